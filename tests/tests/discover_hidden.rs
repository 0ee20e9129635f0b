//! Effects hidden in runs by a simulator that shares no code with what finds them: names, places, intervals, held-out gains,
//! and silence where nothing is hidden. The seeds are fixed; how many of a set must be right follows from the rate that is
//! promised and the number of runs.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};
use thermokin::discover::{Discovery, DiscoveryRequest, discover};
use thermokin::robot::Robot;
use thermokin::run::read;
use thermokin_tests::hidden::arms::Model;
use thermokin_tests::hidden::case::{Case, Options};
use thermokin_tests::hidden::draw::Request;
use thermokin_tests::hidden::floor::floor;
use thermokin_tests::hidden::folder::{self, Form};
use thermokin_tests::hidden::schedule::Plan;

/// A run to be made and examined.
struct Hidden {
    seed: u64,
    effects: &'static [&'static str],
    rho: f64,
    model: Model,
    form: Form,
    missing: f64,
    payload_changes: bool,
    hold_out: bool,
}

impl Hidden {
    fn new(seed: u64, effects: &'static [&'static str], rho: f64) -> Self {
        let form = Form::default();
        Self { seed, effects, rho, model: Model::Nj130, form, missing: 0.002, payload_changes: false, hold_out: false }
    }

    fn examine(&self) -> Examined {
        let case = Case::make(Options {
            seed: self.seed,
            model: self.model,
            plan: Plan {
                cycles: 16,
                poses: 15,
                targets: None,
                shuffled: self.seed % 2 == 1,
                mixed_overrides: false,
                payload_changes: self.payload_changes,
            },
            effects: self.effects.iter().map(|text| Request::parse(text).expect("a known effect")).collect(),
            rho: (!self.effects.is_empty()).then_some(self.rho),
            point_sigma_m: None,
            joint_sigma_rad: None,
            posture_share: 0.0,
            missing: self.missing,
        })
        .expect("a run");
        let name = format!("hidden-{}-{}", self.seed, self.effects.join("-"));
        let at = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&name);
        folder::write(&case, &name, self.form, &at).expect("a folder");
        let run = read(&at).expect("a run");
        let robot = Robot::read(&run.description.robot).expect("a robot");
        let request = DiscoveryRequest { hold_out: self.hold_out, ..DiscoveryRequest::default() };
        let discovery = discover(&robot, &run, &request).expect("a discovery");
        let truth = folder::truth(&case)["effects"].as_array().expect("effects").clone();
        Examined { name, case, truth, discovery }
    }
}

struct Examined {
    name: String,
    case: Case,
    truth: Vec<Value>,
    discovery: Discovery,
}

type Name = (String, String);

impl Examined {
    fn hidden(&self) -> BTreeSet<Name> {
        let name =
            |effect: &Value| (effect["effect"].as_str().expect("a name").to_owned(), effect["where"].to_string());
        self.truth.iter().map(name).collect()
    }

    fn named(&self) -> BTreeSet<Name> {
        let findings = self.discovery.findings.iter();
        let mut named: BTreeSet<Name> =
            findings.map(|finding| (finding.effect.to_owned(), json!(finding.place).to_string())).collect();
        if self.discovery.unexplained.significant {
            named.insert(("unexplained".to_owned(), "{}".to_owned()));
        }
        named
    }

    /// Whether the names are exactly right, an effect that these data cannot tell from the one that is named counted as
    /// named where it is among the two nearest alternatives.
    fn is_right(&self) -> bool {
        let (hidden, named) = (self.hidden(), self.named());
        let missed: Vec<&Name> = hidden.difference(&named).collect();
        let other: Vec<&Name> = named.difference(&hidden).collect();
        let alternatives: BTreeSet<Name> = self
            .discovery
            .findings
            .iter()
            .flat_map(|finding| finding.alternatives.iter().take(2))
            .map(|other| (other.effect.to_owned(), json!(other.place).to_string()))
            .collect();
        let right = missed.len() == other.len() && missed.iter().all(|name| alternatives.contains(name));
        println!("{} {}: hidden {hidden:?}, named {named:?}", if right { "right" } else { "WRONG" }, self.name);
        right
    }

    /// How many intervals of numbers hold the truth, and how many there are.
    fn intervals(&self) -> (usize, usize) {
        let (mut held, mut all) = (0, 0);
        for finding in &self.discovery.findings {
            let is_it = |effect: &&Value| effect["effect"] == finding.effect && effect["where"] == json!(finding.place);
            let Some(truth) = self.truth.iter().find(is_it) else { continue };
            for estimate in finding.parameters.iter().filter(|estimate| estimate.low < estimate.high) {
                let Some(value) = truth["parameters"][&estimate.name].as_f64() else { continue };
                let holds = estimate.low <= value && value <= estimate.high;
                if !holds {
                    println!("  {}: {} is {value:e}, said {estimate:?}", self.name, estimate.name);
                }
                held += usize::from(holds);
                all += 1;
            }
        }
        (held, all)
    }
}

