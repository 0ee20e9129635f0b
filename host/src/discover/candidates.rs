//! Every effect at every place with every shape of its grid, tested against what is left.

use std::collections::{BTreeMap, HashMap};

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

use super::chance::{ln_chi_square, ln_likelihood_ratio, ln_smallest_of};
use super::factor::{Draws, Factor, Projected};
use super::normal::{Normal, Strata};
use super::postures::AtPostures;
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
struct Rivals {
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
    fn new(normal: &Normal<'_>, strata: &Strata) -> Rivals {
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
/// among its shapes is worth, with none of them left, is held against noise without them: shared errors are a name for what
/// is not known, and an effect of a few numbers takes all of them away only if it is their cause.
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

/// What candidates are tested against: what a fit leaves, under every noise that a test chooses from.
pub struct Ground<'a> {
    normal: Normal<'a>,
    rivals: Rivals,
    scene: &'a Scene,
    /// Corrects each candidate for its shapes.
    trials: &'a Trials,
}

impl<'a> Ground<'a> {
    /// The ground of a stage with its strata of noise.
    pub fn new(stage: &'a Stage, strata: &Strata, scene: &'a Scene, trials: &'a Trials) -> Self {
        let normal = Normal::new(stage, strata);
        let rivals = Rivals::new(&normal, strata);
        Self { normal, rivals, scene, trials }
    }

    fn stage(&self) -> &'a Stage {
        self.normal.white.stage
    }

    /// Scores of all candidates that gain anything, best first.
    pub fn score(&self, candidates: &[Candidate]) -> Vec<Score> {
        let at_postures = AtPostures::new(&self.normal, &self.rivals.factors, None);
        let of_some = |some: &[Candidate]| {
            let looked_at = some.iter().enumerate().flat_map(|(rank, candidate)| {
                let shapes = worth_a_look(&at_postures, self.stage(), self.scene, candidate);
                shapes.into_iter().map(move |(shape, columns)| (rank, shape, columns))
            });
            let looked_at: Vec<(usize, Vec<f64>, Vec<Column>)> = looked_at.collect();
            let mut best: Vec<Option<Score>> = vec![None; some.len()];
            for hypotheses in looked_at.chunks(SIDE_BY_SIDE) {
                let columns: Vec<&[Column]> = hypotheses.iter().map(|(.., columns)| columns.as_slice()).collect();
                for (projected, (rank, shape, columns)) in at_postures.projected(&columns).iter().zip(hypotheses) {
                    let tried = self.try_projected(projected, columns, &some[*rank], shape);
                    let score = tried.map(|tried| score_of(&some[*rank], tried, self.trials));
                    let best = &mut best[*rank];
                    if score.as_ref().is_some_and(|own| best.as_ref().is_none_or(|best| own.ln_p < best.ln_p)) {
                        *best = score;
                    }
                }
            }
            best.into_iter().flatten()
        };
        let mut scores: Vec<Score> = candidates.par_chunks(TOGETHER).flat_map_iter(of_some).collect();
        scores.sort_by(|a, b| a.ln_p.total_cmp(&b.ln_p));
        scores
    }

    fn try_shape(&self, candidate: &Candidate, shape: &[f64]) -> Option<Tried> {
        let columns = columns(self.stage(), self.scene, candidate, shape);
        let cross = self.normal.cross(&columns);
        let projected: Vec<Projected> = self.rivals.factors.iter().map(|factor| factor.project(&cross)).collect();
        self.try_projected(&projected, &columns, candidate, shape)
    }

