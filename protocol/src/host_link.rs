//! The host's end of one board's link: datagrams in, arrivals out, answers out.

use crate::header::{Direction, HEADER_LENGTH, Header, Kind};
use crate::inbox::Inbox;
use crate::message::{Answer, BoardMessage, HostMessage, Report, Settings};
use crate::replay::ReplayGuard;
use crate::seal::{self, Refused};
use crate::update::{CHUNK, UpdateOrder, UpdateReport};
use crate::{Key, MAX_DATAGRAM, SCHEMA_VERSION};

/// An authentic, fresh report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    /// The boot of the board that sent it.
    pub boot: u32,
    /// The number of the datagram within that boot.
    pub counter: u64,
    /// Whether this is the first datagram of that boot.
    pub booted: bool,
    /// What the board said.
    pub report: Report,
}

/// The host's link to one board. `SEGMENTS` is that of its [`Inbox`].
#[derive(Debug)]
pub struct HostLink<const SEGMENTS: usize> {
    key: Key,
    board: u32,
    epoch: u32,
    counter: u64,
    guard: ReplayGuard,
    inbox: Inbox<SEGMENTS>,
    /// The boot whose identity was heard.
    known_boot: Option<u32>,
}

impl<const SEGMENTS: usize> HostLink<SEGMENTS> {
    /// The link of a host that starts with `epoch` (greater than at any start before, and durable), and of what it
    /// remembers: which datagrams it had heard and which records it has.
    pub fn new(board: u32, key: Key, epoch: u32, guard: ReplayGuard, inbox: Inbox<SEGMENTS>) -> Self {
        Self { key, board, epoch, counter: 0, guard, inbox, known_boot: None }
    }

    /// Opens a datagram in place, and refuses what is not authentic, fresh and well formed.
    ///
    /// # Errors
    ///
    /// The reason why it was dropped. Only [`Refused::Version`] may be answered, with [`HostLink::version_notice`].
    pub fn open(&mut self, datagram: &mut [u8]) -> Result<Received, Refused> {
        let (header, message) = seal::open(&self.key, self.board, Direction::ToHost, datagram)?;
        let booted = header.epoch > self.guard.epoch();
        self.guard.admit(&header)?;
        if header.version != SCHEMA_VERSION {
            return Err(Refused::Version { theirs: header.version });
        }
        if header.kind != Kind::Message {
            return Err(Refused::Malformed);
        }
        let (BoardMessage::Report(report), rest) =
            postcard::take_from_bytes(message).map_err(|_| Refused::Malformed)?;
        let batch = &report.batch;
        let of_this_time = batch.store <= batch.boot && batch.boot <= header.epoch;
        if !rest.is_empty() || !of_this_time || !batch.is_well_formed() {
            return Err(Refused::Malformed);
        }
        if report.identity.is_some() {
            self.known_boot = Some(header.epoch);
        }
        Ok(Received { boot: header.epoch, counter: header.counter, booted, report })
    }

    /// Opens a datagram of [`Kind::Update`] in place, and refuses what is not authentic, fresh and well formed.
    ///
    /// # Errors
    ///
    /// The reason why it was dropped.
    pub fn open_update(&mut self, datagram: &mut [u8]) -> Result<UpdateReport, Refused> {
        let (header, message) = seal::open(&self.key, self.board, Direction::ToHost, datagram)?;
        self.guard.admit(&header)?;
        if header.version != SCHEMA_VERSION {
            return Err(Refused::Version { theirs: header.version });
        }
        match postcard::take_from_bytes(message) {
            Ok((report, [])) if header.kind == Kind::Update => Ok(report),
            Ok(_) | Err(_) => Err(Refused::Malformed),
        }
    }

    /// The datagram that tells the board of a new program, as the number of its bytes in `buffer`; none before the
    /// board was heard, or if a chunk is longer than [`CHUNK`](crate::update::CHUNK).
    pub fn update(&mut self, order: &UpdateOrder<'_>, buffer: &mut [u8; MAX_DATAGRAM]) -> Option<usize> {
        if self.guard.epoch() == 0 || matches!(order, UpdateOrder::Chunk(chunk) if chunk.bytes.len() > CHUNK) {
            return None;
        }
        let length = postcard::to_slice(order, &mut buffer[HEADER_LENGTH..]).ok()?.len();
        let header = self.next_header(Kind::Update);
        Some(seal::seal(&self.key, &header, buffer, length))
    }

    /// Which datagrams were heard.
    pub fn guard(&self) -> &ReplayGuard {
        &self.guard
    }

    /// Which records were received, and which are durable.
    pub fn inbox(&self) -> &Inbox<SEGMENTS> {
        &self.inbox
    }

    /// The inbox, to take batches and to note what is durable.
    pub fn inbox_mut(&mut self) -> &mut Inbox<SEGMENTS> {
        &mut self.inbox
    }

    /// The answer to what was heard, as the number of its bytes in `buffer`; none before the board was heard.
    ///
    /// `host_us` is the host's clock, microseconds since 1970, as close to the sending as can be.
    pub fn answer(&mut self, host_us: u64, settings: &Settings, buffer: &mut [u8; MAX_DATAGRAM]) -> Option<usize> {
        let boot = self.guard.epoch();
        let answer = Answer {
            boot,
            host_us,
            identity_known: self.known_boot == Some(boot),
            acknowledgement: self.inbox.acknowledgement()?,
            settings: *settings,
        };
        let length = postcard::to_slice(&HostMessage::Answer(answer), &mut buffer[HEADER_LENGTH..]).ok()?.len();
        let header = self.next_header(Kind::Message);
        Some(seal::seal(&self.key, &header, buffer, length))
    }

    /// A datagram that says which schema version this host speaks, for a board that speaks another.
    pub fn version_notice(&mut self, buffer: &mut [u8; MAX_DATAGRAM]) -> usize {
        let header = self.next_header(Kind::Version);
        seal::seal_version(&self.key, &header, buffer)
    }

    fn next_header(&mut self, kind: Kind) -> Header {
        let counter = self.counter;
        self.counter += 1;
        Header {
            version: SCHEMA_VERSION,
            direction: Direction::ToBoard,
            kind,
            board: self.board,
            epoch: self.epoch,
            counter,
        }
    }
}
