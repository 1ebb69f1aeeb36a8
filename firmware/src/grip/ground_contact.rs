//! Foot mode: contact of the fingertips with the ground, its force, and the centre of pressure.
//!
//! A longitudinal force is positive where the ground pushes. The inertial force of the fingertip is subtracted where
//! its acceleration is known and the estimates are not compensated for it already
//! ([`crate::compensation::flexure`]). A short impact may peak between two samples: a peak of 3 ms reads up to
//! 13 % low, which the overload limit allows for.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::estimator::Estimate;
use crate::fixed_point::Force;
use crate::grip::finger_force::newtons;
use crate::math::{sqrt, within};
use crate::protocol::messages;
use crate::sensors::hall::SENSORS;

/// Position of each sensor along its finger, in millimetres from the middle.
const ALONG_MM: [f32; SENSORS] = {
    let half = 0.5 * constants::SENSOR_DISTANCE.value as f32;
    [-half, half, -half, half]
};
/// Position of each sensor across the fingers, as a fraction of the opening.
const SIDE: [f32; SENSORS] = [-0.5, -0.5, 0.5, 0.5];
/// Mass on the flexures of one sensor in kilograms.
const MASS_KG: f32 = constants::FINGERTIP_MASS.value as f32;

/// Maximum over a sliding time.
#[derive(Clone, Copy, Debug, Default)]
pub struct PeakDetector {
    value_n: f32,
    age_ms: u16,
}

impl PeakDetector {
    /// Adds a force in newtons; the maximum of the last `hold_ms`.
    pub fn update(&mut self, force_n: f32, hold_ms: u16) -> f32 {
        self.age_ms = self.age_ms.saturating_add(1);
        if force_n >= self.value_n || self.age_ms >= hold_ms {
            *self = Self { value_n: force_n, age_ms: 0 };
        }
        self.value_n
    }
}

/// Ground contact in one millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GroundContact {
    /// Fingertips in contact, one bit per sensor.
    pub contacts: u8,
    /// Sum of the forces in newtons.
    pub total_n: f32,
    /// Centre of pressure along the fingers, in millimetres from their middle; 0 without contact.
    pub along_mm: f32,
    /// Centre of pressure across, from the left finger to the right, in millimetres from their middle; 0 without
    /// contact, none while the opening is unknown.
    pub across_mm: Option<f32>,
    /// Standard deviation of the sum; none where an estimate has none.
    pub sigma_n: Option<f32>,
    /// Maximum force on one fingertip in the last milliseconds.
    pub peak_n: f32,
    /// All fingertips are unloaded.
    pub is_unloaded: bool,
}

/// Hysteresis and peaks of each fingertip.
#[derive(Clone, Copy, Debug, Default)]
pub struct GroundContactDetector {
    in_contact: [bool; SENSORS],
    peaks: [PeakDetector; SENSORS],
}

impl GroundContactDetector {
    /// Adds one millisecond. `acceleration` in mm/s^2, gripper axes, with gravity; none where it is unknown or
    /// compensated already.
    pub fn update(
        &mut self,
        estimates: &[Estimate; SENSORS],
        acceleration: Option<[i32; 3]>,
        opening_mm: Option<f32>,
        limits: &GripLimits,
    ) -> GroundContact {
        let [.., along_z] = acceleration.unwrap_or_default();
        let inertia_n = MASS_KG * 1e-3 * along_z as f32;
        let mut ground = GroundContact {
            is_unloaded: true,
            sigma_n: Some(0.0),
            across_mm: opening_mm.map(|_| 0.0),
            ..GroundContact::default()
        };
        let (mut along, mut across) = (0.0, 0.0);
        let states = self.in_contact.iter_mut().zip(&mut self.peaks);
        let positions = ALONG_MM.iter().zip(SIDE);
        for (sensor, ((estimate, (in_contact, peak)), (along_mm, side))) in
            (0_u8..).zip(estimates.iter().zip(states).zip(positions))
        {
            let valid = estimate.validity.is_in_range().then_some(estimate.force);
            let Some([_, force]) = valid else {
                // An invalid fingertip keeps its contact and adds no force.
                ground.is_unloaded = false;
                ground.sigma_n = None;
                ground.contacts |= u8::from(*in_contact) << sensor;
                continue;
            };
            let force_n = newtons(force) - inertia_n;
            let limit_n =
                if *in_contact { limits.ground_release_n } else { limits.ground_contact_n };
            *in_contact = force_n > limit_n;
            ground.contacts |= u8::from(*in_contact) << sensor;
            ground.is_unloaded &= force_n.abs() < limits.unloaded_n;
            ground.total_n += force_n;
            ground.peak_n = ground.peak_n.max(peak.update(force_n.abs(), limits.peak_ms));
            along += force_n * along_mm;
            across += force_n * side;
            ground.sigma_n = ground.sigma_n.zip(estimate.sigma).map(|(sum, [_, sigma])| {
                let sigma_n = newtons(sigma);
                sum + sigma_n * sigma_n
            });
        }
        ground.sigma_n = ground.sigma_n.map(sqrt);
        if ground.contacts != 0 && ground.total_n > limits.ground_release_n {
            ground.along_mm = along / ground.total_n;
            ground.across_mm = opening_mm.map(|mm| across / ground.total_n * mm);
        }
        ground
    }
}

