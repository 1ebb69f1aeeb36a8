//! The [`loops`] on the chip: each as a task on its level, and every static with its one writer.
//!
//! Each level preempts those below it:
//!
//! | level | what | why |
//! | --- | --- | --- |
//! | priority 0 and 1 | the motor's interrupts, drivers | [`crate::hardware::drive`] |
//! | [`SENSING_PRIORITY`] | reading the sensors, taking CAN frames | a bus waits for its next transfer; the controller holds three frames |
//! | [`CONTROL_PRIORITY`] | estimating, grasping | the next tick |
//! | thread mode | all else | |
//!
//! Nothing above thread mode writes to the log.

use defmt::info;
use embassy_executor::{InterruptExecutor, SpawnError, SpawnToken, Spawner};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, UartTx};
use embassy_stm32::{interrupt, peripherals, rng};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Ticker};
use static_cell::StaticCell;

use crate::crash::Kind;
use crate::estimator::{Estimator, Running};
use crate::events::Event;
use crate::frame::SENSORS;
use crate::grip::Grip;
use crate::hall::a31301::A31301;
use crate::hardware::board::{Board, HARDWARE};
use crate::hardware::can::{Receiver, Sender};
use crate::hardware::clock::BoardClock;
use crate::hardware::crash;
use crate::hardware::drive::{self, Orders, Tellings};
use crate::hardware::flash::Pages;
use crate::hardware::sensor_bus::BoardBus;
use crate::hardware::watchdog::Watchdog;
use crate::limits::{Grasp, Limits};
use crate::loops::{self, Around, Desk, Exchange, Reins};
use crate::model::tables::{NETWORKS, TABLES};
use crate::motor::Order;
use crate::motor::screw::Screw;
use crate::parameters;
use crate::progress::FED_EVERY_MS;
use crate::store::{Loaded, Store};
use crate::wire::PROTOCOL;
use crate::wire::messages::Version;

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());

/// Where something counts as wrong.
const LIMITS: Limits = Limits::GRIPPER;
/// Between the loops; the writers stand beside each part. Made at the start: as a constant it would lie in
/// flash as well, two kilobytes of it.
static EXCHANGE: StaticCell<Exchange<CriticalSectionRawMutex>> = StaticCell::new();
type Shared = &'static Exchange<CriticalSectionRawMutex>;
/// Reads the sensors and takes CAN frames. The interrupts of the executors belong to peripherals that are not in use.
static SENSING: InterruptExecutor = InterruptExecutor::new();
/// Below the interrupts of the buses.
const SENSING_PRIORITY: Priority = Priority::P5;
/// Estimates and grasps.
static CONTROL: InterruptExecutor = InterruptExecutor::new();
/// Above thread mode.
const CONTROL_PRIORITY: Priority = Priority::P6;

/// The interrupt of [`SENSING`].
#[embassy_stm32::interrupt]
fn SAI1() {
    // The executor's own interrupt, which nothing else raises.
    #[allow(unsafe_code)]
    unsafe {
        SENSING.on_interrupt();
    }
}

/// The interrupt of [`CONTROL`].
#[embassy_stm32::interrupt]
fn FMAC() {
    // As above.
    #[allow(unsafe_code)]
    unsafe {
        CONTROL.on_interrupt();
    }
}

/// A task that is begun for the first time, as each of them is.
fn first<S>(token: Result<SpawnToken<S>, SpawnError>) -> SpawnToken<S> {
    // One place for all: the words of a panic at each are not worth their flash.
    token.unwrap_or_else(|_| twice())
}

#[cold]
#[inline(never)]
fn twice() -> ! {
    defmt::panic!("a task is begun twice")
}

/// Starts every task.
pub fn start(spawner: Spawner, board: Board) {
    // As a task of this crate: what it shares with the others is then there once.
    spawner.spawn(first(begin(spawner, board)));
}

#[embassy_executor::task]
async fn begin(spawner: Spawner, board: Board) {
    let exchange: Shared = EXCHANGE.init_with(Exchange::new);
    let (boot, crash) = crash::take();
    info!(
        "start {}, tables {:04x}, {} sensors",
        boot,
        TABLES.id,
        TABLES.sensors.len()
    );
    if let Some(crash) = &crash {
        exchange.note_crash(crash);
    }
    let mut store = board.store;
    let loaded = loops::begin(&mut store, exchange).await;
    let parameters = exchange.parameters();
    let settings = parameters.settings();
    let (sender, receiver) = board.can;
    sender.listen_as(parameters.node());
    let (out, into) = board.line;
    let line = drive::start(board.drive, settings);
    interrupt::FMAC.set_priority(CONTROL_PRIORITY);
    let control = CONTROL.start(interrupt::FMAC);
    control.spawn(first(estimate(exchange, line.tellings)));
    control.spawn(first(grip(exchange, settings.screw, line.orders)));
    interrupt::SAI1.set_priority(SENSING_PRIORITY);
    let sensing = SENSING.start(interrupt::SAI1);
    sensing.spawn(first(sense(
        exchange,
        board.sensor_buses,
        parameters.addresses(),
    )));
    sensing.spawn(first(listen(exchange, receiver)));
    let watchdog = Watchdog::start(board.watchdog);
    spawner.spawn(first(feed(exchange, watchdog)));
    spawner.spawn(first(scrub(exchange)));
    spawner.spawn(first(report(exchange, sender, parameters.node())));
    spawner.spawn(first(telemetry(exchange, out)));
    spawner.spawn(first(listen_serial(exchange, into, parameters.node())));
    spawner.spawn(first(command(exchange, store, loaded, board.rng)));
}

