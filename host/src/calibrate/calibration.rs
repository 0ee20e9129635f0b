//! A whole calibration: alignment, geometry at the reference cycle, geometry and thermal coefficients from all cycles
//! together, the thesis's way beside it, uncertainties, and the model that comes of it.

use super::align::align;
use super::campaign::{Campaign, ObservedVisit};
use super::covariance::{Uncertainty, uncertainty, with_growth};
use super::identify::{Identification, Manner, geometric_unknowns, identify};
use super::observe::{ObserveOptions, Observed, observe};
use super::problem::Problem;
use super::rank::in_words;
use super::robust::Loss;
use super::solve::{Solution, solve};
use super::strata::weighed_growth;
use super::thermal::{Choice, ChosenBy, PerCycle, choose, per_cycle};
use super::unknown::{GrowthTerm, State, Unknown};
use crate::input::InputError;
use crate::model::{CorrectionBounds, ErrorTally, Errors, Geometry, Growth, Model, ParameterEstimate};
use crate::robot::{ParameterId, Robot};
use crate::run::Run;

/// What a calibration is asked to do.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Request {
    /// How the run is read.
    pub observe: ObserveOptions,
    /// Parameters to be left at nominal.
    pub fixed: Vec<ParameterId>,
    /// How identifications are made.
    pub manner: Manner,
    /// Whether thermal coefficients are left out.
    pub geometry_only: bool,
    /// Whether the instrument's noise alone weighs measurements, even where the strata of noise could be told apart.
    pub instrument_weights: bool,
}

/// A calibration with all that is worth reporting.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// The calibrated arm.
    pub model: Model,
    /// The measurements used, growth terms included.
    pub campaign: Campaign,
    /// Whether base and targets were aligned first.
    pub aligned: bool,
    /// The final identification: geometry and growth together.
    pub joint: Identification,
    /// How sure its values are.
    pub uncertainty: Uncertainty,
    /// The choice of growth terms; none in a purely geometric calibration.
    pub choice: Option<Choice>,
    /// The thesis's way.
    pub per_cycle: Option<PerCycle>,
    /// The state found.
    pub state: State,
    /// Whether all strata of noise weighed the measurements; otherwise the instrument's noise alone did.
    pub weighed_by_strata: bool,
    /// Remarks in words.
    pub notes: Vec<String>,
}

/// Why a calibration cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The input does not allow it.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The identification does not converge.
    #[error("the identification did not converge: {0}")]
    NotConverged(String),
}

/// Distances between measured and predicted positions of a campaign at a state.
pub fn position_errors(campaign: &Campaign, state: &State) -> ErrorTally {
    let mut tally = ErrorTally::default();
    Problem::new(campaign, Vec::new(), state).distances(state, |_, _, error| tally.add(error.norm()));
    tally
}

/// The start of an identification: what was observed, aligned where that is needed.
#[derive(Debug, Clone)]
pub struct Start {
    /// The observed run.
    pub observed: Observed,
    /// Nominal values, aligned.
    pub nominal: State,
    /// Whether base and targets had to be aligned.
    pub aligned: bool,
    /// Places of parameters to be left at nominal.
    pub fixed: Vec<usize>,
}

