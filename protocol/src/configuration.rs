//! What a board must know before it can say anything: the page that is written into its flash beside the firmware.
//!
//! | bytes | content |
//! | --- | --- |
//! | 0..4 | `TKCP` |
//! | 4 | version of the page's form, 1 |
//! | 5 | 0 |
//! | 6..8 | length of the body, little endian as all that follows |
//! | 8..12 | CRC-32 (IEEE 802.3) of the body |
//! | 12.. | the body: fields, each a tag, a length and that many bytes |
//!
//! Tags are append-only. A tag that is not known is skipped, so that an old firmware reads a newer page.

use core::fmt;

use heapless::{String, Vec};

use crate::{Key, MAX_SENSORS, Sensor, SensorKind};

/// The most bytes that a page may have: the smallest flash page of any board.
pub const MAX_PAGE: usize = 1024;

const MAGIC: [u8; 4] = *b"TKCP";
const VERSION: u8 = 1;
const HEAD: usize = 12;

/// The tags of the fields. Append-only.
mod tag {
    pub const BOARD: u8 = 1;
    pub const KEY: u8 = 2;
    pub const FIRST_BOOT: u8 = 3;
    pub const HOST: u8 = 4;
    pub const PORT: u8 = 5;
    pub const SENSORS: u8 = 6;
    pub const PLACE: u8 = 7;
    pub const SSID: u8 = 8;
    pub const PASSWORD: u8 = 9;
    pub const UPDATE_KEY: u8 = 10;
}

/// What one board must know: who it is, its key, its sensors, and how to reach its host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Configuration {
    /// The board's number.
    pub board: u32,
    /// The board's key.
    pub key: Key,
    /// No boot of the board has a smaller number.
    pub first_boot: u32,
    /// The host: an IPv4 address, or a name (by multicast DNS where it ends in `.local`).
    pub host: String<63>,
    /// The UDP port that the host listens on.
    pub port: u16,
    /// The board's sensors, in the order of its readings.
    pub sensors: Vec<Sensor, MAX_SENSORS>,
    /// Where the board sits, for people to read: robot and link.
    pub place: String<63>,
    /// The network to join; none on a board that has no radio.
    pub wifi: Option<Wifi>,
    /// The Ed25519 public key that new programs over the air are signed with; none on a board that takes none.
    pub update_key: Option<[u8; 32]>,
}

/// The credentials of a wireless network. The `Debug` form does not show the password.
#[derive(Clone, PartialEq, Eq)]
pub struct Wifi {
    /// The network's name.
    pub ssid: String<32>,
    /// The network's password; empty for an open network.
    pub password: String<64>,
}

impl fmt::Debug for Wifi {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Wifi").field("ssid", &self.ssid).finish_non_exhaustive()
    }
}

/// Why a page is not a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum BadPage {
    /// Nothing was ever written here, or something else.
    #[error("no configuration is written here")]
    Absent,
    /// A form that this firmware does not know.
    #[error("the configuration has form {0}, this end reads form {VERSION}")]
    Form(u8),
    /// Cut off, or its checksum is wrong.
    #[error("the configuration is damaged")]
    Damaged,
    /// A field is missing or has no sense; its tag.
    #[error("the configuration's field {0} is missing or has no sense")]
    Field(u8),
}

impl Configuration {
    /// The bytes of the page. All that a [`Configuration`] can hold fits [`MAX_PAGE`].
    pub fn to_page(&self) -> Vec<u8, MAX_PAGE> {
        let mut page: Vec<u8, MAX_PAGE> = Vec::new();
        append(&mut page, &[0; HEAD]);
        append_field(&mut page, tag::BOARD, &self.board.to_le_bytes());
        append_field(&mut page, tag::KEY, self.key.expose());
        append_field(&mut page, tag::FIRST_BOOT, &self.first_boot.to_le_bytes());
        append_field(&mut page, tag::HOST, self.host.as_bytes());
        append_field(&mut page, tag::PORT, &self.port.to_le_bytes());
        let mut sensors: Vec<u8, { 2 * MAX_SENSORS }> = Vec::new();
        for sensor in &self.sensors {
            append(&mut sensors, &[sensor.address, kind_number(sensor.kind)]);
        }
        append_field(&mut page, tag::SENSORS, &sensors);
        append_field(&mut page, tag::PLACE, self.place.as_bytes());
        if let Some(wifi) = &self.wifi {
            append_field(&mut page, tag::SSID, wifi.ssid.as_bytes());
            append_field(&mut page, tag::PASSWORD, wifi.password.as_bytes());
        }
        if let Some(key) = &self.update_key {
            append_field(&mut page, tag::UPDATE_KEY, key);
        }
        let (head, body) = page.split_at_mut(HEAD);
        let length = u16::try_from(body.len()).expect("a page is shorter than 2^16 bytes");
        head[..4].copy_from_slice(&MAGIC);
        head[4] = VERSION;
        head[6..8].copy_from_slice(&length.to_le_bytes());
        head[8..].copy_from_slice(&crc32(body).to_le_bytes());
        page
    }

