//! A chunk of messages as it is being gathered: its bytes stand where they will be written from, and its indexes follow.

use super::mcap::{self, CHUNK_HEAD};
use super::summary::ChunkEntry;

/// The messages of a chunk that is not written yet. Its memory serves one chunk after another.
#[derive(Debug)]
pub(super) struct OpenChunk {
    /// Room for the head of the chunk's record, then the records.
    bytes: Vec<u8>,
    /// Of each message its channel, its offset within the records and its time.
    messages: Vec<(u16, u64, u64)>,
    times_ns: Option<(u64, u64)>,
}

impl OpenChunk {
    /// An empty chunk.
    pub(super) fn new() -> Self {
        Self { bytes: vec![0; CHUNK_HEAD], messages: Vec::new(), times_ns: None }
    }

    /// How many bytes of records were gathered.
    pub(super) fn len(&self) -> usize {
        self.bytes.len() - CHUNK_HEAD
    }

    /// Forgets what was gathered.
    pub(super) fn clear(&mut self) {
        self.bytes.truncate(CHUNK_HEAD);
        self.messages.clear();
        self.times_ns = None;
    }

    /// Adds a record that is no message, which `write` writes, and gives it back as it stands there.
    pub(super) fn record(&mut self, write: impl FnOnce(&mut Vec<u8>)) -> &[u8] {
        let start = self.bytes.len();
        write(&mut self.bytes);
        &self.bytes[start..]
    }

    /// Adds a message whose data `content` writes.
    pub(super) fn message(&mut self, channel: u16, sequence: u32, time_ns: u64, content: impl FnOnce(&mut Vec<u8>)) {
        self.messages.push((channel, self.len() as u64, time_ns));
        let (start, end) = self.times_ns.unwrap_or((time_ns, time_ns));
        self.times_ns = Some((start.min(time_ns), end.max(time_ns)));
        mcap::message(&mut self.bytes, channel, sequence, time_ns, content);
    }

    /// Completes the chunk, to be written at a place in the file: its bytes, indexes included, and what the file's summary
    /// says of it; none without messages.
    pub(super) fn close(&mut self, at: u64) -> Option<(&[u8], ChunkEntry)> {
        let times_ns = self.times_ns?;
        let (chunk_length, size) = (self.bytes.len() as u64, self.len() as u64);
        mcap::chunk_head(&mut self.bytes, times_ns);
        self.messages.sort_unstable();
        let mut entry = ChunkEntry::new(times_ns, (at, chunk_length), size);
        for of_channel in self.messages.chunk_by(|a, b| a.0 == b.0) {
            let entries = of_channel.iter().map(|&(_, offset, time_ns)| (time_ns, offset));
            mcap::message_index(&mut self.bytes, of_channel[0].0, entries);
            entry.add_index(of_channel[0].0, of_channel.len() as u64);
        }
        Some((&self.bytes, entry))
    }
}
