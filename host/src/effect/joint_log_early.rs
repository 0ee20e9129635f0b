//! Joints that were logged before the arm had arrived.
//!
//! `Δq = share · (previous q - q)`, or, where the file has both accounts of the joints, `Δq = share · (other - q)` with the
//! account that is not believed.

use super::{Acts, Effect, Named, Scene, Site, Term};

/// The effect.
pub struct JointLogEarly;

/// The shape's one number says which difference: the visit before, or the other account of the joints.
const BEFORE: f64 = 0.0;
const OTHER_ACCOUNT: f64 = 1.0;

fn differs(scene: &Scene, joint: usize) -> bool {
    let other =
        |visit: &super::Situation| visit.other_account.as_ref().is_some_and(|q| q[joint] != visit.joints[joint]);
    scene.visits.iter().any(other)
}

impl Effect for JointLogEarly {
    fn name(&self) -> &'static str {
        "joint_log_early"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        (0..scene.chain.joint_count()).filter(|&joint| scene.half_range(joint) > 0.0).map(Site::joint).collect()
    }

    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        match site.joint {
            Some(joint) if differs(scene, joint) => vec![vec![BEFORE], vec![OTHER_ACCOUNT]],
            _ => vec![vec![BEFORE]],
        }
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        let amounts = scene.by_visit(|visit| {
            let from = if shape[0] == BEFORE { &visit.before } else { &visit.other_account };
            from.as_ref().map_or(0.0, |from| from[joint] - visit.joints[joint])
        });
        vec![vec![Acts::Joint(joint, amounts)]]
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        vec![Named::new("share", coefficients[0])]
    }
}
