//! Sections of a [`Diagnosis`]: verdicts, error reduction, accepted effects, open questions.
//!
//! - [`verdicts`]: verdicts, accepted effects, open questions, suggested commands.
//! - [`staircase`]: held-out error after each step.
//! - [`effect`]: plots of an accepted effect.

pub mod effect;
pub mod staircase;
pub mod verdicts;

#[cfg(test)]
mod tests;

use crate::html::Section;
use analysis::diagnose::Diagnosis;

/// The sections, in the order in which a person reads them; one without content is left out.
pub fn sections(diagnosis: &Diagnosis) -> Vec<Section> {
    let mut sections = vec![verdicts::verdict_section(diagnosis)];
    if diagnosis.staircase.is_empty() {
        return sections;
    }
    sections.push(staircase::section(diagnosis));
    sections.extend(verdicts::found_section(diagnosis));
    sections.extend(verdicts::open_section(diagnosis));
    sections
}

/// The same after plots of the forces: first what was found, then the error step by step.
pub fn effects_first(diagnosis: &Diagnosis) -> Vec<Section> {
    let mut sections = sections(diagnosis);
    sections.sort_by_key(|section| match section.id {
        "found" => 0,
        "staircase" => 1,
        _ => 2,
    });
    sections
}
