//! Where an effect sits: the joint, parameter, sensor or target that identifies the instance.

use serde::{Deserialize, Serialize};

use crate::robot::{Chain, ParameterId};

/// Indices count from 0; what does not apply is absent or empty.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Site {
    /// The joint.
    pub joint: Option<usize>,
    /// The joint that a coupling comes from.
    pub from: Option<usize>,
    /// Place of the parameter in [`Chain::parameters`].
    pub parameter: Option<usize>,
    /// The sensors.
    pub sensors: Vec<usize>,
    /// The targets.
    pub targets: Vec<usize>,
}

impl Site {
    /// Nowhere in particular.
    pub fn whole() -> Self {
        Self::default()
    }

    /// A joint.
    pub fn joint(joint: usize) -> Self {
        Self { joint: Some(joint), ..Self::default() }
    }

    /// A parameter.
    pub fn parameter(place: usize) -> Self {
        Self { parameter: Some(place), ..Self::default() }
    }

    /// A sensor.
    pub fn sensor(sensor: usize) -> Self {
        Self { sensors: vec![sensor], ..Self::default() }
    }

    /// A target.
    pub fn target(target: usize) -> Self {
        Self { targets: vec![target], ..Self::default() }
    }

    /// By the names of the contract.
    pub fn named(&self, chain: &Chain, sensors: &[String], targets: &[String]) -> SiteNames {
        let many = |indices: &[usize], names: &[String]| -> Vec<String> {
            indices.iter().map(|&index| names[index].clone()).collect()
        };
        let (mut sensor, mut target) = (None, None);
        let (mut sensors, mut targets) = (many(&self.sensors, sensors), many(&self.targets, targets));
        if sensors.len() == 1 {
            sensor = sensors.pop();
        }
        if targets.len() == 1 {
            target = targets.pop();
        }
        SiteNames {
            joint: self.joint.map(|joint| joint + 1),
            from: self.from.map(|joint| joint + 1),
            parameter: self.parameter.map(|place| chain.parameters()[place].to_string()),
            sensor,
            sensors,
            target,
            targets,
        }
    }
}

/// `where` of a finding, by the contract's names; joints count from 1.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SiteNames {
    /// The joint.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub joint: Option<usize>,
    /// The joint that a coupling comes from.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub from: Option<usize>,
    /// The parameter.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub parameter: Option<String>,
    /// The sensor.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub sensor: Option<String>,
    /// Two sensors.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub sensors: Vec<String>,
    /// The target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub target: Option<String>,
    /// Two targets.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub targets: Vec<String>,
}

impl std::fmt::Display for SiteNames {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut words = Vec::new();
        match (self.from, self.joint) {
            (Some(from), Some(joint)) => words.push(format!("from joint {from} to joint {joint}")),
            (_, Some(joint)) => words.push(format!("joint {joint}")),
            _ => {}
        }
        words.extend([&self.parameter, &self.sensor, &self.target].into_iter().flatten().cloned());
        for many in [&self.sensors, &self.targets] {
            if !many.is_empty() {
                words.push(many.join(" and "));
            }
        }
        f.write_str(&words.join(", "))
    }
}

impl SiteNames {
    /// Back to indices; `None` where a name is not known to the arm or the run.
    pub fn site(&self, chain: &Chain, sensors: &[String], targets: &[String]) -> Option<Site> {
        let joint = |number: Option<usize>| match number {
            None => Some(None),
            Some(number) => (1..=chain.joint_count()).contains(&number).then(|| Some(number - 1)),
        };
        let among = |one: &Option<String>, many: &[String], known: &[String]| -> Option<Vec<usize>> {
            one.iter().chain(many).map(|name| known.iter().position(|other| other == name)).collect()
        };
        let parameter = match &self.parameter {
            None => None,
            Some(name) => Some(chain.place(name.parse::<ParameterId>().ok()?)?),
        };
        Some(Site {
            joint: joint(self.joint)?,
            from: joint(self.from)?,
            parameter,
            sensors: among(&self.sensor, &self.sensors, sensors)?,
            targets: among(&self.target, &self.targets, targets)?,
        })
    }
}
