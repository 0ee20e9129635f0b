//! The binary `thermokin`.
use std::process::ExitCode;

fn main() -> ExitCode {
    thermokin::cli::main()
}
