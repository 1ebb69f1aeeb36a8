//! Commands of `magpie`, each in a child process of this program.

use std::ffi::OsStr;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

/// First argument with which this program runs the command `magpie`.
pub const SUBCOMMAND: &str = "magpie";

/// Standard output of a command that must succeed.
pub fn run<A: AsRef<OsStr>>(arguments: &[A], threads: Option<usize>) -> Result<Vec<u8>> {
    let mut command = Command::new(std::env::current_exe()?);
    command.arg(SUBCOMMAND).args(arguments);
    if let Some(threads) = threads {
        command.env("RAYON_NUM_THREADS", threads.to_string());
    }
    let output = command.output().context("starting magpie")?;
    let words = arguments.iter().map(|argument| argument.as_ref().to_string_lossy());
    ensure!(
        output.status.success(),
        "magpie {}: {}",
        words.collect::<Vec<_>>().join(" "),
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(output.stdout)
}

/// JSON output of a command that must succeed; `--json` is appended.
pub fn json<A: AsRef<OsStr>>(arguments: &[A], threads: Option<usize>) -> Result<Value> {
    let mut arguments: Vec<&OsStr> = arguments.iter().map(AsRef::as_ref).collect();
    arguments.push("--json".as_ref());
    Ok(serde_json::from_slice(&run(&arguments, threads)?)?)
}
