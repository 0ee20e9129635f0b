//! `hide`: writes runs in which effects are hidden, each with its truth. The same seed gives the same bytes.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use thermokin_tests::hidden::arms::Model;
use thermokin_tests::hidden::case::{Case, Options};
use thermokin_tests::hidden::draw::Request;
use thermokin_tests::hidden::folder::{self, Form};
use thermokin_tests::hidden::schedule::Plan;

/// Writes run folders that hide effects, with truth.json and oracle.json.
///
/// Example: hide --seed 7 --effect gear_eccentricity:joint=3 --effect backlash --rho 8 --out runs
#[derive(Parser)]
struct Arguments {
    /// Seed of the first run; the others follow it.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// An effect, NAME or NAME:where, as joint=3, parameter=a2,joint=1, sensor=L3S3, sensors=L1S1+L2S2, target=T1.
    #[arg(long = "effect")]
    effects: Vec<String>,
    /// Signal-to-noise ratio of each effect as the oracle sees it; absent: natural sizes.
    #[arg(long)]
    rho: Option<f64>,
    /// How many runs.
    #[arg(long, default_value_t = 1)]
    count: u64,
    /// Which arm.
    #[arg(long, value_enum, default_value = "nj130")]
    arm: Model,
    /// Cycles, the cold one included.
    #[arg(long, default_value_t = 24)]
    cycles: usize,
    /// Postures.
    #[arg(long, default_value_t = 15)]
    poses: usize,
    /// Targets on the flange; absent: the arm's.
    #[arg(long)]
    targets: Option<usize>,
    /// Each cycle visits the postures in another order.
    #[arg(long)]
    shuffled: bool,
    /// The override takes many values instead of a warm-up and a cool-down.
    #[arg(long)]
    mixed_overrides: bool,
    /// The load changes from cycle to cycle.
    #[arg(long)]
    payload_changes: bool,
    /// 1-sigma of a point's coordinate, m; absent: 4 µm for nj130, drawn for the others.
    #[arg(long)]
    noise: Option<f64>,
    /// 1-sigma of the first joint from visit to visit, rad; absent: drawn.
    #[arg(long)]
    joint_noise: Option<f64>,
    /// An error that each posture keeps, as a share of the joints' repeatability.
    #[arg(long, default_value_t = 0.0)]
    posture_share: f64,
    /// Share of points that are not seen.
    #[arg(long, default_value_t = 0.002)]
    missing: f64,
    /// Leave motion.csv out.
    #[arg(long)]
    no_motion: bool,
    /// Leave the approach columns out.
    #[arg(long)]
    no_approach: bool,
    /// Where the folders go: OUT itself for one run, OUT/seedN for more.
    #[arg(long)]
    out: PathBuf,
}

fn main() -> ExitCode {
    match hide(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("hide: {error}");
            ExitCode::from(2)
        }
    }
}

fn hide(arguments: &Arguments) -> Result<(), String> {
    let effects = arguments.effects.iter().map(|text| Request::parse(text)).collect::<Result<Vec<_>, _>>()?;
    for seed in arguments.seed..arguments.seed + arguments.count {
        let plan = Plan {
            cycles: arguments.cycles,
            poses: arguments.poses,
            targets: arguments.targets,
            shuffled: arguments.shuffled,
            mixed_overrides: arguments.mixed_overrides,
            payload_changes: arguments.payload_changes,
        };
        let case = Case::make(Options {
            seed,
            model: arguments.arm,
            plan,
            effects: effects.clone(),
            rho: arguments.rho,
            point_sigma_m: arguments.noise,
            joint_sigma_rad: arguments.joint_noise,
            posture_share: arguments.posture_share,
            missing: arguments.missing,
        })?;
        let name = format!("seed{seed}");
        let out = if arguments.count == 1 { arguments.out.clone() } else { arguments.out.join(&name) };
        let form = Form { motion: !arguments.no_motion, approach: !arguments.no_approach, payload: true };
        folder::write(&case, &name, form, &out).map_err(|error| format!("{}: {error}", out.display()))?;
        let rho = |rho: Option<f64>| rho.map_or_else(|| "-".to_owned(), |rho| format!("{rho:.2}"));
        let hidden: Vec<String> = case
            .hidden
            .iter()
            .map(|weighed| {
                format!(
                    "{} {} rho {}",
                    weighed.effect.kind.name(),
                    weighed.effect.place.to_json(&case.world.arm),
                    rho(weighed.rho)
                )
            })
            .collect();
        println!("seed {seed} mismatch {:.2} {}: {}", case.mismatch, out.display(), hidden.join("; "));
    }
    Ok(())
}
