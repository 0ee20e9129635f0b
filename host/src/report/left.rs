//! What is left after a discovery, beside what was left before it: by cycle, by pose, and as vectors in space.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::Tried;
use super::figure::{Figure, axis, layout, level_style, shorts, trace, with};
use super::residuals::{Drawing, Vectors, drawn, skeleton};
use crate::discover::Discovery;
use crate::discover::stage::{Point, errors};

/// More poses than this are points instead of bars.
const MOST_BARS: usize = 60;

/// Squares of errors and their number, before and after.
type Sums = BTreeMap<u32, [(f64, f64); 2]>;

/// Residual vectors: the cycle, where it was measured, measured less predicted there, metres.
type InCycle = Vec<(u32, Vector3<f64>, Vector3<f64>)>;

/// The plots; none where nothing was found, as what is left is then what other chapters show.
pub fn figures(tried: &Tried<'_>, discovery: &Discovery) -> Vec<Figure> {
    let found = &discovery.search.last.point;
    if found.effects.is_empty() {
        return Vec::new();
    }
    let visits = &discovery.campaign.visits;
    let (mut cycles, mut poses) = (Sums::new(), Sums::new());
    let mut vectors: [InCycle; 2] = [Vec::new(), Vec::new()];
    for (side, point) in [&discovery.search.baseline.point, found].into_iter().enumerate() {
        each_error(discovery, point, |visit, at, error| {
            let visit = &visits[visit];
            for (sums, number) in [(&mut cycles, visit.cycle), (&mut poses, visit.pose)] {
                let sum = &mut sums.entry(number).or_default()[side];
                *sum = (sum.0 + error.norm_squared(), sum.1 + 1.0);
            }
            vectors[side].push((visit.cycle, at, error));
        });
    }
    let mut figures = Vec::new();
    if cycles.len() > 1 {
        figures.push(by_cycle(tried, discovery, &cycles));
    }
    figures.push(by_pose(&poses));
    figures.push(in_space(tried, discovery, &cycles, vectors));
    figures
}

fn each_error(discovery: &Discovery, point: &Point, mut each: impl FnMut(usize, Vector3<f64>, Vector3<f64>)) {
    let Discovery { campaign, scene, .. } = discovery;
    errors(campaign, scene, point, |visit, target, error| {
        let positions = &campaign.visits[visit].positions;
        if let Some(position) = positions.iter().find(|position| position.target == target) {
            each(visit, position.at, error);
        }
    });
}

fn rms_mm((square, count): (f64, f64)) -> f64 {
    1e3 * (square / count).sqrt()
}

/// The whole of a side.
fn total(sums: &Sums, side: usize) -> f64 {
    rms_mm(sums.values().fold((0.0, 0.0), |sum, own| (sum.0 + own[side].0, sum.1 + own[side].1)))
}

/// The names of the sides, and the level whose looks they have.
const SIDES: [(&str, usize); 2] = [("before", 2), ("with what was found", 3)];

fn by_cycle(tried: &Tried<'_>, discovery: &Discovery, cycles: &Sums) -> Figure {
    let visits = &discovery.campaign.visits;
    let hours = |cycle: u32| {
        let visit = visits.iter().find(|visit| visit.cycle == cycle);
        visit.map_or(0.0, |visit| tried.run.visits[visit.place].time_s / 3600.0)
    };
    let times = shorts(cycles.keys().map(|cycle| hours(*cycle)));
    let traces = SIDES.iter().enumerate().map(|(side, (name, level))| {
        let (color, symbol, dash) = level_style(*level);
        with(
            trace(name, "lines+markers", times.clone(), shorts(cycles.values().map(|own| rms_mm(own[side])))),
            json!({"marker": {"color": color, "symbol": symbol, "size": 7}, "line": {"color": color, "dash": dash}}),
        )
    });
    Figure {
        id: "left-by-cycle".to_owned(),
        title: "What is left by cycle".to_owned(),
        caption: "RMS error of each cycle, fitted, before and after what was found is corrected.".to_owned(),
        alt: format!("RMS error of {} cycles over hours; {}", cycles.len(), words(cycles)),
        height: 340,
        traces: traces.collect(),
        layout: layout([
            ("xaxis", axis("hours since the run began")),
            ("yaxis", with(axis("RMS error, mm"), json!({"rangemode": "tozero"}))),
        ]),
    }
}

fn by_pose(poses: &Sums) -> Figure {
    let bars = poses.len() <= MOST_BARS;
    let numbers: Value = poses.keys().map(|pose| json!(pose)).collect();
    let traces = SIDES.iter().enumerate().map(|(side, (name, level))| {
        let (color, symbol, _) = level_style(*level);
        let sizes = shorts(poses.values().map(|own| rms_mm(own[side])));
        match bars {
            true => with(trace(name, "", numbers.clone(), sizes), json!({"type": "bar", "marker": {"color": color}})),
            false => with(
                trace(name, "markers", numbers.clone(), sizes),
                json!({"marker": {"color": color, "symbol": symbol, "size": 4, "opacity": 0.7}}),
            ),
        }
    });
    Figure {
        id: "left-by-pose".to_owned(),
        title: "What is left by pose".to_owned(),
        caption: "RMS error of each pose over its visits, fitted, before and after what was found is corrected."
            .to_owned(),
        alt: format!("RMS error of {} poses; {}", poses.len(), words(poses)),
        height: 340,
        traces: traces.collect(),
        layout: layout([
            ("xaxis", with(axis("pose"), if bars { json!({"type": "category"}) } else { json!({}) })),
            ("yaxis", with(axis("RMS error, mm"), json!({"rangemode": "tozero"}))),
        ]),
    }
}

fn words(sums: &Sums) -> String {
    format!("{:.3} mm before, {:.3} mm with what was found", total(sums, 0), total(sums, 1))
}

/// The vectors of the cycle in which most was left before.
fn in_space(tried: &Tried<'_>, discovery: &Discovery, cycles: &Sums, vectors: [InCycle; 2]) -> Figure {
    let worst = cycles.iter().max_by(|a, b| rms_mm(a.1[0]).total_cmp(&rms_mm(b.1[0]))).map(|(cycle, _)| *cycle);
    let kinds = vectors.into_iter().zip(SIDES).map(|(points, (name, level))| Vectors {
        name,
        color: level_style(level).0,
        points: points
            .into_iter()
            .filter(|(cycle, ..)| Some(*cycle) == worst)
            .map(|(_, at, error)| (at, error))
            .collect(),
        hidden: false,
        sets_the_size: level == SIDES[0].1,
    });
    let which = match worst.filter(|_| cycles.len() > 1) {
        Some(cycle) => format!("of cycle {cycle}, in which most was left"),
        None => "of the run".to_owned(),
    };
    drawn(&Drawing {
        id: "left-vectors",
        title: "What is left over the arm",
        which: &which,
        hint: "click a name to hide or show it",
        alt: "before and after what was found is corrected",
        kinds: kinds.collect(),
        arm: skeleton(tried, &discovery.calibration.model, worst.map(u64::from)),
    })
}
