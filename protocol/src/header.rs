//! The header that every datagram begins with, in clear and authenticated. Its layout never changes.
//!
//! | bytes | content |
//! | --- | --- |
//! | 0..2 | `TK` |
//! | 2 | schema version of the sender |
//! | 3 | kind; the top bit is the direction, set from host to board |
//! | 4..8 | board number, little endian as all that follows |
//! | 8..12 | epoch: the board's boot number, or the host's epoch |
//! | 12..20 | counter of the datagrams of that epoch, below 2^63 |

use crate::seal::Refused;

/// The number of bytes of a header.
pub const HEADER_LENGTH: usize = 20;

const MAGIC: [u8; 2] = *b"TK";
const FROM_HOST: u8 = 0x80;
/// The top bit of the counter's place in the nonce keeps the directions apart.
const COUNTER_LIMIT: u64 = 1 << 63;

/// Who sent a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Direction {
    /// From a board to the host.
    ToHost,
    /// From the host to a board.
    ToBoard,
}

/// What the sealed part of a datagram is. Append-only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Kind {
    /// A message of the sender's schema version.
    Message = 0,
    /// Nothing: the sender only says which schema version it speaks, because it could not read a message.
    Version = 1,
    /// A message about a new program: see [`crate::update`].
    Update = 2,
}

/// The header of a datagram; the sealed part follows, then the 16 bytes of its tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// The schema version that the sender speaks.
    pub version: u8,
    /// Who sent it.
    pub direction: Direction,
    /// What the sealed part is.
    pub kind: Kind,
    /// The board that sent it or is meant.
    pub board: u32,
    /// The board's boot number, or the host's epoch: greater at every start of the sender.
    pub epoch: u32,
    /// The number of this datagram within its epoch and direction.
    pub counter: u64,
}

impl Header {
    /// Reads the header of a datagram; nothing about it is authentic until the datagram is opened.
    pub fn parse(datagram: &[u8]) -> Result<Self, Refused> {
        let Some((bytes, _)) = datagram.split_first_chunk::<HEADER_LENGTH>() else {
            return Err(Refused::Foreign);
        };
        let [m0, m1, version, kind, b0, b1, b2, b3, e0, e1, e2, e3, counter @ ..] = *bytes;
        if [m0, m1] != MAGIC {
            return Err(Refused::Foreign);
        }
        let direction = if kind & FROM_HOST == 0 { Direction::ToHost } else { Direction::ToBoard };
        let kind = match kind & !FROM_HOST {
            0 => Kind::Message,
            1 => Kind::Version,
            2 => Kind::Update,
            _ => return Err(Refused::Foreign),
        };
        let counter = u64::from_le_bytes(counter);
        if counter >= COUNTER_LIMIT {
            return Err(Refused::Foreign);
        }
        Ok(Self {
            version,
            direction,
            kind,
            board: u32::from_le_bytes([b0, b1, b2, b3]),
            epoch: u32::from_le_bytes([e0, e1, e2, e3]),
            counter,
        })
    }

    /// The bytes of the header.
    pub fn to_bytes(&self) -> [u8; HEADER_LENGTH] {
        let direction = match self.direction {
            Direction::ToHost => 0,
            Direction::ToBoard => FROM_HOST,
        };
        let mut bytes = [0; HEADER_LENGTH];
        bytes[..2].copy_from_slice(&MAGIC);
        bytes[2] = self.version;
        bytes[3] = self.kind as u8 | direction;
        bytes[4..8].copy_from_slice(&self.board.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.epoch.to_le_bytes());
        bytes[12..].copy_from_slice(&self.counter.to_le_bytes());
        bytes
    }

    /// The nonce under the board's key: epoch, then the counter with the direction in its top bit.
    pub(crate) fn nonce(&self) -> [u8; 12] {
        let direction = match self.direction {
            Direction::ToHost => 0,
            Direction::ToBoard => COUNTER_LIMIT,
        };
        let mut nonce = [0; 12];
        nonce[..4].copy_from_slice(&self.epoch.to_le_bytes());
        nonce[4..].copy_from_slice(&(self.counter | direction).to_le_bytes());
        nonce
    }
}
