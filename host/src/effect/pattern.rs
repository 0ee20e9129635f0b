//! Patterns that no effect of the catalogue makes: what is significant and unexplained is described by the covariates that it
//! follows.
//!
//! A pattern competes with the catalogue in the search, with a handicap: without it, whatever hides outside the catalogue
//! would be given the name of what resembles it most.

use super::{Acts, Effect, Form, Given, InstanceError, Named, Scene, Site, Term, Values};

/// A product of covariates acting on a joint, a parameter or the base. It has no name in the catalogue.
pub struct Pattern;

/// What a shape's first number says; the others are indices or harmonics.
mod kind {
    /// Product of the angles of two joints.
    pub const ANGLES: f64 = 0.0;
    /// A joint's angle times a link's mean rise.
    pub const ANGLE_RISE: f64 = 1.0;
    /// A joint's angle times time.
    pub const ANGLE_TIME: f64 = 2.0;
    /// Sine of the sum of two angles.
    pub const SINE_SUM: f64 = 3.0;
    /// Cosine of the sum of two angles.
    pub const COSINE_SUM: f64 = 4.0;
    /// Sine of the difference of two angles.
    pub const SINE_DIFFERENCE: f64 = 5.0;
    /// Cosine of the difference of two angles.
    pub const COSINE_DIFFERENCE: f64 = 6.0;
    /// The joint's gravity torque times a link's mean rise.
    pub const TORQUE_RISE: f64 = 7.0;
    /// The joint's gravity torque squared.
    pub const TORQUE_SQUARED: f64 = 8.0;
    /// The joint's direction times its angle.
    pub const DIRECTION_ANGLE: f64 = 9.0;
    /// The joint's direction times a link's mean rise.
    pub const DIRECTION_RISE: f64 = 10.0;
    /// A joint's angle cubed.
    pub const ANGLE_CUBED: f64 = 11.0;
    /// The direction of another joint.
    pub const DIRECTION: f64 = 12.0;
    /// The torque of another joint.
    pub const TORQUE: f64 = 13.0;
    /// Legendre's polynomial of time, by its degree.
    pub const TIME: f64 = 14.0;
    /// The air's temperature.
    pub const AIR: f64 = 15.0;
    /// A wave in time, periods a run; with its quarter.
    pub const WAVE: f64 = 16.0;
    /// Another joint's angle, waves a turn: cosine and sine.
    pub const WAVE_OF: f64 = 17.0;
    /// The joint's direction times the speed override before the visit.
    pub const DIRECTION_SPEED: f64 = 18.0;
    /// The instrument's scale by Legendre's polynomial of time.
    pub const SCALE_TIME: f64 = 19.0;
    /// The instrument's scale by a wave in time; with its quarter.
    pub const SCALE_WAVE: f64 = 20.0;
}

/// Most waves a turn of another joint that are tried.
const MOST_WAVES: usize = 6;

fn span(scene: &Scene) -> f64 {
    let (first, last) = scene.span_s();
    (last - first).max(1.0)
}

/// A link's mean rise at every visit.
fn rise(scene: &Scene, link: f64) -> Vec<f64> {
    let sensors = scene.sensors_of(link as usize);
    scene.by_visit(|visit| sensors.iter().map(|&sensor| visit.rises[sensor]).sum::<f64>() / sensors.len().max(1) as f64)
}

fn times(a: Vec<f64>, b: Vec<f64>) -> Vec<f64> {
    a.into_iter().zip(b).map(|(a, b)| a * b).collect()
}

