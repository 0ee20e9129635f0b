//! `thermokin plan`: the exchange never makes a set worse and finds the best one where all can be tried; planned poses beat
//! random ones and a grid, as predicted and in simulated calibrations; no pose leaves limits, volume or the tracker's sight;
//! sensors are those that trying all sets finds; probes tell links apart; bad input is refused.

mod calibrate_twin;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use calibrate_twin::{Dice, SIGMA, Strata, Twin};
use nalgebra::{DMatrix, DVector, Vector3};
use thermokin::calibrate::{Campaign, Manner, Problem, State, Unknown, identify};
use thermokin::model::{CorrectionBounds, Geometry, Growth, Level, Model, ReferenceTemperature};
use thermokin::plan::{
    Criterion, Index, PlanError, Planner, Search, SensorError, SensorStudy, Setup, Space, Telling, Visibility,
    exchange, prepared, probes, schedule_of, tell_apart,
};
use thermokin::robot::{Posture, Robot, shipped};
use thermokin::run::Instrument;
use thermokin::simulate::Scenario;

const CRITERIA: [Criterion; 4] = [Criterion::D, Criterion::A, Criterion::E, Criterion::V];

fn comau() -> Robot {
    shipped("comau-nj-130-2.0").expect("shipped")
}

fn setup(robot: Robot, fixed: Vec<usize>) -> Setup {
    Setup {
        state: State { geometry: Geometry::nominal(&robot), growth: Vec::new() },
        robot,
        unknown_targets: Vec::new(),
        fixed,
        instrument: Instrument {
            name: "tracker".to_owned(),
            position: [0.0; 3],
            sigma_m: SIGMA,
            sigma_per_m: 0.0,
            sigma_rad: None,
        },
        joint_sigma: 0.0,
    }
}

/// The window of the shipped scenarios, before a tracker at the world's origin.
fn space() -> Space {
    Space {
        joints: vec![[-0.9, 0.9], [-0.25, 0.9], [-0.7, 0.3], [-1.7, 1.7], [0.0, 1.6], [-2.1, 2.1]],
        volume: Some([[-1.6, 1.6], [-1.5, 2.5], [-1.5, 3.0]]),
        lowest: None,
        visibility: Visibility {
            tracker: Vector3::zeros(),
            axes: vec![Vector3::z(); 4],
            half_angles: vec![1.3; 4],
            clearance_m: 0.1,
        },
    }
}

fn thermokin(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thermokin")).current_dir(folder).args(arguments).output().expect("runs")
}

#[test]
fn an_exchange_never_lowers_the_index() {
    let space = space();
    let setup = setup(comau(), Vec::new());
    let pool = space.draw(&setup, &[], 120, 120, 3).expect("room enough");
    let telling = Telling::new(setup.clone(), &pool);
    let rows = telling.rows(&pool);
    // Known targets: a pose holds six rows, however many targets there are.
    assert!(rows.iter().all(|own| own.nrows() == 6));
    for criterion in CRITERIA {
        let index = Index::new(criterion, telling.unknowns().len(), &telling.positions(&pool[..40]));
        let found = exchange(&index, &rows, (0..10).collect(), &Search::default()).expect("60 rows of 30 unknowns");
        assert!(found.history.len() > 3, "{criterion:?}: nothing was exchanged");
        for pair in found.history.windows(2) {
            assert!(pair[1] > pair[0], "{criterion:?}: {} after {}", pair[1], pair[0]);
        }
        let own = index.of(found.members.iter().map(|&member| &rows[member])).expect("a set");
        assert!((index.index(&own) - found.history.last().expect("a start")).abs() < 1e-9 * index.index(&own));
        let planned = Planner::new(setup.clone(), pool.clone(), &pool[..40], criterion)
            .expect("tells the arm")
            .plan(10, Some(&space), 1)
            .expect("a plan");
        assert!(planned.history.windows(2).all(|pair| pair[1] >= pair[0]), "{criterion:?}: {:?}", planned.history);
    }
}

