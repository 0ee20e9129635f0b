//! Corrections of a file: a table of joints or of places in, a table with the answers out.
//!
//! A row may say when it is for (`time_s`); it is then computed at the temperatures of that time.

use std::path::Path;

use nalgebra::{Quaternion, Vector3};

use super::arm::{Arm, Conditions, Present};
use super::correction::Corrector;
use super::inverse::{InverseError, Solution};
use crate::input::InputError;
use crate::robot::Frame;
use crate::run::{TemperatureLog, WriteError};
use crate::table::{Row, Table, TableWriter};

/// What is asked of every row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Joints in, the flange's place out.
    Forward,
    /// Joints in, corrected joints out.
    Correct,
    /// Places in, joints out; one solution or those of all branches.
    Inverse {
        /// All branches, a row each.
        all: bool,
    },
}

/// The conditions of the rows.
#[derive(Debug, Clone, Default)]
pub struct Setting {
    /// For rows that do not say when they are.
    pub conditions: Conditions,
    /// What the sensors read over time, for rows that do.
    pub log: Option<TemperatureLog>,
}

/// What a table came to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// The table of answers.
    pub table: Vec<u8>,
    /// Rows that were read.
    pub rows: usize,
    /// Rows without an answer; the column `status` says why.
    pub failed: usize,
    /// Rows whose correction was made smaller to stay within its bounds.
    pub bounded: usize,
    /// The largest correction of a joint, rad or m.
    pub largest: f64,
}

/// Why a table gave none.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// The table that was read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A number that cannot be written.
    #[error(transparent)]
    Output(#[from] WriteError),
}

/// Columns of a place.
const PLACE: [&str; 7] = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"];

/// The status of a row that went well.
const OK: &str = "ok";

/// Works through a table; `file` is named in errors.
///
/// # Errors
/// Columns that are missing, cells that are no numbers, times without temperatures.
pub fn run(arm: &Arm, task: Task, setting: &Setting, file: &Path, bytes: &[u8]) -> Result<Outcome, BatchError> {
    let model = arm.model();
    let count = model.robot.joint_count();
    let names: Vec<String> = (1..=count).map(|joint| format!("q{joint}")).collect();
    let required: Vec<&str> = match task {
        Task::Inverse { .. } => PLACE.to_vec(),
        _ => names.iter().map(String::as_str).collect(),
    };
    let mut table = Table::open(file, bytes, &required)?;
    let columns: Vec<usize> = required.iter().map(|name| table.required(name)).collect::<Result<_, _>>()?;
    let seeds: Option<Vec<usize>> = names.iter().map(|name| table.column(name)).collect();
    let (time, payload) = (table.column("time_s"), table.column("payload_kg"));
    let approach: Option<Vec<usize>> = (1..=count).map(|joint| table.column(&format!("approach{joint}"))).collect();
    let mut header = vec!["row".to_owned()];
    match task {
        Task::Forward => header.extend(PLACE.map(str::to_owned)),
        Task::Correct => {
            header.extend(names.iter().cloned());
            header.extend((1..=count).map(|joint| format!("correction{joint}")));
        }
        Task::Inverse { .. } => {
            header.extend(names.iter().cloned());
            header.extend(["distance_m".to_owned(), "angle_rad".to_owned()]);
        }
    }
    header.push("status".to_owned());
    let mut writer = TableWriter::new(Path::new("the answers").to_owned(), &header)?;
    let mut worker = Worker { present: arm.under(&setting.conditions), corrector: Corrector::new(model), before: None };
    let mut outcome = Outcome::default();
    while let Some(row) = table.next_row()? {
        outcome.rows += 1;
        if let (Some(time), Some(log)) = (time, &setting.log) {
            let time_s = row.number(time, "a time in seconds")?;
            let conditions = at_time(arm, log, time_s, &setting.conditions).map_err(|message| row.error(message))?;
            worker.present = arm.under(&conditions);
        }
        let mass = payload.map(|column| row.number(column, "kilograms")).transpose()?;
        let directions = match &approach {
            Some(columns) => numbers(&row, columns, "-1, 0 or 1")?,
            None => setting.conditions.approach.clone(),
        };
        worker.present.load(mass.unwrap_or(setting.conditions.payload_kg), &directions);
        let given = numbers(&row, &columns, "a number (radians, metres)")?;
        let seed = match (&seeds, task) {
            (Some(columns), Task::Inverse { .. }) => row.optional_numbers(columns, "radians or metres")?,
            _ => None,
        };
        worker.answer(task, &row, given, seed, &mut writer, &mut outcome)?;
    }
    outcome.table = writer.finish()?;
    Ok(outcome)
}

fn numbers(row: &Row<'_>, columns: &[usize], expected: &str) -> Result<Vec<f64>, InputError> {
    columns.iter().map(|&column| row.number(column, expected)).collect()
}

