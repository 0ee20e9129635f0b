//! The twin: the thesis's numbers come out, noise is as asked for, the same seed gives the same bytes, and what is wrong
//! with a scenario is told with its line.
//!
//! # Statistical bounds
//! A sum of `n` squared standard normal deviates has mean `n` and deviation `√(2n)`; the tests allow five deviations,
//! which one run in a million exceeds. The seeds are fixed and printed.

use std::path::Path;
use std::process::Command;

use nalgebra::Vector3;
use thermokin::calibrate::ObserveOptions;
use thermokin::discover::{Discovery, DiscoveryRequest, discover, replay};
use thermokin::effect::SiteNames;
use thermokin::robot::{Posture, Robot};
use thermokin::run;
use thermokin::simulate::{SHIPPED_SCENARIOS, Scenario, Simulated, simulate};

fn shipped(name: &str) -> Scenario {
    Scenario::shipped(name).expect("a shipped scenario")
}

fn simulated(scenario: &Scenario) -> Simulated {
    println!("{}: run seed {}, arm seed {}", scenario.name, scenario.seed, scenario.arm.seed);
    simulate(scenario).expect("the scenario can be simulated")
}

/// The true values of all parameters when cold, in the chain's order.
fn cold(simulated: &Simulated) -> Vec<f64> {
    simulated.truth.parameters.iter().map(|parameter| parameter.value).collect()
}

/// A scenario in which nothing grows and no transmission errs, so that what is left is noise.
fn without_drift() -> Scenario {
    let mut scenario = shipped("thesis-75-25");
    scenario.growth.clear();
    scenario.arm.transmission_error_rad = 0.0;
    scenario
}

fn assert_chi_square(sum: f64, count: usize, what: &str) {
    let n = count as f64;
    assert!((sum - n).abs() < 5.0 * (2.0 * n).sqrt(), "{what}: {sum} for {n} degrees of freedom");
}

#[test]
fn shipped_scenarios_are_valid() {
    for (name, text) in SHIPPED_SCENARIOS {
        let scenario = Scenario::parse(Path::new(name), text).expect("a shipped scenario is valid");
        assert_eq!(scenario.name, name);
        assert_eq!(Scenario::shipped(name), Some(scenario));
    }
    assert_eq!(Scenario::shipped("no such scenario"), None);
}

#[test]
fn the_numbers_of_the_thesis_come_out() {
    for name in ["thesis-75-25", "thesis-90-30"] {
        let made = simulated(&shipped(name));
        let cycles = &made.truth.cycles;
        assert_eq!((cycles.len(), made.run.visits.len(), made.run.point_count()), (24, 15 * 24, 15 * 24 * 4));
        // Section 4.5.2: 2.8 mm and 3.4 mm of nominal error; the error of the cold geometry grows from 0.26 to 0.5 mm,
        // which is what a drift of about 0.4 mm does when both are independent.
        let nominal_mm = cycles[0].nominal_error_m * 1e3;
        assert!((2.5..4.0).contains(&nominal_mm), "nominal error {nominal_mm} mm");
        let drift_mm = cycles.iter().map(|cycle| cycle.drift_m * 1e3).fold(0.0, f64::max);
        assert!((0.35..0.6).contains(&drift_mm), "drift {drift_mm} mm");
        // Section 4.3.4: exponential rises and falls, quick at the beginning and slow at the end.
        let warmest = |cycle: usize| cycles[cycle].warmest_housing_c;
        assert!(warmest(4) - warmest(0) > 2.0 * (warmest(14) - warmest(10)) && warmest(14) > warmest(10));
        assert!(warmest(14) - warmest(18) > warmest(19) - warmest(23) && warmest(19) > warmest(23));
    }
}

