//! The two interrupts of the motor. The current loop runs at the end of the current conversions, 20 kHz, at priority 0:
//! nothing masks it. The motion loop, 4 kHz, is raised by it and by orders; it runs at priority 1 and only critical
//! sections mask it.
#![allow(unsafe_code)] // State owned by the interrupts.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::Ordering;

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::{Peri, peripherals};
use embassy_time::Delay;
use static_cell::ConstStaticCell;

use crate::board::selected::clock::BoardClock;
use crate::board::selected::crash;
use crate::board::selected::feedback::{
    ANGLE_AGE_PERIODS, AnalogPins, PhaseCurrents, RotorSensor, SpiPins, rotor_sensor,
};
use crate::board::selected::pwm::{self, Stage};
use crate::board::{MotorDrive, MotorMonitor, MotorPort};
use crate::clock::{Clock, Timed};
use crate::motor::power_stage::{Encoder, EncoderError, MotorSamples, PowerStage};
use crate::motor::settings::IdentifiedMotor;
use crate::motor::state::{MotorCommand, MotorStatus};
use crate::motor::tick_exchange::{CurrentLoopCommand, CurrentLoopReport};
use crate::motor::{CurrentLoop, MOTION_HZ, MOTION_PERIODS, MotionLoop, Settings};
use crate::system::crash::CrashKind;
use crate::system::queue::{Queue, Reader, Writer};
use crate::tasks::Counts;

/// Motion loop ticks between two status reports: 1 ms.
const STATUS_TICKS: u8 = (MOTION_HZ * 1e-3) as u8;
/// Capacity of the order queue: arming, opening and set-point of one millisecond.
const ORDERS: usize = 3;
/// Capacity of the queue to the current loop, which empties it in its next period: one entry for each order and one of
/// the motion loop itself.
const REQUESTS: usize = ORDERS + 1;

/// Orders in a row without a report of the current loop after which the outputs are switched off: 3 ms.
const MAX_UNREPORTED: u8 = 3;

/// Peripherals and pins of the motor.
pub struct Parts {
    /// PWM timer.
    pub timer: Peri<'static, peripherals::TIM1>,
    /// Half bridges.
    pub bridges: pwm::Pins,
    /// Converter of currents and bus voltage.
    pub converter: Peri<'static, peripherals::ADC1>,
    /// Its inputs.
    pub inputs: AnalogPins,
    /// SPI port of the rotor sensor.
    pub port: Peri<'static, peripherals::SPI1>,
    /// Its pins.
    pub sensor: SpiPins,
}

/// Queue of orders to the motion loop.
pub struct Orders(Writer<MotorCommand, ORDERS>);

impl MotorPort for Orders {
    fn order(&mut self, order: MotorCommand) -> Result<(), MotorCommand> {
        let queued = self.0.push(order);
        interrupt::CORDIC.pend();
        queued
    }

    fn shut_down(&mut self) {
        crash::reset(CrashKind::Corruption)
    }
}

/// Status reports of the motion loop. A report that is not read delays the next.
pub struct StatusReports(Reader<Timed<MotorStatus>, 1>);

impl MotorMonitor for StatusReports {
    fn poll(&mut self) -> Option<Timed<MotorStatus>> {
        self.0.pop()
    }
}

/// State of the current loop's interrupt.
struct CurrentLoopState {
    inner: CurrentLoop,
    stage: Stage,
    currents: PhaseCurrents,
    sensor: RotorSensor,
    requests: Reader<CurrentLoopCommand, REQUESTS>,
    state: Writer<CurrentLoopReport, 1>,
    results: Writer<IdentifiedMotor, 1>,
    periods: u8,
    counts: &'static Counts,
    /// The last angle and the periods for which it has been the same.
    last: (Result<u16, EncoderError>, u16),
}

/// State of the motion loop's interrupt.
struct MotionLoopState {
    outer: MotionLoop,
    orders: Reader<MotorCommand, ORDERS>,
    state: Reader<CurrentLoopReport, 1>,
    results: Reader<IdentifiedMotor, 1>,
    requests: Writer<CurrentLoopCommand, REQUESTS>,
    status: Writer<Timed<MotorStatus>, 1>,
    ticks: u8,
    /// Orders in a row without a report of the current loop between them.
    unreported: u8,
}

struct Owned<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: written before the interrupt is enabled, then used by that interrupt alone.
unsafe impl<T> Sync for Owned<T> {}

static INNER: Owned<CurrentLoopState> = Owned(UnsafeCell::new(MaybeUninit::uninit()));
static OUTER: Owned<MotionLoopState> = Owned(UnsafeCell::new(MaybeUninit::uninit()));

impl MotorDrive for Parts {
    type Port = Orders;
    type Monitor = StatusReports;

    fn start(self, settings: Settings, counts: &'static Counts) -> (Orders, StatusReports) {
        start(self, settings, counts)
    }
}

