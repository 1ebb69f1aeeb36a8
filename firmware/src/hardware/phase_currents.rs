//! The phases' currents and the bus voltage: four injected conversions of ADC1 on TIM1's trigger, 0.48 us
//! each, the currents first. All low sides are on from at least 1.2 us before the trigger to 1.2 us after it:
//! the third current's sample ends 1.1 us after.

use embassy_stm32::adc::{Adc, AdcChannel, AdcConfig, Exten, InjectedAdc, SampleTime};
use embassy_stm32::triggers::TIM1_TRGO2;
use embassy_stm32::{Peri, peripherals};

/// Phases U, V, W and the bus.
pub type Inputs = (
    Peri<'static, peripherals::PC0>,
    Peri<'static, peripherals::PC1>,
    Peri<'static, peripherals::PC2>,
    Peri<'static, peripherals::PC3>,
);

/// The conversions.
pub struct PhaseCurrents(InjectedAdc<'static, peripherals::ADC1, 4>);

impl PhaseCurrents {
    /// Calibrates the converter and waits for triggers; at the end of each four conversions it raises its
    /// interrupt.
    pub fn start(converter: Peri<'static, peripherals::ADC1>, inputs: Inputs) -> Self {
        let (u, v, w, bus) = inputs;
        let sequence = [
            (u.degrade_adc(), SampleTime::CYCLES6_5),
            (v.degrade_adc(), SampleTime::CYCLES6_5),
            (w.degrade_adc(), SampleTime::CYCLES6_5),
            (bus.degrade_adc(), SampleTime::CYCLES6_5),
        ];
        Self(
            Adc::new(converter, AdcConfig::default()).setup_injected_conversions(
                sequence,
                TIM1_TRGO2,
                Exten::RISING_EDGE,
                true,
            ),
        )
    }

    /// The phases and the bus in counts; ends the interrupt.
    pub fn take(&mut self) -> ([u16; 3], u16) {
        let [u, v, w, bus] = self.0.read_injected_samples();
        ([u, v, w], bus)
    }
}
