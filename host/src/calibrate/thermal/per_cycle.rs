//! The thesis's way (sections 4.4.1 and 4.4.2): a geometric calibration at every cycle, then a regression of the chosen
//! parameters' changes on the temperatures' changes.

use nalgebra::{DMatrix, DVector};

use crate::calibrate::campaign::Campaign;
use crate::calibrate::problem::Problem;
use crate::calibrate::solve::{Stopping, solve};
use crate::calibrate::unknown::{State, Unknown};

/// The geometry found at one cycle alone.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleGeometry {
    /// The cycle.
    pub cycle: u32,
    /// The chain's parameters.
    pub parameters: Vec<f64>,
    /// Mean rise of each of the campaign's sensors over the cycle's visits, kelvin.
    pub rises: Vec<f64>,
}

/// Thermal coefficients found the thesis's way.
#[derive(Debug, Clone, PartialEq)]
pub struct PerCycle {
    /// The geometry of every cycle with enough poses.
    pub cycles: Vec<CycleGeometry>,
    /// Cycles with too few poses to find all parameters.
    pub left_out: Vec<u32>,
    /// Coefficients in the order of the campaign's growth terms (eq. 4.5); none where no cycle but the reference is left.
    pub coefficients: Option<Vec<f64>>,
}

/// Calibrates every cycle alone, from the state found at the reference cycle, and regresses (eqs. 4.4 and 4.5).
///
/// `unknowns` are those that the reference cycle identifies.
pub fn per_cycle(campaign: &Campaign, reference: &State, unknowns: &[Unknown], reference_cycle: u32) -> PerCycle {
    let mut numbers: Vec<u32> = campaign.visits.iter().map(|visit| visit.cycle).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let plain = Campaign { growth: Vec::new(), ..campaign.clone() };
    let start = State { growth: Vec::new(), ..reference.clone() };
    let mut cycles = Vec::new();
    let mut left_out = Vec::new();
    for cycle in numbers {
        let own = plain.select(|visit| visit.cycle == cycle);
        let (kept, _) = crate::calibrate::identify::identifiable(&own, unknowns.to_vec(), &start);
        if kept.len() < unknowns.len() || own.rows() < unknowns.len() {
            left_out.push(cycle);
            continue;
        }
        let state = solve(&Problem::new(&own, kept, &start), start.clone(), &Stopping::default()).state;
        let visits = own.visits.len() as f64;
        let rises = (0..campaign.sensors.len())
            .map(|sensor| own.visits.iter().map(|visit| visit.rises[sensor]).sum::<f64>() / visits)
            .collect();
        cycles.push(CycleGeometry { cycle, parameters: state.geometry.parameters, rises });
    }
    let coefficients = regress(campaign, &cycles, reference_cycle);
    PerCycle { cycles, left_out, coefficients }
}

/// The pseudoinverse of the temperatures' changes times the parameters' changes (eq. 4.5), parameter by parameter.
fn regress(campaign: &Campaign, cycles: &[CycleGeometry], reference_cycle: u32) -> Option<Vec<f64>> {
    let zero = cycles.iter().find(|cycle| cycle.cycle == reference_cycle)?;
    let others: Vec<&CycleGeometry> = cycles.iter().filter(|cycle| cycle.cycle != reference_cycle).collect();
    if others.is_empty() || campaign.growth.is_empty() {
        return None;
    }
    let mut coefficients = vec![0.0; campaign.growth.len()];
    let mut parameters: Vec<usize> = campaign.growth.iter().map(|term| term.parameter).collect();
    parameters.sort_unstable();
    parameters.dedup();
    for parameter in parameters {
        let terms: Vec<usize> =
            (0..campaign.growth.len()).filter(|&term| campaign.growth[term].parameter == parameter).collect();
        let rises = DMatrix::from_fn(others.len(), terms.len(), |row, column| {
            let sensor = campaign.growth[terms[column]].sensor;
            others[row].rises[sensor] - zero.rises[sensor]
        });
        let changes =
            DVector::from_fn(others.len(), |row, _| others[row].parameters[parameter] - zero.parameters[parameter]);
        let svd = rises.svd(true, true);
        // Sensors that read alike to a thousandth of their rise are one sensor.
        let smallest = 1e-3 * svd.singular_values.max();
        let solved = svd.solve(&changes, smallest.max(f64::MIN_POSITIVE)).ok()?;
        for (&term, value) in terms.iter().zip(&solved) {
            coefficients[term] = *value;
        }
    }
    Some(coefficients)
}
