//! Results as text, tables and JSON.

pub mod comparison;
pub mod design;
pub mod diagnosis;
#[cfg(test)]
pub mod diagnosis_fixture;
pub mod disturbance;
pub mod terminal;