fn amounts(scene: &Scene, joint: usize, shape: &[f64]) -> Vec<f64> {
    // A model file may name any joint.
    let of = |place: usize| (shape[place] as usize).min(scene.chain.joint_count().saturating_sub(1));
    let angle = |joint: usize| scene.by_visit(|visit| visit.joints[joint]);
    let two = |f: &dyn Fn(f64, f64) -> f64| scene.by_visit(|visit| f(visit.joints[of(1)], visit.joints[of(2)]));
    match shape[0] {
        kind::ANGLES => two(&|a, b| a * b),
        kind::ANGLE_RISE => times(angle(of(1)), rise(scene, shape[2])),
        kind::ANGLE_TIME => {
            let span = span(scene);
            times(angle(of(1)), scene.by_visit(|visit| (visit.time_s - scene.origin_s) / span))
        }
        kind::SINE_SUM => two(&|a, b| libm::sin(a + b)),
        kind::COSINE_SUM => two(&|a, b| libm::cos(a + b)),
        kind::SINE_DIFFERENCE => two(&|a, b| libm::sin(a - b)),
        kind::COSINE_DIFFERENCE => two(&|a, b| libm::cos(a - b)),
        kind::TORQUE_RISE => times(scene.by_visit(|visit| visit.torques[joint]), rise(scene, shape[2])),
        kind::TORQUE_SQUARED => scene.by_visit(|visit| visit.torques[joint].powi(2)),
        kind::DIRECTION_ANGLE => scene.by_visit(|visit| visit.approach[joint] * visit.joints[joint]),
        kind::DIRECTION_RISE => times(scene.by_visit(|visit| visit.approach[joint]), rise(scene, shape[2])),
        kind::ANGLE_CUBED => scene.by_visit(|visit| visit.joints[of(1)].powi(3)),
        kind::DIRECTION => scene.by_visit(|visit| visit.approach[of(1)]),
        kind::DIRECTION_SPEED => {
            let speeds = scene.by_visit(|visit| override_before(scene, visit.time_s));
            times(scene.by_visit(|visit| visit.approach[joint]), speeds)
        }
        kind::TORQUE => scene.by_visit(|visit| visit.torques[of(1)]),
        _ => in_time(scene, shape),
    }
}

/// The speed override of the last movement before a time.
fn override_before(scene: &Scene, time_s: f64) -> f64 {
    let moved = |step: &&crate::run::MotionStep| step.phase == crate::run::Phase::Move && step.start_s < time_s;
    scene.motion.iter().rfind(moved).map_or(0.0, |step| step.speed_override)
}

/// What depends on time alone, without or with a quarter of a wave's shift.
fn in_time(scene: &Scene, shape: &[f64]) -> Vec<f64> {
    let span = span(scene);
    let share = |time: f64| (time - scene.origin_s) / span;
    match shape[0] {
        // Legendre's polynomials: each is what the ones before it cannot make.
        kind::TIME | kind::SCALE_TIME => scene.by_visit(|visit| {
            let x = 2.0 * share(visit.time_s) - 1.0;
            match shape[1] as u32 {
                0 | 1 => x,
                2 => 1.5 * x * x - 0.5,
                3 => 2.5 * x * x * x - 1.5 * x,
                _ => (35.0 * x.powi(4) - 30.0 * x * x + 3.0) / 8.0,
            }
        }),
        kind::AIR => scene.air_rises().unwrap_or_else(|| vec![0.0; scene.visits.len()]),
        _ => scene.by_visit(|visit| {
            let phase = std::f64::consts::TAU * (shape[1] * share(visit.time_s) + 0.25 * shape[2]);
            libm::sin(phase)
        }),
    }
}

