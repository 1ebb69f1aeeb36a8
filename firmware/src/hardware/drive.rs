//! The motor's two interrupts. The inner tick runs at the end of the currents' conversions, 20 kHz, priority 0:
//! it waits for nothing, and nothing holds it off. The outer one, 4 kHz, is raised by it and by whoever orders;
//! it has priority 1 and only critical sections hold it off.
#![allow(unsafe_code)] // What the interrupts own.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::{Peri, peripherals};
use static_cell::ConstStaticCell;

use super::phase_currents::{Inputs, PhaseCurrents};
use super::power_stage::{self, Stage};
use super::queue::{Queue, Reader, Writer};
use super::rotor_sensor::{self, AGE_PERIODS, RotorSensor};
use crate::motor::commission::Found;
use crate::motor::handed::{Ask, Felt};
use crate::motor::stage::{Encoder, PowerStage, Sensed};
use crate::motor::state::{Order, Telling};
use crate::motor::{Inner, MOTION_HZ, MOTION_PERIODS, Outer, Settings};

/// Outer ticks from one telling to the next: a millisecond.
const TELLS: u8 = (MOTION_HZ * 1e-3) as u8;
/// Orders that may wait: a millisecond's arming, opening and set-point.
const ORDERS: usize = 3;
/// What may wait for the inner tick, which takes all in its next period: an answer to each order, and the outer
/// tick's own.
const ASKS: usize = ORDERS + 1;

/// What the drive needs of the board.
pub struct Parts {
    /// The pulses.
    pub timer: Peri<'static, peripherals::TIM1>,
    /// The half bridges.
    pub bridges: power_stage::Pins,
    /// The currents' converter.
    pub converter: Peri<'static, peripherals::ADC1>,
    /// Currents and bus voltage.
    pub inputs: Inputs,
    /// The rotor's sensor.
    pub port: Peri<'static, peripherals::SPI1>,
    /// Its pins.
    pub sensor: rotor_sensor::Pins,
}

/// What those below hold of the drive.
pub struct Line {
    /// Orders to it.
    pub orders: Orders,
    /// What it tells each millisecond; what is not taken by then stands in the way of the next.
    pub tellings: Tellings,
}

/// From the drive.
pub type Tellings = Reader<Telling, 1>;

/// To the drive.
pub struct Orders(Writer<Order, ORDERS>);

impl Orders {
    /// Orders something; it comes back where too much waits.
    pub fn order(&mut self, order: Order) -> Result<(), Order> {
        let ordered = self.0.put(order);
        interrupt::CORDIC.pend();
        ordered
    }
}

/// What the inner tick's interrupt owns.
struct InnerSide {
    inner: Inner,
    stage: Stage,
    currents: PhaseCurrents,
    sensor: RotorSensor,
    asks: Reader<Ask, ASKS>,
    felt: Writer<Felt, 1>,
    found: Writer<Found, 1>,
    periods: u8,
}

/// What the outer tick's interrupt owns.
struct OuterSide {
    outer: Outer,
    orders: Reader<Order, ORDERS>,
    felt: Reader<Felt, 1>,
    found: Reader<Found, 1>,
    asks: Writer<Ask, ASKS>,
    tellings: Writer<Telling, 1>,
    ticks: u8,
}

struct Owned<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: written by `start` before its interrupt is enabled, then used by that interrupt alone.
unsafe impl<T> Sync for Owned<T> {}

static INNER: Owned<InnerSide> = Owned(UnsafeCell::new(MaybeUninit::uninit()));
static OUTER: Owned<OuterSide> = Owned(UnsafeCell::new(MaybeUninit::uninit()));

