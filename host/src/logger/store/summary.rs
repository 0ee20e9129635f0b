//! What an MCAP file says at its end about its contents; kept up while writing, rebuilt while scanning.

use std::collections::BTreeMap;

use super::mcap::{self, opcode};

/// Everything that the summary section of one file needs.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// The schema records as they are in the file.
    pub schemas: BTreeMap<u16, Vec<u8>>,
    /// The channel records as they are in the file.
    pub channels: BTreeMap<u16, Vec<u8>>,
    /// One entry a chunk.
    pub chunks: Vec<ChunkEntry>,
    /// One entry an attachment.
    pub attachments: Vec<AttachmentEntry>,
    /// How many messages each channel has.
    pub counts: BTreeMap<u16, u64>,
}

/// Where a chunk is and what it holds. A file has hundreds of thousands of them, some with an index of ten thousand
/// channels, and all are kept until the file ends: so an index is kept as the few bytes from which it follows.
#[derive(Debug, Clone)]
pub struct ChunkEntry {
    /// The earliest and the latest time in it, in nanoseconds.
    pub times_ns: (u64, u64),
    /// Where its record starts, and its length.
    pub place: (u64, u64),
    /// The bytes of its records.
    pub size: u64,
    /// By channel in order: how far its number is above the last one's, and how many messages it has, as varints.
    indexes: Vec<u8>,
    last_channel: u16,
}

impl ChunkEntry {
    /// A chunk whose indexes are yet to be added.
    pub fn new(times_ns: (u64, u64), place: (u64, u64), size: u64) -> Self {
        Self { times_ns, place, size, indexes: Vec::new(), last_channel: 0 }
    }

    /// Adds the index that follows: that of a channel above all before, with so many messages.
    pub fn add_index(&mut self, channel: u16, messages: u64) {
        put_varint(&mut self.indexes, u64::from(channel - self.last_channel));
        put_varint(&mut self.indexes, messages);
        self.last_channel = channel;
    }

    /// By channel in order: where its index starts, and how many messages it has.
    pub fn indexes(&self) -> impl Iterator<Item = (u16, u64, u64)> + '_ {
        let (mut bytes, mut channel, mut at) = (self.indexes.as_slice(), 0, self.place.0 + self.place.1);
        std::iter::from_fn(move || {
            channel += take_varint(&mut bytes)? as u16;
            let messages = take_varint(&mut bytes)?;
            let start = at;
            at += mcap::message_index_length(messages);
            Some((channel, start, messages))
        })
    }

    /// The length of all its indexes.
    fn indexes_length(&self) -> u64 {
        self.indexes().map(|(_, _, messages)| mcap::message_index_length(messages)).sum()
    }
}

