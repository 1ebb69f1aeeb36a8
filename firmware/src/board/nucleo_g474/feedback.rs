//! Feedback of the motor: phase currents and bus voltage from ADC1, the rotor angle from an AS5047P on SPI1.
//!
//! Four injected conversions follow TIM1's trigger, 0.48 us each, the currents first. All low sides are on from at least
//! 1.2 us before the trigger to 1.2 us after it: the sample of the third current ends 1.1 us after it.
//!
//! One SPI frame at 10 MHz is started in each PWM period and read in the next: nothing waits for it.

use core::mem::forget;

use embassy_stm32::adc::{Adc, AdcChannel, AdcConfig, Exten, InjectedAdc, SampleTime};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::spi::{self, MODE_1, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::triggers::TIM1_TRGO2;
use embassy_stm32::{Peri, pac, peripherals};

use crate::motor::as5047::{READ_ANGLE, angle};
use crate::motor::power_stage::{Encoder, EncoderError};

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

const PORT: pac::spi::Spi = pac::SPI1;
/// Age of the angle at the instant of current sampling, in PWM periods: one frame sends the request, the next returns the
/// angle, which is read one period later. Assumed, to be measured on a board.
pub const ANGLE_AGE_PERIODS: f32 = 2.0;

/// SCK, MOSI, MISO, CS.
pub type SpiPins = (
    Peri<'static, peripherals::PA5>,
    Peri<'static, peripherals::PA7>,
    Peri<'static, peripherals::PA6>,
    Peri<'static, peripherals::PA4>,
);

/// The AS5047P.
pub struct RotorSensor {
    select: Output<'static>,
}

impl RotorSensor {
    /// Configures the port; no frame is started yet.
    pub fn new(port: Peri<'static, peripherals::SPI1>, pins: SpiPins) -> Self {
        let (clock, out, into, select) = pins;
        let mut config = spi::Config::default();
        config.mode = MODE_1;
        config.frequency = Hertz(10_000_000);
        // The blocking driver only configures the port; afterwards its registers are used directly.
        forget(Spi::new_blocking(port, clock, out, into, config));
        PORT.cr1().modify(|w| w.set_spe(false));
        PORT.cr2().modify(|w| {
            w.set_ds(pac::spi::vals::Ds::BITS16);
            w.set_frxth(pac::spi::vals::Frxth::HALF);
        });
        PORT.cr1().modify(|w| w.set_spe(true));
        Self { select: Output::new(select, Level::High, Speed::VeryHigh) }
    }

    /// Asserts CS; the sensor needs 350 ns until [`Self::start_frame`].
    pub fn select(&mut self) {
        self.select.set_low();
    }

    /// Starts a frame, 1.6 us.
    pub fn start_frame(&mut self) {
        PORT.dr16().write_value(READ_ANGLE);
    }
}

impl Encoder for RotorSensor {
    /// The response of the last frame; deasserts CS.
    fn angle(&mut self) -> Result<u16, EncoderError> {
        self.select.set_high();
        if PORT.sr().read().rxne() { angle(PORT.dr16().read()) } else { Err(EncoderError::Silent) }
    }
}
