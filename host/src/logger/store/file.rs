//! One log file: groups of messages appended, each durable when it is said to be.
//!
//! A group is one or several chunks, each with its CRC and indexes, followed by one `sync_data`. A chunk is whole in
//! itself: it has everything of the boards in it, with what must be remembered of them. Whatever is cut off or damaged
//! behind the last whole chunk was never acknowledged.

use std::collections::HashMap;
use std::fs::OpenOptions;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::chunk::OpenChunk;
use super::mcap::{self, opcode};
use super::medium::{Disk, DiskFile};
use super::summary::{AttachmentEntry, Summary};
use super::topic::Topic;

/// A chunk that has this many bytes is written at the next place where it may end. A file is read chunk by chunk, here and
/// by other tools, and a group that gathered while the disk was busy is not held in memory as a whole.
const CHUNK_BYTES: usize = 4 << 20;

/// A file that is being written.
#[derive(Debug)]
pub struct LogFile {
    file: Box<dyn DiskFile>,
    path: PathBuf,
    /// Everything before this byte is durable.
    durable: u64,
    /// Everything before this byte is written.
    written: u64,
    /// What the end of the file will say of everything written.
    summary: Summary,
    channels: HashMap<Topic, u16>,
    chunk: OpenChunk,
    /// What a roll-back takes out of the summary again: the chunks from this one on, and these channels and schemas.
    durable_chunks: usize,
    new_channels: Vec<Topic>,
    new_schemas: Vec<u16>,
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
    pub fn create(disk: &mut dyn Disk, path: &Path, attachments: &[Attachment], time_ns: u64) -> io::Result<Self> {
        let mut file = disk.create(path)?;
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
        let written = file.append(&out).and_then(|()| file.sync()).and_then(|()| disk.sync_name(path));
        if let Err(error) = written {
            // Nothing was acknowledged into it; an empty file would only be in the way.
            let _ = disk.remove(path);
            return Err(error);
        }
        Ok(Self {
            file,
            path: path.to_owned(),
            durable: out.len() as u64,
            written: out.len() as u64,
            summary,
            channels: HashMap::new(),
            chunk: OpenChunk::new(),
            durable_chunks: 0,
            new_channels: Vec::new(),
            new_schemas: Vec::new(),
        })
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many bytes of it are durable.
    pub fn durable(&self) -> u64 {
        self.durable
    }

    /// Adds a message; it is written with [`LogFile::may_end_chunk`] or [`LogFile::commit`].
    ///
    /// # Errors
    ///
    /// If the file has no channel left: MCAP numbers them with 16 bits.
    pub fn message(
        &mut self,
        topic: Topic,
        sequence: u32,
        time_ns: u64,
        content: impl FnOnce(&mut Vec<u8>),
    ) -> io::Result<()> {
        let channel = match self.channels.get(&topic) {
            Some(&channel) => channel,
            None => self.add_channel(topic)?,
        };
        self.chunk.message(channel, sequence, time_ns, content);
        Ok(())
    }

    /// Says that what was added until now is whole without what follows: a long chunk is written.
    ///
    /// # Errors
    ///
    /// If it cannot be written; [`LogFile::roll_back`] must follow.
    pub fn may_end_chunk(&mut self) -> io::Result<()> {
        if self.chunk.len() >= CHUNK_BYTES { self.write_chunk() } else { Ok(()) }
    }

    /// Writes what was added and syncs everything.
    ///
    /// # Errors
    ///
    /// If nothing of it may count as durable; [`LogFile::roll_back`] must follow.
    pub fn commit(&mut self) -> io::Result<()> {
        self.write_chunk()?;
        if self.written > self.durable {
            self.file.sync()?;
        }
        self.durable = self.written;
        self.durable_chunks = self.summary.chunks.len();
        self.new_channels.clear();
        self.new_schemas.clear();
        Ok(())
    }

    /// Goes back to what is durable, after an error.
    ///
    /// # Errors
    ///
    /// If the file does not let itself be cut: nothing may be added to it any more.
    pub fn roll_back(&mut self) -> io::Result<()> {
        self.written = self.durable;
        self.chunk.clear();
        self.summary.forget_chunks(self.durable_chunks);
        for topic in self.new_channels.drain(..) {
            if let Some(channel) = self.channels.remove(&topic) {
                self.summary.channels.remove(&channel);
            }
        }
        for schema in self.new_schemas.drain(..) {
            self.summary.schemas.remove(&schema);
        }
        self.file.cut(self.durable)
    }

    /// Writes the summary, so that other tools find their way in the file, and syncs it.
    pub fn finish(mut self) -> io::Result<()> {
        let end = self.summary.end_of_file(self.durable);
        self.file.append(&end).and_then(|()| self.file.sync())
    }

    fn write_chunk(&mut self) -> io::Result<()> {
        let Some((bytes, entry)) = self.chunk.close(self.written) else {
            return Ok(());
        };
        self.file.append(bytes)?;
        self.written += bytes.len() as u64;
        self.summary.add_chunk(entry);
        self.chunk.clear();
        Ok(())
    }

    fn add_channel(&mut self, topic: Topic) -> io::Result<u16> {
        let channel = u16::try_from(self.channels.len() + 1)
            .map_err(|_| io::Error::other("an MCAP file has room for 65535 channels, more boards need another log"))?;
        let (schema, name, data) = topic.schema();
        if schema != 0 && !self.summary.schemas.contains_key(&schema) {
            let record = self.chunk.record(|out| mcap::schema(out, schema, name, data)).to_vec();
            self.summary.schemas.insert(schema, record);
            self.new_schemas.push(schema);
        }
        let record =
            self.chunk.record(|out| mcap::channel(out, channel, schema, &topic.name(), topic.encoding())).to_vec();
        self.summary.channels.insert(channel, record);
        self.channels.insert(topic, channel);
        self.new_channels.push(topic);
        Ok(channel)
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

/// The kinds of records that stand before and between groups.
pub(super) fn is_known(code: u8) -> bool {
    matches!(code, opcode::HEADER | opcode::ATTACHMENT | opcode::CHUNK | opcode::MESSAGE_INDEX | opcode::DATA_END)
}
