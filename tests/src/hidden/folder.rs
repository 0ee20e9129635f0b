//! A run folder of the contract's form, and beside it what is true of it.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use serde_json::{Value, json};

use super::case::Case;
use super::kind::Kind;

/// Which optional files and columns a folder has.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    /// motion.csv.
    pub motion: bool,
    /// The approach columns of poses.csv.
    pub approach: bool,
    /// The payload column of poses.csv.
    pub payload: bool,
}

impl Default for Form {
    fn default() -> Self {
        Self { motion: true, approach: true, payload: true }
    }
}

/// Writes a run, truth.json and oracle.json into a folder that is made.
///
/// # Errors
///
/// What the disk says.
pub fn write(case: &Case, name: &str, form: Form, folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let file = |file: &str, text: String| fs::write(folder.join(file), text);
    file("robot.toml", case.world.arm.to_toml())?;
    file("poses.csv", poses(case, form))?;
    file("points.csv", points(case))?;
    file("temperatures.csv", temperatures(case))?;
    if form.motion {
        file("motion.csv", motion(case))?;
    }
    file("truth.json", format!("{:#}\n", truth(case)))?;
    file("oracle.json", format!("{:#}\n", oracle(case)))?;
    file("run.toml", run(case, name))
}

fn run(case: &Case, name: &str) -> String {
    let (sigma, per_m) = case.world.noise.point;
    format!(
        "format = 1\nname = \"{name}\"\nrobot = \"robot.toml\"\nreference_cycle = 0\nambient = \"AMB\"\n\n[instrument]\n\
         name = \"laser tracker\"\nposition = [0.0, 0.0, 0.0]\nsigma_m = {sigma:?}\nsigma_per_m = {per_m:?}\n"
    )
}

fn poses(case: &Case, form: Form) -> String {
    let joints = case.world.arm.joints();
    let named = |name: &str| (1..=joints).map(|n| format!(",{name}{n}")).collect::<String>();
    let mut text = format!("time_s,cycle,pose{}", named("q"));
    if form.payload {
        text.push_str(",payload_kg");
    }
    if form.approach {
        text.push_str(&named("approach"));
    }
    text.push('\n');
    for visit in &case.world.schedule.visits {
        let _ = write!(text, "{:.3},{},{}", visit.time_s, visit.cycle, visit.pose);
        visit.joints.iter().for_each(|q| {
            let _ = write!(text, ",{q:.9}");
        });
        if form.payload {
            let _ = write!(text, ",{:.3}", visit.payload_kg);
        }
        if form.approach {
            visit.approach.iter().for_each(|sign| {
                let _ = write!(text, ",{sign:.0}");
            });
        }
        text.push('\n');
    }
    text
}

fn points(case: &Case) -> String {
    let mut text = String::from("time_s,cycle,pose,target,x_m,y_m,z_m\n");
    for ((point, label), at) in case.world.points.iter().zip(&case.labels).zip(&case.measured) {
        let visit = &case.world.schedule.visits[point.visit];
        let target = &case.world.arm.targets[*label].0;
        let _ = write!(text, "{:.3},{},{},{target}", point.time_s, visit.cycle, visit.pose);
        match at {
            Some(at) => {
                let _ = writeln!(text, ",{:.7},{:.7},{:.7}", at.x, at.y, at.z);
            }
            None => text.push_str(",,,\n"),
        }
    }
    text
}

fn temperatures(case: &Case) -> String {
    let names = case.world.arm.sensors.iter().map(|sensor| sensor.name.as_str()).chain(["AMB"]);
    let mut rows: Vec<(f64, &str, f64)> = names
        .zip(&case.log.sensors)
        .flat_map(|(name, readings)| readings.iter().map(move |&(time, celsius)| (time, name, celsius)))
        .collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut text = String::from("time_s,sensor,celsius\n");
    for (time, name, celsius) in rows {
        let _ = writeln!(text, "{time:.2},{name},{celsius}");
    }
    text
}

fn motion(case: &Case) -> String {
    let joints = case.world.arm.joints();
    let mut text = String::from("start_s,end_s,cycle,phase,override");
    (1..=joints).for_each(|n| {
        let _ = write!(text, ",rms{n}");
    });
    text.push('\n');
    for step in &case.world.schedule.steps {
        let (start, end, phase, speed) = (step.start_s, step.end_s, step.phase.name(), step.speed);
        let _ = write!(text, "{start:.3},{end:.3},{},{phase},{speed}", step.cycle);
        step.rms.iter().for_each(|rms| {
            let _ = write!(text, ",{rms:.5}");
        });
        text.push('\n');
    }
    text
}

/// truth.json: the form of the blind examples.
pub fn truth(case: &Case) -> Value {
    let effects = case.hidden.iter().map(|weighed| {
        let effect = &weighed.effect;
        let mut one = json!({
            "effect": effect.kind.answer(),
            "where": if effect.kind.is_off() { json!({}) } else { effect.place.to_json(&case.world.arm) },
            "parameters": effect.parameters(&case.world),
            // The positions see a wrong reading only through the growth; the log itself shows it better.
            "oracle_snr": weighed.rho.filter(|_| !effect.kind.is_of_readings() || effect.kind == Kind::ClockOffset),
        });
        if effect.kind.is_off() {
            one["form"] = json!(effect.kind.name());
        }
        one
    });
    json!({"effects": effects.collect::<Vec<_>>()})
}

/// oracle.json: how the run was made and what the oracle knows besides.
pub fn oracle(case: &Case) -> Value {
    let options = &case.options;
    let noise = &case.world.noise;
    let (mut square, mut count) = (0.0, 0.0_f64);
    for (at, clean) in case.measured.iter().zip(&case.clean) {
        if let Some(at) = at {
            square += (at - clean).norm_squared();
            count += 1.0;
        }
    }
    let effects = case.hidden.iter().map(|weighed| {
        let visible =
            weighed.rho.map(|rho| if weighed.raw > 0.0 { (rho / weighed.raw) * (rho / weighed.raw) } else { 1.0 });
        json!({"effect": weighed.effect.kind.name(), "where": weighed.effect.place.to_json(&case.world.arm),
            "rho": weighed.rho, "raw": weighed.raw, "visible_fraction": visible})
    });
    json!({
        "seed": options.seed,
        "arm": options.model.name(),
        "rho_asked": options.rho,
        "cycles": options.plan.cycles,
        "poses": options.plan.poses,
        "shuffled": options.plan.shuffled,
        "mixed_overrides": options.plan.mixed_overrides,
        "payload_changes": options.plan.payload_changes,
        "point_sigma_m": noise.point.0,
        "point_sigma_per_m": noise.point.1,
        "joint_sigma_rad": noise.joint,
        "posture_sigma_rad": noise.posture,
        "missing": noise.missing,
        "growth_mismatch_rho": case.mismatch,
        "true_model_rms_mm": 1e3 * libm::sqrt(square / count.max(1.0)),
        "outliers": case.outliers.len(),
        "effects": effects.collect::<Vec<_>>(),
    })
}
