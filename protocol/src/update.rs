//! New programs over the air: what host and board say about one, beside reports and answers.
//!
//! The host offers a program to a board that it hears, again and again until the board says how that ended. The board
//! takes only what its configuration's public key has signed, asks for one chunk at a time, and says in each report
//! where it is, so neither end remembers anything of the other, and a transfer goes on where it was after a reset of
//! either. An offer is named by the host's order number: the same program offered again under a new number is tried
//! again.
//!
//! These messages travel under [`Kind::Update`](crate::Kind::Update): an end that does not know them drops them unread.
//! Enums are append-only, `tests/golden.rs` pins the bytes.

use serde::{Deserialize, Serialize};

use crate::message::Firmware;
use crate::seal::Refused;

/// The most bytes of a program that one datagram brings.
pub const CHUNK: usize = 1024;

/// What a program runs on. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Target {
    /// The board in the emulator.
    Emulated,
    /// An ESP32-C3.
    Esp32c3,
    /// An ESP32-C6.
    Esp32c6,
}

/// What is signed of a program: what it runs on and is, and the digest of its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Manifest {
    /// What it runs on.
    pub target: Target,
    /// Its version.
    pub version: Firmware,
    /// The number of its bytes.
    pub length: u32,
    /// The SHA-256 of its bytes.
    pub digest: [u8; 32],
}

/// Keeps a signature of a program from being one of anything else.
const PURPOSE: [u8; 20] = *b"thermokin program 1\0";

impl Manifest {
    /// The number of a manifest's bytes.
    pub const LENGTH: usize = 44;

    /// Its bytes, the same for ever: target, 0, version, length, digest; little endian.
    pub fn to_bytes(&self) -> [u8; Self::LENGTH] {
        let mut bytes = [0; Self::LENGTH];
        bytes[0] = self.target as u8;
        bytes[2..4].copy_from_slice(&self.version.major.to_le_bytes());
        bytes[4..6].copy_from_slice(&self.version.minor.to_le_bytes());
        bytes[6..8].copy_from_slice(&self.version.patch.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.length.to_le_bytes());
        bytes[12..].copy_from_slice(&self.digest);
        bytes
    }

    /// Reads what [`Manifest::to_bytes`] made; none if the target is not known.
    pub fn from_bytes(bytes: &[u8; Self::LENGTH]) -> Option<Self> {
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let target = [Target::Emulated, Target::Esp32c3, Target::Esp32c6];
        let mut digest = [0; 32];
        digest.copy_from_slice(&bytes[12..]);
        Some(Self {
            target: *target.get(usize::from(bytes[0])).filter(|_| bytes[1] == 0)?,
            version: Firmware { major: half(2), minor: half(4), patch: half(6) },
            length: u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]),
            digest,
        })
    }

    /// The bytes that are signed.
    pub fn signed_bytes(&self) -> [u8; PURPOSE.len() + Self::LENGTH] {
        let mut bytes = [0; PURPOSE.len() + Self::LENGTH];
        bytes[..PURPOSE.len()].copy_from_slice(&PURPOSE);
        bytes[PURPOSE.len()..].copy_from_slice(&self.to_bytes());
        bytes
    }
}

/// What the host says of a new program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UpdateOrder<'a> {
    /// There is one.
    Offer(Offer),
    /// A part of it.
    #[serde(borrow)]
    Chunk(Chunk<'a>),
}

/// A program that a board shall have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Offer {
    /// The boot of the board that is meant; any other refuses it.
    pub boot: u32,
    /// The number of this offer.
    pub order: u32,
    /// How long the program, on trial, may take to have a record acknowledged, in seconds, each time it starts.
    pub patience_s: u16,
    /// What it is.
    pub manifest: Manifest,
    /// The Ed25519 signature of [`Manifest::signed_bytes`], in its two halves.
    pub signature: [[u8; 32]; 2],
}

/// A part of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Chunk<'a> {
    /// The boot of the board that asked for it.
    pub boot: u32,
    /// The number of the offer.
    pub order: u32,
    /// Where in the program it begins.
    pub offset: u32,
    /// At most [`CHUNK`] bytes; fewer only at the program's end.
    pub bytes: &'a [u8],
}

impl<'a> UpdateOrder<'a> {
    /// The boot of the board that is meant.
    pub(crate) fn boot(&self) -> u32 {
        match self {
            UpdateOrder::Offer(offer) => offer.boot,
            UpdateOrder::Chunk(chunk) => chunk.boot,
        }
    }

    /// Reads one that was authentic.
    pub(crate) fn parse(message: &'a [u8]) -> Result<Self, Refused> {
        match postcard::take_from_bytes(message) {
            Ok((order, [])) => Ok(order),
            Ok(_) | Err(_) => Err(Refused::Malformed),
        }
    }
}

/// How far a board is with an offer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UpdateReport {
    /// The number of the offer.
    pub order: u32,
    /// How far it is.
    pub state: UpdateState,
}

/// How far a board is with an offer. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UpdateState {
    /// It wants the chunk that begins there.
    Wants(u32),
    /// It has all and is checking it.
    Checking,
    /// It restarts with the new program.
    Restarting,
    /// The new program runs, and nothing that it sampled was acknowledged yet.
    OnTrial,
    /// The new program runs for good.
    Installed,
    /// The new program did not reach the host in time, or did not start; the earlier one runs.
    RolledBack,
    /// It does not take the program.
    Refused(UpdateRefusal),
}

impl UpdateState {
    /// Whether nothing more will come of this offer.
    pub fn is_final(self) -> bool {
        matches!(self, UpdateState::Installed | UpdateState::RolledBack | UpdateState::Refused(_))
    }
}

/// Why a board does not take a program. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UpdateRefusal {
    /// It has no flash for a second one.
    #[error("the board has no room for a second program")]
    NoSlots,
    /// Its configuration names no key for programs.
    #[error("the board's configuration has no key for programs: flash it once by cable")]
    NoKey,
    /// The signature is not of that key.
    #[error("the program is not signed with the key that the board's configuration names")]
    BadSignature,
    /// The program is for another chip.
    #[error("the program is for another kind of board")]
    OtherTarget,
    /// The program has no bytes, or more than a slot.
    #[error("the program does not fit the board's slot")]
    BadLength,
    /// What came is not what was signed.
    #[error("the program came damaged: it is not the one that was signed")]
    Damaged,
    /// The flash does not work.
    #[error("the board's flash failed")]
    Flash,
    /// The program that runs is on trial itself.
    #[error("the board's program is on trial itself")]
    OnTrial,
}
