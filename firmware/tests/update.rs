//! New programs over the air, with the power going at any step, datagrams lost, and programs that do not reach the host:
//! the slot that the bootloader starts always holds a whole program.

mod common;

use common::flash::Dark;
use ed25519_dalek::{Signer, SigningKey};
use proptest::prelude::*;
use sha2::{Digest, Sha256};
use thermokin_firmware::update::{Layout, Slot, Start, Step, TRIES, Updater, Updates, select, selected};
use thermokin_protocol::Firmware;
use thermokin_protocol::update::{
    CHUNK, Chunk, Manifest, Offer, Target, UpdateOrder, UpdateRefusal, UpdateReport, UpdateState,
};

const SECTOR: usize = 2 * CHUNK;
type Flash = common::flash::Flash<SECTOR>;

const LAYOUT: Layout = Layout {
    journal: 0,
    otadata: 2 * SECTOR as u32,
    slots: [4 * SECTOR as u32, 8 * SECTOR as u32],
    slot_length: 4 * SECTOR as u32,
};
const PATIENCE_S: u16 = 60;

fn signing_key() -> SigningKey {
    SigningKey::from_bytes(&[9; 32])
}

/// A program: bytes of its own, not a whole number of anything.
fn program(seed: u8, length: usize) -> Vec<u8> {
    (0..length).map(|index| seed.wrapping_add((index * 7 + index / 251) as u8)).collect()
}

fn earlier() -> Vec<u8> {
    program(1, 5000)
}

fn newer() -> Vec<u8> {
    program(2, 3 * SECTOR + 333)
}

fn offer_of(program: &[u8], order: u32) -> Offer {
    let manifest = Manifest {
        target: Target::Emulated,
        version: Firmware { major: 1, minor: 0, patch: 0 },
        length: program.len() as u32,
        digest: Sha256::digest(program).into(),
    };
    let signature = signing_key().sign(&manifest.signed_bytes()).to_bytes();
    let (first, second) = signature.split_at(32);
    let signature = [first.try_into().unwrap(), second.try_into().unwrap()];
    Offer { boot: 0, order, patience_s: PATIENCE_S, manifest, signature }
}

fn begin(flash: &Flash) -> Result<(Updater<Flash>, Start), Dark> {
    Updater::start(flash.clone(), LAYOUT, Target::Emulated, Some(signing_key().verifying_key().to_bytes()), None)
}

/// Flash with the earlier program in its first slot and, unless it is new, something in everything else.
fn flash(fill: u8) -> Flash {
    let flash = Flash::new(fill, 12 * SECTOR);
    flash.put(2 * SECTOR, &[0xFF; 2 * SECTOR]);
    flash.put(LAYOUT.slots[0] as usize, &earlier());
    flash
}

/// What the bootloader starts.
fn started(flash: &Flash) -> Vec<u8> {
    let slot = LAYOUT.slots[selected(&mut flash.clone(), LAYOUT.otadata).unwrap() as usize] as usize;
    flash.bytes()[slot..slot + LAYOUT.slot_length as usize].to_vec()
}

/// # Panics
///
/// When the bootloader would start something else than one of the two programs.
fn is_newer(flash: &Flash) -> bool {
    let started = started(flash);
    let newer = started.starts_with(&newer());
    assert!(newer || started.starts_with(&earlier()), "the bootloader starts something that is no whole program");
    newer
}

/// One boot of a board and its host's side of the update, until the board restarts, the power goes, or it is over.
#[derive(Debug, PartialEq, Eq)]
enum End {
    Restarted,
    Dark,
    Over(UpdateState),
}

/// How the world treats a boot.
struct World {
    /// Whether a program on trial reaches the host.
    reaches: bool,
    /// How many percent of datagrams are lost.
    loss: u64,
    random: u64,
}

impl World {
    fn kind() -> Self {
        Self { reaches: true, loss: 0, random: 0 }
    }

