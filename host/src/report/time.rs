//! Plots over the run's time and over its poses: errors beside temperatures (thesis figs. 4.17, 4.18), errors by pose (4.15,
//! 4.16), identified against predicted parameters (4.10 to 4.14).

use serde_json::{Value, json};

use super::figure::{Figure, axis, layout, level_style, series_color, short, shorts, trace, with};
use super::{LEVEL_NAMES, Tried};
use crate::calibrate::Calibration;
use crate::model::{Level, Model};
use crate::run::JoinOptions;

/// Temperatures are drawn at so many times.
const TIMES: usize = 240;
/// More poses than this are points instead of bars.
const MOST_BARS: usize = 60;

fn hours(time_s: f64) -> f64 {
    time_s / 3600.0
}

/// Mean temperature of each link's sensors, and of the air, over a run: name, times in hours, °C.
fn link_temperatures(tried: &Tried<'_>) -> Vec<(String, Vec<f64>, Vec<f64>)> {
    let Some(log) = &tried.run.temperatures else { return Vec::new() };
    let first = log.series.iter().filter_map(|series| series.times_s().first()).copied().fold(f64::INFINITY, f64::min);
    let last =
        log.series.iter().filter_map(|series| series.times_s().last()).copied().fold(f64::NEG_INFINITY, f64::max);
    if first >= last {
        return Vec::new();
    }
    let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
    let mut join = |name: String, sensor: usize| match groups.iter_mut().find(|(known, _)| *known == name) {
        Some((_, sensors)) => sensors.push(sensor),
        None => groups.push((name, vec![sensor])),
    };
    for (sensor, name) in log.sensors.iter().enumerate() {
        if let Some(place) = tried.robot.sensor(name) {
            join(format!("link {}", tried.robot.sensors[place].link), sensor);
        } else if tried.run.description.ambient.as_ref() == Some(name) {
            join("air".to_owned(), sensor);
        }
    }
    groups.sort();
    let times: Vec<f64> = (0..TIMES).map(|i| first + (last - first) * i as f64 / (TIMES - 1) as f64).collect();
    groups
        .into_iter()
        .map(|(name, sensors)| {
            let (mut at, mut celsius) = (Vec::new(), Vec::new());
            for &time in &times {
                let read: Vec<f64> = sensors
                    .iter()
                    .filter_map(|&sensor| {
                        let series = &log.series[sensor];
                        series.at(time, series.max_gap_s(&JoinOptions::default())).celsius()
                    })
                    .collect();
                if !read.is_empty() {
                    at.push(hours(time));
                    celsius.push(read.iter().sum::<f64>() / read.len() as f64);
                }
            }
            (name, at, celsius)
        })
        .collect()
}