#[test]
fn where_all_sets_can_be_tried_the_best_is_found() {
    let robot = comau();
    let chain = robot.chain();
    let free = ["a1", "a2", "beta2", "d4", "theta3", "theta5", "alpha4", "a3"];
    let fixed =
        (0..chain.parameters().len()).filter(|&place| !free.contains(&chain.parameters()[place].to_string().as_str()));
    let setup = setup(robot.clone(), fixed.collect());
    let pool = space().draw(&setup, &[], 14, 14, 5).expect("room enough");
    for criterion in CRITERIA {
        let planner = Planner::new(setup.clone(), pool.clone(), &pool, criterion).expect("tells");
        assert_eq!(planner.telling().unknowns().len(), free.len());
        let rows = planner.telling().rows(&pool);
        let index = Index::new(criterion, free.len(), &planner.telling().positions(&pool));
        let mut best = (0.0, vec![]);
        for i in 0..14 {
            for j in i + 1..14 {
                for k in j + 1..14 {
                    let own = index.of([i, j, k].iter().map(|&pose| &rows[pose]));
                    let value = own.map_or(0.0, |own| index.index(&own));
                    if value > best.0 {
                        best = (value, vec![i, j, k]);
                    }
                }
            }
        }
        let planned = planner.plan(3, None, 1).expect("a plan");
        assert_eq!(planned.members, Some(best.1), "{criterion:?}");
        // The bound on what any set could reach holds for the best one.
        if let Some(efficiency) = planned.efficiency {
            assert!(efficiency > 0.0 && efficiency <= 1.0);
        }
    }
}

/// Fifteen of the corners, edges and middles of the window: every joint at three levels, as a person would space them.
fn grid(space: &Space) -> Vec<Vec<f64>> {
    (0..15_usize)
        .map(|pose| {
            let level = |joint: usize| {
                [
                    pose % 3,
                    pose / 3 % 3,
                    (pose + pose / 3) % 3,
                    (pose + 2 * (pose / 3)) % 3,
                    (pose / 9 + pose) % 3,
                    (2 * pose + pose / 9) % 3,
                ][joint]
            };
            (0..6)
                .map(|joint| {
                    let [low, high] = space.joints[joint];
                    low + (high - low) * (0.1 + 0.4 * level(joint) as f64)
                })
                .collect()
        })
        .collect()
}

#[test]
fn planned_poses_beat_random_ones_and_a_grid_as_predicted_and_in_simulated_calibrations() {
    let mut dice = Dice::new("planned poses beat random ones");
    let space = space();
    let setup = setup(comau(), Vec::new());
    let pool = space.draw(&setup, &[], 300, 300, 3).expect("room enough");
    let judged = space.draw_judges(&setup, 60, 9).expect("room enough");
    let planner = Planner::new(setup.clone(), pool.clone(), &judged, Criterion::D).expect("tells");
    let planned = planner.plan(15, Some(&space), 1).expect("a plan");
    let mut sets = vec![("planned", planned.joints.clone()), ("grid", grid(&space))];
    for number in 0..3 {
        let first = (dice.between(0.0, 280.0)) as usize;
        sets.push((["random 1", "random 2", "random 3"][number], pool[first..first + 15].to_vec()));
    }
    let positions = planner.telling().positions(&judged);
    let mut results = Vec::new();
    for (name, postures) in &sets {
        let worth = planner.worth(postures).unwrap_or_else(|| panic!("{name} does not tell the arm"));
        // Calibrations of arms that differ, each with noise of its own.
        const DRAWS: usize = 30;
        let rows = planner.telling().rows(postures);
        let information = rows.iter().fold(DMatrix::zeros(30, 30), |sum, own| sum + own.tr_mul(own));
        let (mut squares, mut normalised) = (0.0, 0.0);
        for _ in 0..DRAWS {
            let mut twin = Twin::new(comau(), &mut dice);
            // Close to where the plan is made: then what is left of it is noise alone.
            for (value, nominal) in twin.truth.geometry.parameters.iter_mut().zip(&twin.nominal.geometry.parameters) {
                *value = nominal + 0.02 * (*value - nominal);
            }
            let campaign = twin.cold(postures, Strata { point: SIGMA, ..Strata::default() }, &mut dice);
            let found =
                identify(&campaign, planner.telling().unknowns().to_vec(), twin.nominal.clone(), &Manner::default());
            assert!(found.solution.stop.converged() && found.weak.is_empty());
            let error =
                DVector::from_iterator(
                    30,
                    planner.telling().unknowns().iter().zip(planner.telling().scale()).map(|(&unknown, scale)| {
                        (found.solution.state.value(unknown) - twin.truth.value(unknown)) / scale
                    }),
                );
            normalised += error.dot(&(&information * &error));
            squares += positions.iter().map(|own| (own * &error).norm_squared()).sum::<f64>();
        }
        let measured = (squares / (DRAWS * positions.len() * 4) as f64).sqrt();
        println!(
            "{name}: index {:.3}, positions predicted {:.2} µm (median), {:.2} µm rms measured",
            worth.index,
            worth.position[0] * 1e6,
            measured * 1e6
        );
        // χ² of 30 a draw; five deviations, and what second order adds.
        let freedom = (30 * DRAWS) as f64;
        assert!((normalised - freedom).abs() < 5.0 * (2.0 * freedom).sqrt() + 0.02 * freedom, "{name}: {normalised}");
        results.push((*name, worth, measured));
    }
    let (_, best, measured) = &results[0];
    for (name, worth, other) in &results[1..] {
        assert!(worth.index < best.index, "{name} has the larger index");
        for (one, other) in [(&best.lengths, &worth.lengths), (&best.angles, &worth.angles)] {
            let (one, other) = (one.as_ref().expect("some"), other.as_ref().expect("some"));
            assert!(one.median < other.median, "{name}: {one:?} {other:?}");
        }
        assert!(best.position[0] < worth.position[0] && measured < other, "{name}: {measured} {other}");
    }
}