    fn loses(&mut self) -> bool {
        self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 33) % 100 < self.loss
    }

    fn boot(&mut self, flash: &Flash, program: &[u8], offer: &Offer) -> End {
        let Ok((mut updater, start)) = begin(flash) else {
            return End::Dark;
        };
        if start == Start::Restart {
            return End::Restarted;
        }
        if updater.patience().is_some() {
            if !self.reaches {
                return End::Restarted;
            }
            updater.acknowledged();
        }
        let mut order = UpdateOrder::Offer(*offer);
        for _ in 0..200 {
            // What is lost is followed by the next offer.
            let report = if self.loses() { None } else { Some(updater.order(&order)) };
            if flash.is_dark() {
                return End::Dark;
            }
            order = UpdateOrder::Offer(*offer);
            match report.filter(|_| !self.loses()) {
                None => {}
                Some(UpdateReport { state: UpdateState::Wants(offset), .. }) => {
                    let rest = &program[offset as usize..];
                    let bytes = &rest[..rest.len().min(CHUNK)];
                    order = UpdateOrder::Chunk(Chunk { boot: 0, order: offer.order, offset, bytes });
                }
                Some(UpdateReport { state, .. }) if state.is_final() => return End::Over(state),
                Some(_) => {}
            }
            let stepped = updater.step();
            if flash.is_dark() {
                return End::Dark;
            }
            match stepped {
                Step::Report(UpdateReport { state: UpdateState::Restarting, .. }) => return End::Restarted,
                Step::Report(UpdateReport { state, .. }) => return End::Over(state),
                Step::Idle | Step::More => {}
            }
        }
        panic!("the update does not come to an end");
    }

    /// Boots until it is over.
    fn run(&mut self, flash: &Flash, program: &[u8], offer: &Offer) -> UpdateState {
        for _ in 0..20 {
            match self.boot(flash, program, offer) {
                End::Restarted => drop(is_newer(flash)),
                End::Over(state) => return state,
                End::Dark => panic!("the power went"),
            }
        }
        panic!("it restarts for ever");
    }
}

#[test]
fn a_program_is_taken_tried_and_kept() {
    for fill in [0xFF, 0x00, 0x5A] {
        let flash = flash(fill);
        let offer = offer_of(&newer(), 7);
        assert_eq!(World::kind().run(&flash, &newer(), &offer), UpdateState::Installed);
        assert!(is_newer(&flash));
        // Offered again, under whatever number, it is installed and nothing is written.
        let before = flash.bytes();
        assert_eq!(World::kind().run(&flash, &newer(), &offer_of(&newer(), 8)), UpdateState::Installed);
        assert!(flash.bytes() == before);
        // And back, into the first slot.
        assert_eq!(World::kind().run(&flash, &earlier(), &offer_of(&earlier(), 9)), UpdateState::Installed);
        assert!(!is_newer(&flash));
    }
}

#[test]
fn a_program_that_does_not_reach_the_host_is_gone_back_from() {
    let flash = flash(0xFF);
    let offer = offer_of(&newer(), 7);
    let mut world = World { reaches: false, ..World::kind() };
    let mut trials = 0;
    assert_eq!(world.boot(&flash, &newer(), &offer), End::Restarted);
    while is_newer(&flash) {
        let (updater, start) = begin(&flash).unwrap();
        match start {
            Start::Run => {
                trials += 1;
                assert_eq!(updater.patience(), Some(embassy_time::Duration::from_secs(u64::from(PATIENCE_S))));
            }
            Start::Restart => assert!(!is_newer(&flash)),
        }
    }
    assert_eq!(trials, TRIES);
    assert_eq!(world.boot(&flash, &newer(), &offer), End::Over(UpdateState::RolledBack));
    // A new number is a new try.
    assert_eq!(World::kind().run(&flash, &newer(), &offer_of(&newer(), 8)), UpdateState::Installed);
    assert!(is_newer(&flash));
}

#[test]
fn a_program_that_the_bootloader_passes_by_is_given_up() {
    let flash = flash(0xFF);
    let offer = offer_of(&newer(), 7);
    assert_eq!(World::kind().boot(&flash, &newer(), &offer), End::Restarted);
    // The chip says that the earlier program runs all the same.
    let key = Some(signing_key().verifying_key().to_bytes());
    let (mut updater, start) = Updater::start(flash.clone(), LAYOUT, Target::Emulated, key, Some(Slot::A)).unwrap();
    assert_eq!((start, updater.patience()), (Start::Run, None));
    assert_eq!(updater.order(&UpdateOrder::Offer(offer)).state, UpdateState::RolledBack);
    assert!(!is_newer(&flash), "the bootloader is told to start what it starts");
}

