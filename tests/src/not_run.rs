//! Tests that this machine cannot run, told once at the end of `cargo test`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Lines of the tests that were not run: remedy, tabulator, name.
fn list() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/tests-not-run.txt")
}

/// Notes tests that are not run, and the remedy.
pub fn note<'n>(names: impl IntoIterator<Item = &'n str>, remedy: &str) {
    let lines: String =
        names.into_iter().map(|name| format!("{}\t{name}\n", remedy.replace('\n', " "))).collect();
    let file = OpenOptions::new().create(true).append(true).open(list());
    // In one write: other programs append to the same file.
    if let Err(error) = file.and_then(|mut file| file.write_all(lines.as_bytes())) {
        eprintln!("{}: {error}", list().display());
    }
}

/// One line for each remedy with the number of tests that it makes run, of all that were noted since the last call.
pub fn take() -> String {
    let noted = fs::read_to_string(list()).unwrap_or_default();
    let _ = fs::remove_file(list());
    summary(&noted)
}

fn summary(noted: &str) -> String {
    let mut of_remedy: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (remedy, name) in noted.lines().filter_map(|line| line.split_once('\t')) {
        of_remedy.entry(remedy).or_default().insert(name);
    }
    let line = |(remedy, names): (&&str, &BTreeSet<&str>)| {
        let tests = if names.len() == 1 { "test was" } else { "tests were" };
        format!("{} {tests} not run; {remedy}\n", names.len())
    };
    of_remedy.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_remedy_has_one_line_and_each_test_counts_once() {
        let noted = "need: x\ta\nneed: y\tb\nneed: x\tc\nneed: x\ta\n";
        assert_eq!(summary(noted), "2 tests were not run; need: x\n1 test was not run; need: y\n");
        assert_eq!(summary(""), "");
    }
}
