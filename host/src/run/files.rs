//! The files of a run folder as bytes: from the disk into a checked run, and from a run onto the disk, whole or not.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::{Run, description, distances, motion, points, poses, temperatures};
use crate::input::InputError;
use crate::table::WriteError;

/// The files of a run folder as bytes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RunFiles {
    /// run.toml.
    pub run: Vec<u8>,
    /// poses.csv.
    pub poses: Vec<u8>,
    /// points.csv; may be absent beside distances.csv.
    pub points: Option<Vec<u8>>,
    /// temperatures.csv; absent in a purely geometric run.
    pub temperatures: Option<Vec<u8>>,
    /// motion.csv.
    pub motion: Option<Vec<u8>>,
    /// distances.csv.
    pub distances: Option<Vec<u8>>,
    /// The robot description where it lies inside the folder and travels with it: its path there, and its bytes.
    pub robot: Option<(PathBuf, Vec<u8>)>,
}

impl RunFiles {
    /// Takes the files of a folder into memory, unchecked.
    ///
    /// # Errors
    /// A file that must be there and is not, or cannot be read.
    pub fn load(folder: &Path) -> Result<Self, InputError> {
        let optional = |name: &str| match fs::read(folder.join(name)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(InputError::of_file(&folder.join(name), format!("cannot be read: {error}"))),
        };
        let needed = |name: &str| {
            let missing = "is not there; expected a run folder with run.toml, poses.csv and points.csv";
            optional(name)?.ok_or_else(|| InputError::of_file(&folder.join(name), missing))
        };
        Ok(Self {
            run: needed(description::FILE)?,
            poses: needed(poses::FILE)?,
            points: optional(points::FILE)?,
            temperatures: optional(temperatures::FILE)?,
            motion: optional(motion::FILE)?,
            distances: optional(distances::FILE)?,
            robot: None,
        })
    }

    /// Reads and checks the files. `folder` names them in errors and resolves the robot's path; the disk is not asked.
    ///
    /// # Errors
    /// The first thing that makes the run unusable, with its file and line and what was expected.
    pub fn parse(&self, folder: &Path) -> Result<Run, InputError> {
        let mut notes = Vec::new();
        let parsed = description::parse(folder, &self.run)?;
        let description = parsed.description;
        let mut visits = poses::parse(&folder.join(poses::FILE), &self.poses, &mut notes)?;
        if !visits.visits.iter().any(|visit| visit.cycle == description.reference_cycle) {
            return Err(InputError::at_line(
                &folder.join(description::FILE),
                parsed.reference_cycle_line,
                format!(
                    "reference_cycle is {}, but poses.csv has no pose in that cycle; expected one of its cycles",
                    description.reference_cycle
                ),
            ));
        }

        let mut names = points::Names::default();
        if self.points.is_none() && self.distances.is_none() {
            return Err(InputError::of_file(
                &folder.join(points::FILE),
                "is not there; expected the measured points (or distances.csv)",
            ));
        }
        if let Some(bytes) = &self.points {
            points::parse(folder, bytes, &mut visits, &mut names, &mut notes)?;
        }
        if let Some(bytes) = &self.distances {
            distances::parse(folder, bytes, &description.anchors, &mut visits, &mut names, &mut notes)?;
        }
        let mut visits = visits.visits;
        for visit in &mut visits {
            visit.broken_beams.sort_by(|left, right| left.time_s.total_cmp(&right.time_s));
        }
        let unmeasured = visits.iter().filter(|visit| visit.points.is_empty() && visit.distances.is_empty()).count();
        if unmeasured > 0 {
            let poses = if unmeasured == 1 { "pose has" } else { "poses have" };
            notes.push(format!("{}: {unmeasured} {poses} no measurement", poses::FILE));
        }
        let target_names = points::order_names(&mut visits, names);

        let temperatures = match &self.temperatures {
            Some(bytes) => Some(temperatures::parse(folder, bytes, &mut notes)?),
            None => None,
        };
        if let (Some(ambient), Some(log)) = (&description.ambient, &temperatures)
            && log.index_of(ambient).is_none()
        {
            notes.push(format!("{}: the ambient sensor {ambient} has no reading in the log", temperatures::FILE));
        }
        let joints = visits.first().map_or(0, |visit| visit.joints.len());
        let motion = match &self.motion {
            Some(bytes) => motion::parse(folder, bytes, joints, &mut notes)?,
            None => Vec::new(),
        };
        Ok(Run { folder: folder.to_owned(), description, visits, target_names, temperatures, motion, notes })
    }

