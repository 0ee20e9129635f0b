//! The memory that an identification takes must not grow with the number of points. The only test of its process: no other
//! may allocate meanwhile.

use peak_alloc::PeakAlloc;
use thermokin::calibrate::{Campaign, Manner, ObservedPosition, ObservedVisit, State, geometric_unknowns, identify};
use thermokin::model::Geometry;
use thermokin::robot::{Posture, shipped};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// The COMAU, a millimetre and a milliradian off, at so many postures spread by the golden ratio.
fn campaign(visits: usize) -> (Campaign, State) {
    let robot = shipped("comau-nj-130-2.0").expect("a shipped arm");
    let chain = robot.chain();
    let geometry = Geometry::nominal(&robot);
    let truth: Vec<f64> = geometry.parameters.iter().enumerate().map(|(k, v)| v + 1e-3 * (k as f64).cos()).collect();
    let prepared = chain.prepare(&truth);
    let visits = (0..visits)
        .map(|number| {
            let spread =
                |joint: usize| 2.4 * ((number as f64 + 0.5) * 0.618_034 * (joint as f64 + 1.0).sqrt()).fract() - 1.2;
            let posture = Posture::new(&std::array::from_fn::<f64, 6, _>(spread));
            let flange = prepared.flange(&posture);
            let positions =
                (0..4).map(|target| ObservedPosition { target, at: flange.point(&geometry.targets[target]) });
            ObservedVisit {
                place: number,
                cycle: 0,
                pose: number as u32,
                posture,
                rises: Vec::new(),
                positions: positions.collect(),
                sigma: 4e-6,
                turns: Vec::new(),
                turn_sigma: 1.0,
                distances: Vec::new(),
            }
        })
        .collect();
    let targets = robot.targets.iter().map(|target| target.name.clone()).collect();
    let campaign = Campaign { chain, targets, anchors: Vec::new(), sensors: Vec::new(), growth: Vec::new(), visits };
    (campaign, State { geometry, growth: Vec::new() })
}

/// Bytes that an identification takes beyond what stood before it.
fn taken(visits: usize) -> usize {
    let (campaign, start) = campaign(visits);
    let unknowns = geometric_unknowns(&campaign, &[], &[], &[]);
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let found = identify(&campaign, unknowns, start, &Manner::default());
    assert!(found.solution.stop.converged());
    ALLOCATOR.peak_usage() - before
}

#[test]
fn a_hundred_times_the_points_take_no_more_memory() {
    let (few, many) = (taken(200), taken(20_000));
    assert!(many <= few + few / 10, "{few} bytes for 800 points, {many} bytes for 80,000");
}
