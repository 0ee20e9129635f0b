//! How long a discovery takes, and how that grows. `cargo bench -p thermokin --bench discover`.
//!
//! Runs are simulated with one effect hidden: `whole` is a discovery with held-out gains of 24 cycles, 15 poses and 4 targets;
//! the other groups leave held-out gains away and change one size each. `catalogue` is one scan of a part of the candidates.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, SamplingMode, criterion_group, criterion_main};
use thermokin::discover::candidates::{Ground, candidates};
use thermokin::discover::{DiscoveryRequest, discover};
use thermokin::simulate::{HiddenEffect, Scenario, Simulated, simulate};

/// The thesis's arm with a gear's error in place of those that no effect names.
fn scenario(cycles: u32, poses: usize, sensors_a_link: usize) -> Scenario {
    let mut scenario = Scenario::shipped("thesis-75-25").expect("it ships");
    scenario.arm.transmission_error_rad = 0.0;
    let [warm, cool] = [cycles / 2, cycles - cycles / 2];
    for (phase, cycles) in scenario.schedule.phases.iter_mut().zip([warm, cool]) {
        phase.cycles = cycles;
    }
    if let Some(drawn) = &mut scenario.postures.drawn {
        drawn.count = poses;
    }
    let mut seen = std::collections::BTreeMap::new();
    scenario.robot.sensors.retain(|sensor| {
        let count = seen.entry(sensor.link).or_insert(0);
        *count += 1;
        *count <= sensors_a_link
    });
    scenario.effects.push(HiddenEffect {
        effect: "gear_eccentricity".to_owned(),
        place: thermokin::effect::SiteNames { joint: Some(3), ..Default::default() },
        parameters: [("amplitude_rad", 1e-4), ("phase_rad", 0.4), ("harmonic", 2.0)]
            .map(|(name, value)| (name.to_owned(), value))
            .into(),
    });
    scenario
}

fn run(cycles: u32, poses: usize, sensors_a_link: usize) -> Simulated {
    simulate(&scenario(cycles, poses, sensors_a_link)).expect("it can be simulated")
}

fn discovery(criterion: &mut Criterion) {
    let request = |hold_out| DiscoveryRequest { seed: 1, hold_out, ..DiscoveryRequest::default() };
    let mut group = criterion.benchmark_group("discover");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    let whole = run(24, 15, 4);
    group.bench_function("whole", |bencher| {
        bencher
            .iter(|| discover(&whole.robot, &whole.run, &request(true)).map(|found| black_box(found.findings.len())));
    });
    let mut grows = |name: &str, sizes: [u32; 3], make: fn(u32) -> Simulated| {
        for size in sizes {
            let made = make(size);
            group.bench_with_input(BenchmarkId::new(name, size), &made, |bencher, made| {
                bencher.iter(|| {
                    discover(&made.robot, &made.run, &request(false)).map(|found| black_box(found.findings.len()))
                });
            });
        }
    };
    grows("cycles", [12, 24, 48], |cycles| run(cycles, 15, 4));
    grows("poses", [15, 30, 60], |poses| run(24, poses as usize, 4));
    grows("sensors a link", [1, 2, 4], |sensors| run(24, 15, sensors as usize));
    let found = discover(&whole.robot, &whole.run, &request(false)).expect("large enough");
    let all = candidates(&found.scene);
    let baseline = &found.search.baseline;
    let ground = Ground::new(&baseline.stage, &baseline.strata, &found.scene, &found.search.trials);
    for parts in [4, 2, 1] {
        // Every fourth, every second and every candidate: effects are listed one after the other.
        let some: Vec<_> = all.iter().step_by(parts).cloned().collect();
        group.bench_with_input(BenchmarkId::new("catalogue", some.len()), &some, |bencher, some| {
            bencher.iter(|| black_box(ground.score(some).len()));
        });
    }
    group.finish();
}

criterion_group!(benches, discovery);
criterion_main!(benches);
