//! The store: a folder of MCAP files that one logger writes, and its memory.
//!
//! Every file begins with what the host must remember of each board, and every group repeats it for the boards it
//! touches. So the newest readable file is all the memory there is, and it can never disagree with the data.

mod chunk;
mod file;
mod mcap;
pub mod medium;
mod scan;
mod summary;
mod topic;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

pub use file::{Attachment, LogFile, finish_in_place};
use scan::scan_part;
pub use scan::{Logged, Scan, scan, scan_stepwise};
pub use topic::Topic;

use medium::{Disk, RealDisk};
use serde::{Deserialize, Serialize};

use super::civil;
use super::group::{BoardState, Group, encode_group, encode_states, read_state};
use super::sink::{Sink, SinkError};

/// When a file is full and the next one begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rotation {
    /// At this many bytes.
    pub bytes: u64,
    /// At this age in seconds.
    pub seconds: u64,
}

impl Default for Rotation {
    /// 1 GiB or a day.
    fn default() -> Self {
        Self { bytes: 1 << 30, seconds: 86_400 }
    }
}

/// Why a folder cannot be used as a store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder or a file in it.
    #[error("{}: {error}", path.display())]
    Io {
        /// What could not be used.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// Another logger has it.
    #[error("{}: another `thermokin log` is writing to this store", path.display())]
    Locked {
        /// The store.
        path: PathBuf,
    },
    /// A file in it is not a log.
    #[error(transparent)]
    Foreign(#[from] crate::input::InputError),
}

/// The folder, locked, and the file that is being written.
#[derive(Debug)]
pub struct Store {
    disk: Box<dyn Disk>,
    folder: PathBuf,
    /// Held for as long as the store is.
    _lock: File,
    epoch: u32,
    number: u32,
    rotation: Rotation,
    attachments: Vec<Attachment>,
    states: BTreeMap<u32, BoardState>,
    file: Option<LogFile>,
    opened_us: u64,
    broken: bool,
    /// The file that was given up before the one that is yet to be begun.
    abandoned: Option<Abandoned>,
}

/// A file that was given up after an error. What was written to it last may come to be on the disk or not, and was stored
/// again elsewhere: so the next file says how much of this one counts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Abandoned {
    file: String,
    durable: u64,
}

impl Abandoned {
    fn new(file: &LogFile) -> Self {
        let name = file.path().file_name().map(|name| name.to_string_lossy().into_owned());
        Self { file: name.unwrap_or_default(), durable: file.durable() }
    }

    /// The file that a message tells of, and how many of its bytes count.
    fn of(logged: &Logged<'_>) -> Option<(String, u64)> {
        let told = (logged.topic == Some(Topic::Files)).then(|| serde_json::from_slice::<Self>(logged.data));
        told.and_then(Result::ok).map(|abandoned| (abandoned.file, abandoned.durable))
    }
}

/// A file that an earlier logger had left behind and that is finished now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finished {
    /// The file.
    pub path: PathBuf,
    /// How many torn bytes were cut; none of them was ever acknowledged.
    pub cut: u64,
}

impl Store {
    /// Opens a folder, made if need be: finishes the files that were left behind, remembers what they say, and begins a
    /// new file. `now_us` is the host's clock.
    pub fn open(
        folder: &Path,
        rotation: Rotation,
        attachments: Vec<Attachment>,
        now_us: u64,
    ) -> Result<(Self, Vec<Finished>), StoreError> {
        Self::open_on(Box::new(RealDisk), folder, rotation, attachments, now_us)
    }

