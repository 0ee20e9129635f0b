//! New programs over the air: takes an offer that is signed, fills the other slot chunk by chunk, checks it, has the
//! bootloader start it on trial, and goes back to the earlier program unless the new one reaches the host.
//!
//! The program that runs is never written over. What was done is in flash (`journal`), so a reset or a loss of power
//! at any moment costs at most one sector of the transfer, and the board always has a whole program to start. A program
//! on trial has [`TRIES`] starts; in each it must have a record acknowledged within the offer's patience, or the board
//! restarts. What no program can do is to go back from one that dies before it comes to [`Updater::start`].

mod journal;
mod otadata;

use ed25519_dalek::{Signature, VerifyingKey};
use embassy_time::Duration;
use embedded_storage::nor_flash::NorFlash;
use sha2::{Digest, Sha256};
use thermokin_protocol::update::{CHUNK, Chunk, Offer, Target, UpdateOrder, UpdateRefusal, UpdateReport, UpdateState};

use crate::log::{alarm, info};
pub use journal::TRIES;
use journal::{Event, Page};
pub use otadata::{Slot, select, selected};

/// Bytes of a program that are checked at once, so that sampling is not held up.
const CHECKED_AT_ONCE: u32 = 4096;
/// Bytes read at once for that.
const READ_AT_ONCE: usize = 256;

/// Where in flash the parts of an update lie; all begin and end with sectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Two sectors that remember how an update goes.
    pub journal: u32,
    /// Two sectors in which the bootloader looks for the slot to start.
    pub otadata: u32,
    /// The slots.
    pub slots: [u32; 2],
    /// The length of each.
    pub slot_length: u32,
}

/// What a board does with its update at the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Start {
    /// It runs.
    Run,
    /// It restarts at once: the earlier program is to run.
    Restart,
}

/// What [`Updates::step`] has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Step {
    /// There is nothing to do.
    Idle,
    /// There is more to check: call again soon.
    More,
    /// How it ended: report it, and if it is [`UpdateState::Restarting`], restart.
    Report(UpdateReport),
}

