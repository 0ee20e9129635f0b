//! Joints that were logged before the arm had arrived.
//!
//! `Δq = share · (previous q - q)`, or, where the file has both accounts of the joints, `Δq = share · (other - q)` with the
//! account that is not believed.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

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

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        let mut named = vec![Named::new("share", coefficients[0])];
        if shape[0] == OTHER_ACCOUNT {
            named.push(Named::new("other_account", OTHER_ACCOUNT));
        }
        named
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint().shape(1..=1)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let share = given.number("share")?;
        let account = given.optional("other_account")?.unwrap_or(BEFORE);
        given.require("other_account", account, account == BEFORE || account == OTHER_ACCOUNT, "0 or 1")?;
        Ok(Values::new([account], [share]))
    }

    fn lacks(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Option<&'static str> {
        let other = shape[0] == OTHER_ACCOUNT && !site.joint.is_some_and(|joint| differs(scene, joint));
        other.then_some("both accounts of the joints")
    }
}
