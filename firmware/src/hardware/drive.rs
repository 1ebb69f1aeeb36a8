//! The motor's interrupt: at the end of the currents' conversions, 20 kHz, priority 0. It waits for nothing,
//! and nothing holds it off.
#![allow(unsafe_code)] // What the interrupt owns.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::{Peri, peripherals};
use static_cell::ConstStaticCell;

use super::phase_currents::{Inputs, PhaseCurrents};
use super::power_stage::{self, Stage};
use super::rotor_sensor::{self, AGE_PERIODS, RotorSensor};
use super::slot::{Reader, Slot, Writer};
use crate::motor::stage::{Encoder, Sensed};
use crate::motor::state::{Order, Telling};
use crate::motor::{Motor, Settings};
use crate::params::PWM_RATE;

/// Periods from one telling to the next: a millisecond.
const TELLS: u8 = PWM_RATE.value as u8;

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

/// What those below hold of the drive: orders to it, and what it tells each millisecond.
pub struct Line {
    /// To the drive, one in a period.
    pub orders: Writer<Order>,
    /// From the drive; what is not taken within a millisecond stands in the way of the next.
    pub tellings: Reader<Telling>,
}

/// What the interrupt owns.
struct Control {
    motor: Motor,
    stage: Stage,
    currents: PhaseCurrents,
    sensor: RotorSensor,
    orders: Reader<Order>,
    tellings: Writer<Telling>,
    periods: u8,
}

struct Owned(UnsafeCell<MaybeUninit<Control>>);

// SAFETY: written by `start` before the interrupt is enabled, then used by the interrupt alone.
unsafe impl Sync for Owned {}

static CONTROL: Owned = Owned(UnsafeCell::new(MaybeUninit::uninit()));

/// Starts the pulses, with all switches off, and the interrupt. Once.
pub fn start(parts: Parts, settings: Settings) -> Line {
    static TO_DRIVE: ConstStaticCell<Slot<Order>> = ConstStaticCell::new(Slot::new());
    static FROM_DRIVE: ConstStaticCell<Slot<Telling>> = ConstStaticCell::new(Slot::new());
    let (orders, ordered) = TO_DRIVE.take().split();
    let (told, tellings) = FROM_DRIVE.take().split();
    let settings = Settings {
        angle_age_periods: AGE_PERIODS,
        ..settings
    };
    let control = Control {
        motor: Motor::new(settings),
        currents: PhaseCurrents::start(parts.converter, parts.inputs),
        sensor: RotorSensor::new(parts.port, parts.sensor),
        stage: Stage::start(parts.timer, parts.bridges),
        orders: ordered,
        tellings: told,
        periods: 0,
    };
    // SAFETY: the interrupt is not enabled yet.
    unsafe { (*CONTROL.0.get()).write(control) };
    interrupt::ADC1_2.set_priority(Priority::P0);
    // SAFETY: what the interrupt owns is there.
    unsafe { interrupt::ADC1_2.enable() };
    Line { orders, tellings }
}

impl Control {
    fn period(&mut self) {
        let angle = self.sensor.angle();
        let (phases, bus) = self.currents.take();
        self.sensor.select();
        if let Some(order) = self.orders.take() {
            self.motor.obey(order);
        }
        if self.stage.is_broken() {
            self.motor.shut_off();
        }
        let sensed = Sensed { phases, bus, angle };
        self.motor.period(&sensed, &mut self.stage);
        self.sensor.ask();
        self.periods = self.periods.saturating_add(1);
        if self.periods >= TELLS {
            self.periods = 0;
            // Without a reader it is dropped.
            let _ = self.tellings.put(self.motor.telling());
        }
    }
}

#[embassy_stm32::interrupt]
fn ADC1_2() {
    // SAFETY: written before the interrupt is enabled; nobody else uses it from then on.
    unsafe { (*CONTROL.0.get()).assume_init_mut() }.period();
}
