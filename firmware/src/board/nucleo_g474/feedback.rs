//! Feedback of the motor: phase currents and bus voltage from ADC1, the rotor angle from an AS5047P on SPI1.
//!
//! Four injected conversions follow TIM1's trigger, the currents first, while all low sides are on ([`SAMPLED_US`]).
//!
//! One SPI frame at 10 MHz is started in each PWM period and read in the next: the interrupt does not wait for it.

use core::iter::repeat;
use core::mem::forget;

use embassy_stm32::adc::{Adc, AdcChannel, AdcConfig, Exten, InjectedAdc, SampleTime};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::spi::{self, MODE_1, Spi};
use embassy_stm32::triggers::TIM1_TRGO2;
use embassy_stm32::{Peri, pac, peripherals};
use embedded_hal::spi::{ErrorKind, ErrorType, SpiBus};

use crate::board::selected::peripherals::bus_frequency;
use crate::board::selected::pwm::TRIGGER_LEAD_US;
use crate::config::constants;
use crate::motor::as5047::{As5047, PipelinedSpi};

/// Cycles of a conversion of 12 bits with a sampling time of 6.5, and the converter's clock in MHz.
const CONVERSION: f64 = 19.0;
const CLOCK_MHZ: f64 = 40.0;
/// From the trigger to the end of the sample of the third current.
const SAMPLED_US: f64 = (2.0 * CONVERSION + 6.5) / CLOCK_MHZ;
/// Half of the shortest time without a high side, before and after the middle of a period.
const WINDOW_US: f64 = 0.5 * (1.0 - constants::MODULATION.value) * 1e3 / constants::PWM_RATE.value;
// Its low side is on after the dead time, and its amplifier valid after having settled: before the first sample. The last sample
// ends before a high side switches.
const _: () = assert!(
    TRIGGER_LEAD_US + 1e-3 * constants::DEAD_TIME.value + constants::AMPLIFIER_SETTLING.value
        < WINDOW_US
);
const _: () = assert!(SAMPLED_US - TRIGGER_LEAD_US < WINDOW_US);

/// Analogue pins of phases U, V, W and of the bus voltage.
pub type AnalogPins = (
    Peri<'static, peripherals::PC0>,
    Peri<'static, peripherals::PC1>,
    Peri<'static, peripherals::PC2>,
    Peri<'static, peripherals::PC3>,
);

/// Injected conversions of phase currents and bus voltage.
pub struct PhaseCurrents(InjectedAdc<'static, peripherals::ADC1, 4>);

impl PhaseCurrents {
    /// Calibrates the converter and arms the trigger; the interrupt follows every fourth conversion.
    pub fn start(converter: Peri<'static, peripherals::ADC1>, inputs: AnalogPins) -> Self {
        let (u, v, w, bus) = inputs;
        let sequence = [
            (u.degrade_adc(), SampleTime::CYCLES6_5),
            (v.degrade_adc(), SampleTime::CYCLES6_5),
            (w.degrade_adc(), SampleTime::CYCLES6_5),
            (bus.degrade_adc(), SampleTime::CYCLES6_5),
        ];
        Self(Adc::new(converter, AdcConfig::default()).setup_injected_conversions(
            sequence,
            TIM1_TRGO2,
            Exten::RISING_EDGE,
            true,
        ))
    }

    /// Phase currents and bus voltage in counts; clears the interrupt.
    pub fn read(&mut self) -> ([u16; 3], u16) {
        let [u, v, w, bus] = self.0.read_injected_samples();
        ([u, v, w], bus)
    }
}

/// Age of the angle at the instant of current sampling, in PWM periods: the sensor samples it at the rising edge of its select, soon
/// after the currents (AS5047P datasheet, SPI timing), and the frame of that period returns it, which the next one reads. To
/// be confirmed on a board.
pub const ANGLE_AGE_PERIODS: f32 = 1.0;

/// SCK, MOSI, MISO, CS.
pub type SpiPins = (
    Peri<'static, peripherals::PA5>,
    Peri<'static, peripherals::PA7>,
    Peri<'static, peripherals::PA6>,
    Peri<'static, peripherals::PA4>,
);

/// The AS5047P.
pub type RotorSensor = As5047<SpiPort, Output<'static>>;

/// The AS5047P on its port; no frame is started yet.
pub fn rotor_sensor(port: Peri<'static, peripherals::SPI1>, pins: SpiPins) -> RotorSensor {
    let (clock, out, into, select) = pins;
    let mut config = spi::Config::default();
    config.mode = MODE_1;
    config.frequency = bus_frequency(10_000_000);
    // The driver library only configures the port: its waits have no limit.
    forget(Spi::new_blocking(port, clock, out, into, config));
    PORT.cr1().modify(|w| w.set_spe(false));
    PORT.cr2().modify(|w| {
        w.set_ds(pac::spi::vals::Ds::BITS16);
        w.set_frxth(pac::spi::vals::Frxth::HALF);
    });
    PORT.cr1().modify(|w| w.set_spe(true));
    As5047::new(SpiPort(()), Output::new(select, Level::High, Speed::VeryHigh))
}

const PORT: pac::spi::Spi = pac::SPI1;
/// Polls of a status bit until a frame counts as lost: more than 6 us, a frame takes 1.6 us.
const FRAME_POLLS: u32 = 1000;
/// Word sent while only receiving.
const IDLE_WORD: u16 = 0;

/// SPI1 with frames of one word, by register access: one frame of 16 bits, 1.6 us, at a time.
pub struct SpiPort(());

/// A frame has not ended in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTimeout;

impl embedded_hal::spi::Error for FrameTimeout {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl SpiPort {
    fn exchange(&mut self, word: u16) -> Result<u16, FrameTimeout> {
        // The word of a frame that has ended too late.
        self.take_received();
        self.start_frame(word);
        (0..FRAME_POLLS).find_map(|_| self.take_received()).ok_or(FrameTimeout)
    }
}

impl PipelinedSpi for SpiPort {
    fn start_frame(&mut self, word: u16) {
        PORT.dr16().write_value(word);
    }

    fn take_received(&mut self) -> Option<u16> {
        PORT.sr().read().rxne().then(|| PORT.dr16().read())
    }
}

impl ErrorType for SpiPort {
    type Error = FrameTimeout;
}

/// Blocking; each word takes at most [`FRAME_POLLS`].
impl SpiBus<u16> for SpiPort {
    fn read(&mut self, words: &mut [u16]) -> Result<(), FrameTimeout> {
        words.fill(IDLE_WORD);
        self.transfer_in_place(words)
    }

    fn write(&mut self, words: &[u16]) -> Result<(), FrameTimeout> {
        words.iter().try_for_each(|word| self.exchange(*word).map(drop))
    }

    fn transfer(&mut self, read: &mut [u16], write: &[u16]) -> Result<(), FrameTimeout> {
        let common = read.len().min(write.len());
        let words = write.iter().copied().chain(repeat(IDLE_WORD));
        for (received, word) in read.iter_mut().zip(words) {
            *received = self.exchange(word)?;
        }
        write.iter().skip(common).try_for_each(|word| self.exchange(*word).map(drop))
    }

    fn transfer_in_place(&mut self, words: &mut [u16]) -> Result<(), FrameTimeout> {
        words.iter_mut().try_for_each(|word| self.exchange(*word).map(|received| *word = received))
    }

    fn flush(&mut self) -> Result<(), FrameTimeout> {
        let has_ended = (0..FRAME_POLLS).any(|_| !PORT.sr().read().bsy());
        if has_ended { Ok(()) } else { Err(FrameTimeout) }
    }
}
