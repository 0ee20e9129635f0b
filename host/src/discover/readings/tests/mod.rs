//! Faults hidden in logs of a twin with random heat: found by name and place, with intervals that hold the truth; and
//! nothing found where there is nothing. `READINGS_RUNS` asks for more runs than the quick default.

mod twin;

use super::{Examined, ReadingFault, examine};
use crate::run::TemperatureLog;
use twin::{Dice, Lie, Plan, Twin};

fn runs(quick: u64) -> u64 {
    std::env::var("READINGS_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(quick)
}

fn plan(seed: u64) -> Plan {
    Plan { near_drives: seed.is_multiple_of(3), ..Plan::default() }
}

fn name(sensor: usize, plan: Plan) -> String {
    format!("L{}S{}", sensor / plan.per_link, 1 + sensor % plan.per_link)
}

/// Name and place as they should be found, and the true numbers.
fn truth(lie: Lie, plan: Plan) -> (&'static str, Vec<String>, Vec<(&'static str, f64)>) {
    let at = |sensor| vec![name(sensor, plan)];
    match lie {
        Lie::Chill { sensor, depth_k, tau_s } => {
            ("sensor_chill", at(sensor), vec![("depth_k", depth_k), ("tau_s", tau_s)])
        }
        Lie::Step { sensor, time_s, step_k } => {
            ("sensor_bias", at(sensor), vec![("time_s", time_s), ("step_k", step_k)])
        }
        Lie::Drift { sensor, drift_k_per_h } => ("sensor_bias", at(sensor), vec![("drift_k_per_h", drift_k_per_h)]),
        Lie::Detached { sensor, share } => ("sensor_detached", at(sensor), vec![("air_share", share)]),
        Lie::Swap { one, other } => ("sensor_swap", vec![name(one, plan), name(other, plan)], Vec::new()),
        Lie::Clock { offset_s } => ("clock_offset", Vec::new(), vec![("offset_s", offset_s)]),
    }
}

/// Root mean square of the difference of two logs after each sensor's mean: only changes count.
fn apart(one: &TemperatureLog, other: &TemperatureLog, sensor: &str) -> f64 {
    let (Some(a), Some(b)) = (one.index_of(sensor), other.index_of(sensor)) else { return f64::INFINITY };
    let (a, b) = (&one.series[a], &other.series[b]);
    let pairs: Vec<f64> =
        a.times_s().iter().zip(a.celsius()).filter_map(|(&time, c)| Some(c - b.at(time, 30.0).celsius()?)).collect();
    let mean = pairs.iter().sum::<f64>() / pairs.len() as f64;
    (pairs.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / pairs.len() as f64).sqrt()
}

#[derive(Default)]
struct Tally {
    runs: u64,
    named: u64,
    extra: u64,
    silent: u64,
    intervals: u64,
    held: u64,
    worst_k: f64,
    slowest_s: f64,
}

impl Tally {
    fn rate(&self) -> f64 {
        self.named as f64 / self.runs as f64
    }
}

/// Hides a fault in many runs.
fn hide(first: u64, count: u64, plan: impl Fn(u64) -> Plan, lie: impl Fn(&mut Dice, f64, Plan) -> Lie) -> Tally {
    let mut tally = Tally::default();
    for seed in first..first + count {
        let plan = plan(seed);
        let (twin, hidden) = Twin::new(seed, plan, |dice, end_s| Some(lie(dice, end_s, plan)));
        let hidden = hidden.expect("a lie");
        let (effect, sensors, numbers) = truth(hidden, plan);
        let clock = std::time::Instant::now();
        let Examined { faults, corrected } = examine(&twin.robot, &twin.run);
        tally.slowest_s = tally.slowest_s.max(clock.elapsed().as_secs_f64());
        tally.runs += 1;
        let right = |fault: &ReadingFault| {
            fault.effect == effect
                && fault.sensors == sensors
                && numbers.iter().all(|(name, _)| fault.parameters.iter().any(|p| p.name == *name))
        };
        let found = faults.first().filter(|fault| right(fault));
        let wrong = faults.iter().filter(|fault| !right(fault)).count() as u64;
        tally.extra += wrong;
        tally.silent += u64::from(faults.is_empty());
        if found.is_none() || wrong > 0 {
            println!("seed {seed}: {hidden:?} {sensors:?}");
            faults.iter().for_each(|f| {
                println!("    {} {:?} {:?} ln p {:.1} {:?}", f.effect, f.sensors, f.parameters, f.ln_p, f.alternatives)
            });
        }
        let Some(found) = found else { continue };
        tally.named += 1;
        for (name, value) in numbers {
            let held = found.parameters.iter().any(|p| p.name == name && p.low <= value && value <= p.high);
            if !held {
                println!("seed {seed}: {hidden:?} outside {:?}", found.parameters);
            }
            tally.intervals += 1;
            tally.held += u64::from(held);
        }
        let corrected = corrected.expect("a corrected log");
        for sensor in &sensors {
            tally.worst_k = tally.worst_k.max(apart(&corrected, &twin.honest, sensor));
        }
    }
    println!(
        "{} of {} named, {} silent, {} wrong; {} of {} intervals hold; corrected to {:.3} K; {:.2} s at most",
        tally.named, tally.runs, tally.silent, tally.extra, tally.held, tally.intervals, tally.worst_k, tally.slowest_s
    );
    tally
}