#[test]
fn no_planned_pose_leaves_limits_volume_or_sight() {
    let space = space();
    let setup = setup(comau(), Vec::new());
    let pool = space.draw(&setup, &[], 200, 200, 11).expect("room enough");
    let judged = space.draw_judges(&setup, 10, 11).expect("room enough");
    let planner = Planner::new(setup.clone(), pool.clone(), &judged, Criterion::V).expect("tells");
    let planned = planner.plan(12, Some(&space), 4).expect("a plan");
    assert!(planned.joints.iter().any(|pose| !pool.contains(pose)), "no pose was moved");
    let robot = comau();
    let arm = robot.chain().prepare(&robot.nominal());
    for joints in &planned.joints {
        for (joint, [low, high]) in joints.iter().zip(&space.joints) {
            assert!((*low..=*high).contains(joint));
        }
        let flange = arm.flange(&Posture::new(joints));
        for target in &robot.targets {
            let place = flange.point(&target.position.expect("known"));
            let volume = space.volume.expect("given");
            assert!((0..3).all(|axis| volume[axis][0] <= place[axis] && place[axis] <= volume[axis][1]), "{place}");
            // The cosine of the angle to the tracker, which stands at the origin.
            let cosine = flange.rotation.column(2).dot(&-place) / place.norm();
            assert!(cosine >= 1.3_f64.cos() - 1e-12, "averted: {cosine}");
        }
    }
    // A narrower cone leaves fewer poses, and none that a wider one would refuse.
    let mut narrow = space.clone();
    narrow.visibility.half_angles = vec![0.3; 4];
    let targets = &setup.state.geometry.targets;
    let admitted = pool.iter().filter(|joints| narrow.admits(&arm, targets, joints).is_ok()).count();
    assert!(admitted < pool.len());
    narrow.volume = Some([[50.0, 51.0]; 3]);
    let error = narrow.draw(&setup, &[], 5, 5, 1).expect_err("nothing is there");
    assert_eq!((error.found, error.outside), (0, error.drawn));
}

#[test]
fn too_few_poses_are_refused_with_how_many_would_do() {
    let space = space();
    let setup = setup(comau(), Vec::new());
    let pool = space.draw(&setup, &[], 40, 40, 3).expect("room enough");
    let planner = Planner::new(setup, pool.clone(), &pool, Criterion::D).expect("tells");
    let error = planner.plan(4, None, 1).expect_err("24 rows of 30 unknowns");
    assert_eq!(error, PlanError::TooFew { count: 4, unknowns: 30, least: 5 });
    assert_eq!(planner.plan(41, None, 1), Err(PlanError::SmallPool { count: 41, pool: 40 }));
}

