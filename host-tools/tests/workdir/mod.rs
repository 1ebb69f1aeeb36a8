//! Fixtures of the command's tests: running `magpie`, a temporary folder, models fitted to the repository's data.

#![allow(dead_code)] // No test program needs all of it.

#[cfg(unix)]
pub mod running;
#[cfg(unix)]
pub mod served;
#[cfg(unix)]
pub mod tutorial;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use serde_json::Value;
use tempfile::TempDir;
use tests::data;

/// Arguments of a command: a line with words separated by spaces, or separate words.
pub trait Arguments {
    fn words(&self) -> Vec<&str>;
}

impl Arguments for str {
    fn words(&self) -> Vec<&str> {
        self.split_whitespace().collect()
    }
}

impl Arguments for String {
    fn words(&self) -> Vec<&str> {
        self.as_str().words()
    }
}

impl<T: AsRef<str>> Arguments for [T] {
    fn words(&self) -> Vec<&str> {
        self.iter().map(AsRef::as_ref).collect()
    }
}

impl<T: AsRef<str>, const N: usize> Arguments for [T; N] {
    fn words(&self) -> Vec<&str> {
        self.as_slice().words()
    }
}

impl<T: AsRef<str>> Arguments for Vec<T> {
    fn words(&self) -> Vec<&str> {
        self.as_slice().words()
    }
}

impl<A: Arguments + ?Sized> Arguments for &A {
    fn words(&self) -> Vec<&str> {
        (**self).words()
    }
}

/// Path or output as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Path of a campaign of `tests/data`.
pub fn campaign(name: &str) -> String {
    data(name).display().to_string()
}

/// Model without effects fitted to `clean`, `demo`, `friction` or `ripple`; fitted once in a test program. Do not
/// write to it.
pub fn fitted_model(name: &str) -> PathBuf {
    static FITTED: [OnceLock<PathBuf>; 4] = [const { OnceLock::new() }; 4];
    let fit = || {
        let program = std::process::id();
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("models");
        std::fs::create_dir_all(&folder).unwrap();
        let draft = folder.join(format!("{name}-{program}.toml"));
        let shown = draft.display().to_string();
        WorkDir::empty().stdout(&["fit", &campaign(name), "-o", &shown]);
        let model = folder.join(format!("{name}.toml"));
        std::fs::rename(draft, &model).unwrap();
        model
    };
    FITTED[place(name)].get_or_init(fit).clone()
}

fn place(name: &str) -> usize {
    ["clean", "demo", "friction", "ripple"].iter().position(|known| *known == name).unwrap()
}

/// What `magpie diagnose` states of one of these campaigns with [`fitted_model`]; diagnosed once in a test program.
pub fn diagnosis(name: &str) -> &'static Value {
    static DIAGNOSED: [OnceLock<Value>; 4] = [const { OnceLock::new() }; 4];
    let arguments = ["diagnose", "model.toml", &campaign(name), "--json"];
    DIAGNOSED[place(name)].get_or_init(|| WorkDir::with_model(name).json(&arguments))
}

/// Temporary folder in which commands run, deleted on drop.
pub struct WorkDir(pub TempDir);

impl WorkDir {
    /// Empty folder.
    pub fn empty() -> Self {
        Self(TempDir::new().unwrap())
    }

    /// Folder with `model.toml`, fitted to a campaign of `tests/data`.
    pub fn with_model(name: &str) -> Self {
        let dir = Self::empty();
        std::fs::copy(fitted_model(name), dir.path("model.toml")).unwrap();
        dir
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Text of a file in the folder.
    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// Runs a command, given without the program name.
    pub fn run(&self, arguments: &(impl Arguments + ?Sized)) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// A command in this folder, given without the program name.
    pub fn command(&self, arguments: &(impl Arguments + ?Sized)) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magpie"));
        command.args(arguments.words()).current_dir(self.0.path());
        command
    }

    /// Standard output of a command that must succeed.
    pub fn stdout(&self, arguments: &(impl Arguments + ?Sized)) -> Vec<u8> {
        let output = self.run(arguments);
        assert!(output.status.success(), "{:?}: {}", arguments.words(), text(&output.stderr));
        output.stdout
    }

    /// JSON output of a command that must succeed.
    pub fn json(&self, arguments: &(impl Arguments + ?Sized)) -> Value {
        serde_json::from_slice(&self.stdout(arguments)).expect("one JSON object on stdout")
    }

    /// Standard error of a command that must fail.
    pub fn failure(&self, arguments: &(impl Arguments + ?Sized)) -> String {
        let output = self.run(arguments);
        assert!(!output.status.success(), "{:?} succeeded", arguments.words());
        text(&output.stderr)
    }
}