#[test]
fn two_runs_of_one_arm_share_the_arm_and_nothing_else() {
    let (one, other) = (simulated(&shipped("thesis-75-25")), simulated(&shipped("thesis-90-30")));
    assert_eq!(one.truth.parameters, other.truth.parameters);
    assert_eq!(one.truth.targets, other.truth.targets);
    assert_eq!(one.truth.sensors, other.truth.sensors);
    let postures =
        |made: &Simulated| made.run.visits.iter().take(15).map(|visit| visit.joints.clone()).collect::<Vec<_>>();
    assert_eq!(postures(&one), postures(&other));
    assert_ne!(one.run.motion, other.run.motion);
    // The air warms in one and cools in the other.
    let trend = |made: &Simulated| made.truth.cycles[23].air_c - made.truth.cycles[0].air_c;
    assert!(trend(&one) > 0.5 && trend(&other) < -0.5);
}

#[test]
fn instrument_noise_is_as_asked_for() {
    let scenario = without_drift();
    let made = simulated(&scenario);
    let chain = made.robot.chain().prepare(&cold(&made));
    let (mut radial, mut transverse, mut count) = (0.0, 0.0, 0);
    for (visit, truth) in made.run.visits.iter().zip(&made.truth.visits) {
        let flange = chain.flange(&Posture::new(&truth.joints));
        for point in &visit.points {
            let place = flange.point(&Vector3::from(made.truth.targets[point.target].position));
            let beam = place - Vector3::from(scenario.instrument.position);
            let (distance, along) = (beam.norm(), beam.normalize());
            let error = point.position - place;
            // Readings averaged, and positions rounded to 0.1 µm.
            let variance = |sigma: f64| sigma * sigma / f64::from(scenario.instrument.readings) + 1e-14 / 12.0;
            let off = error - along * along.dot(&error);
            radial += along.dot(&error) * along.dot(&error) / variance(scenario.instrument.radial.at(distance));
            transverse += off.norm_squared() / variance(scenario.instrument.transverse.at(distance));
            count += 1;
        }
    }
    assert_chi_square(radial, count, "along the beam");
    assert_chi_square(transverse, 2 * count, "across the beam");
}

#[test]
fn repeatability_is_as_asked_for() {
    let scenario = without_drift();
    let made = simulated(&scenario);
    let chain = made.robot.chain().prepare(&cold(&made));
    let (mut squares, mut count, mut displaced) = (0.0, 0, 0.0);
    for (visit, truth) in made.run.visits.iter().zip(&made.truth.visits) {
        for (logged, true_joint) in visit.joints.iter().zip(&truth.joints) {
            let error = (true_joint - logged) / made.truth.joint_sigma;
            squares += error * error;
            count += 1;
        }
        let (logged, moved) = (chain.flange(&Posture::new(&visit.joints)), chain.flange(&Posture::new(&truth.joints)));
        for target in &made.truth.targets {
            let place = Vector3::from(target.position);
            displaced += (moved.point(&place) - logged.point(&place)).norm_squared();
        }
    }
    assert_chi_square(squares, count, "joints");
    // A visit's squared displacement is a weighted sum of squared deviates, whose relative deviation is at most √2.
    let visits = made.run.visits.len() as f64;
    let asked = (scenario.arm.repeatability_m / 3.0).powi(2);
    let found = displaced / visits / made.truth.targets.len() as f64;
    assert!((found / asked - 1.0).abs() < 5.0 * (2.0 / visits).sqrt(), "{found:e} {asked:e}");
}

#[test]
fn beams_break_as_often_as_asked_for() {
    let mut scenario = shipped("thesis-75-25");
    scenario.instrument.broken_beam = 0.1;
    let made = simulated(&scenario);
    let broken = made.run.visits.iter().map(|visit| visit.broken_beams.len()).sum::<usize>() as f64;
    let tried = made.run.point_count() as f64 + broken;
    assert_eq!(tried, 1440.0);
    assert!((broken - 0.1 * tried).abs() < 5.0 * (tried * 0.1 * 0.9).sqrt(), "{broken} of {tried}");
    // What is seen is seen as before.
    scenario.instrument.broken_beam = 0.0;
    let whole = simulated(&scenario);
    for (visit, all) in made.run.visits.iter().zip(&whole.run.visits) {
        assert!(visit.points.iter().all(|point| all.points.contains(point)));
    }
}

