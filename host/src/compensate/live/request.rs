//! What a robot asks and what it is answered: one line of JSON each.
//!
//! `correct` is the stream that moves the arm: its corrections are bounded in size and rate, and where there is none for a
//! posture the last one is held. `forward` and `inverse` compute; a solution that differs from the nominal arm's by more than
//! any correction may be is refused.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Quaternion, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};

use super::super::arm::Present;
use super::super::correction::{Corrector, Guard};
use super::super::inverse::{Branches, InverseError};
use super::follower::Footing;
use crate::robot::Frame;

/// The longest line that is read as a request, bytes.
pub const LONGEST_REQUEST: usize = 16 * 1024;

/// No place is farther from the instrument than this, m.
const FARTHEST_M: f64 = 1e4;

/// The arm at the present temperatures, and what those rest on. A new one replaces it whenever either changes.
#[derive(Debug, Clone)]
pub struct Moment {
    /// The arm.
    pub present: Present,
    /// What its temperatures rest on.
    pub footing: Footing,
    /// The temperatures, °C, by sensor; those that matter.
    pub celsius: Vec<(String, f64)>,
}

/// A request. Unknown fields are refused: one that is misspelt would otherwise be missed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Request {
    #[serde(default)]
    id: Value,
    op: Operation,
    joints: Option<Vec<f64>>,
    position: Option<[f64; 3]>,
    quaternion: Option<[f64; 4]>,
    seed: Option<Vec<f64>>,
    #[serde(default)]
    all: bool,
    #[serde(default)]
    payload_kg: f64,
    #[serde(default)]
    approach: Vec<f64>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Operation {
    Correct,
    Forward,
    Inverse,
    State,
}

/// Answers the requests of one connection.
#[derive(Debug)]
pub struct Answerer {
    moment: Arc<Moment>,
    present: Present,
    corrector: Corrector,
    guard: Arc<Mutex<Guard>>,
}

impl Answerer {
    /// With the arm at a moment; `guard` is shared by all connections, as there is one arm.
    pub fn new(moment: Arc<Moment>, corrector: Corrector, guard: Arc<Mutex<Guard>>) -> Self {
        Self { present: moment.present.clone(), moment, corrector, guard }
    }

    /// Another moment, where it is another.
    pub fn renew(&mut self, moment: &Arc<Moment>) {
        if !Arc::ptr_eq(moment, &self.moment) {
            self.present = moment.present.clone();
            self.moment = Arc::clone(moment);
        }
    }

    /// The answer to a line, without the line's end. `now_s` is a clock that never goes back.
    pub fn answer(&mut self, line: &[u8], now_s: f64) -> String {
        let request: Request = match serde_json::from_slice(line) {
            Ok(request) => request,
            Err(error) => return refusal(Value::Null, &format!("no request: {error}")).to_string(),
        };
        let id = request.id.clone();
        let answer = match self.carry_out(&request, now_s) {
            Ok(mut answer) => {
                answer["id"] = id;
                answer["ok"] = json!(true);
                answer["temperatures"] = json!(self.moment.footing.name());
                if !self.moment.footing.why().is_empty() {
                    answer["why"] = json!(self.moment.footing.why());
                }
                answer
            }
            Err(message) => refusal(id, &message),
        };
        answer.to_string()
    }

