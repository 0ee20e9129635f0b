//! Discovery put to the test: a run that hides effects is made, examined by thermokin, and the answer held against the truth.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};
use thermokin::discover::{Discovery, DiscoveryRequest, discover};
use thermokin::robot::Robot;
use thermokin::run::read;

use crate::hidden::arms::Model;
use crate::hidden::case::{Case, Options};
use crate::hidden::draw::Request;
use crate::hidden::folder::{self, Form};
use crate::hidden::schedule::Plan;

/// A run to be made and examined.
#[derive(Debug, Clone)]
pub struct Hidden {
    /// Its seed.
    pub seed: u64,
    /// What to hide, as [`Request::parse`] reads it.
    pub effects: Vec<String>,
    /// The signal-to-noise ratio of each.
    pub rho: f64,
    /// The arm.
    pub model: Model,
    /// Which files and columns the folder has.
    pub form: Form,
    /// Share of points that are not seen.
    pub missing: f64,
    /// Whether the load changes from cycle to cycle.
    pub payload_changes: bool,
    /// Whether gains are held out.
    pub hold_out: bool,
}

impl Hidden {
    /// A run of the usual arm with all files.
    pub fn new(seed: u64, effects: &[&str], rho: f64) -> Self {
        let form = Form::default();
        let effects = effects.iter().map(|text| (*text).to_owned()).collect();
        Self { seed, effects, rho, model: Model::Nj130, form, missing: 0.002, payload_changes: false, hold_out: false }
    }

    /// Makes the run in a folder of its own within `folder`, and examines it.
    ///
    /// # Errors
    ///
    /// Effects that cannot be, a disk that does not take the run, a run that discovery refuses.
    pub fn examine(&self, folder: &Path) -> Result<Examined, String> {
        let case = Case::make(Options {
            seed: self.seed,
            model: self.model,
            plan: Plan {
                cycles: 16,
                poses: 15,
                targets: None,
                shuffled: self.seed % 2 == 1,
                mixed_overrides: false,
                payload_changes: self.payload_changes,
            },
            effects: self.effects.iter().map(|text| Request::parse(text)).collect::<Result<_, _>>()?,
            rho: (!self.effects.is_empty()).then_some(self.rho),
            point_sigma_m: None,
            joint_sigma_rad: None,
            posture_share: 0.0,
            missing: self.missing,
        })?;
        let name = format!("hidden-{}-{}", self.seed, self.effects.join("-"));
        let at = folder.join(&name);
        folder::write(&case, &name, self.form, &at).map_err(|error| format!("{}: {error}", at.display()))?;
        let run = read(&at).map_err(|error| error.to_string())?;
        let robot = Robot::read(&run.description.robot).map_err(|error| error.to_string())?;
        let request = DiscoveryRequest { hold_out: self.hold_out, ..DiscoveryRequest::default() };
        let discovery = discover(&robot, &run, &request).map_err(|error| format!("{}: {error}", at.display()))?;
        let truth = folder::truth(&case)["effects"].as_array().cloned().unwrap_or_default();
        Ok(Examined { name, case, truth, discovery })
    }
}

/// A run that was examined.
pub struct Examined {
    /// Its name.
    pub name: String,
    /// What it hides.
    pub case: Case,
    /// The same as its truth.json says it.
    truth: Vec<Value>,
    /// What was found.
    pub discovery: Discovery,
}

/// An effect and its place, as results say them.
pub type Name = (String, String);

impl Examined {
    /// What is hidden.
    pub fn hidden(&self) -> BTreeSet<Name> {
        let name =
            |effect: &Value| (effect["effect"].as_str().unwrap_or_default().to_owned(), effect["where"].to_string());
        self.truth.iter().map(name).collect()
    }

    /// What was named, `unexplained` among it.
    pub fn named(&self) -> BTreeSet<Name> {
        let findings = self.discovery.findings.iter();
        let mut named: BTreeSet<Name> =
            findings.map(|finding| (finding.effect.to_owned(), json!(finding.place).to_string())).collect();
        if self.discovery.unexplained.significant {
            named.insert(("unexplained".to_owned(), "{}".to_owned()));
        }
        named
    }

    /// Whether the names are exactly right, an effect that these data cannot tell from the one that is named counted as
    /// named where it is among the two nearest alternatives.
    pub fn is_right(&self) -> bool {
        let (hidden, named) = (self.hidden(), self.named());
        let missed: Vec<&Name> = hidden.difference(&named).collect();
        let other: Vec<&Name> = named.difference(&hidden).collect();
        let alternatives: BTreeSet<Name> = self
            .discovery
            .findings
            .iter()
            .flat_map(|finding| finding.alternatives.iter().take(2))
            .map(|other| (other.effect.to_owned(), json!(other.place).to_string()))
            .collect();
        let right = missed.len() == other.len() && missed.iter().all(|name| alternatives.contains(name));
        println!("{} {}: hidden {hidden:?}, named {named:?}", if right { "right" } else { "WRONG" }, self.name);
        right
    }

    /// How many intervals of numbers hold the truth, and how many there are.
    pub fn intervals(&self) -> (usize, usize) {
        let (mut held, mut all) = (0, 0);
        for finding in &self.discovery.findings {
            let is_it = |effect: &&Value| effect["effect"] == finding.effect && effect["where"] == json!(finding.place);
            let Some(truth) = self.truth.iter().find(is_it) else { continue };
            for estimate in finding.parameters.iter().filter(|estimate| estimate.low < estimate.high) {
                let Some(value) = truth["parameters"][&estimate.name].as_f64() else { continue };
                let holds = estimate.low <= value && value <= estimate.high;
                if !holds {
                    println!("  {}: {} is {value:e}, said {estimate:?}", self.name, estimate.name);
                }
                held += usize::from(holds);
                all += 1;
            }
        }
        (held, all)
    }
}
