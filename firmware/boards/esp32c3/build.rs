//! Links with the HAL's own memory map, which `linkall.x` brings along; no other map may lie where the linker searches.

use std::env;
use std::path::PathBuf;

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo::rustc-link-arg-bins=-Tlinkall.x");
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    println!("cargo::rustc-link-arg-bins=-Map={}", out.join("esp32c3.map").display());
    println!("cargo::rerun-if-changed=build.rs");
}
