//! `thermokin plan poses`: the poses that identify an arm best.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::calibrate::{Observed, Request, Start, State, in_words, start};
use crate::cli::Failure;
use crate::cli::output::{JsonOption, write_whole};
use crate::cli::progress::Steps;
use crate::input::InputError;
use crate::model::{Geometry, Model};
use crate::plan::{Criterion, PlanError, Planned, Planner, Setup, Space, Spread, Visibility, Worth, in_order};
use crate::robot::{ParameterId, Posture, Robot, Target, shipped};
use crate::run::{self, Instrument, Run, format_postures};

/// What "best" means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum IndexName {
    /// The determinant: the smallest region of confidence for all parameters together
    D,
    /// The least mean variance of the parameters
    A,
    /// The worst known combination of parameters known best
    E,
    /// The least mean variance of predicted positions
    V,
}

/// The poses that identify an arm best, within limits and volume and seen by the tracker
#[derive(Debug, Args)]
pub struct Arguments {
    /// A robot.toml, the name of a shipped arm, or a model.json
    robot: PathBuf,
    /// How many poses
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    count: u32,
    /// What best means
    #[arg(long, value_enum, default_value = "d")]
    index: IndexName,
    /// Where the tracker stands in the world frame, m [default: the run's, or the world's origin]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    tracker: Option<String>,
    /// 1-sigma of a coordinate, m [default: the run's, or 1e-5]
    #[arg(long, value_name = "M")]
    sigma: Option<f64>,
    /// More of it per metre of distance [default: the run's, or 3e-6]
    #[arg(long, value_name = "M/M")]
    sigma_per_m: Option<f64>,
    /// 1-sigma of each joint from visit to visit, rad or m: the arm's repeatability
    #[arg(long, value_name = "RAD", default_value_t = 0.0)]
    joint_sigma: f64,
    /// Another window of a joint, rad or m, as 2=-0.5:1.2 [default: the run's, or the limits of robot.toml]
    #[arg(long = "joint", value_name = "N=LOW:HIGH")]
    joints: Vec<String>,
    /// The working volume: all targets stay in this box of the world frame, m [default: the run's, or anywhere]
    #[arg(long, value_name = "X0:X1,Y0:Y1,Z0:Z1", allow_hyphen_values = true)]
    volume: Option<String>,
    /// The least height above the base of everything beyond joint 1, m
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    lowest: Option<f64>,
    /// A target counts as seen within this angle about the flange's z, degrees [default: 60; a run's: as the run saw it]
    #[arg(long, value_name = "DEG")]
    facing: Option<f64>,
    /// How near a beam may come to a link's centre line, m [default: 0.15; a run's: no nearer than the run's beams]
    #[arg(long, value_name = "M")]
    clearance: Option<f64>,
    /// A target at this rough place on the flange, m, in place of the robot's own; given again for each
    #[arg(long = "target", value_name = "X,Y,Z", allow_hyphen_values = true)]
    targets: Vec<String>,
    /// Parameters that are not to be identified, as in a6,beta6
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    fix: Vec<ParameterId>,
    /// A measured run: window, volume, tracker and what it sees are taken from it, and its own poses are compared
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Choose among the run's own poses
    #[arg(long, requires = "run")]
    own: bool,
    /// How many poses to choose from
    #[arg(long, value_name = "N", default_value_t = 1500, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    candidates: u32,
    /// The seed of what is drawn
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Other numbers of poses to say the worth of [default: half, one and a half, two and three times N]
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    sizes: Vec<u32>,
    /// The table of poses to write, in the form of a run's poses.csv
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: JsonOption,
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        match error {
            PlanError::Nothing => Failure::Work(error.to_string()),
            _ => Failure::Usage(error.to_string()),
        }
    }
}

/// Poses that the worth of predictions is judged at.
const JUDGED: usize = 200;

/// The arm, where poses may be, and the poses of a run.
struct Ground {
    setup: Setup,
    space: Space,
    own: Vec<Vec<f64>>,
}

