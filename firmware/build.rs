//! Chooses the tables: `MAGPIE_TABLES=PATH`, else those of the repository.

use std::env;
use std::path::{Path, PathBuf};

fn main() {
    println!("cargo:rerun-if-env-changed=MAGPIE_TABLES");
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
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
