//! Faults, thrown at the whole gripper in virtual time: where they arise, in every state, and what becomes of it.
//!
//! - [`row`]: the rows of the matrix of faults: what should be found and when; `inject`: how it is done.
//! - [`situation`]: what the gripper does as it happens.
//! - [`run`]: one fault in one situation.
//! - [`path`](mod@path): which states may follow which.
//! - [`campaign`]: all of them on all cores; [`quiet`]: hours without any.
//!
//! What only hardware or the image can show is not here and never counted: see [`row::ELSEWHERE`].

pub mod campaign;
mod inject;
pub mod path;
pub mod quiet;
pub mod row;
pub mod run;
pub mod situation;
