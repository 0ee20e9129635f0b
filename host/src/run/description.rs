//! run.toml: which robot, which instrument, which reference; and the anchors of distance measurements.

use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::WriteError;
use crate::input::{InputError, line_of_offset};
use crate::table::is_usable_name;

/// The name of the file in its folder.
pub(super) const FILE: &str = "run.toml";

/// What run.toml says.
#[derive(Debug, Clone, PartialEq)]
pub struct RunDescription {
    /// The run's name.
    pub name: String,
    /// The robot description: the path in run.toml joined to the run's folder.
    pub robot: PathBuf,
    /// The cold reference: the cycle that temperatures and geometry are compared with.
    pub reference_cycle: u32,
    /// The sensor that reads the air of the cell.
    pub ambient: Option<String>,
    /// The instrument that measured the points.
    pub instrument: Instrument,
    /// The anchors that distances were measured from.
    pub anchors: Vec<Anchor>,
}

/// The instrument that measured the points, and its noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Instrument {
    /// What it is called.
    pub name: String,
    /// Where it stands, m, in the world frame.
    pub position: [f64; 3],
    /// 1-sigma of one coordinate, m: the constant part.
    pub sigma_m: f64,
    /// 1-sigma of one coordinate per metre of distance.
    pub sigma_per_m: f64,
    /// 1-sigma of an orientation about one axis, rad; absent: not stated.
    pub sigma_rad: Option<f64>,
}

/// A fixed place that distances are measured from, as a draw-wire sensor or a ball bar has.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// What distances.csv calls it.
    pub name: String,
    /// Where it is, m, in the world frame; absent: unknown, to be identified.
    pub position: Option<[f64; 3]>,
    /// 1-sigma of one distance, m.
    pub sigma_m: f64,
}

/// run.toml as it is written. Ranges are checked after reading, to say more than a type would.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct RunToml {
    format: Spanned<i64>,
    name: Spanned<String>,
    robot: Spanned<String>,
    reference_cycle: Spanned<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ambient: Option<Spanned<String>>,
    instrument: InstrumentToml,
    #[serde(default, rename = "anchor", skip_serializing_if = "Vec::is_empty")]
    anchors: Vec<AnchorToml>,
}

/// `[instrument]` as it is written.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct InstrumentToml {
    name: Spanned<String>,
    position: Spanned<[f64; 3]>,
    sigma_m: Spanned<f64>,
    sigma_per_m: Spanned<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_rad: Option<Spanned<f64>>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct AnchorToml {
    name: Spanned<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    position: Option<Spanned<[f64; 3]>>,
    sigma_m: Spanned<f64>,
}

/// run.toml, checked, and the line that later checks blame.
pub(super) struct Parsed {
    pub(super) description: RunDescription,
    pub(super) reference_cycle_line: usize,
}

/// Reads run.toml. `folder` resolves the robot's path.
pub(super) fn parse(folder: &Path, bytes: &[u8]) -> Result<Parsed, InputError> {
    let file = folder.join(FILE);
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        InputError::at_line(&file, line, "is not UTF-8 text; expected TOML in UTF-8")
    })?;
    let checker = Checker { file: &file, text };
    let raw: RunToml = toml::from_str(text).map_err(|error| InputError::of_toml(&file, text, &error))?;

    checker.require(&raw.format, |&format| format == 1, "format", "1, the only one there is")?;
    checker.name(&raw.name, "name")?;
    checker.name(&raw.robot, "robot")?;
    let reference_cycle = u32::try_from(*raw.reference_cycle.get_ref())
        .map_err(|_| checker.unexpected(&raw.reference_cycle, "reference_cycle", "a whole number from 0"))?;
    if let Some(ambient) = &raw.ambient {
        checker.name(ambient, "ambient")?;
    }
    let reference_cycle_line = line_of_offset(text, raw.reference_cycle.span().start);
    let description = RunDescription {
        name: raw.name.into_inner(),
        robot: folder.join(raw.robot.into_inner()),
        reference_cycle,
        ambient: raw.ambient.map(Spanned::into_inner),
        instrument: checker.instrument(raw.instrument)?,
        anchors: checker.anchors(raw.anchors)?,
    };
    Ok(Parsed { description, reference_cycle_line })
}

