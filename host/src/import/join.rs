//! Which samples belong to which visit: by cycle and pose where both say them, by time where not.

use std::collections::{BTreeMap, HashMap};

use super::mapping::{JointRows, JointsSource, PointsAre};
use super::positions::Sample;
use super::postures::{Stand, number};
use super::source::Key;

/// The visits, and what belongs to each.
pub(super) struct Join {
    /// The cycle and pose of each stand; none where nothing was measured in a standstill of a log.
    pub(super) keys: Vec<Option<Key>>,
    /// The stand of each sample, or why there is none.
    pub(super) stands: Vec<Result<usize, Miss>>,
    pub(super) by_key: usize,
    pub(super) by_time: usize,
}

/// Why a sample belongs to no visit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Miss {
    /// No row of joints has its cycle and pose.
    NoSuchVisit,
    /// It has no time, and the joints have no cycle and pose.
    NoTime,
    /// The arm did not stand, or no row of joints is near enough in time.
    NoStand,
    /// Most samples of its cycle and pose were taken at another standstill.
    OtherStand,
    /// Most samples of its standstill are of another cycle and pose.
    OtherVisit,
}

impl Miss {
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::NoSuchVisit => "no joints of that cycle and pose",
            Self::NoTime => "no time, and joints without cycle and pose",
            Self::NoStand => "no posture near that time",
            Self::OtherStand => "most of its cycle and pose were taken at another posture",
            Self::OtherVisit => "most of its posture's are of another cycle and pose",
        }
    }
}

/// The stands in order of time.
struct Timeline<'s> {
    stands: &'s [Stand],
    joints: &'s [JointsSource],
    order: Vec<(f64, usize)>,
}

impl<'s> Timeline<'s> {
    fn new(stands: &'s [Stand], joints: &'s [JointsSource]) -> Self {
        let spans = stands.iter().enumerate();
        let mut order: Vec<(f64, usize)> = spans.filter_map(|(index, stand)| Some((stand.span_s?.0, index))).collect();
        order.sort_by(|left, right| left.0.total_cmp(&right.0));
        Self { stands, joints, order }
    }

    /// The stand that a time belongs to.
    fn at(&self, time_s: f64) -> Option<usize> {
        let after = self.order.partition_point(|&(from, _)| from <= time_s);
        let neighbours = [after.checked_sub(1), Some(after)].into_iter().flatten();
        let candidates = neighbours.filter_map(|place| self.order.get(place)).filter_map(|&(_, index)| {
            let (from, to) = self.stands[index].span_s?;
            let joints = &self.joints[self.stands[index].row.source.0];
            let (early, late) = (from - time_s, time_s - to);
            let away = match joints.points {
                _ if early <= 0.0 && late <= 0.0 => 0.0,
                PointsAre::Near => early.max(late),
                PointsAre::After if early <= 0.0 => late,
                PointsAre::Before if late <= 0.0 => early,
                PointsAre::After | PointsAre::Before => return None,
            };
            (away <= joints.max_gap_s).then_some((away, index))
        });
        candidates.min_by(|left, right| left.0.total_cmp(&right.0)).map(|(_, index)| index)
    }
}

/// Joins samples, whose times in s since the run began are `times_s`, to stands.
pub(super) fn join(
    samples: &[Sample],
    times_s: &[Option<f64>],
    stands: &[Stand],
    joints: &[JointsSource],
    same_posture: f64,
) -> Join {
    let by_key: HashMap<Key, usize> =
        stands.iter().enumerate().filter_map(|(index, stand)| Some((stand.row.key?, index))).collect();
    let keyed = !by_key.is_empty();
    let timeline = Timeline::new(stands, joints);
    let mut joined =
        Join { keys: stands.iter().map(|stand| stand.row.key).collect(), stands: Vec::new(), by_key: 0, by_time: 0 };
    for (sample, time_s) in samples.iter().zip(times_s) {
        let found = match (sample.key, time_s) {
            (Some(key), _) if keyed => by_key.get(&key).copied().ok_or(Miss::NoSuchVisit),
            (_, Some(time_s)) => timeline.at(*time_s).ok_or(Miss::NoStand),
            (_, None) => Err(Miss::NoTime),
        };
        match (sample.key, found) {
            (Some(_), Ok(_)) if keyed => joined.by_key += 1,
            (_, Ok(_)) => joined.by_time += 1,
            (_, Err(_)) => {}
        }
        joined.stands.push(found);
    }
    if !keyed {
        name_stands(samples, &mut joined, stands, joints, same_posture);
    }
    joined
}

/// Gives cycles and poses to stands that came without: those of their samples, or else numbers in order of time.
fn name_stands(samples: &[Sample], joined: &mut Join, stands: &[Stand], joints: &[JointsSource], same_posture: f64) {
    let mut votes: BTreeMap<(usize, Key), usize> = BTreeMap::new();
    for (sample, stand) in samples.iter().zip(&joined.stands) {
        if let (Some(key), Ok(stand)) = (sample.key, stand) {
            *votes.entry((*stand, key)).or_default() += 1;
        }
    }
    if votes.is_empty() {
        let mut measured = vec![false; stands.len()];
        joined.stands.iter().flatten().for_each(|&stand| measured[stand] = true);
        let mut order: Vec<usize> = (0..stands.len())
            .filter(|&stand| measured[stand] || joints[stands[stand].row.source.0].rows == JointRows::Visits)
            .collect();
        order.sort_by(|&left, &right| {
            let time = |stand: usize| stands[stand].time_s().unwrap_or(f64::INFINITY);
            time(left).total_cmp(&time(right))
        });
        let postures = order.iter().map(|&stand| {
            let row = &stands[stand].row;
            row.commanded.as_deref().unwrap_or(&row.joints)
        });
        for (&stand, key) in order.iter().zip(number(postures, same_posture)) {
            joined.keys[stand] = Some(key);
        }
        return;
    }
    // The pairs with most samples first; each stand and each key is given once.
    let mut pairs: Vec<((usize, Key), usize)> = votes.into_iter().collect();
    pairs.sort_by(|left, right| right.1.cmp(&left.1).then(left.0.cmp(&right.0)));
    let mut stand_of: HashMap<Key, usize> = HashMap::new();
    for ((stand, key), _) in pairs {
        if joined.keys[stand].is_none() && !stand_of.contains_key(&key) {
            joined.keys[stand] = Some(key);
            stand_of.insert(key, stand);
        }
    }
    for (sample, found) in samples.iter().zip(&mut joined.stands) {
        let Ok(stand) = *found else { continue };
        match sample.key {
            Some(key) if joined.keys[stand] == Some(key) => {}
            Some(key) if stand_of.contains_key(&key) => *found = Err(Miss::OtherStand),
            Some(_) => *found = Err(Miss::OtherVisit),
            None if joined.keys[stand].is_some() => {}
            None => *found = Err(Miss::NoSuchVisit),
        }
        if found.is_err() {
            joined.by_time -= 1;
        }
    }
}
