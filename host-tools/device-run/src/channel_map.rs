//! Columns of a recording as the device's sensor readings and covariates.

use std::f64::consts::{PI, TAU};

use firmware::compensation::covariates::{
    AccelerationSample, AttitudeSample, Covariates, MotorSample,
};
use firmware::config::constants;
use firmware::sensors::hall::{HallReading, a31301};
use model_export::effects::REFERENCE_C;
use model_export::fit::rows::ForcePair;
use model_export::recordings::columns::{Axis, COVARIATES, ChannelLayout, ForceColumn, HallColumn};
use model_export::recordings::description::NominalDesign;
use model_export::recordings::stream::RawRow;

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
    /// Indices of the forces of its model: Fx, Fz; `None` for one that was not measured.
    pub forces: [Option<usize>; 2],
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
    /// Channels of those sensors in `numbers` whose field and forces were recorded; `forces` are those of the model of each.
    pub fn find(numbers: &[u32], forces: &[ForcePair], layout: &ChannelLayout) -> Vec<Self> {
        let channel = |(sensor, axis): (u32, Axis)| {
            let wanted = ForceColumn::Force { sensor, axis };
            layout.forces.iter().position(|column| *column == wanted)
        };
        let sensors = numbers.iter().zip(forces).enumerate();
        let channels = sensors.filter_map(|(table, (&number, pair))| {
            let forces = pair.map(|force| force.and_then(channel));
            let recorded = forces.iter().flatten().count();
            if recorded == 0 || recorded < pair.iter().flatten().count() {
                return None;
            }
            Some(Self {
                table,
                number,
                field: layout.field_channels(number)?,
                temperature: layout.hall.iter().position(|column| {
                    matches!(column, HallColumn::Temperature { sensor } if *sensor == number)
                }),
                forces,
            })
        });
        channels.collect()
    }

    pub fn field_g(&self, row: &RawRow) -> [f64; 3] {
        self.field.map(|channel| row.hall[channel])
    }

    /// Forces in a row in newtons; NaN for one that was not measured.
    pub fn force_n(&self, row: &RawRow) -> [f64; 2] {
        self.forces.map(|channel| channel.map_or(f64::NAN, |channel| row.forces[channel]))
    }

    /// Temperature word in a row; zero where the temperature was not recorded.
    pub fn temperature(&self, row: &RawRow) -> i16 {
        // The recording's degrees were made from counts with the same scale, so its true value cancels.
        self.temperature.map_or(0, |channel| temperature_counts(row.hall[channel] - REFERENCE_C))
    }

    /// Reading in a row, through the bytes on the sensor's bus.
    pub fn reading(&self, row: &RawRow, gauss_per_lsb: f64) -> HallReading {
        self.reading_of(self.field_g(row), row, gauss_per_lsb)
    }

    /// Reading of another field in gauss in a row.
    pub fn reading_of(&self, field_g: [f64; 3], row: &RawRow, gauss_per_lsb: f64) -> HallReading {
        let field = field_g.map(|gauss| field_counts(gauss, gauss_per_lsb));
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
    pole_pairs: u8,
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
                .and_then(NominalDesign::pole_pairs)
                .unwrap_or(constants::POLE_PAIRS.value) as u8,
        }
    }

    /// Covariates of a row, rounded as on the device's serial line.
    pub fn at(&self, row: &RawRow) -> Covariates {
        let milli = |channel: usize| (1e3 * row.hall[channel]).round() as i32;
        Covariates {
            opening_um: self.opening.map(milli),
            motor: self.motor.map(|(iq, angle)| MotorSample {
                age_us: 0,
                // The cast saturates.
                iq_ma: (1e3 * row.hall[iq]).round() as i16,
                // A whole turn is 0.
                turn: ((row.hall[angle] / TAU).rem_euclid(1.0) * 65_536.0).round() as u32 as u16,
            }),
            acceleration: self
                .acceleration
                .map(|channels| AccelerationSample { age_us: 0, mm_s2: channels.map(milli) }),
            attitude: self.attitude.map(|channels| AttitudeSample {
                age_ms: 0,
                euler: channels.map(|channel| euler_counts(row.hall[channel])),
            }),
        }
    }

    /// Pole pairs of the motor, for [`Covariates::inputs`].
    pub fn pole_pairs(&self) -> u8 {
        self.pole_pairs
    }
}

/// Values of [`COVARIATES`] that the device has sent, in their order; `None` where it had none.
pub fn covariate_values(covariates: &Covariates) -> [Option<f64>; COVARIATES.len()] {
    let milli = |value: i32| 1e-3 * f64::from(value);
    let [ax, ay, az] = three(covariates.acceleration.map(|sample| sample.mm_s2.map(milli)));
    let [roll, pitch, yaw] =
        three(covariates.attitude.map(|sample| sample.radians().map(f64::from)));
    [
        covariates.opening_um.map(milli),
        covariates.motor.map(|motor| milli(motor.iq_ma.into())),
        covariates.motor.map(|motor| turn_rad(motor.turn)),
        ax,
        ay,
        az,
        roll,
        pitch,
        yaw,
    ]
}

/// Angle in radians as [`AttitudeSample::euler`], within half a turn.
pub fn euler_counts(radians: f64) -> i16 {
    let within = (radians + PI).rem_euclid(TAU) - PI;
    (within * f64::from(AttitudeSample::PER_RAD)).round() as i16
}

/// Rotor angle in radians, 0 to 2 pi, from 2^-16 turns.
pub fn turn_rad(turn: u16) -> f64 {
    f64::from(turn) / 65_536.0 * TAU
}

fn three(values: Option<[f64; 3]>) -> [Option<f64>; 3] {
    values.map_or([None; 3], |values| values.map(Some))
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::recordings::description::NominalDesign;

    #[test]
    fn covariates_survive_their_columns() {
        let covariates = Covariates {
            opening_um: Some(40_123),
            motor: Some(MotorSample { age_us: 0, iq_ma: -2500, turn: 0xC001 }),
            acceleration: Some(AccelerationSample { age_us: 0, mm_s2: [10, -20, 9807] }),
            attitude: Some(AttitudeSample { age_ms: 0, euler: [1000, -15_000, 31_000] }),
        };
        let names =
            COVARIATES.iter().map(|name| HallColumn::Covariate { name: (*name).to_owned() });
        let layout = ChannelLayout { hall: names.collect(), forces: Vec::new() };
        let channels = CovariateChannels::find(&layout, Some(&NominalDesign::magpie()));
        // As the recorder writes them.
        let texts = covariate_values(&covariates).map(|value| format!("{:.5}", value.unwrap()));
        let hall = texts.map(|text| text.parse().unwrap()).to_vec();
        let row = RawRow { time_s: 0.0, hall, forces: Vec::new() };
        assert_eq!(channels.at(&row), covariates);
        assert_eq!(covariate_values(&Covariates::default()), [None; COVARIATES.len()]);
    }

    #[test]
    fn field_out_of_range_saturates_and_does_not_wrap() {
        let channels = SensorChannels {
            table: 0,
            number: 0,
            field: [0, 1, 2],
            temperature: None,
            forces: [Some(0), Some(1)],
        };
        let row = RawRow { time_s: 0.0, hall: vec![2100.0, -2100.0, 0.25], forces: Vec::new() };
        assert_eq!(channels.reading(&row, 0.125).field, [16383, -16384, 2]);
    }
}
