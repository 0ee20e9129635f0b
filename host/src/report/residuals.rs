//! What is left at each point, as vectors in space over the arm's skeleton.

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::figure::{Figure, level_style, short, with};
use super::{LEVEL_NAMES, Tried};
use crate::model::{Level, Model};
use crate::robot::Posture;

/// More vectors than this hide each other.
const MOST: usize = 600;
/// A vector that is larger than nine tenths of the others is drawn this large, as a share of the points' extent.
const SHARE: f64 = 0.12;

/// A line through points; breaks where a point is missing.
fn line(name: &str, points: impl IntoIterator<Item = Option<Vector3<f64>>>) -> Value {
    let (mut x, mut y, mut z) = (Vec::new(), Vec::new(), Vec::new());
    for point in points {
        let part = |axis: usize| point.map_or(Value::Null, |point: Vector3<f64>| short(point[axis]));
        x.push(part(0));
        y.push(part(1));
        z.push(part(2));
    }
    json!({"type": "scatter3d", "name": name, "mode": "lines", "x": x, "y": y, "z": z, "connectgaps": false})
}

/// The residual vectors of the cycle that drifts most (of the whole run where there is one cycle only).
pub fn in_space(tried: &Tried<'_>, model: &Model, values: &Value) -> Figure {
    let cycles = values["cycles"].as_array().map_or(&[][..], Vec::as_slice);
    let worst = cycles.iter().max_by(|a, b| {
        let error = |cycle: &Value| cycle["geometric_mm"].as_f64().unwrap_or(0.0);
        error(a).total_cmp(&error(b))
    });
    let cycle = worst.filter(|_| cycles.len() > 1).and_then(|cycle| cycle["cycle"].as_u64());
    let mut levels: Vec<Vec<(Vector3<f64>, Vector3<f64>)>> = vec![Vec::new(); 4];
    tried.trial.errors(|level, visit, target, error| {
        if cycle.is_none_or(|cycle| cycle == u64::from(visit.cycle))
            && let Some(position) = visit.positions.iter().find(|position| position.target == target)
        {
            levels[level].push((position.at, error));
        }
    });
    let same = values["thermal"] == values["geometric"];
    let kinds = levels.into_iter().enumerate().filter(|(place, points)| !points.is_empty() && (*place != 2 || !same));
    let kinds = kinds.map(|(place, points)| Vectors {
        name: LEVEL_NAMES[place],
        color: level_style(place).0,
        points,
        hidden: place == 0,
        sets_the_size: place == 1,
    });
    let which =
        cycle.map_or_else(|| "of all cycles".to_owned(), |cycle| format!("of cycle {cycle}, which drifts most"));
    drawn(&Drawing {
        id: "residual-vectors",
        title: "Residual vectors over the arm",
        which: &which,
        hint: "click 'nominal' to see the arm before calibration",
        alt: "for each level of the model",
        kinds: kinds.collect(),
        arm: skeleton(tried, model, cycle),
    })
}

/// Residual vectors of one kind: where each was measured, and measured less predicted there, metres.
pub(super) struct Vectors {
    /// Its name in the legend.
    pub name: &'static str,
    /// Its colour by name.
    pub color: &'static str,
    /// The points and their errors; those of all kinds are the same points.
    pub points: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Whether it is shown when its name is clicked only.
    pub hidden: bool,
    /// Whether the magnification is chosen for it.
    pub sets_the_size: bool,
}

/// Residual vectors in space, of several kinds.
pub(super) struct Drawing<'a> {
    /// Its name within the page.
    pub id: &'a str,
    /// What stands above it.
    pub title: &'a str,
    /// Which points are drawn.
    pub which: &'a str,
    /// What can be clicked.
    pub hint: &'a str,
    /// What the kinds are, for those who do not see them.
    pub alt: &'a str,
    /// The vectors.
    pub kinds: Vec<Vectors>,
    /// The arm.
    pub arm: Value,
}