impl Effect for Pattern {
    fn name(&self) -> &'static str {
        super::UNEXPLAINED
    }

    fn sites(&self, scene: &Scene) -> Vec<Site> {
        let mut sites: Vec<Site> = (0..scene.chain.joint_count()).map(Site::joint).collect();
        if scene.cycles().len() >= 6 {
            let parameters = scene.chain.parameters().iter().enumerate();
            sites.extend(parameters.filter(|(_, id)| id.transform > 0).map(|(place, _)| Site::parameter(place)));
            sites.push(Site::whole());
        }
        sites
    }

    fn shapes(&self, scene: &Scene, site: &Site) -> Vec<Vec<f64>> {
        let joints = scene.chain.joint_count();
        let links = scene.sensed_links();
        let mut shapes = Vec::new();
        let in_time = || {
            let mut shapes: Vec<Vec<f64>> =
                [1.0, 2.0, 3.0, 4.0].iter().map(|&power| vec![kind::TIME, power, 0.0]).collect();
            if scene.air.is_some() {
                shapes.push(vec![kind::AIR, 0.0, 0.0]);
            }
            for periods in 1..=3 {
                shapes.extend([0.0, 1.0].map(|quarter| vec![kind::WAVE, f64::from(periods), quarter]));
            }
            shapes
        };
        let Some(joint) = site.joint else {
            let mut shapes = in_time();
            match site.parameter {
                // What a load does to a link about an axis that is no joint's.
                Some(_) if scene.masses_known => {
                    shapes.extend((0..joints).map(|joint| vec![kind::TORQUE, joint as f64, 0.0]));
                }
                Some(_) => {}
                None => {
                    // A straight line of the base in time is a drift, and has its name.
                    shapes.retain(|shape| *shape != [kind::TIME, 1.0, 0.0]);
                    shapes.extend((1..=4).map(|power| vec![kind::SCALE_TIME, f64::from(power), 0.0]));
                    for periods in 1..=3 {
                        shapes.extend([0.0, 1.0].map(|quarter| vec![kind::SCALE_WAVE, f64::from(periods), quarter]));
                    }
                }
            }
            return shapes;
        };
        for a in 0..joints {
            for b in a..joints {
                let mut push = |kind: f64| shapes.push(vec![kind, a as f64, b as f64]);
                push(kind::ANGLES);
                push(kind::SINE_SUM);
                push(kind::COSINE_SUM);
                if a != b {
                    push(kind::SINE_DIFFERENCE);
                    push(kind::COSINE_DIFFERENCE);
                }
            }
            shapes.push(vec![kind::ANGLE_TIME, a as f64, 0.0]);
            shapes.push(vec![kind::ANGLE_CUBED, a as f64, 0.0]);
            shapes.extend(links.iter().map(|&link| vec![kind::ANGLE_RISE, a as f64, link as f64]));
            if a != joint {
                shapes.push(vec![kind::DIRECTION, a as f64, 0.0]);
                if scene.revolute[a] {
                    shapes.extend((1..=MOST_WAVES).map(|waves| vec![kind::WAVE_OF, a as f64, waves as f64]));
                }
                if scene.masses_known {
                    shapes.push(vec![kind::TORQUE, a as f64, 0.0]);
                }
            }
        }
        // A wave of the joint's own angle is a gear's.
        shapes.retain(|shape| {
            let own = shape[1] == joint as f64 && shape[2] == joint as f64;
            !(own && (shape[0] == kind::SINE_SUM || shape[0] == kind::COSINE_SUM))
        });
        if scene.masses_known {
            shapes.push(vec![kind::TORQUE_SQUARED, 0.0, 0.0]);
            shapes.extend(links.iter().map(|&link| vec![kind::TORQUE_RISE, 0.0, link as f64]));
        }
        shapes.push(vec![kind::DIRECTION_ANGLE, 0.0, 0.0]);
        let mut speeds: Vec<f64> = scene.by_visit(|visit| override_before(scene, visit.time_s));
        speeds.dedup();
        if speeds.len() > 2 {
            shapes.push(vec![kind::DIRECTION_SPEED, 0.0, 0.0]);
        }
        shapes.extend(links.iter().map(|&link| vec![kind::DIRECTION_RISE, 0.0, link as f64]));
        shapes
    }

    /// Each kind of covariate is a family.
    fn family(&self, shape: &[f64]) -> u8 {
        shape[0] as u8
    }

    fn terms(&self, scene: &Scene, site: &Site, shape: &[f64]) -> Vec<Term> {
        match (site.joint, site.parameter) {
            (Some(joint), _) if shape[0] == kind::WAVE_OF => {
                let other = (shape[1] as usize).min(scene.chain.joint_count().saturating_sub(1));
                let wave = |of: fn(f64) -> f64| {
                    vec![Acts::Joint(joint, scene.by_visit(|visit| of(shape[2] * visit.joints[other])))]
                };
                vec![wave(libm::cos), wave(libm::sin)]
            }
            (Some(joint), _) => vec![vec![Acts::Joint(joint, amounts(scene, joint, shape))]],
            (None, Some(place)) if shape[0] == kind::TORQUE => {
                vec![vec![Acts::Parameter(place, amounts(scene, 0, shape))]]
            }
            (None, Some(place)) => vec![vec![Acts::Parameter(place, in_time(scene, shape))]],
            (None, None) if [kind::SCALE_TIME, kind::SCALE_WAVE].contains(&shape[0]) => {
                vec![vec![Acts::Scale(in_time(scene, shape))]]
            }
            (None, None) => {
                let amounts = in_time(scene, shape);
                (0..6).map(|axis| vec![Acts::World(axis, amounts.clone())]).collect()
            }
        }
    }

    fn parameters(&self, _: &Site, _: &[f64], coefficients: &[f64]) -> Vec<Named> {
        (1..).zip(coefficients).map(|(n, value)| Named::new(format!("coefficient_{n}"), *value)).collect()
    }

    fn form(&self, site: &Site) -> Form {
        let form = Form::whole().shape(3..=3);
        match (site.joint, site.parameter) {
            (Some(_), _) => form.joint().coefficients(1..=2),
            (None, Some(_)) => form.parameter(),
            (None, None) => form.coefficients(1..=6),
        }
    }

    fn values(&self, _: &Scene, _: &Site, _: &mut Given) -> Result<Values, InstanceError> {
        Err(InstanceError::OfModelsAlone(self.name()))
    }

    fn is_of_run_with(&self, shape: &[f64]) -> bool {
        [kind::TIME, kind::WAVE, kind::ANGLE_TIME, kind::SCALE_TIME, kind::SCALE_WAVE].contains(&shape[0])
    }

    fn lacks(&self, scene: &Scene, _: &Site, shape: &[f64]) -> Option<&'static str> {
        let rises = [kind::ANGLE_RISE, kind::TORQUE_RISE, kind::DIRECTION_RISE].contains(&shape[0]);
        if rises && scene.sensors_of(shape[2] as usize).is_empty() {
            return Some("the sensors that it follows");
        }
        (shape[0] == kind::AIR && scene.air.is_none()).then_some("a sensor of the air")
    }
}