/// The errors of each level over a run beside the temperatures of the links; `values` are the run's in the results.
pub fn over_time(id: &str, whose: &str, tried: &Tried<'_>, values: &Value) -> Figure {
    let mut traces = Vec::new();
    let cycles = values["cycles"].as_array().map_or(&[][..], Vec::as_slice);
    let by_cycle = cycles.len() > 1;
    if by_cycle {
        let times = shorts(cycles.iter().map(|cycle| hours(cycle["time_s"].as_f64().unwrap_or(0.0))));
        for (place, level) in LEVEL_NAMES.iter().enumerate().filter(|(_, level)| values[**level].is_object()) {
            let (color, symbol, dash) = level_style(place);
            let means = cycles.iter().map(|cycle| cycle[format!("{level}_mm")].clone()).collect();
            // The nominal arm is so far off that beside it nothing else shows: its line comes when its name is clicked.
            let visible = if place == 0 { json!("legendonly") } else { json!(true) };
            traces.push(with(
                trace(level, "lines+markers", times.clone(), means),
                json!({
                    "marker": {"color": color, "symbol": symbol, "size": 7}, "line": {"color": color, "dash": dash},
                    "visible": visible,
                }),
            ));
        }
    } else {
        let mut each: Vec<(Vec<f64>, Vec<f64>)> = vec![Default::default(); 4];
        tried.trial.errors(|level, visit, _, error| {
            each[level].0.push(hours(tried.run.visits[visit.place].time_s));
            each[level].1.push(1e3 * error.norm());
        });
        for (place, (times, errors)) in each.into_iter().enumerate().filter(|(_, (times, _))| !times.is_empty()) {
            let (color, symbol, _) = level_style(place);
            // Thermal is the same as geometric where nothing grows: two clouds would hide each other.
            if place == 2 && values["thermal"] == values["geometric"] {
                continue;
            }
            traces.push(with(
                trace(LEVEL_NAMES[place], "markers", shorts(times), shorts(errors)),
                json!({"marker": {"color": color, "symbol": symbol, "size": 4, "opacity": 0.7}}),
            ));
        }
    }
    let temperatures = link_temperatures(tried);
    let has_temperatures = !temperatures.is_empty();
    for (place, (name, times, celsius)) in temperatures.into_iter().enumerate() {
        let dash = if name == "air" { "dot" } else { "solid" };
        let line = json!({"line": {"color": series_color(place), "width": 1.6, "dash": dash}, "yaxis": "y2", "legend": "legend2"});
        traces.push(with(trace(&name, "lines", shorts(times), shorts(celsius)), line));
    }
    let errors = if by_cycle { "mean error, mm" } else { "error, mm" };
    let plot = match has_temperatures {
        true => layout([
            ("xaxis", with(axis("hours since the run began"), json!({"anchor": "y2"}))),
            ("yaxis", with(axis(errors), json!({"domain": [0.46, 1.0], "rangemode": "tozero"}))),
            ("yaxis2", with(axis("temperature, °C"), json!({"domain": [0.0, 0.38]}))),
            ("legend", json!({"y": 1.0})),
            ("legend2", json!({"y": 0.4})),
        ]),
        false => layout([
            ("xaxis", axis("hours since the run began")),
            ("yaxis", with(axis(errors), json!({"rangemode": "tozero"}))),
        ]),
    };
    let unit = if by_cycle { "Each mark is the mean over the points of one cycle" } else { "Each mark is one point" };
    Figure {
        id: id.to_owned(),
        title: format!("Errors over time, {whose}"),
        caption: format!(
            "{unit}{}. Click a name to hide or show it{}, drag to zoom, double-click to return.",
            if has_temperatures { "; below, the mean temperature of each link's sensors and of the air" } else { "" },
            if by_cycle { " (the nominal arm is hidden at first)" } else { "" }
        ),
        alt: format!("Position error over hours by level of the model, {whose}. {}", span_words(values)),
        height: if has_temperatures { 560 } else { 380 },
        traces,
        layout: plot,
    }
}

/// "geometric 0.31 mm on average, thermal 0.21 mm".
fn span_words(values: &Value) -> String {
    let words: Vec<String> = LEVEL_NAMES
        .iter()
        .filter_map(|level| Some(format!("{level} {:.3} mm on average", values[*level]["mean_mm"].as_f64()?)))
        .collect();
    words.join(", ")
}

/// The errors of each level by pose.
pub fn by_pose(id: &str, whose: &str, values: &Value) -> Figure {
    let poses = values["poses"].as_array().map_or(&[][..], Vec::as_slice);
    let bars = poses.len() <= MOST_BARS;
    let numbers: Value = poses.iter().map(|pose| pose["pose"].clone()).collect();
    let mut traces = Vec::new();
    for (place, level) in LEVEL_NAMES.iter().enumerate().filter(|(_, level)| values[**level].is_object()) {
        if place == 2 && values["thermal"] == values["geometric"] {
            continue;
        }
        let (color, symbol, _) = level_style(place);
        let means: Value =
            poses.iter().map(|pose| short(pose[format!("{level}_mm")].as_f64().unwrap_or(0.0))).collect();
        let pattern = ["", "/", "", "x"][place];
        traces.push(match bars {
            true => with(
                trace(level, "", numbers.clone(), means),
                json!({"type": "bar", "marker": {"color": color, "pattern": {"shape": pattern, "fillmode": "overlay", "size": 5}}}),
            ),
            false => with(
                trace(level, "markers", numbers.clone(), means),
                json!({"marker": {"color": color, "symbol": symbol, "size": 4, "opacity": 0.7}}),
            ),
        });
    }
    let x = with(axis("pose"), if bars { json!({"type": "category"}) } else { json!({}) });
    Figure {
        id: id.to_owned(),
        title: format!("Errors by pose before and after, {whose}"),
        caption: "Mean over all targets and cycles of a pose: an even height says that no posture is special."
            .to_owned(),
        alt: format!(
            "Mean position error of {} poses by level of the model, {whose}. {}",
            poses.len(),
            span_words(values)
        ),
        height: 380,
        traces,
        layout: layout([("xaxis", x), ("yaxis", with(axis("mean error, mm"), json!({"rangemode": "tozero"})))]),
    }
}

