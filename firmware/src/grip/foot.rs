//! The gripper as a foot: which fingertips stand on the ground, how hard, and where the ground pushes.
//!
//! A longitudinal force counts positive where the ground pushes. The fingertip's own inertia is taken off where
//! the board knows its acceleration and the estimates are not without it already
//! ([`crate::compensate::fingertip_mass`]). A short impact lies between two samples: of 3 ms the peak may read
//! 13 % low, which the limit of the overload allows for.

use super::fingers::newtons;
use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::limits::Grasp;
use crate::motor::number::{sqrt, within};
use crate::params;
use crate::units::Force;
use crate::wire::messages;

/// Where the sensors are along a finger, in millimetres from its middle.
const ALONG_MM: [f32; SENSORS] = {
    let half = 0.5 * params::SENSOR_DISTANCE.value as f32;
    [-half, half, -half, half]
};
/// On which side they are.
const SIDE: [f32; SENSORS] = [-0.5, -0.5, 0.5, 0.5];
/// Kilograms on each sensor's flexures.
const MASS_KG: f32 = params::FINGERTIP_MASS.value as f32;

/// The greatest of the last milliseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Peak {
    value_n: f32,
    age_ms: u16,
}

impl Peak {
    /// Takes a force in newtons; the greatest of the last `hold_ms`, this one among them.
    pub fn note(&mut self, force_n: f32, hold_ms: u16) -> f32 {
        self.age_ms = self.age_ms.saturating_add(1);
        if force_n >= self.value_n || self.age_ms >= hold_ms {
            *self = Self {
                value_n: force_n,
                age_ms: 0,
            };
        }
        self.value_n
    }
}

/// What the foot feels in a millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standing {
    /// Fingertips that stand, one bit for each sensor.
    pub contacts: u8,
    /// Sum of the forces in newtons.
    pub total_n: f32,
    /// Where the ground pushes along the fingers, in millimetres from their middle; 0 while nothing stands.
    pub along_mm: f32,
    /// The same across, from the left finger to the right.
    pub across_mm: f32,
    /// Standard deviation of the sum; none where a network does not tell it.
    pub sigma_n: Option<f32>,
    /// The greatest force on one fingertip of the last milliseconds.
    pub peak_n: f32,
    /// All fingertips are unloaded.
    pub is_unloaded: bool,
}

/// What is remembered from millisecond to millisecond.
#[derive(Clone, Copy, Debug, Default)]
pub struct Feeling {
    stands: [bool; SENSORS],
    peaks: [Peak; SENSORS],
}

impl Feeling {
    /// Takes a millisecond. `acceleration` in mm/s^2, gripper's axes, gravity included; none where it is not
    /// known or accounted for already.
    pub fn note(
        &mut self,
        estimates: &[Estimate; SENSORS],
        acceleration: Option<[i32; 3]>,
        opening_mm: Option<f32>,
        limits: &Grasp,
    ) -> Standing {
        let [.., along_z] = acceleration.unwrap_or_default();
        let own_n = MASS_KG * 1e-3 * along_z as f32;
        let mut standing = Standing {
            is_unloaded: true,
            sigma_n: Some(0.0),
            ..Standing::default()
        };
        let (mut along, mut across) = (0.0, 0.0);
        let states = self.stands.iter_mut().zip(&mut self.peaks);
        let places = ALONG_MM.iter().zip(SIDE);
        for (sensor, ((estimate, (stands, peak)), (place, side))) in
            (0_u8..).zip(estimates.iter().zip(states).zip(places))
        {
            let told = (estimate.validity == Validity::Valid).then_some(estimate.force);
            let Some([_, force]) = told else {
                // What is not told stands as it did, and adds nothing.
                standing.is_unloaded = false;
                standing.sigma_n = None;
                standing.contacts |= u8::from(*stands) << sensor;
                continue;
            };
            let force_n = newtons(force) - own_n;
            let limit_n = if *stands {
                limits.foot_off_n
            } else {
                limits.foot_on_n
            };
            *stands = force_n > limit_n;
            standing.contacts |= u8::from(*stands) << sensor;
            standing.is_unloaded &= force_n.abs() < limits.unloaded_n;
            standing.total_n += force_n;
            standing.peak_n = standing
                .peak_n
                .max(peak.note(force_n.abs(), limits.peak_ms));
            along += force_n * place;
            across += force_n * side;
            standing.sigma_n = standing
                .sigma_n
                .zip(estimate.sigma)
                .map(|(sum, [_, sigma])| {
                    let sigma_n = newtons(sigma);
                    sum + sigma_n * sigma_n
                });
        }
        standing.sigma_n = standing.sigma_n.map(sqrt);
        if standing.contacts != 0 && standing.total_n > limits.foot_off_n {
            standing.along_mm = along / standing.total_n;
            standing.across_mm = across / standing.total_n * opening_mm.unwrap_or_default();
        }
        standing
    }
}

/// Counts of the bus for one unit: force, place, sigma.
const PER_UNIT: [f32; 3] = match messages::Foot::LAYOUT.fields {
    [_, force, place, sigma, ..] => [
        force.counts_per_unit() as f32,
        place.counts_per_unit() as f32,
        sigma.counts_per_unit() as f32,
    ],
    _ => [0.0; 3],
};

