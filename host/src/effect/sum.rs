//! What several effects do together.

use nalgebra::Vector3;

use super::{Adjustment, Instance, Scene};

/// The sum of what effects do at every visit of a scene. `targets` are the places in the flange frame that they move.
pub fn adjustments(scene: &Scene, effects: &[Instance], targets: &[Vector3<f64>]) -> Vec<Adjustment> {
    let chain = &scene.chain;
    let none = Adjustment::none(chain.joint_count(), chain.parameters().len(), scene.sensors.len(), targets.len());
    let mut all = vec![none; scene.visits.len()];
    for effect in effects {
        for (term, coefficient) in effect.terms(scene).iter().zip(&effect.coefficients) {
            for act in term {
                for (visit, adjustment) in all.iter_mut().enumerate() {
                    adjustment.add(act, visit, *coefficient, targets);
                }
            }
        }
    }
    all
}
