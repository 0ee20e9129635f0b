//! Sealing and opening of datagrams: ChaCha20-Poly1305 under the board's key, the header as associated data.
//!
//! A datagram is header, ciphertext and a 16-byte tag. The nonce is made of the header's epoch, direction and counter, so
//! it repeats only if a sender uses an epoch twice (the crate's documentation says what each end must guarantee).

use chacha20poly1305::{AeadInOut, ChaCha20Poly1305, KeyInit, Nonce, Tag};

use crate::header::{Direction, HEADER_LENGTH, Header, Kind};
use crate::{Key, MAX_DATAGRAM, SCHEMA_VERSION};

/// The number of bytes of the tag at a datagram's end.
pub const TAG_LENGTH: usize = 16;

/// The most bytes that a message may have before it is sealed.
pub const MAX_MESSAGE: usize = MAX_DATAGRAM - HEADER_LENGTH - TAG_LENGTH;

/// Why a datagram was dropped. None of these is ever answered, but [`Refused::Version`], which is authentic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Refused {
    /// Too short, too long or without the header of this protocol.
    #[error("not a datagram of this protocol")]
    Foreign,
    /// For another board, or in the wrong direction.
    #[error("not addressed to this end")]
    Misdirected,
    /// Its tag does not fit the board's key.
    #[error("not sealed with this board's key")]
    Forged,
    /// A datagram that was received before, or so late that this can no longer be told.
    #[error("replayed, or later than the window of fresh datagrams")]
    Replayed,
    /// From an earlier boot of the board, or an earlier start of the host, than one already heard.
    #[error("from an earlier start of its sender")]
    Stale,
    /// An answer to an earlier boot of this board.
    #[error("an answer to an earlier boot of this board")]
    OtherBoot,
    /// Authentic, but the sender speaks another schema version.
    #[error("the other end speaks schema version {theirs}, this end speaks {SCHEMA_VERSION}: update the older one")]
    Version {
        /// The version that the other end speaks.
        theirs: u8,
    },
    /// Authentic, but not a message of this schema.
    #[error("authentic, but not a message that this end understands")]
    Malformed,
}

/// Seals the first `length` bytes that lie in `buffer` from [`HEADER_LENGTH`] on; returns the datagram's length.
///
/// # Panics
///
/// If `length` exceeds [`MAX_MESSAGE`], which no message of this crate does.
pub fn seal(key: &Key, header: &Header, buffer: &mut [u8; MAX_DATAGRAM], length: usize) -> usize {
    assert!(length <= MAX_MESSAGE, "a message of {length} bytes does not fit a datagram");
    let (head, rest) = buffer.split_at_mut(HEADER_LENGTH);
    head.copy_from_slice(&header.to_bytes());
    let (message, rest) = rest.split_at_mut(length);
    let tag = cipher(key)
        .encrypt_inout_detached(&Nonce::from(header.nonce()), head, message.into())
        .expect("the cipher takes 256 GiB at once, a message is smaller than a datagram");
    rest[..TAG_LENGTH].copy_from_slice(&tag);
    HEADER_LENGTH + length + TAG_LENGTH
}

/// Seals the header alone: the sender says which version it speaks.
pub(crate) fn seal_version(key: &Key, header: &Header, buffer: &mut [u8; MAX_DATAGRAM]) -> usize {
    seal(key, &Header { kind: Kind::Version, ..*header }, buffer, 0)
}

/// Opens a datagram in place: its header and, authenticated and decrypted, its message.
pub(crate) fn open<'a>(
    key: &Key,
    board: u32,
    direction: Direction,
    datagram: &'a mut [u8],
) -> Result<(Header, &'a [u8]), Refused> {
    let header = Header::parse(datagram)?;
    if datagram.len() > MAX_DATAGRAM {
        return Err(Refused::Foreign);
    }
    if header.direction != direction || header.board != board {
        return Err(Refused::Misdirected);
    }
    let (head, rest) = datagram.split_at_mut(HEADER_LENGTH);
    let Some((message, tag)) = rest.split_last_chunk_mut::<TAG_LENGTH>() else {
        return Err(Refused::Foreign);
    };
    cipher(key)
        .decrypt_inout_detached(&Nonce::from(header.nonce()), head, (&mut *message).into(), &Tag::from(*tag))
        .map_err(|_| Refused::Forged)?;
    Ok((header, message))
}

fn cipher(key: &Key) -> ChaCha20Poly1305 {
    ChaCha20Poly1305::new(key.expose().into())
}