/// A model that grows with all of five sensors, of which two say nearly the same and one nearly nothing.
fn grown(dice: &mut Dice) -> (Model, Campaign, State) {
    let mut twin = Twin::new(comau(), dice);
    let names = ["S0", "S1", "S2", "S3", "S4"];
    let coefficients =
        [("d1", 0, -6e-6), ("a1", 1, 7e-6), ("a2", 2, 1.5e-5), ("beta2", 3, 1e-5), ("d4", 1, -8e-6), ("a2", 4, 1e-7)];
    for name in names {
        twin.sensor(name);
    }
    for (parameter, sensor, coefficient) in coefficients {
        twin.grows(parameter, names[sensor], coefficient);
    }
    let rises: Vec<Vec<f64>> = (0..12)
        .map(|cycle| {
            let t = f64::from(cycle) / 3.0;
            let (fast, slow) = (15.0 * (1.0 - (-t).exp()), 6.0 * (1.0 - (-0.4 * t).exp()));
            vec![slow, fast, fast + 0.1 * slow + 0.05 * dice.normal(), 0.5 * fast + slow, 0.3 * dice.normal()]
        })
        .collect();
    let postures = twin.postures(6, 0.7, dice);
    let campaign = twin.visit(&postures, &rises, Strata::default(), dice);
    let reference = Geometry { ..twin.truth.geometry.clone() };
    let model = Model {
        nominal: twin.nominal.geometry.clone(),
        geometric: reference.clone(),
        reference: reference.clone(),
        growth: coefficients
            .iter()
            .map(|&(parameter, sensor, coefficient)| Growth {
                parameter: parameter.parse().expect("a parameter"),
                sensor: names[sensor].to_owned(),
                coefficient,
                sigma: 1e-7,
            })
            .collect(),
        temperatures: names
            .iter()
            .map(|name| ReferenceTemperature { sensor: (*name).to_owned(), celsius: 20.0, lowest: 20.0, highest: 45.0 })
            .collect(),
        anchors: Vec::new(),
        estimates: Vec::new(),
        correction_bounds: CorrectionBounds::default(),
        extended: None,
        robot: twin.robot.clone(),
    };
    (model, campaign, State { geometry: reference, growth: Vec::new() })
}

/// A visit's cycle, what parameters do to its targets, the sensors' rises, and how growth moves the targets.
type Moved = (u32, DMatrix<f64>, Vec<f64>, DVector<f64>);

