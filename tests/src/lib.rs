//! Shared pieces of the tests that cross crates: the yardstick of discovery, [`hidden`], which shares no code with what it
//! measures, and [`judged`], which holds the one against the other.

pub mod hidden;
pub mod judged;