/// What the uplink asks of a board's updates; [`Updater`] is the one that there is.
pub trait Updates {
    /// Takes what the host says; gives what to report.
    fn order(&mut self, order: &UpdateOrder<'_>) -> UpdateReport;
    /// Goes on with checking.
    fn step(&mut self) -> Step;
    /// How long after the start the program that runs must have reached the host; none once it has.
    fn patience(&self) -> Option<Duration>;
    /// A record of this boot was acknowledged: a program on trial stays.
    fn acknowledged(&mut self);
}

/// The updates of a board, on its flash.
#[derive(Debug)]
pub struct Updater<F> {
    flash: F,
    layout: Layout,
    target: Target,
    key: Option<[u8; 32]>,
    running: Slot,
    page: Option<Page>,
    state: State,
}

#[derive(Debug, Clone)]
enum State {
    /// No update goes on.
    Idle,
    /// The next chunk begins there.
    Receiving(u32),
    /// The digest of so many bytes.
    Checking(u32, Sha256),
    /// The program that runs is on trial.
    OnTrial,
}

impl<F: NorFlash> Updater<F> {
    /// Takes up what an earlier boot left. `key` signs programs for this board, `running` is the slot that the program
    /// was started from, where the chip tells; otherwise the one that the bootloader was told.
    ///
    /// # Errors
    ///
    /// When the flash fails.
    pub fn start(
        mut flash: F,
        layout: Layout,
        target: Target,
        key: Option<[u8; 32]>,
        running: Option<Slot>,
    ) -> Result<(Self, Start), F::Error> {
        const { assert!(F::ERASE_SIZE.is_multiple_of(CHUNK) && F::WRITE_SIZE <= 4 && F::READ_SIZE <= 4) };
        let chosen = selected(&mut flash, layout.otadata)?;
        let running = running.unwrap_or(chosen);
        let page = journal::read(&mut flash, layout.journal)?;
        let mut updater = Self { flash, layout, target, key, running, page, state: State::Idle };
        let start = updater.take_up(chosen)?;
        Ok((updater, start))
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// The slot that the program runs from.
    pub fn running(&self) -> Slot {
        self.running
    }

    fn take_up(&mut self, chosen: Slot) -> Result<Start, F::Error> {
        let Some(page) = &mut self.page else {
            return Ok(Start::Run);
        };
        if page.has(Event::Confirmed) || page.has(Event::Failed) {
            return Ok(Start::Run);
        }
        if !page.has(Event::Whole) {
            let sectors = page.marked(&mut self.flash)?;
            let next = (sectors * F::ERASE_SIZE as u32).min(page.manifest.length);
            self.state = if next < page.manifest.length { State::Receiving(next) } else { checking() };
            return Ok(Start::Run);
        }
        if page.slot == self.running {
            if page.count(Event::Trial) == TRIES {
                alarm!("the new program did not reach the host: back to the earlier one");
                select(&mut self.flash, self.layout.otadata, page.slot.other())?;
                page.note(&mut self.flash, Event::Failed)?;
                return Ok(Start::Restart);
            }
            page.note(&mut self.flash, Event::Trial)?;
            info!("new program, start {=u32} on trial", page.count(Event::Trial));
            self.state = State::OnTrial;
            return Ok(Start::Run);
        }
        // The earlier program runs though the new one is whole. Either the power went before the bootloader was told,
        // then it is told again; or the new program was gone back from, by itself or by the bootloader.
        if page.has(Event::Trial) || chosen == page.slot || page.count(Event::Chosen) == TRIES {
            select(&mut self.flash, self.layout.otadata, self.running)?;
            page.note(&mut self.flash, Event::Failed)?;
        } else {
            self.state = checking();
        }
        Ok(Start::Run)
    }

    fn offered(&mut self, offer: &Offer) -> Result<UpdateState, F::Error> {
        if let Some(page) = &self.page
            && page.manifest == offer.manifest
        {
            // A program that was confirmed once needs no second transfer, whoever offers it again.
            let runs = page.has(Event::Confirmed) && page.slot == self.running;
            if runs || page.order == offer.order {
                return Ok(self.progress(page));
            }
        }
        if let Some(refusal) = self.objection(offer) {
            return Ok(UpdateState::Refused(refusal));
        }
        let slot = self.running.other();
        let page = journal::begin(&mut self.flash, self.layout.journal, self.page.as_ref(), offer, slot)?;
        info!("a new program of {=u32} bytes is offered and signed", page.manifest.length);
        self.page = Some(page);
        self.state = State::Receiving(0);
        Ok(UpdateState::Wants(0))
    }

    /// Why a new offer is not taken.
    fn objection(&self, offer: &Offer) -> Option<UpdateRefusal> {
        let Offer { manifest, signature: [first, second], .. } = offer;
        if matches!(self.state, State::OnTrial) {
            return Some(UpdateRefusal::OnTrial);
        }
        let Some(key) = &self.key else {
            return Some(UpdateRefusal::NoKey);
        };
        if manifest.target != self.target {
            return Some(UpdateRefusal::OtherTarget);
        }
        if manifest.length == 0 || manifest.length > self.layout.slot_length {
            return Some(UpdateRefusal::BadLength);
        }
        if !journal::fits::<F>(self.layout.slot_length) {
            return Some(UpdateRefusal::NoSlots);
        }
        let mut signature = [0; 64];
        signature[..32].copy_from_slice(first);
        signature[32..].copy_from_slice(second);
        let signature = Signature::from_bytes(&signature);
        let genuine = VerifyingKey::from_bytes(key)
            .is_ok_and(|key| key.verify_strict(&manifest.signed_bytes(), &signature).is_ok());
        (!genuine).then_some(UpdateRefusal::BadSignature)
    }

    /// How far the page's update is.
    fn progress(&self, page: &Page) -> UpdateState {
        match self.state {
            State::Receiving(next) => UpdateState::Wants(next),
            State::Checking(..) => UpdateState::Checking,
            State::OnTrial => UpdateState::OnTrial,
            State::Idle if page.has(Event::Confirmed) => UpdateState::Installed,
            State::Idle if page.has(Event::Whole) => UpdateState::RolledBack,
            State::Idle => UpdateState::Refused(UpdateRefusal::Damaged),
        }
    }

    fn arrived(&mut self, chunk: &Chunk<'_>) -> Result<UpdateState, F::Error> {
        let Some(page) = self.page.filter(|page| page.order == chunk.order) else {
            // Of an offer that is not this board's any more: asking from its start shows the host that it is not.
            return Ok(UpdateState::Wants(0));
        };
        let State::Receiving(next) = self.state else {
            return Ok(self.progress(&page));
        };
        let expected = CHUNK.min((page.manifest.length - next) as usize);
        if chunk.offset != next || chunk.bytes.len() != expected {
            return Ok(UpdateState::Wants(next));
        }
        let sector = F::ERASE_SIZE as u32;
        let at = self.layout.slots[page.slot as usize] + next;
        if next.is_multiple_of(sector) {
            self.flash.erase(at, at + sector)?;
        }
        let mut words = Aligned([0xFF; CHUNK]);
        words.0[..expected].copy_from_slice(chunk.bytes);
        self.flash.write(at, &words.0[..expected.next_multiple_of(4)])?;
        let next = next + expected as u32;
        if next.is_multiple_of(sector) || next == page.manifest.length {
            page.mark(&mut self.flash, (next - 1) / sector)?;
        }
        self.state = if next < page.manifest.length { State::Receiving(next) } else { checking() };
        Ok(self.progress(&page))
    }

    fn check(&mut self) -> Result<Step, F::Error> {
        let State::Checking(checked, digest) = &mut self.state else {
            return Ok(Step::Idle);
        };
        let Some(page) = &mut self.page else {
            return Ok(Step::Idle);
        };
        let until = page.manifest.length.min(*checked + CHECKED_AT_ONCE);
        let mut words = Aligned([0; READ_AT_ONCE]);
        while *checked < until {
            let length = READ_AT_ONCE.min((until - *checked) as usize);
            let at = self.layout.slots[page.slot as usize] + *checked;
            self.flash.read(at, &mut words.0[..length.next_multiple_of(4)])?;
            digest.update(&words.0[..length]);
            *checked += length as u32;
        }
        if *checked < page.manifest.length {
            return Ok(Step::More);
        }
        let whole = digest.clone().finalize()[..] == page.manifest.digest;
        self.state = State::Idle;
        let state = if !whole {
            alarm!("the new program came damaged");
            page.note(&mut self.flash, Event::Failed)?;
            UpdateState::Refused(UpdateRefusal::Damaged)
        } else {
            if !page.has(Event::Whole) {
                page.note(&mut self.flash, Event::Whole)?;
            }
            page.note(&mut self.flash, Event::Chosen)?;
            select(&mut self.flash, self.layout.otadata, page.slot)?;
            info!("the new program is whole: restart");
            UpdateState::Restarting
        };
        Ok(Step::Report(UpdateReport { order: page.order, state }))
    }
}

impl<F: NorFlash> Updates for Updater<F> {
    fn order(&mut self, order: &UpdateOrder<'_>) -> UpdateReport {
        let (number, state) = match order {
            UpdateOrder::Offer(offer) => (offer.order, self.offered(offer)),
            UpdateOrder::Chunk(chunk) => (chunk.order, self.arrived(chunk)),
        };
        UpdateReport { order: number, state: state.unwrap_or(UpdateState::Refused(UpdateRefusal::Flash)) }
    }

    fn step(&mut self) -> Step {
        let failed = |order| Step::Report(UpdateReport { order, state: UpdateState::Refused(UpdateRefusal::Flash) });
        match self.check() {
            Ok(step) => step,
            Err(_) => {
                self.state = State::Idle;
                self.page.map_or(Step::Idle, |page| failed(page.order))
            }
        }
    }

    fn patience(&self) -> Option<Duration> {
        match (&self.state, &self.page) {
            (State::OnTrial, Some(page)) => Some(Duration::from_secs(u64::from(page.patience_s))),
            _ => None,
        }
    }

    fn acknowledged(&mut self) {
        if let (State::OnTrial, Some(page)) = (&self.state, &mut self.page) {
            // A word that cannot be written is tried again with the next acknowledgement.
            if page.note(&mut self.flash, Event::Confirmed).is_ok() {
                info!("the new program reached the host: it stays");
                self.state = State::Idle;
            }
        }
    }
}

/// Bytes where flash drivers take words.
#[repr(align(4))]
struct Aligned<const LENGTH: usize>([u8; LENGTH]);

fn checking() -> State {
    State::Checking(0, Sha256::new())
}
