//! A run, and what a model leaves of its measurements, as Parquet files for any analysis engine.

use std::fs;
use std::path::{Path, PathBuf};

use super::LEVEL_NAMES;
use crate::calibrate::Trial;
use crate::run::{JoinOptions, Run, WriteError};
use crate::table::{Column, parquet};

/// A table that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WrittenTable {
    /// Where it is.
    pub file: PathBuf,
    /// Its rows.
    pub rows: usize,
    /// Its columns.
    pub columns: usize,
}

/// Why tables were not written.
#[derive(Debug, thiserror::Error)]
pub enum TablesError {
    /// The run holds what cannot be written, or the disk does not take it.
    #[error(transparent)]
    Run(#[from] WriteError),
    /// A file, and what is wrong with it.
    #[error("{}: {message}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        message: String,
    },
}

/// Writes `poses.parquet`, `points.parquet`, those of the run's other tables, and `residuals.parquet` into a folder. Every file
/// is read back and compared before the first takes its place.
///
/// `residuals` has a row for each level of the model, visit and target: `time_s,cycle,pose,target` (the time is the visit's),
/// `level`, the error measured less predicted in the world frame `dx_m,dy_m,dz_m`, and its length `distance_m`.
///
/// # Errors
/// A disk that does not take the files; none of them is left then.
pub fn write_tables(
    run: &Run,
    trial: &Trial,
    join: &JoinOptions,
    folder: &Path,
) -> Result<Vec<WrittenTable>, TablesError> {
    let mut tables = run.columns(join)?;
    tables.push(("residuals", residuals(run, trial)));
    let failed = |file: &Path, message: String| TablesError::File { file: file.to_owned(), message };
    fs::create_dir_all(folder).map_err(|error| failed(folder, format!("cannot be made: {error}")))?;
    let staging = folder.join(format!(".writing-{}", std::process::id()));
    let staged = || -> Result<(), TablesError> {
        fs::create_dir_all(&staging).map_err(|error| failed(&staging, format!("cannot be made: {error}")))?;
        for (name, columns) in &tables {
            let file = staging.join(format!("{name}.parquet"));
            let wrong = |error: &dyn std::fmt::Display| failed(&file, format!("cannot be written: {error}"));
            parquet::write(&file, columns).map_err(|error| wrong(&error))?;
            if !parquet::holds(&file, columns).map_err(|error| wrong(&error))? {
                return Err(wrong(&"read back, it differs from what was written"));
            }
        }
        Ok(())
    };
    let placed = || -> Result<Vec<WrittenTable>, TablesError> {
        let place = |(name, columns): &(&str, Vec<Column>)| {
            let name = format!("{name}.parquet");
            let file = folder.join(&name);
            fs::rename(staging.join(&name), &file)
                .map_err(|error| failed(&file, format!("cannot be written: {error}")))?;
            Ok(WrittenTable { file, rows: columns.first().map_or(0, Column::len), columns: columns.len() })
        };
        tables.iter().map(place).collect()
    };
    let outcome = staged().and_then(|()| placed());
    // What is left of it is of no use to anyone; that it cannot be removed is no further news.
    let _ = fs::remove_dir_all(&staging);
    outcome
}

fn residuals(run: &Run, trial: &Trial) -> Vec<Column> {
    let (mut time_s, mut cycle, mut pose) = (Vec::new(), Vec::new(), Vec::new());
    let (mut target, mut level) = (Vec::new(), Vec::new());
    let mut errors: [Vec<Option<f64>>; 4] = Default::default();
    trial.errors(|place, visit, which, error| {
        time_s.push(Some(run.visits[visit.place].time_s));
        cycle.push(Some(i64::from(visit.cycle)));
        pose.push(Some(i64::from(visit.pose)));
        target.push(Some(trial.campaign.targets[which].clone()));
        level.push(Some(LEVEL_NAMES[place].to_owned()));
        for (column, value) in errors.iter_mut().zip([error.x, error.y, error.z, error.norm()]) {
            column.push(Some(value));
        }
    });
    let mut columns = vec![
        Column::numbers("time_s", time_s),
        Column::whole("cycle", cycle),
        Column::whole("pose", pose),
        Column::names("target", target),
        Column::names("level", level),
    ];
    columns.extend(
        ["dx_m", "dy_m", "dz_m", "distance_m"]
            .into_iter()
            .zip(errors)
            .map(|(name, cells)| Column::numbers(name, cells)),
    );
    columns
}