/// Numbers between separators; none where a part is no finite number or there are others than `N`.
fn numbers<const N: usize>(text: &str, separators: &[char]) -> Option<[f64; N]> {
    let all: Vec<f64> = text.split(separators).map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    <[f64; N]>::try_from(all).ok().filter(|all| all.iter().all(|value| value.is_finite()))
}

fn named(option: &str, text: &str, expected: &str) -> Failure {
    Failure::Usage(format!("--{option} {text}: expected {expected}"))
}

/// Carries the command out.
///
/// # Errors
/// Bad usage or input; no room for as many poses.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let criterion = match arguments.index {
        IndexName::D => Criterion::D,
        IndexName::A => Criterion::A,
        IndexName::E => Criterion::E,
        IndexName::V => Criterion::V,
    };
    let ground = arguments.ground()?;
    let Ground { setup, space, own } = &ground;
    let count = arguments.count as usize;
    let mut sizes: Vec<usize> = arguments.sizes.iter().map(|&size| size as usize).collect();
    if sizes.is_empty() {
        sizes = vec![count / 2, count + count / 2, 2 * count, 3 * count];
    }
    sizes.push(count);
    sizes.sort_unstable();
    sizes.dedup();
    let most = sizes.last().copied().unwrap_or(count);
    let steps = Steps::new(sizes.len() as u64, "planning");
    let pool = match arguments.own {
        true => own.clone(),
        false => space
            .draw(setup, own, (arguments.candidates as usize).max(2 * most), count.max(10), arguments.seed)
            .map_err(PlanError::from)?,
    };
    let judged = match own.is_empty() {
        false => spread(own, JUDGED),
        true => space.draw_judges(setup, JUDGED, arguments.seed).map_err(PlanError::from)?,
    };
    let planner = Planner::new(setup.clone(), pool, &judged, criterion)?;
    let movable = (!arguments.own).then_some(space);
    let mut table: Vec<(String, Worth)> = Vec::new();
    let mut wanted = None;
    for &size in &sizes {
        if size == count {
            let planned = planner.plan(size, movable, arguments.seed)?;
            table.push(("planned".to_owned(), planned.worth.clone()));
            wanted = Some(planned);
        } else if let Ok(planned) = planner.plan(size, movable, arguments.seed) {
            // A size that cannot be had is no row of the table.
            table.push(("planned".to_owned(), planned.worth));
        }
        steps.done();
    }
    let mut add = |name: &str, postures: &[Vec<f64>]| {
        table.extend(planner.worth(postures).map(|worth| (name.to_owned(), worth)));
    };
    if !own.is_empty() {
        add("own, evenly", &spread(own, count));
        if !arguments.own
            && let Ok(best) = planner.among(own.clone()).plan(count, None, arguments.seed)
        {
            add("own, best", &best.joints);
        }
        add("own, all", own);
    }
    drop(steps);
    let Some(planned) = wanted else { return Ok(()) };
    let joints = in_order(planned.joints.clone());
    if let Some(out) = &arguments.out {
        let bytes = format_postures(&joints).map_err(|error| Failure::Work(error.to_string()))?;
        write_whole(out, &bytes)?;
    }
    if arguments.json.leaves_words() {
        arguments.print(&ground, &planner, &planned, &joints, &table);
    }
    arguments.json.write(&json!({
        "format": 1, "command": "plan", "plan": "poses", "index": criterion.letter().to_string(), "seed": arguments.seed,
        "unknowns": planner.telling().names(),
        "unidentifiable": unidentifiable(&planner),
        "candidates": planner.pool().len(),
        "efficiency_at_least": planned.efficiency, "index_history": planned.history,
        "visibility": {
            "tracker": space.visibility.tracker.as_slice(),
            "axes": space.visibility.axes.iter().map(|axis| axis.as_slice().to_vec()).collect::<Vec<_>>(),
            "half_angles_rad": space.visibility.half_angles, "clearance_m": space.visibility.clearance_m,
        },
        "joints": space.joints, "volume": space.volume,
        "poses": joints,
        "table": table.iter().map(|(name, worth)| worth_json(name, worth)).collect::<Vec<_>>(),
    }))
}

