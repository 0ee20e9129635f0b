//! Brings the repository's `memory.x` to this image's linker, and no other map.
//!
//! The linker searches its working directory first; cargo runs it in `firmware/`, which holds no `memory.x`, so the
//! copy in this package's output folder is the one that is found.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let map = PathBuf::from("../../../memory.x");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy(&map, out.join("memory.x")).expect("memory.x lies at the top of the repository");
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    println!("cargo::rustc-link-arg-bins=-Map={}", out.join("emulated.map").display());
    println!("cargo::rerun-if-changed={}", map.display());
    println!("cargo::rerun-if-changed=build.rs");
}
