//! `thermokin board flash`: firmware and configuration onto an ESP32-C3, by espflash.

use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Args;

use super::config::{PageArguments, configuration};
use super::execute;
use crate::cli::Failure;
use crate::input::InputError;
use crate::logger::registry::write_secret;

/// The layout of a board's flash; the firmware looks for its configuration where this says.
const PARTITIONS: &str = include_str!("../../../../firmware/boards/esp32c3/partitions.csv");
/// Where the layout has the configuration.
const CONFIGURATION: &str = "0x3fd000";

#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    page: PageArguments,
    /// The serial port that the board is on
    #[arg(long, value_name = "PORT")]
    port: String,
    /// The firmware's image, as firmware/build-image esp32c3 makes it
    #[arg(long, value_name = "FILE", default_value = "firmware/target/riscv32imc-unknown-none-elf/release/esp32c3")]
    image: PathBuf,
    /// The espflash to use
    #[arg(long, value_name = "PROGRAM", default_value = "espflash")]
    espflash: PathBuf,
}

/// Writes the configuration, then the firmware, which starts.
///
/// # Errors
/// Bad input, no espflash, or what espflash failed at.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let configuration = configuration(&arguments.page)?;
    if !arguments.image.exists() {
        let message = "is not there: firmware/build-image esp32c3 makes it".to_owned();
        return Err(InputError::of_file(&arguments.image, message).into());
    }
    let files = Files::new().map_err(|error| Failure::Work(format!("a folder for temporary files: {error}")))?;
    let (page, partitions) = (files.0.join("configuration"), files.0.join("partitions.csv"));
    let failed = |path: &Path, error: io::Error| Failure::Work(format!("{}: {error}", path.display()));
    write_secret(&page, &configuration.to_page()).map_err(|error| failed(&page, error))?;
    std::fs::write(&partitions, PARTITIONS).map_err(|error| failed(&partitions, error))?;
    let espflash = |action: &str| {
        let mut command = Command::new(&arguments.espflash);
        command.args([action, "--chip", "esp32c3", "--port", &arguments.port]);
        command
    };
    // First the configuration: firmware that starts without one can do nothing.
    execute(espflash("write-bin").arg(CONFIGURATION).arg(&page))?;
    let mut flash = espflash("flash");
    flash.args(["--flash-size", "4mb", "--target-app-partition", "ota_0", "--erase-parts", "otadata"]);
    execute(flash.arg("--partition-table").arg(&partitions).arg(&arguments.image))?;
    println!("board {} is flashed", configuration.board);
    Ok(())
}

/// A folder that is removed, with the key in it, however the command ends.
struct Files(PathBuf);

impl Files {
    fn new() -> io::Result<Self> {
        let folder = std::env::temp_dir().join(format!("thermokin-flash-{}", std::process::id()));
        std::fs::create_dir(&folder)?;
        Ok(Self(folder))
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            eprintln!("thermokin: {}: {error}; it holds the board's key", self.0.display());
        }
    }
}
