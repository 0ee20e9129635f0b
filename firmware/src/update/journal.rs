//! What a board must remember of an update: the offer that it took, which sectors it has, and how it went.
//!
//! Two sectors of flash take turns. A page begins with the offer and a checksum; after that only single words are
//! written, each once, from all ones to zero: so a loss of power leaves every word done or not done, and a page half
//! erased is older than the one that replaced it. The page with the higher generation counts.

use embedded_storage::nor_flash::NorFlash;
use thermokin_protocol::update::{Manifest, Offer};

use super::otadata::Slot;

const MAGIC: [u8; 4] = *b"TKUJ";
const HEADER: usize = 64;
/// Where in the header its parts lie: after the magic generation, order, slot and patience.
const MANIFEST: usize = 16;
const CHECK: usize = HEADER - 4;
/// The words of the page's history follow the header, then one word for each sector of the slot.
const HISTORY: u32 = HEADER as u32;
const WORDS: usize = 16;
const MARKS: u32 = HISTORY + 4 * WORDS as u32;

/// How often a whole program is chosen, and how often it starts on trial, before it is given up.
pub const TRIES: u32 = 3;

/// A word of a page's history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Event {
    /// All of the program is there and is what was signed.
    Whole,
    /// The bootloader was about to be told to start it; several times if the power went.
    Chosen,
    /// It started on trial; several times.
    Trial,
    /// It reached the host.
    Confirmed,
    /// It is given up.
    Failed,
}

impl Event {
    /// The words for it: the first one's index, and how many there are.
    fn words(self) -> (usize, u32) {
        match self {
            Event::Whole => (0, 1),
            Event::Chosen => (1, TRIES),
            Event::Trial => (4, TRIES),
            Event::Confirmed => (7, 1),
            Event::Failed => (8, 1),
        }
    }
}

/// The page that counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Page {
    at: u32,
    generation: u32,
    /// The number of the offer.
    pub order: u32,
    /// Where the program goes.
    pub slot: Slot,
    /// How long the program may take on trial, in seconds.
    pub patience_s: u16,
    /// What the program is.
    pub manifest: Manifest,
    history: [u32; WORDS],
}

impl Page {
    /// Whether something happened.
    pub fn has(&self, event: Event) -> bool {
        let (first, count) = event.words();
        // A word that was being written when the power went is done again; one that is counted counts.
        if count == 1 { self.history[first] == 0 } else { self.count(event) > 0 }
    }

    /// How often something happened.
    pub fn count(&self, event: Event) -> u32 {
        let (first, count) = event.words();
        self.history[first..first + count as usize].iter().filter(|&&word| word != u32::MAX).count() as u32
    }

    /// Notes that something happened.
    pub fn note<F: NorFlash>(&mut self, flash: &mut F, event: Event) -> Result<(), F::Error> {
        let (first, count) = event.words();
        let word = first + self.count(event).min(count - 1) as usize;
        flash.write(self.at + HISTORY + 4 * word as u32, &[0; 4])?;
        self.history[word] = 0;
        Ok(())
    }

    /// Notes that a sector of the slot is written.
    pub fn mark<F: NorFlash>(&self, flash: &mut F, sector: u32) -> Result<(), F::Error> {
        flash.write(self.at + MARKS + 4 * sector, &[0; 4])
    }

    /// How many sectors from the slot's start are written.
    pub fn marked<F: NorFlash>(&self, flash: &mut F) -> Result<u32, F::Error> {
        let sectors = self.manifest.length.div_ceil(F::ERASE_SIZE as u32);
        for sector in 0..sectors {
            let mut word = [0; 4];
            flash.read(self.at + MARKS + 4 * sector, &mut word)?;
            if word != [0; 4] {
                return Ok(sector);
            }
        }
        Ok(sectors)
    }
}

/// Whether a page has a word for each sector of a slot.
pub(super) fn fits<F: NorFlash>(slot_length: u32) -> bool {
    MARKS as usize + 4 * (slot_length as usize).div_ceil(F::ERASE_SIZE) <= F::ERASE_SIZE
}

/// The page that counts, if there is one.
pub(super) fn read<F: NorFlash>(flash: &mut F, journal: u32) -> Result<Option<Page>, F::Error> {
    let first = read_at(flash, journal)?;
    let second = read_at(flash, journal + F::ERASE_SIZE as u32)?;
    Ok(match (first, second) {
        (Some(first), Some(second)) if second.generation > first.generation => Some(second),
        (Some(first), _) => Some(first),
        (None, second) => second,
    })
}

/// Begins a page for an offer, in the sector that does not count.
pub(super) fn begin<F: NorFlash>(
    flash: &mut F,
    journal: u32,
    earlier: Option<&Page>,
    offer: &Offer,
    slot: Slot,
) -> Result<Page, F::Error> {
    let sector = F::ERASE_SIZE as u32;
    let at = earlier.map_or(journal, |page| if page.at == journal { journal + sector } else { journal });
    let generation = earlier.map_or(1, |page| page.generation.saturating_add(1));
    let page = Page {
        at,
        generation,
        order: offer.order,
        slot,
        patience_s: offer.patience_s,
        manifest: offer.manifest,
        history: [u32::MAX; WORDS],
    };
    let mut header = [0; HEADER];
    header[..4].copy_from_slice(&MAGIC);
    header[4..8].copy_from_slice(&generation.to_le_bytes());
    header[8..12].copy_from_slice(&page.order.to_le_bytes());
    header[12] = slot as u8;
    header[14..16].copy_from_slice(&page.patience_s.to_le_bytes());
    header[MANIFEST..CHECK].copy_from_slice(&page.manifest.to_bytes());
    let check = check(&header[..CHECK]);
    header[CHECK..].copy_from_slice(&check.to_le_bytes());
    flash.erase(at, at + sector)?;
    flash.write(at, &header)?;
    Ok(page)
}

fn read_at<F: NorFlash>(flash: &mut F, at: u32) -> Result<Option<Page>, F::Error> {
    let mut header = [0; HEADER];
    flash.read(at, &mut header)?;
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    if header[..4] != MAGIC || word(CHECK) != check(&header[..CHECK]) {
        return Ok(None);
    }
    let mut manifest = [0; Manifest::LENGTH];
    manifest.copy_from_slice(&header[MANIFEST..CHECK]);
    let Some(manifest) = Manifest::from_bytes(&manifest) else {
        return Ok(None);
    };
    let mut words = [0; 4 * WORDS];
    flash.read(at + HISTORY, &mut words)?;
    let (words, _) = words.as_chunks::<4>();
    let mut history = [0; WORDS];
    for (place, &word) in history.iter_mut().zip(words) {
        *place = u32::from_le_bytes(word);
    }
    Ok(Some(Page {
        at,
        generation: word(4),
        order: word(8),
        slot: if header[12] == Slot::A as u8 { Slot::A } else { Slot::B },
        patience_s: u16::from_le_bytes([header[14], header[15]]),
        manifest,
        history,
    }))
}

/// CRC-32 as Ethernet has it.
fn check(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    })
}
