//! The name of one geometric parameter of a chain: its symbol and its transform's number.

use std::fmt;
use std::str::FromStr;

use super::convention::Symbol;

/// A geometric parameter such as `d1` or `beta2`: a symbol and the number of its transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ParameterId {
    /// The number of the transform, 0 being world to base.
    pub transform: usize,
    /// Which of the transform's parameters.
    pub symbol: Symbol,
}

impl ParameterId {
    /// The parameter `symbol` of transform `transform`.
    pub const fn new(symbol: Symbol, transform: usize) -> Self {
        Self { transform, symbol }
    }
}

impl fmt::Display for ParameterId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}{}", self.symbol.name(), self.transform)
    }
}

/// A text that is no parameter's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is no parameter's name: expected a symbol (d, theta, a, alpha, b, beta) and a transform's number, as in d1"
)]
pub struct NoParameterName(String);

impl FromStr for ParameterId {
    type Err = NoParameterName;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let digits = text.find(|c: char| c.is_ascii_digit()).unwrap_or(text.len());
        let (symbol, number) = text.split_at(digits);
        Symbol::ALL
            .into_iter()
            .find(|candidate| candidate.name() == symbol)
            .zip(number.parse().ok())
            .map(|(symbol, transform)| ParameterId { transform, symbol })
            .ok_or_else(|| NoParameterName(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for symbol in Symbol::ALL {
            for transform in [0, 6, 12] {
                let id = ParameterId::new(symbol, transform);
                assert_eq!(id.to_string().parse(), Ok(id));
            }
        }
    }

    #[test]
    fn other_texts_are_refused() {
        for text in ["", "d", "1", "dd1", "beta2x", "d-1", "gamma1"] {
            assert!(text.parse::<ParameterId>().is_err(), "{text:?}");
        }
    }
}
