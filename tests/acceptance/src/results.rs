//! The results file: one section per run between two markers, replaced in place.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use model_export::output::{check_output, write_output};

/// First line of a results file.
const SIGNATURE: &str = "# Acceptance results\n";

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Name of the run on the command line.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Seeds and number of campaigns, grippers or grasps.
    pub extent: String,
    pub conditions: String,
    /// Tables in Markdown.
    pub tables: String,
    /// Whether all requirements are met; `None` without a requirement.
    pub is_met: Option<bool>,
}

impl Section {
    /// Name in the markers: quick runs do not replace the table of the full run.
    pub fn marker(&self, quick: bool) -> String {
        if quick { format!("{}-quick", self.id) } else { self.id.to_owned() }
    }

    /// Text of the section.
    pub fn markdown(&self, command: &str) -> String {
        let verdict = match self.is_met {
            Some(true) => "all requirements met",
            Some(false) => "NOT all requirements met",
            None => "no requirement is specified",
        };
        format!(
            "## {}\n\n`{command}`, version {}: {}; {verdict}. {}\n\n{}",
            self.title,
            env!("CARGO_PKG_VERSION"),
            self.extent,
            self.conditions,
            self.tables
        )
    }
}

/// Checks before a long run that the results file can be written.
pub fn check(path: &Path) -> Result<()> {
    check_output(path, SIGNATURE)?;
    Ok(())
}

/// Replaces the section of this marker, or appends it; all other text is preserved. The file is replaced
/// atomically.
pub fn write(path: &Path, marker: &str, text: &str) -> Result<()> {
    let current = match std::fs::read_to_string(path) {
        Ok(current) => current,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    let updated = replace_section(&current, marker, text)
        .with_context(|| format!("{}: section {marker}", path.display()))?;
    Ok(write_output(path, updated.as_bytes(), SIGNATURE)?)
}

/// `current` with the section of this marker replaced or appended.
pub fn replace_section(current: &str, marker: &str, text: &str) -> Result<String> {
    let (begin, end) = (format!("<!-- begin {marker} -->\n"), format!("<!-- end {marker} -->\n"));
    let section = format!("{begin}{}\n{end}", text.trim_end());
    let current = if current.is_empty() { SIGNATURE } else { current };
    let Some(start) = current.find(&begin) else {
        ensure!(!current.contains(&end), "end marker without begin marker");
        return Ok(format!("{}\n\n{section}", current.trim_end()));
    };
    let length = current[start..].find(&end).context("begin marker without end marker")?;
    let rest = &current[start + length + end.len()..];
    Ok(format!("{}{section}{rest}", &current[..start]))
}

pub fn markdown_table<const N: usize>(
    header: [&str; N],
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let mut text = line(&header.map(str::to_owned)) + &line(&[(); N].map(|()| "---".to_owned()));
    for row in rows {
        text += &line(&row.map(|cell| cell.replace('|', "\\|")));
    }
    text
}

/// `seeds 1 to 20`, `seed 1`.
pub fn seeds_text(seeds: &std::ops::Range<u64>) -> String {
    match seeds.end - seeds.start {
        1 => format!("seed {}", seeds.start),
        _ => format!("seeds {} to {}", seeds.start, seeds.end - 1),
    }
}
