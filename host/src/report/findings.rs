//! What was discovered: a table and words for each finding, a plot of its evidence, and what is left.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::Tried;
use super::figure::{Figure, axis, layout, shorts, trace, with};
use super::table::{Form, Table, escaped, list, shown, strings};
use crate::discover::stage::{Point, errors};
use crate::discover::{Discovery, Finding};
use crate::effect::{Instance, UNEXPLAINED, pattern};
use crate::robot::{Posture, Twist};
use crate::run::JoinOptions;

/// More findings than this are told in words alone.
const MOST_FIGURES: usize = 12;
/// Chances below this are not told apart.
const SMALLEST_CHANCE: f64 = 1e-300;
/// More marks than this hide each other.
const MOST_MARKS: usize = 3000;

/// A finding's name and place in words, from its result: "gear eccentricity at joint 2".
pub fn name(finding: &Value) -> String {
    let effect = finding["effect"].as_str().unwrap_or("").replace('_', " ");
    let place = place(&finding["where"]);
    if place.is_empty() { effect } else { format!("{effect} at {place}") }
}

fn place(place: &Value) -> String {
    let mut words = Vec::new();
    match (place["from"].as_u64(), place["joint"].as_u64()) {
        (Some(from), Some(joint)) => words.push(format!("joint {joint} from joint {from}")),
        (None, Some(joint)) => words.push(format!("joint {joint}")),
        _ => {}
    }
    words.extend(["parameter", "sensor", "target"].iter().filter_map(|kind| place[*kind].as_str().map(str::to_owned)));
    for many in ["sensors", "targets"] {
        let names = strings(&place[many]);
        if !names.is_empty() {
            words.push(names.join(" and "));
        }
    }
    words.join(", ")
}

/// The chapter: `figure` gives the HTML of a finding's plot by its place, `left` that of the plots of what is left.
pub fn chapter(results: &Value, figure: impl Fn(usize) -> String, left: &str) -> String {
    let discovery = &results["discovery"];
    let Some(findings) = discovery["findings"].as_array() else {
        return "<p>Nothing was looked for (<code>--no-discover</code>, or a run too small to judge).</p>".to_owned();
    };
    let mut html = list(&strings(&discovery["notes"]));
    let mut levels = Table::new(
        results,
        "Errors before and after what was found is corrected, millimetres",
        &["model", "mean", "RMS", "max", "held-out RMS"],
    );
    for (level, words) in [("baseline", "geometry and temperature"), ("extended", "with what was found")] {
        levels.row(words);
        for field in ["mean_mm", "rms_mm", "max_mm", "heldout_rms_mm"] {
            levels.cell(&format!("/discovery/{level}/{field}"), Form::Fixed(1.0, 4), "–");
        }
        levels.end_row();
    }
    levels.row("noise alone");
    levels.words("");
    levels.cell("/discovery/noise/floor_rms_mm", Form::Fixed(1.0, 4), "–");
    levels.words("");
    levels.words("");
    levels.end_row();
    html += &levels.finish();
    if findings.is_empty() {
        html += "<p>No cause of the catalogue is supported by these data.</p>";
    }
    for (number, finding) in findings.iter().enumerate() {
        html += &one(results, number, finding);
        html += &figure(number);
    }
    let rest = &discovery["unexplained"];
    let chance = chance("/discovery/unexplained/p_value", &rest["p_value"]);
    html += "<h3>What is left</h3>";
    html += &match rest["significant"].as_bool() {
        Some(true) => format!(
            "<p>Something is left that no effect of the catalogue explains: {} mm RMS that follow {} (chance in noise \
             {chance}).</p>",
            shown(&rest["rms_mm"], Form::Fixed(1.0, 4)).unwrap_or_default(),
            escaped(&strings(&rest["follows"]).join(", ")),
        ),
        _ => format!(
            "<p>What is left cannot be told from noise (chance of as much in noise: \
             {chance}).</p>"
        ),
    };
    html + left
}

