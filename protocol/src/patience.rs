//! How long a board waits for an acknowledgement before it sends again: learnt from the acknowledgements, as TCP does.
//!
//! RFC 6298: a smoothed latency and a smoothed deviation from it; the wait is the one plus four times the other. Each
//! resend doubles the wait, and only the latency of a record that was sent once (Karn's rule) ends the doubling: an
//! acknowledgement of what was sent twice does not say which of the two it is for. So a host that is slow, because ten
//! thousand boards write to one disk, is asked less often and not more often.

/// The wait before any latency is known.
const FIRST_US: u32 = 1_000_000;
/// No wait is shorter: a host gathers, writes and syncs before it answers, and a disk takes its time now and then.
const SHORTEST_US: u32 = 500_000;
/// No wait is longer.
const LONGEST_US: u32 = 60_000_000;
/// No wait of a board that is alone is longer, so that a host that comes back is found soon.
const LONGEST_ALONE_US: u32 = 8_000_000;
/// The resolution of the times of sending (see [`crate::Outbox`]), twice: the time is rounded up.
const GRAIN_US: u32 = 2048;
/// 2^7 times the shortest wait is longer than the longest.
const MOST_DOUBLINGS: u8 = 7;

/// The latency of acknowledgements as heard, and the wait that follows from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Patience {
    /// The smoothed latency and the smoothed deviation from it, in microseconds; none before the first.
    latency: Option<(u32, u32)>,
    doublings: u8,
}

impl Patience {
    /// Takes the latency of the acknowledgement of a record that was sent once.
    pub(crate) fn hear(&mut self, latency_us: u64) {
        let heard = u32::try_from(latency_us).unwrap_or(u32::MAX).min(LONGEST_US);
        self.latency = Some(match self.latency {
            None => (heard, heard / 2),
            Some((smoothed, deviation)) => ((7 * smoothed + heard) / 8, (3 * deviation + smoothed.abs_diff(heard)) / 4),
        });
        self.doublings = 0;
    }

    /// A wait was in vain: the next is twice as long.
    pub(crate) fn lose(&mut self) {
        self.doublings = (self.doublings + 1).min(MOST_DOUBLINGS);
    }

    /// A host is heard that was not heard for long: the waits in vain said nothing about its latency.
    pub(crate) fn find(&mut self) {
        self.doublings = 0;
    }

    /// The wait now, in microseconds.
    pub(crate) fn wait_us(&self) -> u64 {
        let base = self.latency.map_or(FIRST_US, |(smoothed, deviation)| smoothed + GRAIN_US.max(4 * deviation));
        (u64::from(base.max(SHORTEST_US)) << self.doublings).min(u64::from(LONGEST_US))
    }

    /// The wait between two probes of a board that hears nobody, in microseconds.
    pub(crate) fn wait_alone_us(&self) -> u64 {
        self.wait_us().min(u64::from(LONGEST_ALONE_US))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Whatever happens, the wait stays within its bounds, a resend never shortens it, and no sum overflows.
        #[test]
        fn the_wait_keeps_its_bounds(events in proptest::collection::vec(prop_oneof![
            any::<u64>().prop_map(Some), (0u64..100_000_000).prop_map(Some), Just(None)], 0..200)
        ) {
            let mut patience = Patience::default();
            for event in events {
                let before = patience.wait_us();
                match event {
                    Some(latency_us) => patience.hear(latency_us),
                    None => {
                        patience.lose();
                        prop_assert!(patience.wait_us() >= before);
                        prop_assert!(patience.wait_us() >= (2 * before).min(u64::from(LONGEST_US)) || before == patience.wait_us());
                    }
                }
                prop_assert!((u64::from(SHORTEST_US)..=u64::from(LONGEST_US)).contains(&patience.wait_us()));
                prop_assert!(patience.wait_alone_us() <= u64::from(LONGEST_ALONE_US));
            }
        }

        /// A latency that stays is waited for, whatever was heard before, and hardly longer.
        #[test]
        fn a_steady_latency_is_learnt(
            before in proptest::collection::vec(0u64..60_000_000, 0..20),
            latency_us in 0u64..50_000_000,
        ) {
            let mut patience = Patience::default();
            before.into_iter().for_each(|latency_us| patience.hear(latency_us));
            (0..100).for_each(|_| patience.hear(latency_us));
            let wait_us = patience.wait_us();
            prop_assert!(wait_us >= latency_us, "{wait_us}");
            prop_assert!(wait_us <= latency_us.max(u64::from(SHORTEST_US)) * 11 / 10 + 3000, "{wait_us}");
        }

        /// Latencies spread evenly between two bounds are waited for to the upper one, but for a few in a hundred: the
        /// deviation that is smoothed is itself a sample.
        #[test]
        fn a_spread_latency_is_waited_for(
            seed: u64, low_us in 100_000u64..5_000_000, width_us in 0u64..10_000_000,
        ) {
            let (mut patience, mut random, mut early) = (Patience::default(), seed, 0);
            for round in 0..1100 {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let latency_us = low_us + (random >> 33) % (width_us + 1);
                early += u32::from(round >= 100 && patience.wait_us() < latency_us);
                patience.hear(latency_us);
            }
            prop_assert!(early <= 50, "{early} of 1000 came after the wait");
        }
    }

    #[test]
    fn doubling_ends_with_what_was_sent_once() {
        let mut patience = Patience::default();
        assert_eq!(patience.wait_us(), 1_000_000);
        patience.lose();
        patience.lose();
        assert_eq!(patience.wait_us(), 4_000_000);
        patience.hear(2_000_000);
        // 2 s and four times half of it.
        assert_eq!(patience.wait_us(), 6_000_000);
        (0..10).for_each(|_| patience.lose());
        assert_eq!((patience.wait_us(), patience.wait_alone_us()), (60_000_000, 8_000_000));
        patience.find();
        assert_eq!(patience.wait_us(), 6_000_000);
    }
}