/// Bus counts per unit of force, centre of pressure and sigma.
const PER_UNIT: [f32; 4] = match messages::Foot::LAYOUT.signals {
    [_, force, centre, sigma, _, across] => [
        force.counts_per_unit() as f32,
        centre.counts_per_unit() as f32,
        sigma.counts_per_unit() as f32,
        across.counts_per_unit() as f32,
    ],
    _ => panic!("the layout needs force, sigma and both centres of pressure"),
};

impl GroundContact {
    /// The message without its counter; values saturate at the range of their field.
    pub fn message(&self) -> messages::Foot {
        let [per_n, per_mm, per_sigma, per_mm_across] = PER_UNIT;
        messages::Foot {
            contacts: self.contacts,
            total_fz: (self.total_n * per_n) as i16,
            centre: (self.along_mm * per_mm) as i16,
            // Rounded, and never -128, which stands for unknown.
            across: self.across_mm.map_or(i8::MIN, |mm| {
                within(mm * per_mm_across + 0.5_f32.copysign(mm), -127.0, 127.0) as i8
            }),
            sigma: self.sigma_n.map_or(u8::MAX, |sigma_n| {
                // Rounded up, and never 255, which stands for unknown.
                within(sigma_n * per_sigma + 1.0, 0.0, 254.0) as u8
            }),
            counter: 0,
        }
    }

