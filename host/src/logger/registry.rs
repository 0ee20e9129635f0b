//! The registry of link boards: who they are, where they sit, and their keys. A TOML file of mode 0600.

use std::collections::HashSet;
use std::fs::{File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thermokin_protocol::{Key, MAX_SENSORS, PowerMode, Settings};

use crate::input::{InputError, line_of_offset};

/// The most boards of a registry: an MCAP file has 65,535 channels, of which a board takes two.
const MAX_BOARDS: usize = 32_000;

/// The boards that the host knows, and the settings that they shall have.
#[derive(Debug, Clone)]
pub struct Registry {
    /// The settings of all boards.
    pub settings: Settings,
    /// The boards, in the order of the file.
    pub boards: Vec<Board>,
}

/// One board and its place.
#[derive(Debug, Clone)]
pub struct Board {
    /// Its number, as in robot.toml.
    pub board: u32,
    /// The robot that it sits on.
    pub robot: String,
    /// The link that it is glued to.
    pub link: u32,
    /// The I2C addresses of its sensors.
    pub sensors: Vec<u8>,
    /// Its key.
    pub key: Key,
    /// The boot number that it begins with.
    pub first_boot: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegistryToml {
    format: u32,
    #[serde(default)]
    settings: SettingsToml,
    #[serde(default)]
    board: Vec<BoardToml>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SettingsToml {
    revision: u32,
    sampling_period_ms: u32,
    batch_length: u16,
    power: PowerToml,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum PowerToml {
    Live,
    Burst,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BoardToml {
    board: u32,
    robot: String,
    link: u32,
    sensors: Vec<u8>,
    key: String,
    first_boot: u32,
}

impl Default for SettingsToml {
    fn default() -> Self {
        Self { revision: 1, sampling_period_ms: 1000, batch_length: 1, power: PowerToml::Live }
    }
}

impl Default for Registry {
    fn default() -> Self {
        let settings = Settings { revision: 1, ..Settings::default() };
        Self { settings, boards: Vec::new() }
    }
}

impl Registry {
    /// Where the registry is unless an option says otherwise: `thermokin/boards.toml` in the user's configuration.
    pub fn default_path() -> PathBuf {
        let configuration = std::env::var_os("XDG_CONFIG_HOME")
            .map(PathBuf::from)
            .or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".config")));
        configuration.unwrap_or_default().join("thermokin").join("boards.toml")
    }

    /// Reads a registry.
    ///
    /// # Errors
    ///
    /// If it cannot be read, if others than its owner may read it, or if it is not a registry.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let failed = |error: io::Error| InputError::of_file(path, error.to_string());
        Self::parse(path, &read_secret(path, File::open(path).map_err(failed)?, "keys")?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let toml: RegistryToml = toml::from_str(text).map_err(|error| {
            // The error's own display quotes the line, which may hold a key.
            let message = error.message().to_owned();
            match error.span() {
                Some(span) => InputError::at_line(path, line_of_offset(text, span.start), message),
                None => InputError::of_file(path, message),
            }
        })?;
        if toml.format != 1 {
            return Err(InputError::of_file(path, format!("has format {}, expected 1", toml.format)));
        }
        if toml.board.len() > MAX_BOARDS {
            let message = format!("has {} boards, expected at most {MAX_BOARDS} for one logger", toml.board.len());
            return Err(InputError::of_file(path, message));
        }
        let (mut boards, mut numbers) = (Vec::new(), HashSet::new());
        for entry in toml.board {
            let wrong = |message: String| InputError::of_file(path, format!("board {}: {message}", entry.board));
            if !numbers.insert(entry.board) {
                return Err(wrong("stands twice, expected each board once".to_owned()));
            }
            if entry.sensors.len() > MAX_SENSORS {
                return Err(wrong(format!("has {} sensors, expected at most {MAX_SENSORS}", entry.sensors.len())));
            }
            let key = Key::from_hex(&entry.key).map_err(|error| wrong(error.to_string()))?;
            boards.push(Board {
                board: entry.board,
                robot: entry.robot.clone(),
                link: entry.link,
                sensors: entry.sensors.clone(),
                key,
                first_boot: entry.first_boot,
            });
        }
        let power = match toml.settings.power {
            PowerToml::Live => PowerMode::Live,
            PowerToml::Burst => PowerMode::Burst,
        };
        let settings = Settings {
            revision: toml.settings.revision,
            sampling_period_ms: toml.settings.sampling_period_ms.max(1),
            batch_length: toml.settings.batch_length.max(1),
            power,
        };
        Ok(Self { settings, boards })
    }

    /// Writes the registry with mode 0600, so that a reader sees the old file or the new one and nothing between.
    pub fn write(&self, path: &Path) -> Result<(), InputError> {
        let failed = |error: io::Error| InputError::of_file(path, error.to_string());
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        let toml = RegistryToml {
            format: 1,
            settings: SettingsToml {
                revision: self.settings.revision,
                sampling_period_ms: self.settings.sampling_period_ms,
                batch_length: self.settings.batch_length,
                power: match self.settings.power {
                    PowerMode::Live => PowerToml::Live,
                    PowerMode::Burst => PowerToml::Burst,
                },
            },
            board: self
                .boards
                .iter()
                .map(|board| BoardToml {
                    board: board.board,
                    robot: board.robot.clone(),
                    link: board.link,
                    sensors: board.sensors.clone(),
                    key: hex(&board.key),
                    first_boot: board.first_boot,
                })
                .collect(),
        };
        let text = toml::to_string(&toml).map_err(|error| InputError::of_file(path, error.to_string()))?;
        write_secret(path, text.as_bytes()).map_err(failed)
    }

    /// A board of the registry.
    pub fn board(&self, number: u32) -> Option<&Board> {
        self.boards.iter().find(|board| board.board == number)
    }
}

/// Reads the whole of an open file, which only its owner may be able to read; what it `holds` is said otherwise.
///
/// # Errors
///
/// If it cannot be read, or if others than its owner may read it.
pub fn read_secret(path: &Path, mut file: File, holds: &str) -> Result<String, InputError> {
    let failed = |error: io::Error| InputError::of_file(path, error.to_string());
    let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let message = format!("has mode {mode:03o} but holds {holds}: expected 600 (chmod 600 makes it so)");
        return Err(InputError::of_file(path, message));
    }
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(failed)?;
    Ok(text)
}

/// Writes a file that only its owner may read, in place of what was there.
pub fn write_secret(path: &Path, contents: &[u8]) -> io::Result<()> {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    let new = PathBuf::from(name);
    let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
    // The mode above is for a file that did not exist.
    file.set_permissions(Permissions::from_mode(0o600))?;
    file.write_all(contents)?;
    file.sync_all()?;
    std::fs::rename(&new, path)
}

/// A new key from the system's random source.
pub fn new_key() -> io::Result<Key> {
    let mut bytes = [0; 32];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(Key::from_bytes(bytes))
}

/// A key as 64 hexadecimal digits, for the two places that need it: the registry and a board's own configuration.
pub fn hex(key: &Key) -> String {
    key.expose().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registry() -> Registry {
        let key = Key::from_bytes(std::array::from_fn(|index| index as u8));
        let board =
            Board { board: 3, robot: "arm".into(), link: 2, sensors: vec![0x48, 0x49], key, first_boot: 1_700_000_000 };
        Registry { boards: vec![board], ..Registry::default() }
    }

    #[test]
    fn what_is_written_is_read_and_only_the_owner_may() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("boards.toml");
        registry().write(&path).expect("it is written");
        let mode = std::fs::metadata(&path).expect("it exists").permissions().mode() & 0o777;
        assert_eq!(mode, 0o600);
        let read = Registry::read(&path).expect("it is read");
        assert_eq!(read.boards[0].key, registry().boards[0].key);
        assert_eq!(read.settings, registry().settings);
        std::fs::set_permissions(&path, Permissions::from_mode(0o640)).expect("it is changed");
        let refused = Registry::read(&path).expect_err("others may read it").to_string();
        assert!(refused.contains("has mode 640 but holds keys"), "{refused}");
    }

    #[test]
    fn no_word_about_a_registry_holds_a_key() {
        let digits = hex(&registry().boards[0].key);
        assert!(!format!("{:?}", registry()).contains(&digits[..16]));
        let text = format!(
            "format = 1\n[[board]]\nboard = 3\nrobot = \"arm\"\nlink = \"two\"\nsensors = []\nkey = \"{digits}\"\nfirst_boot = 1\n"
        );
        let error = Registry::parse(Path::new("boards.toml"), &text).expect_err("link is no number").to_string();
        assert!(error.starts_with("boards.toml:5: ") && !error.contains(&digits[..16]), "{error}");
        let text = text.replace("\"two\"", "2").replace(&digits, &digits[1..]);
        let error = Registry::parse(Path::new("boards.toml"), &text).expect_err("a digit is missing").to_string();
        assert!(error.contains("expected a key of 64") && !error.contains(&digits[8..24]), "{error}");
    }
}
