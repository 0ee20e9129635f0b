//! Shared pieces of the tests that cross crates, and the yardstick of discovery: [`hidden`].

pub mod hidden;
