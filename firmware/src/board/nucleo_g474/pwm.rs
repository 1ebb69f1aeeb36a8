//! Power stage: three half bridges on TIM1 with complementary, centre-aligned PWM at 20 kHz, dead time, a break input that
//! switches off without software, and a trigger of the ADC in the middle of the period.
//!
//! A period is from one underflow of the counter to the next. The high sides are on around the underflow, the low sides
//! around the overflow, which is the middle of the period. New duties take effect at the underflow.
//!
//! After a break the outputs stay off until the motor controller has switched them off and on again.

use core::mem::forget;

use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull};
use embassy_stm32::pac::timer::vals::{Bkp, Cms, FilterValue, Lock, Mms, Mms2, Ocm, Ossi, Ossr};
use embassy_stm32::timer::complementary_pwm::ComplementaryPwmPin;
use embassy_stm32::timer::simple_pwm::PwmPin;
use embassy_stm32::{Peri, pac, peripherals, rcc};

use crate::config::constants;
use crate::motor::power_stage::{BridgeCommand, PowerStage};

/// Clock of the timer.
const CLOCK_HZ: f64 = 160e6;
/// Counts of half a period.
const PERIOD_COUNTS: u16 = (CLOCK_HZ / (2e3 * constants::PWM_RATE.value)) as u16;
/// Counts of the dead time; the register is linear up to 127.
const DEAD_TIME_COUNTS: u8 = (constants::DEAD_TIME.value * 1e-9 * CLOCK_HZ) as u8;
const _: () = assert!(DEAD_TIME_COUNTS < 128);
/// Counts from the trigger to the middle of the period.
const TRIGGER_LEAD: u16 = 8;
/// The same in microseconds.
pub const TRIGGER_LEAD_US: f64 = 1e6 * TRIGGER_LEAD as f64 / CLOCK_HZ;
const TIMER: pac::timer::TimAdv = pac::TIM1;
/// Alternate function of the break input.
const BREAK_AF: u8 = 6;

/// Pins of the half bridges.
pub struct Pins {
    /// High sides of U, V, W.
    pub high: (
        Peri<'static, peripherals::PA8>,
        Peri<'static, peripherals::PA9>,
        Peri<'static, peripherals::PA10>,
    ),
    /// Low sides of U, V, W.
    pub low: (
        Peri<'static, peripherals::PB13>,
        Peri<'static, peripherals::PB14>,
        Peri<'static, peripherals::PB15>,
    ),
    /// Break input: low on a fault of gate drivers or comparators, and with an open wire. The stage must pull it high with at
    /// most 4.7 kilohm, against the chip's pull-down of 25 to 55 kilohm: 47 kilohm never reach the threshold.
    pub stop: Peri<'static, peripherals::PB12>,
}

/// Power stage on TIM1.
pub struct Stage {
    is_on: bool,
}

impl Stage {
    /// Starts the timer with all switches off.
    pub fn start(_timer: Peri<'static, peripherals::TIM1>, pins: Pins) -> Self {
        rcc::enable_and_reset::<peripherals::TIM1>();
        configure();
        connect(pins);
        TIMER.cr1().modify(|w| w.set_cen(true));
        Self { is_on: false }
    }

    /// Level of the break input: true if the power stage is ready.
    pub fn is_ready() -> bool {
        pac::GPIOB.idr().read().idr(12) == pac::gpio::vals::Idr::HIGH
    }

    /// Whether a fault of the chip, such as a low supply, has switched the outputs off since the stage was last switched on.
    pub fn was_broken_by_chip() -> bool {
        TIMER.sr().read().sbif()
    }

    /// Whether the break input has switched the outputs off since the stage was last switched on.
    pub fn is_broken(&self) -> bool {
        self.is_on && !TIMER.bdtr().read().moe()
    }

    fn set_duties(&mut self, [u, v, w]: [f32; 3]) {
        // The cast saturates; NaN gives zero.
        let counts = |duty: f32| ((duty * f32::from(PERIOD_COUNTS)) as u16).min(PERIOD_COUNTS);
        // Constant channel numbers need no check at run time.
        TIMER.ccr(0).write(|to| to.set_ccr(counts(u)));
        TIMER.ccr(1).write(|to| to.set_ccr(counts(v)));
        TIMER.ccr(2).write(|to| to.set_ccr(counts(w)));
    }

