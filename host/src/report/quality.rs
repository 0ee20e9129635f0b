//! How good the data are: points that are missing, readings that are lost, sensors that misbehaved, clocks.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

use super::table::{Form, Table, escaped, list, strings};
use crate::robot::Robot;
use crate::run::{JoinOptions, Run};

/// What of a run's data is there and what is not.
#[derive(Debug, Clone, Serialize)]
pub struct Quality {
    /// Visits of the run.
    pub visits: usize,
    /// Positions measured.
    pub points: usize,
    /// Measurements that were tried and gave nothing.
    pub broken_beams: usize,
    /// By target.
    pub targets: Vec<TargetQuality>,
    /// By sensor.
    pub sensors: Vec<SensorQuality>,
    /// What the log of the link boards said of itself when it was exported.
    pub link: Option<LinkQuality>,
    /// What was odd but usable, in words.
    pub notes: Vec<String>,
}

/// A target's measurements.
#[derive(Debug, Clone, Serialize)]
pub struct TargetQuality {
    /// Its name.
    pub name: String,
    /// Visits at which it was measured.
    pub measured: usize,
    /// Visits at which its beam was broken.
    pub broken: usize,
    /// Visits at which nothing was tried.
    pub absent: usize,
}

/// A sensor's readings.
#[derive(Debug, Clone, Serialize)]
pub struct SensorQuality {
    /// Its name.
    pub name: String,
    /// The link it is glued to; none for one that robot.toml does not name.
    pub link: Option<usize>,
    /// Readings.
    pub readings: usize,
    /// Median time between them, s.
    pub period_s: Option<f64>,
    /// The longest time between two of them, s.
    pub longest_gap_s: Option<f64>,
    /// Readings that its period lets expect and that are not there.
    pub lost: usize,
    /// The lowest reading, °C.
    pub lowest_c: Option<f64>,
    /// The highest reading, °C.
    pub highest_c: Option<f64>,
    /// Visits without a temperature.
    pub missing_at_visits: usize,
    /// Visits that took the nearest reading across a gap.
    pub held_at_visits: usize,
}

/// What `log export --json` says of a log.
#[derive(Debug, Clone, Serialize, serde::Deserialize)]
pub struct LinkQuality {
    /// Readings written.
    pub readings: u64,
    /// Readings that have a status instead of a value.
    pub missing: u64,
    /// Readings beyond their sensor's range.
    pub out_of_range: u64,
    /// The greatest uncertainty of a reading's time, s.
    pub time_uncertainty_s: f64,
    /// Readings whose time has no uncertainty.
    pub times_unbounded: u64,
}

/// A time between readings of more than this many periods has readings lost in it.
const LOST_AFTER: f64 = 1.5;

impl Quality {
    /// Looks through a run.
    pub fn of(run: &Run, robot: &Robot, join: &JoinOptions, link: Option<LinkQuality>) -> Quality {
        let mut targets: BTreeMap<usize, (usize, usize)> = BTreeMap::new();
        for visit in &run.visits {
            visit.points.iter().for_each(|point| targets.entry(point.target).or_default().0 += 1);
            for beam in visit.broken_beams.iter().filter(|beam| beam.anchor.is_none()) {
                targets.entry(beam.target).or_default().1 += 1;
            }
        }
        let table = run.temperatures_at_visits(join);
        let sensors =
            run.temperatures.iter().flat_map(|log| log.sensors.iter().zip(&log.series)).map(|(name, series)| {
                let period_s = series.median_period_s();
                let gaps = series.times_s().windows(2).map(|pair| pair[1] - pair[0]);
                let lost: f64 = period_s.filter(|period| *period > 0.0).map_or(0.0, |period| {
                    gaps.clone().filter(|gap| *gap > LOST_AFTER * period).map(|gap| (gap / period).round() - 1.0).sum()
                });
                let extreme = |pick: fn(f64, f64) -> f64| series.celsius().iter().copied().reduce(pick);
                let joined = table.report.iter().find(|join| join.sensor == *name);
                SensorQuality {
                    name: name.clone(),
                    link: robot.sensor(name).map(|place| robot.sensors[place].link),
                    readings: series.times_s().len(),
                    period_s,
                    longest_gap_s: gaps.reduce(f64::max),
                    lost: lost as usize,
                    lowest_c: extreme(f64::min),
                    highest_c: extreme(f64::max),
                    missing_at_visits: joined.map_or(0, |join| join.missing),
                    held_at_visits: joined.map_or(0, |join| join.held),
                }
            });
        Quality {
            visits: run.visits.len(),
            points: run.point_count(),
            broken_beams: run.visits.iter().map(|visit| visit.broken_beams.len()).sum(),
            targets: targets
                .into_iter()
                .map(|(target, (measured, broken))| TargetQuality {
                    name: run.target_names[target].clone(),
                    measured,
                    broken,
                    absent: run.visits.len().saturating_sub(measured + broken),
                })
                .collect(),
            sensors: sensors.collect(),
            link,
            notes: run.notes.clone(),
        }
    }
}