/// Starts the pulses, with all switches off, and the interrupts. Once.
pub fn start(parts: Parts, settings: Settings) -> Line {
    static ORDERED: ConstStaticCell<Queue<Order, ORDERS>> = ConstStaticCell::new(Queue::new());
    static TOLD: ConstStaticCell<Queue<Telling, 1>> = ConstStaticCell::new(Queue::new());
    static FELT: ConstStaticCell<Queue<Felt, 1>> = ConstStaticCell::new(Queue::new());
    static FOUND: ConstStaticCell<Queue<Found, 1>> = ConstStaticCell::new(Queue::new());
    static ASKED: ConstStaticCell<Queue<Ask, ASKS>> = ConstStaticCell::new(Queue::new());
    let (orders, ordered) = ORDERED.take().split();
    let (telling, tellings) = TOLD.take().split();
    let (felt, feelings) = FELT.take().split();
    let (found, findings) = FOUND.take().split();
    let (asking, asks) = ASKED.take().split();
    let settings = Settings {
        angle_age_periods: AGE_PERIODS,
        ..settings
    };
    let inner = InnerSide {
        inner: Inner::new(settings),
        currents: PhaseCurrents::start(parts.converter, parts.inputs),
        sensor: RotorSensor::new(parts.port, parts.sensor),
        stage: Stage::start(parts.timer, parts.bridges),
        asks,
        felt,
        found,
        periods: 0,
    };
    let outer = OuterSide {
        outer: Outer::new(settings),
        orders: ordered,
        felt: feelings,
        found: findings,
        asks: asking,
        tellings: telling,
        ticks: 0,
    };
    // SAFETY: the interrupts are not enabled yet.
    unsafe {
        (*INNER.0.get()).write(inner);
        (*OUTER.0.get()).write(outer);
    }
    interrupt::ADC1_2.set_priority(Priority::P0);
    interrupt::CORDIC.set_priority(Priority::P1);
    // SAFETY: what the interrupts own is there.
    unsafe {
        interrupt::CORDIC.enable();
        interrupt::ADC1_2.enable();
    }
    Line {
        orders: Orders(orders),
        tellings,
    }
}

impl InnerSide {
    fn period(&mut self) {
        let angle = self.sensor.angle();
        let (phases, bus) = self.currents.take();
        self.sensor.select();
        while let Some(ask) = self.asks.take() {
            self.inner.hear(ask);
        }
        if self.stage.is_broken() {
            self.inner.shut_off();
        }
        let sensed = Sensed { phases, bus, angle };
        self.stage.drive(self.inner.tick(&sensed));
        self.sensor.ask();
        self.periods = self.periods.saturating_add(1);
        if self.periods >= MOTION_PERIODS {
            self.periods = 0;
            if let Some(found) = self.inner.take_found() {
                let _ = self.found.put(found);
            }
            // Where the outer tick has missed its turns there is no room; the motor trips by itself then.
            let _ = self.felt.put(self.inner.felt());
            interrupt::CORDIC.pend();
        }
    }
}

impl OuterSide {
    fn tick(&mut self) {
        while let Some(order) = self.orders.take() {
            if let Some(urgent) = self.outer.obey(order) {
                let _ = self.asks.put(urgent);
            }
        }
        if let Some(found) = self.found.take() {
            self.outer.adopt(found);
        }
        let Some(felt) = self.felt.take() else {
            return;
        };
        // The inner tick takes all that waits in its next period.
        let _ = self.asks.put(self.outer.tick(felt));
        self.ticks = self.ticks.saturating_add(1);
        if self.ticks >= TELLS {
            self.ticks = 0;
            // Without a reader it is dropped.
            let _ = self.tellings.put(self.outer.telling());
        }
    }
}

/// Raised by the converter.
#[embassy_stm32::interrupt]
fn ADC1_2() {
    // SAFETY: written before the interrupt is enabled; nobody else uses it from then on.
    unsafe { (*INNER.0.get()).assume_init_mut() }.period();
}

/// Raised by the inner tick and by whoever orders; its peripheral is not in use.
#[embassy_stm32::interrupt]
fn CORDIC() {
    // SAFETY: written before the interrupt is enabled; nobody else uses it from then on.
    unsafe { (*OUTER.0.get()).assume_init_mut() }.tick();
}