    fn carry_out(&mut self, request: &Request, now_s: f64) -> Result<Value, String> {
        let count = self.present.joint_count();
        if !request.approach.is_empty() && request.approach.len() != count {
            return Err(format!("approach: expected {count} numbers"));
        }
        if !(0.0..=1e5).contains(&request.payload_kg)
            || request.approach.iter().any(|sign| !(-1.0..=1.0).contains(sign))
        {
            return Err("payload_kg: expected kilograms from 0; approach: numbers from -1 to 1".to_owned());
        }
        self.present.load(request.payload_kg, &request.approach);
        match request.op {
            Operation::State => {
                let celsius: serde_json::Map<String, Value> =
                    self.moment.celsius.iter().map(|(name, celsius)| (name.clone(), json!(celsius))).collect();
                Ok(json!({ "celsius": celsius }))
            }
            Operation::Forward => {
                let joints = self.joints(request.joints.as_deref(), "joints")?;
                Ok(place(&self.present.forward(&joints)))
            }
            Operation::Correct => {
                let joints = self.joints(request.joints.as_deref(), "joints")?;
                let outcome = self.corrector.correct(&mut self.present, &joints);
                let mut guard = self.guard.lock().unwrap_or_else(PoisonError::into_inner);
                let (corrected, held) = match outcome {
                    Ok(wanted) => (guard.pass(&joints, wanted, now_s), None),
                    Err(error) => (guard.hold(&joints), Some(error.to_string())),
                };
                drop(guard);
                let mut answer = json!({
                    "joints": corrected.joints, "correction": corrected.correction, "bounded": corrected.bounded,
                });
                if let Some(held) = held {
                    answer["held"] = json!(held);
                }
                Ok(answer)
            }
            Operation::Inverse => self.inverse(request),
        }
    }

    fn inverse(&mut self, request: &Request) -> Result<Value, String> {
        let (Some(position), Some(quaternion)) = (request.position, request.quaternion) else {
            return Err("inverse: expected position [x, y, z] in m and quaternion [w, x, y, z]".to_owned());
        };
        let goal = goal(position, quaternion)?;
        let unreachable = |error: InverseError| error.to_string();
        let solutions = match (&request.seed, request.all) {
            (Some(seed), false) => {
                let seed = self.joints(Some(seed), "seed")?;
                vec![self.present.inverse_near(&goal, &seed).map_err(unreachable)?]
            }
            (_, true) => {
                let Branches { solutions, .. } = self.present.branches(&goal).map_err(unreachable)?;
                solutions
            }
            (None, false) => vec![self.present.inverse(&goal).map_err(unreachable)?],
        };
        let checked: Vec<Value> = solutions
            .into_iter()
            .filter_map(|solution| {
                let correction = self.corrector.against_nominal(&goal, &solution.joints)?;
                Some(json!({ "joints": solution.joints, "correction": correction }))
            })
            .collect();
        match checked.first() {
            None => Err("the solution differs from the nominal arm's by more than the model's bound on corrections \
                         (a singular place, or one at the edge of the reach)"
                .to_owned()),
            Some(_) if request.all => Ok(json!({ "solutions": checked })),
            Some(first) => Ok(first.clone()),
        }
    }

    /// Joint positions of a request: as many as the arm has, within its limits.
    fn joints(&self, given: Option<&[f64]>, name: &str) -> Result<Vec<f64>, String> {
        let count = self.present.joint_count();
        let joints = given.ok_or_else(|| format!("expected {name}: {count} numbers, rad or m"))?;
        if joints.len() != count {
            return Err(format!("{name}: {} numbers, expected {count}", joints.len()));
        }
        match self.present.outside(joints) {
            Some((joint, low, high)) => {
                Err(format!("{name}: joint {} is {}, expected {low} to {high}", joint + 1, joints[joint]))
            }
            None => Ok(joints.to_vec()),
        }
    }
}

fn refusal(id: Value, message: &str) -> Value {
    json!({ "id": id, "ok": false, "error": message })
}

/// A frame as position and quaternion.
fn place(frame: &Frame) -> Value {
    let turn = frame.quaternion();
    json!({ "position": [frame.origin.x, frame.origin.y, frame.origin.z], "quaternion": [turn.w, turn.i, turn.j, turn.k] })
}

/// A place of the flange from a position, m, and a quaternion w, x, y, z.
fn goal(position: [f64; 3], [w, x, y, z]: [f64; 4]) -> Result<Frame, String> {
    if position.iter().any(|coordinate| coordinate.abs() > FARTHEST_M) {
        return Err("position: expected metres".to_owned());
    }
    Frame::from_quaternion(Vector3::from(position), Quaternion::new(w, x, y, z))
        .ok_or_else(|| "quaternion: expected w, x, y, z of length 1".to_owned())
}
