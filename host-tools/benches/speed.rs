//! Speed next to other programs and growth of cost: `cargo bench --package host-tools --bench speed [-- --quick --only replay]`.
//!
//! Builds the command as it is shipped, installs the other programs in a virtual environment (`target/speed-python`) and starts
//! `speed/run.py`, which writes `tests/speed/RESULTS.md`.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// NumPy, SciPy, MagpyLib and PyTorch are what the commands are compared with; a fleet needs Dask, fsspec and pandas; the others
/// measure and draw.
const PACKAGES: [&str; 10] = [
    "dask==2026.8.0",
    "distributed==2026.8.0",
    "fsspec==2026.9.0",
    "magpylib==6.1.0",
    "matplotlib==3.11.2",
    "numpy==2.4.6",
    "pandas==3.1.1",
    "pyarrow==26.0.1",
    "scipy==1.17.1",
    "torch==2.15.0",
];

fn main() -> ExitCode {
    // `cargo test --benches` runs this too: there it only has to build.
    if !std::env::args().any(|argument| argument == "--bench") {
        return ExitCode::SUCCESS;
    }
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    match python(package) {
        Ok(python) => succeeded(
            Command::new(python)
                .arg(package.join("benches/speed/run.py"))
                .arg(env!("CARGO_BIN_EXE_magpie"))
                .args(std::env::args().skip(1)),
        ),
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// The interpreter of an environment with the packages, or that of the variable `PYTHON`.
fn python(package: &Path) -> Result<PathBuf, String> {
    if let Some(python) = std::env::var_os("PYTHON") {
        return Ok(python.into());
    }
    let environment = package.join("../target/speed-python");
    let python = environment.join("bin/python");
    if !python.exists() {
        eprintln!("installing {} in {}", PACKAGES.join(", "), environment.display());
        let mut create = Command::new("python3");
        let mut install = Command::new(environment.join("bin/pip"));
        for command in [
            create.args(["-m", "venv"]).arg(&environment),
            install.args(["install", "--quiet", "--disable-pip-version-check"]).args(PACKAGES),
        ] {
            let status = command.status().map_err(|error| format!("{command:?}: {error}"))?;
            if !status.success() {
                return Err(format!("{command:?} failed"));
            }
        }
    }
    Ok(python)
}

fn succeeded(command: &mut Command) -> ExitCode {
    match command.status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}