/// The conditions at a time of a log, what the sensors read before included.
///
/// # Errors
/// A sensor that the model needs and that has no reading near that time, in words.
pub fn at_time(arm: &Arm, log: &TemperatureLog, time_s: f64, others: &Conditions) -> Result<Conditions, String> {
    let place = |name: &str| log.index_of(name);
    let references = &arm.model().temperatures;
    let celsius: Vec<Option<f64>> =
        references.iter().map(|reference| log.at(place(&reference.sensor)?, time_s)).collect();
    let missing = arm.needed_sensors().iter().zip(&celsius).position(|(needed, celsius)| *needed && celsius.is_none());
    if let Some(sensor) = missing {
        let name = &references[sensor].sensor;
        return Err(format!("at {time_s} s the temperatures have no reading of sensor {name}, which the model needs"));
    }
    let history = references
        .iter()
        .map(|reference| place(&reference.sensor).map(|index| log.series[index].until(time_s)).unwrap_or_default())
        .collect();
    Ok(Conditions { celsius, history, time_s, ..others.clone() })
}

/// What stays from row to row.
struct Worker {
    present: Present,
    corrector: Corrector,
    /// The solution of the row before: rows of a path follow each other.
    before: Option<Vec<f64>>,
}

impl Worker {
    fn answer(
        &mut self,
        task: Task,
        row: &Row<'_>,
        given: Vec<f64>,
        seed: Option<Vec<f64>>,
        writer: &mut TableWriter,
        outcome: &mut Outcome,
    ) -> Result<(), BatchError> {
        let number = outcome.rows as i64;
        let count = self.present.joint_count();
        if let (Task::Correct, Some((joint, low, high))) = (task, self.present.outside(&given)) {
            let message = format!("joint {} is {}, expected {low} to {high}", joint + 1, given[joint]);
            return Err(row.error(message).into());
        }
        writer.whole(number);
        match task {
            Task::Forward => {
                let frame = self.present.forward(&given);
                let turn = frame.quaternion();
                writer.numbers(&[frame.origin.x, frame.origin.y, frame.origin.z])?;
                writer.numbers(&[turn.w, turn.i, turn.j, turn.k])?;
                writer.name(OK)?;
            }
            Task::Correct => match self.corrector.correct(&mut self.present, &given) {
                Ok(corrected) => {
                    outcome.bounded += usize::from(corrected.bounded);
                    outcome.largest =
                        corrected.correction.iter().fold(outcome.largest, |most, one| most.max(one.abs()));
                    writer.numbers(&corrected.joints)?;
                    writer.numbers(&corrected.correction)?;
                    writer.name(if corrected.bounded { "bounded" } else { OK })?;
                }
                Err(error) => {
                    outcome.failed += 1;
                    writer.empty(2 * count);
                    writer.name(&error.to_string())?;
                }
            },
            Task::Inverse { all } => {
                let goal =
                    goal(&given).ok_or_else(|| row.error("qw, qx, qy, qz: expected a quaternion of length 1"))?;
                match self.solve(&goal, all, seed) {
                    Ok(solutions) => {
                        for (place, solution) in solutions.iter().enumerate() {
                            if place > 0 {
                                writer.whole(number);
                            }
                            solved(writer, solution, OK)?;
                        }
                        return Ok(());
                    }
                    Err(error) => {
                        outcome.failed += 1;
                        let InverseError::Unreachable { nearest, .. } = &error;
                        return Ok(solved(writer, nearest, &error.to_string())?);
                    }
                }
            }
        }
        Ok(writer.end_row()?)
    }

    /// A place's solutions: from the seed of its row, else from the row before where that leads there, else from anywhere.
    fn solve(&mut self, goal: &Frame, all: bool, seed: Option<Vec<f64>>) -> Result<Vec<Solution>, InverseError> {
        if all {
            return self.present.branches(goal).map(|branches| branches.solutions);
        }
        let near = match (&seed, &self.before) {
            (Some(seed), _) => Some(self.present.inverse_near(goal, seed)?),
            (None, Some(before)) => self.present.inverse_near(goal, before).ok(),
            (None, None) => None,
        };
        let solution = match near {
            Some(solution) => solution,
            None => self.present.inverse(goal)?,
        };
        self.before = Some(solution.joints.clone());
        Ok(vec![solution])
    }
}

fn solved(writer: &mut TableWriter, solution: &Solution, status: &str) -> Result<(), WriteError> {
    writer.numbers(&solution.joints)?;
    writer.numbers(&[solution.distance_m, solution.angle_rad])?;
    writer.name(status)?;
    writer.end_row()
}

/// A place of the flange from x, y, z and a quaternion w, x, y, z; none where that is no rotation.
fn goal(given: &[f64]) -> Option<Frame> {
    let &[x, y, z, qw, qx, qy, qz] = given else { return None };
    Frame::from_quaternion(Vector3::new(x, y, z), Quaternion::new(qw, qx, qy, qz))
}
