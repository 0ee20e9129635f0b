//! A gear that is not round: the joint runs ahead and behind as it turns.
//!
//! `Δq = amplitude · cos(harmonic · q + phase)`, as a cosine and a sine coefficient.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// The effect.
pub struct GearEccentricity;

/// The lowest harmonic: below it a wave over half a turn is a straight line, which is the encoder's gain.
const LOWEST: f64 = 0.5;

/// The highest harmonic of the output side that is scanned.
const HIGHEST: f64 = 16.0;

/// The highest harmonic of the motor side that is scanned where robot.toml does not give the gear's ratio: twice a turn of the
/// motor behind a gear of 200.
const HIGHEST_OF_MOTOR: f64 = 400.0;

/// Phase between neighbours of the scan at the ends of the joint's range, radians: a wave found between two of them keeps
/// 98 % of its square.
const STEP: f64 = 0.45;

/// Multiples of the gear ratio that are tried: once and twice a motor turn, and a strain wave gear's two lobes.
const MOTOR_MULTIPLES: [f64; 3] = [0.5, 1.0, 2.0];

impl Effect for GearEccentricity {
    fn name(&self) -> &'static str {
        "gear_eccentricity"
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let turning = (0..scene.chain.joint_count()).filter(|&joint| scene.revolute[joint]);
        turning.filter(|&joint| scene.half_range(joint) > 0.0).map(Site::joint).collect()
    }

    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        let Some(joint) = site.joint else { return Vec::new() };
        let step = (STEP / scene.half_range(joint)).min(1.0);
        let mut harmonics = Vec::new();
        let mut harmonic = LOWEST;
        let ratio = scene.gear_ratios[joint].filter(|ratio| ratio.abs() > 1.0);
        let highest = if ratio.is_some() { HIGHEST } else { HIGHEST_OF_MOTOR };
        while harmonic <= highest {
            harmonics.push(harmonic);
            harmonic += step;
        }
        // What turns a whole number of times is the likeliest, and worth being met exactly.
        harmonics.extend((1..=HIGHEST as usize).map(|whole| whole as f64));
        if let Some(ratio) = ratio {
            harmonics.extend(MOTOR_MULTIPLES.iter().map(|multiple| multiple * ratio.abs()));
        }
        harmonics.sort_by(f64::total_cmp);
        harmonics.dedup();
        harmonics.into_iter().map(|harmonic| vec![harmonic]).collect()
    }

    /// The motor's side is another family than the output's.
    fn family(&self, shape: &[f64]) -> u8 {
        u8::from(shape[0] > HIGHEST)
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        let Some(joint) = site.joint else { return Vec::new() };
        let wave =
            |of: fn(f64) -> f64| vec![Acts::Joint(joint, scene.by_visit(|visit| of(shape[0] * visit.joints[joint])))];
        vec![wave(libm::cos), wave(libm::sin)]
    }

    fn parameters(&self, _: &Site, shape: &[f64], coefficients: &[f64]) -> Vec<Named> {
        // a cos(hq) + b sin(hq) = A cos(hq + φ) with a = A cos φ, b = -A sin φ.
        let [a, b] = [coefficients[0], coefficients[1]];
        vec![
            Named::new("amplitude_rad", a.hypot(b)),
            Named::new("phase_rad", libm::atan2(-b, a)),
            Named::new("harmonic", shape[0]),
        ]
    }

    fn form(&self, _: &Site) -> Form {
        Form::whole().joint().shape(1..=1).coefficients(2..=2)
    }

    fn values(&self, _: &Scene, _: &Site, given: &mut Given) -> Result<Values, InstanceError> {
        let (amplitude, phase) = (given.number("amplitude_rad")?, given.number("phase_rad")?);
        let harmonic = given.positive("harmonic")?;
        Ok(Values::new([harmonic], [amplitude * libm::cos(phase), -amplitude * libm::sin(phase)]))
    }

    fn refine(&self, scene: &Scene, _: &[f64]) -> Vec<f64> {
        let widest = (0..scene.chain.joint_count()).map(|joint| scene.half_range(joint)).fold(0.0, f64::max);
        vec![(STEP / widest.max(1e-3)).min(1.0)]
    }
}
