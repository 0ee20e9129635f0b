//! The binary `thermokin`.
use std::process::ExitCode;

fn main() -> ExitCode {
    // A reader that stops listening (`| head`) ends the program as it ends any other, without a word.
    sigpipe::reset();
    thermokin::cli::main()
}
