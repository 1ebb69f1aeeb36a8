//! The whole control on a motor of a few lines.

mod bench;
mod commissioning;
mod guards;
mod loops;
