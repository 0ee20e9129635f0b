//! A calibration that drifts for half a year and is kept true by checks of one target a week at four postures: its error
//! falls toward a full recalibration's, innovations are as probable as the filter says, and a wrong check is refused.

mod calibrate_twin;

use calibrate_twin::{Dice, SIGMA, Strata, TURN_SIGMA, Twin};
use nalgebra::Vector3;
use thermokin::calibrate::{
    Campaign, Drift, Manner, ObservedPosition, ObservedVisit, State, Unknown, Upkeep, identify,
};
use thermokin::robot::{Posture, shipped};

const GROWN: [(&str, &str, f64); 5] =
    [("d1", "S0", -1.1e-5), ("a1", "S1", 7e-6), ("a2", "S2", 1.7e-5), ("beta2", "S2", 1e-5), ("d4", "S3", -1.5e-5)];

/// 1-sigma of what a calibration leaves of a coefficient (a share) and of a parameter.
const LEFT: [f64; 2] = [0.03, 1e-5];

const DRIFT: Drift = Drift {
    coefficient_share: 0.02,
    length_m: 4e-6,
    angle_rad: 4e-6,
    posture_m: 1e-4,
    joint_sigma: 5e-6,
    refused_share: 1e-3,
};

struct Cell {
    twin: Twin,
    dice: Dice,
}

impl Cell {
    fn rises(&mut self) -> Vec<f64> {
        let warm = self.dice.between(0.0, 18.0);
        (0..4).map(|_| warm * self.dice.between(0.4, 1.0)).collect()
    }

    /// One target of a posture as it is measured; `error` is what no parameter describes, in the flange frame.
    fn check(&mut self, pose: u32, joints: &[f64], error: Vector3<f64>, rises: Vec<f64>) -> ObservedVisit {
        let mut values = self.twin.truth.geometry.parameters.clone();
        for (term, coefficient) in self.twin.growth.iter().zip(&self.twin.truth.growth) {
            values[term.parameter] += coefficient * rises[term.sensor];
        }
        let stood: Vec<f64> = joints.iter().map(|joint| joint + DRIFT.joint_sigma * self.dice.normal()).collect();
        let flange = self.twin.robot.chain().prepare(&values).flange(&Posture::new(&stood));
        let at = flange.point(&(self.twin.truth.geometry.targets[0] + error)) + self.dice.vector(SIGMA);
        ObservedVisit {
            place: 0,
            cycle: 0,
            pose,
            posture: Posture::new(joints),
            rises,
            positions: vec![ObservedPosition { target: 0, at }],
            sigma: SIGMA,
            turns: Vec::new(),
            turn_sigma: TURN_SIGMA,
            distances: Vec::new(),
        }
    }

    /// A day of drift, as the filter believes in it.
    fn drift(&mut self) {
        let chain = self.twin.robot.chain();
        for (term, (_, _, coefficient)) in GROWN.iter().enumerate() {
            self.twin.truth.growth[term] += DRIFT.coefficient_share * coefficient * self.dice.normal();
            let place = self.twin.growth[term].parameter;
            let size = if chain.parameters()[place].symbol.is_angle() { DRIFT.angle_rad } else { DRIFT.length_m };
            self.twin.truth.geometry.parameters[place] += size * self.dice.normal();
        }
    }

    /// Root mean square distance between the truth and a state, over the window and the temperatures, m.
    fn error(&mut self, state: &State) -> f64 {
        let chain = self.twin.robot.chain();
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..200 {
            let joints: Vec<f64> = (0..6).map(|_| self.dice.between(-0.8, 0.8)).collect();
            let rises = self.rises();
            let place = |state: &State| {
                let mut values = state.geometry.parameters.clone();
                for (term, coefficient) in self.twin.growth.iter().zip(&state.growth) {
                    values[term.parameter] += coefficient * rises[term.sensor];
                }
                chain.prepare(&values).flange(&Posture::new(&joints)).point(&state.geometry.targets[0])
            };
            sum += (place(state) - place(&self.twin.truth)).norm_squared();
            count += 1.0;
        }
        f64::sqrt(sum / count)
    }
}

