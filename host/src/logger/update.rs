//! New programs for boards, on their way: what is offered to whom, and how far each board says it is.
//!
//! The board asks and the logger gives: an offer goes out again and again with what the board is heard to say, until the
//! board reports an end. Nothing is remembered over a restart of the logger; whoever asked for the update asks again, and
//! the board goes on where it was.

use std::collections::BTreeMap;
use std::sync::Arc;

use thermokin_protocol::update::{CHUNK, Chunk, Offer, UpdateOrder, UpdateReport, UpdateState};

use super::program::SignedProgram;

/// The least time between two offers to one board.
const OFFER_US: u64 = 1_000_000;

/// The updates that go on or have ended, one a board.
#[derive(Debug, Default)]
pub struct Updates {
    jobs: BTreeMap<u32, Job>,
}

/// A board's update.
#[derive(Debug)]
pub struct Job {
    program: Arc<SignedProgram>,
    /// The number of the offer.
    pub order: u32,
    patience_s: u16,
    /// How far the board says that it is; none before it said anything.
    pub state: Option<UpdateState>,
    offered_us: u64,
}

impl Job {
    /// How far it is, in words.
    pub fn words(&self) -> String {
        match self.state {
            None => "offered".to_owned(),
            Some(UpdateState::Wants(offset)) => {
                format!("receiving: {}%", u64::from(offset) * 100 / u64::from(self.program.manifest.length.max(1)))
            }
            Some(UpdateState::Checking) => "checking".to_owned(),
            Some(UpdateState::Restarting) => "restarting".to_owned(),
            Some(UpdateState::OnTrial) => "on trial".to_owned(),
            Some(UpdateState::Installed) => "installed".to_owned(),
            Some(UpdateState::RolledBack) => {
                "rolled back: the new program did not reach this host, the earlier one runs".to_owned()
            }
            Some(UpdateState::Refused(refusal)) => format!("refused: {refusal}"),
        }
    }

    /// Whether nothing more will come of it.
    pub fn is_over(&self) -> bool {
        self.state.is_some_and(UpdateState::is_final)
    }
}

impl Updates {
    /// Has a program offered to a board. The order that goes on already goes on.
    pub fn begin(&mut self, board: u32, order: u32, patience_s: u16, program: Arc<SignedProgram>) {
        if self.jobs.get(&board).is_none_or(|job| job.order != order) {
            self.jobs.insert(board, Job { program, order, patience_s, state: None, offered_us: 0 });
        }
    }

    /// A board's update.
    pub fn of(&self, board: u32) -> Option<&Job> {
        self.jobs.get(&board)
    }

    /// What to tell a board that was just heard in a boot: the offer, if it is due.
    pub fn offer(&mut self, board: u32, boot: u32, now_us: u64) -> Option<UpdateOrder<'static>> {
        let job = self.jobs.get_mut(&board).filter(|job| !job.is_over())?;
        if now_us.saturating_sub(job.offered_us) < OFFER_US {
            return None;
        }
        job.offered_us = now_us;
        let (first, second) = job.program.signature.split_at(32);
        let mut signature = [[0; 32]; 2];
        signature[0].copy_from_slice(first);
        signature[1].copy_from_slice(second);
        let Job { order, patience_s, .. } = *job;
        Some(UpdateOrder::Offer(Offer { boot, order, patience_s, manifest: job.program.manifest, signature }))
    }

    /// Takes what a board says, in a boot: the chunk that it wants, and words if it has come to an end.
    pub fn take(
        &mut self,
        board: u32,
        boot: u32,
        report: UpdateReport,
        now_us: u64,
    ) -> (Option<UpdateOrder<'_>>, Option<String>) {
        let Some(job) = self.jobs.get_mut(&board).filter(|job| job.order == report.order && !job.is_over()) else {
            return (None, None);
        };
        job.state = Some(report.state);
        // The transfer goes on without offers as long as nothing is lost.
        job.offered_us = now_us;
        let words = job.is_over().then(|| format!("board {board}: new program {}", job.words()));
        let chunk = match report.state {
            UpdateState::Wants(offset) => {
                job.program.image.get(offset as usize..).filter(|rest| !rest.is_empty()).map(|rest| {
                    let bytes = &rest[..rest.len().min(CHUNK)];
                    UpdateOrder::Chunk(Chunk { boot, order: job.order, offset, bytes })
                })
            }
            _ => None,
        };
        (chunk, words)
    }
}

#[cfg(test)]
mod tests {
    use ed25519_dalek::SigningKey;
    use thermokin_protocol::Firmware;
    use thermokin_protocol::update::{Target, UpdateRefusal};

    use super::*;

    fn updates() -> Updates {
        let version = Firmware { major: 0, minor: 1, patch: 0 };
        let program = SignedProgram::sign(vec![5; 2500], Target::Emulated, version, &SigningKey::from_bytes(&[1; 32]));
        let mut updates = Updates::default();
        updates.begin(3, 7, 60, Arc::new(program.expect("it is short")));
        updates
    }

    #[test]
    fn an_offer_goes_out_once_a_second_until_the_board_reports_an_end() {
        let mut updates = updates();
        assert_eq!(updates.offer(4, 1, 5_000_000), None, "another board");
        assert!(updates.offer(3, 1, 5_000_000).is_some());
        assert_eq!(updates.offer(3, 1, 5_900_000), None);
        assert!(updates.offer(3, 1, 6_000_000).is_some());
        let over = UpdateReport { order: 7, state: UpdateState::Refused(UpdateRefusal::NoKey) };
        let (chunk, words) = updates.take(3, 1, over, 6_000_000);
        assert!(chunk.is_none() && words.is_some_and(|words| words.contains("flash it once by cable")));
        assert_eq!(updates.offer(3, 1, 60_000_000), None);
    }

    #[test]
    fn a_board_gets_the_chunk_that_it_wants_and_nothing_beyond_the_end() {
        let mut updates = updates();
        let mut wants = |order, offset| {
            let report = UpdateReport { order, state: UpdateState::Wants(offset) };
            match updates.take(3, 9, report, 0).0 {
                Some(UpdateOrder::Chunk(Chunk { boot: 9, order: 7, offset, bytes })) => Some((offset, bytes.len())),
                other => {
                    assert_eq!(other, None);
                    None
                }
            }
        };
        assert_eq!(wants(7, 0), Some((0, CHUNK)));
        assert_eq!(wants(7, 2048), Some((2048, 452)));
        assert_eq!(wants(7, 2500), None);
        assert_eq!(wants(7, u32::MAX), None);
        assert_eq!(wants(6, 0), None, "an order that is not its own");
    }
}