fn worth_json(name: &str, worth: &Worth) -> Value {
    let spread = |spread: &Option<Spread>| {
        spread.as_ref().map(|own| json!({"median": own.median, "worst": own.worst, "worst_of": own.of}))
    };
    json!({
        "set": name, "poses": worth.poses, "index": worth.index,
        "lengths_sd_m": spread(&worth.lengths), "angles_sd_rad": spread(&worth.angles),
        "position_sd_m": {"median": worth.position[0], "worst": worth.position[1]},
    })
}

fn unidentifiable(planner: &Planner) -> Vec<String> {
    let telling = planner.telling();
    let campaign = telling.setup().campaign(&[]);
    let names = campaign.names();
    let values = &telling.setup().state.geometry.parameters;
    let held = telling.held.iter().map(|held| in_words(held, &names, values));
    let weak = telling
        .weak
        .iter()
        .map(|weak| format!("{} is told too weakly by any of these poses", names.name(weak.unknown)));
    held.chain(weak).collect()
}

/// `count` of some poses, evenly from first to last.
fn spread(poses: &[Vec<f64>], count: usize) -> Vec<Vec<f64>> {
    let count = count.min(poses.len());
    (0..count).map(|place| poses[place * poses.len() / count].clone()).collect()
}

impl Arguments {
    fn ground(&self) -> Result<Ground, Failure> {
        let extension = self.robot.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        let (robot, geometry) = match (extension, self.robot.to_str().and_then(shipped)) {
            (_, Some(robot)) => (robot, None),
            ("json", None) => {
                let model = Model::read(&self.robot)?;
                (model.robot, Some(model.reference))
            }
            ("toml", None) => (Robot::read(&self.robot)?, None),
            _ => {
                let names: Vec<&str> = crate::robot::SHIPPED.iter().map(|(name, _)| *name).collect();
                let message = "expected a robot.toml, a model.json, or one of";
                return Err(Failure::Usage(format!("{}: {message} {}", self.robot.display(), names.join(", "))));
            }
        };
        self.check_numbers()?;
        let measured = self.run.as_deref().map(run::read).transpose()?;
        let mut setup = self.setup(robot, geometry, measured.as_ref())?;
        setup.fixed = self.fixed(&setup.robot)?;
        let own = measured.as_ref().map(own_poses).unwrap_or_default();
        let mut space = match &measured {
            Some(run) => measured_space(&setup, run, &own)?,
            None => self.open_space(&setup),
        };
        self.narrow(&setup, &mut space)?;
        Ok(Ground { setup, space, own })
    }