    fn try_projected(
        &self,
        projected: &[Projected],
        columns: &[Column],
        candidate: &Candidate,
        shape: &[f64],
    ) -> Option<Tried> {
        let mut best: Option<(f64, &Factor, usize, Vec<f64>, f64)> = None;
        // The chance in noise that postures and cycles do not share.
        let mut instead = 0.0_f64;
        for (factor, projected) in self.rivals.factors.iter().zip(projected) {
            let (drop, freedom, coefficients) = projected.drop();
            let gain = factor.log_likelihood + 0.5 * drop - self.rivals.nothing;
            if freedom > 0 && factor.is_unshared() && gain > INSTEAD + self.trials.tests(candidate, shape, drop).ln() {
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
        let numbers = match factor.posture > 0.0 && is_static(self.stage(), columns) {
            true => self.rivals.between,
            false => self.rivals.within,
        };
        let ln_p = ln_likelihood_ratio(2.0 * gain, freedom, numbers).min(instead);
        Some(Tried { shape: shape.to_vec(), coefficients, ratio: 2.0 * gain, freedom, ln_p, visible })
    }

    /// The gains of a step at every time between two visits near one, and before the first.
    fn step_profile(&self, instance: &Instance) -> Vec<Gap> {
        const NEAR: usize = 12;
        let candidate = Candidate { effect: instance.effect, site: instance.site.clone() };
        let Some((time_place, &time)) = instance.shape.iter().enumerate().next_back() else { return Vec::new() };
        let mut times: Vec<f64> = self.scene.visits.iter().map(|visit| visit.time_s).collect();
        times.dedup();
        // What stepped before the first visit has been so all along.
        times.insert(0, 0.0_f64.min(times.first().copied().unwrap_or(0.0)));
        let after = times.partition_point(|&other| other < time);
        let gaps = after.saturating_sub(NEAR).max(1)..(after + NEAR).min(times.len());
        gaps.map(|gap| {
            let (from_s, to_s) = (times[gap - 1], times[gap]);
            let mut shape = instance.shape.clone();
            shape[time_place] = if gap == 1 { from_s } else { 0.5 * (from_s + to_s) };
            Gap { from_s, to_s, tried: self.try_shape(&candidate, &shape) }
        })
        .collect()
    }

    /// Between which visits a step lies with 95 % confidence; none where nothing speaks for it.
    pub fn step_between(&self, instance: &Instance) -> Option<(f64, f64)> {
        let profile = self.step_profile(instance);
        let best = profile.iter().map(Gap::ratio).fold(0.0, f64::max);
        let mut near = profile.iter().filter(|gap| gap.ratio() > best - ALLOWED_DROP);
        let first = near.next()?;
        Some((first.from_s, near.next_back().unwrap_or(first).to_s))
    }

    /// A candidate's best shape near one: a scan around it, twice, ever finer.
    pub fn refine(&self, score: &Score) -> Score {
        const EACH_SIDE: i32 = 4;
        let candidate = Candidate { effect: score.instance.effect, site: score.instance.site.clone() };
        let mut reach = candidate.effect.refine(self.scene, &score.instance.shape);
        if !candidate.effect.is_smooth() {
            if reach.iter().all(|reach| *reach == 0.0) {
                return score.clone();
            }
            let profile = self.step_profile(&score.instance);
            let best = profile.into_iter().filter_map(|gap| gap.tried).max_by(|a, b| a.ratio.total_cmp(&b.ratio));
            let better = best.filter(|best| best.ratio > score.ratio);
            return better.map_or_else(|| score.clone(), |best| score_of(&candidate, best, self.trials));
        }
        let mut best = score.clone();
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
                    let tried = self.try_shape(&candidate, &shape);
                    if let Some(tried) = tried.filter(|tried| tried.ratio > best.ratio) {
                        best = score_of(&candidate, tried, self.trials);
                    }
                }
                reach[number] /= f64::from(EACH_SIDE);
            }
        }
        best
    }
}

/// Of twice the log likelihood, the drop that a 95 % interval allows.
const ALLOWED_DROP: f64 = 3.84;

/// A step at a time between two visits.
struct Gap {
    /// The visits' times.
    from_s: f64,
    to_s: f64,
    /// None where it gains nothing.
    tried: Option<Tried>,
}

impl Gap {
    /// Twice the gain of log likelihood.
    fn ratio(&self) -> f64 {
        self.tried.as_ref().map_or(0.0, |tried| tried.ratio)
    }
}

/// Hypotheses that are projected together: enough for one product to be worth it, few enough for the cache.
const SIDE_BY_SIDE: usize = 64;

/// Candidates that are looked at together: few enough to be shared out evenly.
const TOGETHER: usize = 8;

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

/// Draws of noise by which the search is calibrated: as many as memory allows for large runs.
const DRAWS: usize = 200;
const LARGEST: usize = 30_000_000;

/// White noise, one column a draw.
pub(super) fn white_noise(random: &mut ChaCha8Rng, rows: usize, draws: usize) -> DMatrix<f64> {
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
    let normal = Normal::with_draws(stage, strata, draws, |rows| white_noise(&mut random, rows, draws));
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
    let at_postures = AtPostures::new(&normal, &factors, Some(Draws { turned: &turned, shared: &shared }));
    // For each family of a candidate's shapes and each draw: the smallest chance, and the drop that it belongs to.
    let of_candidate = |candidate: &Candidate| {
        let mut largest: BTreeMap<(u8, usize), Vec<f64>> = BTreeMap::new();
        for shapes in candidate.effect.shapes(scene, &candidate.site).chunks(SIDE_BY_SIDE) {
            let columns: Vec<_> = shapes.iter().map(|shape| columns(stage, scene, candidate, shape)).collect();
            let hypotheses: Vec<&[Column]> = columns.iter().map(Vec::as_slice).collect();
            for (shape, (projected, drawn)) in shapes.iter().zip(at_postures.drawn(&hypotheses)) {
                let directions = projected.directions();
                let key = (candidate.effect.family(shape), directions.count());
                let largest = largest.entry(key).or_insert_with(|| vec![0.0; draws]);
                largest.iter_mut().zip(directions.drops(&drawn)).for_each(|(most, drop)| *most = most.max(drop));
            }
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
        families.into_iter().map(|(family, smallest)| (key(family), smallest)).collect::<Vec<_>>()
    };
    let results: Vec<(Family, Vec<(f64, f64)>)> = candidates.par_iter().flat_map_iter(of_candidate).collect();
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