    /// Reads a page; what follows it (erased flash) is ignored.
    ///
    /// # Errors
    ///
    /// When there is no page, or it is damaged, or a field is missing or has no sense.
    pub fn from_page(page: &[u8]) -> Result<Self, BadPage> {
        let (head, rest) = page.split_first_chunk::<HEAD>().ok_or(BadPage::Damaged)?;
        if head[..4] != MAGIC {
            return Err(BadPage::Absent);
        }
        if head[4] != VERSION {
            return Err(BadPage::Form(head[4]));
        }
        let body = rest.get(..usize::from(u16::from_le_bytes([head[6], head[7]]))).ok_or(BadPage::Damaged)?;
        if crc32(body).to_le_bytes() != head[8..HEAD] {
            return Err(BadPage::Damaged);
        }
        let field = |wanted: u8| Fields(body).find(|&(tag, _)| tag == wanted).map(|(_, bytes)| bytes);
        let number = |tag: u8| field(tag).and_then(|bytes| bytes.try_into().ok().map(u32::from_le_bytes));
        let ssid = field(tag::SSID).map(|bytes| text(bytes).ok_or(BadPage::Field(tag::SSID))).transpose()?;
        let wifi = match ssid {
            Some(ssid) => {
                let password = field(tag::PASSWORD).and_then(text).ok_or(BadPage::Field(tag::PASSWORD))?;
                Some(Wifi { ssid, password })
            }
            None => None,
        };
        Ok(Self {
            board: number(tag::BOARD).ok_or(BadPage::Field(tag::BOARD))?,
            key: field(tag::KEY)
                .and_then(|bytes| bytes.try_into().ok().map(Key::from_bytes))
                .ok_or(BadPage::Field(tag::KEY))?,
            first_boot: number(tag::FIRST_BOOT).ok_or(BadPage::Field(tag::FIRST_BOOT))?,
            host: field(tag::HOST).and_then(text).ok_or(BadPage::Field(tag::HOST))?,
            port: field(tag::PORT)
                .and_then(|bytes| bytes.try_into().ok().map(u16::from_le_bytes))
                .ok_or(BadPage::Field(tag::PORT))?,
            sensors: field(tag::SENSORS).and_then(sensors).ok_or(BadPage::Field(tag::SENSORS))?,
            place: field(tag::PLACE).and_then(text).ok_or(BadPage::Field(tag::PLACE))?,
            wifi,
            update_key: field(tag::UPDATE_KEY)
                .map(|bytes| bytes.try_into().map_err(|_| BadPage::Field(tag::UPDATE_KEY)))
                .transpose()?,
        })
    }
}

/// The fields of a body, as far as they are whole.
struct Fields<'a>(&'a [u8]);

impl<'a> Iterator for Fields<'a> {
    type Item = (u8, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let (&[tag, length], rest) = self.0.split_first_chunk()?;
        let (bytes, rest) = rest.split_at_checked(usize::from(length))?;
        self.0 = rest;
        Some((tag, bytes))
    }
}

fn text<const CAPACITY: usize>(bytes: &[u8]) -> Option<String<CAPACITY>> {
    String::try_from(core::str::from_utf8(bytes).ok()?).ok()
}

fn sensors(bytes: &[u8]) -> Option<Vec<Sensor, MAX_SENSORS>> {
    let (pairs, rest) = bytes.as_chunks::<2>();
    let mut sensors = Vec::new();
    for &[address, kind] in pairs {
        sensors.push(Sensor { address, kind: kind_of(kind)? }).ok()?;
    }
    rest.is_empty().then_some(sensors)
}

fn kind_number(kind: SensorKind) -> u8 {
    match kind {
        SensorKind::Max30205 => 0,
        SensorKind::Lm75 => 1,
    }
}

fn kind_of(number: u8) -> Option<SensorKind> {
    match number {
        0 => Some(SensorKind::Max30205),
        1 => Some(SensorKind::Lm75),
        _ => None,
    }
}

fn append_field(page: &mut Vec<u8, MAX_PAGE>, tag: u8, bytes: &[u8]) {
    append(page, &[tag, u8::try_from(bytes.len()).expect("a field is shorter than 256 bytes")]);
    append(page, bytes);
}

fn append<const CAPACITY: usize>(page: &mut Vec<u8, CAPACITY>, bytes: &[u8]) {
    page.extend_from_slice(bytes).expect("the largest configuration fits a page");
}

/// CRC-32 as Ethernet has it, bit by bit: a page is read once a boot.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    })
}