/// Checks the values of a TOML file and blames their lines.
pub(crate) struct Checker<'a> {
    /// The file, as errors name it.
    pub(crate) file: &'a Path,
    /// Its text.
    pub(crate) text: &'a str,
}

impl Checker<'_> {
    /// An `[instrument]`.
    pub(crate) fn instrument(&self, raw: InstrumentToml) -> Result<Instrument, InputError> {
        self.name(&raw.name, "the instrument's name")?;
        self.place(&raw.position)?;
        let not_negative = |sigma: &f64| sigma.is_finite() && *sigma >= 0.0;
        self.require(&raw.sigma_m, not_negative, "sigma_m", "metres, not negative")?;
        self.require(&raw.sigma_per_m, not_negative, "sigma_per_m", "metres per metre, not negative")?;
        if *raw.sigma_m.get_ref() == 0.0 && *raw.sigma_per_m.get_ref() == 0.0 {
            return Err(self.error(
                &raw.sigma_m,
                "sigma_m and sigma_per_m are both 0; expected the instrument's 1-sigma of one coordinate, by which points \
                 are weighted",
            ));
        }
        if let Some(sigma) = &raw.sigma_rad {
            self.require(sigma, |sigma| sigma.is_finite() && *sigma > 0.0, "sigma_rad", "radians above 0")?;
        }
        Ok(Instrument {
            name: raw.name.into_inner(),
            position: raw.position.into_inner(),
            sigma_m: raw.sigma_m.into_inner(),
            sigma_per_m: raw.sigma_per_m.into_inner(),
            sigma_rad: raw.sigma_rad.map(Spanned::into_inner),
        })
    }

    fn anchors(&self, raw: Vec<AnchorToml>) -> Result<Vec<Anchor>, InputError> {
        let mut anchors: Vec<Anchor> = Vec::with_capacity(raw.len());
        for anchor in raw {
            self.name(&anchor.name, "an anchor's name")?;
            if anchors.iter().any(|known| known.name == *anchor.name.get_ref()) {
                let message = format!("the anchor {:?} stands twice; expected each name once", anchor.name.get_ref());
                return Err(self.error(&anchor.name, message));
            }
            if let Some(position) = &anchor.position {
                self.place(position)?;
            }
            let above_zero = |sigma: &f64| sigma.is_finite() && *sigma > 0.0;
            self.require(&anchor.sigma_m, above_zero, "an anchor's sigma_m", "metres above 0")?;
            anchors.push(Anchor {
                name: anchor.name.into_inner(),
                position: anchor.position.map(Spanned::into_inner),
                sigma_m: anchor.sigma_m.into_inner(),
            });
        }
        Ok(anchors)
    }

    fn place(&self, position: &Spanned<[f64; 3]>) -> Result<(), InputError> {
        let finite = |position: &[f64; 3]| position.iter().all(|coordinate| coordinate.is_finite());
        self.require(position, finite, "position", "three finite numbers in metres")
    }

    /// Requires a name on one line.
    pub(crate) fn name(&self, name: &Spanned<String>, what: &str) -> Result<(), InputError> {
        self.require(name, |name| is_usable_name(name), what, "a name on one line without spaces around it")
    }

    /// Requires a value to be right; `expected` says what is.
    pub(crate) fn require<T: std::fmt::Debug>(
        &self,
        value: &Spanned<T>,
        is_right: impl Fn(&T) -> bool,
        what: &str,
        expected: &str,
    ) -> Result<(), InputError> {
        if is_right(value.get_ref()) { Ok(()) } else { Err(self.unexpected(value, what, expected)) }
    }

    /// What a value is, and what was expected.
    pub(crate) fn unexpected<T: std::fmt::Debug>(&self, value: &Spanned<T>, what: &str, expected: &str) -> InputError {
        self.error(value, format!("{what} is {:?}; expected {expected}", value.get_ref()))
    }

    /// An error at the line of a value.
    pub(crate) fn error<T>(&self, value: &Spanned<T>, message: impl Into<String>) -> InputError {
        InputError::at_line(self.file, line_of_offset(self.text, value.span().start), message)
    }
}

