//! Temperatures: thermistors of motor and power stage at ADC3, the chip's own sensor at ADC5. Each PWM period converts them
//! from its beginning on, triggered by TIM1: they end before ADC1 samples the currents, which simultaneous conversions would
//! disturb (ES0430 2.7.11), and no pause reaches the millisecond after which a conversion is wrong (ES0430 2.7.9).

use embassy_stm32::adc::{Adc, AdcChannel, AdcConfig, Exten, InjectedAdc, SampleTime};
use embassy_stm32::triggers::TIM1_TRGO;
use embassy_stm32::{Peri, peripherals};

use crate::board::Thermometer;
use crate::config::constants::PWM_RATE;
use crate::motor::limits::Temperatures;
use crate::sensors::thermistor;
use crate::tasks::temperatures::BoardTemperatures;

/// Sampling for 6.2 us: enough for the 5 kOhm of a thermistor with its pull-up, and for the chip's sensor, which needs 5 us.
const SAMPLING: SampleTime = SampleTime::CYCLES247_5;
/// Conversions of ADC3 in microseconds: two of 260 cycles of 40 MHz, in the first half of a period.
const CONVERSIONS_US: f64 = 2.0 * 260.0 / 40.0;
const _: () = assert!(CONVERSIONS_US < 0.8 * 0.5 * 1e3 / PWM_RATE.value);
/// Factory calibration of the chip's sensor at 30 and 130 degrees Celsius, with a reference of 3.0 V (datasheet, table 5).
const CALIBRATION_30_C: *const u16 = 0x1FFF_75A8 as *const u16;
const CALIBRATION_130_C: *const u16 = 0x1FFF_75CA as *const u16;
/// Reference of the board relative to that of the calibration.
const REFERENCE: f32 = 3.3 / 3.0;

/// Converters and pins.
pub struct Parts {
    /// Converter of the thermistors.
    pub thermistors: Peri<'static, peripherals::ADC3>,
    /// Thermistor of the motor.
    pub motor: Peri<'static, peripherals::PB1>,
    /// Thermistor of the power stage.
    pub stage: Peri<'static, peripherals::PB0>,
    /// Converter of the chip's own sensor.
    pub chip: Peri<'static, peripherals::ADC5>,
}

/// The temperature sensors.
pub struct BoardThermometer {
    thermistors: InjectedAdc<'static, peripherals::ADC3, 2>,
    chip: InjectedAdc<'static, peripherals::ADC5, 1>,
}

impl BoardThermometer {
    /// Calibrates both converters and arms their triggers.
    pub fn new(parts: Parts) -> Self {
        let edge = Exten::RISING_EDGE;
        let inputs = [(parts.motor.degrade_adc(), SAMPLING), (parts.stage.degrade_adc(), SAMPLING)];
        let thermistors = Adc::new(parts.thermistors, AdcConfig::default());
        let chip = Adc::new(parts.chip, AdcConfig::default());
        let sensor = [(chip.enable_temperature().degrade_adc(), SAMPLING)];
        Self {
            thermistors: thermistors.setup_injected_conversions(inputs, TIM1_TRGO, edge, false),
            chip: chip.setup_injected_conversions(sensor, TIM1_TRGO, edge, false),
        }
    }
}

impl Thermometer for BoardThermometer {
    fn measure(&mut self) -> BoardTemperatures {
        let [motor, stage] = self.thermistors.read_injected_samples();
        let [chip] = self.chip.read_injected_samples();
        BoardTemperatures {
            mcu: chip_celsius(chip),
            motor: Temperatures {
                motor: thermistor::celsius(motor),
                stage: thermistor::celsius(stage),
            },
        }
    }
}

/// Temperature of the chip; `None` without a calibration.
fn chip_celsius(counts: u16) -> Option<f32> {
    // SAFETY: half words of the system memory, which every chip of this line has.
    #[allow(unsafe_code)]
    let [cold, hot] =
        unsafe { [CALIBRATION_30_C.read_volatile(), CALIBRATION_130_C.read_volatile()] }
            .map(f32::from);
    let span = hot - cold;
    (span > 0.0).then(|| 30.0 + 100.0 * (f32::from(counts) * REFERENCE - cold) / span)
}
