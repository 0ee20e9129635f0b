//! One log file: groups of messages appended, each durable when it is said to be.
//!
//! A group is one chunk with its CRC and indexes, written at once and followed by `sync_data`. Whatever is cut off or
//! damaged behind the last whole group was never acknowledged.

use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::mcap::{self, opcode};
use super::summary::{AttachmentEntry, ChunkEntry, Summary};
use super::topic::Topic;

/// A file that is being written.
#[derive(Debug)]
pub struct LogFile {
    file: File,
    path: PathBuf,
    /// Everything before this byte is durable.
    durable: u64,
    summary: Summary,
    channels: HashMap<Topic, u16>,
}

/// The messages of a group that is being gathered for a file.
#[derive(Debug, Default)]
pub struct GroupBytes {
    records: Vec<u8>,
    indexes: BTreeMap<u16, Vec<(u64, u64)>>,
    times_ns: Option<(u64, u64)>,
    new_schemas: BTreeMap<u16, Vec<u8>>,
    new_channels: HashMap<Topic, u16>,
    new_channel_records: BTreeMap<u16, Vec<u8>>,
}

/// Something that rides along in each file: robot.toml, the settings.
#[derive(Debug, Clone)]
pub struct Attachment {
    /// Its file name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Its bytes.
    pub data: Vec<u8>,
}

impl LogFile {
    /// Creates a file that must not exist yet, durable with its attachments and its name.
    pub fn create(path: &Path, attachments: &[Attachment], time_ns: u64) -> io::Result<Self> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let mut out = mcap::MAGIC.to_vec();
        mcap::header(&mut out);
        let mut summary = Summary::default();
        for attachment in attachments {
            let start = out.len();
            mcap::attachment(&mut out, time_ns, &attachment.name, &attachment.media_type, &attachment.data);
            summary.attachments.push(AttachmentEntry {
                place: (start as u64, (out.len() - start) as u64),
                time_ns,
                size: attachment.data.len() as u64,
                name: attachment.name.clone(),
                media_type: attachment.media_type.clone(),
            });
        }
        let written = file.write_all(&out).and_then(|()| file.sync_all()).and_then(|()| sync_folder(path));
        if let Err(error) = written {
            // Nothing was acknowledged into it; an empty file would only be in the way.
            let _ = std::fs::remove_file(path);
            return Err(error);
        }
        Ok(Self { file, path: path.to_owned(), durable: out.len() as u64, summary, channels: HashMap::new() })
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many bytes of it are durable.
    pub fn durable(&self) -> u64 {
        self.durable
    }

    /// Adds a message to a group that will be written to this file.
    ///
    /// # Errors
    ///
    /// If the file has no channel left: MCAP numbers them with 16 bits.
    pub fn message(
        &self,
        group: &mut GroupBytes,
        topic: Topic,
        time_ns: u64,
        content: impl FnOnce(&mut Vec<u8>),
    ) -> io::Result<()> {
        let channel = match self.channels.get(&topic).or_else(|| group.new_channels.get(&topic)) {
            Some(&channel) => channel,
            None => self.add_channel(group, topic)?,
        };
        let index = group.indexes.entry(channel).or_default();
        let sequence = index.len() as u32;
        index.push((time_ns, group.records.len() as u64));
        let (start, end) = group.times_ns.unwrap_or((time_ns, time_ns));
        group.times_ns = Some((start.min(time_ns), end.max(time_ns)));
        mcap::message(&mut group.records, channel, sequence, time_ns, content);
        Ok(())
    }

    /// Writes a group and syncs it. On an error nothing of it counts: the file is cut back to what was durable.
    pub fn commit(&mut self, group: GroupBytes) -> io::Result<()> {
        let Some(times_ns) = group.times_ns else {
            return Ok(());
        };
        let mut out = Vec::with_capacity(group.records.len() + group.records.len() / 8 + 1024);
        mcap::chunk(&mut out, times_ns.0, times_ns.1, &group.records);
        let chunk_length = out.len() as u64;
        let mut indexes = BTreeMap::new();
        for (&channel, entries) in &group.indexes {
            indexes.insert(channel, self.durable + out.len() as u64);
            mcap::message_index(&mut out, channel, entries);
        }
        let written = self.file.write_all(&out).and_then(|()| self.file.sync_data());
        if let Err(error) = written {
            // Should this fail as well, whoever scans the file stops at the torn group.
            let _ = self.file.set_len(self.durable).and_then(|()| self.file.seek(SeekFrom::Start(self.durable)));
            return Err(error);
        }
        self.summary.chunks.push(ChunkEntry {
            times_ns,
            place: (self.durable, chunk_length),
            indexes,
            indexes_length: out.len() as u64 - chunk_length,
            size: group.records.len() as u64,
        });
        self.durable += out.len() as u64;
        for (channel, entries) in group.indexes {
            *self.summary.counts.entry(channel).or_default() += entries.len() as u64;
        }
        self.summary.schemas.extend(group.new_schemas);
        self.summary.channels.extend(group.new_channel_records);
        self.channels.extend(group.new_channels);
        Ok(())
    }

    /// Writes the summary, so that other tools find their way in the file, and syncs it.
    pub fn finish(mut self) -> io::Result<()> {
        let end = self.summary.end_of_file(self.durable);
        self.file.write_all(&end).and_then(|()| self.file.sync_all())
    }

    fn add_channel(&self, group: &mut GroupBytes, topic: Topic) -> io::Result<u16> {
        let known = self.channels.len() + group.new_channels.len();
        let channel = u16::try_from(known + 1)
            .map_err(|_| io::Error::other("an MCAP file has room for 65535 channels, more boards need another log"))?;
        let (schema, name, data) = topic.schema();
        if schema != 0 && !self.summary.schemas.contains_key(&schema) && !group.new_schemas.contains_key(&schema) {
            let start = group.records.len();
            mcap::schema(&mut group.records, schema, name, data);
            group.new_schemas.insert(schema, group.records[start..].to_vec());
        }
        let start = group.records.len();
        mcap::channel(&mut group.records, channel, schema, &topic.name(), topic.encoding());
        group.new_channel_records.insert(channel, group.records[start..].to_vec());
        group.new_channels.insert(topic, channel);
        Ok(channel)
    }
}

impl GroupBytes {
    /// How many bytes of records were gathered.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether nothing was gathered.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }
}

/// Finishes in place a file that was left behind: cuts what is torn, then writes the summary.
pub fn finish_in_place(path: &Path, valid: u64, summary: &Summary) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).open(path)?;
    file.set_len(valid)?;
    file.seek(SeekFrom::Start(valid))?;
    file.write_all(&summary.end_of_file(valid))?;
    file.sync_all()
}

/// Makes the name of a new file durable.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder)?.sync_all()
}

/// The kinds of records that stand before and between groups.
pub(super) fn is_known(code: u8) -> bool {
    matches!(code, opcode::HEADER | opcode::ATTACHMENT | opcode::CHUNK | opcode::MESSAGE_INDEX | opcode::DATA_END)
}
