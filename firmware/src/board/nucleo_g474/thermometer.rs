//! Temperatures: thermistors of motor and power stage at ADC3, the chip's own sensor at ADC5. Regular conversions by software,
//! apart from the motor's converter.

use embassy_stm32::adc::{Adc, AdcConfig, SampleTime, Temperature};
use embassy_stm32::{Peri, peripherals};

use crate::board::Thermometer;
use crate::motor::limits::Temperatures;
use crate::sensors::thermistor;
use crate::tasks::temperatures::BoardTemperatures;

/// Sampling: 640.5 cycles of 40 MHz are 16 us, for the 5 kOhm of a thermistor with its pull-up, and for the chip's sensor,
/// which needs several microseconds.
const SAMPLING: SampleTime = SampleTime::CYCLES640_5;
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
    thermistors: Adc<'static, peripherals::ADC3>,
    motor: Peri<'static, peripherals::PB1>,
    stage: Peri<'static, peripherals::PB0>,
    chip: Adc<'static, peripherals::ADC5>,
    chip_sensor: Temperature,
}

impl BoardThermometer {
    /// Calibrates both converters.
    pub fn new(parts: Parts) -> Self {
        let thermistors = Adc::new(parts.thermistors, AdcConfig::default());
        let chip = Adc::new(parts.chip, AdcConfig::default());
        let chip_sensor = chip.enable_temperature();
        Self { thermistors, motor: parts.motor, stage: parts.stage, chip, chip_sensor }
    }
}

impl Thermometer for BoardThermometer {
    fn measure(&mut self) -> BoardTemperatures {
        let motor = self.thermistors.blocking_read(&mut self.motor, SAMPLING);
        let stage = self.thermistors.blocking_read(&mut self.stage, SAMPLING);
        let chip = self.chip.blocking_read(&mut self.chip_sensor, SAMPLING);
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
