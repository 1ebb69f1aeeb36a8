//! Boards. Each is a folder that implements [`Bsp`] for its chip and spawns the tasks; [`selected`] is one of them.

pub mod i2c_timing;
/// The board that the firmware is built for: the path of its folder. Only one board is compiled, because each defines the
/// interrupts and the critical section.
#[path = "nucleo_g474/mod.rs"]
pub mod selected;

use embedded_hal::digital::InputPin;
use embedded_io_async::{Read, Write};
use embedded_storage_async::nor_flash::NorFlash;

pub use crate::motor::state::MotorPort;

use crate::clock::{Clock, Timed};
use crate::motor::{MotorStatus, Settings};
use crate::protocol::can::{CanReceiver, CanSender};
use crate::sensors::hall::SensorBus;
use crate::sensors::imu::Imu;
use crate::system::task_watchdog::TaskProgress;
use crate::tasks::Counts;
use crate::tasks::temperatures::BoardTemperatures;

/// What a board provides to the tasks.
pub trait Bsp: Sized {
    /// Identifier of the board in [`crate::protocol::messages::Version`].
    const HARDWARE: u8;
    /// Time since boot.
    type Clock: Clock;
    /// An I2C bus with two Hall sensors.
    type SensorBus: SensorBus;
    /// Inertial sensor.
    type Imu: Imu;
    /// Transmitting half of the CAN controller.
    type CanTx: CanSender;
    /// Receiving half of the CAN controller.
    type CanRx: CanReceiver;
    /// Transmitting half of the serial line.
    type SerialTx: Write;
    /// Receiving half of the serial line.
    type SerialRx: Read;
    /// Flash of parameters and calibrations.
    type Flash: NorFlash;
    /// Source of the challenges.
    type Rng;
    /// Button that a person presses to allow a new key; high while pressed.
    type Button: InputPin;
    /// Temperature sensors.
    type Thermometer: Thermometer;
    /// Power stage, current sensors and rotor sensor.
    type Drive: MotorDrive;
    /// Watchdog of the tasks.
    type Watchdog: Watchdog;

    /// Initialises clocks and buses. Must be called once, first.
    fn init() -> Peripherals<Self>;
}

/// Initialised peripherals of a board; motor and watchdog are not running yet.
pub struct Peripherals<B: Bsp> {
    /// Buses of sensors 0 and 1, and of sensors 2 and 3.
    pub sensor_buses: [B::SensorBus; 2],
    /// Inertial sensor; one that is not fitted does not answer.
    pub imu: B::Imu,
    /// Classic CAN at 1 Mbit/s, transmitting half.
    pub can_tx: B::CanTx,
    /// Receiving half.
    pub can_rx: B::CanRx,
    /// Serial line, transmitting half.
    pub serial_tx: B::SerialTx,
    /// Receiving half.
    pub serial_rx: B::SerialRx,
    /// Source of the challenges.
    pub rng: B::Rng,
    /// Button.
    pub button: B::Button,
    /// Flash of parameters and calibrations.
    pub flash: B::Flash,
    /// Where they are.
    pub flash_offsets: FlashOffsets,
    /// The chip's persistent configuration is unsuitable, or its crystal does not start: a non-zero code of the board.
    pub configuration_defect: Option<u32>,
    /// Temperatures of chip, motor and power stage.
    pub thermometer: B::Thermometer,
    /// Motor.
    pub drive: B::Drive,
    /// Watchdog.
    pub watchdog: B::Watchdog,
}

/// Offsets in the flash in bytes, aligned to pages.
#[derive(Clone, Copy, Debug)]
pub struct FlashOffsets {
    /// First page of the parameters.
    pub parameters: u32,
    /// First slot of the calibrations.
    pub calibrations: u32,
}

/// Temperature sensors of a board.
pub trait Thermometer {
    /// The latest temperatures.
    fn measure(&mut self) -> BoardTemperatures;
}

/// Motor of a board.
pub trait MotorDrive {
    /// Receives orders.
    type Port: MotorPort;
    /// Reports the state of the motor.
    type Monitor: MotorMonitor;

    /// Starts the control of the motor with the power stage off, which counts what its sensor does.
    fn start(self, settings: Settings, counts: &'static Counts) -> (Self::Port, Self::Monitor);
}

/// State of the motor, updated each millisecond.
pub trait MotorMonitor {
    /// The state and when it was taken, if it was updated since the last call.
    fn poll(&mut self) -> Option<Timed<MotorStatus>>;
}

/// A watchdog that cannot be stopped.
pub trait Watchdog {
    /// Starts it. From now on every task must check in within its time-out.
    fn start(&mut self);

    /// Feeds it while all tasks make progress, else records the task that hangs. Must be called every
    /// [`crate::system::task_watchdog::FEED_PERIOD_MS`].
    fn feed(&mut self, progress: &TaskProgress);
}
