//! Parameters that a host may change; also the paths of constants and limits for hosts.

pub mod parameters;
pub mod schema;

pub use crate::{constants, limits};
