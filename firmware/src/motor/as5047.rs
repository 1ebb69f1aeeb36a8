//! AS5047P, a magnetic angle sensor: 14 bits, absolute, 16-bit SPI in mode 1 up to 10 MHz. A frame contains the answer
//! to the previous one. That this sensor is on the rotor is assumed; the paper names none.
//!
//! The driver uses the traits of `embedded-hal`: [`SpiBus`] with words of 16 bits, [`OutputPin`] for the chip select and
//! [`DelayNs`]. One operation has no such trait: the control interrupt starts the frame of one PWM period and reads its
//! answer in the next ([`PipelinedSpi`]). A transfer of [`SpiBus`] returns the words received and therefore waits for the
//! end of the frame: 1.6 us in every period of 50 us, at the highest priority.

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::OutputPin;
use embedded_hal::spi::SpiBus;

use crate::motor::power_stage::{Encoder, EncoderError};

/// Command to read the angle with compensation of the sensor's delay (ANGLECOM, 0x3FFF).
pub const READ_ANGLE: u16 = read_command(0x3FFF);
/// Command to read the error register (ERRFL), which clears it.
const READ_ERRORS: u16 = read_command(0x0001);
/// Command to read the strength of the magnet and the gain (DIAAGC).
const READ_DIAGNOSIS: u16 = read_command(0x3FFC);
/// Command without effect (NOP), to receive the answer to the previous one.
const NO_OPERATION: u16 = read_command(0x0000);
/// Error bit of an answer: a previous command frame was invalid.
const ERROR: u16 = 1 << 14;
/// Data bits of an answer.
pub const DATA: u16 = 0x3FFF;

/// Time from an edge of the chip select to the next edge or clock, in nanoseconds: 350, and a microsecond by which a clock that counts
/// these may end a delay early.
const SELECT_NS: u32 = 1350;
/// Time from power-up to the first valid answer in milliseconds.
const POWER_UP_MS: u32 = 10;
/// Attempts of [`As5047::start`].
const START_ATTEMPTS: u8 = 3;

/// Command to read a register: parity, read, address.
const fn read_command(address: u16) -> u16 {
    with_parity(1 << 14 | address)
}

/// Sets bit 15 for even parity.
const fn with_parity(word: u16) -> u16 {
    word | ((word.count_ones() as u16 & 1) << 15)
}

/// The data of an answer: the angle after [`READ_ANGLE`]. A data line stuck high is a silent sensor; one stuck low reads
/// as angle zero and is detected as a jump ([`super::encoder`]) or a stuck sensor ([`super::diagnostics`]).
pub const fn angle(answer: u16) -> Result<u16, EncoderError> {
    if answer == u16::MAX {
        Err(EncoderError::Silent)
    } else if answer.count_ones() % 2 == 1 {
        Err(EncoderError::Checksum)
    } else if answer & ERROR != 0 {
        Err(EncoderError::ErrorFlag)
    } else {
        Ok(answer & DATA)
    }
}

/// Bits of DIAAGC: automatic gain, and what is wrong.
pub mod diagnosis {
    /// Gain, 0 for a strong field, 255 for none.
    pub const GAIN: u16 = 0xFF;
    /// The offsets are compensated.
    pub const READY: u16 = 1 << 8;
    /// The field is too strong or too weak, or the angle overflows.
    pub const WRONG: u16 = 0b1110 << 8;
}

/// Answer of a working sensor, for simulations.
pub const fn answer(angle: u16) -> u16 {
    with_parity(angle & DATA)
}

/// An SPI bus on which a frame of one word can be started without waiting for its end.
pub trait PipelinedSpi: SpiBus<u16> {
    /// Starts a frame; the previous one has ended.
    fn start_frame(&mut self, word: u16);

    /// Removes the word received in the last frame; `None` before its end.
    fn take_received(&mut self) -> Option<u16>;
}

/// Driver of the sensor.
#[derive(Debug)]
pub struct As5047<B, C> {
    bus: B,
    select: C,
    /// Answers to be discarded while the error register is read, which clears it.
    discarded: u8,
}

/// Answers after an error flag that are no angle: the one that was requested meanwhile, and the error register.
const DISCARDED: u8 = 2;

impl<B: SpiBus<u16>, C: OutputPin> As5047<B, C> {
    /// Driver on a bus with a chip select that is high; no access yet.
    pub const fn new(bus: B, select: C) -> Self {
        Self { bus, select, discarded: 0 }
    }

    /// Checks the communication and clears the error register: a reset of the chip within a frame leaves an error that
    /// every later answer would report. Writes no register: the angle is compensated by default. Waits at most 20 ms.
    ///
    /// # Errors
    /// That of the last attempt.
    pub fn start<D: DelayNs>(&mut self, delay: &mut D) -> Result<(), EncoderError> {
        let mut result = self.clear_errors(delay);
        for _ in 1..START_ATTEMPTS {
            if result.is_ok() {
                break;
            }
            delay.delay_ms(POWER_UP_MS);
            result = self.clear_errors(delay);
        }
        result
    }

    fn clear_errors<D: DelayNs>(&mut self, delay: &mut D) -> Result<(), EncoderError> {
        // Contains the answer to a command before.
        self.transfer_frame(READ_ERRORS, delay)?;
        match angle(self.transfer_frame(NO_OPERATION, delay)?)? {
            0 => Ok(()),
            _ => Err(EncoderError::ErrorFlag),
        }
    }

