//! Chooses effects: a place of a kind, its nonlinear parameters and a natural size, all at random or as asked for.

use super::effect::Effect;
use super::kind::{Kind, Place};
use super::random::Stream;
use super::world::World;

/// An effect that is asked for: a kind and, maybe, where.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// What.
    pub kind: Kind,
    /// `joint=3`, `parameter=a2,joint=1`, `sensor=L3S3`, `sensors=L1S1+L2S2`, `target=T1`, `from=1,joint=3`; what is not
    /// said is drawn.
    pub place: Option<String>,
}

impl Request {
    /// Reads `NAME[:where]`.
    ///
    /// # Errors
    ///
    /// A line that says what was expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, place) = text.split_once(':').map_or((text, None), |(name, place)| (name, Some(place.to_owned())));
        let kind = Kind::of(name).ok_or_else(|| format!("no effect is called {name}"))?;
        Ok(Self { kind, place })
    }
}

/// An effect of a kind at a random or given place, of random shape and natural size.
///
/// # Errors
///
/// Where the place cannot be, or the arm has none for this kind.
pub fn effect(world: &World, request: &Request, stream: &mut Stream) -> Result<Effect, String> {
    let kind = request.kind;
    let mut place = place(world, kind, stream).ok_or_else(|| format!("no place for {}", kind.name()))?;
    if let Some(text) = &request.place {
        apply(world, &mut place, text)?;
    }
    let shape = shape(world, kind, &place, stream);
    let size = size(world, kind, &place, stream);
    Ok(Effect { kind, place, shape, size })
}

fn apply(world: &World, place: &mut Place, text: &str) -> Result<(), String> {
    let arm = &world.arm;
    let joint = |value: &str| match value.parse::<usize>() {
        Ok(joint) if (1..=arm.joints()).contains(&joint) => Ok(joint - 1),
        _ => Err(format!("no joint {value}")),
    };
    let sensor = |value: &str| {
        arm.sensors.iter().position(|sensor| sensor.name == value).ok_or_else(|| format!("no sensor {value}"))
    };
    let target = |value: &str| {
        arm.targets.iter().position(|(name, _)| name == value).ok_or_else(|| format!("no target {value}"))
    };
    for part in text.split(',') {
        let (key, value) = part.split_once('=').ok_or_else(|| format!("expected key=value, not {part}"))?;
        match key {
            "joint" => place.joint = Some(joint(value)?),
            "from" => place.from = Some(joint(value)?),
            "parameter" => {
                let named = (0..arm.parameters().len()).find(|&parameter| arm.parameter_name(parameter) == value);
                place.parameter = Some(named.ok_or_else(|| format!("no parameter {value}"))?);
            }
            "sensor" | "sensors" => place.sensors = value.split('+').map(sensor).collect::<Result<_, _>>()?,
            "target" | "targets" => place.targets = value.split('+').map(target).collect::<Result<_, _>>()?,
            _ => return Err(format!("no place is called {key}")),
        }
    }
    Ok(())
}

/// Parameters of the arm behind the base.
pub fn own_parameters(world: &World) -> Vec<usize> {
    let transforms = world.arm.parameters();
    (0..transforms.len()).filter(|&parameter| transforms[parameter].0 > 0).collect()
}

/// Parameters that the baseline lets follow temperatures.
pub fn thermal_parameters(world: &World) -> Vec<usize> {
    world.growth.iter().map(|growth| growth.parameter).collect()
}

/// Sensors that the baseline uses.
pub fn used_sensors(world: &World) -> Vec<usize> {
    let mut used: Vec<usize> = world.arm.thermal.iter().flat_map(|pair| pair.sensors.clone()).collect();
    used.sort_unstable();
    used.dedup();
    used
}

