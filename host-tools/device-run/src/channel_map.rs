//! Columns of a recording as the device's sensor readings and covariates.

use firmware::compensation::auxiliary_inputs::{Attitude, AuxiliaryInputs, MotorInputs};
use firmware::config::constants;
use firmware::sensors::hall::{HallReading, a31301};
use model_export::effects::REFERENCE_C;
use model_export::recordings::columns::{Axis, ChannelLayout, ForceColumn, HallColumn};
use model_export::recordings::description::NominalDesign;
use model_export::recordings::stream::RawRow;
use nalgebra::Rotation3;

/// Channels of one sensor in a row.
#[derive(Clone, Debug)]
pub struct SensorChannels {
    /// Index of the sensor's table.
    pub table: usize,
    /// Number of the sensor.
    pub number: u32,
    /// Channels of its field: x, y, z.
    pub field: [usize; 3],
    /// Channel of its temperature.
    pub temperature: Option<usize>,
    /// Indices of its forces: Fx, Fz.
    pub forces: [usize; 2],
}

/// Field in gauss as the sensor's word; saturates at the ends of the range.
pub fn field_counts(gauss: f64, gauss_per_lsb: f64) -> i16 {
    let (min, max) = a31301::FIELD_LIMITS;
    let counts = (gauss / gauss_per_lsb).round();
    counts.clamp(f64::from(min), f64::from(max)) as i16
}

/// Temperature above [`REFERENCE_C`] in kelvin as the sensor's word.
pub fn temperature_counts(warmer_k: f64) -> i16 {
    (warmer_k * constants::TEMPERATURE_SCALE.value).round() as i16
}

impl SensorChannels {
    /// Channels of those sensors in `numbers` whose field and both forces were recorded.
    pub fn find(numbers: &[u32], layout: &ChannelLayout) -> Vec<Self> {
        let force = |place: u32, axis: Axis| {
            let wanted = ForceColumn::Force { sensor: place, axis };
            layout.forces.iter().position(|column| *column == wanted)
        };
        let channels = numbers.iter().enumerate().filter_map(|(table, &number)| {
            Some(Self {
                table,
                number,
                field: layout.field_channels(number)?,
                temperature: layout.hall.iter().position(|column| {
                    matches!(column, HallColumn::Temperature { sensor } if *sensor == number)
                }),
                forces: [force(number, Axis::X)?, force(number, Axis::Z)?],
            })
        });
        channels.collect()
    }

    /// Field in a row, in gauss.
    pub fn field_g(&self, row: &RawRow) -> [f64; 3] {
        self.field.map(|channel| row.hall[channel])
    }

    /// Temperature word in a row; zero where the temperature was not recorded.
    pub fn temperature(&self, row: &RawRow) -> i16 {
        // The recording's degrees were made from counts with the same scale, so its true value cancels.
        self.temperature.map_or(0, |channel| temperature_counts(row.hall[channel] - REFERENCE_C))
    }

    /// Reading in a row, through the bytes on the sensor's bus.
    pub fn reading(&self, row: &RawRow, gauss_per_lsb: f64) -> HallReading {
        let field = self.field_g(row).map(|gauss| field_counts(gauss, gauss_per_lsb));
        let temperature = self.temperature(row);
        a31301::decode(a31301::encode(HallReading { field, temperature }))
    }
}

/// Channels of the covariates in a row.
#[derive(Clone, Copy, Debug)]
pub struct CovariateChannels {
    opening: Option<usize>,
    motor: Option<(usize, usize)>,
    acceleration: Option<[usize; 3]>,
    attitude: Option<[usize; 3]>,
    pole_pairs: f64,
}

impl CovariateChannels {
    /// Channels of the covariates that were recorded.
    pub fn find(layout: &ChannelLayout, design: Option<&NominalDesign>) -> Self {
        let at = |wanted: &str| {
            layout.hall.iter().position(
                |column| matches!(column, HallColumn::Covariate { name } if name == wanted),
            )
        };
        let three = |names: [&str; 3]| {
            let [x, y, z] = names.map(at);
            Some([x?, y?, z?])
        };
        Self {
            opening: at("opening_mm"),
            motor: at("motor_iq_a").zip(at("motor_angle_rad")),
            acceleration: three(["accel_x_mps2", "accel_y_mps2", "accel_z_mps2"]),
            attitude: three(["roll_rad", "pitch_rad", "yaw_rad"]),
            pole_pairs: design
                .and_then(|design| design.number("motor_pole_pairs"))
                .unwrap_or(constants::POLE_PAIRS.value),
        }
    }

    /// Covariates of a row in the device's units.
    pub fn at(&self, row: &RawRow) -> AuxiliaryInputs {
        let milli = |channel: usize| (1e3 * row.hall[channel]).round() as i32;
        AuxiliaryInputs {
            opening_um: self.opening.map(milli),
            motor: self.motor.map(|(iq, angle)| {
                let mechanical = row.hall[angle];
                let (sin, cos) = (self.pole_pairs * mechanical).sin_cos();
                let q15 = |share: f64| (share * f64::from(1 << 15)).round() as i32;
                let turn = mechanical.rem_euclid(std::f64::consts::TAU);
                MotorInputs {
                    iq_ma: milli(iq),
                    electrical: [q15(sin), q15(cos)],
                    angle_urad: (1e6 * turn).round() as i32,
                }
            }),
            acceleration: self.acceleration.map(|channels| channels.map(milli)),
            attitude: self.attitude.map(|[roll, pitch, yaw]| {
                let rotation =
                    Rotation3::from_euler_angles(row.hall[roll], row.hall[pitch], row.hall[yaw]);
                let one = f64::from(1 << Attitude::BITS);
                let entry = |i: usize, j: usize| (rotation[(i, j)] * one).round() as i32;
                Attitude { to_world: [0, 1, 2].map(|i| [0, 1, 2].map(|j| entry(i, j))) }
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_out_of_range_saturates_and_does_not_wrap() {
        let channels = SensorChannels {
            table: 0,
            number: 0,
            field: [0, 1, 2],
            temperature: None,
            forces: [0, 1],
        };
        let row = RawRow { time_s: 0.0, hall: vec![2100.0, -2100.0, 0.25], forces: Vec::new() };
        assert_eq!(channels.reading(&row, 0.125).field, [16383, -16384, 2]);
    }
}
