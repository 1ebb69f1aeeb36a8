//! Findings from the files of a campaign alone.

use std::path::Path;

use anyhow::Result;
use model_export::recordings::campaign::recording_folders;
use rayon::prelude::*;

use super::judge::{self, Desk};
use super::scan::RecordingScan;
use super::sort;
use crate::compare::Finding;

/// Reads every recording of the campaign in `folder` once and tells what is wrong with it, the gravest
/// first. What the strict reader refuses for other reasons (text in a number, a missing file) is
/// passed over: it says so itself. `read` is called once for each recording, from any thread.
///
/// # Errors
/// The folder holds no recordings.
pub fn scan(folder: &Path, read: impl Fn(&str) + Sync) -> Result<Vec<Finding>> {
    let folders = recording_folders(folder)?;
    let recordings: Vec<RecordingScan> = folders
        .par_iter()
        .map(|folder| {
            let scan = RecordingScan::read(folder, folders.len());
            read(&scan.name);
            scan
        })
        .collect();
    Ok(findings(&recordings))
}

/// Judges what was read.
fn findings(recordings: &[RecordingScan]) -> Vec<Finding> {
    let mut desk = Desk::new(recordings);
    judge::clock::judge(&mut desk);
    judge::units::judge(&mut desk);
    judge::stuck::judge(&mut desk);
    judge::saturated::judge(&mut desk);
    judge::gap::judge(&mut desk);
    judge::coarse::judge(&mut desk);
    judge::repeated::judge(&mut desk);
    judge::outlier::judge(&mut desk);
    judge::lines::judge(&mut desk);
    judge::constant::judge(&mut desk);
    let mut findings = desk.findings;
    sort(&mut findings);
    findings
}