#[test]
fn sensors_count_in_256ths_and_keep_their_times() {
    let scenario = shipped("thesis-75-25");
    let made = simulated(&scenario);
    let log = made.run.temperatures.as_ref().expect("a temperature log");
    assert_eq!(log.sensors.len(), 21);
    for (name, series) in log.sensors.iter().zip(&log.series) {
        assert!(series.celsius().iter().all(|celsius| (celsius * 256.0).fract() == 0.0), "{name}");
        assert!(series.times_s().windows(2).all(|pair| pair[0] < pair[1]), "{name}");
        let period = series.median_period_s().expect("many readings");
        assert!((period - scenario.sensors.period_s).abs() < 5.0 * scenario.sensors.jitter_s, "{name}: {period} s");
    }
    // At every visit, each sensor lies between its link's nodes but for lag, bias, noise and counts.
    let lag_k = scenario.sensors.response_s * 0.02;
    let allowed = lag_k + 5.0 * (scenario.sensors.bias_k + scenario.sensors.noise_k) + 1.0 / 256.0;
    for visit in &made.truth.visits {
        for sensor in &made.robot.sensors {
            let index = log.index_of(&sensor.name).expect("the sensor is in the log");
            let read = log.at(index, visit.time_s).expect("a reading");
            let (core, housing) = (visit.nodes_c[2 * sensor.link], visit.nodes_c[2 * sensor.link + 1]);
            assert!(read > core.min(housing) - allowed && read < core.max(housing) + allowed, "{}", sensor.name);
        }
    }
}

#[test]
fn bare_sensors_fall_while_the_arm_moves() {
    let mut scenario = shipped("thesis-75-25");
    let covered = simulated(&scenario);
    scenario.sensors.chill_k = 2.0;
    let bare = simulated(&scenario);
    let at = |made: &Simulated, name: &str, time_s: f64| {
        let log = made.run.temperatures.as_ref().expect("a temperature log");
        log.at(log.index_of(name).expect("a sensor"), time_s).expect("a reading")
    };
    let step = bare.run.motion.iter().find(|step| step.speed_override == 0.75).expect("a warm-up step");
    let (moving, after) = (step.end_s - 5.0, step.end_s + 5.0 * scenario.sensors.response_s);
    assert!(at(&covered, "L4S1", moving) - at(&bare, "L4S1", moving) > 1.0);
    assert!((at(&covered, "L0S1", moving) - at(&bare, "L0S1", moving)).abs() <= 1.0 / 256.0, "the base does not move");
    assert!(at(&bare, "L4S1", after) > at(&bare, "L4S1", moving) + 1.0, "readings rise as the arm stops");
}

#[test]
fn growth_follows_the_true_nodes_and_offsets_are_exact() {
    let mut scenario = shipped("small");
    scenario.arm.offsets.insert("d4".to_owned(), 0.0025);
    let made = simulated(&scenario);
    let place = |name: &str| made.truth.parameters.iter().position(|parameter| parameter.name == name).expect(name);
    let d4 = &made.truth.parameters[place("d4")];
    assert_eq!(d4.value, d4.nominal + 0.0025);
    // Other parameters stay as the arm's seed drew them.
    let plain = simulated(&shipped("small"));
    assert_eq!(plain.truth.parameters[place("a2")], made.truth.parameters[place("a2")]);
    let growth = scenario.growth.iter().find(|growth| growth.parameter.0.to_string() == "a2").expect("a2 grows");
    for visit in &made.truth.visits {
        let expected: f64 = growth
            .terms
            .iter()
            .map(|term| {
                let node = 2 * term.link + usize::from(term.node == thermokin::simulate::Node::Housing);
                term.per_k * (visit.nodes_c[node] - scenario.arm.reference_c)
            })
            .sum();
        assert!((visit.growth[place("a2")] - expected).abs() <= 4.0 * f64::EPSILON * expected.abs());
        assert_eq!(visit.growth[place("d3")], 0.0);
    }
}

