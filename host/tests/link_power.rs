//! Failing disks and losses of power: writes that stop half-way, syncs that fail, names that never became durable, blocks
//! that reach the disk in any order or not at all. What the store said to be durable is there exactly once, and what it
//! remembers of a board is what it has.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

use thermokin::logger::group::{BoardState, Entry, Group, SensorLabel};
use thermokin::logger::sink::Sink;
use thermokin::logger::store::medium::{Disk, DiskFile};
use thermokin::logger::store::{Attachment, Rotation, Store, Topic, files, scan};
use thermokin_protocol::{Reading, Record, SensorKind};

const START_US: u64 = 1_795_000_000_000_000;
const BOARDS: u32 = 4;
/// Blocks are written whole or not at all.
const BLOCK: usize = 4096;

/// SplitMix64.
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % limit
    }

    fn percent(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }
}

/// What happened to a file since it was last synced.
#[derive(Debug, Clone)]
enum Change {
    Write { at: usize, bytes: Vec<u8> },
    Cut { length: usize },
}

/// A file: what is on the platters, what may get there, and what a reader sees meanwhile.
#[derive(Debug, Clone, Default)]
struct Simulated {
    durable: Vec<u8>,
    changes: Vec<Change>,
    length: usize,
    position: usize,
    name_durable: bool,
}

/// A disk that fails now and then, in percent of the calls.
#[derive(Debug)]
struct Bench {
    files: BTreeMap<PathBuf, Simulated>,
    random: Random,
    failing: u64,
}

#[derive(Debug, Clone)]
struct SharedBench(Arc<Mutex<Bench>>);

impl SharedBench {
    fn lock(&self) -> MutexGuard<'_, Bench> {
        self.0.lock().expect("nobody panicked with it")
    }
}

impl Bench {
    fn fails(&mut self) -> Option<io::Error> {
        let failing = self.failing;
        self.random.percent(failing).then(|| match self.random.below(2) {
            0 => io::ErrorKind::StorageFull.into(),
            _ => io::Error::from_raw_os_error(5),
        })
    }

    /// The files as they may be after a loss of power, written to a real folder.
    fn lose_power(&self, random: &mut Random, folder: &Path) {
        for (path, file) in &self.files {
            if !file.name_durable && random.percent(50) {
                continue;
            }
            let mut bytes = file.durable.clone();
            for change in &file.changes {
                match change {
                    Change::Cut { length } if random.percent(50) => bytes.resize(*length, 0),
                    Change::Cut { .. } => {}
                    Change::Write { at, bytes: written } => {
                        let mut start = 0;
                        while start < written.len() {
                            // Up to the next border of a block of the file.
                            let end = written.len().min(start + BLOCK - (at + start) % BLOCK);
                            if random.percent(70) {
                                bytes.resize(bytes.len().max(at + end), 0);
                                bytes[at + start..at + end].copy_from_slice(&written[start..end]);
                            } else if random.percent(50) {
                                // The length reached the disk, the block did not.
                                bytes.resize(bytes.len().max(at + end), 0);
                            }
                            start = end;
                        }
                    }
                }
            }
            std::fs::write(folder.join(path.file_name().expect("it has a name")), bytes).expect("it is written");
        }
    }
}

impl Disk for SharedBench {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        let mut bench = self.lock();
        if let Some(error) = bench.fails() {
            return Err(error);
        }
        assert!(bench.files.insert(path.to_owned(), Simulated::default()).is_none(), "it exists");
        Ok(Box::new(BenchFile { bench: self.clone(), path: path.to_owned() }))
    }

    fn sync_name(&mut self, path: &Path) -> io::Result<()> {
        let mut bench = self.lock();
        if let Some(error) = bench.fails() {
            return Err(error);
        }
        bench.files.get_mut(path).expect("it exists").name_durable = true;
        Ok(())
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        let mut bench = self.lock();
        // That a name is gone is not durable: half of the removed come back.
        if bench.random.percent(50) {
            bench.files.remove(path);
        }
        Ok(())
    }
}

#[derive(Debug)]
struct BenchFile {
    bench: SharedBench,
    path: PathBuf,
}

impl DiskFile for BenchFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut bench = self.bench.lock();
        let error = bench.fails();
        let written = if error.is_some() { bench.random.below(bytes.len() as u64) as usize } else { bytes.len() };
        let file = bench.files.get_mut(&self.path).expect("it exists");
        let at = file.position;
        file.changes.push(Change::Write { at, bytes: bytes[..written].to_vec() });
        file.position += written;
        file.length = file.length.max(file.position);
        error.map_or(Ok(()), Err)
    }

    fn sync(&mut self) -> io::Result<()> {
        let mut bench = self.bench.lock();
        if let Some(error) = bench.fails() {
            // What was not written stays unwritten for ever: the kernel takes its pages for clean from now on. The changes
            // stay in the list of what may have come to the disk; a later sync that succeeds applies what follows them.
            return Err(error);
        }
        let mut random = bench.random.clone();
        let file = bench.files.get_mut(&self.path).expect("it exists");
        let length = file.length;
        for change in file.changes.drain(..) {
            if let Change::Write { at, bytes } = change {
                let end = at + bytes.len();
                file.durable.resize(file.durable.len().max(end), 0);
                file.durable[at..end].copy_from_slice(&bytes);
            }
        }
        file.durable.resize(length, 0);
        random.below(2);
        bench.random = random;
        Ok(())
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        let mut bench = self.bench.lock();
        if let Some(error) = bench.fails() {
            return Err(error);
        }
        let file = bench.files.get_mut(&self.path).expect("it exists");
        file.changes.push(Change::Cut { length: length as usize });
        (file.length, file.position) = (length as usize, length as usize);
        Ok(())
    }
}