/// A chance that names its source; one that is smaller than anyone can mean is said in words.
fn chance(pointer: &str, value: &Value) -> String {
    match value.as_f64() {
        Some(chance) if chance < SMALLEST_CHANCE => "below 1e-300".to_owned(),
        _ => format!("<span data-from=\"{pointer}\">{}</span>", shown(value, Form::Power(1)).unwrap_or_default()),
    }
}

fn one(results: &Value, number: usize, finding: &Value) -> String {
    let at = format!("/discovery/findings/{number}");
    let chance = chance(&format!("{at}/p_value"), &finding["p_value"]);
    let mut html = format!("<h3>{}</h3><p>Chance of as much in noise: {chance}.", escaped(&capital(&name(finding))));
    if let Some(cost) = finding["cost_rms_mm"].as_f64().filter(|cost| *cost > 0.0) {
        html += &format!(" It moves the targets by <span data-from=\"{at}/cost_rms_mm\">{cost:.4}</span> mm RMS.");
    }
    if finding["gain"].is_object() {
        let number = |field: &str| {
            let text = shown(&finding["gain"][field], Form::Fixed(1.0, 4)).unwrap_or_default();
            format!("<span data-from=\"{at}/gain/{field}\">{text}</span>")
        };
        html += &format!(
            " Corrected, the RMS error on data that were held out goes from {} to {} mm.",
            number("heldout_rms_mm_before"),
            number("heldout_rms_mm_after")
        );
    }
    if let Some(evidence) = finding["evidence"].as_str() {
        html += &format!(" {}.", escaped(capital(evidence).trim_end_matches('.')));
    }
    html += "</p>";
    let parameters = finding["parameters"].as_array().map_or(&[][..], Vec::as_slice);
    if !parameters.is_empty() {
        let mut table = Table::new(
            results,
            &format!("Numbers of {}, SI units", name(finding)),
            &["number", "value", "95 % from", "to"],
        );
        for (row, parameter) in parameters.iter().enumerate() {
            table.row(parameter["name"].as_str().unwrap_or(""));
            let whole = parameter["value"].as_f64().is_some_and(|value| value.fract() == 0.0);
            let form = if whole { Form::Whole } else { Form::Power(4) };
            for field in ["value", "low", "high"] {
                table.cell(&format!("{at}/parameters/{row}/{field}"), form, "–");
            }
            table.end_row();
        }
        html += &table.finish();
    }
    let others: Vec<String> = finding["alternatives"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|other| {
            let evidence = other["log_evidence"].as_f64().unwrap_or(0.0);
            format!("These data hardly tell it from {} (log evidence {evidence:+.1}).", name(other))
        })
        .collect();
    let points: Vec<String> = finding["points"]
        .as_array()
        .into_iter()
        .flatten()
        .take(10)
        .map(|point| {
            format!(
                "Cycle {}, pose {}, {}: {:.3} mm off, set aside.",
                point["cycle"],
                point["pose"],
                point["target"].as_str().unwrap_or(""),
                point["error_mm"].as_f64().unwrap_or(0.0)
            )
        })
        .collect();
    html + &list(&others) + &list(&points)
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// The plot of a finding's evidence: what is left before and after it is corrected, against what it follows.
pub fn evidence(tried: &Tried<'_>, discovery: &Discovery, number: usize) -> Option<Figure> {
    let finding = discovery.findings.get(number).filter(|_| number < MOST_FIGURES)?;
    let effects = &discovery.search.last.point.effects;
    let own = finding.instance.as_ref().and_then(|instance| {
        effects.iter().position(|other| other.same_name(instance) && other.shape == instance.shape)
    });
    match own {
        Some(place) => {
            let name = format!("{} {}", finding.effect.replace('_', " "), finding.place);
            of_positions(discovery, place, &format!("finding-{number}"), name.trim())
        }
        None => of_readings(tried, discovery, finding, number),
    }
}

/// The plots of what has no name: what is left before and after each part of it, against what it follows.
pub fn nameless(discovery: &Discovery) -> Vec<Figure> {
    let effects = &discovery.search.last.point.effects;
    let nameless = (0..effects.len()).filter(|&place| effects[place].effect.name() == UNEXPLAINED);
    nameless
        .take(MOST_FIGURES)
        .filter_map(|place| {
            let follows = pattern::follows(&discovery.scene, &effects[place].site, &effects[place].shape);
            of_positions(
                discovery,
                place,
                &format!("nameless-{place}"),
                &format!("what follows {}", follows.join(", ")),
            )
        })
        .collect()
}

/// The axis of effects that come with time.
const HOURS: &str = "hours since the run began";

/// What an effect is plotted against: the axis and a number for each visit.
fn covariate(discovery: &Discovery, instance: &Instance) -> (String, Vec<f64>) {
    let scene = &discovery.scene;
    let site = &instance.site;
    let hours = || (HOURS.to_owned(), scene.by_visit(|visit| visit.time_s / 3600.0));
    let position = |joint: usize| {
        let (unit, factor) = if scene.revolute[joint] { ("°", 1f64.to_degrees()) } else { ("mm", 1e3) };
        (format!("joint {}, {unit}", joint + 1), scene.by_visit(|visit| factor * visit.joints[joint]))
    };
    match (instance.effect.name(), site.joint) {
        (UNEXPLAINED, _) => {
            let mut made = vec![0.0; scene.visits.len()];
            for (term, coefficient) in instance.terms(scene).iter().zip(&instance.coefficients) {
                for act in term {
                    made.iter_mut().zip(act.amounts()).for_each(|(made, amount)| *made += 1e6 * coefficient * amount);
                }
            }
            ("what the pattern makes of it, millionths (µm, µrad)".to_owned(), made)
        }
        ("joint_coupling", _) => site.from.map_or_else(hours, position),
        ("gear_eccentricity" | "encoder_gain", Some(joint)) => position(joint),
        ("backlash", Some(joint)) => {
            (format!("direction from which joint {} came", joint + 1), scene.by_visit(|visit| visit.approach[joint]))
        }
        ("joint_compliance" | "lost_motion", Some(joint)) if scene.masses_known => {
            (format!("gravity torque about joint {}, N·m", joint + 1), scene.by_visit(|visit| visit.torques[joint]))
        }
        ("joint_compliance" | "lost_motion", Some(joint)) => position(joint),
        ("joint_log_early", Some(joint)) => (
            format!("way of joint {} to the posture, °", joint + 1),
            scene.by_visit(|visit| {
                visit.before.as_ref().map_or(0.0, |before| (before[joint] - visit.joints[joint]).to_degrees())
            }),
        ),
        ("thermal_growth" | "thermal_nonlinearity", _) if site.sensors.len() == 1 => {
            let sensor = site.sensors[0];
            (
                format!("{} above its reference, K", scene.sensors[sensor].name),
                scene.by_visit(|visit| visit.rises[sensor]),
            )
        }
        _ => hours(),
    }
}

/// What an effect found in positions acts as, and how a residual is seen along it.
enum Along {
    /// A joint's error.
    Joint(usize),
    /// A parameter's error.
    Parameter(usize),
    /// The way that the effect itself moves a point.
    Itself,
}

/// The plot of an effect by its place among those of the last fit.
fn of_positions(discovery: &Discovery, place: usize, id: &str, name: &str) -> Option<Figure> {
    let Discovery { campaign, scene, .. } = discovery;
    let with_all = &discovery.search.last.point;
    let instance = &with_all.effects[place];
    let mut without = Point { state: with_all.state.clone(), effects: with_all.effects.clone() };
    without.effects.remove(place);
    let (mut before, mut after) = (Vec::new(), Vec::new());
    errors(campaign, scene, &without, |visit, target, error| before.push((visit, target, error)));
    errors(campaign, scene, with_all, |visit, target, error| after.push((visit, target, error)));
    let chain = &campaign.chain;
    let along = match (instance.site.joint, instance.site.parameter) {
        // Where both stand, the joint is where heat comes from.
        (_, Some(parameter)) => Along::Parameter(parameter),
        (Some(joint), None) => Along::Joint(joint),
        (None, None) => Along::Itself,
    };
    let prepared = chain.prepare(&with_all.state.geometry.parameters);
    let mut parameter_twists = vec![Twist::default(); chain.parameters().len()];
    let mut joint_twists = vec![Twist::default(); chain.joint_count()];
    let (title, at) = covariate(discovery, instance);
    // By visit: what its points say of the error along the effect, by least squares over them.
    let visits = campaign.visits.len();
    let mut sums = vec![[0.0_f64; 3]; visits];
    for ((visit, target, old), (_, _, new)) in before.iter().zip(&after) {
        let way = match along {
            Along::Itself => {
                let moved = old - new;
                if moved.norm() == 0.0 {
                    continue;
                }
                moved.normalize()
            }
            Along::Joint(_) | Along::Parameter(_) => {
                let posture = Posture::new(&scene.visits[*visit].joints);
                let flange = prepared.twists(&posture, &mut parameter_twists, &mut joint_twists);
                let twist = match along {
                    Along::Joint(joint) => joint_twists[joint],
                    Along::Parameter(parameter) => parameter_twists[parameter],
                    Along::Itself => continue,
                };
                let target = with_all.state.geometry.targets[*target];
                flange.rotation * nalgebra::Vector3::from(twist.at(&[target.x, target.y, target.z]))
            }
        };
        let sum = &mut sums[*visit];
        sum[0] += way.norm_squared();
        sum[1] += way.dot(old);
        sum[2] += way.dot(new);
    }
    let (what, factor) = match along {
        Along::Joint(joint) if scene.revolute[joint] => (format!("error of joint {}, µrad", joint + 1), 1e6),
        Along::Joint(joint) => (format!("error of joint {}, µm", joint + 1), 1e6),
        Along::Parameter(parameter) => {
            let id = chain.parameters()[parameter];
            (format!("error of {id}, {}", if id.symbol.is_angle() { "µrad" } else { "µm" }), 1e6)
        }
        Along::Itself => ("error along it, µm".to_owned(), 1e6),
    };
    let known: Vec<usize> = (0..visits).filter(|&visit| sums[visit][0] > 1e-12).collect();
    let step = known.len().div_ceil(MOST_MARKS).max(1);
    let known: Vec<usize> = known.into_iter().step_by(step).collect();
    if known.is_empty() {
        return None;
    }
    let side = |number: usize| -> Vec<f64> {
        known.iter().map(|&visit| factor * sums[visit][number] / sums[visit][0]).collect()
    };
    let (mut old, mut new) = (side(1), side(2));
    let changes = title == HOURS;
    if changes {
        // What stays with a posture says nothing of what comes with time, and would hide it.
        let mut stays: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
        for (&visit, error) in known.iter().zip(&new) {
            let (sum, count) = stays.entry(scene.visits[visit].pose).or_default();
            *sum += error;
            *count += 1.0;
        }
        for (place, &visit) in known.iter().enumerate() {
            if let Some((sum, count)) = stays.get(&scene.visits[visit].pose) {
                old[place] -= sum / count;
                new[place] -= sum / count;
            }
        }
    }
    let rms = |values: &[f64]| (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt();
    let words = format!("RMS {:.1} before, {:.1} after", rms(&old), rms(&new));
    let x = shorts(known.iter().map(|&visit| at[visit]));
    let marks =
        |color: &str, symbol: &str| json!({"marker": {"color": color, "symbol": symbol, "size": 5, "opacity": 0.75}});
    Some(Figure {
        id: id.to_owned(),
        title: format!("Evidence: {name}"),
        caption: format!(
            "Each mark is one visit: what its residuals say, before and after the correction{}. {words}.",
            if changes { ", less what stays with its posture" } else { "" }
        ),
        alt: format!("{what} against {title}, before and after {name} is corrected: {words}"),
        height: 360,
        traces: vec![
            with(trace("before", "markers", x.clone(), shorts(old)), marks("@geometric", "circle-open")),
            with(trace("after", "markers", x, shorts(new)), marks("@thermal", "diamond")),
        ],
        layout: layout([("xaxis", axis(&title)), ("yaxis", axis(&what))]),
    })
}

/// For faults of readings: what a sensor read at the visits, and what it would have read without the fault.
fn of_readings(tried: &Tried<'_>, discovery: &Discovery, finding: &Finding, number: usize) -> Option<Figure> {
    if !finding.points.is_empty() {
        return of_points(tried, finding, number);
    }
    let mut sensors: Vec<String> = finding.place.sensor.iter().chain(&finding.place.sensors).cloned().collect();
    if sensors.is_empty() && finding.effect == "clock_offset" {
        sensors.extend(discovery.calibration.campaign.sensors.iter().take(2).cloned());
    }
    let log = tried.run.temperatures.as_ref()?;
    let campaign = &discovery.calibration.campaign;
    let mut traces = Vec::new();
    for (place, name) in sensors.iter().enumerate() {
        let series = &log.series[log.index_of(name)?];
        let gap = series.max_gap_s(&JoinOptions::default());
        let step = campaign.visits.len().div_ceil(MOST_MARKS).max(1);
        let own = campaign.sensors.iter().position(|known| known == name)?;
        let zero = discovery.calibration.model.temperatures.iter().find(|reference| reference.sensor == *name)?.celsius;
        let (mut times, mut read, mut right) = (Vec::new(), Vec::new(), Vec::new());
        for visit in campaign.visits.iter().step_by(step) {
            let time = tried.run.visits[visit.place].time_s;
            times.push(time / 3600.0);
            read.push(series.at(time, gap).celsius().unwrap_or(f64::NAN));
            right.push(zero + visit.rises[own]);
        }
        let color = ["@geometric", "@extended"][place % 2];
        traces.push(with(
            trace(&format!("{name} as read"), "markers", shorts(times.clone()), shorts(read)),
            json!({"marker": {"color": color, "symbol": "circle-open", "size": 5}}),
        ));
        traces.push(with(
            trace(&format!("{name} corrected"), "lines", shorts(times), shorts(right)),
            json!({"line": {"color": (["@thermal", "@nominal"][place % 2]), "width": 2}}),
        ));
    }
    if traces.is_empty() {
        return None;
    }
    let name = finding.effect.replace('_', " ");
    Some(Figure {
        id: format!("finding-{number}"),
        title: format!("Evidence: {name} {}", finding.place),
        caption: "Marks: what the log says at each visit; lines: the same with the fault undone.".to_owned(),
        alt: format!("Temperatures of {} at the visits, as read and with the fault undone", sensors.join(" and ")),
        height: 360,
        traces,
        layout: layout([("xaxis", axis(HOURS)), ("yaxis", axis("temperature, °C"))]),
    })
}

/// For points that are plainly wrong: how far each is off, over time.
fn of_points(tried: &Tried<'_>, finding: &Finding, number: usize) -> Option<Figure> {
    let times = finding.points.iter().map(|point| tried.run.visits[point.visit].time_s / 3600.0);
    let off = finding.points.iter().map(|point| 1e3 * point.error);
    let marks = json!({"marker": {"color": "@thermal", "symbol": "x", "size": 8}});
    Some(Figure {
        id: format!("finding-{number}"),
        title: "Evidence: points set aside".to_owned(),
        caption: "How far each point that was set aside is from where the model has it.".to_owned(),
        alt: format!("Errors of {} points that were set aside, over time", finding.points.len()),
        height: 300,
        traces: vec![with(trace("set aside", "markers", shorts(times), shorts(off)), marks)],
        layout: layout([("xaxis", axis(HOURS)), ("yaxis", with(axis("error, mm"), json!({"rangemode": "tozero"})))]),
    })
}