impl Standing {
    /// The message, not counted yet; what does not fit stays at the end of its field.
    pub fn message(&self) -> messages::Foot {
        let [per_n, per_mm, per_sigma] = PER_UNIT;
        messages::Foot {
            contacts: self.contacts,
            total_fz: (self.total_n * per_n) as i16,
            centre: (self.along_mm * per_mm) as i16,
            sigma: self.sigma_n.map_or(u8::MAX, |sigma_n| {
                // Never better than it is, nor the number that says "unknown".
                within(sigma_n * per_sigma + 1.0, 0.0, 254.0) as u8
            }),
            counter: 0,
        }
    }

    /// The greatest force of the last milliseconds in 1/1024 N, for the detail of a fault.
    pub fn peak_detail(&self) -> u32 {
        (self.peak_n * Force::PER_NEWTON as f32) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::pressed;
    use super::*;

    const LIMITS: Grasp = Grasp::GRIPPER;

    fn stood(newtons: [f64; 4]) -> Standing {
        Feeling::default().note(&pressed([0.0; 4], newtons), None, Some(20.0), &LIMITS)
    }

    #[test]
    fn the_centre_of_pressure_is_where_the_moments_balance() {
        // Sensors 60 mm apart: (20 + 20 - 60 - 100) N * -30 mm / 200 N = 18 mm along; the right finger bears
        // 120 of 200 N: (0.6 - 0.4) * 10 mm = 2 mm across at an opening of 20 mm.
        let standing = stood([20.0, 60.0, 20.0, 100.0]);
        assert_eq!((standing.contacts, standing.total_n), (0b1111, 200.0));
        assert!((standing.along_mm - 18.0).abs() < 1e-4, "{standing:?}");
        assert!((standing.across_mm - 2.0).abs() < 1e-4, "{standing:?}");
        let message = standing.message();
        assert_eq!((message.total_fz, message.centre), (2000, 1800));
        assert_eq!(message.sigma, 255);
    }

    #[test]
    fn nothing_stands_below_15_n_and_what_stands_does_so_down_to_7_n() {
        let mut feeling = Feeling::default();
        let mut at = |n| {
            let standing =
                feeling.note(&pressed([0.0; 4], [n, 0.0, 0.0, 0.0]), None, None, &LIMITS);
            (standing.contacts, standing.along_mm != 0.0)
        };
        assert_eq!(at(14.9), (0, false));
        assert_eq!(at(15.1), (1, true));
        assert_eq!(at(7.1), (1, true));
        assert_eq!(at(6.9), (0, false));
        assert_eq!(at(14.9), (0, false));
    }

    #[test]
    fn the_fingertip_s_own_inertia_is_no_contact() {
        // 50 g at 400 m/s^2 are 20 N.
        let swung = pressed([0.0; 4], [20.0; 4]);
        let feel = |acceleration| {
            Feeling::default()
                .note(&swung, acceleration, None, &LIMITS)
                .contacts
        };
        assert_eq!((feel(None), feel(Some([0, 0, 400_000]))), (0b1111, 0));
    }

    #[test]
    fn the_peak_of_a_half_sine_is_read_as_low_as_its_samples_allow_and_kept_for_ten_milliseconds() {
        // Between two samples: cos(pi / 2 / ms) of the peak.
        for (length_ms, low) in [(2.0, 0.29), (3.0, 0.134), (5.0, 0.049), (10.0, 0.0123)] {
            let read = |phase: f64| {
                let mut peak = Peak::default();
                let mut read = [0.0_f32; 40];
                for (tick, read) in read.iter_mut().enumerate() {
                    let share = (tick as f64 + phase) / length_ms;
                    let force = if share < 1.0 {
                        (share * std::f64::consts::PI).sin()
                    } else {
                        0.0
                    };
                    *read = peak.note(1000.0 * force as f32, LIMITS.peak_ms);
                }
                read
            };
            let greatest = |phase| read(phase).into_iter().fold(0.0, f32::max);
            let worst = (0..100)
                .map(|i| greatest(f64::from(i) / 100.0))
                .fold(1e9, f32::min);
            assert!(
                (f64::from(worst) / 1000.0 - (1.0 - low)).abs() < 0.003,
                "{length_ms}: {worst}"
            );
            // Kept, then let go.
            let samples = read(0.5);
            let peak = samples.into_iter().fold(0.0, f32::max);
            let held = samples.iter().filter(|sample| **sample == peak).count();
            assert!((10..=11).contains(&held), "{length_ms}: {held}");
            assert_eq!(samples[39], 0.0);
        }
    }

    #[test]
    fn a_fingertip_that_is_not_told_adds_nothing_and_keeps_standing() {
        let mut feeling = Feeling::default();
        let mut estimates = pressed([0.0; 4], [50.0; 4]);
        feeling.note(&estimates, None, None, &LIMITS);
        estimates[3] = Estimate::MISSING;
        let standing = feeling.note(&estimates, None, None, &LIMITS);
        assert_eq!((standing.contacts, standing.total_n), (0b1111, 150.0));
        assert!(!standing.is_unloaded);
    }
}
