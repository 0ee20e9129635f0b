//! The oracle's naming: every effect of the catalogue at every place as a candidate, nonlinear parameters known where one
//! of the kind is hidden, the noise and the strength known; the largest Bayes factor is the name. It is the most that a
//! namer can do with these data, and what candidates it cannot tell apart nobody can.

use nalgebra::{DMatrix, DVector, Vector3};

use super::case::{Case, tangents};
use super::draw::{own_parameters, thermal_parameters};
use super::effect::{Effect, basis};
use super::kind::{Kind, Place};
use super::oracle::{Basis, Oracle};
use super::random::{Purpose, Stream};
use super::readings;
use super::world::{Influence, World, less_reference};

/// An effect at a place with the shapes it may have.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// What.
    pub kind: Kind,
    /// Where.
    pub place: Place,
    /// Nonlinear parameters, each weighed alike.
    pub shapes: Vec<Vec<f64>>,
}

/// What the oracle says of a run.
#[derive(Debug, Clone)]
pub struct Verdict {
    /// What it names, the surest first; as many as exceed the threshold.
    pub named: Vec<(Kind, Place)>,
    /// The log Bayes factor that a run without any effect exceeds in 1% of the cases.
    pub threshold: f64,
    /// Candidates searched.
    pub searched: usize,
    /// For each hidden effect that positions show, the candidates nearest to it: sine of the angle, nearest first.
    pub nearest: Vec<Vec<(Kind, Place, f64)>>,
}

/// Runs without effects that set the threshold; the largest 1% of them lie above it.
const NULL_DRAWS: usize = 300;

/// All candidates; shapes of hidden effects where their kind is hidden, else a few plausible ones.
pub fn candidates(world: &World, hidden: &[Effect]) -> Vec<Candidate> {
    let arm = &world.arm;
    let joints = 0..arm.joints();
    let end = world.schedule.end_s;
    let known = |kind: Kind, else_: Vec<Vec<f64>>| {
        let shapes: Vec<Vec<f64>> =
            hidden.iter().filter(|effect| effect.kind == kind).map(|effect| effect.shape.clone()).collect();
        if shapes.is_empty() { else_ } else { shapes }
    };
    let times = || [0.25, 0.4, 0.5, 0.6, 0.75].map(|share| vec![share * end]).to_vec();
    let mut all = Vec::new();
    let mut add = |kind: Kind, place: Place, shapes: Vec<Vec<f64>>| all.push(Candidate { kind, place, shapes });
    for joint in joints.clone() {
        let waves = known(Kind::GearEccentricity, [1.0, 2.0, 3.0, 4.0].map(|h| vec![h]).to_vec());
        add(Kind::GearEccentricity, Place::joint(joint), waves);
        for kind in [Kind::EncoderGain, Kind::Backlash, Kind::JointLogEarly, Kind::JointCompliance] {
            add(kind, Place::joint(joint), vec![Vec::new()]);
        }
        let square: f64 = world.moments.iter().map(|visit| visit[joint].0 * visit[joint].0).sum();
        let typical = libm::sqrt(square / world.moments.len() as f64);
        let of_joint = |effect: &&Effect| effect.kind == Kind::LostMotion && effect.place.joint == Some(joint);
        let scale = hidden.iter().find(of_joint).map_or(0.5 * typical, |effect| effect.shape[0]);
        if typical > 0.0 {
            add(Kind::LostMotion, Place::joint(joint), vec![vec![scale]]);
        }
        for from in joints.clone().filter(|from| *from != joint) {
            add(Kind::JointCoupling, Place { from: Some(from), ..Place::joint(joint) }, vec![Vec::new()]);
        }
    }
    let thermal = thermal_parameters(world);
    for parameter in own_parameters(world) {
        if thermal.contains(&parameter) {
            add(Kind::ThermalLag, Place::parameter(parameter), known(Kind::ThermalLag, vec![vec![900.0]]));
        } else {
            let links = arm.sensors.iter().map(|sensor| sensor.link).max().map_or(0, |last| last + 1);
            let of_link = |link| world.sensors_of(link).into_iter().map(|sensor| sensor as f64).collect::<Vec<_>>();
            let shapes = (0..links).map(of_link).filter(|sensors| !sensors.is_empty()).collect();
            add(Kind::ThermalGrowth, Place::parameter(parameter), shapes);
        }
        for joint in joints.clone() {
            let place = Place { joint: Some(joint), ..Place::parameter(parameter) };
            add(Kind::UnsensedHeat, place, known(Kind::UnsensedHeat, vec![vec![1000.0]]));
        }
    }
    for pair in &arm.thermal {
        for &sensor in &pair.sensors {
            let place = Place { sensors: vec![sensor], ..Place::parameter(pair.parameter) };
            add(Kind::ThermalNonlinearity, place, vec![Vec::new()]);
        }
    }
    add(Kind::FrameDrift, Place::default(), vec![Vec::new()]);
    add(Kind::FrameJump, Place::default(), known(Kind::FrameJump, times()));
    add(Kind::ScaleError, Place::default(), vec![Vec::new()]);
    for target in 0..arm.targets.len() {
        let mut whole = times();
        whole.push(vec![0.0]);
        let place = Place { targets: vec![target], ..Place::default() };
        add(Kind::TargetShift, place, known(Kind::TargetShift, whole));
    }
    add(Kind::ToolSlip, Place::default(), known(Kind::ToolSlip, times()));
    add(Kind::ClockOffset, Place::default(), known(Kind::ClockOffset, vec![vec![300.0], vec![-300.0]]));
    all
}

