//! Results for people and programs. Nothing here computes a result.
//!
//! - [`text`]: terminal text, tables and JSON.
//! - [`html`]: pages with plots.

pub mod html;
pub mod text;
