//! `thermokin discover RUN --out MODEL`.

use std::path::PathBuf;

use clap::Args;

use super::Failure;
use super::campaign::RunOptions;
use crate::calibrate::{Request, calibrate};
use crate::discover::fit::positional;
use crate::discover::search::search;
use crate::discover::stage::Point;
use crate::effect::{Scene, Seen};

/// Arguments.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The run's folder.
    run: PathBuf,
    #[command(flatten)]
    options: RunOptions,
}

/// Carries the command out.
///
/// # Errors
/// Bad input, or work that fails.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (run, robot) = arguments.options.read(&arguments.run)?;
    let request = Request { observe: arguments.options.observe(), ..Request::default() };
    let calibration = calibrate(&robot, &run, &request, |_| true)?;
    let campaign = &calibration.campaign;
    let seen = campaign.visits.iter().map(|visit| Seen {
        place: visit.place,
        joints: visit.posture.positions(),
        rises: visit.rises.clone(),
    });
    let unknown: Vec<usize> = (0..robot.targets.len()).filter(|&t| robot.targets[t].position.is_none()).collect();
    let mut scene = Scene::new(
        &calibration.model.robot,
        &run,
        seen,
        &calibration.state.geometry.parameters,
        &calibration.model.temperatures,
        calibration.state.geometry.targets.clone(),
        &unknown,
    );
    let point = Point { state: calibration.state.clone(), effects: Vec::new() };
    let unknowns = positional(&calibration.joint.unknowns);
    let time = std::time::Instant::now();
    let Some(found) = search(campaign, &mut scene, point, &unknowns, 1) else {
        return Err(Failure::Work("no fit".into()));
    };
    println!("search {:?}  strata {:?}  trials {}", time.elapsed(), found.baseline.strata, found.trials.all);
    for named in &found.named {
        let s = &named.score;
        println!(
            "NAMED {:?} ratio {:.1} k {} lnp {:.1} visible {:.3}",
            s.instance, s.ratio, s.freedom, named.ln_p, s.visible
        );
        println!("      {:?}", s.instance.parameters());
        for rival in named.rivals.iter().take(4) {
            println!(
                "   rival {:?} ratio {:.1} k {} lnp {:.1}",
                rival.instance, rival.ratio, rival.freedom, rival.ln_p
            );
        }
    }
    println!("after strata {:?} effects {:?}", found.last.strata, found.last.point.effects);
    let all = crate::discover::candidates::candidates(&scene);
    for s in crate::discover::search::scores(&found.last, &scene, &all, &found.trials).iter().take(5) {
        println!(
            "   left {:?} ratio {:.1} k {} lnp {:.1} over all {:.2}",
            s.instance,
            s.ratio,
            s.freedom,
            s.ln_p,
            found.trials.over_all(s.ln_p)
        );
    }
    Ok(())
}
