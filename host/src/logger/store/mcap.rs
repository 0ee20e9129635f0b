//! The records of an MCAP file, as bytes (<https://mcap.dev/spec>): written and taken apart, nothing else.
//!
//! By hand, because the log needs what no MCAP writer offers: to know the exact byte up to which a file is durable, to cut
//! back to it when a write failed, and to finish in place a file that another process left behind.

/// What an MCAP file begins and ends with.
pub const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];

/// The kinds of records that this log writes.
pub mod opcode {
    #![allow(missing_docs, reason = "the names are the specification's")]
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const ATTACHMENT: u8 = 0x09;
    pub const ATTACHMENT_INDEX: u8 = 0x0A;
    pub const STATISTICS: u8 = 0x0B;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
}

/// Appends a record: its kind, its length, and what `content` writes.
pub fn record(out: &mut Vec<u8>, opcode: u8, content: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let at = out.len();
    out.extend_from_slice(&[0; 8]);
    content(out);
    let length = (out.len() - at - 8) as u64;
    out[at..at + 8].copy_from_slice(&length.to_le_bytes());
}

/// Appends a text with its length in front.
pub fn text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

/// Appends the header record.
pub fn header(out: &mut Vec<u8>) {
    record(out, opcode::HEADER, |out| {
        text(out, "");
        text(out, concat!("thermokin ", env!("CARGO_PKG_VERSION")));
    });
}

/// Appends a JSON schema, or with an empty text none, under an id from 1.
pub fn schema(out: &mut Vec<u8>, id: u16, name: &str, data: &str) {
    record(out, opcode::SCHEMA, |out| {
        out.extend_from_slice(&id.to_le_bytes());
        text(out, name);
        text(out, "jsonschema");
        text(out, data);
    });
}

/// Appends a channel; schema 0 is none.
pub fn channel(out: &mut Vec<u8>, id: u16, schema: u16, topic: &str, encoding: &str) {
    record(out, opcode::CHANNEL, |out| {
        out.extend_from_slice(&id.to_le_bytes());
        out.extend_from_slice(&schema.to_le_bytes());
        text(out, topic);
        text(out, encoding);
        out.extend_from_slice(&0_u32.to_le_bytes());
    });
}

/// Appends a message whose data `content` writes; times in nanoseconds since 1970.
pub fn message(out: &mut Vec<u8>, channel: u16, sequence: u32, time_ns: u64, content: impl FnOnce(&mut Vec<u8>)) {
    record(out, opcode::MESSAGE, |out| {
        out.extend_from_slice(&channel.to_le_bytes());
        out.extend_from_slice(&sequence.to_le_bytes());
        out.extend_from_slice(&time_ns.to_le_bytes());
        out.extend_from_slice(&time_ns.to_le_bytes());
        content(out);
    });
}

/// The bytes of a chunk record in front of its records.
pub const CHUNK_HEAD: usize = 9 + 8 + 8 + 8 + 4 + 4 + 8;

/// Fills in the head of an uncompressed chunk: its records, of these times, stand behind the room for it.
///
/// # Panics
///
/// If there is no room for it.
pub fn chunk_head(bytes: &mut [u8], (start_ns, end_ns): (u64, u64)) {
    let (head, records) = bytes.split_at_mut(CHUNK_HEAD);
    let length = records.len() as u64;
    let mut out = Vec::with_capacity(CHUNK_HEAD);
    out.push(opcode::CHUNK);
    out.extend_from_slice(&(CHUNK_HEAD as u64 - 9 + length).to_le_bytes());
    out.extend_from_slice(&start_ns.to_le_bytes());
    out.extend_from_slice(&end_ns.to_le_bytes());
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&crc32fast::hash(records).to_le_bytes());
    text(&mut out, "");
    out.extend_from_slice(&length.to_le_bytes());
    head.copy_from_slice(&out);
}

/// Appends the index of one channel's messages in the chunk before: (time, offset within the chunk's records).
pub fn message_index(out: &mut Vec<u8>, channel: u16, entries: impl ExactSizeIterator<Item = (u64, u64)>) {
    record(out, opcode::MESSAGE_INDEX, |out| {
        out.extend_from_slice(&channel.to_le_bytes());
        out.extend_from_slice(&((entries.len() * 16) as u32).to_le_bytes());
        for (time_ns, offset) in entries {
            out.extend_from_slice(&time_ns.to_le_bytes());
            out.extend_from_slice(&offset.to_le_bytes());
        }
    });
}

/// The length of the index of so many messages.
pub fn message_index_length(messages: u64) -> u64 {
    9 + 2 + 4 + 16 * messages
}

/// Appends an attachment, with its CRC.
pub fn attachment(out: &mut Vec<u8>, time_ns: u64, name: &str, media_type: &str, data: &[u8]) {
    record(out, opcode::ATTACHMENT, |out| {
        let start = out.len();
        out.extend_from_slice(&time_ns.to_le_bytes());
        out.extend_from_slice(&time_ns.to_le_bytes());
        text(out, name);
        text(out, media_type);
        out.extend_from_slice(&(data.len() as u64).to_le_bytes());
        out.extend_from_slice(data);
        let crc = crc32fast::hash(&out[start..]);
        out.extend_from_slice(&crc.to_le_bytes());
    });
}

/// Takes little-endian numbers and texts off the front of some bytes; none where they end too early.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    /// The next bytes.
    pub fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(head)
    }

    /// The next 16-bit number.
    pub fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.bytes(2)?.try_into().ok()?))
    }

    /// The next 32-bit number.
    pub fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.bytes(4)?.try_into().ok()?))
    }

    /// The next 64-bit number.
    pub fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }

    /// The next text with its length in front.
    pub fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()?;
        std::str::from_utf8(self.bytes(length as usize)?).ok()
    }

    /// The next record: its kind and its content.
    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let opcode = self.bytes(1)?[0];
        let length = usize::try_from(self.u64()?).ok()?;
        Some((opcode, self.bytes(length)?))
    }
}

/// The records of an uncompressed chunk, if its CRC is right.
pub fn chunk_records(content: &[u8]) -> Option<(u64, u64, &[u8])> {
    let mut fields = Fields(content);
    let (start_ns, end_ns, _size, crc) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
    let compression = fields.text()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    let records = fields.bytes(length)?;
    (compression.is_empty() && crc32fast::hash(records) == crc).then_some((start_ns, end_ns, records))
}

/// A message within a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
    /// The channel's id in its file.
    pub channel: u16,
    /// The time in nanoseconds since 1970.
    pub time_ns: u64,
    /// What was written.
    pub data: &'a [u8],
}

impl<'a> Message<'a> {
    /// Takes the content of a message record apart.
    pub fn parse(content: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(content);
        let (channel, _sequence, time_ns, _published) = (fields.u16()?, fields.u32()?, fields.u64()?, fields.u64()?);
        Some(Self { channel, time_ns, data: fields.0 })
    }
}
