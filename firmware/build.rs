//! Selects the file of the model tables: `MAGPIE_TABLES=PATH`, else the one of the repository.

use std::env;
use std::path::{Path, PathBuf};

/// Address of the kernels in the self-test: CCM SRAM of the G474 as mapped on the system bus, where QEMU has memory. It has
/// none at the address of CCM SRAM itself.
const KERNELS_EMULATED: &str = "0x20018000";

fn main() {
    if env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "none") {
        link();
        println!("cargo:rustc-link-arg-examples=--defsym=_kernels={KERNELS_EMULATED}");
    }
    println!("cargo:rerun-if-env-changed=MAGPIE_TABLES");
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let own = root.join("src/model/tables.rs");
    let specified = env::var_os("MAGPIE_TABLES").filter(|path| !path.is_empty());
    let path = match specified {
        // Relative paths start at the root of the workspace, where cargo is called.
        Some(file) => root.parent().unwrap_or(Path::new(".")).join(file),
        None => own,
    };
    assert!(
        path.is_file(),
        "MAGPIE_TABLES: no such file: {} (write one with `cargo magpie dev export model.toml -o PATH`)",
        path.display()
    );
    let tables = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        tables.starts_with("// Written by `magpie dev export`."),
        "{} is not a file of tables: write one with `cargo magpie dev export model.toml -o PATH`",
        path.display()
    );
    println!("cargo:rerun-if-changed={}", path.display());
    println!("cargo:rustc-env=MAGPIE_TABLES_SOURCE={}", path.display());
}

/// Arguments of the linker, which finds `memory.x` wherever cargo is called from.
fn link() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../memory.x");
    let folder = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    let copied = std::fs::copy(&script, folder.join("memory.x"));
    assert!(copied.is_ok(), "{}: {copied:?}", script.display());
    // Cargo does not track the linker script.
    println!("cargo:rerun-if-changed={}", script.display());
    println!("cargo:rustc-link-search={}", folder.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg={argument}");
    }
}