fn cell(test: &str) -> (Cell, Campaign, State, Vec<[f64; 2]>) {
    let mut dice = Dice::new(test);
    let mut twin = Twin::new(shipped("comau-nj-130-2.0").expect("shipped"), &mut dice);
    for (parameter, sensor, coefficient) in GROWN {
        twin.grows(parameter, sensor, coefficient);
    }
    // What a calibration left.
    let mut state = twin.truth.clone();
    let sigmas: Vec<[f64; 2]> =
        GROWN.iter().map(|(_, _, coefficient)| [LEFT[0] * coefficient.abs(), LEFT[1]]).collect();
    for (term, growth) in twin.growth.iter().enumerate() {
        state.growth[term] += sigmas[term][0] * dice.normal();
        state.geometry.parameters[growth.parameter] += sigmas[term][1] * dice.normal();
    }
    let campaign = twin.empty();
    (Cell { twin, dice }, campaign, state, sigmas)
}

#[test]
fn checks_of_one_target_keep_a_calibration_true_for_half_a_year() {
    let (mut cell, campaign, old, sigmas) = cell("checks keep a calibration true");
    let mut upkeep = Upkeep::new(&campaign, old.clone(), &sigmas, DRIFT);
    let postures = cell.twin.postures(4, 0.8, &mut cell.dice);
    let errors: Vec<Vector3<f64>> = postures.iter().map(|_| cell.dice.vector(DRIFT.posture_m)).collect();
    let (mut nis, mut freedom, mut refused) = (0.0, 0, 0);
    for day in 0..182_u32 {
        if day > 0 {
            cell.drift();
        }
        if day % 7 != 0 {
            continue;
        }
        for (pose, (joints, error)) in postures.iter().zip(&errors).enumerate() {
            let rises = cell.rises();
            let visit = cell.check(pose as u32, joints, *error, rises);
            let innovation = upkeep.take(&visit, f64::from(day) * 86_400.0);
            refused += u32::from(innovation.refused);
            if !innovation.refused {
                nis += innovation.nis;
                freedom += innovation.freedom;
            }
        }
    }
    // Refused are a thousandth of the good ones: of 104, none to a few.
    assert!(refused <= 3, "{refused} good checks refused");
    let deviation = (2.0 * freedom as f64).sqrt();
    println!("NIS {nis:.1} of {freedom} degrees of freedom (± {deviation:.1})");
    assert!((nis - freedom as f64).abs() < 5.0 * deviation);
    // A full new run: fifteen postures with errors of their own, in twelve cycles.
    let poses = cell.twin.postures(15, 0.8, &mut cell.dice);
    let rises: Vec<Vec<f64>> = (0..12).map(|_| cell.rises()).collect();
    let strata = Strata { point: SIGMA, visit: DRIFT.joint_sigma, posture: 0.0 };
    let run = cell.twin.visit(&poses, &rises, strata, &mut cell.dice);
    let mut unknowns: Vec<Unknown> = (0..run.chain.parameters().len()).map(Unknown::Parameter).collect();
    unknowns.extend((0..GROWN.len()).map(Unknown::Growth));
    let full = identify(&run, unknowns, old.clone(), &Manner::default()).solution.state;
    let [old, kept, full] = [&old, upkeep.state(), &full].map(|state| cell.error(state) * 1e6);
    println!(
        "positions after half a year: {old:.1} µm as calibrated, {kept:.1} µm with checks, {full:.1} µm after a new run"
    );
    assert!(kept - full < 0.5 * (old - full));
    // The coefficients themselves lie where the filter says.
    let mut distance = 0.0;
    for (unknown, sigma) in upkeep.unknowns().iter().zip(upkeep.sigmas()) {
        distance += ((upkeep.state().value(*unknown) - cell.twin.truth.value(*unknown)) / sigma).powi(2);
    }
    // Ten values that are correlated: the mean square stays near one, at most a χ² of one degree of freedom ten times over.
    assert!(distance / 10.0 < 6.0, "{distance}");
}

#[test]
fn a_wrong_check_is_refused_and_changes_nothing() {
    let (mut cell, campaign, old, sigmas) = cell("a wrong check");
    let mut upkeep = Upkeep::new(&campaign, old, &sigmas, DRIFT);
    let joints = [0.2, 0.3, -0.2, 0.5, 0.8, -0.4];
    for week in 0..8 {
        let rises = cell.rises();
        let visit = cell.check(0, &joints, Vector3::zeros(), rises);
        assert!(!upkeep.take(&visit, f64::from(week) * 604_800.0).refused);
    }
    let before = upkeep.state().clone();
    let rises = cell.rises();
    let mut visit = cell.check(0, &joints, Vector3::zeros(), rises);
    visit.positions[0].at += Vector3::new(0.0, 5e-3, 0.0);
    let innovation = upkeep.take(&visit, 8.0 * 604_800.0);
    assert!(innovation.refused && innovation.nis > 100.0 && innovation.distance_m > 4e-3, "{innovation:?}");
    assert_eq!(*upkeep.state(), before);
}
