//! The measured sets of ../shared/data: the reference figures of each SOURCE.txt are reached.
//!
//! The sets may not all be copied into the project: where they are absent (`THERMOKIN_SHARED`, or ../shared beside the
//! workspace), the tests say that they skip. A figure counts as reached within half a unit of its last digit plus 1 %.
//!
//! The references weigh every point alike, while a run's instrument has a part that grows with distance; so the figures
//! that are compared to their last digit are made with that part at zero, and those of the run as it is lie beside them.
//! Held-out figures depend on which poses are dealt into which fold: means are compared, and maxima where they are not the
//! lot of one pose.

use std::path::{Path, PathBuf};

use thermokin::calibrate::{
    Folds, HeldOutBy, JointSource, ObserveOptions, Refit, Request, calibrate, held_out, observe, position_errors,
    validate,
};
use thermokin::model::Errors;
use thermokin::robot::{Robot, shipped};
use thermokin::run::{self, Run, Selection};

fn data(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("THERMOKIN_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let folder = shared.join("data").join(name);
    if !folder.is_dir() {
        eprintln!("skipped: {} is not here (set THERMOKIN_SHARED)", folder.display());
        return None;
    }
    Some(folder)
}

/// A run and its arm; `alike` weighs all points alike, as the references do.
fn read(folder: &Path, alike: bool) -> (Run, Robot) {
    let mut run = run::read(folder).unwrap_or_else(|error| panic!("{error}"));
    let robot = Robot::read(&run.description.robot).unwrap_or_else(|error| panic!("{error}"));
    if alike {
        run.description.instrument.sigma_per_m = 0.0;
    }
    (run, robot)
}

fn request(joints: JointSource) -> Request {
    let observe = ObserveOptions { joints, ..ObserveOptions::default() };
    Request { observe, geometry_only: true, ..Request::default() }
}

/// The references' five folds, whose dealing is not known: here as the command deals them by default.
const FIVE: Folds = Folds { by: HeldOutBy::Pose, count: 5, seed: 1 };

/// `figure` as SOURCE.txt prints it, with `digits` behind the point.
fn reached(what: &str, found: f64, figure: f64, digits: i32) {
    println!("{what}: {found:.4} for {figure}");
    let tolerance = 0.5 * 10f64.powi(-digits) + 0.01 * figure;
    assert!((found - figure).abs() <= tolerance, "{what}: {found} instead of {figure} ± {tolerance:.4}");
}

fn per_coordinate_um(errors: &Errors) -> f64 {
    errors.rms_mm / 3f64.sqrt() * 1e3
}

#[test]
fn irb120_reaches_its_reference() {
    let Some(folder) = data("irb120") else { return };
    let (run, robot) = read(&folder, false);
    for (joints, rms_um, mean, most_poses) in
        [(JointSource::Logged, 328.0, 0.459, 2.69), (JointSource::Commanded, 158.0, 0.217, 1.67)]
    {
        let request = request(joints);
        let found = calibrate(&robot, &run, &request, |_| true).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((found.joint.unknowns.len(), found.joint.held.len(), found.joint.weak.len()), (33, 6, 0));
        let folded =
            held_out(&robot, &run, &request, &found.campaign, FIVE, |_| ()).unwrap_or_else(|error| panic!("{error}"));
        reached("irb120, mean held out", folded.errors.mean_mm, mean, 3);
        let unseen_um = per_coordinate_um(&folded.errors);
        let fitted_um = per_coordinate_um(&found.errors(&found.campaign)[2]);
        println!(
            "irb120: {fitted_um:.1} um fitted, {unseen_um:.1} um held out for {rms_um}, max {:.2}",
            folded.errors.max_mm
        );
        // The RMS hangs on a few poses 2 to 3 mm off, and so on the folds: the reference lies between the fit and our folds.
        assert!(fitted_um < rms_um && rms_um < 1.01 * unseen_um && unseen_um < 1.05 * rms_um);
        // The largest error is one pose's: it is the same pose, 10 % more or less by what else its fold lacks.
        assert!((folded.errors.max_mm / most_poses - 1.0).abs() < 0.12, "{}", folded.errors.max_mm);
    }
}

#[test]
fn tx2_reaches_its_reference() {
    for (name, nominal, fitted, unseen) in [
        ("tx2-cal", (0.364, 0.967), (0.097, 0.289), (0.125, 0.4)),
        ("tx2-points", (0.151, 0.496), (0.066, 0.201), (0.068, 0.21)),
    ] {
        let Some(folder) = data(name) else { return };
        let (run, robot) = read(&folder, true);
        let request = request(JointSource::Logged);
        let found = calibrate(&robot, &run, &request, |_| true).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((found.joint.unknowns.len(), found.joint.held.len(), found.joint.weak.len()), (27, 6, 0), "{name}");
        let [before, _, after] = found.errors(&found.campaign);
        reached(&format!("{name} fitted, mean"), after.mean_mm, fitted.0, 3);
        reached(&format!("{name} fitted, max"), after.max_mm, fitted.1, 3);
        let folded =
            held_out(&robot, &run, &request, &found.campaign, FIVE, |_| ()).unwrap_or_else(|error| panic!("{error}"));
        // '0.12 to 0.13' of tx2-cal is 0.125 ± 0.005.
        reached(
            &format!("{name} held out, mean"),
            folded.errors.mean_mm,
            unseen.0,
            if name == "tx2-cal" { 2 } else { 3 },
        );
        // The largest error is one pose's and hangs on what else its fold lacks.
        assert!((folded.errors.max_mm / unseen.1 - 1.0).abs() < 0.12, "{name}: {}", folded.errors.max_mm);
        // The data's robot.toml has d3 = 0, the arm 50 mm: the reference's nominal is that of the shipped description.
        assert!(before.mean_mm > 2.0, "{}", before.mean_mm);
        let mut arm = shipped("staubli-tx2-90l").expect("shipped");
        arm.targets[0].name = "TMAC".into();
        let found = calibrate(&arm, &run, &request, |_| true).unwrap_or_else(|error| panic!("{error}"));
        let [before, _, after] = found.errors(&found.campaign);
        reached(&format!("{name} nominal, mean"), before.mean_mm, nominal.0, 3);
        reached(&format!("{name} nominal, max"), before.max_mm, nominal.1, 3);
        reached(&format!("{name} fitted from the shipped arm, mean"), after.mean_mm, fitted.0, 3);
    }
}

#[test]
fn the_instruments_own_weights_change_little() {
    let Some(folder) = data("tx2-cal") else { return };
    let (run, robot) = read(&folder, false);
    let found =
        calibrate(&robot, &run, &request(JointSource::Logged), |_| true).unwrap_or_else(|error| panic!("{error}"));
    let [_, _, after] = found.errors(&found.campaign);
    reached("tx2-cal as it is, mean", after.mean_mm, 0.097, 3);
    // The point nearest to the tracker counts a little more: the largest error is 1.5 % larger.
    assert!((after.max_mm / 0.289 - 1.0).abs() < 0.02, "{}", after.max_mm);
}

#[test]
fn tx2_holds_on_another_day_with_base_and_targets_found_anew() {
    let (Some(learn), Some(judge)) = (data("tx2-cal"), data("tx2-points")) else { return };
    let (run, robot) = read(&learn, false);
    let found =
        calibrate(&robot, &run, &request(JointSource::Logged), |_| true).unwrap_or_else(|error| panic!("{error}"));
    let (other, other_robot) = read(&judge, false);
    let refit = Refit { base: true, targets: true };
    let options = ObserveOptions::default();
    let judged = validate(&found.model, &other, &other_robot, &options, refit, |_| true)
        .unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(judged.points, 300);
    reached("tx2-cal on tx2-points", judged.errors[2].mean_mm, 0.082, 3);
}

#[test]
fn ur10_reaches_its_reference() {
    let Some(folder) = data("ur10-a") else { return };
    let (run, robot) = read(&folder, false);
    let mask = "every:100".parse::<Selection>().expect("a selection").mask(&run.visits);
    let request = request(JointSource::Logged);
    let found = calibrate(&robot, &run, &request, |visit| mask[visit.place]).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(found.joint.observability(&found.campaign).rank, 27);
    // Two of the 27 are known to some degrees only from 120 points and are held: the others err no less without them.
    assert_eq!(found.weak().len(), 2, "{:?}", found.weak());
    let whole = observe(&found.model.robot, &run, &request.observe, None).unwrap_or_else(|error| panic!("{error}"));
    let others = whole.campaign.select(|visit| !mask[visit.place]);
    assert_eq!(others.visits.len(), 11_791);
    let [nominal, _, after] = found.errors(&others);
    reached("ur10-a on the others, mean", after.mean_mm, 0.41, 2);
    reached("ur10-a on the others, max", after.max_mm, 1.4, 1);
    reached("ur10-a nominal, mean", nominal.mean_mm, 0.76, 2);
    // The nominal's largest error is that of one pose, far from the 120 by which base and target are placed; placed by
    // all poses it is 2.71 mm, and 2.6 in the reference.
    assert!(nominal.max_mm < 3.0, "{}", nominal.max_mm);
    // With the weak ones estimated, too, the figure is the same.
    let mut keep = request.clone();
    keep.manner.keep_weak = true;
    let kept = calibrate(&robot, &run, &keep, |visit| mask[visit.place]).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(kept.joint.unknowns.len(), 27);
    reached("ur10-a with all 27, mean", position_errors(&others, &kept.state).errors().mean_mm, 0.41, 2);
}
