//! Networks: `magpie train`, `benchmark`, and networks in `replay` and `export`.

mod benchmark;
mod device;
mod train;