/// The error of a set on held-out cycles by dense least squares over all rows: nothing of the products that the study sums.
fn dense_error(model: &Model, campaign: &Campaign, state: &State, set: &[usize], reading_k: f64) -> f64 {
    let chain = campaign.chain.clone();
    let growing: Vec<usize> = ["d1", "a1", "a2", "beta2", "d4"]
        .iter()
        .map(|name| chain.place(name.parse().expect("a name")).expect("there"))
        .collect();
    let unknowns: Vec<Unknown> = growing.iter().map(|&place| Unknown::Parameter(place)).collect();
    let mut visits: Vec<Moved> = Vec::new();
    Problem::new(campaign, unknowns, state).each_visit_rows(state, |visit, part| {
        let mut growth = DVector::zeros(growing.len());
        for (id, sensor, coefficient) in model.growth_at(Level::Thermal) {
            let place = growing.iter().position(|&own| Some(own) == chain.place(id)).expect("grows");
            growth[place] +=
                coefficient * visit.rises[campaign.sensors.iter().position(|own| own == sensor).expect("known")];
        }
        let jacobian = part.jacobian * visit.sigma;
        let moved = &jacobian * growth;
        visits.push((visit.cycle, jacobian, visit.rises.clone(), moved));
    });
    let row = |jacobian: &DMatrix<f64>, rises: &[f64]| {
        let blocks: Vec<DMatrix<f64>> = set.iter().map(|&sensor| jacobian * rises[sensor]).collect();
        DMatrix::from_fn(jacobian.nrows(), set.len() * 5, |i, j| blocks[j / 5][(i, j % 5)])
    };
    // A reading that errs is one more measurement, of nothing, at the size of its error.
    let noise = |jacobian: &DMatrix<f64>| {
        let mut rows = DMatrix::zeros(jacobian.nrows() * set.len(), set.len() * 5);
        for place in 0..set.len() {
            rows.view_mut((place * jacobian.nrows(), place * 5), jacobian.shape()).copy_from(&(jacobian * reading_k));
        }
        rows
    };
    let (mut square, mut positions) = (0.0, 0.0);
    for group in 0..8_u32 {
        let held = |cycle: u32| cycle * 8 / 12 == group;
        let (mut a, mut b) = (DMatrix::zeros(0, set.len() * 5), DVector::zeros(0));
        for (_, jacobian, rises, moved) in visits.iter().filter(|visit| !held(visit.0)) {
            for (rows, right) in
                [(row(jacobian, rises), moved.clone()), (noise(jacobian), DVector::zeros(jacobian.nrows() * set.len()))]
            {
                let before = a.nrows();
                a = a.insert_rows(before, rows.nrows(), 0.0);
                a.rows_mut(before, rows.nrows()).copy_from(&rows);
                b = b.insert_rows(before, rows.nrows(), 0.0);
                b.rows_mut(before, rows.nrows()).copy_from(&right);
            }
        }
        let scale = DVector::from_iterator(a.ncols(), a.column_iter().map(|column| 1.0 / column.norm()));
        for (mut column, scale) in a.column_iter_mut().zip(scale.iter()) {
            column *= *scale;
        }
        let c = a.svd(true, true).solve(&b, 1e-12).expect("solved").component_mul(&scale);
        for (_, jacobian, rises, moved) in visits.iter().filter(|visit| held(visit.0)) {
            square += (moved - row(jacobian, rises) * &c).norm_squared() + (noise(jacobian) * &c).norm_squared();
            positions += moved.len() as f64 / 3.0;
        }
    }
    (square / positions).sqrt()
}

#[test]
fn the_smallest_set_of_sensors_is_the_one_that_trying_all_sets_finds() {
    let mut dice = Dice::new("the smallest set of sensors");
    let (model, campaign, state) = grown(&mut dice);
    let reading = 0.02;
    let study = SensorStudy::of_campaign(&model, &campaign, &state, reading).expect("grows");
    for set in [vec![1], vec![0, 3], vec![1, 2, 4]] {
        let (own, dense) = (study.error(&set), dense_error(&model, &campaign, &state, &set, reading));
        // Normal equations of fifteen unknowns against singular values.
        assert!((own - dense).abs() < 1e-6 * dense, "{set:?}: {own} {dense}");
    }
    let subsets: Vec<Vec<usize>> =
        (0..32_u32).map(|bits| (0..5).filter(|sensor| bits >> sensor & 1 == 1).collect()).collect();
    let errors: Vec<f64> = subsets.iter().map(|set| study.error(set)).collect();
    for bound in [2e-5, 5e-6, 2e-6, 1e-4] {
        let smallest = subsets
            .iter()
            .zip(&errors)
            .filter(|(_, error)| **error <= bound)
            .min_by(|one, other| one.0.len().cmp(&other.0.len()).then(one.1.total_cmp(other.1)));
        match (study.smallest(bound, |_| ()), smallest) {
            (Ok(plan), Some((set, error))) => {
                let chosen = plan.by_size.last().expect("a set");
                assert_eq!((&chosen.sensors, plan.exhaustive), (set, true), "bound {bound}");
                assert_eq!(chosen.rms, *error);
                for (place, without) in chosen.without.iter().enumerate() {
                    let mut fewer = set.clone();
                    fewer.remove(place);
                    assert_eq!(*without, study.error(&fewer));
                    assert!(*without > bound, "a smaller set would do");
                }
            }
            (Err(SensorError::OutOfReach { .. }), None) => {}
            (found, expected) => panic!("bound {bound}: {found:?}, expected {expected:?}"),
        }
    }
}

