//! Effects: what each adds to the true world, stated once here for the simulation and for the oracle. Nothing of this is
//! shared with the code that fits.

use nalgebra::{Matrix3, Vector3};
use serde_json::{Map, Value, json};

use super::heat::follow;
use super::kind::{Kind, Place};
use super::world::{Influence, Point, World, less_reference};

/// One hidden effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// What.
    pub kind: Kind,
    /// Where.
    pub place: Place,
    /// Nonlinear parameters; their meaning is the kind's, see [`basis`].
    pub shape: Vec<f64>,
    /// Linear coefficients, one for each of [`basis`].
    pub size: Vec<f64>,
}

impl Effect {
    /// What it does to the positions.
    pub fn influence(&self, world: &World) -> Influence {
        let mut sum = Influence::default();
        for (size, one) in self.size.iter().zip(basis(world, self.kind, &self.place, &self.shape)) {
            sum.add(*size, &one);
        }
        sum
    }

    /// The parameters as truth.json states them, by the names of effects.md.
    pub fn parameters(&self, world: &World) -> Value {
        let (s, c) = (&self.shape, &self.size);
        match self.kind {
            Kind::GearEccentricity => json!({
                "amplitude_rad": libm::hypot(c[0], c[1]), "phase_rad": libm::atan2(-c[1], c[0]), "harmonic": s[0]}),
            Kind::EncoderGain => json!({"gain": c[0]}),
            Kind::Backlash => json!({"width_rad": c[0]}),
            Kind::LostMotion => json!({"amplitude_rad": c[0], "torque_scale_nm": s[0]}),
            Kind::JointLogEarly => json!({"share": c[0]}),
            Kind::JointCompliance => json!({"compliance_rad_per_nm": c[0]}),
            Kind::JointCoupling => json!({"ratio": c[0]}),
            Kind::ThermalGrowth => {
                let each = c[0] / s.len() as f64;
                let named = s.iter().map(|&sensor| (world.arm.sensors[sensor as usize].name.clone(), json!(each)));
                Value::Object(named.collect::<Map<_, _>>())
            }
            Kind::ThermalLag => json!({"tau_s": s[0]}),
            Kind::ThermalNonlinearity => json!({"coefficient": c[0]}),
            Kind::UnsensedHeat => json!({"coefficient": c[0], "tau_s": s[0]}),
            Kind::FrameDrift => json!({"shift_m_per_s": c[..3], "rot_rad_per_s": c[3..6]}),
            Kind::FrameJump | Kind::ToolSlip => json!({"time_s": s[0], "shift_m": c[..3], "rot_rad": c[3..6]}),
            Kind::ScaleError => json!({"scale": c[0]}),
            Kind::TargetShift => json!({"time_s": s[0], "shift_m": c}),
            Kind::TargetSwap => json!({"cycles": s.iter().map(|&cycle| cycle as usize).collect::<Vec<_>>()}),
            Kind::Outliers => json!({"fraction": s[0], "size_m": s[1]}),
            Kind::SensorChill => json!({"depth_k": s[0], "tau_s": s[1]}),
            Kind::SensorBias if s[2] != 0.0 => json!({"drift_k_per_h": s[2]}),
            Kind::SensorBias => json!({"time_s": s[0], "step_k": s[1]}),
            Kind::SensorSwap => json!({}),
            Kind::SensorDetached => json!({"air_share": s[0]}),
            Kind::ClockOffset => json!({"offset_s": s[0]}),
            off if off.is_off() => json!({"coefficient": c[0]}),
            _ => json!({}),
        }
    }
}