#[test]
fn a_bootloader_that_takes_its_choice_back_is_told_three_times_only() {
    let flash = flash(0xFF);
    let offer = offer_of(&newer(), 7);
    for _ in 0..TRIES {
        assert_eq!(World::kind().boot(&flash, &newer(), &offer), End::Restarted);
        select(&mut flash.clone(), LAYOUT.otadata, Slot::A).unwrap();
    }
    assert_eq!(World::kind().boot(&flash, &newer(), &offer), End::Over(UpdateState::RolledBack));
}

#[test]
fn what_is_not_to_be_taken_is_refused_with_its_reason_and_nothing_is_written() {
    let flash = flash(0x5A);
    let before = flash.bytes();
    let (mut updater, _) = begin(&flash).unwrap();
    let genuine = offer_of(&newer(), 7);
    let refused = |updater: &mut Updater<Flash>, offer: Offer| updater.order(&UpdateOrder::Offer(offer)).state;
    for bit in 0..512 {
        let mut offer = genuine;
        offer.signature[bit / 256][bit % 256 / 8] ^= 1 << (bit % 8);
        assert_eq!(refused(&mut updater, offer), UpdateState::Refused(UpdateRefusal::BadSignature), "bit {bit}");
    }
    let mut other = genuine;
    other.manifest.version.patch += 1;
    assert_eq!(refused(&mut updater, other), UpdateState::Refused(UpdateRefusal::BadSignature));
    let mut other = genuine;
    other.manifest.digest[5] ^= 1;
    assert_eq!(refused(&mut updater, other), UpdateState::Refused(UpdateRefusal::BadSignature));
    let mut other = genuine;
    other.manifest.target = Target::Esp32c3;
    assert_eq!(refused(&mut updater, other), UpdateState::Refused(UpdateRefusal::OtherTarget));
    for length in [0, LAYOUT.slot_length + 1] {
        let mut other = genuine;
        other.manifest.length = length;
        assert_eq!(refused(&mut updater, other), UpdateState::Refused(UpdateRefusal::BadLength));
    }
    let (mut keyless, _) = Updater::start(flash.clone(), LAYOUT, Target::Emulated, None, None).unwrap();
    assert_eq!(refused(&mut keyless, genuine), UpdateState::Refused(UpdateRefusal::NoKey));
    assert!(flash.bytes() == before);
}

#[test]
fn a_program_on_trial_takes_no_other() {
    let flash = flash(0xFF);
    assert_eq!(World::kind().boot(&flash, &newer(), &offer_of(&newer(), 7)), End::Restarted);
    let (mut updater, _) = begin(&flash).unwrap();
    let other = UpdateOrder::Offer(offer_of(&earlier(), 8));
    assert_eq!(updater.order(&other).state, UpdateState::Refused(UpdateRefusal::OnTrial));
}

#[test]
fn what_is_not_what_was_signed_is_never_started() {
    let flash = flash(0xFF);
    let mut forged = newer();
    forged[2500] ^= 0x10;
    let state = World::kind().run(&flash, &forged, &offer_of(&newer(), 7));
    assert_eq!(state, UpdateState::Refused(UpdateRefusal::Damaged));
    assert!(!is_newer(&flash));
}

#[test]
fn chunks_that_were_not_asked_for_change_nothing() {
    let flash = flash(0xFF);
    let (mut updater, _) = begin(&flash).unwrap();
    let bytes = newer();
    let chunk = |order, offset: usize, length| {
        UpdateOrder::Chunk(Chunk { boot: 0, order, offset: offset as u32, bytes: &bytes[offset..offset + length] })
    };
    assert_eq!(updater.order(&chunk(7, 0, CHUNK)).state, UpdateState::Wants(0), "before any offer");
    updater.order(&UpdateOrder::Offer(offer_of(&bytes, 7)));
    assert_eq!(updater.order(&chunk(7, 0, CHUNK)).state, UpdateState::Wants(CHUNK as u32));
    let before = flash.bytes();
    for other in [chunk(7, 0, CHUNK), chunk(7, 2 * CHUNK, CHUNK), chunk(7, CHUNK, CHUNK - 4)] {
        assert_eq!(updater.order(&other).state, UpdateState::Wants(CHUNK as u32));
    }
    updater.order(&chunk(8, CHUNK, CHUNK));
    assert!(flash.bytes() == before);
}