/// How each growing parameter was found at every cycle alone, and how the model predicts it from temperatures.
pub fn identified_and_predicted(tried: &Tried<'_>, model: &Model, calibration: &Calibration) -> Option<Figure> {
    let cycles = &calibration.per_cycle.as_ref()?.cycles;
    let zero = cycles.iter().find(|cycle| cycle.cycle == tried.run.description.reference_cycle)?;
    let mut names: Vec<crate::robot::ParameterId> = model.growth.iter().map(|growth| growth.parameter).collect();
    names.sort();
    names.dedup();
    let chain = model.robot.chain();
    let columns = if names.len() > 1 { 2 } else { 1 };
    let rows = names.len().div_ceil(columns);
    let celsius = |rises: &[f64]| -> Vec<Option<f64>> {
        // Rises are from the run's own reference, which the model's may differ from.
        let at = |name: &str| calibration.campaign.sensors.iter().position(|known| known == name);
        model
            .sensors()
            .into_iter()
            .map(|name| {
                let own = calibration.model.temperatures.iter().find(|reference| reference.sensor == name)?;
                Some(own.celsius + rises[at(name)?])
            })
            .collect()
    };
    let time =
        |cycle: u32| tried.run.visits.iter().find(|visit| visit.cycle == cycle).map_or(0.0, |visit| visit.time_s);
    let times = shorts(cycles.iter().map(|cycle| hours(time(cycle.cycle))));
    let mut traces = Vec::new();
    let mut axes = serde_json::Map::new();
    let mut worst = 0.0_f64;
    for (number, &name) in names.iter().enumerate() {
        let place = chain.place(name)?;
        let (factor, unit) = (1e6, if name.symbol.is_angle() { "µrad" } else { "µm" });
        let predicted = |rises: &[f64]| model.parameters_at(Level::Thermal, &chain, &celsius(rises))[place];
        let identified: Vec<f64> =
            cycles.iter().map(|cycle| factor * (cycle.parameters[place] - zero.parameters[place])).collect();
        let foretold: Vec<f64> =
            cycles.iter().map(|cycle| factor * (predicted(&cycle.rises) - predicted(&zero.rises))).collect();
        worst = identified.iter().zip(&foretold).map(|(a, b)| (a - b).abs()).fold(worst, f64::max);
        let own = |letter: &str| if number == 0 { letter.to_owned() } else { format!("{letter}{}", number + 1) };
        let on = json!({"xaxis": own("x"), "yaxis": own("y"), "showlegend": number == 0});
        traces.push(with(
            with(trace("identified at each cycle alone", "markers", times.clone(), shorts(identified)), on.clone()),
            json!({"legendgroup": "identified", "marker": {"color": "@geometric", "symbol": "circle-open", "size": 7}}),
        ));
        traces.push(with(
            with(trace("predicted from temperatures", "lines", times.clone(), shorts(foretold)), on),
            json!({"legendgroup": "predicted", "line": {"color": "@thermal", "width": 2}}),
        ));
        let (row, column) = (number / columns, number % columns);
        let (height, width) = (1.0 / rows as f64, 1.0 / columns as f64);
        let top = 1.0 - row as f64 * height;
        let left = column as f64 * width + if column > 0 { 0.06 } else { 0.0 };
        let right = (column + 1) as f64 * width - if columns > 1 && column == 0 { 0.04 } else { 0.0 };
        let last_row = number + columns >= names.len();
        let title = if last_row { "hours" } else { "" };
        axes.insert(
            own("x").replace('x', "xaxis"),
            with(axis(title), json!({"domain": [left, right], "anchor": own("y")})),
        );
        axes.insert(
            own("y").replace('y', "yaxis"),
            with(
                axis(&format!("{name}, {unit}")),
                json!({"domain": [top - height + 0.22 * height, top], "anchor": own("x")}),
            ),
        );
    }
    axes.insert("legend".to_owned(), json!({"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"}));
    let list: Vec<String> = names.iter().map(ToString::to_string).collect();
    Some(Figure {
        id: "thermal-parameters".to_owned(),
        title: "Identified and predicted thermal parameters".to_owned(),
        caption: "Changes since the reference cycle. Marks: a geometric calibration at each cycle alone, free to find anything; \
                  lines: what the model's coefficients make of the temperatures. Where marks leave the line, the parameter \
                  follows something that the sensors do not see."
            .to_owned(),
        alt: format!(
            "Changes of {} over the run, identified at each cycle and predicted from temperatures; they differ by at most \
             {worst:.0} millionths (µm or µrad)",
            list.join(", ")
        ),
        height: 90 + 210 * rows as u32,
        traces,
        layout: Value::Object(axes),
    })
}