    /// [`GroundContact::peak_n`] in 1/1024 N, for the detail of a fault.
    pub fn peak_detail(&self) -> u32 {
        (self.peak_n * Force::PER_NEWTON as f32) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grip::tests::rig::pressed;

    const LIMITS: GripLimits = GripLimits::GRIPPER;

    fn ground_at(newtons: [f64; 4]) -> GroundContact {
        GroundContactDetector::default().update(
            &pressed([0.0; 4], newtons),
            None,
            Some(20.0),
            &LIMITS,
        )
    }

    #[test]
    fn centre_of_pressure_balances_the_moments() {
        // Sensors 60 mm apart: (20 + 20 - 60 - 100) N * -30 mm / 200 N = 18 mm along; the right finger bears
        // 120 of 200 N: (0.6 - 0.4) * 10 mm = 2 mm across at an opening of 20 mm.
        let ground = ground_at([20.0, 60.0, 20.0, 100.0]);
        assert_eq!((ground.contacts, ground.total_n), (0b1111, 200.0));
        assert!((ground.along_mm - 18.0).abs() < 1e-4, "{ground:?}");
        assert!((ground.across_mm.unwrap() - 2.0).abs() < 1e-4, "{ground:?}");
        let message = ground.message();
        assert_eq!((message.total_fz, message.centre, message.across), (2000, 1800, 4));
        assert_eq!(message.sigma, 255);
    }

    #[test]
    fn ground_contact_has_hysteresis_of_15_and_7_n() {
        let mut detector = GroundContactDetector::default();
        let mut at = |n| {
            let ground =
                detector.update(&pressed([0.0; 4], [n, 0.0, 0.0, 0.0]), None, None, &LIMITS);
            assert_eq!(ground.message().across, i8::MIN);
            (ground.contacts, ground.along_mm != 0.0)
        };
        assert_eq!(at(14.9), (0, false));
        assert_eq!(at(15.1), (1, true));
        assert_eq!(at(7.1), (1, true));
        assert_eq!(at(6.9), (0, false));
        assert_eq!(at(14.9), (0, false));
    }

    #[test]
    fn inertial_force_is_no_ground_contact() {
        // 50 g at 400 m/s^2 are 20 N.
        let swung = pressed([0.0; 4], [20.0; 4]);
        let contacts = |acceleration| {
            GroundContactDetector::default().update(&swung, acceleration, None, &LIMITS).contacts
        };
        assert_eq!((contacts(None), contacts(Some([0, 0, 400_000]))), (0b1111, 0));
    }

    #[test]
    fn peak_of_a_half_sine_is_held_for_ten_milliseconds() {
        // Worst case between two samples: cos(pi / 2 / ms) of the peak.
        for (length_ms, low) in [(2.0, 0.29), (3.0, 0.134), (5.0, 0.049), (10.0, 0.0123)] {
            let read = |phase: f64| {
                let mut peak = PeakDetector::default();
                let mut read = [0.0_f32; 40];
                for (tick, read) in read.iter_mut().enumerate() {
                    let share = (tick as f64 + phase) / length_ms;
                    let force =
                        if share < 1.0 { (share * std::f64::consts::PI).sin() } else { 0.0 };
                    *read = peak.update(1000.0 * force as f32, LIMITS.peak_ms);
                }
                read
            };
            let max_of = |phase| read(phase).into_iter().fold(0.0, f32::max);
            let worst = (0..100).map(|i| max_of(f64::from(i) / 100.0)).fold(1e9, f32::min);
            assert!(
                (f64::from(worst) / 1000.0 - (1.0 - low)).abs() < 0.003,
                "{length_ms}: {worst}"
            );
            // Held, then released.
            let samples = read(0.5);
            let peak = samples.into_iter().fold(0.0, f32::max);
            let held = samples.iter().filter(|sample| **sample == peak).count();
            assert!((10..=11).contains(&held), "{length_ms}: {held}");
            assert_eq!(samples[39], 0.0);
        }
    }

    #[test]
    fn invalid_fingertip_keeps_contact_without_force() {
        let mut detector = GroundContactDetector::default();
        let mut estimates = pressed([0.0; 4], [50.0; 4]);
        detector.update(&estimates, None, None, &LIMITS);
        estimates[3] = Estimate::MISSING;
        let ground = detector.update(&estimates, None, None, &LIMITS);
        assert_eq!((ground.contacts, ground.total_n), (0b1111, 150.0));
        assert!(!ground.is_unloaded);
    }

    #[test]
    fn force_at_the_threshold_begins_no_contact_and_ends_one() {
        let mut detector = GroundContactDetector::default();
        let contacts = [15.0, 15.25, 7.25, 7.0].map(|n| {
            let forces = pressed([0.0; 4], [0.0, 0.0, n, 0.0]);
            detector.update(&forces, None, Some(20.0), &LIMITS).contacts
        });
        assert_eq!(contacts, [0, 0b100, 0b100, 0]);
    }

    #[test]
    fn centre_is_the_middle_without_contact() {
        let ground = ground_at([1.0, 2.0, 3.0, 4.0]);
        assert_eq!((ground.contacts, ground.total_n), (0, 10.0));
        assert_eq!((ground.along_mm, ground.across_mm), (0.0, Some(0.0)));
        assert!(ground.is_unloaded);
        assert!(!ground_at([1.0, -20.0, 3.0, 4.0]).is_unloaded);
        // A contact whose sum is below the release threshold has no centre.
        let ground = ground_at([16.0, -9.0, 0.0, 0.0]);
        assert_eq!((ground.contacts, ground.along_mm, ground.total_n), (1, 0.0, 7.0));
    }

    #[test]
    fn sigma_is_the_root_of_the_sum_of_variances() {
        let mut estimates = pressed([0.0; 4], [20.0; 4]);
        let sigmas = [1.0, 2.0, 2.0, 4.5];
        for (estimate, sigma_n) in estimates.iter_mut().zip(sigmas) {
            estimate.sigma =
                Some([0.0, sigma_n * Force::PER_NEWTON].map(|force| Force(force as i32)));
        }
        let mut detector = GroundContactDetector::default();
        let ground = detector.update(&estimates, None, None, &LIMITS);
        // (1 + 4 + 4 + 20.25)^0.5 = 5.4083 N: 21.6 counts of 0.25 N, rounded up.
        assert!(ground.sigma_n.is_some_and(|sigma_n| (sigma_n - 5.4083).abs() < 1e-3));
        assert_eq!(ground.message().sigma, 22);
        estimates[2].sigma = None;
        let ground = detector.update(&estimates, None, None, &LIMITS);
        assert_eq!((ground.sigma_n, ground.message().sigma), (None, 255));
    }

    #[test]
    fn message_rounds_and_saturates_the_centre() {
        for (across_mm, count) in [
            (Some(1.2), 2),
            (Some(1.4), 3),
            (Some(-1.2), -2),
            (Some(-1.4), -3),
            (Some(100.0), 127),
            (Some(-100.0), -127),
            (None, -128),
        ] {
            let ground = GroundContact { across_mm, sigma_n: Some(100.0), ..Default::default() };
            let message = ground.message();
            assert_eq!((message.across, message.sigma), (count, 254), "{across_mm:?}");
        }
        let ground = GroundContact {
            contacts: 0b1001,
            total_n: -12.5,
            along_mm: -3.25,
            peak_n: 200.25,
            ..Default::default()
        };
        let message = ground.message();
        assert_eq!((message.contacts, message.total_fz, message.centre), (0b1001, -125, -325));
        // 200.25 N * 1024.
        assert_eq!(ground.peak_detail(), 205_056);
    }

    #[test]
    fn gravity_along_the_fingers_is_subtracted_and_peaks_have_no_sign() {
        let mut detector = GroundContactDetector::default();
        // 50 g at 100 m/s^2 are 5 N.
        let forces = pressed([0.0; 4], [25.0, -30.0, 5.0, 5.0]);
        let ground = detector.update(&forces, Some([7, 7, 100_000]), None, &LIMITS);
        assert!((ground.total_n + 15.0).abs() < 1e-3, "{ground:?}");
        assert!((ground.peak_n - 35.0).abs() < 1e-3, "{ground:?}");
    }
}