#[embassy_executor::task]
async fn sense(exchange: Shared, buses: [BoardBus; 2], addresses: [u8; SENSORS]) {
    loops::sense::<A31301, _, _, _>(buses, addresses, &LIMITS, &BoardClock, exchange).await;
}

#[embassy_executor::task]
async fn estimate(exchange: Shared, mut tellings: Tellings) {
    let mut estimator = Estimator::new(&TABLES, Running::start(&NETWORKS));
    let mut around = Around::default();
    let around = move || {
        if let Some(motor) = tellings.take() {
            around = Around {
                surroundings: motor.surroundings(),
                motor,
            };
        }
        around
    };
    loops::estimate(&mut estimator, around, &LIMITS, &BoardClock, exchange).await;
}

impl Reins for Orders {
    fn order(&mut self, order: Order) -> Result<(), Order> {
        Self::order(self, order)
    }

    fn give_up(&mut self) {
        crash::end(Kind::Corruption)
    }
}

#[embassy_executor::task]
async fn grip(exchange: Shared, screw: Screw, orders: Orders) {
    let locks = exchange.parameters().screw() == parameters::Screw::SelfLocking;
    let mut grip = Grip::new(Grasp::GRIPPER, screw, locks);
    loops::grip(&mut grip, orders, exchange).await;
}

#[embassy_executor::task]
async fn feed(exchange: Shared, mut watchdog: Watchdog) {
    let mut ticker = Ticker::every(Duration::from_millis(FED_EVERY_MS.into()));
    loop {
        watchdog.feed(&exchange.progress);
        ticker.next().await;
    }
}

#[embassy_executor::task]
async fn scrub(exchange: Shared) {
    loops::scrub(&TABLES, &NETWORKS, &BoardClock, exchange).await;
}

#[embassy_executor::task]
async fn report(exchange: Shared, can: Sender, node: u16) {
    loops::report(can, (node, version()), log, &BoardClock, exchange).await;
}

#[embassy_executor::task]
async fn telemetry(exchange: Shared, line: UartTx<'static, Async>) {
    loops::telemetry(line, exchange).await;
}

#[embassy_executor::task]
async fn listen(exchange: Shared, can: Receiver) {
    loops::listen(can, &LIMITS, &BoardClock, exchange).await;
}

#[embassy_executor::task]
async fn listen_serial(exchange: Shared, line: RingBufferedUartRx<'static>, node: u16) {
    loops::listen_serial(line, node, &LIMITS, &BoardClock, exchange).await;
}

#[embassy_executor::task]
async fn command(
    exchange: Shared,
    store: Store<Pages>,
    loaded: Loaded,
    mut rng: rng::Rng<'static, peripherals::RNG>,
) {
    let desk = Desk {
        version: version(),
        store,
        loaded,
        random: move || rng.next_u32() as u16,
        reboot: || cortex_m::peripheral::SCB::sys_reset(),
    };
    loops::command(desk, &BoardClock, exchange).await;
}

const fn number(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => u8::MAX,
    }
}

fn version() -> Version {
    Version {
        protocol_major: PROTOCOL.0,
        protocol_minor: PROTOCOL.1,
        firmware_major: const { number(env!("CARGO_PKG_VERSION_MAJOR")) },
        firmware_minor: const { number(env!("CARGO_PKG_VERSION_MINOR")) },
        firmware_patch: const { number(env!("CARGO_PKG_VERSION_PATCH")) },
        hardware: HARDWARE,
        tables: TABLES.id,
    }
}

fn log(event: Event) {
    match event {
        Event::Found { bus, answers } => info!("bus {}: answers {:04b}", bus, answers),
        Event::Cleared { bus, free } => info!("bus {} cleared, free {}", bus, free),
        Event::Fault(fault) => info!(
            "fault {} of {}: {}, {}",
            fault.code, fault.source, fault.active, fault.detail
        ),
    }
}