    /// Switches the outputs off from outside of the current loop, which then reports a break of the stage.
    pub fn break_off() {
        TIMER.bdtr().modify(|w| w.set_moe(false));
    }

    fn switch(&mut self, on: bool) {
        if self.is_on != on {
            if on {
                // A break by the supply, the flash or the core leaves SBIF, which "must be reset to re-start PWM operation" (RM0440
                // 28.6.6; ST's __HAL_TIM_CLEAR_FLAG). Flags are cleared by zeros. One whose cause lasts stays, and so does
                // MOE = 0: the next period reads it back.
                TIMER.sr().write(|w| {
                    w.0 = u32::MAX;
                    w.set_bif(0, false);
                    w.set_bif(1, false);
                    w.set_sbif(false);
                });
            }
            TIMER.bdtr().modify(|w| w.set_moe(on));
            self.is_on = on;
        }
    }
}

impl PowerStage for Stage {
    /// `Off` takes effect at once, all else from the next period on. After `Off` the low sides are on until then.
    fn drive(&mut self, drive: BridgeCommand) {
        match drive {
            BridgeCommand::Off => {
                self.switch(false);
                self.set_duties([0.0; 3]);
            }
            BridgeCommand::Brake => {
                self.set_duties([0.0; 3]);
                self.switch(true);
            }
            BridgeCommand::Duty(duties) => {
                self.set_duties(duties);
                self.switch(true);
            }
        }
    }
}

fn configure() {
    TIMER.cr1().modify(|w| {
        w.set_cms(Cms::CENTER_ALIGNED1);
        w.set_arpe(true);
    });
    TIMER.arr().write(|w| w.set_arr(PERIOD_COUNTS));
    // Update at every second counter event: set before the start, this is the underflow.
    TIMER.rcr().write(|w| w.set_rep(1));
    for channel in 0..3 {
        TIMER.ccmr_output(channel / 2).modify(|w| {
            w.set_ocm(channel % 2, Ocm::PWM_MODE1);
            w.set_ocpe(channel % 2, true);
        });
    }
    // Channel 4 has no pin: its reference rises shortly before the middle.
    TIMER.ccmr_output(1).modify(|w| {
        w.set_ocm(1, Ocm::PWM_MODE2);
        w.set_ocpe(1, true);
    });
    TIMER.ccr(3).write(|w| w.set_ccr(PERIOD_COUNTS - TRIGGER_LEAD));
    // The currents in the middle of a period, the temperatures at its beginning.
    TIMER.cr2().modify(|w| {
        w.set_mms2(Mms2::COMPARE_OC4);
        w.set_mms(Mms::UPDATE);
    });
    TIMER.ccer().modify(|w| {
        for channel in 0..3 {
            w.set_cce(channel, true);
            w.set_ccne(channel, true);
        }
    });
    TIMER.egr().write(|w| w.set_ug(true));
    // Off: the timer drives all six pins low. Locked bits stay until a reset.
    TIMER.bdtr().write(|w| {
        w.set_dtg(DEAD_TIME_COUNTS);
        w.set_ossi(Ossi::IDLE_LEVEL);
        w.set_ossr(Ossr::IDLE_LEVEL);
        w.set_bkp(0, Bkp::ACTIVE_LOW);
        w.set_bkf(0, FilterValue::FCK_INT_N8);
        w.set_bke(0, true);
        w.set_lock(Lock::LEVEL1);
    });
}

/// Assigns the pins to the timer. They are forgotten because dropping them would release them.
fn connect(pins: Pins) {
    let mut stop = Flex::new(pins.stop);
    stop.set_as_af_unchecked(BREAK_AF, AfType::input(Pull::Down));
    forget(stop);
    let push = OutputType::PushPull;
    let (u, v, w) = pins.high;
    forget((
        PwmPin::<peripherals::TIM1, _>::new(u, push),
        PwmPin::<peripherals::TIM1, _>::new(v, push),
        PwmPin::<peripherals::TIM1, _>::new(w, push),
    ));
    let (u, v, w) = pins.low;
    forget((
        ComplementaryPwmPin::<peripherals::TIM1, _>::new(u, push),
        ComplementaryPwmPin::<peripherals::TIM1, _>::new(v, push),
        ComplementaryPwmPin::<peripherals::TIM1, _>::new(w, push),
    ));
}
