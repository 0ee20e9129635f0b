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

/// Where a chunk is and what it holds.
#[derive(Debug, Clone)]
pub struct ChunkEntry {
    /// The earliest and the latest time in it, in nanoseconds.
    pub times_ns: (u64, u64),
    /// Where its record starts, and its length.
    pub place: (u64, u64),
    /// Where the index of each channel starts.
    pub indexes: BTreeMap<u16, u64>,
    /// The length of all those indexes.
    pub indexes_length: u64,
    /// The bytes of its records.
    pub size: u64,
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
            out.extend_from_slice(&((self.indexes.len() * 10) as u32).to_le_bytes());
            for (channel, offset) in &self.indexes {
                out.extend_from_slice(&channel.to_le_bytes());
                out.extend_from_slice(&offset.to_le_bytes());
            }
            out.extend_from_slice(&self.indexes_length.to_le_bytes());
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