#[test]
fn postures_stay_in_their_window_and_repeat() {
    let scenario = shipped("thesis-75-25");
    let made = simulated(&scenario);
    let window = scenario.postures.drawn.as_ref().expect("drawn postures");
    let first: Vec<_> = made.run.visits.iter().take(window.count).map(|visit| &visit.joints).collect();
    for visit in &made.run.visits {
        assert_eq!(&visit.joints, first[visit.pose as usize]);
        for (q, (min, max)) in visit.joints.iter().zip(window.min.iter().zip(&window.max)) {
            assert!(min <= q && q <= max);
        }
    }
    for pair in made.run.visits.windows(2).filter(|pair| pair[0].cycle == pair[1].cycle) {
        let approach = pair[1].approach.as_ref().expect("approach signs");
        for (approach, (to, from)) in approach.iter().zip(pair[1].joints.iter().zip(&pair[0].joints)) {
            assert_eq!(f64::from(*approach), (to - from).signum());
        }
    }
}

#[test]
fn an_arm_of_sliding_joints_can_be_simulated() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut robot = thermokin::robot::shipped("comau-nj-130-2.0").expect("shipped");
    if let Some(joint) = &mut robot.transforms[1].joint {
        joint.kind = thermokin::robot::JointKind::Prismatic;
    }
    std::fs::write(folder.path().join("slider.toml"), robot.to_toml()).expect("written");
    let (_, text) = SHIPPED_SCENARIOS.iter().find(|(name, _)| *name == "small").expect("small");
    let text = text.replace("\"comau-nj-130-2.0\"", "\"slider.toml\"");
    let scenario = Scenario::parse(&folder.path().join("scenario.toml"), &text).expect("valid");
    assert_eq!(simulated(&scenario).run.visits.len(), 75);
}

/// FNV-1a of 64 bits: enough to tell whether bytes have changed.
fn fingerprint(files: &run::RunFiles) -> u64 {
    let robot = files.robot.as_ref().map(|(_, bytes)| bytes.clone());
    [
        Some(files.run.clone()),
        Some(files.poses.clone()),
        files.points.clone(),
        files.temperatures.clone(),
        files.motion.clone(),
        robot,
    ]
    .into_iter()
    .flatten()
    .flatten()
    .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn files(scenario: &Scenario) -> run::RunFiles {
    simulated(scenario).files(Path::new("run")).expect("files")
}

/// What `small` gives on every machine. Whoever changes it on purpose says so in the changelog.
const GOLDEN: u64 = 0x3b0a_3c82_b34e_2687;

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_gives_others() {
    let mut scenario = shipped("small");
    let first = files(&scenario);
    assert_eq!(first, files(&scenario));
    assert_eq!(fingerprint(&first), GOLDEN, "{:#018x}", fingerprint(&first));
    scenario.seed += 1;
    let other = files(&scenario);
    assert_ne!(first.points, other.points);
    assert_ne!(first.temperatures, other.temperatures);
    assert_eq!(first.robot, other.robot);
}

#[test]
fn a_written_run_is_read_back_and_holds_no_truth() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = folder.path().join("run");
    let made = simulated(&shipped("small"));
    made.write(&place).expect("written");
    let again = run::read(&place).expect("read back");
    assert_eq!(again.visits, made.run.visits);
    assert_eq!(again.temperatures, made.run.temperatures);
    assert_eq!(again.motion, made.run.motion);
    assert_eq!(again.target_names, made.run.target_names);
    assert_eq!(again.notes, Vec::<String>::new());
    assert_eq!(Robot::read(&again.description.robot), Ok(made.robot));
    let mut names: Vec<String> = std::fs::read_dir(&place)
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["motion.csv", "points.csv", "poses.csv", "robot.toml", "run.toml", "temperatures.csv"]);
}

