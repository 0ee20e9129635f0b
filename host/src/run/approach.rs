//! The direction from which each joint came to a posture: as the file gives it, or from the order of the visits.

use super::{Run, Visit};

/// A joint that moved less than this between visits did not move, rad or m: the jitter of a servo at rest stays below
/// it, and postures differ by more.
const REST: f64 = 1e-4;

impl Run {
    /// The sign of each joint's last motion at each visit: -1, 0 or 1, visits by joints.
    ///
    /// Where the file gives none, a sign follows from the visit before in order of time, by the commanded joints if both
    /// visits have them and else by the logged ones. A joint that rested between two visits keeps the sign it had; 0
    /// stands where no motion is known yet, as at the first visit.
    pub fn approach_directions(&self) -> Vec<Vec<i8>> {
        let mut directions: Vec<Vec<i8>> = Vec::with_capacity(self.visits.len());
        let mut before: Option<&Visit> = None;
        for visit in &self.visits {
            let signs = match (&visit.approach, before, directions.last()) {
                (Some(given), _, _) => given.clone(),
                (None, Some(before), Some(last)) => signs_after(before, visit, last),
                _ => vec![0; visit.joints.len()],
            };
            directions.push(signs);
            before = Some(visit);
        }
        directions
    }
}

fn signs_after(before: &Visit, visit: &Visit, last: &[i8]) -> Vec<i8> {
    let (from, to) = match (&before.commanded, &visit.commanded) {
        (Some(from), Some(to)) => (from, to),
        _ => (&before.joints, &visit.joints),
    };
    let sign = |((&from, &to), &last): ((&f64, &f64), &i8)| match to - from {
        motion if motion > REST => 1,
        motion if motion < -REST => -1,
        _ => last,
    };
    from.iter().zip(to).zip(last).map(sign).collect()
}