fn place(world: &World, kind: Kind, stream: &mut Stream) -> Option<Place> {
    let arm = &world.arm;
    let joints = arm.joints();
    let thermal = thermal_parameters(world);
    let two = |count: usize, stream: &mut Stream| {
        let first = stream.below(count);
        (first, (first + 1 + stream.below(count - 1)) % count)
    };
    Some(match kind {
        Kind::GearEccentricity | Kind::EncoderGain | Kind::Backlash | Kind::JointLogEarly | Kind::OffOverride => {
            Place::joint(stream.below(joints))
        }
        Kind::LostMotion | Kind::JointCompliance => {
            // Gravity must turn the joint one way and the other or more and less; the first axis is upright.
            let span = |joint: usize| {
                let moments = world.moments.iter().map(|visit| visit[joint].0);
                moments.clone().fold(f64::MIN, f64::max) - moments.fold(f64::MAX, f64::min)
            };
            let largest = (0..joints).map(span).fold(0.0, f64::max);
            let loaded: Vec<usize> = (0..joints).filter(|&joint| span(joint) > 0.005 * largest).collect();
            Place::joint(*stream.pick(&loaded))
        }
        Kind::JointCoupling => {
            let (from, joint) = two(joints, stream);
            Place { from: Some(from), ..Place::joint(joint) }
        }
        Kind::ThermalGrowth => {
            let fixed: Vec<usize> = own_parameters(world).into_iter().filter(|p| !thermal.contains(p)).collect();
            Place::parameter(*stream.pick(&fixed))
        }
        Kind::ThermalLag if thermal.is_empty() => return None,
        Kind::ThermalLag => Place::parameter(*stream.pick(&thermal)),
        Kind::ThermalNonlinearity => {
            let pair = if arm.thermal.is_empty() { return None } else { stream.pick(&arm.thermal) };
            Place { sensors: vec![*stream.pick(&pair.sensors)], ..Place::parameter(pair.parameter) }
        }
        Kind::UnsensedHeat => {
            let parameter = *stream.pick(&own_parameters(world));
            Place { joint: Some(stream.below(joints)), ..Place::parameter(parameter) }
        }
        Kind::TargetShift => Place { targets: vec![stream.below(arm.targets.len())], ..Place::default() },
        Kind::TargetSwap => {
            let (a, b) = two(arm.targets.len(), stream);
            Place { targets: vec![a.min(b), a.max(b)], ..Place::default() }
        }
        Kind::SensorChill | Kind::SensorBias | Kind::SensorDetached => {
            let used = used_sensors(world);
            if used.is_empty() {
                return None;
            }
            Place { sensors: vec![*stream.pick(&used)], ..Place::default() }
        }
        Kind::SensorSwap => {
            // Of two links, one of them used: neighbours under one parameter swap without any consequence.
            let used = used_sensors(world);
            let first = *stream.pick(&used);
            let link = arm.sensors[first].link;
            let others: Vec<usize> = (0..arm.sensors.len()).filter(|&s| arm.sensors[s].link != link).collect();
            let second = *stream.pick(&others);
            Place { sensors: vec![first.min(second), first.max(second)], ..Place::default() }
        }
        Kind::OffJointProduct | Kind::OffCrossWave => {
            let (from, joint) = two(joints, stream);
            Place { from: Some(from), ..Place::joint(joint) }
        }
        Kind::OffLinkBending => {
            let joint = 1 + stream.below(3);
            let symbol = arm.place(&format!("alpha{}", joint + 1));
            Place { joint: Some(joint), ..Place::parameter(symbol) }
        }
        Kind::FrameDrift
        | Kind::FrameJump
        | Kind::ScaleError
        | Kind::ToolSlip
        | Kind::Outliers
        | Kind::ClockOffset
        | Kind::OffCubicDrift
        | Kind::OffScaleWalk
        | Kind::OffIncidence => Place::default(),
    })
}