/// A candidate's influences at one of its shapes; for a clock that is off, what the growth misses.
fn columns(world: &World, candidate: &Candidate, shape: &[f64]) -> Vec<Influence> {
    if candidate.kind != Kind::ClockOffset {
        return basis(world, candidate.kind, &candidate.place, shape);
    }
    let times: Vec<f64> = world.points.iter().map(|point| point.time_s).collect();
    let parameters = world.growth.iter().map(|growth| {
        let ahead = times.iter().map(|&t| world.heat.at(&growth.terms, t) - world.heat.at(&growth.terms, t - shape[0]));
        (growth.parameter, less_reference(&world.schedule, &world.points, ahead.collect()))
    });
    vec![Influence { parameters: parameters.collect(), ..Influence::default() }]
}

/// What is beyond a basis of a few columns, orthonormal.
fn beyond(basis: &Basis, columns: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let mut own = Basis::default();
    for column in columns {
        let rest = basis.beyond(&basis.beyond(column));
        // A column that calibration absorbs but for rounding says nothing.
        if rest.norm_squared() > 1e-10 * column.norm_squared() {
            own.add(&rest);
        }
    }
    own.into_columns()
}

/// Log Bayes factor of p coefficients that carry rho² together, against none.
fn evidence(square: f64, p: usize, rho: f64) -> f64 {
    let strength = rho * rho / p as f64;
    0.5 * square * strength / (1.0 + strength) - 0.5 * p as f64 * libm::log(1.0 + strength)
}

fn log_mean_exp(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + libm::log(values.iter().map(|value| libm::exp(value - most)).sum::<f64>() / values.len() as f64)
}

/// The candidates' orthonormal bases beyond one nuisance space.
struct Library {
    /// All basis vectors side by side.
    all: DMatrix<f64>,
    /// By candidate, by shape: first column and count.
    spans: Vec<Vec<(usize, usize)>>,
}

impl Library {
    fn new(white: &[Vec<Vec<DVector<f64>>>], nuisance: &Basis) -> Self {
        let (mut vectors, mut spans) = (Vec::new(), Vec::new());
        for candidate in white {
            let mut of_candidate = Vec::new();
            for columns in candidate {
                let own = beyond(nuisance, columns);
                of_candidate.push((vectors.len(), own.len()));
                vectors.extend(own);
            }
            spans.push(of_candidate);
        }
        Self { all: DMatrix::from_columns(&vectors), spans }
    }

    /// Every candidate's log Bayes factor for a residual.
    fn weigh(&self, residual: &DVector<f64>, rho: f64) -> Vec<f64> {
        let along = self.all.tr_mul(residual);
        let square = |&(first, count): &(usize, usize)| (along.rows(first, count).norm_squared(), count);
        self.spans
            .iter()
            .map(|shapes| {
                let seen = shapes.iter().map(square).filter(|(_, count)| *count > 0);
                let each: Vec<f64> = seen.map(|(square, count)| evidence(square, count, rho)).collect();
                if each.is_empty() { f64::NEG_INFINITY } else { log_mean_exp(&each) }
            })
            .collect()
    }

    /// The cosine of the angle between a direction and each candidate's nearest shape.
    fn cosines(&self, direction: &DVector<f64>) -> Vec<f64> {
        let along = self.all.tr_mul(direction);
        let length = libm::sqrt(direction.norm_squared());
        let cosine = |&(first, count): &(usize, usize)| libm::sqrt(along.rows(first, count).norm_squared()) / length;
        self.spans.iter().map(|shapes| shapes.iter().map(cosine).fold(0.0, f64::max)).collect()
    }
}

