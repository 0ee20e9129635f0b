//! What is doubtful about a chain although it can be computed: said to the user, not refused.

use super::convention::{Convention, Symbol};
use super::description::{JointKind, Robot};
use super::parametrise::NEARLY_PARALLEL;

/// Two axes closer to perpendicular than this, as the cosine of their angle, make 'hayati' singular for practical purposes.
const NEARLY_PERPENDICULAR: f64 = 0.05;

impl Robot {
    /// Remarks on completeness and proportionality of the chain's parametrisation (thesis section 3.3.1), in words.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let last = self.transforms.len() - 1;
        let next_joint = |number: usize| self.transforms.get(number + 1).and_then(|transform| transform.joint.as_ref());
        for (number, transform) in self.transforms.iter().enumerate() {
            let revolute_follows = next_joint(number).is_some_and(|joint| joint.kind == JointKind::Revolute);
            if number == last || !revolute_follows {
                continue;
            }
            let (alpha, beta) = (transform.value(Symbol::Alpha), transform.value(Symbol::Beta));
            // The next axis seen along this one: the third row and column of Rx(alpha) Ry(beta).
            let cosine = libm::cos(alpha) * libm::cos(beta);
            let joint = self.transforms[..=number].iter().filter(|transform| transform.joint.is_some()).count();
            match transform.convention {
                Convention::Dh if number > 0 && 1.0 - cosine * cosine < NEARLY_PARALLEL * NEARLY_PARALLEL => remarks.push(format!(
                    "transform {number} is 'dh' between axes {joint} and {}, which are parallel: its d and the next move \
                     together and the common normal is not defined; 'hayati' suits it",
                    joint + 1
                )),
                Convention::Hayati if cosine.abs() < NEARLY_PERPENDICULAR => remarks.push(format!(
                    "transform {number} is 'hayati' between perpendicular axes, where it is singular; 'dh' suits it"
                )),
                _ => {}
            }
        }
        if self.transforms[last].convention != Convention::Full {
            remarks.push(format!(
                "the last transform ({last}) is '{}': the flange can only be placed completely by 'full'",
                self.transforms[last].convention.name()
            ));
        }
        remarks
    }
}