#[test]
fn readings_without_fault_are_silent() {
    let mut false_alarms = 0;
    let count = runs(30);
    for seed in 1000..1000 + count {
        let plan = Plan { per_link: 2 + (seed % 3) as usize, ..plan(seed / 3) };
        let (twin, _) = Twin::new(seed, plan, |_, _| None);
        let examined = examine(&twin.robot, &twin.run);
        if !examined.faults.is_empty() {
            println!("seed {seed} {plan:?}: {:?}", examined.faults);
            false_alarms += 1;
        }
        assert!(examined.corrected.is_some() != examined.faults.is_empty());
    }
    assert_eq!(false_alarms, 0, "of {count}");
}

#[test]
fn readings_chilled_are_named() {
    let tally = hide(2000, runs(20), plan, |dice, _, plan| Lie::Chill {
        sensor: dice.below(5 * plan.per_link),
        depth_k: dice.log_between(0.5, 6.0),
        tau_s: dice.log_between(30.0, 300.0),
    });
    assert!(tally.rate() >= 0.95 && tally.extra == 0);
}

#[test]
fn readings_that_step_are_named() {
    let tally = hide(3000, runs(20), plan, |dice, end_s, plan| Lie::Step {
        sensor: dice.below(5 * plan.per_link),
        time_s: dice.between(0.15, 0.85) * end_s,
        step_k: dice.sign() * dice.log_between(0.3, 3.0),
    });
    assert!(tally.rate() >= 0.9 && tally.extra == 0);
}

#[test]
fn readings_that_drift_are_named() {
    let tally = hide(4000, runs(20), plan, |dice, _, plan| Lie::Drift {
        sensor: dice.below(5 * plan.per_link),
        drift_k_per_h: dice.sign() * dice.log_between(0.3, 1.5),
    });
    assert!(tally.rate() >= 0.9 && tally.extra == 0);
}

#[test]
fn readings_of_air_are_named() {
    let tally = hide(5000, runs(20), plan, |dice, _, plan| Lie::Detached {
        sensor: dice.below(5 * plan.per_link),
        share: dice.between(0.2, 0.7),
    });
    // The faintest of these are within what neighbours differ by; silence about them is right, a wrong name never is.
    assert!(tally.rate() >= 0.75 && tally.extra == 0);
}

#[test]
fn readings_under_exchanged_names_are_named() {
    let tally = hide(6000, runs(20), plan, |dice, _, plan| {
        let one = dice.below(5 * plan.per_link);
        let link = one / plan.per_link;
        let other = ((link + 1 + dice.below(4)) % 5) * plan.per_link + dice.below(plan.per_link);
        Lie::Swap { one: one.min(other), other: one.max(other) }
    });
    // The faintest of these are within what neighbours differ by; silence about them is right, a wrong name never is.
    assert!(tally.rate() >= 0.75 && tally.extra == 0);
}

#[test]
fn readings_of_a_late_clock_are_named() {
    let tally =
        hide(7000, runs(20), plan, |dice, _, _| Lie::Clock { offset_s: dice.sign() * dice.log_between(60.0, 600.0) });
    assert!(tally.rate() >= 0.7 && tally.extra == 0);
}
