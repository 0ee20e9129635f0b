//! Reading a log file from its beginning, whole or cut off at any byte: only whole, undamaged groups count.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::file::is_known;
use super::mcap::{self, Fields, MAGIC, Message, opcode};
use super::summary::{AttachmentEntry, ChunkEntry, Summary};
use super::topic::Topic;
use crate::input::InputError;

/// By channel: the time of each message, and its offset within the group's records.
type Indexes = BTreeMap<u16, Vec<(u64, u64)>>;

/// A chunk that was read, with those of its indexes that were not.
struct OpenGroup {
    entry: ChunkEntry,
    indexes: Indexes,
    records: Vec<u8>,
}

/// What a scan found.
#[derive(Debug, Clone)]
pub struct Scan {
    /// Everything before this byte is whole: header, attachments and groups.
    pub valid: u64,
    /// The file's length.
    pub length: u64,
    /// Whether the file ends with the summary and the magic that a finished file has.
    pub finished: bool,
    /// What stands at `valid` if not the end of a finished file.
    pub damage: Option<String>,
    /// What the summary of the whole part says.
    pub summary: Summary,
}

impl Scan {
    /// How many bytes at the end belong to no whole group, the end of a finished file aside.
    pub fn torn(&self) -> u64 {
        if self.finished { 0 } else { self.length - self.valid }
    }
}

/// A message of a log file.
#[derive(Debug, Clone, Copy)]
pub struct Logged<'a> {
    /// Its channel; none for a channel of another program.
    pub topic: Option<Topic>,
    /// Its time in nanoseconds since 1970.
    pub time_ns: u64,
    /// What was written.
    pub data: &'a [u8],
}