    /// The files of a run that is to lie in `folder`.
    ///
    /// # Errors
    /// A run that could not be read back, or a robot description that cannot be copied along.
    pub fn of(run: &Run, folder: &Path) -> Result<Self, WriteError> {
        check_joint_counts(run, folder)?;
        let robot = description::robot_reference(&run.description.robot, &run.folder, folder)?;
        let files = Self {
            run: description::format(&run.description, &robot, folder)?,
            poses: poses::format(run, folder)?,
            points: points::format(run, folder)?,
            temperatures: temperatures::format(run, folder)?,
            motion: motion::format(run, folder)?,
            distances: distances::format(run, folder)?,
            robot: robot_copy(run, folder, &robot)?,
        };
        // The reader is the one place that knows what a run must be.
        match files.parse(folder) {
            Ok(_) => Ok(files),
            Err(error) => Err(WriteError::Content { file: error.file, message: error.message }),
        }
    }

    /// Writes the files into a folder, which is created where it is missing; see [`super::write`].
    ///
    /// # Errors
    /// A disk that does not take them. Nothing half-written is left.
    pub fn store(&self, folder: &Path) -> Result<(), WriteError> {
        let disk = |file: &Path| {
            let file = file.to_owned();
            move |source| WriteError::Disk { file, source }
        };
        fs::create_dir_all(folder).map_err(disk(folder))?;
        let staging = folder.join(format!(".writing-{}", std::process::id()));
        let outcome = self.stage(&staging).and_then(|()| self.put_in_place(&staging, folder));
        let tidied = fs::remove_dir_all(&staging).map_err(disk(&staging));
        outcome.and(tidied)
    }

    /// The files but run.toml by their names; `None` for those that the run does not have.
    fn data_files(&self) -> [(&'static str, Option<&[u8]>); 5] {
        [
            (poses::FILE, Some(&self.poses)),
            (points::FILE, self.points.as_deref()),
            (temperatures::FILE, self.temperatures.as_deref()),
            (motion::FILE, self.motion.as_deref()),
            (distances::FILE, self.distances.as_deref()),
        ]
    }

    fn stage(&self, staging: &Path) -> Result<(), WriteError> {
        let write = |name: &Path, bytes: &[u8]| {
            let file = staging.join(name);
            let written = || -> io::Result<()> {
                fs::create_dir_all(file.parent().unwrap_or(staging))?;
                let mut output = fs::File::create(&file)?;
                output.write_all(bytes)?;
                output.sync_all()
            };
            written().map_err(|source| WriteError::Disk { file: file.clone(), source })
        };
        for (name, bytes) in self.data_files() {
            if let Some(bytes) = bytes {
                write(Path::new(name), bytes)?;
            }
        }
        if let Some((name, bytes)) = &self.robot {
            write(name, bytes)?;
        }
        write(Path::new(description::FILE), &self.run)
    }

    /// Moves the staged files into place. run.toml goes first and comes last: between, the folder is no run, so that
    /// old and new files are never taken for one.
    fn put_in_place(&self, staging: &Path, folder: &Path) -> Result<(), WriteError> {
        let place = |name: &Path| {
            let file = folder.join(name);
            let moved = || -> io::Result<()> {
                fs::create_dir_all(file.parent().unwrap_or(folder))?;
                fs::rename(staging.join(name), &file)
            };
            moved().map_err(|source| WriteError::Disk { file: file.clone(), source })
        };
        let remove = |name: &str| match fs::remove_file(folder.join(name)) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(WriteError::Disk { file: folder.join(name), source })
            }
            _ => Ok(()),
        };
        remove(description::FILE)?;
        for (name, bytes) in self.data_files() {
            match bytes {
                Some(_) => place(Path::new(name))?,
                None => remove(name)?,
            }
        }
        if let Some((name, _)) = &self.robot {
            place(name)?;
        }
        place(Path::new(description::FILE))
    }
}

/// The robot description to copy along: one inside the folder that the run was read from, unless the run stays there.
fn robot_copy(run: &Run, folder: &Path, reference: &str) -> Result<Option<(PathBuf, Vec<u8>)>, WriteError> {
    let robot = &run.description.robot;
    let inside = robot.strip_prefix(&run.folder).is_ok_and(|inside| inside == Path::new(reference));
    let stays = matches!((run.folder.canonicalize(), folder.canonicalize()), (Ok(from), Ok(to)) if from == to);
    if !inside || stays {
        return Ok(None);
    }
    match fs::read(robot) {
        Ok(bytes) => Ok(Some((PathBuf::from(reference), bytes))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(WriteError::Disk { file: robot.clone(), source }),
    }
}

/// Rows of unequal counts of joints could pass for rows of other columns.
fn check_joint_counts(run: &Run, folder: &Path) -> Result<(), WriteError> {
    let joints = run.joint_count();
    for visit in &run.visits {
        let commanded = visit.commanded.as_ref().map_or(joints, Vec::len);
        let approach = visit.approach.as_ref().map_or(joints, Vec::len);
        if [visit.joints.len(), commanded, approach] != [joints; 3] {
            return Err(WriteError::Content {
                file: folder.join(poses::FILE),
                message: format!(
                    "cycle {}, pose {} has another count of joints than the first visit; expected {joints}",
                    visit.cycle, visit.pose
                ),
            });
        }
    }
    Ok(())
}