    /// As [`Store::open`], with new files on a disk of the caller's.
    pub fn open_on(
        disk: Box<dyn Disk>,
        folder: &Path,
        rotation: Rotation,
        attachments: Vec<Attachment>,
        now_us: u64,
    ) -> Result<(Self, Vec<Finished>), StoreError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |error| StoreError::Io { path, error }
        };
        std::fs::create_dir_all(folder).map_err(failed(folder))?;
        let lock_path = folder.join("store.lock");
        let lock =
            File::options().create(true).truncate(false).write(true).open(&lock_path).map_err(failed(&lock_path))?;
        if lock.try_lock().is_err() {
            return Err(StoreError::Locked { path: folder.to_owned() });
        }
        let mut finished = Vec::new();
        let mut epoch = (now_us / 1_000_000) as u32;
        let mut states = BTreeMap::new();
        let mut remembered = false;
        let (mut skipped, mut counted) = (Vec::new(), HashMap::new());
        for path in files(folder).map_err(failed(folder))?.into_iter().rev() {
            if let Some(of_file) = epoch_of_name(&path) {
                epoch = epoch.max(of_file.saturating_add(1));
            }
            if remembered && is_finished(&path).map_err(failed(&path))? {
                skipped.push(path);
                continue;
            }
            if is_blank(&path).map_err(failed(&path))? {
                std::fs::remove_file(&path).map_err(failed(&path))?;
                continue;
            }
            for newer in skipped.drain(..) {
                scan(&newer, |logged| counted.extend(Abandoned::of(&logged)))?;
            }
            let (mut last, mut abandoned) = (BTreeMap::new(), None);
            let limit = path.file_name().and_then(|name| counted.get(name.to_string_lossy().as_ref()));
            let scan = scan_part(&path, limit.copied().unwrap_or(u64::MAX), |logged| {
                abandoned = Abandoned::of(&logged).or(abandoned.take());
                if let Some(state) = (logged.topic == Some(Topic::Delivery)).then(|| read_state(logged.data)).flatten()
                {
                    last.insert(state.board, state);
                }
            })?;
            counted.extend(abandoned);
            if !scan.finished {
                finish_in_place(&path, scan.valid, &scan.summary).map_err(failed(&path))?;
                finished.push(Finished { path: path.clone(), cut: scan.torn() });
            }
            // A file without groups knows nothing; its predecessor does.
            if !remembered && scan.summary.message_count() > 0 {
                states = last;
                remembered = true;
            }
        }
        let mut store = Self {
            disk,
            folder: folder.to_owned(),
            _lock: lock,
            epoch,
            number: 0,
            rotation,
            attachments,
            states,
            file: None,
            opened_us: now_us,
            broken: false,
            abandoned: None,
        };
        store.begin_file(now_us).map_err(failed(folder))?;
        Ok((store, finished))
    }

    /// The host's epoch: greater than at any start before, and durable as the name of the file begun.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// What the store remembers of each board.
    pub fn states(&self) -> &BTreeMap<u32, BoardState> {
        &self.states
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn begin_file(&mut self, now_us: u64) -> io::Result<()> {
        self.number += 1;
        let stamp = civil::compact_utc(now_us / 1_000_000);
        let name = format!("{stamp}-{:010}-{:04}.mcap", self.epoch, self.number);
        let mut file = LogFile::create(self.disk.as_mut(), &self.folder.join(name), &self.attachments, now_us * 1000)?;
        let begun = self
            .abandoned
            .iter()
            .try_for_each(|abandoned| {
                file.message(Topic::Files, 0, now_us * 1000, |out| {
                    serde_json::to_writer(out, abandoned).expect("a text and a number are JSON, and a Vec takes all");
                })
            })
            .and_then(|()| encode_states(self.states.values(), now_us, &mut file))
            .and_then(|()| file.commit());
        if let Err(error) = begun {
            let _ = self.disk.remove(file.path());
            return Err(error);
        }
        self.abandoned = None;
        self.file = Some(file);
        self.opened_us = now_us;
        self.broken = false;
        Ok(())
    }

    fn write(&mut self, group: &Group) -> io::Result<()> {
        let now_us = group.closed_us;
        let full = |file: &LogFile| file.durable() >= self.rotation.bytes;
        let old = now_us.saturating_sub(self.opened_us) >= self.rotation.seconds.saturating_mul(1_000_000);
        if self.file.as_ref().is_none_or(|file| self.broken || old || full(file)) {
            match self.file.take() {
                Some(file) if self.broken => self.abandoned = Some(Abandoned::new(&file)),
                Some(file) => file.finish()?,
                None => {}
            }
            self.begin_file(now_us)?;
        }
        let Some(file) = &mut self.file else {
            return Err(io::Error::other("no file is open"));
        };
        if let Err(error) = encode_group(group, file).and_then(|()| file.commit()) {
            // After a failed sync nobody knows what the kernel still holds: the next group goes to a new file. A full
            // disk is different: what was synced before stays good, and a new file would need room itself.
            let full = matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded);
            self.broken = file.roll_back().is_err() || !full;
            return Err(error);
        }
        self.states.extend(group.states.iter().map(|state| (state.board, state.clone())));
        Ok(())
    }
}

impl Sink for Store {
    fn take(&mut self, group: &Group) -> Result<(), SinkError> {
        let path = self.file.as_ref().map_or(self.folder.clone(), |file| file.path().to_owned());
        self.write(group).map_err(|error| SinkError { path, error })
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        match self.file.take() {
            Some(file) if !self.broken => {
                let path = file.path().to_owned();
                file.finish().map_err(|error| SinkError { path, error })
            }
            _ => Ok(()),
        }
    }
}

/// The log files of a store, oldest first; or the file itself if it is one.
pub fn files(path: &Path) -> io::Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files: Vec<PathBuf> = std::fs::read_dir(path)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<io::Result<Vec<_>>>()?
        .into_iter()
        .filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
        .collect();
    // The epoch grows with every start, whatever the clock said; names without one come first.
    files.sort_by_key(|path| (epoch_of_name(path), path.clone()));
    Ok(files)
}

/// The host's epoch in a file's name: `20261121T014400Z-1795139040-0001.mcap`.
pub fn epoch_of_name(path: &Path) -> Option<u32> {
    path.file_stem()?.to_str()?.split('-').nth(1)?.parse().ok()
}

/// Whether a file was never synced: a loss of power can leave a name without contents, or with zeros.
fn is_blank(path: &Path) -> io::Result<bool> {
    use std::io::Read;
    let mut start = Vec::new();
    File::open(path)?.take(8).read_to_end(&mut start)?;
    Ok(start.len() < 8 || start.iter().all(|&byte| byte == 0))
}

fn is_finished(path: &Path) -> io::Result<bool> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = File::open(path)?;
    let mut end = [0; 8];
    if file.metadata()?.len() < 16 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-8))?;
    file.read_exact(&mut end)?;
    Ok(end == mcap::MAGIC)
}