/// Replaces a text that stands once in `small`; gives the line of the error and its message.
fn spoiled(what: &str, with: &str) -> (Option<usize>, String) {
    let (_, text) = SHIPPED_SCENARIOS.iter().find(|(name, _)| *name == "small").expect("small");
    assert_eq!(text.matches(what).count(), 1, "'{what}' stands once in small.toml");
    let error = Scenario::parse(Path::new("s.toml"), &text.replace(what, with)).expect_err(with);
    assert!(!error.message.contains('\n'), "one line: {}", error.message);
    (error.line, error.message)
}

#[test]
fn what_is_wrong_with_a_scenario_is_told_with_its_line() {
    let (_, text) = SHIPPED_SCENARIOS.iter().find(|(name, _)| *name == "small").expect("small");
    let line_of = |what: &str| 1 + text.lines().position(|line| line.contains(what)).expect(what);
    for (what, with, words) in [
        ("jitter_s = 0.05", "jitter = 0.05", "jitter"),
        ("format = 1", "format = 2", "format is 2, expected 1"),
        ("step_s = 5.0", "step_s = 0.0", "step_s is 0, expected more than 0"),
        ("repeatability_m = 70e-6", "repeatability_m = -1.0", "expected 0 or more"),
        ("reference_c = 20.0", "reference_c = nan", "reference_c is NaN"),
        ("measure_override = 0.1", "measure_override = 10.0", "expected a share from 0 to 1"),
        ("cycle_s = [300.0, 400.0]", "cycle_s = [400.0, 300.0]", "the lower first"),
        ("cycle_s = [300.0, 400.0]", "cycle_s = [100.0, 400.0]", "the shortest cycle is 100 s"),
        ("\"comau-nj-130-2.0\"", "\"comau\"", "no robot 'comau' ships"),
        ("parameter = \"a2\"", "parameter = \"b2\"", "no parameter b2"),
        ("parameter = \"a2\"", "parameter = \"d1\"", "a second [[growth]] of d1"),
        ("parameter = \"a2\"", "parameter = \"length\"", "no parameter's name"),
        ("min = [-0.9, ", "min = [", "5 numbers"),
        ("min = [-0.9, ", "min = [1.9, ", "expected at least the 1.9 of min"),
        ("count = 15", "count = 0", "expected 1 to 1000"),
        ("core_share = [0.05, 0.5]", "core_share = [0.05, 1.5]", "expected a share"),
        ("ambient = \"AMB\"", "ambient = \"L0S1\"", "is a sensor of the arm"),
        ("readings = 50", "readings = 0", "expected more than 0"),
    ] {
        let (line, message) = spoiled(what, with);
        assert!(message.contains(words), "{with}: {message}");
        let expected = if with.contains("min = [1.9") { line_of("max = [") } else { line_of(what) };
        assert_eq!(line, Some(expected), "{with}: {message}");
    }
    let (_, message) = spoiled("reference_c = 20.0", "reference_c = 20.0\noffsets = { d9 = 0.1 }");
    assert!(message.contains("no parameter d9"), "{message}");
    let (_, message) = spoiled("reference_c = 20.0", "reference_c = 20.0\ntargets = { T9 = [0.0, 0.0, 0.1] }");
    assert!(message.contains("no target T9"), "{message}");
    let (_, message) = spoiled("\"comau-nj-130-2.0\"", "\"staubli-tx90\"");
    assert!(message.contains("target SMR has no position"), "{message}");
    let (_, message) = spoiled("[postures.drawn]", "[postures]\njoints = []\n[postures.drawn]");
    assert!(message.contains("expected one of joints"), "{message}");
}

#[test]
fn postures_that_cannot_be_are_said_so() {
    let mut scenario = shipped("small");
    if let Some(drawn) = &mut scenario.postures.drawn {
        drawn.lowest_m = Some(50.0);
        drawn.count = 2;
    }
    let error = simulate(&scenario).expect_err("no arm reaches so high");
    assert!(error.to_string().contains("0 of 2 postures"), "{error}");
}

