//! What a model's effects do, taken into a campaign: afterwards it looks as if an arm without effects had been measured, so
//! that everything that works on campaigns works with effects.
//!
//! Effects on joints change the postures, those on readings the rises, those on the instrument the measured positions; a
//! parameter that an effect moves gets a sensor of its own, whose rise is the amount, with the coefficient one.

use nalgebra::{Matrix3, Vector3};

use super::campaign::Campaign;
use super::unknown::GrowthTerm;
use crate::effect::Adjustment;
use crate::robot::Posture;

/// Where a target truly stood that the instrument reports at `seen`: the inverse of [`Adjustment::seen`].
fn truly(adjustment: &Adjustment, seen: &Vector3<f64>, station: &Vector3<f64>) -> Vector3<f64> {
    let turned = (seen + station * adjustment.scale) / (1.0 + adjustment.scale) - adjustment.shift;
    let turn = Matrix3::identity() + adjustment.turn.cross_matrix();
    // A turn is small, and the identity with a cross product beside it has no zero eigenvalue.
    turn.try_inverse().map_or(turned, |back| back * turned)
}

/// The campaign with what effects do at its visits taken in, and the coefficients of the growth terms that were added to its
/// own. Shifts of targets belong to one run and are not taken in.
pub fn folded(campaign: &Campaign, adjustments: &[Adjustment], station: &Vector3<f64>) -> (Campaign, Vec<f64>) {
    let mut folded = campaign.clone();
    let parameters = campaign.chain.parameters().len();
    let moved: Vec<usize> = (0..parameters)
        .filter(|&place| adjustments.iter().any(|adjustment| adjustment.parameters[place] != 0.0))
        .collect();
    for &parameter in &moved {
        folded.growth.push(GrowthTerm { parameter, sensor: folded.sensors.len() });
        folded.sensors.push(format!("effects on {}", campaign.chain.parameters()[parameter]));
    }
    for (visit, adjustment) in folded.visits.iter_mut().zip(adjustments) {
        let joints: Vec<f64> =
            visit.posture.positions().iter().zip(&adjustment.joints).map(|(q, more)| q + more).collect();
        visit.posture = Posture::new(&joints);
        visit.rises.iter_mut().zip(&adjustment.rises).for_each(|(rise, more)| *rise += more);
        visit.rises.extend(moved.iter().map(|&place| adjustment.parameters[place]));
        for position in &mut visit.positions {
            position.at = truly(adjustment, &position.at, station);
        }
    }
    (folded, vec![1.0; moved.len()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_a_target_stood_is_found_from_where_it_is_seen() {
        let mut adjustment = Adjustment::none(6, 30, 0, 1);
        adjustment.shift = Vector3::new(1e-3, -2e-3, 5e-4);
        adjustment.turn = Vector3::new(1e-4, 3e-4, -2e-4);
        adjustment.scale = 2e-5;
        let (stood, station) = (Vector3::new(1.5, -0.4, 1.1), Vector3::new(-3.0, 2.0, 0.5));
        let seen = adjustment.seen(&stood, &station);
        assert!((seen - stood).norm() > 1e-3);
        assert!((truly(&adjustment, &seen, &station) - stood).norm() < 1e-14);
    }
}