/// The oracle's verdict on a run. Gross errors and wrong sensors are taken out first: it knows them.
pub fn verdict(case: &Case) -> Verdict {
    let world = &case.world;
    let effects = case.effects();
    let seen: Vec<bool> =
        (0..world.points.len()).map(|p| case.measured[p].is_some() && !case.outliers.contains(&p)).collect();
    let rises = readings::said_rises(world, &effects);
    let oracle = Oracle::new(world, &rises, &seen);
    let searched = candidates(world, &effects);
    let white: Vec<Vec<Vec<DVector<f64>>>> = searched
        .iter()
        .map(|candidate| {
            let white = |shape: &Vec<f64>| {
                columns(world, candidate, shape).iter().map(|influence| oracle.column(influence)).collect()
            };
            candidate.shapes.iter().map(white).collect()
        })
        .collect();
    let truth = world.positions(&Influence::default(), &[]);
    let errors: Vec<Vector3<f64>> =
        case.measured.iter().zip(&truth).map(|(at, truth)| at.map_or_else(Vector3::zeros, |at| at - truth)).collect();
    let residual = oracle.visible(&oracle.whiten(&errors));
    let library = Library::new(&white, oracle.nuisance());
    let rho = case.options.rho.unwrap_or(8.0);
    let threshold = threshold(case, &library, rho);
    let nearest = effects.iter().map(|effect| nearest(case, &oracle, &searched, &white, effect)).collect();
    let named = name(&oracle, &searched, &white, library, residual, rho, threshold, effects.len().max(1));
    Verdict { named, threshold, searched: searched.len(), nearest }
}

/// The surest candidate beyond the threshold, then the surest beyond that one, as often as effects are hidden.
#[allow(clippy::too_many_arguments)] // Parts of one verdict.
fn name(
    oracle: &Oracle,
    searched: &[Candidate],
    white: &[Vec<Vec<DVector<f64>>>],
    mut library: Library,
    residual: DVector<f64>,
    rho: f64,
    threshold: f64,
    most: usize,
) -> Vec<(Kind, Place)> {
    let mut named = Vec::new();
    let mut nuisance = oracle.nuisance().clone();
    let mut residual = residual;
    for turn in 0..most {
        if turn > 0 {
            library = Library::new(white, &nuisance);
        }
        let weights = library.weigh(&residual, rho);
        let (best, weight) = (0..searched.len())
            .map(|c| (c, weights[c]))
            .fold((0, f64::NEG_INFINITY), |a, b| if b.1 > a.1 { b } else { a });
        if weight <= threshold {
            break;
        }
        named.push((searched[best].kind, searched[best].place.clone()));
        // Its most likely shape is taken out before the next is looked for.
        let along = library.all.tr_mul(&residual);
        let span = library.spans[best].iter().enumerate().max_by(|a, b| {
            let square = |span: &(usize, usize)| along.rows(span.0, span.1).norm_squared();
            square(a.1).total_cmp(&square(b.1))
        });
        if let Some((shape, _)) = span {
            white[best][shape].iter().for_each(|column| nuisance.add(column));
        }
        residual = nuisance.beyond(&residual);
    }
    named
}

fn threshold(case: &Case, library: &Library, rho: f64) -> f64 {
    let mut stream = Stream::new(case.options.seed.wrapping_add(1 << 41), Purpose::Batch);
    let mut largest: Vec<f64> = (0..NULL_DRAWS)
        .map(|_| {
            let noise = DVector::from_fn(library.all.nrows(), |_, _| stream.normal());
            // The library lies beyond the nuisance space already; noise within it does not matter.
            library.weigh(&noise, rho).into_iter().fold(f64::NEG_INFINITY, f64::max)
        })
        .collect();
    largest.sort_by(f64::total_cmp);
    largest[NULL_DRAWS - 1 - NULL_DRAWS / 100]
}

/// The candidates nearest to a hidden effect, itself left out, after all else that is hidden is projected out.
fn nearest(
    case: &Case,
    oracle: &Oracle,
    searched: &[Candidate],
    white: &[Vec<Vec<DVector<f64>>>],
    effect: &Effect,
) -> Vec<(Kind, Place, f64)> {
    const KEPT: usize = 8;
    let world = &case.world;
    let influence = if effect.kind == Kind::ClockOffset {
        let candidate =
            Candidate { kind: effect.kind, place: effect.place.clone(), shapes: vec![effect.shape.clone()] };
        columns(world, &candidate, &effect.shape).remove(0)
    } else {
        effect.influence(world)
    };
    let mut nuisance = oracle.nuisance().clone();
    for other in case.effects().iter().filter(|other| *other != effect) {
        tangents(world, other).iter().for_each(|tangent| nuisance.add(&oracle.column(tangent)));
    }
    let direction = nuisance.beyond(&oracle.column(&influence));
    if direction.norm_squared() == 0.0 {
        return Vec::new();
    }
    let cosines = Library::new(white, &nuisance).cosines(&direction);
    let mut near: Vec<(Kind, Place, f64)> = searched
        .iter()
        .zip(cosines)
        .filter(|(candidate, _)| (candidate.kind, &candidate.place) != (effect.kind, &effect.place))
        .map(|(candidate, cosine)| {
            (candidate.kind, candidate.place.clone(), libm::sqrt((1.0 - cosine * cosine).max(0.0)))
        })
        .collect();
    near.sort_by(|a, b| a.2.total_cmp(&b.2));
    near.truncate(KEPT);
    near
}