    /// Strength of the magnet and gain ([`diagnosis`]). Waits some microseconds.
    ///
    /// # Errors
    /// No valid answer.
    pub fn diagnose<D: DelayNs>(&mut self, delay: &mut D) -> Result<u16, EncoderError> {
        self.transfer_frame(READ_DIAGNOSIS, delay)?;
        angle(self.transfer_frame(NO_OPERATION, delay)?)
    }

    /// Sends a command and waits for the end of its frame.
    fn transfer_frame<D: DelayNs>(
        &mut self,
        command: u16,
        delay: &mut D,
    ) -> Result<u16, EncoderError> {
        let mut frame = [command];
        delay.delay_ns(SELECT_NS);
        self.select.set_low().map_err(|_| EncoderError::Silent)?;
        delay.delay_ns(SELECT_NS);
        let transferred = self.bus.transfer_in_place(&mut frame).and_then(|()| self.bus.flush());
        // After an error as well: the next frame begins with the edge of the chip select.
        self.select.set_high().map_err(|_| EncoderError::Silent)?;
        let [answer] = frame;
        transferred.map(|()| answer).map_err(|_| EncoderError::Silent)
    }
}

/// Angle in the control interrupt, once per PWM period: [`Encoder::angle`], [`Self::select`], [`Self::start_frame`].
impl<B: PipelinedSpi, C: OutputPin> As5047<B, C> {
    /// Asserts the chip select; the sensor needs 350 ns until [`Self::start_frame`].
    ///
    /// # Errors
    /// Errors of the pin.
    pub fn select(&mut self) -> Result<(), C::Error> {
        self.select.set_low()
    }

    /// Starts the frame that requests the angle, or the error register after an error, and returns before its end.
    pub fn start_frame(&mut self) {
        let command = if self.discarded == DISCARDED { READ_ERRORS } else { READ_ANGLE };
        self.bus.start_frame(command);
    }
}

impl<B: PipelinedSpi, C: OutputPin> Encoder for As5047<B, C> {
    /// Deasserts the chip select and decodes the answer of the last frame. The error flag of the sensor stays set until its
    /// error register is read: three angles are missing then, which [`super::encoder::AngleTracker`] bridges.
    fn angle(&mut self) -> Result<u16, EncoderError> {
        self.select.set_high().map_err(|_| EncoderError::Silent)?;
        let answer = self.bus.take_received();
        if let Some(discarded) = self.discarded.checked_sub(1) {
            self.discarded = discarded;
            return Err(EncoderError::ErrorFlag);
        }
        let measured = answer.map_or(Err(EncoderError::Silent), angle);
        if measured == Err(EncoderError::ErrorFlag) {
            self.discarded = DISCARDED;
        }
        measured
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_match_the_datasheet() {
        assert_eq!([READ_ANGLE, READ_ERRORS, NO_OPERATION], [0xFFFF, 0x4001, 0xC000]);
        assert_eq!(with_parity(0), 0);
    }

    #[test]
    fn answer_of_a_working_sensor_round_trips() {
        for counts in 0..=DATA {
            assert_eq!(angle(answer(counts)), Ok(counts));
        }
    }

    #[test]
    fn answer_bits_decode_to_angle_or_error() {
        assert_eq!(angle(0x0003), Ok(3));
        assert_eq!(angle(0xA000), Ok(0x2000));
        assert_eq!(angle(0x3FFF), Ok(0x3FFF));
        assert_eq!(angle(0x0001), Err(EncoderError::Checksum));
        assert_eq!(angle(0xC000), Err(EncoderError::ErrorFlag));
        assert_eq!(angle(0xFFFF), Err(EncoderError::Silent));
    }

    /// Sensor that sets its error flag once.
    #[derive(Default)]
    struct FaultySensor {
        errors: u16,
        answer: u16,
        received: u16,
    }

    impl embedded_hal::spi::ErrorType for FaultySensor {
        type Error = core::convert::Infallible;
    }

    impl SpiBus<u16> for FaultySensor {
        fn read(&mut self, _: &mut [u16]) -> Result<(), Self::Error> {
            Ok(())
        }
        fn write(&mut self, _: &[u16]) -> Result<(), Self::Error> {
            Ok(())
        }
        fn transfer(&mut self, _: &mut [u16], _: &[u16]) -> Result<(), Self::Error> {
            Ok(())
        }
        fn transfer_in_place(&mut self, _: &mut [u16]) -> Result<(), Self::Error> {
            Ok(())
        }
        fn flush(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
    }

    impl PipelinedSpi for FaultySensor {
        fn start_frame(&mut self, word: u16) {
            self.received = self.answer;
            let flag = if self.errors == 0 { 0 } else { ERROR };
            self.answer = match word {
                READ_ERRORS => with_parity(core::mem::take(&mut self.errors) | flag),
                _ => with_parity(1234 | flag),
            };
        }

        fn take_received(&mut self) -> Option<u16> {
            Some(self.received)
        }
    }

    struct Pin;

    impl embedded_hal::digital::ErrorType for Pin {
        type Error = core::convert::Infallible;
    }

    impl OutputPin for Pin {
        fn set_low(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
        fn set_high(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
    }

    #[test]
    fn error_flag_is_cleared_within_four_periods_and_its_register_is_no_angle() {
        let mut sensor = As5047::new(FaultySensor::default(), Pin);
        let mut period = |errors: Option<u16>| {
            if let Some(errors) = errors {
                sensor.bus.errors = errors;
            }
            sensor.start_frame();
            sensor.angle().ok()
        };
        period(None);
        assert_eq!(period(None), Some(1234));
        let answers = [Some(1), None, None, None, None, None, None].map(&mut period);
        let good = Some(1234);
        assert_eq!(answers, [good, None, None, None, good, good, good]);
    }
}
