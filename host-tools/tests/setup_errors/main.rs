//! Setup errors, each injected into a copy of a clean campaign.

mod files;
mod with_model;
