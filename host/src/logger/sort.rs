//! Rows of a table sorted by time in bounded memory: sorted parts go to a temporary file and are merged from there.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::sync::atomic::{self, AtomicU64};

/// A row as it is sorted: its time, its name's number and its value.
type Row = (f64, u32, f64);

/// The bytes of a row in the temporary file.
const ROW_BYTES: usize = 20;
/// What is read of each part at a time: its rows in multiples.
const READ_AHEAD: usize = 3000 * ROW_BYTES;

/// Rows, gathered to be sorted by time and name.
#[derive(Debug)]
pub(super) struct Rows {
    limit: usize,
    names: Vec<String>,
    numbers: BTreeMap<String, u32>,
    rows: Vec<Row>,
    /// The temporary file, and where each sorted part of it ends.
    spilled: Option<(File, Vec<u64>)>,
}

impl Rows {
    /// No rows; more than `limit` are not held in memory.
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, names: Vec::new(), numbers: BTreeMap::new(), rows: Vec::new(), spilled: None }
    }

    /// The names that rows have.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(String::as_str)
    }

    /// Adds a row.
    ///
    /// # Errors
    ///
    /// If the temporary file cannot be written.
    pub(super) fn push(&mut self, time_s: f64, name: &str, value: f64) -> io::Result<()> {
        let number = match self.numbers.get(name) {
            Some(&number) => number,
            None => {
                let number = self.names.len() as u32;
                self.names.push(name.to_owned());
                self.numbers.insert(name.to_owned(), number);
                number
            }
        };
        self.rows.push((time_s, number, value));
        if self.rows.len() >= self.limit { self.spill() } else { Ok(()) }
    }

    /// Calls `each` with the rows by time, and by name where times are equal.
    ///
    /// # Errors
    ///
    /// What `each` gave, or if the temporary file cannot be read back.
    pub(super) fn in_order(mut self, mut each: impl FnMut(f64, &str, f64) -> io::Result<()>) -> io::Result<()> {
        if self.spilled.is_some() && !self.rows.is_empty() {
            self.spill()?;
        }
        let Some((file, ends)) = self.spilled.take() else {
            sort(&mut self.rows, &self.names);
            return self
                .rows
                .iter()
                .try_for_each(|&(time_s, name, value)| each(time_s, &self.names[name as usize], value));
        };
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let mut parts: Vec<_> = starts
            .zip(&ends)
            .map(|(at, &end)| BufReader::with_capacity(READ_AHEAD, Part { file: &file, at, end }))
            .collect();
        let mut heads = BinaryHeap::new();
        for (part, reader) in parts.iter_mut().enumerate() {
            heads.extend(next_row(reader)?.map(|row| Head { row, part, names: &self.names }));
        }
        while let Some(Head { row: (time_s, name, value), part, .. }) = heads.pop() {
            each(time_s, &self.names[name as usize], value)?;
            heads.extend(next_row(&mut parts[part])?.map(|row| Head { row, part, names: &self.names }));
        }
        Ok(())
    }

    fn spill(&mut self) -> io::Result<()> {
        sort(&mut self.rows, &self.names);
        let (file, ends) = match &mut self.spilled {
            Some(spilled) => spilled,
            none => none.insert((temporary_file()?, Vec::new())),
        };
        let mut bytes = Vec::with_capacity(self.rows.len() * ROW_BYTES);
        for (time_s, name, value) in self.rows.drain(..) {
            bytes.extend_from_slice(&time_s.to_le_bytes());
            bytes.extend_from_slice(&name.to_le_bytes());
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        file.write_all(&bytes)?;
        ends.push(file.seek(SeekFrom::End(0))?);
        Ok(())
    }
}

/// A file without a name in the folder for temporary files, which is gone when it is closed.
fn temporary_file() -> io::Result<File> {
    // Several exports of one process may sort at a time.
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let name = format!("thermokin-{}-{}.rows", std::process::id(), NUMBER.fetch_add(1, atomic::Ordering::Relaxed));
    let path = std::env::temp_dir().join(name);
    let file = File::options().read(true).write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

fn order(a: &Row, b: &Row, names: &[String]) -> Ordering {
    a.0.total_cmp(&b.0).then_with(|| names[a.1 as usize].cmp(&names[b.1 as usize])).then_with(|| a.2.total_cmp(&b.2))
}

fn sort(rows: &mut [Row], names: &[String]) {
    rows.sort_unstable_by(|a, b| order(a, b, names));
}

/// A sorted part of the temporary file.
struct Part<'a> {
    file: &'a File,
    at: u64,
    end: u64,
}

impl Read for Part<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = buffer.len().min((self.end - self.at) as usize);
        let read = self.file.read_at(&mut buffer[..length], self.at)?;
        self.at += read as u64;
        Ok(read)
    }
}

fn next_row(part: &mut BufReader<Part<'_>>) -> io::Result<Option<Row>> {
    let mut bytes = [0; ROW_BYTES];
    if part.buffer().is_empty() && part.get_ref().at == part.get_ref().end {
        return Ok(None);
    }
    part.read_exact(&mut bytes)?;
    let [t0, t1, t2, t3, t4, t5, t6, t7, n0, n1, n2, n3, value @ ..] = bytes;
    let time_s = f64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
    Ok(Some((time_s, u32::from_le_bytes([n0, n1, n2, n3]), f64::from_le_bytes(value))))
}

/// The first row of a part that was not given out yet; the greatest in a heap is the earliest.
struct Head<'a> {
    row: Row,
    part: usize,
    names: &'a [String],
}

impl Ord for Head<'_> {
    fn cmp(&self, other: &Self) -> Ordering {
        order(&other.row, &self.row, self.names)
    }
}

impl PartialOrd for Head<'_> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Head<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Head<'_> {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows with times from a small generator, some equal, as they come out of a sort with a limit.
    fn sorted(limit: usize, count: u64) -> Vec<(f64, String, f64)> {
        let mut rows = Rows::new(limit);
        let mut random = 5_u64;
        for number in 0..count {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let name = ["L0S1", "AMB", "board3/0x48"][(random >> 40) as usize % 3];
            rows.push((random >> 33) as f64 % 400.0 - 100.0, name, number as f64).expect("there is room");
        }
        let mut out = Vec::new();
        rows.in_order(|time_s, name, value| {
            out.push((time_s, name.to_owned(), value));
            Ok(())
        })
        .expect("it is read back");
        out
    }

    #[test]
    fn parts_on_disk_come_out_as_rows_in_memory_do() {
        let whole = sorted(usize::MAX, 5000);
        assert_eq!(whole.len(), 5000);
        assert!(whole.windows(2).all(|pair| (pair[0].0, &pair[0].1) <= (pair[1].0, &pair[1].1)));
        for limit in [1, 7, 1000, 2500, 4999, 5000] {
            assert_eq!(sorted(limit, 5000), whole, "{limit} rows at a time");
        }
        assert_eq!(sorted(3, 0), []);
    }
}