/// What a kind at a place does to the positions per unit of each of its linear coefficients. Empty for what changes the
/// records alone (readings, labels, outliers).
///
/// Shapes: gear and cross wave `[harmonic]`; lost motion `[torque_scale_nm]`; lag `[tau_s]`; unsensed heat `[tau_s]`; jump,
/// shift and slip `[time_s]`; thermal growth the sensors' places; scale walk one value a cycle; readings as [`Effect::parameters`]
/// states them.
pub fn basis(world: &World, kind: Kind, place: &Place, shape: &[f64]) -> Vec<Influence> {
    let joint = place.joint.unwrap_or(0);
    let from = place.from.unwrap_or(0);
    let visits = &world.schedule.visits;
    let by_visit = |value: &dyn Fn(usize) -> f64| {
        let values = (0..visits.len()).map(value).collect();
        Influence { joints: vec![(joint, values)], ..Influence::default() }
    };
    let by_point = |values: Vec<f64>| {
        let parameters = vec![(place.parameter.expect("a parameter"), values)];
        Influence { parameters, ..Influence::default() }
    };
    let after = |time_s: f64| move |point: &Point| if point.time_s >= time_s { 1.0 } else { 0.0 };
    match kind {
        Kind::GearEccentricity => vec![
            by_visit(&|v| libm::cos(shape[0] * visits[v].joints[joint])),
            by_visit(&|v| libm::sin(shape[0] * visits[v].joints[joint])),
        ],
        Kind::EncoderGain => vec![by_visit(&|v| visits[v].joints[joint])],
        Kind::Backlash => vec![by_visit(&|v| 0.5 * visits[v].approach[joint])],
        Kind::LostMotion => vec![by_visit(&|v| libm::tanh(world.moments[v][joint].0 / shape[0]))],
        Kind::JointLogEarly => vec![by_visit(&|v| visits[v].before[joint] - visits[v].joints[joint])],
        Kind::JointCompliance => vec![by_visit(&|v| world.moments[v][joint].0)],
        Kind::JointCoupling => vec![by_visit(&|v| visits[v].joints[from])],
        Kind::ThermalGrowth => {
            let count = shape.len() as f64;
            let mean = |p: usize| shape.iter().map(|&sensor| world.rises[sensor as usize][p]).sum::<f64>() / count;
            vec![by_point((0..world.points.len()).map(mean).collect())]
        }
        Kind::ThermalLag => {
            let Some(growth) = world.growth.iter().find(|growth| Some(growth.parameter) == place.parameter) else {
                return Vec::new();
            };
            let times: Vec<f64> = world.points.iter().map(|point| point.time_s).collect();
            let lagged = follow(shape[0], &times, |t| world.heat.at(&growth.terms, t));
            let beyond = lagged.iter().zip(&times).map(|(l, &t)| l - world.heat.at(&growth.terms, t)).collect();
            vec![by_point(less_reference(&world.schedule, &world.points, beyond))]
        }
        Kind::ThermalNonlinearity => {
            vec![by_point(world.rises[place.sensors[0]].iter().map(|rise| rise * rise).collect())]
        }
        Kind::UnsensedHeat => {
            let speed = |t| world.schedule.step_at(t).map_or(0.0, |step| step.rms[joint] * step.rms[joint]);
            let times: Vec<f64> = world.points.iter().map(|point| point.time_s).collect();
            vec![by_point(less_reference(&world.schedule, &world.points, follow(shape[0], &times, speed)))]
        }
        Kind::FrameDrift => rigid_in_world(world, |point| point.time_s),
        Kind::FrameJump => rigid_in_world(world, after(shape[0])),
        Kind::ScaleError => vec![scaled(world, |_| 1.0)],
        Kind::TargetShift => {
            let target = place.targets[0];
            let here = move |point: &Point| if point.target == target { after(shape[0])(point) } else { 0.0 };
            (0..3).map(|axis| in_flange(world, |point| unit(axis) * here(point))).collect()
        }
        Kind::ToolSlip => {
            let shifts = (0..3).map(|axis| in_flange(world, |point| unit(axis) * after(shape[0])(point)));
            let turned = |axis: usize, point: &Point| unit(axis).cross(&world.arm.targets[point.target].1);
            let turns = (0..3).map(|axis| in_flange(world, |point| turned(axis, point) * after(shape[0])(point)));
            shifts.chain(turns).collect()
        }
        Kind::TargetSwap
        | Kind::Outliers
        | Kind::SensorChill
        | Kind::SensorBias
        | Kind::SensorSwap
        | Kind::SensorDetached
        | Kind::ClockOffset => Vec::new(),
        // A joint's error that goes with the product of two joints' angles.
        Kind::OffJointProduct => {
            let other = (joint + 2) % visits[0].joints.len();
            vec![by_visit(&|v| visits[v].joints[from] * visits[v].joints[other])]
        }
        // A link that bends under the load's moment about an axis that is no joint's: the x axis behind the joint.
        Kind::OffLinkBending => {
            let moments = world.points.iter().map(|point| world.moments[point.visit][joint].1).collect();
            vec![by_point(moments)]
        }
        // The instrument wanders by the cube of time, so far as a linear drift does not follow it.
        Kind::OffCubicDrift => {
            let end = world.schedule.end_s;
            let wander = |t: f64| {
                let x = 2.0 * t / end - 1.0;
                2.5 * x * x * x - 1.5 * x
            };
            let along = Vector3::new(shape[0], shape[1], shape[2]);
            vec![world_motion(world, |point| (Matrix3::zeros(), along * wander(point.time_s)))]
        }
        // The scale walks at random from cycle to cycle, as under air of changing humidity.
        Kind::OffScaleWalk => vec![scaled(world, |point| shape[visits[point.visit].cycle])],
        // A joint lags behind by the speed override of the movement before the measurement.
        Kind::OffOverride => vec![by_visit(&|v| {
            let visit = &visits[v];
            world.schedule.override_before(visit.cycle) * visit.approach[joint]
        })],
        // A joint's error that waves with another joint's angle.
        Kind::OffCrossWave => vec![by_visit(&|v| libm::cos(shape[0] * visits[v].joints[from] + shape[1]))],
        // A retroreflector's range error that grows with the angle under which the beam falls on it.
        Kind::OffIncidence => {
            let nothing = Influence::default();
            let at = world.positions(&nothing, &[]);
            let motion = |p: usize| {
                let visit = &visits[world.points[p].visit];
                let facing = world.arm.flange(&world.values, &visit.joints).fixed_view::<3, 1>(0, 2).into_owned();
                let beam = at[p] / libm::sqrt(at[p].norm_squared());
                beam * (1.0 - facing.dot(&beam)) * (1.0 - facing.dot(&beam))
            };
            let world = (0..world.points.len()).map(|p| (Matrix3::zeros(), motion(p))).collect();
            vec![Influence { world, ..Influence::default() }]
        }
    }
}

fn unit(axis: usize) -> Vector3<f64> {
    Vector3::ith(axis, 1.0)
}

fn in_flange(world: &World, shift: impl Fn(&Point) -> Vector3<f64>) -> Influence {
    Influence { flange: world.points.iter().map(shift).collect(), ..Influence::default() }
}

fn world_motion(world: &World, motion: impl Fn(&Point) -> (Matrix3<f64>, Vector3<f64>)) -> Influence {
    Influence { world: world.points.iter().map(motion).collect(), ..Influence::default() }
}

fn scaled(world: &World, amount: impl Fn(&Point) -> f64) -> Influence {
    world_motion(world, |point| (Matrix3::identity() * amount(point), Vector3::zeros()))
}

/// Three shifts and three turns about the world's origin, each times an amount.
fn rigid_in_world(world: &World, amount: impl Fn(&Point) -> f64) -> Vec<Influence> {
    let shifts = (0..3).map(|axis| world_motion(world, |point| (Matrix3::zeros(), unit(axis) * amount(point))));
    let turns =
        (0..3).map(|axis| world_motion(world, |point| (unit(axis).cross_matrix() * amount(point), Vector3::zeros())));
    shifts.chain(turns).collect()
}
