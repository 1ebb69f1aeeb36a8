//! What the board would know beside its fields, from a recording's covariates.

use firmware::params;
use firmware::surroundings::{Attitude, Motor, Surroundings};
use model_export::recordings::columns::HallColumn;
use model_export::recordings::description::Design;
use model_export::recordings::layout::Layout;
use model_export::recordings::raw::RawRow;
use nalgebra::Rotation3;

/// Where the covariates are in a row.
#[derive(Clone, Copy, Debug)]
pub struct Covariates {
    opening: Option<usize>,
    motor: Option<(usize, usize)>,
    acceleration: Option<[usize; 3]>,
    attitude: Option<[usize; 3]>,
    pole_pairs: f64,
}

impl Covariates {
    /// Finds them among a recording's columns.
    pub fn find(layout: &Layout, design: Option<&Design>) -> Self {
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
                .unwrap_or(params::POLE_PAIRS.value),
        }
    }

    /// What the board knows in this row, in its own units.
    pub fn at(&self, row: &RawRow) -> Surroundings {
        let milli = |channel: usize| (1e3 * row.hall[channel]).round() as i32;
        Surroundings {
            opening_um: self.opening.map(milli),
            motor: self.motor.map(|(iq, angle)| {
                let mechanical = row.hall[angle];
                let (sin, cos) = (self.pole_pairs * mechanical).sin_cos();
                let fine = |share: f64| (share * f64::from(1 << 15)).round() as i32;
                let turn = mechanical.rem_euclid(std::f64::consts::TAU);
                Motor {
                    iq_ma: milli(iq),
                    electrical: [fine(sin), fine(cos)],
                    angle_urad: (1e6 * turn).round() as i32,
                }
            }),
            acceleration: self.acceleration.map(|channels| channels.map(milli)),
            attitude: self.attitude.map(|[roll, pitch, yaw]| {
                let turn =
                    Rotation3::from_euler_angles(row.hall[roll], row.hall[pitch], row.hall[yaw]);
                let one = f64::from(1 << Attitude::BITS);
                let entry = |i: usize, j: usize| (turn[(i, j)] * one).round() as i32;
                Attitude {
                    to_world: [0, 1, 2].map(|i| [0, 1, 2].map(|j| entry(i, j))),
                }
            }),
        }
    }
}
