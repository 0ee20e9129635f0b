//! The verdict: three sentences and one table.

use serde_json::Value;

use super::LEVEL_NAMES;
use super::table::{Form, Table, escaped};

/// The level that the results end with: extended where the model carries effects.
fn best(results: &Value) -> &'static str {
    if results["on_run"]["extended"].is_object() { "extended" } else { "thermal" }
}

fn mean(errors: &Value) -> Option<f64> {
    errors["mean_mm"].as_f64()
}

/// Three sentences: how well the arm is known now, what temperature does, and what else was found.
pub fn verdict(results: &Value) -> [String; 3] {
    [geometry(results), temperature(results), causes(results)]
}

fn geometry(results: &Value) -> String {
    let best = best(results);
    let held_out = &results["held_out"];
    let (errors, seen) = match held_out[best].is_object() {
        true => (&held_out[best], "on data that it did not see"),
        false => (&results["on_run"][best], "on this run"),
    };
    let nominal = mean(&held_out["nominal"]).or_else(|| mean(&results["on_run"]["nominal"])).unwrap_or(0.0);
    let value = mean(errors).unwrap_or(0.0);
    let most = errors["max_mm"].as_f64().unwrap_or(0.0);
    let times = if value > 0.0 { nominal / value } else { f64::INFINITY };
    format!(
        "The calibrated model predicts where the tool is to {value:.3} mm on average and {most:.3} mm at worst {seen}; the \
         nominal arm is off by {nominal:.3} mm, {times:.0} times as much."
    )
}

fn temperature(results: &Value) -> String {
    let coefficients = results["thermal_coefficients"].as_array().map_or(0, Vec::len);
    if coefficients == 0 {
        return "The model has no thermal coefficients: it says nothing about what changes with temperature."
            .to_owned();
    }
    let from = if results["held_out"]["thermal"].is_object() && results["held_out"]["cycles"].is_array() {
        &results["held_out"]
    } else {
        &results["on_run"]
    };
    let (geometric, thermal) = (mean(&from["geometric"]).unwrap_or(0.0), mean(&from["thermal"]).unwrap_or(0.0));
    let worst = from["cycles"].as_array().into_iter().flatten().max_by(|a, b| {
        let error = |cycle: &Value| cycle["geometric_mm"].as_f64().unwrap_or(0.0);
        error(a).total_cmp(&error(b))
    });
    let at_worst = worst.map_or_else(String::new, |cycle| {
        format!(
            ", and in the cycle that drifts most, number {}, from {:.3} to {:.3} mm",
            cycle["cycle"],
            cycle["geometric_mm"].as_f64().unwrap_or(0.0),
            cycle["thermal_mm"].as_f64().unwrap_or(0.0)
        )
    });
    format!(
        "Its {coefficients} thermal coefficients take the mean error from {geometric:.3} to {thermal:.3} mm{at_worst}."
    )
}

fn causes(results: &Value) -> String {
    let discovery = &results["discovery"];
    let Some(findings) = discovery["findings"].as_array() else {
        return "What else the model gets wrong was not looked for.".to_owned();
    };
    let floor = discovery["noise"]["floor_rms_mm"].as_f64().unwrap_or(0.0);
    let left = match discovery["unexplained"]["significant"].as_bool() {
        Some(true) => {
            let follows = super::table::strings(&discovery["unexplained"]["follows"]).join(", ");
            format!("something that follows {follows} is left unexplained")
        }
        _ => format!("what is left cannot be told from noise, which makes {floor:.3} mm RMS"),
    };
    if findings.is_empty() {
        return format!("Beyond geometry and temperature no cause was found; {left}.");
    }
    let names: Vec<String> = findings.iter().map(super::findings::name).collect();
    let rms = |level: &str| discovery[level]["rms_mm"].as_f64().unwrap_or(0.0);
    let (before, after) = (rms("baseline"), rms("extended"));
    let them = if names.len() == 1 { "it" } else { "them" };
    // Points that were set aside and readings that were put right are so in both.
    let gain = match after < 0.99 * before {
        true => format!("with {them} corrected the RMS error of this run goes from {before:.3} to {after:.3} mm"),
        false => format!("{after:.3} mm RMS remain on this run with {them} put right"),
    };
    format!("Beyond geometry and temperature the data show {}: {gain}, and {left}.", names.join("; "))
}

/// The chapter: sentences and table.
pub fn chapter(results: &Value) -> String {
    let sentences: String = verdict(results).iter().map(|sentence| format!("<p>{}</p>", escaped(sentence))).collect();
    let mut table = Table::new(
        results,
        "Position errors by level of the model, millimetres",
        &["level", "mean", "RMS", "max", "held out: mean", "RMS", "max"],
    );
    for level in LEVEL_NAMES {
        if !results["on_run"][level].is_object() {
            continue;
        }
        table.row(level);
        for side in ["on_run", "held_out"] {
            for number in ["mean_mm", "rms_mm", "max_mm"] {
                table.cell(&format!("/{side}/{level}/{number}"), Form::Fixed(1.0, 3), "–");
            }
        }
        table.end_row();
    }
    let how = results["held_out"]["how"].as_str().unwrap_or("nothing was held out");
    format!(
        "<div class=\"verdict\">{sentences}</div>{}<p class=\"note\">Errors are distances between measured and predicted \
         positions of the targets. Nominal is the nominal arm after its base and unknown targets were found; geometric is \
         the arm calibrated at the reference temperature; thermal adds growth with temperature; extended adds what was \
         discovered. Held out: {}.</p>",
        table.finish(),
        escaped(how)
    )
}
