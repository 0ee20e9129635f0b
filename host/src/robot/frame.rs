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

    /// The frame in which the first point of each pair lies nearest to where the second is seen from outside: an absolute
    /// orientation (Kabsch 1976). Three pairs that are no line determine it.
    pub fn registered(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone) -> Self {
        let (mut count, mut from_mean, mut to_mean) = (0.0, Vector3::zeros(), Vector3::zeros());
        for (from, to) in pairs.clone() {
            count += 1.0;
            from_mean += from;
            to_mean += to;
        }
        from_mean /= count;
        to_mean /= count;
        let covariance =
            pairs.fold(Matrix3::zeros(), |sum, (from, to)| sum + (to - to_mean) * (from - from_mean).transpose());
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
        // A reflection is no motion: the weakest direction is turned over.
        let mut signs = Vector3::new(1.0, 1.0, 1.0);
        signs[svd.singular_values.imin()] = (u * v_t).determinant().signum();
        let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
        Self { rotation, origin: to_mean - rotation * from_mean }
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

/// The points of an arm from the base to the flange, with the corner that each transform's shift along its axis makes: from
/// the frames after each transform, two points a transform after the first and the flange's origin.
pub fn centre_lines(frames: &[Frame]) -> Vec<Vector3<f64>> {
    let mut points = Vec::with_capacity(2 * frames.len());
    for pair in frames.windows(2) {
        let (before, after) = (&pair[0], &pair[1]);
        let along = before.local(&after.origin).z;
        points.push(before.origin);
        points.push(before.point(&Vector3::new(0.0, 0.0, along)));
    }
    points.extend(frames.last().map(|frame| frame.origin));
    points
}
