//! Parts of documents that are generated from the program.

use std::path::Path;

/// Compares what is between two marks of a document of this repository with what it must be; with UPDATE_README, writes it.
pub fn assert_generated(document: &str, [begin, end]: [&str; 2], text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document);
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = page.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    let expected = format!("{before}{begin}{text}{end}{after}");
    if std::env::var_os("UPDATE_README").is_some() {
        std::fs::write(&path, &expected).unwrap();
        return;
    }
    assert!(
        page == expected,
        "{document}: run `UPDATE_README=1 cargo test -p host-tools --test commands`"
    );
}