fn thermokin(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_thermokin")).arg("simulate").args(arguments).output().expect("runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn the_command_makes_a_run_and_refuses_to_overwrite_one() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (out, truth) = (path("run"), path("truth.json"));
    let (code, words, errors) = thermokin(&["small", "--out", &out, "--seed", "9", "--truth", &truth]);
    assert_eq!((code, errors.as_str()), (Some(0), ""));
    assert!(words.contains("run seed 9, arm seed 7") && words.contains("nominal error"), "{words}");
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(truth).expect("the truth")).expect("JSON");
    assert_eq!(truth["parameters"].as_array().map(Vec::len), Some(30));

    let (code, _, errors) = thermokin(&["small", "--out", &out]);
    assert_eq!(code, Some(2));
    assert!(errors.contains("not empty") && errors.contains("--force"), "{errors}");
    let (code, words, _) = thermokin(&["small", "--out", &out, "--force", "--json", "-"]);
    assert_eq!(code, Some(0));
    let summary: serde_json::Value = serde_json::from_str(&words).expect("JSON alone on standard output");
    assert_eq!(summary["command"], "simulate");

    let (code, _, errors) = thermokin(&["medium", "--out", &path("other")]);
    assert!(code == Some(2) && errors.contains("thesis-75-25"), "{errors}");
    let (code, _, errors) = thermokin(&["none.toml", "--out", &path("other")]);
    assert!(code == Some(2) && errors.contains("none.toml: cannot be read"), "{errors}");
    assert!(!folder.path().join("other").exists());
}

/// A shipped scenario with more text at its end.
fn with(more: &str) -> Result<Scenario, thermokin::input::InputError> {
    let (name, text) = SHIPPED_SCENARIOS.iter().find(|(name, _)| *name == "small").expect("it ships");
    Scenario::parse(Path::new(name), &format!("{text}\n{more}"))
}

#[test]
fn an_effect_on_a_joint_moves_it_and_nothing_else() {
    let (amplitude, phase, harmonic) = (2e-4, 0.7, 3.0);
    let hidden = with(&format!(
        "[[effect]]\neffect = \"gear_eccentricity\"\nwhere = {{ joint = 2 }}\n\
         parameters = {{ amplitude_rad = {amplitude}, phase_rad = {phase}, harmonic = {harmonic} }}"
    ));
    let (plain, hidden) = (simulated(&shipped("small")), simulated(&hidden.expect("it is right")));
    assert_eq!(hidden.truth.effects.len(), 1);
    assert_eq!(plain.run.temperatures, hidden.run.temperatures);
    for ((before, after), visit) in plain.truth.visits.iter().zip(&hidden.truth.visits).zip(&hidden.run.visits) {
        for (joint, (q, moved)) in before.joints.iter().zip(&after.joints).enumerate() {
            let expected = if joint == 1 { amplitude * (harmonic * visit.joints[1] + phase).cos() } else { 0.0 };
            assert!((moved - q - expected).abs() < 1e-15, "joint {}: {moved} - {q}, expected {expected}", joint + 1);
        }
    }
    assert_ne!(plain.run.visits[0].points, hidden.run.visits[0].points);
}

#[test]
fn an_effect_on_a_sensor_spoils_its_log_and_leaves_the_arm_alone() {
    let robot = shipped("small").robot;
    let sensor = &robot.sensors[0].name;
    let hidden = with(&format!(
        "[[effect]]\neffect = \"sensor_bias\"\nwhere = {{ sensor = \"{sensor}\" }}\n\
         parameters = {{ time_s = 900.0, step_k = 1.5 }}"
    ));
    let (plain, hidden) = (simulated(&shipped("small")), simulated(&hidden.expect("it is right")));
    assert_eq!(plain.run.visits, hidden.run.visits);
    let (before, after) = (plain.run.temperatures.expect("a log"), hidden.run.temperatures.expect("a log"));
    let mut stepped = 0;
    for ((name, before), after) in before.sensors.iter().zip(&before.series).zip(&after.series) {
        for ((time, cold), warm) in before.times_s().iter().zip(before.celsius()).zip(after.celsius()) {
            let expected = if name == sensor && *time >= 900.0 { 1.5 } else { 0.0 };
            assert!((warm - cold - expected).abs() < 1e-9, "{name} at {time} s");
            stepped += usize::from(expected > 0.0);
        }
    }
    assert!(stepped > 10, "{stepped} readings after the step");
}