/// The power goes once, in the midst of each single step of a whole update.
#[test]
fn a_loss_of_power_at_any_step_leaves_a_whole_program_and_the_update_goes_on() {
    let offer = offer_of(&newer(), 7);
    let whole = flash(0x5A);
    World::kind().run(&whole, &newer(), &offer);
    let steps = whole.steps();
    assert!(steps > newer().len());
    for cut in 1..=steps {
        let flash = flash(0x5A);
        flash.set_power(Some(cut), cut as u64);
        let mut boots = 0;
        let state = loop {
            boots += 1;
            assert!(boots < 10, "cut at step {cut}");
            match World::kind().boot(&flash, &newer(), &offer) {
                End::Dark => flash.set_power(None, 0),
                End::Restarted => {}
                End::Over(state) => break state,
            }
            is_newer(&flash);
        };
        assert_eq!(state, UpdateState::Installed, "cut at step {cut}");
        assert!(is_newer(&flash));
    }
    println!("{steps} steps, the power gone at each");
}

/// The same while a program that does not reach the host is gone back from.
#[test]
fn a_loss_of_power_at_any_step_of_going_back_leaves_a_whole_program() {
    let offer = offer_of(&newer(), 7);
    let taken = || {
        let flash = flash(0xFF);
        assert_eq!(World::kind().boot(&flash, &newer(), &offer), End::Restarted);
        flash
    };
    let mut cut = 0;
    loop {
        cut += 1;
        let flash = taken();
        flash.set_power(Some(cut), 77 * cut as u64);
        let (mut boots, mut was_cut) = (0, false);
        let state = loop {
            boots += 1;
            assert!(boots < 10, "cut at step {cut}");
            match (World { reaches: false, ..World::kind() }).boot(&flash, &newer(), &offer) {
                End::Dark => {
                    was_cut = true;
                    flash.set_power(None, 0);
                }
                End::Restarted => {}
                End::Over(state) => break state,
            }
            is_newer(&flash);
        };
        assert_eq!(state, UpdateState::RolledBack, "cut at step {cut}");
        assert!(!is_newer(&flash));
        if !was_cut {
            break;
        }
    }
    assert!(cut > 3 * 4, "only {cut} steps");
}

#[test]
fn a_transfer_goes_on_where_it_was() {
    let flash = flash(0xFF);
    let offer = offer_of(&newer(), 7);
    // A word for the sector behind its two chunks, and 64 bytes and one sector before them.
    flash.set_power(Some(1 + 64 + 1 + SECTOR + 4 + 10), 3);
    assert_eq!(World::kind().boot(&flash, &newer(), &offer), End::Dark);
    flash.set_power(None, 0);
    let (mut updater, _) = begin(&flash).unwrap();
    assert_eq!(updater.order(&UpdateOrder::Offer(offer)).state, UpdateState::Wants(SECTOR as u32));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// The power goes again and again, and datagrams are lost.
    #[test]
    fn whatever_comes_a_whole_program_is_started(
        cuts in proptest::collection::vec((1usize..4000, any::<u64>()), 0..12),
        loss in 0u64..50,
        random: u64,
        reaches in any::<bool>(),
    ) {
        let flash = flash(0x5A);
        let offer = offer_of(&newer(), 7);
        let mut world = World { reaches, loss, random };
        let mut cuts = cuts.into_iter();
        let mut boots = 0;
        let state = loop {
            boots += 1;
            prop_assert!(boots < 60);
            let (power, noise) = cuts.next().map_or((None, 0), |(steps, noise)| (Some(steps), noise));
            flash.set_power(power, noise);
            let end = world.boot(&flash, &newer(), &offer);
            is_newer(&flash);
            if let End::Over(state) = end {
                break state;
            }
        };
        // Each start on trial that the power ends is a start: after three of them the board goes back.
        prop_assert!(state == UpdateState::RolledBack || reaches && state == UpdateState::Installed, "{state:?}");
        prop_assert_eq!(is_newer(&flash), state == UpdateState::Installed);
    }
}
