//! What the store asks of a disk, as a seam: the real one, and in tests one that fails and loses what was not synced.

use std::fmt::Debug;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

/// A disk on which log files are begun.
pub trait Disk: Send + Debug {
    /// Creates a file that must not exist yet.
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn DiskFile>>;

    /// Makes the name of a new file durable.
    fn sync_name(&mut self, path: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove(&mut self, path: &Path) -> io::Result<()>;
}

/// A file that is appended to.
pub trait DiskFile: Send + Debug {
    /// Appends some bytes; on an error part of them may stand there.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Makes durable everything that was appended; on an error nobody knows how much of it is.
    fn sync(&mut self) -> io::Result<()>;

    /// Cuts the file to a length, where the next append goes.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

/// The operating system's.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

impl Disk for RealDisk {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(OpenOptions::new().write(true).create_new(true).open(path)?))
    }

    fn sync_name(&mut self, path: &Path) -> io::Result<()> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        std::fs::remove_file(path)
    }
}

impl DiskFile for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(drop)
    }
}