/// The plot of residual vectors.
pub(super) fn drawn(drawing: &Drawing<'_>) -> Figure {
    let Drawing { kinds, which, .. } = drawing;
    let all = kinds.first().map_or(&[][..], |kind| &kind.points);
    let step = all.len().div_ceil(MOST).max(1);
    let extent = all
        .iter()
        .flat_map(|(at, _)| [at.min(), at.max()])
        .fold((f64::INFINITY, f64::NEG_INFINITY), |r, v| (r.0.min(v), r.1.max(v)));
    let sizing = kinds.iter().find(|kind| kind.sets_the_size).map_or(all, |kind| &kind.points);
    let mut norms: Vec<f64> = sizing.iter().step_by(step).map(|(_, error)| error.norm()).collect();
    norms.sort_by(f64::total_cmp);
    let large = norms.get(norms.len() * 9 / 10).copied().unwrap_or(0.0).max(1e-9);
    let magnified = nice(SHARE * (extent.1 - extent.0).abs().max(0.1) / large);

    let mut traces = vec![drawing.arm.clone()];
    traces.push(with(
        line("measured points", all.iter().step_by(step).map(|(at, _)| Some(*at))),
        json!({"mode": "markers", "marker": {"size": 2, "color": "@muted"}, "hoverinfo": "skip"}),
    ));
    for kind in kinds {
        let points = || kind.points.iter().step_by(step);
        let ends = points().flat_map(|(at, error)| [Some(*at), Some(at + magnified * error), None]);
        let texts: Vec<Value> = points()
            .flat_map(|(_, error)| {
                let words = json!(format!("{:.3} mm", 1e3 * error.norm()));
                [words.clone(), words, Value::Null]
            })
            .collect();
        let mut vectors = with(
            line(kind.name, ends),
            json!({"line": {"color": kind.color, "width": 4}, "text": texts, "hoverinfo": "text+name"}),
        );
        if kind.hidden {
            vectors["visible"] = json!("legendonly");
        }
        traces.push(vectors);
    }
    let titled = |text: &str| json!({"title": {"text": text}});
    Figure {
        id: drawing.id.to_owned(),
        title: format!("{}, {magnified:.0} times their size", drawing.title),
        caption: format!(
            "From each measured point {which}, measured less predicted, magnified {magnified:.0} times. Drag to turn; {}. \
             Vectors that agree point at a cause; vectors that do not are noise.",
            drawing.hint
        ),
        alt: format!(
            "{} residual vectors in space over the skeleton of the arm, {which}, {}",
            all.len().div_ceil(step),
            drawing.alt
        ),
        height: 560,
        traces,
        layout: json!({"scene": {
            "aspectmode": "data", "camera": {"eye": {"x": 1.0, "y": -1.1, "z": 0.55}}, "xaxis": titled("x, m"), "yaxis": titled("y, m"), "zaxis": titled("z, m"),
        }}),
    }
}

/// The arm at its first posture there, as a line through the origins of its frames.
pub(super) fn skeleton(tried: &Tried<'_>, model: &Model, cycle: Option<u64>) -> Value {
    let visits = &tried.trial.campaign.visits;
    let visit =
        visits.iter().find(|visit| cycle.is_none_or(|cycle| cycle == u64::from(visit.cycle))).or(visits.first());
    let posture = visit.map_or_else(|| Posture::new(&[]), |visit| visit.posture.clone());
    let chain = model.robot.chain();
    let frames = match posture.joints().len() == chain.joint_count() {
        true => chain.prepare(&model.geometry(Level::Thermal).parameters).frames(&posture),
        false => Vec::new(),
    };
    with(
        line("arm", frames.iter().map(|frame| Some(frame.origin))),
        json!({"mode": "lines+markers", "line": {"color": "@text", "width": 9},
               "marker": {"size": 5, "color": "@text"}, "hoverinfo": "name"}),
    )
}

/// The next smaller number of one digit.
fn nice(value: f64) -> f64 {
    let power = 10f64.powf(value.max(1.0).log10().floor());
    (value.max(1.0) / power).floor() * power
}
