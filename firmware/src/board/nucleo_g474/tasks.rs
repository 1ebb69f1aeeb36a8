//! The [`tasks`](crate::tasks) on the chip: executors, priorities, and the statics.
//!
//! | level | tasks | deadline |
//! | --- | --- | --- |
//! | priority 0 and 1 | motor interrupts ([`crate::board::selected::drive`]), drivers | one PWM period |
//! | [`SENSING_PRIORITY`] | sense, inertial, receive CAN | a bus waits for its next transfer; the controller stores three frames |
//! | [`CONTROL_PRIORITY`] | control: estimate and grip | the next tick |
//! | thread mode | all other tasks | |
//!
//! Each level preempts those below it. Nothing above thread mode writes to the log.

use core::sync::atomic::Ordering;

use defmt::info;
use embassy_executor::{InterruptExecutor, SpawnError, SpawnToken, Spawner};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_hal::digital::InputPin;
use static_cell::StaticCell;

use crate::board::selected::calibration_memory;
use crate::board::selected::clock::BoardClock;
use crate::board::selected::peripherals::break_on_low_supply;
use crate::board::selected::pwm::Stage;
use crate::board::selected::{NucleoG474, crash};
use crate::board::{Bsp, MotorDrive, MotorMonitor, Peripherals, Thermometer, Watchdog};
use crate::clock::Clock;
use crate::config::limits::DetectionLimits;
use crate::estimator::{Estimator, NetworkBank};
use crate::grip::GripController;
use crate::model::calibration::Payload;
use crate::model::tables::{DESCRIPTION, NETWORKS, TABLES, TablesCalibration};
use crate::motor::screw::Screw;
use crate::parameters::Backdrivability;
use crate::parameters::schema::detector;
use crate::protocol::firmware_version;
use crate::protocol::messages::Version;
use crate::sensors::hall::{GripperHallSensor, SENSORS};
use crate::system::faults::Event;
use crate::system::nv_storage::ParameterStore;
use crate::system::nv_storage::calibration::CalibrationSlots;
use crate::system::task_watchdog::FEED_PERIOD_MS;
use crate::tasks::calibration::{
    CalibrationOrigin, CalibrationService, LinkedCalibration, load_calibration,
};
use crate::tasks::{self, GripInputs, GripLoop, HostService, SharedState};

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());

type B = NucleoG474;
type Drive = <B as Bsp>::Drive;
type Calibration = TablesCalibration<'static>;
type Shared = &'static SharedState<CriticalSectionRawMutex>;

const LIMITS: DetectionLimits = DetectionLimits::GRIPPER;
/// Initialised at boot: as a constant it would also occupy 2 KB of flash.
static SHARED: StaticCell<SharedState<CriticalSectionRawMutex>> = StaticCell::new();
/// The running calibration.
static CALIBRATION: StaticCell<Calibration> = StaticCell::new();
/// Executor of sensing and CAN reception. Both executors use interrupts of unused peripherals.
static SENSING: InterruptExecutor = InterruptExecutor::new();
/// Below the interrupts of the buses.
const SENSING_PRIORITY: Priority = Priority::P5;
/// Executor of estimation and grip.
static CONTROL: InterruptExecutor = InterruptExecutor::new();
/// Above thread mode.
const CONTROL_PRIORITY: Priority = Priority::P6;

/// Interrupt of [`SENSING`].
#[embassy_stm32::interrupt]
fn SAI1() {
    // SAFETY: the executor's own interrupt, not raised by anything else.
    #[allow(unsafe_code)]
    unsafe {
        SENSING.on_interrupt();
    }
}

/// Interrupt of [`CONTROL`].
#[embassy_stm32::interrupt]
fn FMAC() {
    // SAFETY: as above.
    #[allow(unsafe_code)]
    unsafe {
        CONTROL.on_interrupt();
    }
}

/// The token of a task that is spawned once.
fn once<S>(token: Result<SpawnToken<S>, SpawnError>) -> SpawnToken<S> {
    crash::once(token.ok())
}

/// Initialises the board and spawns every task.
pub fn start(spawner: Spawner) {
    // As a task of this crate: code shared with the other tasks is then instantiated once.
    spawner.spawn(once(begin(spawner, B::init())));
}

