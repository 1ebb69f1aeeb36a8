//! The firmware's image for the emulated chip, built with the compiler of this machine.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use sha2::{Digest, Sha256};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Builds an image with tables, without them with the committed ones, or takes the one of this name that was built from the
/// same sources; its path. Builds of one process wait for each other.
///
/// # Errors
/// This machine has no compiler for the chip, or the image does not build: what the tools print.
pub fn compile(name: &str, tables: Option<&Path>) -> Result<PathBuf, String> {
    static BUILDING: Mutex<()> = Mutex::new(());
    let _building = BUILDING.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = root().join("target/images");
    let (image, stamp) =
        (folder.join(format!("{name}.elf")), folder.join(format!("{name}.sha256")));
    let sources = sources(tables);
    if image.is_file() && std::fs::read_to_string(&stamp).is_ok_and(|known| known == sources) {
        return Ok(image);
    }
    std::fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
    let script = r#". .ci/target.sh; for_target image; cp "$folder/firmware" "$1""#;
    let mut command = Command::new("bash");
    command.args(["-euc", script, "image"]).arg(&image).current_dir(root());
    command.env_remove("MAGPIE_TABLES").envs(tables.map(|tables| ("MAGPIE_TABLES", tables)));
    // What cargo sets for the tests is not meant for another build.
    for (variable, _) in std::env::vars_os() {
        let is_of_cargo = variable.to_string_lossy().starts_with("CARGO_");
        if is_of_cargo && variable != "CARGO_HOME" {
            command.env_remove(variable);
        }
    }
    let output = command.output().map_err(|error| format!("bash: {error}"))?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        let last: Vec<_> = message.lines().rev().take(12).collect();
        return Err(last.into_iter().rev().collect::<Vec<_>>().join("\n"));
    }
    std::fs::write(stamp, sources).map_err(|error| error.to_string())?;
    Ok(image)
}

/// A digest of everything that an image is built from.
fn sources(tables: Option<&Path>) -> String {
    let mut files = Vec::new();
    collect(&root().join("firmware/src"), &mut files);
    for file in [
        "firmware/Cargo.toml",
        "firmware/build.rs",
        "Cargo.toml",
        "Cargo.lock",
        "memory.x",
        ".cargo/config.toml",
    ] {
        files.push(root().join(file));
    }
    files.extend(tables.map(Path::to_owned));
    files.sort();
    let mut digest = Sha256::new();
    for file in files {
        digest.update(std::fs::read(file).unwrap_or_default());
    }
    digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.path() {
            path if path.is_dir() => collect(&path, files),
            path => files.push(path),
        }
    }
}