/// The covariates that a pattern follows, in words.
pub fn follows(scene: &Scene, site: &Site, shape: &[f64]) -> Vec<String> {
    let angle = |place: usize| format!("angle of joint {}", shape[place] as usize + 1);
    let rise = format!("temperature of link {}", shape[2] as usize);
    let own = |what: &str| format!("{what} of joint {}", site.joint.map_or(0, |joint| joint + 1));
    let mut words = match shape[0] {
        kind::ANGLES if shape[1] == shape[2] => vec![format!("{} squared", angle(1))],
        kind::ANGLES => vec![angle(1), angle(2)],
        kind::ANGLE_RISE => vec![angle(1), rise],
        kind::ANGLE_TIME => vec![angle(1), "time".to_owned()],
        kind::SINE_SUM | kind::COSINE_SUM => vec![format!("{} plus {}", angle(1), angle(2))],
        kind::SINE_DIFFERENCE | kind::COSINE_DIFFERENCE => vec![format!("{} less {}", angle(1), angle(2))],
        kind::TORQUE_RISE => vec![own("gravity torque"), rise],
        kind::TORQUE_SQUARED => vec![format!("{} squared", own("gravity torque"))],
        kind::DIRECTION_ANGLE => vec![own("direction of approach"), own("angle")],
        kind::DIRECTION_RISE => vec![own("direction of approach"), rise],
        kind::ANGLE_CUBED => vec![format!("{} cubed", angle(1))],
        kind::DIRECTION => vec![format!("direction of approach of joint {}", shape[1] as usize + 1)],
        kind::TORQUE => vec![format!("gravity torque about joint {}", shape[1] as usize + 1)],
        kind::WAVE_OF => vec![format!("{} waves a turn of the {}", shape[2], angle(1))],
        kind::DIRECTION_SPEED => vec![own("direction of approach"), "speed of the movement before".to_owned()],
        kind::TIME | kind::SCALE_TIME if shape[1] == 1.0 => vec!["time".to_owned()],
        kind::TIME | kind::SCALE_TIME => vec![format!("time to the power of {}", shape[1])],
        kind::AIR => vec!["temperature of the air".to_owned()],
        _ => vec![format!("time, {} waves a run", shape[1])],
    };
    words.push(match (site.joint, site.parameter) {
        (Some(joint), _) => format!("as an error of joint {}", joint + 1),
        (None, Some(place)) => format!("as a change of {}", scene.chain.parameters()[place]),
        (None, None) if [kind::SCALE_TIME, kind::SCALE_WAVE].contains(&shape[0]) => {
            "as the instrument's scale".to_owned()
        }
        (None, None) => "as a motion between instrument and base".to_owned(),
    });
    words
}