/// Starts timer and interrupts with all switches off. Must be called once.
fn start(parts: Parts, settings: Settings, counts: &'static Counts) -> (Orders, StatusReports) {
    static ORDER_QUEUE: ConstStaticCell<Queue<MotorCommand, ORDERS>> =
        ConstStaticCell::new(Queue::new());
    static STATUS_QUEUE: ConstStaticCell<Queue<Timed<MotorStatus>, 1>> =
        ConstStaticCell::new(Queue::new());
    static STATE_QUEUE: ConstStaticCell<Queue<CurrentLoopReport, 1>> =
        ConstStaticCell::new(Queue::new());
    static RESULT_QUEUE: ConstStaticCell<Queue<IdentifiedMotor, 1>> =
        ConstStaticCell::new(Queue::new());
    static REQUEST_QUEUE: ConstStaticCell<Queue<CurrentLoopCommand, REQUESTS>> =
        ConstStaticCell::new(Queue::new());
    let (orders, order_reader) = crash::once(ORDER_QUEUE.try_take()).split();
    let (status_writer, status) = crash::once(STATUS_QUEUE.try_take()).split();
    let (state_writer, state_reader) = crash::once(STATE_QUEUE.try_take()).split();
    let (result_writer, result_reader) = crash::once(RESULT_QUEUE.try_take()).split();
    let (request_writer, request_reader) = crash::once(REQUEST_QUEUE.try_take()).split();
    let settings = Settings { angle_age_periods: ANGLE_AGE_PERIODS, ..settings };
    let mut sensor = rotor_sensor(parts.port, parts.sensor);
    if sensor.start(&mut Delay).is_err() {
        // The current loop reports it.
        defmt::warn!("no valid answer of the rotor sensor");
    }
    let diagnosis = sensor.diagnose(&mut Delay).map_or(u32::MAX, u32::from);
    counts.rotor_sensor.store(diagnosis, Ordering::Relaxed);
    let inner = CurrentLoopState {
        inner: CurrentLoop::new(settings),
        currents: PhaseCurrents::start(parts.converter, parts.inputs),
        sensor,
        stage: Stage::start(parts.timer, parts.bridges),
        requests: request_reader,
        state: state_writer,
        results: result_writer,
        periods: 0,
        counts,
        last: (Err(EncoderError::Silent), 0),
    };
    let outer = MotionLoopState {
        outer: MotionLoop::new(settings),
        orders: order_reader,
        state: state_reader,
        results: result_reader,
        requests: request_writer,
        status: status_writer,
        ticks: 0,
        unreported: 0,
    };
    // SAFETY: the interrupts are not enabled yet.
    unsafe {
        (*INNER.0.get()).write(inner);
        (*OUTER.0.get()).write(outer);
    }
    interrupt::ADC1_2.set_priority(Priority::P0);
    interrupt::CORDIC.set_priority(Priority::P1);
    // SAFETY: the state of both interrupts is initialised.
    unsafe {
        interrupt::CORDIC.enable();
        interrupt::ADC1_2.enable();
    }
    (Orders(orders), StatusReports(status))
}

impl CurrentLoopState {
    fn period(&mut self) {
        let angle = self.sensor.angle();
        let (phases, bus) = self.currents.read();
        while let Some(ask) = self.requests.pop() {
            self.inner.apply(ask);
        }
        if self.stage.is_broken() {
            self.inner.trip_power_stage();
        }
        // At least 350 ns after it was deselected, and before its frame.
        let Ok(()) = self.sensor.select();
        let sensed = MotorSamples { phases, bus, angle };
        self.stage.drive(self.inner.tick(&sensed));
        self.sensor.start_frame();
        self.count_repeated(angle);
        self.periods = self.periods.saturating_add(1);
        if self.periods >= MOTION_PERIODS {
            self.periods = 0;
            if let Some(found) = self.inner.take_identification() {
                let _ = self.results.push(found);
            }
            // Full when the motion loop has missed its ticks: then the events wait, and the current loop trips by itself.
            self.inner.push_report(|report| self.state.push(report));
            interrupt::CORDIC.pend();
        }
    }

    /// Longest run of equal angles, also while the motor is off, where
    /// [`SensorMonitor`](crate::motor::diagnostics::SensorMonitor) does not count: the bring-up reads it.
    fn count_repeated(&mut self, angle: Result<u16, EncoderError>) {
        let (last, repeated) = self.last;
        let repeated = if angle.is_ok() && angle == last { repeated.saturating_add(1) } else { 0 };
        self.last = (angle, repeated);
        let longest = &self.counts.repeated_angles;
        if u32::from(repeated) > longest.load(Ordering::Relaxed) {
            longest.store(repeated.into(), Ordering::Relaxed);
        }
    }
}

impl MotionLoopState {
    fn tick(&mut self) {
        let mut orders = 0_u8;
        while let Some(order) = self.orders.pop() {
            orders = orders.saturating_add(1);
            if let Some(urgent) = self.outer.handle_command(order) {
                let _ = self.requests.push(urgent);
            }
        }
        if let Some(found) = self.results.pop() {
            self.outer.apply_identification(found);
        }
        let Some(report) = self.state.pop() else {
            // The current loop reports four times between two orders, unless its trigger is lost: its duties are frozen.
            self.unreported = self.unreported.saturating_add(orders);
            if self.unreported >= MAX_UNREPORTED {
                Stage::break_off();
            }
            return;
        };
        self.unreported = 0;
        // The current loop has just sampled it.
        let time_us = BoardClock.now_us();
        // The current loop empties this queue in its next period.
        let _ = self.requests.push(self.outer.tick(report));
        self.ticks = self.ticks.saturating_add(1);
        if self.ticks >= STATUS_TICKS {
            self.ticks = 0;
            // Dropped while the last report was not read.
            let _ = self.status.push(Timed { time_us, value: self.outer.status() });
        }
    }
}

/// End of the injected conversions. In core-coupled memory, where neither branches nor constants wait.
#[embassy_stm32::interrupt]
#[unsafe(link_section = ".ccm.current_loop")]
fn ADC1_2() {
    // SAFETY: written before the interrupt is enabled; not used elsewhere from then on.
    unsafe { (*INNER.0.get()).assume_init_mut() }.period();
}

/// Raised by the current loop and by orders; its peripheral is unused. In core-coupled memory as well.
#[embassy_stm32::interrupt]
#[unsafe(link_section = ".ccm.motion_loop")]
fn CORDIC() {
    // SAFETY: written before the interrupt is enabled; not used elsewhere from then on.
    unsafe { (*OUTER.0.get()).assume_init_mut() }.tick();
}