#[embassy_executor::task]
async fn begin(spawner: Spawner, board: Peripherals<B>) {
    let shared: Shared = &*crash::once(SHARED.try_init_with(SharedState::new));
    let (boot, cause, crash) = crash::take_record();
    if let Some(crash) = &crash {
        shared.record_crash(crash);
    }
    let mut store = ParameterStore::new(board.flash, board.flash_offsets.parameters);
    let loaded = tasks::load_parameters(&mut store, shared).await;
    let slots = CalibrationSlots::new(board.flash_offsets.calibrations);
    let payload = Payload { tables: &TABLES, networks: &NETWORKS };
    let linked = LinkedCalibration { payload, description: DESCRIPTION };
    let (calibration, origin, defect) =
        load_calibration(&slots, store.flash(), calibration_memory::take(), &linked).await;
    let calibration: &'static Calibration = &*crash::once(CALIBRATION.try_init(calibration));
    let tables = &calibration.tables;
    let parameters = shared.parameters();
    info!("start {}, tables {:04x}, {} sensors", boot, tables.id, tables.sensors.len());
    let (chip, options) = (pac::DBGMCU.idcode().read().0, pac::FLASH.optr().read().0);
    info!("chip {:08x}, option bytes {:08x}, reset flags {:08x}", chip, options, cause);
    // Code 3: without a crystal the core runs from its own oscillator.
    let wrong = board.configuration_defect.unwrap_or_default();
    info!("core 160 MHz, defect of the configuration {}", wrong);
    let is_uploaded = matches!(origin, CalibrationOrigin::Stored(_));
    let (is_measured, is_on_bench) = (parameters.is_commissioned(), parameters.is_on_bench());
    info!("calibration uploaded: {}, motor measured: {}", is_uploaded, is_measured);
    info!("limits of the bench: {}", is_on_bench);
    let counts = &shared.counts;
    counts.chip.store(chip, Ordering::Relaxed);
    counts.option_bytes.store(options, Ordering::Relaxed);
    counts.reset_cause.store(cause, Ordering::Relaxed);
    let settings = parameters.settings();
    let node = parameters.node();
    board.can_tx.accept_node(node);
    if parameters.detects(detector::LOW_SUPPLY) {
        break_on_low_supply();
    }
    let (motor_port, motor_status) = board.drive.start(settings, counts);
    interrupt::FMAC.set_priority(CONTROL_PRIORITY);
    let executor = CONTROL.start(interrupt::FMAC);
    executor.spawn(once(control(shared, calibration, settings.screw, motor_port, motor_status)));
    interrupt::SAI1.set_priority(SENSING_PRIORITY);
    let sensing = SENSING.start(interrupt::SAI1);
    sensing.spawn(once(sense(shared, board.sensor_buses, parameters.addresses())));
    sensing.spawn(once(inertial(shared, board.imu)));
    sensing.spawn(once(receive_can(shared, board.can_rx)));
    let mut watchdog = board.watchdog;
    watchdog.start();
    spawner.spawn(once(feed(shared, watchdog)));
    spawner.spawn(once(temperatures(shared, board.thermometer)));
    spawner.spawn(once(scrub(shared, calibration)));
    let version = firmware_version(B::HARDWARE, tables.id);
    spawner.spawn(once(transmit(shared, board.can_tx, node, version)));
    spawner.spawn(once(transmit_serial(shared, board.serial_tx)));
    spawner.spawn(once(receive_serial(shared, board.serial_rx, node)));
    let calibration = CalibrationService { slots, origin, defect };
    let service = HostService {
        version,
        store,
        loaded,
        calibration,
        configuration_defect: board.configuration_defect,
        random: board.rng,
        is_pressed: board.button,
        reboot: (),
    };
    spawner.spawn(once(host_service(shared, service)));
}

#[embassy_executor::task]
async fn sense(shared: Shared, buses: [<B as Bsp>::SensorBus; 2], addresses: [u8; SENSORS]) {
    let limits = shared.parameters().detection_limits();
    tasks::sense::<GripperHallSensor, _, _, _>(buses, addresses, &limits, &BoardClock, shared)
        .await;
}

