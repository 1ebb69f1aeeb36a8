//! An emulator of the gripper's microcontroller, an STM32G474: runs the firmware's unmodified ELF on a computer.
//!
//! - [`core`]: the Cortex-M4F core, with its interrupt controller and its model of execution times.
//! - [`peripherals`]: clocks, timers, DMA, buses, converter, flash.
//! - [`soc`]: memories, address map, and how peripherals are connected to each other and to the board.
//! - [`wiring`]: what is at which pin of the circuit board.
//! - [`devices`]: traits of what is connected: sensors, buses, drivetrain. The emulator contains none of them.
//! - [`image`], [`log`]: the ELF file and its log.
//! - [`chip`]: all of it running: resets, loss of the supply, load.
//! - [`violations`]: accesses that indicate a firmware bug.
//! - [`registers`]: names, addresses and numbers from `stm32-metapac`, compared with ST's header.
//!
//! # Time
//!
//! Instructions take cycles by one of three models ([`core::CycleModel`]): the shortest times of ARM's manual with all
//! accesses to flash served by its caches, the longest with none of them, and one between. Peripherals take the times of
//! the reference manual. A sound program behaves alike with all three.
//!
//! # What it does not show
//!
//! The models were written from manuals and drivers; nothing was compared with a chip. A misunderstanding that driver and
//! model share goes unnoticed. Contention on the chip's buses, the flash caches' contents, analogue behaviour, edges on
//! lines, errata but those of the README, the shape of a falling supply, parity errors of SRAM and electromagnetic interference are not emulated.

pub mod chip;
pub mod core;
pub mod devices;
pub mod image;
pub mod log;
mod mpu;
pub mod peripherals;
pub mod registers;
pub mod soc;
pub mod time;
pub mod violations;
pub mod wiring;

pub use chip::{Chip, Halt, Load, Profile, ResetRecord};
pub use core::CycleModel;
pub use devices::Devices;
pub use image::{Image, ImageError};
pub use log::LogLine;
pub use peripherals::clocks::ResetCause;
pub use soc::{Options, Soc, TEMPERATURE_CALIBRATION, UnseenFrames};
pub use time::{Frequency, Time};
pub use violations::{Kind, Violation};
pub use wiring::Wiring;
