//! The [`loops`] on the chip: each as a task on its level, and every static with its one writer.
//!
//! Sensing and estimating run on an interrupt of their own ([`LEVEL`]) and so interrupt the rest, which
//! runs in thread mode. Nothing above thread mode writes to the log.

use defmt::{info, unwrap};
use embassy_executor::{InterruptExecutor, Spawner};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, UartTx};
use embassy_stm32::{interrupt, peripherals, rng};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

use crate::estimator::{Estimator, Running};
use crate::events::Event;
use crate::hall::Part;
use crate::hall::a31301::A31301;
use crate::hardware::board::{Board, HARDWARE};
use crate::hardware::can::{Receiver, Sender};
use crate::hardware::clock::BoardClock;
use crate::hardware::sensor_bus::BoardBus;
use crate::limits::Limits;
use crate::loops::{self, Exchange};
use crate::model::tables::{NETWORKS, TABLES};
use crate::session::Session;
use crate::surroundings::Surroundings;
use crate::wire::messages::Version;
use crate::wire::{DEFAULT_NODE, PROTOCOL};

/// Where something counts as wrong.
const LIMITS: Limits = Limits::GRIPPER;
/// Between the loops; the writers stand beside each part.
static EXCHANGE: Exchange<CriticalSectionRawMutex> = Exchange::new();
/// Sensing and estimating; its interrupt belongs to no peripheral in use.
static UPPER: InterruptExecutor = InterruptExecutor::new();
/// Below the interrupts of the buses, above thread mode.
const LEVEL: Priority = Priority::P6;

/// The interrupt of [`UPPER`].
#[embassy_stm32::interrupt]
fn FMAC() {
    // The executor's own interrupt, which nothing else raises.
    #[allow(unsafe_code)]
    unsafe {
        UPPER.on_interrupt();
    }
}

/// Starts every task.
pub fn spawn(spawner: Spawner, board: Board) {
    info!("tables {:04x}, {} sensors", TABLES.id, TABLES.sensors.len());
    interrupt::FMAC.set_priority(LEVEL);
    let upper = UPPER.start(interrupt::FMAC);
    upper.spawn(unwrap!(sense(board.sensor_buses)));
    upper.spawn(unwrap!(estimate()));
    let (sender, receiver) = board.can;
    let (out, into) = board.line;
    spawner.spawn(unwrap!(report(sender)));
    spawner.spawn(unwrap!(telemetry(out)));
    spawner.spawn(unwrap!(listen(receiver)));
    spawner.spawn(unwrap!(listen_serial(into)));
    spawner.spawn(unwrap!(command(board.rng)));
}

#[embassy_executor::task]
async fn sense(buses: [BoardBus; 2]) {
    loops::sense::<A31301, _, _, _>(buses, A31301::ADDRESSES, &LIMITS, &BoardClock, &EXCHANGE)
        .await;
}

#[embassy_executor::task]
async fn estimate() {
    let estimator = Estimator::new(&TABLES, Running::start(&NETWORKS));
    // Nothing on this board measures them yet: what needs them stays off, and the estimates say so.
    let around = Surroundings::default;
    loops::estimate(estimator, around, &LIMITS, &BoardClock, &EXCHANGE).await;
}

#[embassy_executor::task]
async fn report(can: Sender) {
    loops::report(can, (DEFAULT_NODE, version()), log, &BoardClock, &EXCHANGE).await;
}

#[embassy_executor::task]
async fn telemetry(line: UartTx<'static, Async>) {
    loops::telemetry(line, &EXCHANGE).await;
}

#[embassy_executor::task]
async fn listen(can: Receiver) {
    loops::listen(can, &LIMITS, &BoardClock, &EXCHANGE).await;
}

#[embassy_executor::task]
async fn listen_serial(line: RingBufferedUartRx<'static>) {
    loops::listen_serial(line, DEFAULT_NODE, &LIMITS, &BoardClock, &EXCHANGE).await;
}

#[embassy_executor::task]
async fn command(mut rng: rng::Rng<'static, peripherals::RNG>) {
    let random = move || rng.next_u32() as u16;
    loops::command(
        Session::new(DEFAULT_NODE, &LIMITS),
        random,
        &BoardClock,
        &EXCHANGE,
    )
    .await;
}

fn version() -> Version {
    let number = |text: &str| text.parse().unwrap_or(u8::MAX);
    Version {
        protocol_major: PROTOCOL.0,
        protocol_minor: PROTOCOL.1,
        firmware_major: number(env!("CARGO_PKG_VERSION_MAJOR")),
        firmware_minor: number(env!("CARGO_PKG_VERSION_MINOR")),
        firmware_patch: number(env!("CARGO_PKG_VERSION_PATCH")),
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
