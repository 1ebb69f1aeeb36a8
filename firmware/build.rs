//! Chooses the tables: `MAGPIE_TABLES=PATH`, else those of the repository.

use std::env;
use std::path::{Path, PathBuf};

/// Where the self-test's kernels lie: the G474's memory beside the core as its system bus shows it. QEMU
/// has plain memory there, and none at the address that the core itself uses.
const KERNELS_EMULATED: &str = "0x20018000";

fn main() {
    if env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "none") {
        println!("cargo:rustc-link-arg-examples=--defsym=_kernels={KERNELS_EMULATED}");
    }
    println!("cargo:rerun-if-env-changed=MAGPIE_TABLES");
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    // The linker finds it by itself; nobody else would notice that it has changed.
    println!(
        "cargo:rerun-if-changed={}",
        root.join("../memory.x").display()
    );
    let own = root.join("src/model/tables.rs");
    let stated = env::var_os("MAGPIE_TABLES").filter(|path| !path.is_empty());
    let chosen = match stated {
        // Relative paths are the user's: they start where cargo was called, at the workspace's root.
        Some(path) => root.parent().unwrap_or(Path::new(".")).join(path),
        None => own,
    };
    assert!(
        chosen.is_file(),
        "MAGPIE_TABLES names no file: {} (write one with `cargo magpie export model.toml -o PATH`)",
        chosen.display()
    );
    let tables = std::fs::read_to_string(&chosen).unwrap_or_default();
    assert!(
        tables.starts_with("// Written by `magpie export`."),
        "{} is no file of tables: write one with `cargo magpie export model.toml -o PATH`",
        chosen.display()
    );
    println!("cargo:rerun-if-changed={}", chosen.display());
    println!("cargo:rustc-env=MAGPIE_TABLES_SOURCE={}", chosen.display());
}
