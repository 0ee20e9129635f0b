//! A rigid motion: rotation and origin of one frame seen from another.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// A quaternion of another length than one by more than this is none of a rotation: a number is missing or misplaced.
const NOT_UNIT: f64 = 1e-3;

/// A frame seen from another: maps coordinates `p` in it to `rotation * p + origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Columns are the frame's axes.
    pub rotation: Matrix3<f64>,
    /// The frame's origin, metres.
    pub origin: Vector3<f64>,
}

impl Frame {
    /// The frame itself.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), origin: Vector3::zeros() }
    }

    /// The frame at an origin, m, with the turn of a quaternion; none where that is not of length one, near enough.
    pub fn from_quaternion(origin: Vector3<f64>, turn: Quaternion<f64>) -> Option<Self> {
        let unit = (turn.norm() - 1.0).abs() < NOT_UNIT;
        let rotation = || UnitQuaternion::from_quaternion(turn).to_rotation_matrix().into_inner();
        unit.then(|| Self { rotation: rotation(), origin })
    }

    /// A point of this frame in the outer frame.
    pub fn point(&self, local: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * local + self.origin
    }

    /// A point of the outer frame in this frame.
    pub fn local(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(&(point - self.origin))
    }

    /// The frame `inner`, which is seen from this one, seen from the outer frame.
    pub fn then(&self, inner: &Frame) -> Frame {
        Frame { rotation: self.rotation * inner.rotation, origin: self.point(&inner.origin) }
    }

    /// The outer frame seen from this one.
    pub fn inverse(&self) -> Frame {
        let rotation = self.rotation.transpose();
        Frame { rotation, origin: -(rotation * self.origin) }
    }

    /// The rotation as a unit quaternion.
    pub fn quaternion(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_matrix(&self.rotation)
    }
}