#[embassy_executor::task]
async fn inertial(shared: Shared, imu: <B as Bsp>::Imu) {
    tasks::inertial::inertial(imu, &BoardClock, shared).await;
}

/// Not inlined: copies of the networks' states are then on the stack during this call only, and not in every call of the task.
#[inline(never)]
fn estimator(calibration: &'static Calibration) -> Estimator<'static, impl NetworkBank> {
    Estimator::new(&calibration.tables, calibration.bank())
}

#[embassy_executor::task]
async fn control(
    shared: Shared,
    calibration: &'static Calibration,
    screw: Screw,
    mut motor: <Drive as MotorDrive>::Port,
    mut motor_status: <Drive as MotorDrive>::Monitor,
) {
    let mut estimator = estimator(calibration);
    let parameters = shared.parameters();
    let is_self_locking = parameters.backdrivability() == Backdrivability::SelfLocking;
    let mut grip = GripController::new(parameters.grip_limits(), screw, is_self_locking);
    let mut state = GripLoop::default();
    let grip = |inputs: &GripInputs| state.step(&mut grip, inputs, &mut motor, shared);
    let motor_status = || motor_status.poll();
    tasks::estimate(&mut estimator, motor_status, grip, &LIMITS, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn feed(shared: Shared, mut watchdog: <B as Bsp>::Watchdog) {
    let mut time_us = BoardClock.now_us();
    loop {
        watchdog.feed(&shared.progress);
        time_us = time_us.saturating_add(1000 * u64::from(FEED_PERIOD_MS));
        BoardClock.until(time_us).await;
    }
}

#[embassy_executor::task]
async fn temperatures(shared: Shared, mut thermometer: <B as Bsp>::Thermometer) {
    let measure = || {
        let counts = &shared.counts;
        counts.break_input.store(Stage::is_ready().into(), Ordering::Relaxed);
        let is_low = pac::PWR.sr2().read().pvdo() || Stage::was_broken_by_chip();
        counts.low_supply.fetch_add(is_low.into(), Ordering::Relaxed);
        thermometer.measure()
    };
    tasks::temperatures::temperatures(measure, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn scrub(shared: Shared, calibration: &'static Calibration) {
    let networks = calibration.networks.scrubbed();
    tasks::scrub(&calibration.tables, networks, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn transmit(shared: Shared, can: <B as Bsp>::CanTx, node: u16, version: Version) {
    tasks::transmit(can, (node, version), log, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn transmit_serial(shared: Shared, line: <B as Bsp>::SerialTx) {
    tasks::transmit_serial(line, shared).await;
}

#[embassy_executor::task]
async fn receive_can(shared: Shared, can: <B as Bsp>::CanRx) {
    tasks::receive_can(can, &LIMITS, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn receive_serial(shared: Shared, line: <B as Bsp>::SerialRx, node: u16) {
    tasks::receive_serial(line, node, &LIMITS, &BoardClock, shared).await;
}

#[embassy_executor::task]
async fn host_service(
    shared: Shared,
    service: HostService<<B as Bsp>::Flash, <B as Bsp>::Rng, <B as Bsp>::Button, ()>,
) {
    let HostService { version, store, loaded, calibration, configuration_defect, .. } = service;
    let (mut rng, mut button) = (service.random, service.is_pressed);
    let service = HostService {
        version,
        store,
        loaded,
        calibration,
        configuration_defect,
        random: move || rng.next_u64(),
        is_pressed: move || InputPin::is_high(&mut button).unwrap_or(false),
        reboot: || cortex_m::peripheral::SCB::sys_reset(),
    };
    tasks::host_service(service, &BoardClock, shared).await;
}

fn log(event: Event) {
    match event {
        Event::BusScanned { bus, answers } => info!("bus {}: answers {:016b}", bus, answers),
        Event::InertialSensor { is_present } => info!("inertial sensor present: {}", is_present),
        Event::BusCleared { bus, free } => info!("bus {} cleared, free {}", bus, free),
        Event::Fault(fault) => {
            info!("fault {} of {}: {}, {}", fault.code, fault.source, fault.active, fault.detail)
        }
    }
}