    fn check_numbers(&self) -> Result<(), Failure> {
        let from_zero = [
            ("sigma", self.sigma),
            ("sigma-per-m", self.sigma_per_m),
            ("joint-sigma", Some(self.joint_sigma)),
            ("clearance", self.clearance),
        ];
        for (name, value) in from_zero {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value >= 0.0)) {
                return Err(named(name, &value.to_string(), "a number from 0"));
            }
        }
        if let Some(facing) = self.facing.filter(|facing| !(*facing > 0.0 && *facing <= 180.0)) {
            return Err(named("facing", &facing.to_string(), "degrees above 0, 180 at most"));
        }
        match self.lowest.filter(|lowest| !lowest.is_finite()) {
            Some(lowest) => Err(named("lowest", &lowest.to_string(), "metres")),
            None => Ok(()),
        }
    }

    fn fixed(&self, robot: &Robot) -> Result<Vec<usize>, Failure> {
        let chain = robot.chain();
        let place = |id: &ParameterId| {
            chain.place(*id).ok_or_else(|| Failure::Usage(format!("--fix {id}: the chain has no such parameter")))
        };
        self.fix.iter().map(place).collect()
    }

    fn setup(&self, mut robot: Robot, geometry: Option<Geometry>, run: Option<&Run>) -> Result<Setup, Failure> {
        if !self.targets.is_empty() {
            let places = self.targets.iter().map(|text| {
                numbers::<3>(text, &[','])
                    .ok_or_else(|| named("target", text, "three numbers of metres, as 0,0.1,0.05"))
            });
            let places: Vec<[f64; 3]> = places.collect::<Result<_, _>>()?;
            if run.is_some() {
                return Err(Failure::Usage(
                    "--target and --run: expected one of them, a run has its own targets".to_owned(),
                ));
            }
            robot.targets = (1..).zip(&places).map(|(n, _)| Target { name: format!("P{n}"), position: None }).collect();
            let parameters = geometry.map_or_else(|| robot.nominal(), |geometry| geometry.parameters);
            let targets = places.into_iter().map(Vector3::from).collect();
            let geometry = Geometry { parameters, targets, ..Geometry::nominal(&robot) };
            return Ok(self.setup_of(robot, geometry, None, None));
        }
        if let Some(run) = run {
            let Start { observed, nominal, .. } = start(&robot, run, &Request::default(), |_| true)?;
            let state = match geometry {
                Some(geometry) if geometry.targets.len() == nominal.geometry.targets.len() => geometry,
                _ => nominal.geometry,
            };
            let (robot, state, unknown) = seen_alone(observed, state);
            return Ok(self.setup_of(robot, state, Some(unknown), Some(&run.description.instrument)));
        }
        if robot.targets.is_empty()
            || (geometry.is_none() && robot.targets.iter().any(|target| target.position.is_none()))
        {
            let message = "the places of its targets are not known; expected --target X,Y,Z with a rough place, m";
            return Err(Failure::Usage(format!("{}: {message}", self.robot.display())));
        }
        let geometry = geometry.unwrap_or_else(|| Geometry::nominal(&robot));
        Ok(self.setup_of(robot, geometry, None, None))
    }

    fn setup_of(
        &self,
        robot: Robot,
        geometry: Geometry,
        unknown_targets: Option<Vec<usize>>,
        instrument: Option<&Instrument>,
    ) -> Setup {
        let unknown_targets = unknown_targets.unwrap_or_else(|| {
            (0..robot.targets.len()).filter(|&target| robot.targets[target].position.is_none()).collect()
        });
        let tracker = self.tracker.as_deref().and_then(|text| numbers::<3>(text, &[',']));
        Setup {
            state: State { geometry, growth: Vec::new() },
            unknown_targets,
            fixed: Vec::new(),
            instrument: Instrument {
                name: instrument.map_or_else(|| "tracker".to_owned(), |own| own.name.clone()),
                position: tracker.or(instrument.map(|own| own.position)).unwrap_or_default(),
                sigma_m: self.sigma.or(instrument.map(|own| own.sigma_m)).unwrap_or(1e-5),
                sigma_per_m: self.sigma_per_m.or(instrument.map(|own| own.sigma_per_m)).unwrap_or(3e-6),
                sigma_rad: None,
            },
            joint_sigma: self.joint_sigma,
            robot,
        }
    }

    fn open_space(&self, setup: &Setup) -> Space {
        let joints = setup.robot.transforms.iter().filter_map(|transform| transform.joint.as_ref());
        let window = |limit: Option<f64>, far: f64| limit.unwrap_or(far);
        let targets = setup.robot.targets.len();
        Space {
            joints: joints
                .map(|joint| [window(joint.min, f64::NEG_INFINITY), window(joint.max, f64::INFINITY)])
                .collect(),
            volume: None,
            lowest: None,
            visibility: Visibility {
                tracker: Vector3::from(setup.instrument.position),
                axes: vec![Vector3::z(); targets],
                half_angles: vec![60_f64.to_radians(); targets],
                clearance_m: 0.15,
            },
        }
    }

    /// Puts what was given by hand in place of defaults.
    fn narrow(&self, setup: &Setup, space: &mut Space) -> Result<(), Failure> {
        if let Some(text) = &self.tracker {
            let place = numbers::<3>(text, &[',']).ok_or_else(|| named("tracker", text, "three numbers of metres"))?;
            space.visibility.tracker = Vector3::from(place);
        }
        for text in &self.joints {
            let expected = "a joint, counted from 1, and its lowest and highest position, as 2=-0.5:1.2";
            let wrong = || named("joint", text, expected);
            let (joint, window) = text.split_once('=').ok_or_else(wrong)?;
            let place = joint.parse::<usize>().ok().and_then(|joint| joint.checked_sub(1)).ok_or_else(wrong)?;
            let [low, high] = numbers::<2>(window, &[':']).filter(|[low, high]| low <= high).ok_or_else(wrong)?;
            *space.joints.get_mut(place).ok_or_else(wrong)? = [low, high];
        }
        if let Some(joint) = space.joints.iter().position(|window| !window.iter().all(|end| end.is_finite())) {
            let number = joint + 1;
            let message =
                format!("joint {number} of {} has no limits; expected --joint {number}=LOW:HIGH", setup.robot.name);
            return Err(Failure::Usage(message));
        }
        if let Some(text) = &self.volume {
            let [x0, x1, y0, y1, z0, z1] = numbers::<6>(text, &[',', ':'])
                .filter(|ends| ends.chunks(2).all(|pair| pair[0] < pair[1]))
                .ok_or_else(|| named("volume", text, "three ranges of metres, as -1:1,0.5:2,0:1.5"))?;
            space.volume = Some([[x0, x1], [y0, y1], [z0, z1]]);
        }
        if let Some(lowest) = self.lowest {
            let gravity = setup.robot.gravity.norm();
            let up = if gravity > 0.0 { -setup.robot.gravity / gravity } else { Vector3::z() };
            space.lowest = Some((lowest, up));
        }
        if let Some(facing) = self.facing {
            space.visibility.axes.fill(Vector3::z());
            space.visibility.half_angles.fill(facing.to_radians());
        }
        if let Some(clearance) = self.clearance {
            space.visibility.clearance_m = clearance;
        }
        Ok(())
    }

    fn print(
        &self,
        ground: &Ground,
        planner: &Planner,
        planned: &Planned,
        joints: &[Vec<f64>],
        table: &[(String, Worth)],
    ) {
        let Ground { setup, space, .. } = ground;
        let seen = &space.visibility;
        let letter = planner.criterion().letter();
        println!(
            "{}: {} poses, best by {letter}, of {} unknowns",
            setup.robot.name,
            joints.len(),
            planner.telling().unknowns().len()
        );
        let angles: Vec<String> = seen.half_angles.iter().map(|angle| format!("{:.0}°", angle.to_degrees())).collect();
        println!(
            "  seen: the tracker at ({:.2}, {:.2}, {:.2}) m within {} of each target's axis, the beam {:.2} m off other links' \
             centre lines",
            seen.tracker.x,
            seen.tracker.y,
            seen.tracker.z,
            angles.join(", "),
            seen.clearance_m
        );
        println!("  collisions are not looked at: try the poses slowly first");
        unidentifiable(planner).iter().for_each(|words| println!("  note: {words}"));
        if let Some(efficiency) = planned.efficiency {
            println!(
                "  no {} of the {} poses to choose from have an index more than {:.3} times as large",
                joints.len(),
                planner.pool().len(),
                1.0 / efficiency
            );
        }
        println!("\n  poses                index   lengths, µm (SD)    angles, µrad (SD)   positions, µm (SD)");
        println!("                                median    worst      median    worst      median    worst");
        for (name, worth) in table {
            let pair = |own: &Option<Spread>| own.as_ref().map_or([f64::NAN; 2], |own| [own.median, own.worst]);
            let [[a, b], [c, d], [e, f]] = [pair(&worth.lengths), pair(&worth.angles), worth.position];
            println!(
                "  {:<5} {name:<12} {:8.3} {:9.2} {:8.2}   {:9.2} {:8.2}   {:9.2} {:8.2}",
                worth.poses,
                worth.index,
                a * 1e6,
                b * 1e6,
                c * 1e6,
                d * 1e6,
                e * 1e6,
                f * 1e6
            );
        }
        match &self.out {
            Some(out) => println!("\n  written to {}", out.display()),
            None => {
                println!("\n  joints, rad (m); --out FILE writes them as poses.csv");
                for joints in joints {
                    let own: Vec<String> = joints.iter().map(|joint| format!("{joint:9.4}")).collect();
                    println!("  {}", own.join(" "));
                }
            }
        }
    }
}

