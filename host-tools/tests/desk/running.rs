//! Commands that run while a test does something else.

#![allow(dead_code)] // No test needs all of it.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::desk::Desk;

/// A command that runs; it is killed where the test ends before it.
pub struct Running(pub Child);

impl Running {
    pub fn start(desk: &Desk, line: &str) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_magpie"))
            .args(line.split_whitespace())
            .current_dir(desk.0.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        Self(child.unwrap())
    }

    /// Objects that it prints, each on a line.
    pub fn objects(&mut self) -> impl Iterator<Item = Value> + use<> {
        let lines = BufReader::new(self.0.stdout.take().unwrap()).lines();
        lines.map(|line| serde_json::from_str(&line.unwrap()).unwrap())
    }

    /// Where others find the virtual board's line.
    pub fn line(&mut self) -> (PathBuf, BufReader<ChildStderr>) {
        let mut said = BufReader::new(self.0.stderr.take().unwrap());
        let mut first = String::new();
        said.read_line(&mut first).unwrap();
        let path = first.trim().rsplit(' ').next().unwrap();
        (PathBuf::from(path), said)
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).unwrap();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