/// The fewest successes of so many that a rate gives in 99 of 100 cases.
fn fewest(rate: f64, count: usize) -> usize {
    let mut chance = (1.0 - rate).powi(count as i32);
    let (mut below, mut successes) = (0.0, 0);
    while below + chance < 0.01 {
        below += chance;
        chance *= (count - successes) as f64 / (successes + 1) as f64 * rate / (1.0 - rate);
        successes += 1;
    }
    successes
}

#[test]
fn hidden_effects_are_named_with_intervals_that_hold() {
    let each: [&[&str]; 22] = [
        &["gear_eccentricity"],
        &["encoder_gain"],
        &["backlash"],
        &["lost_motion"],
        &["joint_log_early"],
        &["joint_compliance"],
        &["joint_coupling"],
        &["thermal_growth"],
        &["thermal_lag"],
        &["thermal_nonlinearity"],
        &["unsensed_heat"],
        &["frame_drift"],
        &["frame_jump"],
        &["scale_error"],
        &["target_shift"],
        &["target_swap"],
        &["tool_slip"],
        &["sensor_chill"],
        &["sensor_bias"],
        &["sensor_swap"],
        &["sensor_detached"],
        &["clock_offset"],
    ];
    let (mut right, mut held, mut all) = (0, 0, 0);
    for (seed, effects) in (501..).zip(each) {
        let examined = Hidden::new(seed, effects, 12.0).examine();
        right += usize::from(examined.is_right());
        let (own_held, own_all) = examined.intervals();
        held += own_held;
        all += own_all;
    }
    println!("{right} of {} right, {held} of {all} intervals hold", each.len());
    // 98 % at 12, and intervals of 95 %.
    assert!(right >= fewest(0.98, each.len()), "{right} right of {}", each.len());
    assert!(held >= fewest(0.95, all), "{held} of {all} intervals hold");
}

#[test]
fn nothing_is_named_where_nothing_is_hidden() {
    let runs = [
        Hidden::new(601, &[], 0.0),
        Hidden { model: Model::Ur, ..Hidden::new(602, &[], 0.0) },
        Hidden { payload_changes: true, missing: 0.1, ..Hidden::new(603, &[], 0.0) },
        Hidden { form: Form { motion: false, approach: false, payload: true }, ..Hidden::new(604, &[], 0.0) },
    ];
    let wrong = runs.iter().filter(|run| !run.examine().is_right()).count();
    // One run in a hundred may be wrong; of four, by bad luck, one.
    assert!(wrong <= 1, "{wrong}");
}

#[test]
fn several_effects_are_named_at_once() {
    let runs: [&[&str]; 4] = [
        &["backlash", "thermal_growth"],
        &["gear_eccentricity", "frame_jump"],
        &["target_swap", "joint_coupling"],
        &["encoder_gain", "sensor_chill", "tool_slip"],
    ];
    let right =
        (701..).zip(runs).filter(|(seed, effects)| Hidden::new(*seed, effects, 12.0).examine().is_right()).count();
    // Nine in ten for pairs, 83 % for triples.
    assert!(right >= fewest(0.88, runs.len()), "{right}");
}

#[test]
fn what_no_effect_makes_is_owned_as_unexplained() {
    let runs: [&[&str]; 3] = [&["off_joint_product"], &["off_cross_wave"], &["off_override"]];
    let owned = (801..).zip(runs).filter(|(seed, effects)| {
        let examined = Hidden::new(*seed, effects, 24.0).examine();
        let unexplained = &examined.discovery.unexplained;
        println!("{}: {:?}, named {:?}", examined.name, unexplained.follows(), examined.named());
        unexplained.significant
    });
    let owned = owned.count();
    assert!(owned >= fewest(0.9, runs.len()), "{owned}");
}

#[test]
fn what_is_gained_on_held_out_data_is_what_the_true_model_gains() {
    for (seed, effect) in [(901, &["joint_compliance"]), (902, &["thermal_lag"])] {
        let examined = Hidden { hold_out: true, ..Hidden::new(seed, effect, 30.0) }.examine();
        assert!(examined.is_right());
        let said = examined.discovery.extended.held_out.expect("held out").rms_mm;
        let floor = floor(&examined.case);
        // The same folds; each point is held out once with its pose and once with its cycle.
        let (poses, cycles) = (floor.poses * 1e3, floor.cycles * 1e3);
        let true_model = (0.5 * (poses * poses + cycles * cycles)).sqrt();
        println!("{}: held out {said:.5} mm, the true model {true_model:.5} mm", examined.name);
        assert!((said / true_model - 1.0).abs() < 0.03, "{said} against {true_model}");
    }
}
