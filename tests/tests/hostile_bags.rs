//! Bags made by others to exhaust the reader. Skipped with a note if they are not available.

use std::ffi::OsString;
use std::path::Path;

use model_export::recordings::mcap::{Undecodable, read_topics};

fn names(folder: &Path) -> Vec<OsString> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    names
}

#[test]
fn hostile_bags_are_read_or_refused_with_a_sentence() {
    let Some(folder) = tests::case("hostile") else {
        return;
    };
    let before = names(&folder);
    for (name, refusal) in [
        ("array-of-empty.mcap", Some("a length in it is wrong")),
        ("attachment-2e60.mcap", None),
        ("mutual-recursion.mcap", Some("its type a/B contains itself")),
        ("schema-name-4GiB.mcap", Some("repair it with `mcap recover`")),
        ("wal-mode.db3", None),
    ] {
        let read = |undecodable| read_topics(&folder.join(name), |_| true, undecodable);
        let (import, guess) = (read(Undecodable::Refuse), read(Undecodable::Skip));
        match (import, refusal) {
            (Ok(read), None) => {
                assert!(read.topics.iter().all(|topic| topic.messages() > 0), "{name}")
            }
            (Err(error), Some(part)) => assert!(error.to_string().contains(part), "{error}"),
            (result, expected) => panic!("{name}: {result:?} where {expected:?} is expected"),
        }
        assert!(guess.is_ok() || refusal.is_some(), "{name}");
    }
    assert_eq!(names(&folder), before, "files next to the bags");
}
