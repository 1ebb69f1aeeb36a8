//! A folder in which the tool runs.

#![allow(dead_code)] // No test needs all of it.

use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// The folder; it goes with the value.
pub struct Desk(pub TempDir);

impl Desk {
    /// With nothing on it.
    pub fn empty() -> Self {
        Self(TempDir::new().unwrap())
    }

    /// What a command prints that must succeed, its words given one by one.
    pub fn call(&self, words: &[&str]) -> Vec<u8> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magpie"));
        let output = command
            .args(words)
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {said}");
        output.stdout
    }

    /// What a command, given without the program's name, does here.
    pub fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_magpie"))
            .args(line.split_whitespace())
            .current_dir(self.0.path())
            .output()
            .unwrap()
    }

    /// What a command prints that must succeed.
    pub fn done(&self, line: &str) -> Vec<u8> {
        let output = self.run(line);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{line}: {said}");
        output.stdout
    }

    /// The JSON object that a command prints.
    pub fn told(&self, line: &str) -> Value {
        serde_json::from_slice(&self.done(line)).unwrap()
    }

    /// What a command says that must fail.
    pub fn refused(&self, line: &str) -> String {
        let output = self.run(line);
        assert!(!output.status.success(), "{line} was done");
        String::from_utf8_lossy(&output.stderr).into_owned()
    }
}
