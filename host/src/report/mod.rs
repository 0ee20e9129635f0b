//! The report: everything that a calibration, a validation and a discovery came to, on one HTML page that opens from disk;
//! and, in `tables`, the run with its residuals for engines of analysis.
//!
//! Computes nothing that a command does not say as well: tables are written from the commands' JSON, cell by cell, each cell
//! naming the number that it shows, so that page and JSON cannot differ. One file of this module is one chapter of the page;
//! `figure` is what a plot is, `table` what a table is, `page` puts them together with the library that draws.

mod figure;
mod findings;
mod left;
mod observability;
mod overview;
mod page;
mod parameters;
mod provenance;
mod quality;
mod residuals;
mod table;
mod tables;
mod time;
mod verdict;

use serde_json::Value;

use crate::calibrate::{Calibration, Trial};
use crate::discover::Discovery;
use crate::model::Model;
use crate::robot::Robot;
use crate::run::Run;

pub use findings::name as finding_name;
pub use page::page;
pub use parameters::{coefficients, parameters};
pub use provenance::{InputFile, Provenance, ProvenanceError, sha256_of, sha256_of_run};
pub use quality::{LinkQuality, Quality, SensorQuality, TargetQuality};
pub use tables::{TablesError, WrittenTable, write_tables};
pub use verdict::verdict;

/// A run with what a model makes of it.
#[derive(Clone, Copy)]
pub struct Tried<'a> {
    /// The run.
    pub run: &'a Run,
    /// The arm as the run describes it.
    pub robot: &'a Robot,
    /// The model set up on it.
    pub trial: &'a Trial,
}

/// All that a page is made of.
#[derive(Clone, Copy)]
pub struct Contents<'a> {
    /// The object of `report --json`: what tables show.
    pub results: &'a Value,
    /// The model.
    pub model: &'a Model,
    /// The run that the report is about.
    pub own: Tried<'a>,
    /// Another run, of which the model saw nothing.
    pub other: Option<Tried<'a>>,
    /// An identification on the run: what these data tell, and how each cycle's geometry stands alone.
    pub calibration: Option<&'a Calibration>,
    /// What was discovered in the run; none where nothing was looked for.
    pub discovery: Option<&'a Discovery>,
}

/// The levels as results name them.
pub(crate) const LEVEL_NAMES: [&str; 4] = ["nominal", "geometric", "thermal", "extended"];
