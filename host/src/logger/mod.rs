//! The host logger: boards heard, datagrams in, samples to disk, acknowledgements, the live view.
//!
//! [`engine`] is the logger without socket, disk and clock; [`serve`] gives it those. [`store`] is where readings go,
//! behind the seam of [`sink`], and [`read`] and [`export`] work on what lies
//! there. [`virtual_board`] simulates boards that speak the same protocol.

pub mod civil;
pub mod clock;
mod digits;
pub mod engine;
pub mod export;
pub mod gauge;
pub mod group;
pub mod program;
pub mod read;
pub mod registry;
pub mod scenario;
pub mod serve;
pub mod sink;
mod sort;
pub mod status;
pub mod store;
pub mod update;
pub mod verify;
pub mod virtual_board;
pub mod watch;
