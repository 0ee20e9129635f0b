//! Parameters by the contract's names, as a scenario gives them: taken one by one, so that what nobody took is an error.

use super::form::InstanceError;
use super::instance::Named;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Parameters on their way into an instance.
pub struct Given<'a> {
    effect: &'static str,
    named: &'a [Named],
    taken: Vec<bool>,
    asked: Vec<String>,
}

impl<'a> Given<'a> {
    /// Parameters given for an effect.
    pub fn new(effect: &'static str, named: &'a [Named]) -> Self {
        Self { effect, named, taken: vec![false; named.len()], asked: Vec::new() }
    }

    /// A parameter that may be missing.
    ///
    /// # Errors
    /// A value that is no number.
    pub fn optional(&mut self, name: &str) -> Result<Option<f64>, InstanceError> {
        self.asked.push(name.to_owned());
        let Some(place) = self.named.iter().position(|named| named.name == name) else { return Ok(None) };
        self.taken[place] = true;
        let value = self.named[place].value;
        self.require(name, value, value.is_finite(), "a finite number").map(Some)
    }

    /// A parameter.
    ///
    /// # Errors
    /// One that is missing or no number.
    pub fn number(&mut self, name: &str) -> Result<f64, InstanceError> {
        let missing = InstanceError::Missing { effect: self.effect, name: name.to_owned() };
        self.optional(name)?.ok_or(missing)
    }

    /// A parameter above zero.
    ///
    /// # Errors
    /// One that is missing or not above zero.
    pub fn positive(&mut self, name: &str) -> Result<f64, InstanceError> {
        let value = self.number(name)?;
        self.require(name, value, value > 0.0, "more than 0")
    }

    /// Holds a value against what it can be.
    ///
    /// # Errors
    /// A value that it cannot be.
    pub fn require(&self, name: &str, value: f64, right: bool, expected: &'static str) -> Result<f64, InstanceError> {
        match right {
            true => Ok(value),
            false => Err(InstanceError::Value { effect: self.effect, name: name.to_owned(), value, expected }),
        }
    }

    /// Three parameters of a vector, `shift_x_m` and so on; zero where one is missing.
    ///
    /// # Errors
    /// A value that is no number.
    pub fn vector(&mut self, kind: &str, unit: &str) -> Result<Vec<f64>, InstanceError> {
        AXES.iter().map(|axis| Ok(self.optional(&format!("{kind}_{axis}_{unit}"))?.unwrap_or(0.0))).collect()
    }

    /// `name` if it is given alone, else `name_1`, `name_2` and so on.
    ///
    /// # Errors
    /// None of them, or a value that is no number.
    pub fn numbered(&mut self, alone: &str, number: impl Fn(usize) -> String) -> Result<Vec<f64>, InstanceError> {
        if let Some(one) = self.optional(alone)? {
            return Ok(vec![one]);
        }
        let mut values = Vec::new();
        while let Some(value) = self.optional(&number(values.len() + 1))? {
            values.push(value);
        }
        match values.is_empty() {
            true => Err(InstanceError::Missing { effect: self.effect, name: alone.to_owned() }),
            false => Ok(values),
        }
    }

    /// That nothing is left over.
    ///
    /// # Errors
    /// A parameter that nobody asked for.
    pub fn finish(self) -> Result<(), InstanceError> {
        let left = self.named.iter().zip(&self.taken).find(|(_, taken)| !**taken);
        let expected = if self.asked.is_empty() { "none".to_owned() } else { self.asked.join(", ") };
        match left {
            None => Ok(()),
            Some((named, _)) => Err(InstanceError::Unknown { effect: self.effect, name: named.name.clone(), expected }),
        }
    }
}

impl Named {
    /// A vector by the names of its coordinates: `shift_m` is `shift_x_m`, `shift_y_m`, `shift_z_m`; `rot_rad` is what
    /// turns. None where the name has no unit.
    pub fn vector(name: &str, values: [f64; 3]) -> Option<Vec<Named>> {
        let (kind, unit) = name.split_once('_')?;
        let kind = if kind == "rot" { "turn" } else { kind };
        Some(AXES.iter().zip(values).map(|(axis, value)| Named::new(format!("{kind}_{axis}_{unit}"), value)).collect())
    }
}
