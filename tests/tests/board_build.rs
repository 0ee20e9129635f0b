//! Which compiler `firmware/build-image` takes: rustup's where it has the target's standard library, Debian's otherwise.
//! No target can be added on a machine that reaches only registries of packages, so a compiler and a cargo that only say
//! what they are asked for stand in their place.

mod board_support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use board_support::{REPOSITORY, Workshop};

/// A folder with a `rustc` whose sysroot has the standard libraries of some targets, and a `cargo` that tells what it is
/// asked for.
fn toolchain(workshop: &Workshop, targets: &[&str]) -> PathBuf {
    let (folder, sysroot) = (workshop.file("bin"), workshop.file("sysroot"));
    fs::create_dir_all(&folder).unwrap();
    for target in targets {
        fs::create_dir_all(sysroot.join(format!("lib/rustlib/{target}/lib"))).unwrap();
    }
    let script = |name: &str, text: String| {
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(path, PermissionsExt::from_mode(0o755)).unwrap();
    };
    script("rustc", format!("[ \"$*\" = '--print sysroot' ] && echo {}", sysroot.display()));
    script("cargo", "echo cargo \"$@\"; env | grep -E '^(RUSTC|RUSTFLAGS|CARGO_TARGET)' | sort; pwd".to_owned());
    folder
}

fn build_image(tools: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(Path::new(REPOSITORY).join("firmware/build-image"));
    command.args(arguments).env_clear().env("PATH", format!("{}:/usr/bin:/bin", tools.display())).output().unwrap()
}

#[test]
fn rustups_toolchain_builds_where_it_has_the_target() {
    let workshop = Workshop::new("build_rustup", 1, 1000, 1, "live");
    let targets = ["thumbv7m-none-eabi", "riscv32imc-unknown-none-elf", "riscv32imac-unknown-none-elf"];
    let tools = toolchain(&workshop, &targets);
    for (board, target, package, more) in [
        ("emulated", targets[0], "emulated", ""),
        ("esp32c3", targets[1], "esp32c3", ""),
        ("esp32c6", targets[2], "esp32c3", " --no-default-features --features esp32c6"),
    ] {
        let output = build_image(&tools, &[board, "--locked"]);
        assert!(output.status.success(), "{output:?}");
        let said = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<_> = said.lines().collect();
        let folder = fs::canonicalize(Path::new(REPOSITORY).join("firmware")).unwrap();
        // No nightly feature, no other linker: in the environment is only what both toolchains are told.
        assert_eq!(
            lines,
            [
                format!("cargo build --release --target {target} --package thermokin-board-{package}{more} --locked")
                    .as_str(),
                "RUSTFLAGS= --cfg sha2_backend_soft=\"compact\"",
                folder.to_str().unwrap(),
                &format!("firmware/target/{target}/release/{package}"),
            ]
        );
    }
    let output = build_image(&tools, &["esp32c6", "check", "--locked"]);
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("cargo check --release "));
}

#[test]
fn without_the_target_debians_compiler_is_taken_or_asked_for() {
    let workshop = Workshop::new("build_debian", 1, 1000, 1, "live");
    let tools = toolchain(&workshop, &["x86_64-unknown-linux-gnu"]);
    if Path::new("/usr/bin/cargo").exists() {
        // This machine has it, and would build for minutes: its cargo is only asked for what it knows of the command.
        let output = build_image(&tools, &["emulated", "check", "--help"]);
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && !said.contains("cargo check --release"), "rustup's cargo was taken: {said}");
    } else {
        let output = build_image(&tools, &["emulated"]);
        let words = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(words.contains("rustup target add thumbv7m-none-eabi") && words.contains("apt-get install"), "{words}");
    }
}

#[test]
fn a_board_that_does_not_exist_is_one_clear_line() {
    let workshop = Workshop::new("build_unknown", 1, 1000, 1, "live");
    let output = build_image(&toolchain(&workshop, &[]), &["esp32"]);
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && words.lines().count() == 1, "{words}");
}