fn shape(world: &World, kind: Kind, place: &Place, stream: &mut Stream) -> Vec<f64> {
    let end = world.schedule.end_s;
    let time = |stream: &mut Stream| stream.between(0.2, 0.8) * end;
    match kind {
        // Output-side eccentricity turns a few times a turn, motor-side ones with the gear's ratio.
        Kind::GearEccentricity if stream.uniform() < 0.7 => vec![(1 + stream.below(4)) as f64],
        Kind::GearEccentricity => vec![libm::round(stream.between(40.0, 160.0) * 10.0) / 10.0],
        Kind::LostMotion => {
            let joint = place.joint.expect("a joint");
            let square = world.moments.iter().map(|visit| visit[joint].0 * visit[joint].0).sum::<f64>();
            vec![stream.between(0.2, 0.8) * libm::sqrt(square / world.moments.len() as f64)]
        }
        Kind::ThermalGrowth => {
            // The link that the parameter's transform belongs to, or the next one with sensors.
            let (transform, _) = world.arm.parameters()[place.parameter.expect("a parameter")];
            let last = world.arm.sensors.iter().map(|sensor| sensor.link).max().unwrap_or(0);
            world.sensors_of(transform.min(last)).into_iter().map(|sensor| sensor as f64).collect()
        }
        Kind::ThermalLag => vec![stream.log_between(300.0, 2500.0)],
        Kind::UnsensedHeat => vec![stream.log_between(200.0, 4000.0)],
        Kind::FrameJump | Kind::ToolSlip => vec![time(stream)],
        Kind::TargetShift if stream.uniform() < 0.4 => vec![0.0],
        Kind::TargetShift => vec![time(stream)],
        Kind::TargetSwap => {
            let cycles = world.schedule.visits.iter().map(|visit| visit.cycle).max().unwrap_or(0) + 1;
            let count = 3.min(cycles);
            let first = stream.below(cycles - count + 1);
            (first..first + count).map(|cycle| cycle as f64).collect()
        }
        Kind::Outliers => vec![stream.between(0.005, 0.02), stream.log_between(3e-4, 2e-3)],
        Kind::SensorChill => vec![stream.between(1.0, 5.0), stream.log_between(50.0, 250.0)],
        Kind::SensorBias if stream.uniform() < 0.5 => vec![time(stream), stream.sign() * stream.between(0.5, 3.0), 0.0],
        Kind::SensorBias => vec![0.0, 0.0, stream.sign() * stream.between(0.2, 1.0)],
        Kind::SensorDetached => vec![stream.between(0.2, 0.7)],
        Kind::ClockOffset => vec![stream.sign() * stream.log_between(60.0, 600.0)],
        Kind::OffCubicDrift => (0..3).map(|_| stream.normal()).collect(),
        Kind::OffScaleWalk => {
            let cycles = world.schedule.visits.iter().map(|visit| visit.cycle).max().unwrap_or(0) + 1;
            let mut at = 0.0;
            (0..cycles)
                .map(|_| {
                    at += stream.normal();
                    at
                })
                .collect()
        }
        Kind::OffCrossWave => vec![stream.between(1.5, 4.0), stream.between(0.0, std::f64::consts::TAU)],
        _ => Vec::new(),
    }
}

/// Natural sizes; where a signal-to-noise ratio is asked for they are only a direction.
fn size(world: &World, kind: Kind, place: &Place, stream: &mut Stream) -> Vec<f64> {
    let duration = world.schedule.end_s;
    let mut motion = |shift: f64, turn: f64| -> Vec<f64> {
        (0..6).map(|axis| if axis < 3 { shift } else { turn } * stream.normal()).collect()
    };
    let per_angle = |parameter: usize| {
        let (_, symbol) = world.arm.parameters()[parameter];
        if matches!(symbol, "d" | "a" | "b") { 1.0 } else { 2.0 }
    };
    match kind {
        Kind::GearEccentricity => {
            let phase = stream.between(0.0, std::f64::consts::TAU);
            vec![4e-5 * libm::cos(phase), -4e-5 * libm::sin(phase)]
        }
        Kind::FrameDrift => motion(20e-6 / duration, 8e-6 / duration),
        Kind::FrameJump => motion(10e-6, 4e-6),
        Kind::ToolSlip => motion(10e-6, 80e-6),
        Kind::TargetShift => (0..3).map(|_| 10e-6 * stream.normal()).collect(),
        Kind::EncoderGain | Kind::JointCoupling => vec![stream.sign() * 3e-5],
        // A width is no direction: backlash, play and springs have one sign; early logs lag.
        Kind::Backlash => vec![3e-5],
        Kind::LostMotion => vec![3e-5],
        Kind::JointLogEarly => vec![2e-5],
        Kind::JointCompliance => vec![2e-8],
        Kind::ThermalGrowth => vec![stream.sign() * 1e-6 * per_angle(place.parameter.expect("a parameter"))],
        Kind::ThermalLag => vec![1.0],
        Kind::ThermalNonlinearity => vec![stream.sign() * 1e-7],
        Kind::UnsensedHeat => vec![stream.sign() * 2e-5],
        Kind::ScaleError => vec![stream.sign() * 5e-6],
        Kind::OffJointProduct | Kind::OffCrossWave | Kind::OffOverride => vec![stream.sign() * 3e-5],
        Kind::OffLinkBending => vec![2e-8],
        Kind::OffCubicDrift => vec![1e-5],
        Kind::OffScaleWalk => vec![2e-6],
        Kind::OffIncidence => vec![stream.sign() * 2e-5],
        Kind::TargetSwap
        | Kind::Outliers
        | Kind::SensorChill
        | Kind::SensorBias
        | Kind::SensorSwap
        | Kind::SensorDetached
        | Kind::ClockOffset => Vec::new(),
    }
}
