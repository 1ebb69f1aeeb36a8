//! The reference board, a NUCLEO-G474RE. The paper's own board is not public: every pin here is assumed.
//!
//! | function | pins |
//! | --- | --- |
//! | Hall sensors 0 and 1 | I2C1: SCL PA15, SDA PB9 |
//! | Hall sensors 2 and 3 | I2C3: SCL PC8, SDA PC9 |
//! | CAN | FDCAN1: RX PA11, TX PA12, to a transceiver |
//! | serial line | USART2: TX PA2, RX PA3, to the debugger's virtual port |
//! | half bridges | TIM1: high sides PA8, PA9, PA10, low sides PB13, PB14, PB15; break PB12, active low |
//! | phase currents, bus voltage | ADC1: PC0, PC1, PC2; PC3 |
//! | thermistors of motor and power stage | ADC3: PB1, PB0 |
//! | rotor angle | SPI1: SCK PA5, MOSI PA7, MISO PA6, CS PA4 |
//! | button B1, high while pressed | PC13 |
//! | inertial sensor, optional | SPI3: SCK PC10, MOSI PC12, MISO PC11, CS PD2 |
//!
//! What the board must provide at these pins (assumed, as the pins):
//!
//! | pins | requirement |
//! | --- | --- |
//! | PC0 to PC3 | source impedance of at most 1 kOhm: they are sampled for 162 ns; amplifiers that settle within 1 us |
//! | PB0, PB1 | thermistors of 10 kOhm to ground, pull-ups of 10 kOhm to VREF+ |
//! | VREF+ | connected to 3.3 V: the chip's own reference buffer is off |
//! | PA8 to PA10, PB13 to PB15 | pull-downs at the gate drivers, for the time without a program |
//! | PB12 | pull-up of at most 4.7 kOhm to 3.3 V against the chip's pull-down of 25 to 55 kOhm, open drain outputs of the gate drivers |
//! | gate drivers | enabled and configured by the board: no pin and no SPI frame of this firmware does |
//! | PA11, PA12 | transceiver with STB low, 120 Ohm at both ends of the bus |
//! | PA15, PB9; PC8, PC9 | pull-ups of 1 kOhm to 3.3 V, at most 100 pF |
//! | PA5 | SCK of the rotor sensor is the LED LD2 of a Nucleo as well: disconnect it if the edges are slow |
//!
//! SCL of I2C1 is at PA15 because PB8 is also BOOT0: a pull-up there starts the boot loader at each reset of a chip with
//! its option bytes as shipped (RM0440 2.6.1).
//!
//! The sensor buses have pull-ups of 1 kOhm (assumed): 1 MHz requires rising edges within 120 ns.

#[cfg(target_os = "none")]
mod calibration_memory;
#[cfg(target_os = "none")]
pub mod can;
#[cfg(target_os = "none")]
pub mod clock;
#[cfg(target_os = "none")]
pub mod crash;
#[cfg(target_os = "none")]
pub mod drive;
#[cfg(target_os = "none")]
pub mod feedback;
#[cfg(target_os = "none")]
pub mod flash;
#[cfg(target_os = "none")]
pub mod i2c;
#[cfg(target_os = "none")]
pub mod imu;
#[cfg(target_os = "none")]
pub mod mem;
#[cfg(target_os = "none")]
pub mod peripherals;
#[cfg(target_os = "none")]
pub mod pwm;
#[cfg(target_os = "none")]
pub mod random;
#[cfg(target_os = "none")]
pub mod sync;
#[cfg(target_os = "none")]
pub mod tasks;
#[cfg(target_os = "none")]
pub mod thermometer;

/// The board as a type.
#[derive(Clone, Copy, Debug)]
pub struct NucleoG474;
