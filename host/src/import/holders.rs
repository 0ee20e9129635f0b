//! Where the targets are in the flange frame: a coordinate measuring machine knows the holders in it, the tracker sees the
//! holders and the targets from one place, and a rigid registration leads from one to the other.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::average::{average, usual_spread};
use super::mapping::{HoldersSource, PointsSource, SamplesToml};
use super::positions::{self, Sample};
use super::source::Source;
use crate::input::InputError;
use crate::robot::Frame;

/// The registration, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Registration {
    /// How far each holder is from where the registration puts it.
    pub residuals: Vec<HolderResidual>,
    /// Root mean square of the distances, m.
    pub rms_m: f64,
    /// The greatest distance, m.
    pub max_m: f64,
    /// 1-sigma of one coordinate that the residuals tell of, m: none for three holders, which leave too little over.
    pub sigma_m: Option<f64>,
    /// The targets' places.
    pub targets: Vec<PlacedTarget>,
}

/// What the registration leaves of one holder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HolderResidual {
    /// Its name.
    pub name: String,
    /// Seen less expected, m, in the flange frame.
    pub residual_m: [f64; 3],
    /// Its length, m.
    pub distance_m: f64,
}

/// A target in the flange frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlacedTarget {
    /// Its name.
    pub name: String,
    /// Its place, m.
    pub position_m: [f64; 3],
}

/// Holders that are this much nearer to a line than they are long leave the turn about it open.
const COLLINEAR: f64 = 1e-2;

/// The three tables of a registration: the machine's holders, the tracker's holders, the tracker's targets.
pub type HolderFiles = [Vec<Source>; 3];

/// Registers the holders. `mapping` is blamed for what no single file is to blame for.
pub(super) fn register(
    mapping: &Path,
    holders: &HoldersSource,
    files: &HolderFiles,
    notes: &mut Vec<String>,
) -> Result<Registration, InputError> {
    let refuse = |message: String| InputError::at_line(mapping, holders.line, message);
    let machine = places(&holders.machine, &files[0], notes)?;
    let seen = places(&holders.tracker, &files[1], notes)?;
    let targets = places(&holders.targets, &files[2], notes)?;
    let pairs: Vec<(&String, Vector3<f64>, Vector3<f64>)> =
        machine.iter().filter_map(|(name, own)| Some((name, *own, *seen.get(name)?))).collect();
    for (here, there, whose) in [(&machine, &seen, "the tracker"), (&seen, &machine, "the machine")] {
        let missing: Vec<&str> = here.keys().filter(|name| !there.contains_key(*name)).map(String::as_str).collect();
        if !missing.is_empty() {
            notes.push(format!("holders: {} not measured by {whose}", missing.join(", ")));
        }
    }
    if pairs.len() < 3 {
        return Err(refuse(format!(
            "the machine and the tracker have {} holders in common; expected 3 at least, of equal names",
            pairs.len()
        )));
    }
    if targets.is_empty() {
        return Err(refuse("the tracker saw no target; expected one at least".to_owned()));
    }
    if is_a_line(pairs.iter().map(|(_, own, _)| *own)) {
        return Err(refuse("the holders stand in a line; expected three that do not".to_owned()));
    }
    let flange = Frame::registered(pairs.iter().map(|&(_, own, seen)| (own, seen)));
    let residuals: Vec<HolderResidual> = pairs
        .iter()
        .map(|&(name, own, seen)| {
            let residual = flange.local(&seen) - own;
            HolderResidual { name: name.clone(), residual_m: residual.into(), distance_m: residual.norm() }
        })
        .collect();
    let squares: f64 = residuals.iter().map(|residual| residual.distance_m * residual.distance_m).sum();
    let max_m = residuals.iter().map(|residual| residual.distance_m).fold(0.0, f64::max);
    if max_m > holders.max_residual_m {
        let worst = residuals.iter().find(|residual| residual.distance_m == max_m).map_or("", |worst| &worst.name);
        return Err(refuse(format!(
            "holder {worst} is {:.3} mm from where the registration puts it; expected {:.3} mm at most (names exchanged, \
             or another unit?)",
            max_m * 1e3,
            holders.max_residual_m * 1e3
        )));
    }
    // Three coordinates each, less the six of a rigid motion.
    let left_over = 3 * pairs.len() - 6;
    Ok(Registration {
        rms_m: (squares / pairs.len() as f64).sqrt(),
        max_m,
        sigma_m: (pairs.len() > 3).then(|| (squares / left_over as f64).sqrt()),
        residuals,
        targets: targets
            .into_iter()
            .map(|(name, seen)| PlacedTarget { name, position_m: flange.local(&seen).into() })
            .collect(),
    })
}

/// Where a table says that each name is, averaged over its rows.
fn places(
    points: &PointsSource,
    files: &[Source],
    notes: &mut Vec<String>,
) -> Result<BTreeMap<String, Vector3<f64>>, InputError> {
    let (samples, _) = positions::read(points, 0, files, notes)?;
    let mut by_name: BTreeMap<&str, (Vec<Vector3<f64>>, &Sample)> = BTreeMap::new();
    for sample in &samples {
        let Some(seen) = sample.seen else { continue };
        let (rows, _) = by_name.entry(&sample.target).or_insert_with(|| (Vec::new(), sample));
        rows.push(seen);
        if rows.len() > 1 && points.samples.is_none() {
            let message = format!("{} stands twice; expected it once, or samples = {{}} in the mapping", sample.target);
            return Err(InputError::at_line(&files[sample.source.1].path, sample.line, message));
        }
    }
    let rule = points.samples.unwrap_or(SamplesToml { least: 1, sigmas: f64::INFINITY, floor_m: 1.0 });
    let usual = usual_spread(by_name.values().map(|(rows, _)| rows.as_slice()));
    let mut places = BTreeMap::new();
    for (name, (rows, first)) in &by_name {
        let average = average(rows, &usual, &rule).ok_or_else(|| {
            let message = format!("the {} samples of {name} contradict each other or are too few", rows.len());
            InputError::at_line(&files[first.source.1].path, first.line, message)
        })?;
        let dropped = rows.len() - average.used;
        if dropped > 0 {
            notes.push(format!("holders: {dropped} samples of {name} left out, as the others contradict them"));
        }
        places.insert((*name).to_owned(), average.position);
    }
    Ok(places)
}

/// Whether places lie so near to a line that they leave the turn about it open.
fn is_a_line(places: impl Iterator<Item = Vector3<f64>> + Clone) -> bool {
    let count = places.clone().count() as f64;
    let mean = places.clone().sum::<Vector3<f64>>() / count;
    let scatter = places.fold(Matrix3::zeros(), |sum, place| sum + (place - mean) * (place - mean).transpose());
    let mut lengths: [f64; 3] = scatter.symmetric_eigenvalues().into();
    lengths.sort_by(f64::total_cmp);
    lengths[1].max(0.0).sqrt() <= COLLINEAR * lengths[2].max(0.0).sqrt()
}