#[test]
fn effects_that_cannot_be_are_refused_with_their_line() {
    let (_, text) = SHIPPED_SCENARIOS.iter().find(|(name, _)| *name == "small").expect("it ships");
    // The text ends with a line break, and one more is put before what is added.
    let line = text.lines().count() + 2;
    for (more, said) in [
        ("effect = \"gear_excentricity\"", "no effect"),
        ("effect = \"backlash\"\nwhere = { joint = 9 }\nparameters = { width_rad = 1e-4 }", "that is not there"),
        ("effect = \"backlash\"\nwhere = { joint = 1 }", "expected the parameter width_rad"),
        ("effect = \"backlash\"\nwhere = { joint = 1 }\nparameters = { width_rad = 0.0 }", "does nothing"),
        ("effect = \"thermal_lag\"\nwhere = { parameter = \"d1\" }\nparameters = { tau_s = 300.0 }", "does nothing"),
    ] {
        let error = with(&format!("[[effect]]\n{more}")).expect_err(more);
        assert_eq!(error.line, Some(line), "{error}");
        assert!(error.message.contains(said), "{error}");
    }
}

#[test]
fn a_run_made_of_an_extended_model_looks_like_the_one_that_it_was_found_on() {
    let mut scenario = with(
        "[[effect]]\neffect = \"gear_eccentricity\"\nwhere = { joint = 2 }\n\
         parameters = { amplitude_rad = 2e-4, phase_rad = 0.7, harmonic = 3.0 }",
    )
    .expect("it is right");
    // Heat and waves of other joints would be found as well, the weakest of them once and not again.
    scenario.growth.clear();
    scenario.arm.transmission_error_rad = 0.0;
    let measured = simulated(&scenario);
    let request = DiscoveryRequest { seed: 1, hold_out: false, ..DiscoveryRequest::default() };
    let first = discover(&measured.robot, &measured.run, &request).expect("large enough");
    let model = first.model();
    let (seed, options) = (5, ObserveOptions::default());
    println!("noise of seed {seed}");
    let again = replay(&model, &measured.run, &measured.robot, &options, seed).expect("the run fits the model");
    assert_eq!(again.notes, measured.run.notes);
    assert_eq!(again.run.point_count(), measured.run.point_count());
    assert_eq!(again.run.temperatures, measured.run.temperatures);
    let second = discover(&measured.robot, &again.run, &request).expect("large enough");
    let named = |found: &Discovery| -> Vec<(&str, SiteNames)> {
        found.findings.iter().map(|finding| (finding.effect, finding.place.clone())).collect()
    };
    let gear = ("gear_eccentricity", SiteNames { joint: Some(2), ..SiteNames::default() });
    assert!(named(&first).contains(&gear), "{:?}", named(&first));
    assert_eq!(named(&first), named(&second));
    // Six numbers a visit tell the size of what is left: five deviations of the ratio of two such sizes.
    let freedom = 6.0 * measured.run.visits.len() as f64;
    for (what, one, other) in [
        ("baseline", first.baseline.fitted.rms_mm, second.baseline.fitted.rms_mm),
        ("extended", first.extended.fitted.rms_mm, second.extended.fitted.rms_mm),
    ] {
        assert!((one / other).ln().abs() < 5.0 / freedom.sqrt(), "{what}: {one} mm and {other} mm");
    }
    for (one, other) in first.findings[0].parameters.iter().zip(&second.findings[0].parameters) {
        let sigma = ((one.high - one.low) / 3.92).hypot((other.high - other.low) / 3.92);
        assert!((one.value - other.value).abs() < 5.0 * sigma, "{}: {} and {}", one.name, one.value, other.value);
    }
}
