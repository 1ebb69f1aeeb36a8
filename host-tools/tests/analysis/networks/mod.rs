//! Networks: `magpie train`, and networks in `replay` and `export`.

mod device;
mod train;