/// The effects that are faults of what was measured, by how their names begin.
const FAULTS: [&str; 6] = ["sensor_", "clock_", "outliers", "target_", "tool_slip", "frame_"];

/// The chapter.
pub fn chapter(results: &Value) -> String {
    let rows = |what: &str| results["quality"][what].as_array().map_or(&[][..], Vec::as_slice);
    let mut targets = Table::new(results, "Visits of each target", &["target", "measured", "beam broken", "not tried"]);
    for (row, target) in rows("targets").iter().enumerate() {
        targets.row(target["name"].as_str().unwrap_or(""));
        for field in ["measured", "broken", "absent"] {
            targets.cell(&format!("/quality/targets/{row}/{field}"), Form::Whole, "–");
        }
        targets.end_row();
    }
    let mut html = targets.finish();
    if rows("sensors").is_empty() {
        html += "<p>The run has no temperatures.</p>";
    } else {
        let heads = [
            "sensor",
            "link",
            "readings",
            "period s",
            "longest gap s",
            "lost",
            "lowest °C",
            "highest °C",
            "visits without",
        ];
        let mut sensors = Table::new(results, "Readings of each temperature sensor", &heads);
        for (row, sensor) in rows("sensors").iter().enumerate() {
            sensors.row(sensor["name"].as_str().unwrap_or(""));
            let at = |field: &str| format!("/quality/sensors/{row}/{field}");
            sensors.cell(&at("link"), Form::Whole, "–");
            sensors.cell(&at("readings"), Form::Whole, "–");
            sensors.cell(&at("period_s"), Form::Fixed(1.0, 2), "–");
            sensors.cell(&at("longest_gap_s"), Form::Fixed(1.0, 1), "–");
            sensors.cell(&at("lost"), Form::Whole, "–");
            sensors.cell(&at("lowest_c"), Form::Fixed(1.0, 2), "–");
            sensors.cell(&at("highest_c"), Form::Fixed(1.0, 2), "–");
            sensors.cell(&at("missing_at_visits"), Form::Whole, "–");
            sensors.end_row();
        }
        html += &sensors.finish();
    }
    let faults: Vec<String> = results["discovery"]["findings"]
        .as_array()
        .into_iter()
        .flatten()
        .filter(|finding| {
            FAULTS.iter().any(|start| finding["effect"].as_str().is_some_and(|name| name.starts_with(start)))
        })
        .map(|finding| format!("Misbehaved: {}.", super::findings::name(finding)))
        .collect();
    html += &match (results["discovery"].is_object(), faults.is_empty()) {
        (true, true) => "<p>No fault of a sensor, of the clock or of the instrument was found.</p>".to_owned(),
        (true, false) => list(&faults),
        (false, _) => "<p>Faults of sensors were not looked for.</p>".to_owned(),
    };
    let link = &results["quality"]["link"];
    html += &match link["time_uncertainty_s"].as_f64() {
        Some(uncertainty) => format!(
            "<p>Clocks of the link boards: every reading's time is known to ±<span \
             data-from=\"/quality/link/time_uncertainty_s\" data-factor=\"1000\">{:.1}</span> ms or better, but for {} \
             readings whose boot was heard in one direction only. {} readings have no value and {} were out of range.</p>",
            1e3 * uncertainty,
            link["times_unbounded"],
            link["missing"],
            link["out_of_range"]
        ),
        None => "<p>Clocks: a run's files do not say how well their times are known; <code>log export --json</code> does, and \
                 <code>report --log-export</code> shows it here.</p>"
            .to_owned(),
    };
    let mut notes = strings(&results["quality"]["notes"]);
    for part in ["on_run", "identification"] {
        for note in strings(&results[part]["notes"]) {
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
    }
    if !notes.is_empty() {
        html += &format!("<h3>{}</h3>{}", escaped("Notes"), list(&notes));
    }
    html
}
