//! Setup errors, each injected into a copy of a clean campaign.

mod files;
mod with_model;

use analysis::data_quality::Finding;
use report::text::findings::message;
use tests::campaign_copy::CsvTable;
use tests::data;

/// All recordings of a campaign.
const ALL: [u32; 3] = [1, 2, 3];

/// The only one of these findings.
fn single(mut findings: Vec<Finding>) -> Finding {
    let kinds: Vec<_> = findings.iter().map(|f| (f.id, message(f))).collect();
    assert_eq!(findings.len(), 1, "{kinds:#?}");
    findings.remove(0)
}

fn assert_message(finding: &Finding, words: &[&str]) {
    let message = message(finding);
    for word in words {
        assert!(message.contains(word), "{message:?} should contain {word:?}");
    }
}

/// A table of the clean campaign.
fn clean(recording: u32, name: &str) -> CsvTable {
    let folder = data("clean").join(recording.to_string());
    CsvTable::read(&folder.join(format!("{name}.gz")))
}

/// Compares a column of two tables.
fn assert_equal_numbers(corrected: &CsvTable, clean: &CsvTable, column: &str, within: f64) {
    let pairs = corrected.numbers(column).into_iter().zip(clean.numbers(column));
    assert_eq!(corrected.rows.len(), clean.rows.len());
    for (a, b) in pairs {
        assert!((a - b).abs() <= within, "{column}: {a} and {b}");
    }
}