/// Reads a run and aligns the nominal arm to the visits that `pick` chooses.
///
/// # Errors
/// What [`observe`] refuses, and a fixed parameter that the chain does not have.
pub fn start(
    robot: &Robot,
    run: &Run,
    request: &Request,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<Start, InputError> {
    let mut observed = observe(robot, run, &request.observe, None)?;
    let fixed = request
        .fixed
        .iter()
        .map(|&id| {
            observed.campaign.chain.place(id).ok_or_else(|| {
                InputError::of_file(&run.description.robot, format!("the chain has no parameter {id} to fix"))
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    observed.campaign = observed.campaign.select(pick);
    if observed.campaign.visits.is_empty() {
        let message = "no visit is left to calibrate with: the choice of poses leaves none";
        return Err(InputError::of_file(&run.folder.join("poses.csv"), message));
    }
    let aligned = align(&observed.robot, &observed.campaign, &observed.nominal, &observed.unknown_targets);
    let nominal = aligned.clone().unwrap_or_else(|| observed.nominal.clone());
    Ok(Start { nominal, aligned: aligned.is_some(), observed, fixed })
}

/// Calibrates an arm from the visits of a run that `pick` chooses.
///
/// # Errors
/// Input that cannot be used, or an identification that does not converge.
pub fn calibrate(
    robot: &Robot,
    run: &Run,
    request: &Request,
    pick: impl Fn(&ObservedVisit) -> bool,
) -> Result<Calibration, CalibrationError> {
    let Start { observed, nominal, aligned, fixed } = start(robot, run, request, pick)?;
    let reference_cycle = run.description.reference_cycle;
    let mut notes = observed.notes.clone();
    let mut campaign = observed.campaign.clone();
    let unknowns = geometric_unknowns(&campaign, &observed.unknown_targets, &observed.unknown_anchors, &fixed);

    let geometric = identify(&campaign, unknowns.clone(), nominal.clone(), &request.manner);
    let choice = (!request.geometry_only && !campaign.sensors.is_empty())
        .then(|| choose(&observed.robot, &campaign, &geometric.unknowns, &geometric.solution.state))
        .filter(|choice| {
            if choice.terms.is_empty() && choice.by == ChosenBy::HeldOutCycles {
                notes.push("no parameter follows any sensor in a way that holds on held-out cycles".into());
            }
            !choice.terms.is_empty()
        });
    let mut joint = geometric.clone();
    if let Some(choice) = &choice {
        campaign.growth = choice.terms.clone();
        let mut with_growth = unknowns.clone();
        with_growth.extend((0..choice.terms.len()).map(Unknown::Growth));
        let start = State { growth: vec![0.0; choice.terms.len()], ..geometric.solution.state.clone() };
        joint = identify(&campaign, with_growth, start, &request.manner);
        // Observability is the geometry's: of a parameter and its growth together it would be another question.
        joint.sensitivity = geometric.sensitivity.clone();
    }
    if !joint.solution.stop.converged() {
        let words = joint.solution.stop.words().to_owned();
        return Err(CalibrationError::NotConverged(words));
    }
    let mut state = joint.solution.state.clone();
    let mut uncertainty = uncertainty(&Problem::new(&campaign, joint.unknowns.clone(), &state), &state);
    // Where postures are visited more than once, the strata of noise can be told apart, and weigh growth as they should.
    let strata = uncertainty.noise.posture > 0.0 && request.manner.loss == Loss::Squares && !request.instrument_weights;
    let mut weighed = false;
    if let Some((found, at, sureness)) =
        strata.then(|| grown_by_strata(&campaign, &joint, &uncertainty, &request.manner)).flatten()
    {
        joint.solution = found;
        (state, uncertainty, weighed) = (at, sureness, true);
    }

    // The model of the reference cycle alone, as far as its poses suffice.
    let cold = campaign.select(|visit| visit.cycle == reference_cycle);
    let several = campaign.visits.iter().any(|visit| visit.cycle != reference_cycle);
    let mut at_reference = State { growth: Vec::new(), ..state.clone() };
    let mut cycles = None;
    if several && !cold.visits.is_empty() {
        let plain = Campaign { growth: Vec::new(), ..cold };
        let start = State { growth: Vec::new(), ..geometric.solution.state.clone() };
        let own = identify(&plain, geometric.unknowns.clone(), start, &request.manner);
        if own.held.is_empty() && own.weak.is_empty() && own.solution.stop.converged() {
            at_reference = own.solution.state;
            if choice.is_some() {
                cycles = Some(per_cycle(&campaign, &at_reference, &own.unknowns, reference_cycle));
            }
        } else {
            notes.push(format!(
                "cycle {reference_cycle} alone does not determine all parameters: its geometry is that of all cycles together"
            ));
        }
    }
    let estimates = estimates(&campaign, &observed.nominal, &state, &joint, &uncertainty, &unknowns);
    let sigmas = uncertainty.sigmas();
    let growth = (0..campaign.growth.len())
        .filter_map(|term| {
            // A coefficient that the data do not tell is named among what is held; it has no value to give.
            let column = joint.unknowns.iter().position(|&unknown| unknown == Unknown::Growth(term))?;
            Some(Growth {
                parameter: campaign.chain.parameters()[campaign.growth[term].parameter],
                sensor: campaign.sensors[campaign.growth[term].sensor].clone(),
                coefficient: state.growth[term],
                sigma: sigmas[column],
            })
        })
        .collect();
    notes.extend(observed.robot.remarks());
    let model = Model {
        robot: observed.robot,
        nominal: nominal.geometry,
        geometric: at_reference.geometry,
        reference: state.geometry.clone(),
        growth,
        temperatures: observed.temperatures,
        anchors: campaign.anchors.clone(),
        estimates,
        correction_bounds: CorrectionBounds::default(),
        extended: None,
    };
    Ok(Calibration {
        model,
        campaign,
        aligned,
        joint,
        uncertainty,
        choice,
        per_cycle: cycles,
        state,
        weighed_by_strata: weighed,
        notes,
    })
}

/// Growth found under all strata of noise, then geometry by the errors of position that it leaves: the solution, its state
/// and how sure both are. None where there is no growth or a search fails.
fn grown_by_strata(
    campaign: &Campaign,
    joint: &Identification,
    least_squares: &Uncertainty,
    manner: &Manner,
) -> Option<(Solution, State, Uncertainty)> {
    let growth = weighed_growth(campaign, &joint.unknowns, &joint.solution.state, &least_squares.noise)?;
    let geometric: Vec<Unknown> =
        joint.unknowns.iter().copied().filter(|unknown| !matches!(unknown, Unknown::Growth(_))).collect();
    let start = State { growth: growth.coefficients, ..joint.solution.state.clone() };
    let problem = Problem::new(campaign, geometric, &start);
    let solution = solve(&problem, start, &manner.stopping);
    if !solution.stop.converged() {
        return None;
    }
    let state = solution.state.clone();
    let own = uncertainty(&problem, &state);
    let both = Problem::new(campaign, joint.unknowns.clone(), &state);
    let sureness = with_growth(own, &growth.covariance, &both, &state)?;
    Some((solution, state, sureness))
}

/// What is known of every parameter of the chain and every unknown target and anchor.
fn estimates(
    campaign: &Campaign,
    nominal: &State,
    state: &State,
    joint: &Identification,
    uncertainty: &Uncertainty,
    asked: &[Unknown],
) -> Vec<ParameterEstimate> {
    let names = campaign.names();
    let sigmas = uncertainty.sigmas();
    let factor = uncertainty.coverage_factor();
    let parameters = (0..campaign.chain.parameters().len()).map(Unknown::Parameter);
    let others = asked.iter().copied().filter(|unknown| !matches!(unknown, Unknown::Parameter(_)));
    parameters
        .chain(others)
        .map(|unknown| {
            let column = joint.unknowns.iter().position(|&own| own == unknown);
            let sigma = column.map(|column| sigmas[column]);
            ParameterEstimate {
                name: names.name(unknown),
                unit: names.unit(unknown),
                nominal: nominal.value(unknown),
                value: state.value(unknown),
                sigma,
                half_width: sigma.map(|sigma| factor * sigma),
            }
        })
        .collect()
}

impl Calibration {
    /// Errors of position of the three levels over the visits of another selection of the same run.
    pub fn errors(&self, campaign: &Campaign) -> [Errors; 3] {
        let at = |geometry: &Geometry, growth: &[f64]| {
            let with_terms = Campaign {
                growth: if growth.is_empty() { Vec::new() } else { self.campaign.growth.clone() },
                ..campaign.clone()
            };
            position_errors(&with_terms, &State { geometry: geometry.clone(), growth: growth.to_vec() }).errors()
        };
        [at(&self.model.nominal, &[]), at(&self.model.geometric, &[]), at(&self.model.reference, &self.state.growth)]
    }

    /// Errors of position of the thesis's way: the reference cycle's geometry with coefficients found cycle by cycle. None
    /// where there are no such coefficients.
    pub fn cycle_by_cycle_errors(&self) -> Option<Errors> {
        let coefficients = self.per_cycle.as_ref()?.coefficients.clone()?;
        let state = State { geometry: self.model.geometric.clone(), growth: coefficients };
        Some(position_errors(&self.campaign, &state).errors())
    }

    /// A thermal coefficient as the thesis's way finds it; none where it could not be used.
    pub fn cycle_by_cycle(&self, growth: &Growth) -> Option<f64> {
        let coefficients = self.per_cycle.as_ref()?.coefficients.as_ref()?;
        let names = |term: &GrowthTerm| {
            (self.campaign.chain.parameters()[term.parameter], self.campaign.sensors[term.sensor].as_str())
        };
        let own = (growth.parameter, growth.sensor.as_str());
        self.campaign.growth.iter().position(|term| names(term) == own).map(|term| coefficients[term])
    }

    /// What these data cannot identify, in words.
    pub fn unidentifiable(&self) -> Vec<String> {
        let names = self.campaign.names();
        self.joint.held.iter().map(|held| in_words(held, &names, &self.model.nominal.parameters)).collect()
    }

    /// What these data tell too weakly to be believed, in words.
    pub fn weak(&self) -> Vec<String> {
        let names = self.campaign.names();
        self.joint
            .weak
            .iter()
            .map(|weak| {
                let partners: Vec<String> =
                    weak.moves_with.iter().take(4).map(|(unknown, _)| names.name(*unknown)).collect();
                let (sigma, unit) = match names.unit(weak.unknown) {
                    "rad" => (weak.sigma.to_degrees(), "°"),
                    _ => (weak.sigma * 1e3, "mm"),
                };
                let name = names.name(weak.unknown);
                format!(
                    "{name} would be known to ±{sigma:.2} {unit} only: it moves almost together with {}; {name} held",
                    partners.join(", ")
                )
            })
            .collect()
    }

    /// Pairs of unknowns whose estimates are correlated by more than `threshold`, strongest first.
    pub fn correlations(&self, threshold: f64) -> Vec<(String, String, f64)> {
        let names = self.campaign.names();
        let unknowns = &self.joint.unknowns;
        let mut pairs = Vec::new();
        for i in 0..unknowns.len() {
            for j in i + 1..unknowns.len() {
                let correlation = self.uncertainty.correlation(i, j);
                if correlation.abs() > threshold {
                    pairs.push((names.name(unknowns[i]), names.name(unknowns[j]), correlation));
                }
            }
        }
        pairs.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
        pairs
    }
}
