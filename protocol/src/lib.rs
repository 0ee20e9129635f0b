//! Everything a link board and the host say to each other, and nothing else.
//!
//! The crate is `no_std`, allocates nothing, does no I/O and reads no clock: time is always an argument. A board owns a
//! [`BoardLink`], the host owns one [`HostLink`] a board; both are state machines that turn events into datagrams. What
//! travels is one sealed message a datagram, at most [`MAX_DATAGRAM`] bytes (see [`seal`]).
//!
//! # Delivery semantics
//!
//! **What is identified.** A board numbers its records 0, 1, 2, … in its *store* ([`Outbox`]). A store is named by the
//! boot in which it began empty, so (board, store, sequence) names one record for ever. A store that lives in plain RAM
//! dies with its boot and `store == boot`; one that survives a reset (retained RAM) goes on counting under its old name,
//! and each batch says in which boot, that is on which clock, its records were taken.
//!
//! **What an acknowledgement means.** The record, its exact datagram included, is on the host's disk and was covered by
//! a successful `sync_data`. Only then does the board forget it. An acknowledgement lists every sequence below a limit
//! and a sparse bitmap above it; it is cumulative and idempotent, so losing or repeating one does no harm.
//!
//! **What it does not mean.** Not that anybody has looked at the reading, not that its time is known yet (clocks settle
//! later; raw counts and the board's own clock are what is stored), and not that earlier records arrived: the limit and
//! the bitmap say exactly which did.
//!
//! **Exactly once, in a known order.** What arrives twice is stored once, because the host remembers what it has, across
//! its own restarts too (it rebuilds that memory from the log itself). Records may be stored out of order (live ones
//! overtake the backlog); the sequence gives the order in which they were taken.
//!
//! **What can be lost, and how that is told.** Nothing else than: records that a full store thinned out, and records in
//! a store that lost power. Each batch carries a claim, "of all sequences in `from..until` I hold only these" ([`Batch`]),
//! which stays true for ever; the host turns whatever it never received inside a claim into a gap record that says from
//! where to where. A store that ended is told by its successor; what it may have held beyond the last sequence heard is
//! an open gap.
//!
//! **Order of sending.** The newest records go first; what has waited (never sent, or sent and not acknowledged in time)
//! follows at a pace set by the acknowledgements, with a bounded number in flight. How long a board waits before it sends
//! again follows the latency of the acknowledgements and its spread (RFC 6298), from 0.5 to 60 seconds, and doubles with
//! each wait in vain. A board that hears nobody falls back to one probe at a time, at most 8 seconds apart.
//!
//! # What the board must guarantee
//!
//! - Its **boot number** is greater at every start than at any start before under the same key. It counts up in
//!   non-volatile storage, written *before* the first datagram, beginning at the first boot number that the host printed
//!   with the key. Nonces are (boot, direction, counter): a boot number used twice is a nonce used twice.
//! - Its **microsecond clock** begins at zero or anywhere with each boot and never steps back within one.
//! - The **sensors** of a boot stay the same, in the same order; one that does not answer is a reading with a status.
//! - A retained store is checked (checksum) before it is resumed; a doubtful one is dropped for a new store.
//!
//! # What the host must guarantee
//!
//! - Its **epoch** is greater at every start than at any before, and durable before the first datagram.
//! - It answers only what was authentic and fresh, and acknowledges only what was synced.
//! - One host at a time works with a key.
//!
//! # Time exchange
//!
//! Each answer carries the host's time of sending (t1); the board notes when it came (t2) and returns both in its next
//! report with the time of that report's sending (t3); the host notes when that came (t4). Nothing else is needed on the
//! board. How the host turns exchanges into a mapping of clocks is the host's affair.
//!
//! # New programs
//!
//! Programs go over the air in messages of their own ([`update`]), which change nothing of the above: what is not
//! acknowledged when a board restarts into a new program is lost or kept as with any other restart.
//!
//! # Changing the schema
//!
//! Header and sealing never change. Enums are append-only and their discriminants are pinned by golden byte vectors;
//! any other change of a message raises [`SCHEMA_VERSION`], which each header carries: ends that differ say so, each
//! naming both numbers ([`Refused::Version`]), and exchange nothing else.
#![no_std]

#[cfg(test)]
extern crate std;

#[cfg(feature = "defmt")]
use defmt as _;

mod archive;
mod board_link;
mod configuration;
#[cfg(test)]
mod exhaustive;
mod header;
mod host_link;
mod inbox;
mod key;
mod message;
mod outbox;
mod patience;
mod replay;
pub mod seal;
mod sequence_set;
pub mod update;

pub use board_link::{BoardCounters, BoardLink, Heard};
pub use configuration::{BadPage, Configuration, MAX_PAGE, Wifi};
pub use header::{Direction, HEADER_LENGTH, Header, Kind};
pub use host_link::{HostLink, Received};
pub use inbox::{Arrival, Gap, GapReason, Inbox};
pub use key::{Key, KeyError};
pub use message::{
    Acknowledgement, Answer, Batch, Battery, BoardMessage, Counters, Firmware, Health, HostMessage, Identity,
    PowerMode, Reading, Record, Report, ResetReason, Segment, Sensor, SensorKind, Settings, Signal, TimeEcho,
};
pub use outbox::Outbox;
pub use replay::ReplayGuard;
pub use seal::Refused;
pub use sequence_set::{Full, SequenceSet};

/// The version of the messages; raised by every change that is not an appended enum variant.
pub const SCHEMA_VERSION: u8 = 1;

/// The most bytes that one datagram may have, header and tag included: below every path's MTU that matters.
pub const MAX_DATAGRAM: usize = 1200;

/// The most sensors that one board reports.
pub const MAX_SENSORS: usize = 8;

/// The most records that one batch may hold.
pub const MAX_BATCH: usize = 32;

/// No sequence reaches this number: a sender that claims one is not to be believed.
pub const MAX_SEQUENCE: u64 = 1 << 62;

/// The most 64-sequence segments that one acknowledgement may hold.
pub const MAX_SEGMENTS: usize = 8;
