//! A run's tables as typed columns, named as the folder's files name them.

use std::path::Path;

use super::{JoinOptions, Run, RunFiles, WriteError, distances, motion, points, poses, temperatures};
use crate::table::{Column, Table, numbered_suffix};

impl Run {
    /// The tables by their names (`poses`, `points`, and of `temperatures`, `motion` and `distances` those that the run has)
    /// with the columns of the folder's files. `poses` has beside them what every sensor read at the visit, as `celsius_` and
    /// the sensor's name, joined as `options` say.
    ///
    /// # Errors
    /// A run that could not be written either.
    pub(crate) fn columns(&self, options: &JoinOptions) -> Result<Vec<(&'static str, Vec<Column>)>, WriteError> {
        // What is written is the one statement of which columns there are.
        let files = RunFiles::of(self, &self.folder)?;
        let tables = [
            (poses::FILE, Some(&files.poses)),
            (points::FILE, files.points.as_ref()),
            (temperatures::FILE, files.temperatures.as_ref()),
            (motion::FILE, files.motion.as_ref()),
            (distances::FILE, files.distances.as_ref()),
        ];
        let mut found = Vec::new();
        for (file, bytes) in tables {
            let Some(bytes) = bytes else { continue };
            let mut columns = columns_of(Path::new(file), bytes)?;
            if file == poses::FILE {
                let joined = self.temperatures_at_visits(options);
                for (number, sensor) in joined.sensors.iter().enumerate() {
                    let cells = (0..self.visits.len()).map(|visit| joined.at_visit(visit)[number]).collect();
                    columns.push(Column::numbers(format!("celsius_{sensor}"), cells));
                }
            }
            found.push((file.trim_end_matches(".csv"), columns));
        }
        Ok(found)
    }
}

/// What a column of a run's tables holds follows from its name.
fn columns_of(file: &Path, bytes: &[u8]) -> Result<Vec<Column>, WriteError> {
    let unreadable = |error: crate::input::InputError| WriteError::Content { file: error.file, message: error.message };
    let mut table = Table::open(file, bytes, &[]).map_err(unreadable)?;
    let mut columns: Vec<Column> = table
        .names()
        .iter()
        .map(|name| match name.as_str() {
            "target" | "anchor" | "sensor" | "phase" => Column::names(name, Vec::new()),
            "cycle" | "pose" => Column::whole(name, Vec::new()),
            name if numbered_suffix(name, "approach").is_some() => Column::whole(name, Vec::new()),
            name => Column::numbers(name, Vec::new()),
        })
        .collect();
    while let Some(row) = table.next_row().map_err(unreadable)? {
        for (place, column) in columns.iter_mut().enumerate() {
            column.push(&row, place).map_err(unreadable)?;
        }
    }
    Ok(columns)
}
