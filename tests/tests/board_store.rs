//! How long a board outlives its host: the ESP32-C3's store of unacknowledged records, filled with what its sensors would
//! read, at one sample a second.

use thermokin_protocol::{Outbox, Reading};

/// The store of boards/esp32c3: the newest in full, the others in an archive of so many blocks.
const BLOCKS: usize = 736;
const IN_FULL: usize = 128;
type Store = Outbox<IN_FULL, 4, BLOCKS>;

/// The least that the store holds of readings with a part's own noise, before any is thinned out.
const LEAST_HOURS: f64 = 6.0;
const SEED: u64 = 0x7468_6B6E;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number from -most to most.
    fn within(&mut self, most: i64) -> i64 {
        (self.next() % (2 * most as u64 + 1)) as i64 - most
    }
}

/// Records of links that warm up by 20 K in two hours: counts with noise, times with jitter.
struct Sensors {
    random: Random,
    noise_counts: i64,
    jitter_us: i64,
    second: u64,
}

impl Sensors {
    fn next(&mut self) -> (u64, [i16; 4]) {
        self.second += 1;
        let warmth = 20.0 * 256.0 * (1.0 - (-(self.second as f64) / 3600.0).exp());
        let time_us = (self.second * 1_000_000) as i64 + self.jitter_us + self.random.within(self.jitter_us);
        let counts = std::array::from_fn(|sensor| {
            (22 * 256 + sensor as i64 * 100 + warmth as i64 + self.random.within(self.noise_counts)) as i16
        });
        (time_us as u64, counts)
    }
}

fn store() -> Box<Store> {
    Box::new(Store::new(1))
}

fn push(store: &mut Store, time_us: u64, counts: [i16; 4]) {
    store.push(1, time_us, counts.into_iter().map(Reading::Ok).collect());
}

/// Records held before the first is thinned out.
fn held_in_full(noise_counts: i64, jitter_us: i64) -> usize {
    let mut sensors = Sensors { random: Random(SEED), noise_counts, jitter_us, second: 0 };
    let mut store = store();
    while store.dropped() == 0 {
        let (time_us, counts) = sensors.next();
        push(&mut store, time_us, counts);
    }
    sensors.second as usize - 1
}

#[test]
fn the_blocks_are_those_of_the_board() {
    let board = include_str!("../../firmware/boards/esp32c3/src/main.rs");
    assert!(board.contains(&format!("const BLOCKS: usize = {BLOCKS};")));
    let library = include_str!("../../firmware/src/board.rs");
    assert!(library.contains(&format!("const IN_FULL: usize = {IN_FULL};")));
}

#[test]
fn the_store_holds_hours() {
    println!("seed {SEED:#x}; {} bytes of RAM", size_of::<Store>());
    // A MAX30205's noise is a count or two; a clock that is late by up to a millisecond. The others are worse than any.
    for (noise_counts, jitter_us, least) in
        [(2, 1000, LEAST_HOURS), (20, 5000, 0.9 * LEAST_HOURS), (500, 20_000, 0.5 * LEAST_HOURS)]
    {
        let held = held_in_full(noise_counts, jitter_us);
        let hours = held as f64 / 3600.0;
        println!("noise {noise_counts} counts, jitter {jitter_us} us: {held} records, {hours:.2} h");
        assert!(hours >= least, "{hours:.2} h, at least {least:.2}");
    }
}

#[test]
fn a_day_without_a_host_leaves_an_even_coarser_trace_and_every_record_is_counted() {
    println!("seed {SEED:#x}");
    let mut sensors = Sensors { random: Random(SEED), noise_counts: 2, jitter_us: 1000, second: 0 };
    let mut store = store();
    let taken = 24 * 3600;
    for _ in 0..taken {
        let (time_us, counts) = sensors.next();
        push(&mut store, time_us, counts);
    }
    assert_eq!(store.len() + store.dropped() as usize, taken);
    let sequences: Vec<u64> = store.sequences().collect();
    assert_eq!(sequences.len(), store.len());
    assert_eq!(*sequences.last().unwrap(), taken as u64 - 1);
    let gaps: Vec<u64> = sequences.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // The newest hour is whole, nothing of the day is coarser than a minute, and it gets coarser with age only: where two
    // thinnings meet single gaps are longer or shorter, so that is asked of the middle gap of each eighth.
    assert!(gaps[gaps.len() - 3600..].iter().all(|&gap| gap == 1));
    assert!(gaps.iter().all(|&gap| gap <= 60), "{:?}", gaps.iter().max());
    let middle = |gaps: &[u64]| {
        let mut gaps = gaps.to_vec();
        gaps.sort_unstable();
        gaps[gaps.len() / 2]
    };
    let parts: Vec<u64> = gaps.chunks(gaps.len() / 8).map(middle).collect();
    println!(
        "{} records left of {taken}; middle gaps of each eighth, oldest first: {parts:?} s, longest {:?} s",
        store.len(),
        gaps.iter().max()
    );
    assert!(parts.windows(2).all(|pair| pair[0] >= pair[1]), "{parts:?}");
    assert!(sequences[0] < 60, "the beginning is still there: {}", sequences[0]);
}
