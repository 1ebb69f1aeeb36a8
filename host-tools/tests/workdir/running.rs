//! Commands in the background.

#![allow(dead_code)] // No test needs all of it.

use std::io::{self, BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::workdir::WorkDir;

/// Background command, killed on drop.
pub struct Running(pub Child);

impl Running {
    pub fn start(dir: &WorkDir, line: &str) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_magpie"))
            .args(line.split_whitespace())
            .current_dir(dir.0.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        Self(child.unwrap())
    }

    /// JSON objects, one per line of output.
    pub fn objects(&mut self) -> impl Iterator<Item = Value> + use<> {
        let lines = BufReader::new(self.0.stdout.take().unwrap()).lines();
        lines.map(|line| serde_json::from_str(&line.unwrap()).unwrap())
    }

    /// Path of the virtual board's serial line.
    pub fn line(&mut self) -> (PathBuf, BufReader<ChildStderr>) {
        let mut message = BufReader::new(self.0.stderr.take().unwrap());
        let mut first = String::new();
        message.read_line(&mut first).unwrap();
        let path = first.trim().rsplit(' ').next().unwrap();
        (PathBuf::from(path), message)
    }

    /// Reads and drops the output that nothing else reads: a full pipe stops the command.
    pub fn drop_output(&mut self) {
        if let Some(mut output) = self.0.stdout.take() {
            thread::spawn(move || io::copy(&mut output, &mut io::sink()));
        }
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