/// The next records of every board: `bulk` bytes of datagram beside each, to fill several chunks.
fn group(from: u64, until: u64, bulk: usize, closed_us: u64) -> Group {
    let sensors: Arc<[SensorLabel]> = Arc::from([SensorLabel::new("J1".to_owned(), SensorKind::Max30205)]);
    let mut group = Group { entries: Vec::new(), states: Vec::new(), closed_us };
    for board in 0..BOARDS {
        let record = |sequence| Record {
            sequence,
            time_us: sequence * 1_000_000,
            readings: [Reading::Ok((board * 1000) as i16 + sequence as i16)].into_iter().collect(),
        };
        group.entries.push(Entry::Records {
            board,
            store: 7,
            boot: 7,
            fit: None,
            arrived_us: closed_us,
            sensors: Arc::clone(&sensors),
            records: (from..until).map(record).collect(),
        });
        let bytes = vec![board as u8 + 1; bulk].into();
        group.entries.push(Entry::Datagram { board, arrived_us: closed_us, bytes });
        let inbox = Some((7, until, Vec::new()));
        group.states.push(BoardState { board, guard: (7, until, 1), boot: 7, inbox });
    }
    group
}

/// The sequences of each board that a folder of logs holds, in the order of the files.
fn stored(folder: &Path) -> BTreeMap<u32, Vec<u64>> {
    let mut found: BTreeMap<u32, Vec<u64>> = BTreeMap::new();
    for file in files(folder).expect("the folder is read") {
        scan(&file, |logged| {
            if let Some(Topic::Readings(board)) = logged.topic {
                let json: serde_json::Value = serde_json::from_slice(logged.data).expect("JSON");
                found.entry(board).or_default().push(json["sequence"].as_u64().expect("a number"));
            }
        })
        .expect("it is a log");
    }
    found
}

fn open(disk: SharedBench, folder: &Path) -> io::Result<Store> {
    let attachment = Attachment { name: "robot.toml".into(), media_type: "text/plain".into(), data: vec![b'x'; 6000] };
    // Small enough that some runs rotate.
    let rotation = Rotation { bytes: 64 << 10, seconds: 86_400 };
    Store::open_on(Box::new(disk), folder, rotation, vec![attachment], START_US)
        .map(|(store, _)| store)
        .map_err(io::Error::other)
}

/// Groups are taken on a failing disk, then the power goes; returns whether a group failed, and how many files there were.
fn a_loss_of_power(seed: u64) -> (bool, usize) {
    let mut random = Random(seed);
    let failing = [0, 3, 10, 25][random.below(4) as usize];
    let bench =
        SharedBench(Arc::new(Mutex::new(Bench { files: BTreeMap::new(), random: Random(seed ^ 0xABCD), failing: 0 })));
    let empty = tempfile::tempdir().expect("a temporary folder");
    let mut store = open(bench.clone(), empty.path()).expect("a disk that works is no trouble");
    bench.lock().failing = failing;
    let (mut durable, mut failed) = (0, false);
    for round in 1..=2 + random.below(12) {
        // What failed comes again, together with what is new since.
        let until = durable + 1 + random.below(4);
        let bulk = if random.percent(15) { 1_500_000 } else { 100 };
        match store.take(&group(durable, until, bulk, START_US + round * 1_000_000)) {
            Ok(()) => durable = until,
            Err(_) => failed = true,
        }
    }
    // The last group may be on its way when the power goes.
    let mut on_its_way = durable;
    if random.percent(70) {
        on_its_way = durable + 3;
        bench.lock().failing = 60;
        if store.take(&group(durable, on_its_way, 1_500_000, START_US + 60_000_000)).is_ok() {
            durable = on_its_way;
        }
    }
    drop(store);
    for _ in 0..3 {
        let folder = tempfile::tempdir().expect("a temporary folder");
        bench.lock().lose_power(&mut random, folder.path());
        let store = Store::open(folder.path(), Rotation::default(), Vec::new(), START_US + 100_000_000)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"))
            .0;
        let found = stored(folder.path());
        for board in 0..BOARDS {
            let sequences = found.get(&board).cloned().unwrap_or_default();
            let count = sequences.len() as u64;
            let expected: Vec<u64> = (0..count).collect();
            assert_eq!(sequences, expected, "seed {seed}: board {board}, none twice and none missing");
            assert!(count >= durable, "seed {seed}: board {board} has {count} of {durable} durable records");
            assert!(count <= durable.max(on_its_way) + 4, "seed {seed}: board {board} has {count}");
            let remembered =
                store.states().get(&board).and_then(|state| state.inbox.as_ref()).map_or(0, |inbox| inbox.1);
            assert_eq!(remembered, count, "seed {seed}: board {board}, what is remembered is what is there");
        }
    }
    let files = bench.lock().files.len();
    (failed, files)
}

#[test]
fn what_was_durable_survives_failing_disks_and_losses_of_power_exactly_once() {
    let seeds = std::env::var("THERMOKIN_POWER_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(120);
    let (mut failures, mut rotations) = (0, 0);
    for seed in 0..seeds {
        let (failed, files) = a_loss_of_power(seed);
        failures += u64::from(failed);
        rotations += u64::from(files > 1);
    }
    println!("{seeds} seeds from 0 (THERMOKIN_POWER_SEEDS), {failures} with errors, {rotations} with several files");
    assert!(failures * 4 >= seeds && rotations * 4 >= seeds, "{failures} with errors, {rotations} with several files");
}
