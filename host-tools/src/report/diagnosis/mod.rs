//! The sections of a [`Diagnosis`]: verdicts, the staircase, what was found, what stays open.
//!
//! - [`verdicts`]: the table, and what to type next.
//! - [`staircase`]: the error, step by step, over the floor.
//! - [`effect`]: a plot of what a step took away.
//! - [`found`]: each effect with its physics, its size and its plot.
//! - [`open`]: ties, what cannot be judged, what is unexplained.

pub mod effect;
pub mod found;
pub mod open;
pub mod staircase;
pub mod verdicts;

#[cfg(test)]
mod tests;

use super::Section;
use crate::diagnose::Diagnosis;

/// The sections, in the order in which a person reads them; one without content is left out.
pub fn sections(diagnosis: &Diagnosis) -> Vec<Section> {
    let mut sections = vec![verdicts::section(diagnosis)];
    if diagnosis.staircase.is_empty() {
        return sections;
    }
    sections.push(staircase::section(diagnosis));
    sections.extend(found::section(diagnosis));
    sections.extend(open::section(diagnosis));
    sections
}