#[test]
fn probes_of_single_joints_tell_links_apart_that_warm_together() {
    let scenario = prepared(&Scenario::shipped("small").expect("ships"), None);
    let (alone, together) = probes(&scenario, 6.0, 1.0).expect("time enough");
    let cycles = |phases: &[thermokin::simulate::DrivePhase]| phases.iter().map(|phase| phase.cycles).sum::<u32>();
    assert_eq!(cycles(&alone), cycles(&together));
    let mut moved: Vec<usize> = alone.iter().flat_map(|phase| phase.joints.clone().unwrap_or_default()).collect();
    moved.sort_unstable();
    assert_eq!(moved, [1, 2, 3, 4, 5, 6]);
    let tried = |phases: &[thermokin::simulate::DrivePhase]| {
        let mut scenario = scenario.clone();
        scenario.schedule.phases = phases.to_vec();
        tell_apart(&scenario).expect("simulated")
    };
    let (single, all) = (tried(&alone), tried(&together));
    // What no other links' rises explain, averaged over the links.
    let own = |tried: &thermokin::plan::TriedSchedule| {
        tried.links.iter().map(|(_, _, share)| share).sum::<f64>() / tried.links.len() as f64
    };
    println!("share of its own: {:.3} by probes, {:.3} all at once", own(&single), own(&all));
    assert!(own(&single) > 3.0 * own(&all));
    assert!(single.links.iter().all(|(_, _, share)| (0.0..=1.0 + 1e-9).contains(share)));
}

#[test]
fn the_best_schedule_tells_more_than_any_other_that_was_tried() {
    let scenario = prepared(&Scenario::shipped("small").expect("ships"), None);
    let mut told = 0;
    let tried = schedule_of(&scenario, 2.5, &[0.0, 0.5, 1.0], |count| told = count).expect("time enough");
    assert!(told >= 12 && tried.len() <= told);
    assert!(tried.windows(2).all(|pair| pair[0].index >= pair[1].index));
    let cycles: u32 = tried[0].phases.iter().map(|phase| phase.cycles).sum();
    for own in &tried {
        assert_eq!(own.phases.iter().map(|phase| phase.cycles).sum::<u32>(), cycles);
        assert!(own.duration_s <= 2.5 * 3600.0 * 1.1, "{} s", own.duration_s);
        assert!(own.phases[0].speed_override > own.phases[1].speed_override);
    }
}