/// Reads a file and calls `each` with the messages of every whole group, in order, a group at a time.
///
/// # Errors
///
/// If the file cannot be read, or is not an MCAP file at all; a file that is cut off or damaged is no error.
pub fn scan(path: &Path, each: impl FnMut(Logged<'_>)) -> Result<Scan, InputError> {
    scan_stepwise(path, |_| {}, each)
}

/// As [`scan`], and calls `step` now and then with how many more bytes were read.
pub fn scan_stepwise(path: &Path, step: impl FnMut(u64), each: impl FnMut(Logged<'_>)) -> Result<Scan, InputError> {
    scan_to(path, u64::MAX, step, each)
}

/// As [`scan`], of the first `limit` bytes: nothing behind them counts.
pub(super) fn scan_part(path: &Path, limit: u64, each: impl FnMut(Logged<'_>)) -> Result<Scan, InputError> {
    scan_to(path, limit, |_| {}, each)
}

fn scan_to(
    path: &Path,
    limit: u64,
    mut step: impl FnMut(u64),
    mut each: impl FnMut(Logged<'_>),
) -> Result<Scan, InputError> {
    let failed = |error: io::Error| InputError::of_file(path, error.to_string());
    let file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let mut magic = [0; 8];
    if reader.read_exact(&mut magic).is_err() || magic != MAGIC {
        return Err(InputError::of_file(path, "not an MCAP file: expected one that `thermokin log` wrote"));
    }
    let mut scan = Scan { valid: 8, length, finished: false, damage: None, summary: Summary::default() };
    let mut topics: BTreeMap<u16, Option<Topic>> = BTreeMap::new();
    // The group that is being read: a chunk whose indexes are not all there yet.
    let mut open: Option<OpenGroup> = None;
    let mut expected = Vec::new();
    let mut position = 8;
    let mut content = Vec::new();
    scan.damage = loop {
        if position >= limit {
            break Some(format!("the file that follows says that nothing counts from byte {limit} on"));
        }
        if position == length {
            break open.is_some().then(|| "cut off within a group".to_owned());
        }
        let mut head = [0; 9];
        if reader.read_exact(&mut head).is_err() {
            break Some("cut off within a record".to_owned());
        }
        let mut fields = Fields(&head[1..]);
        let size = fields.u64().unwrap_or(u64::MAX);
        if !is_known(head[0]) {
            break Some(format!("no record of a log begins at byte {position}"));
        }
        if size > length - position - 9 {
            break Some("cut off within a record".to_owned());
        }
        content.resize(size as usize, 0);
        reader.read_exact(&mut content).map_err(failed)?;
        let start = position;
        position += 9 + size;
        step(9 + size);
        match head[0] {
            opcode::DATA_END if open.is_none() => break None,
            opcode::HEADER if open.is_none() => scan.valid = position,
            opcode::ATTACHMENT if open.is_none() => {
                let Some(entry) = attachment(&content, (start, position - start)) else {
                    break Some(format!("damaged attachment at byte {start}"));
                };
                scan.summary.attachments.push(entry);
                scan.valid = position;
            }
            opcode::CHUNK if open.is_none() => {
                let Some((start_ns, end_ns, records)) = mcap::chunk_records(&content) else {
                    break Some(format!("damaged group at byte {start}"));
                };
                let entry = ChunkEntry::new((start_ns, end_ns), (start, position - start), records.len() as u64);
                let Some(indexes) = indexes_of(records) else {
                    break Some(format!("damaged group at byte {start}"));
                };
                open = Some(OpenGroup { entry, indexes, records: records.to_vec() });
            }
            opcode::MESSAGE_INDEX => {
                let Some(group) = &mut open else {
                    break Some(format!("an index without a group at byte {start}"));
                };
                // No CRC guards an index, but it follows from its group: there is one a channel, in order.
                let Some((channel, messages)) = group.indexes.pop_first() else {
                    break Some(format!("an index too many at byte {start}"));
                };
                expected.clear();
                mcap::message_index(&mut expected, channel, messages.iter().copied());
                if expected[9..] != content[..] {
                    break Some(format!("damaged index at byte {start}"));
                }
                group.entry.add_index(channel, messages.len() as u64);
            }
            _ => break Some(format!("a record out of place at byte {start}")),
        }
        if let Some(group) = open.take_if(|group| group.indexes.is_empty()) {
            scan.valid = position;
            scan.summary.add_chunk(group.entry);
            take_group(&group.records, &mut scan.summary, &mut topics, &mut each);
        }
    };
    scan.finished = scan.damage.is_none() && ends_with_magic(&mut reader, length, scan.valid).map_err(failed)?;
    if !scan.finished && scan.damage.is_none() && scan.valid < length {
        scan.damage = Some("its summary is cut off".to_owned());
    }
    Ok(scan)
}

fn attachment(content: &[u8], place: (u64, u64)) -> Option<AttachmentEntry> {
    let mut fields = Fields(content);
    let (time_ns, _created) = (fields.u64()?, fields.u64()?);
    let (name, media_type) = (fields.text()?.to_owned(), fields.text()?.to_owned());
    let size = fields.u64()?;
    fields.bytes(usize::try_from(size).ok()?)?;
    let crc = fields.u32()?;
    let right = crc32fast::hash(&content[..content.len() - 4]) == crc;
    right.then_some(AttachmentEntry { place, time_ns, size, name, media_type })
}

/// The index that each channel with messages in a group must have; none if the group's records cannot be read.
fn indexes_of(records: &[u8]) -> Option<Indexes> {
    let mut indexes = Indexes::new();
    let mut fields = Fields(records);
    while !fields.0.is_empty() {
        let offset = (records.len() - fields.0.len()) as u64;
        let (code, content) = fields.record()?;
        if code == opcode::MESSAGE {
            let message = Message::parse(content)?;
            indexes.entry(message.channel).or_default().push((message.time_ns, offset));
        }
    }
    Some(indexes)
}

fn take_group(
    records: &[u8],
    summary: &mut Summary,
    topics: &mut BTreeMap<u16, Option<Topic>>,
    each: &mut impl FnMut(Logged<'_>),
) {
    let mut fields = Fields(records);
    loop {
        let before = fields.0;
        let Some((code, content)) = fields.record() else {
            return;
        };
        let whole = || before[..before.len() - fields.0.len()].to_vec();
        let mut inner = Fields(content);
        match code {
            opcode::SCHEMA => {
                if let Some(id) = inner.u16() {
                    summary.schemas.insert(id, whole());
                }
            }
            opcode::CHANNEL => {
                if let (Some(id), Some(_schema), Some(name)) = (inner.u16(), inner.u16(), inner.text()) {
                    topics.insert(id, Topic::of_name(name));
                    summary.channels.insert(id, whole());
                }
            }
            opcode::MESSAGE => {
                if let Some(message) = Message::parse(content) {
                    let topic = topics.get(&message.channel).copied().flatten();
                    each(Logged { topic, time_ns: message.time_ns, data: message.data });
                }
            }
            _ => {}
        }
    }
}

/// Whether the file ends as a finished one does: footer and magic behind a data end at `valid`.
fn ends_with_magic(reader: &mut BufReader<File>, length: u64, valid: u64) -> io::Result<bool> {
    const END: u64 = 9 + 20 + 8;
    if length < valid + 13 + END {
        return Ok(false);
    }
    let mut end = [0; END as usize];
    reader.seek(SeekFrom::Start(length - END))?;
    reader.read_exact(&mut end)?;
    Ok(end[0] == opcode::FOOTER && end[29..] == MAGIC)
}
