//! Every effect at every place with every shape of its grid, tested against what is left.

use std::collections::{BTreeMap, HashMap};

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::chance::{ln_chi_square, ln_likelihood_ratio, ln_smallest_of};
use super::normal::{Factor, Normal, Strata, Whitened};
use super::postures::{AtPostures, Draws, Products};
use super::stage::{Column, Stage};
use crate::effect::pattern::Pattern;
use crate::effect::{Effect, Instance, Scene, Site, catalogue};

/// An effect at a place.
#[derive(Clone)]
pub struct Candidate {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Where.
    pub site: Site,
}

impl Candidate {
    fn family(&self, shape: &[f64]) -> Family {
        (self.effect.name(), self.site.clone(), self.effect.family(shape))
    }
}

/// A candidate with its best shape.
#[derive(Clone)]
pub struct Score {
    /// The effect at its place, with shape and linear estimate.
    pub instance: Instance,
    /// Twice the gain of log likelihood.
    pub ratio: f64,
    /// Coefficients that the data can tell from nuisance.
    pub freedom: usize,
    /// Logarithm of the chance that noise alone would favour this candidate as much, over all its shapes.
    pub ln_p: f64,
    /// Of its square, the share that calibration cannot absorb.
    pub visible: f64,
}

/// A candidate's shapes of one family ([`Effect::family`]).
type Family = (&'static str, Site, u8);

/// How many independent tests the search amounts to.
#[derive(Debug, Clone, Default)]
pub struct Trials {
    each: HashMap<Family, Look>,
    /// Independent candidates of the catalogue.
    named: f64,
    /// Independent patterns outside of it.
    patterns: f64,
}

/// What looking at all shapes of one candidate is worth.
#[derive(Debug, Clone, Copy)]
struct Look {
    /// Independent tests at the level that noise usually reaches.
    tests: f64,
    /// That level: a drop of the sum of squares.
    usual: f64,
}

impl Look {
    /// Independent tests at a level. Along a curve of shapes they grow with the root of the level (Davies 1987: the tube
    /// about the curve is thinner the higher the level).
    fn at(&self, drop: f64) -> f64 {
        1.0 + (self.tests - 1.0) * (drop / self.usual.max(1.0)).max(1.0).sqrt()
    }
}

impl Trials {
    /// Logarithm of the chance that the best of a candidate's shapes of the family of this one looks as good by noise alone.
    pub fn over_shapes(&self, candidate: &Candidate, shape: &[f64], ln_p: f64, drop: f64) -> f64 {
        ln_smallest_of(ln_p, self.tests(candidate, shape, drop))
    }

    /// How many independent tests the family of a shape amounts to at a level.
    fn tests(&self, candidate: &Candidate, shape: &[f64], drop: f64) -> f64 {
        self.each.get(&candidate.family(shape)).map_or(1.0, |look| look.at(drop))
    }

    /// Logarithm of the chance that the best of the whole catalogue, or of all patterns outside of it if it is one of them,
    /// looks as good as `ln_p` by noise alone.
    pub fn over_all(&self, instance: &Instance, ln_p: f64) -> f64 {
        let count = if is_pattern(instance.effect) { self.patterns } else { self.named };
        ln_smallest_of(ln_p, count.max(1.0))
    }
}

/// Whether it is a pattern outside the catalogue.
pub fn is_pattern(effect: &dyn Effect) -> bool {
    effect.name() == Pattern.name()
}

/// All candidates of a scene, patterns outside the catalogue included. Faults of readings are told by the log itself.
pub fn candidates(scene: &Scene) -> Vec<Candidate> {
    let effects = catalogue().iter().copied().filter(|effect| !effect.of_readings());
    effects
        .chain([&Pattern as &'static dyn Effect])
        .flat_map(|effect| effect.sites(scene).into_iter().map(move |site| Candidate { effect, site }))
        .collect()
}

/// A shape's columns.
pub fn columns(stage: &Stage, scene: &Scene, candidate: &Candidate, shape: &[f64]) -> Vec<Column> {
    candidate.effect.terms(scene, &candidate.site, shape).iter().map(|term| stage.column(scene, term)).collect()
}

/// Whether amounts hardly differ between the visits of a posture: such a candidate is judged between postures.
fn is_static(stage: &Stage, columns: &[Column]) -> bool {
    let (mut within, mut all) = (0.0, 0.0);
    let mut sums = vec![(0.0, 0.0); stage.postures];
    for (_, amounts) in columns.iter().flatten() {
        sums.iter_mut().for_each(|sum| *sum = (0.0, 0.0));
        let mean = amounts.iter().sum::<f64>() / amounts.len().max(1) as f64;
        for (amount, block) in amounts.iter().zip(&stage.blocks) {
            let sum = &mut sums[block.posture];
            sum.0 += 1.0;
            sum.1 += amount;
        }
        for (amount, block) in amounts.iter().zip(&stage.blocks) {
            let (count, sum) = sums[block.posture];
            within += (amount - sum / count).powi(2);
            all += (amount - mean).powi(2);
        }
    }
    within <= 0.2 * all
}

/// The models of noise that a test chooses from: the sizes of shared errors, with and without an effect, are the likeliest.
pub struct Rivals {
    factors: Vec<Factor>,
    /// The best log likelihood without any effect.
    nothing: f64,
    /// Numbers that tell the postures' shared errors.
    between: f64,
    /// Numbers that tell the errors of visits.
    within: f64,
}

impl Rivals {
    /// The rivals about given strata.
    pub fn new(normal: &Normal<'_>, strata: &Strata) -> Rivals {
        let some = |sigma: f64| if sigma > 0.0 { vec![0.0, 0.4 * sigma, 0.7 * sigma, sigma] } else { vec![0.0] };
        let mut pairs: Vec<(f64, f64)> = some(strata.posture).into_iter().map(|p| (p, strata.cycle)).collect();
        pairs.extend(some(strata.cycle).into_iter().map(|c| (strata.posture, c)));
        pairs.push((0.0, 0.0));
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        pairs.dedup();
        let factors: Vec<Factor> = pairs.into_iter().filter_map(|(p, c)| normal.system.factor(p, c)).collect();
        let nothing = factors.iter().map(|factor| factor.log_likelihood).fold(f64::NEG_INFINITY, f64::max);
        let layout = normal.system.layout;
        let between =
            (layout.joints * layout.postures) as f64 - layout.nuisance.min(layout.joints * layout.postures / 2) as f64;
        // Joints move a point in three directions, and a visit with more points in as many as there are joints.
        let rows = |block: &super::stage::Block| block.residual.len().min(layout.joints);
        let within = normal.white.stage.blocks.iter().map(rows).sum::<usize>() as f64 - layout.nuisance as f64;
        Rivals { factors, nothing, between, within }
    }
}

/// An effect that explains more than shared errors of postures and cycles by this log likelihood, and by what the choice
/// among its shapes is worth, with none of them left, is held against noise without them: shared errors are a name for what is not known, and an effect of a few numbers
/// takes all of them away only if it is their cause.
const INSTEAD: f64 = 2.0;

/// A shape with its gain.
struct Tried {
    shape: Vec<f64>,
    coefficients: Vec<f64>,
    ratio: f64,
    freedom: usize,
    ln_p: f64,
    visible: f64,
}

fn try_shape(
    normal: &Normal<'_>,
    rivals: &Rivals,
    products: &Products<'_>,
    columns: &[Column],
    candidate: &Candidate,
    shape: &[f64],
    trials: &Trials,
) -> Option<Tried> {
    let mut best: Option<(f64, &Factor, usize, Vec<f64>, f64)> = None;
    // The chance in noise that postures and cycles do not share.
    let mut instead = 0.0_f64;
    for (rank, factor) in rivals.factors.iter().enumerate() {
        let projected = products.project(rank, factor);
        let (drop, freedom, coefficients) = projected.drop();
        let gain = factor.log_likelihood + 0.5 * drop - rivals.nothing;
        if freedom > 0 && factor.is_unshared() && gain > INSTEAD + trials.tests(candidate, shape, drop).ln() {
            instead = ln_chi_square(drop, freedom);
        }
        if freedom > 0 && best.as_ref().is_none_or(|(other, ..)| gain > *other) {
            let before: f64 = projected.before.iter().map(|norm| norm * norm).sum();
            let visible = projected.own.trace() / before;
            best = Some((gain, factor, freedom, coefficients.iter().copied().collect(), visible));
        }
    }
    let (gain, factor, freedom, coefficients, visible) = best?;
    if gain <= 0.0 || !candidate.effect.is_plausible(shape, &coefficients) {
        return None;
    }
    let numbers = match factor.posture > 0.0 && is_static(normal.white.stage, columns) {
        true => rivals.between,
        false => rivals.within,
    };
    let ln_p = ln_likelihood_ratio(2.0 * gain, freedom, numbers).min(instead);
    Some(Tried { shape: shape.to_vec(), coefficients, ratio: 2.0 * gain, freedom, ln_p, visible })
}

/// Scores of all candidates that gain anything, best first. `trials` corrects each for its shapes.
pub fn score(
    normal: &Normal<'_>,
    rivals: &Rivals,
    scene: &Scene,
    candidates: &[Candidate],
    trials: &Trials,
) -> Vec<Score> {
    let stage = normal.white.stage;
    let at_postures = AtPostures::new(normal, &rivals.factors, None);
    let mut scores = in_two(candidates, |candidate| {
        let shapes = worth_a_look(&at_postures, stage, scene, candidate);
        let tried = shapes.into_iter().filter_map(|(shape, columns)| {
            try_shape(normal, rivals, &at_postures.products(&columns), &columns, candidate, &shape, trials)
        });
        tried.map(|tried| score_of(candidate, tried, trials)).min_by(|a, b| a.ln_p.total_cmp(&b.ln_p))
    });
    scores.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
    scores
}

/// Of long scans the shapes that explain most by a rough measure, with their columns; all shapes of short ones.
fn worth_a_look(
    at_postures: &AtPostures<'_>,
    stage: &Stage,
    scene: &Scene,
    candidate: &Candidate,
) -> Vec<(Vec<f64>, Vec<Column>)> {
    const CLOSELY: usize = 60;
    let shapes = candidate.effect.shapes(scene, &candidate.site);
    let is_long = shapes.len() > 2 * CLOSELY;
    let with_columns = shapes.into_iter().map(|shape| {
        let columns = columns(stage, scene, candidate, &shape);
        let rough = if is_long { at_postures.rough(&columns) } else { None };
        (rough.unwrap_or(f64::INFINITY), shape, columns)
    });
    let mut all: Vec<_> = with_columns.collect();
    let close = all.iter().filter(|(rough, ..)| rough.is_infinite()).count() + CLOSELY;
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.truncate(close);
    all.into_iter().map(|(_, shape, columns)| (shape, columns)).collect()
}

fn score_of(candidate: &Candidate, tried: Tried, trials: &Trials) -> Score {
    let instance = Instance {
        effect: candidate.effect,
        site: candidate.site.clone(),
        shape: tried.shape,
        coefficients: tried.coefficients,
    };
    let ln_p = trials.over_shapes(candidate, &instance.shape, tried.ln_p, tried.ratio);
    Score { instance, ratio: tried.ratio, freedom: tried.freedom, ln_p, visible: tried.visible }
}

/// The gains of a step at every time between two visits near one: times, the visits' times about each, twice the gain.
pub fn step_profile(
    normal: &Normal<'_>,
    rivals: &Rivals,
    scene: &Scene,
    instance: &Instance,
    trials: &Trials,
) -> Vec<(f64, f64, f64, Option<Score>)> {
    const NEAR: usize = 12;
    let candidate = Candidate { effect: instance.effect, site: instance.site.clone() };
    let Some((time_place, &time)) = instance.shape.iter().enumerate().next_back() else { return Vec::new() };
    let mut times: Vec<f64> = scene.visits.iter().map(|visit| visit.time_s).collect();
    times.dedup();
    let after = times.partition_point(|&other| other < time);
    let gaps = after.saturating_sub(NEAR).max(1)..(after + NEAR).min(times.len());
    gaps.map(|gap| {
        let mut shape = instance.shape.clone();
        shape[time_place] = 0.5 * (times[gap - 1] + times[gap]);
        let columns = columns(normal.white.stage, scene, &candidate, &shape);
        let tried =
            try_shape(normal, rivals, &Products::Columns(normal.cross(&columns)), &columns, &candidate, &shape, trials);
        let ratio = tried.as_ref().map_or(0.0, |tried| tried.ratio);
        (times[gap - 1], times[gap], ratio, tried.map(|tried| score_of(&candidate, tried, &Trials::default())))
    })
    .collect()
}

/// A candidate's best shape near one: a scan around it, twice, ever finer.
pub fn refine(normal: &Normal<'_>, rivals: &Rivals, scene: &Scene, score: &Score, trials: &Trials) -> Score {
    const EACH_SIDE: i32 = 4;
    let candidate = Candidate { effect: score.instance.effect, site: score.instance.site.clone() };
    if !candidate.effect.is_smooth() {
        if candidate.effect.refine(scene, &score.instance.shape).iter().all(|reach| *reach == 0.0) {
            return score.clone();
        }
        let profile = step_profile(normal, rivals, scene, &score.instance, trials);
        let best = profile.into_iter().filter_map(|(.., own)| own).max_by(|a, b| a.ratio.total_cmp(&b.ratio));
        return best.filter(|best| best.ratio > score.ratio).map_or_else(
            || score.clone(),
            |best| {
                // The chance of the best point of the grid, at the drop that was found between.
                let ln_p = trials.over_shapes(&candidate, &best.instance.shape, best.ln_p, best.ratio);
                Score { ln_p, ..best }
            },
        );
    }
    let mut best = score.clone();
    let mut reach = candidate.effect.refine(scene, &best.instance.shape);
    for _ in 0..2 {
        for number in 0..reach.len() {
            if reach[number] <= 0.0 {
                continue;
            }
            let center = best.instance.shape.clone();
            for step in (-EACH_SIDE..=EACH_SIDE).filter(|step| *step != 0) {
                let mut shape = center.clone();
                shape[number] += reach[number] * f64::from(step) / f64::from(EACH_SIDE);
                if shape[number] * center[number] <= 0.0 && center[number] != 0.0 {
                    continue;
                }
                let columns = columns(normal.white.stage, scene, &candidate, &shape);
                let tried = try_shape(
                    normal,
                    rivals,
                    &Products::Columns(normal.cross(&columns)),
                    &columns,
                    &candidate,
                    &shape,
                    trials,
                );
                if let Some(tried) = tried.filter(|tried| tried.ratio > best.ratio) {
                    best = score_of(&candidate, tried, trials);
                }
            }
            reach[number] /= f64::from(EACH_SIDE);
        }
    }
    best
}

/// Runs over the items on two threads, in order.
fn in_two<T: Sync, R: Send>(items: &[T], of: impl Fn(&T) -> Option<R> + Sync) -> Vec<R> {
    // Interleaved: neighbours cost alike, and an effect's places lie side by side.
    let half = |parity: usize| -> Vec<(usize, R)> {
        items
            .iter()
            .enumerate()
            .filter(|(rank, _)| rank % 2 == parity)
            .filter_map(|(rank, item)| Some((rank, of(item)?)))
            .collect()
    };
    let mut all = std::thread::scope(|scope| {
        let other = scope.spawn(|| half(1));
        let mut own = half(0);
        match other.join() {
            Ok(rest) => own.extend(rest),
            Err(panic) => std::panic::resume_unwind(panic),
        }
        own
    });
    all.sort_by_key(|(rank, _)| *rank);
    all.into_iter().map(|(_, result)| result).collect()
}

/// Draws of noise by which the search is calibrated: as many as memory allows for large runs.
const DRAWS: usize = 200;
const LARGEST: usize = 30_000_000;

/// White noise, one column a draw.
fn white_noise(random: &mut ChaCha8Rng, rows: usize, draws: usize) -> DMatrix<f64> {
    let mut uniform = || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    DMatrix::from_fn(rows, draws, |_, _| {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - uniform()));
        radius * libm::cos(std::f64::consts::TAU * uniform())
    })
}

/// Finds how many independent tests the search amounts to: the same search over draws of noise of the strata's sizes
/// (nothing hidden), by the mean of the logarithm of the smallest chance that it meets.
pub fn trials(stage: &Stage, strata: &Strata, scene: &Scene, candidates: &[Candidate], seed: u64) -> Trials {
    let draws = (LARGEST / (stage.blocks.len() * stage.places.count())).clamp(40, DRAWS);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let white = Whitened::new(stage, strata);
    let normal = Normal::with_draws(&white, strata, draws, |rows| white_noise(&mut random, rows, draws));
    let Some(factor) = normal.system.factor(strata.posture, strata.cycle) else { return Trials::default() };
    let layout = normal.system.layout;
    let mut shared = DMatrix::zeros(layout.count(), draws);
    let of_postures = layout.joints * layout.postures;
    let own = white_noise(&mut random, of_postures, draws) * strata.posture;
    shared.rows_mut(layout.nuisance, of_postures).copy_from(&own);
    let of_cycles = layout.joints * layout.cycles;
    let own = white_noise(&mut random, of_cycles, draws) * strata.cycle;
    shared.rows_mut(layout.nuisance + of_postures, of_cycles).copy_from(&own);
    let turned = factor.turn_draws(&normal, &shared);
    let factors = [factor];
    let [factor] = &factors;
    let draws_of = || Draws { turned: &turned, shared: &shared };
    let at_postures = AtPostures::new(&normal, &factors, Some(draws_of()));
    // For each family of a candidate's shapes and each draw: the smallest chance, and the drop that it belongs to.
    let results: Vec<(Family, Vec<(f64, f64)>)> = in_two(candidates, |candidate| {
        let mut largest: BTreeMap<(u8, usize), Vec<f64>> = BTreeMap::new();
        for shape in candidate.effect.shapes(scene, &candidate.site) {
            let columns = columns(stage, scene, candidate, &shape);
            let products = at_postures.products(&columns);
            let directions = products.project(0, factor).directions();
            let drops = directions.drops(&products.project_draws(factor, &draws_of()));
            let key = (candidate.effect.family(&shape), directions.count());
            let largest = largest.entry(key).or_insert_with(|| vec![0.0; draws]);
            largest.iter_mut().zip(drops).for_each(|(largest, drop)| *largest = largest.max(drop));
        }
        let mut families: BTreeMap<u8, Vec<(f64, f64)>> = BTreeMap::new();
        for ((family, freedom), drops) in largest {
            let smallest = families.entry(family).or_insert_with(|| vec![(0.0, 0.0); draws]);
            for (smallest, drop) in smallest.iter_mut().zip(drops) {
                let ln_p = ln_chi_square(drop, freedom);
                if ln_p < smallest.0 {
                    *smallest = (ln_p, drop);
                }
            }
        }
        let key = |family| (candidate.effect.name(), candidate.site.clone(), family);
        Some(families.into_iter().map(|(family, smallest)| (key(family), smallest)).collect::<Vec<_>>())
    })
    .into_iter()
    .flatten()
    .collect();
    let each: HashMap<_, _> = results
        .iter()
        .map(|(key, smallest)| {
            let tests = independent(smallest.iter().map(|(ln_p, _)| *ln_p));
            let usual = smallest.iter().map(|(_, drop)| drop).sum::<f64>() / draws as f64;
            (key.clone(), Look { tests, usual })
        })
        .collect();
    let best_of = |patterns: bool| {
        let own = results.iter().filter(|((name, ..), _)| (*name == Pattern.name()) == patterns);
        let own: Vec<_> = own.map(|(key, smallest)| (each[key], smallest)).collect();
        independent((0..draws).map(|draw| {
            let of = |(look, smallest): &(Look, &Vec<(f64, f64)>)| {
                ln_smallest_of(smallest[draw].0, look.at(smallest[draw].1))
            };
            own.iter().map(of).fold(0.0, f64::min)
        }))
    };
    let (named, patterns) = (best_of(false), best_of(true));
    Trials { each, named, patterns }
}

/// How many independent tests have the smallest chance that these draws had: `-ln(1 - p)` of the smallest of m is exponential
/// with mean 1 / m.
fn independent(ln_ps: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) =
        ln_ps.fold((0.0, 0.0), |(count, sum), ln_p| (count + 1.0, sum - (-ln_p.exp().min(0.999_999)).ln_1p()));
    if sum > 0.0 { (count / sum).max(1.0) } else { 1.0 }
}
