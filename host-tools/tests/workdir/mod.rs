//! Temporary folder in which a test runs the command.

#![allow(dead_code)] // No test needs all of it.

use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// Temporary folder, deleted on drop.
pub struct WorkDir(pub TempDir);

impl WorkDir {
    /// Empty folder.
    pub fn empty() -> Self {
        Self(TempDir::new().unwrap())
    }

    /// Standard output of a command that must succeed; arguments given separately.
    pub fn call(&self, words: &[&str]) -> Vec<u8> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magpie"));
        let output = command.args(words).current_dir(self.0.path()).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {message}");
        output.stdout
    }

    /// Runs a command, given without the program name.
    pub fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_magpie"))
            .args(line.split_whitespace())
            .current_dir(self.0.path())
            .output()
            .unwrap()
    }

    /// Standard output of a command that must succeed.
    pub fn stdout(&self, line: &str) -> Vec<u8> {
        let output = self.run(line);
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{line}: {message}");
        output.stdout
    }

    /// JSON output of a command.
    pub fn json(&self, line: &str) -> Value {
        serde_json::from_slice(&self.stdout(line)).unwrap()
    }

    /// Standard error of a command that must fail.
    pub fn failure(&self, line: &str) -> String {
        let output = self.run(line);
        assert!(!output.status.success(), "{line} succeeded");
        String::from_utf8_lossy(&output.stderr).into_owned()
    }
}
