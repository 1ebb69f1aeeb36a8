//! Runs the tests of the Python package with this build of its library, where `PYTHON` names an interpreter that has numpy, pandas,
//! matplotlib, pytest, and the reference implementations of bags (see `.ci/run`). With the argument `notebooks` it runs the notebooks,
//! which need the command and the image that other tests build.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::Path;
use std::process::Command;

/// Tests with a process of their own. Dask leaves threads and finalizers behind, in which a Ctrl-C of another test could end.
const FLEET: &str = "test_fleet.py";
const NOTEBOOKS: &str = "test_notebooks.py";

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
    let tests = package.join("tests");
    let run = |arguments: &[String]| {
        let status = Command::new(&python)
            .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
            .args(arguments)
            .current_dir(folder.path())
            .env("PYTHONPATH", folder.path())
            .status();
        assert!(status.unwrap().success(), "the tests of the Python package failed");
    };
    let path = |name: &str| tests.join(name).display().to_string();
    if std::env::args().any(|argument| argument == "notebooks") {
        run(&[path(NOTEBOOKS)]);
        return;
    }
    let others = [FLEET, NOTEBOOKS].map(|name| format!("--ignore={}", path(name)));
    run(&[vec![tests.display().to_string()], others.to_vec()].concat());
    run(&[path(FLEET)]);
}
