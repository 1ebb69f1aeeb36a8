//! Runs the tests of the Python package with this build of its library, where `PYTHON` names an interpreter that has numpy, pandas,
//! matplotlib, pytest, and the reference implementations of bags (see `.ci/run`).

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

fn main() {
    let Some(python) = std::env::var_os("PYTHON") else {
        println!(
            "not tested: the Python package; set PYTHON to an interpreter with the packages that .ci/run installs"
        );
        return;
    };
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    // Cargo puts what it builds for this program next to it.
    let name = format!("{DLL_PREFIX}_magpie{DLL_SUFFIX}");
    let library = std::env::current_exe().unwrap().with_file_name(name);
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("magpie");
    std::fs::create_dir(&copy).unwrap();
    for entry in std::fs::read_dir(package.join("magpie")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "py") {
            std::fs::copy(&path, copy.join(path.file_name().unwrap())).unwrap();
        }
    }
    std::fs::copy(library, copy.join("_magpie.abi3.so")).unwrap();
    // Dask leaves threads and finalizers behind, in which a Ctrl-C of another test could end.
    let (tests, fleet) = (package.join("tests"), package.join("tests/test_fleet.py"));
    let mut others = OsString::from("--ignore=");
    others.push(&fleet);
    for arguments in [vec![tests.into_os_string(), others], vec![fleet.into_os_string()]] {
        let status = Command::new(&python)
            .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
            .args(arguments)
            .current_dir(folder.path())
            .env("PYTHONPATH", folder.path())
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .status();
        assert!(status.unwrap().success(), "the tests of the Python package failed");
    }
}