/// run.toml's bytes, for a run that is to lie in `folder`. `robot` is the robot's path as it is to stand there.
pub(super) fn format(description: &RunDescription, robot: &str, folder: &Path) -> Result<Vec<u8>, WriteError> {
    let plain = |text: &str| Spanned::new(0..0, text.to_owned());
    let number = |value: f64| Spanned::new(0..0, value);
    let instrument = &description.instrument;
    let raw = RunToml {
        format: Spanned::new(0..0, 1),
        name: plain(&description.name),
        robot: plain(robot),
        reference_cycle: Spanned::new(0..0, i64::from(description.reference_cycle)),
        ambient: description.ambient.as_deref().map(plain),
        instrument: InstrumentToml {
            name: plain(&instrument.name),
            position: Spanned::new(0..0, instrument.position),
            sigma_m: number(instrument.sigma_m),
            sigma_per_m: number(instrument.sigma_per_m),
            sigma_rad: instrument.sigma_rad.map(number),
        },
        anchors: description
            .anchors
            .iter()
            .map(|anchor| AnchorToml {
                name: plain(&anchor.name),
                position: anchor.position.map(|position| Spanned::new(0..0, position)),
                sigma_m: number(anchor.sigma_m),
            })
            .collect(),
    };
    toml::to_string(&raw)
        .map(String::into_bytes)
        .map_err(|error| WriteError::Content { file: folder.join(FILE), message: error.to_string() })
}

/// How a robot's path is to stand in the run.toml of `folder`: relative where there is a way from one to the other,
/// so that the folders can move together.
///
/// # Errors
/// A path that is not Unicode, which TOML cannot hold.
pub(super) fn robot_reference(robot: &Path, read_from: &Path, folder: &Path) -> Result<String, WriteError> {
    let path = relative_path(robot, read_from, folder);
    let parts: Option<Vec<&str>> = path.components().map(|part| part.as_os_str().to_str()).collect();
    match (parts, path.to_str()) {
        (Some(parts), Some(_)) if path.is_relative() => Ok(parts.join("/")),
        (_, Some(text)) => Ok(text.to_owned()),
        (_, None) => Err(WriteError::Content {
            file: folder.join(FILE),
            message: format!("the robot's path {} is not Unicode; expected one that TOML can hold", robot.display()),
        }),
    }
}

fn relative_path(robot: &Path, read_from: &Path, folder: &Path) -> PathBuf {
    if folder == read_from {
        match robot.strip_prefix(folder) {
            Ok(as_it_stood) => return as_it_stood.to_owned(),
            Err(_) if robot.is_absolute() => return robot.to_owned(),
            Err(_) => {}
        }
    }
    let stays_inside = |path: &&Path| path.components().all(|part| matches!(part, Component::Normal(_)));
    for base in [folder, read_from] {
        if let Some(inside) = robot.strip_prefix(base).ok().filter(stays_inside) {
            return inside.to_owned();
        }
    }
    // Links are resolved first: `..` after a link leads elsewhere than the path says.
    match (robot.canonicalize(), existing_ancestor(folder)) {
        (Ok(robot), Some(folder)) => between(&folder, &robot).unwrap_or(robot),
        _ => std::path::absolute(robot).unwrap_or_else(|_| robot.to_owned()),
    }
}

/// A folder's path with its links resolved, even where its last parts do not exist yet.
fn existing_ancestor(folder: &Path) -> Option<PathBuf> {
    let folder = std::path::absolute(folder).ok()?;
    folder.ancestors().find_map(|ancestor| {
        let rest = folder.strip_prefix(ancestor).ok()?;
        ancestor.canonicalize().ok().map(|ancestor| ancestor.join(rest))
    })
}

/// The way from a folder to a file; `None` where they share no root.
fn between(folder: &Path, file: &Path) -> Option<PathBuf> {
    let shared = folder.components().zip(file.components()).take_while(|(left, right)| left == right).count();
    if shared == 0 {
        return None;
    }
    let up = folder.components().skip(shared).map(|_| Component::ParentDir);
    Some(up.chain(file.components().skip(shared)).collect())
}