/// The arm with those targets alone that a run saw, and which of them have unknown places.
fn seen_alone(observed: Observed, geometry: Geometry) -> (Robot, Geometry, Vec<usize>) {
    let seen = observed.campaign.seen_targets();
    let kept: Vec<usize> = (0..seen.len()).filter(|&target| seen[target]).collect();
    let mut robot = observed.robot;
    robot.targets = kept.iter().map(|&target| robot.targets[target].clone()).collect();
    let geometry = Geometry {
        targets: kept.iter().map(|&target| geometry.targets[target]).collect(),
        turns: kept.iter().map(|&target| geometry.turns[target]).collect(),
        ..geometry
    };
    let unknown = (0..kept.len()).filter(|&place| observed.unknown_targets.contains(&kept[place])).collect();
    (robot, geometry, unknown)
}

/// Every posture of a run once, in the order of its visits.
fn own_poses(run: &Run) -> Vec<Vec<f64>> {
    let mut met = std::collections::HashSet::new();
    run.visits
        .iter()
        .filter(|visit| !visit.points.is_empty() && met.insert(visit.pose))
        .map(|visit| visit.joints.clone())
        .collect()
}

/// Where a run measured, and what its tracker saw: the cone about each target's mean direction to the tracker that holds all
/// of its poses, and beams no nearer to links than the run's.
fn measured_space(setup: &Setup, run: &Run, own: &[Vec<f64>]) -> Result<Space, Failure> {
    const WIDEST_CLEARANCE: f64 = 0.15;
    let arm = setup.prepared();
    let tracker = Vector3::from(setup.instrument.position);
    let targets = &setup.state.geometry.targets;
    let joint_count = setup.robot.joint_count();
    let ends = |joint: usize| {
        let all = own.iter().map(|joints| joints[joint]);
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    };
    let places: Vec<Vector3<f64>> =
        run.visits.iter().flat_map(|visit| visit.points.iter().map(|point| point.position)).collect();
    if places.is_empty() || own.iter().any(|joints| joints.len() != joint_count) {
        let file = run.folder.join("points.csv");
        return Err(InputError::of_file(&file, "has no position, expected some of the arm's targets").into());
    }
    let range = |axis: usize| {
        let all = places.iter().map(|place| place[axis]);
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    };
    let flanges: Vec<_> = own.iter().map(|joints| arm.frames(&Posture::new(joints))).collect();
    let axes: Vec<Vector3<f64>> = targets
        .iter()
        .map(|target| {
            let towards = flanges.iter().filter_map(|frames| {
                let flange = frames.last()?;
                flange.rotation.tr_mul(&(tracker - flange.point(target))).try_normalize(0.0)
            });
            towards.sum::<Vector3<f64>>().try_normalize(0.0).unwrap_or_else(Vector3::z)
        })
        .collect();
    let mut visibility =
        Visibility { tracker, half_angles: vec![0.0; axes.len()], axes, clearance_m: WIDEST_CLEARANCE };
    for frames in &flanges {
        let Some(flange) = frames.last() else { continue };
        for (target, place) in targets.iter().enumerate() {
            let angle = visibility.angle(flange, target, place);
            visibility.half_angles[target] = visibility.half_angles[target].max(angle);
            let nearest = visibility.nearest_link(frames, &flange.point(place));
            visibility.clearance_m = visibility.clearance_m.min(nearest);
        }
    }
    Ok(Space {
        joints: (0..joint_count).map(ends).collect(),
        volume: Some([range(0), range(1), range(2)]),
        lowest: None,
        visibility,
    })
}