fn put_varint(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

fn take_varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u64::from(byte & 0x7F) << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

/// Where an attachment is and what it is.
#[derive(Debug, Clone)]
pub struct AttachmentEntry {
    /// Where its record starts, and its length.
    pub place: (u64, u64),
    /// Its time in nanoseconds.
    pub time_ns: u64,
    /// The bytes of its data.
    pub size: u64,
    /// Its name.
    pub name: String,
    /// What it is.
    pub media_type: String,
}

impl Summary {
    /// Takes a chunk with all its indexes.
    pub fn add_chunk(&mut self, mut chunk: ChunkEntry) {
        for (channel, _, messages) in chunk.indexes() {
            *self.counts.entry(channel).or_default() += messages;
        }
        chunk.indexes.shrink_to_fit();
        self.chunks.push(chunk);
    }

    /// Forgets all chunks but the first so many.
    pub fn forget_chunks(&mut self, kept: usize) {
        for chunk in self.chunks.drain(kept..) {
            for (channel, _, messages) in chunk.indexes() {
                if let Some(count) = self.counts.get_mut(&channel) {
                    *count -= messages;
                }
            }
        }
        self.counts.retain(|_, count| *count > 0);
    }

    /// The end of a file whose data ends at `position`: data end, summary, footer and magic.
    pub fn end_of_file(&self, position: u64) -> Vec<u8> {
        let mut out = Vec::new();
        mcap::record(&mut out, opcode::DATA_END, |out| out.extend_from_slice(&0_u32.to_le_bytes()));
        let summary_start = out.len();
        let mut groups: Vec<(u8, usize, usize)> = Vec::new();
        let mut group = |out: &mut Vec<u8>, opcode: u8, write: &dyn Fn(&mut Vec<u8>)| {
            let start = out.len();
            write(out);
            if out.len() > start {
                groups.push((opcode, start, out.len() - start));
            }
        };
        group(&mut out, opcode::SCHEMA, &|out| self.schemas.values().for_each(|record| out.extend_from_slice(record)));
        group(&mut out, opcode::CHANNEL, &|out| {
            self.channels.values().for_each(|record| out.extend_from_slice(record));
        });
        group(&mut out, opcode::STATISTICS, &|out| self.statistics(out));
        group(&mut out, opcode::CHUNK_INDEX, &|out| self.chunks.iter().for_each(|chunk| chunk.write(out)));
        group(&mut out, opcode::ATTACHMENT_INDEX, &|out| self.attachments.iter().for_each(|entry| entry.write(out)));
        let offsets_start = out.len();
        for (group, start, length) in groups {
            mcap::record(&mut out, opcode::SUMMARY_OFFSET, |out| {
                out.push(group);
                out.extend_from_slice(&(position + start as u64).to_le_bytes());
                out.extend_from_slice(&(length as u64).to_le_bytes());
            });
        }
        // The CRC covers the summary and the footer up to the CRC itself.
        out.push(opcode::FOOTER);
        out.extend_from_slice(&20_u64.to_le_bytes());
        out.extend_from_slice(&(position + summary_start as u64).to_le_bytes());
        out.extend_from_slice(&(position + offsets_start as u64).to_le_bytes());
        let crc = crc32fast::hash(&out[summary_start..]);
        out.extend_from_slice(&crc.to_le_bytes());
        out.extend_from_slice(&mcap::MAGIC);
        out
    }

    /// How many messages the file has.
    pub fn message_count(&self) -> u64 {
        self.counts.values().sum()
    }

    /// The earliest and the latest time in the file, in nanoseconds; none without messages.
    pub fn times_ns(&self) -> Option<(u64, u64)> {
        let start = self.chunks.iter().map(|chunk| chunk.times_ns.0).min()?;
        let end = self.chunks.iter().map(|chunk| chunk.times_ns.1).max()?;
        Some((start, end))
    }

    fn statistics(&self, out: &mut Vec<u8>) {
        let (start, end) = self.times_ns().unwrap_or((0, 0));
        mcap::record(out, opcode::STATISTICS, |out| {
            out.extend_from_slice(&self.message_count().to_le_bytes());
            out.extend_from_slice(&(self.schemas.len() as u16).to_le_bytes());
            out.extend_from_slice(&(self.channels.len() as u32).to_le_bytes());
            out.extend_from_slice(&(self.attachments.len() as u32).to_le_bytes());
            out.extend_from_slice(&0_u32.to_le_bytes());
            out.extend_from_slice(&(self.chunks.len() as u32).to_le_bytes());
            out.extend_from_slice(&start.to_le_bytes());
            out.extend_from_slice(&end.to_le_bytes());
            out.extend_from_slice(&((self.counts.len() * 10) as u32).to_le_bytes());
            for (channel, count) in &self.counts {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&count.to_le_bytes());
            }
        });
    }
}

impl ChunkEntry {
    fn write(&self, out: &mut Vec<u8>) {
        mcap::record(out, opcode::CHUNK_INDEX, |out| {
            for number in [self.times_ns.0, self.times_ns.1, self.place.0, self.place.1] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            out.extend_from_slice(&((self.indexes().count() * 10) as u32).to_le_bytes());
            for (channel, offset, _) in self.indexes() {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&offset.to_le_bytes());
            }
            out.extend_from_slice(&self.indexes_length().to_le_bytes());
            mcap::text(out, "");
            out.extend_from_slice(&self.size.to_le_bytes());
            out.extend_from_slice(&self.size.to_le_bytes());
        });
    }
}

impl AttachmentEntry {
    fn write(&self, out: &mut Vec<u8>) {
        mcap::record(out, opcode::ATTACHMENT_INDEX, |out| {
            for number in [self.place.0, self.place.1, self.time_ns, self.time_ns, self.size] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            mcap::text(out, &self.name);
            mcap::text(out, &self.media_type);
        });
    }
}
