//! The sections of a grasp and of a landing.
//!
//! - [`course`]: force, width, current and state over time.
//! - [`ground`]: what the ground does and what is told of it.

pub mod course;
pub mod ground;

use super::Section;
use super::drive::assumed;
use crate::drive::gripped::Gripped;
use crate::drive::landing::Landed;

/// A grasp's heading.
pub fn title(gripped: &Gripped) -> String {
    format!(
        "magpie: a grasp of {} N with screw {:?}",
        gripped.own.asked.set_n, gripped.case.lead
    )
}

/// All sections of a grasp.
pub fn sections(gripped: &Gripped) -> Vec<Section> {
    vec![
        course::section(gripped),
        assumed::section(&gripped.assumed()),
    ]
}

/// A landing's heading.
pub fn landing_title(landed: &Landed) -> String {
    format!("magpie: a landing of {} N", landed.landing.peak_n)
}

/// All sections of a landing.
pub fn landing(landed: &Landed) -> Vec<Section> {
    vec![ground::section(landed), assumed::section(&landed.assumed())]
}