#[test]
fn a_plan_goes_from_the_command_line_into_a_simulated_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    let poses = [
        "plan",
        "comau-nj-130-2.0",
        "--count",
        "8",
        "--tracker",
        "0,0,0",
        "--candidates",
        "100",
        "--sizes",
        "8",
        "--joint",
        "1=-0.9:0.9",
        "--joint",
        "2=-0.25:0.9",
        "--joint",
        "3=-0.7:0.3",
        "--joint",
        "4=-1.7:1.7",
        "--joint",
        "5=0:1.6",
        "--joint",
        "6=-2.1:2.1",
        "--facing",
        "120",
        "--out",
        "poses.csv",
        "--json",
        "plan.json",
    ];
    let output = thermokin(path, &poses);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let plan: serde_json::Value =
        serde_json::from_slice(&fs::read(path.join("plan.json")).expect("written")).expect("JSON");
    let (told, written) = (&plan["poses"], thermokin::run::read_postures(&path.join("poses.csv")).expect("its own"));
    assert_eq!(*told, serde_json::to_value(&written).expect("numbers"));
    assert_eq!(written.len(), 8);
    let again = thermokin(path, &poses);
    assert_eq!(output.stdout, again.stdout, "the same seed gives the same plan");
    let schedule = [
        "plan",
        "schedule",
        "small",
        "--hours",
        "1.5",
        "--overrides",
        "0,1",
        "--poses",
        "poses.csv",
        "--out",
        "planned.toml",
    ];
    let output = thermokin(path, &schedule);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let output = thermokin(path, &["simulate", "planned.toml", "--out", "run"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let run = thermokin::run::read(&path.join("run")).expect("a run");
    let first: Vec<&Vec<f64>> = run.visits.iter().filter(|visit| visit.cycle == 0).map(|visit| &visit.joints).collect();
    for (one, other) in first.iter().zip(&written) {
        assert!(one.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-9), "postures are written to the nanoradian");
    }
    // The same poses by the name of their file.
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/small.toml")).expect("ships");
    let begin = text.find("[postures.drawn]").expect("there");
    let end = text.find("[heat]").expect("there");
    let text = format!("{}[postures]\nfile = \"poses.csv\"\n\n{}", &text[..begin], &text[end..]);
    fs::write(path.join("named.toml"), text).expect("written");
    assert_eq!(Scenario::read(&path.join("named.toml")).expect("valid").postures.joints, Some(written));
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    fs::write(path.join("five.csv"), "time_s,cycle,pose,q1,q2,q3,q4,q5\n0,0,0,0,0,0,0,0\n").expect("written");
    let tx90 = ["plan", "staubli-tx90", "--count", "10", "--target", "0,0,0.1", "--candidates", "50"];
    let cases: &[(&[&str], &[&str], &str)] = &[
        (&["plan", "no-such-arm", "--count", "10"], &[], "expected a robot.toml, a model.json, or one of"),
        (&["plan", "nothing.toml", "--count", "10"], &[], "nothing.toml: "),
        (&["plan", "comau-nj-130-2.0", "--count", "10"], &[], "joint 1 of COMAU NJ-130-2.0 has no limits"),
        (&["plan", "staubli-tx90", "--count", "10"], &[], "expected --target X,Y,Z"),
        (&tx90, &["--target", "0,0"], "--target 0,0: expected three numbers"),
        (&tx90, &["--joint", "7=0:1"], "--joint 7=0:1: expected a joint"),
        (&tx90, &["--joint", "1=1:0"], "--joint 1=1:0: expected a joint"),
        (&tx90, &["--volume", "0:1,0:1"], "--volume 0:1,0:1: expected three ranges"),
        (&tx90, &["--tracker", "a,b,c"], "--tracker a,b,c: expected three numbers"),
        (&tx90, &["--sigma=-1"], "--sigma -1: expected a number from 0"),
        (&tx90, &["--facing", "0"], "--facing 0: expected degrees"),
        (&tx90, &["--fix", "beta9"], "--fix beta9: the chain has no such parameter"),
        (&tx90, &["--volume", "50:51,50:51,50:51"], "0 of 10 postures found"),
        (
            &["plan", "staubli-tx90", "--count", "3", "--target", "0,0,0.1", "--candidates", "50"],
            &[],
            "3 poses do not tell",
        ),
        (&["plan", "schedule", "small", "--hours", "0.1"], &[], "expected 4 cycles or more"),
        (&["plan", "schedule", "small", "--hours=-1"], &[], "--hours -1: expected"),
        (&["plan", "schedule", "small", "--hours", "2", "--overrides", "0.5"], &[], "two different overrides"),
        (
            &["plan", "schedule", "small", "--hours", "2", "--poses", "five.csv"],
            &[],
            "five.csv:1: has 5 joints, expected the arm's 6",
        ),
        (&["plan", "probes", "small", "--hours", "0.5"], &[], "expected 12 cycles or more"),
        (&["plan", "probes", "no.toml", "--hours", "5"], &[], "no.toml: cannot be read"),
        (&["plan", "sensors", "no.json", "no-run", "--bound-mm", "0.1"], &[], "no.json"),
        (&["plan", "sensors", "no.json", "no-run", "--bound-mm", "0"], &[], "--bound-mm 0: expected a number above 0"),
    ];
    for (command, more, expected) in cases {
        let arguments: Vec<&str> = command
            .iter()
            .chain(*more)
            .copied()
            .chain(["--out", "out"].into_iter().filter(|_| !command.contains(&"sensors")))
            .collect();
        let output = thermokin(path, &arguments);
        let words = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {words}");
        assert!(words.contains(expected), "{arguments:?}: {words}");
        assert!(!path.join("out").exists(), "{arguments:?}: something was written");
    }
}
