//! Opening, motor and orientation of the gripper over time.

use crate::random::{Purpose, SineSum, stream, uniform};
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::{PI, TAU};

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Excitation programme of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Programme {
    /// Loads, opening, current, temperature and orientation all vary.
    Bench,
    /// Constant opening and motor current.
    Still,
    /// Constant orientation.
    Level,
    /// Constant temperature.
    Isothermal,
    /// The same warm-up in every recording.
    SameWarmUp,
    /// Both forces are a sine of 0.5 Hz.
    SingleSine,
}

/// Range of the opening.
const OPENING_MM: [f64; 2] = [5.0, 45.0];

/// Maximum speed of the opening.
const MAX_MM_PER_S: f64 = 58.0;

/// Peak over mean speed of a minimum-jerk stroke (Flash and Hogan 1985).
const PEAK_SPEED: f64 = 1.875;

/// Lead of the screw, as written to `recording.toml`.
pub const LEAD_MM: f64 = 3.213;

/// Pole pairs of the motor.
pub const POLE_PAIRS: f64 = 7.0;

/// Current limit of the motor.
const CURRENT_A: f64 = 10.0;

/// Current at maximum speed, and maximum holding current.
const DRIVING_A: f64 = 4.0;
const HOLDING_A: f64 = 7.0;

/// Current at constant opening.
const STILL_A: f64 = 3.0;

/// Opening and motor current during a recording.
#[derive(Clone, Debug)]
pub struct OpeningProfile {
    strokes: Vec<Stroke>,
    holding: Option<SineSum>,
    /// Rotor angle at the screw's zero.
    rotor_rad: f64,
}

/// A smooth move, followed by a stop.
#[derive(Clone, Copy, Debug)]
struct Stroke {
    start_s: f64,
    seconds: f64,
    from_mm: f64,
    to_mm: f64,
}

/// Opening and motor state at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// Opening in mm, derived from the motor angle.
    pub opening_mm: f64,
    /// Mechanical angle of the motor in rad, not wrapped.
    pub angle_rad: f64,
    /// Quadrature current in A.
    pub current_a: f64,
}

impl OpeningProfile {
    /// Draws the strokes of a recording.
    pub fn draw(programme: Programme, seed: u64, recording: u32, seconds: f64) -> Self {
        let rotor_rad = Self::rotor_rad(seed);
        let mut rng = stream(seed, Purpose::Strokes, recording);
        let still = programme == Programme::Still;
        let mut strokes = Vec::new();
        let mut at_mm =
            if still { OPENING_MM[0] } else { uniform(&mut rng, OPENING_MM[0], OPENING_MM[1]) };
        let mut start_s = uniform(&mut rng, 0.3, 1.0);
        while strokes.is_empty() || (!still && start_s < seconds) {
            let to_mm = if still { at_mm } else { uniform(&mut rng, OPENING_MM[0], OPENING_MM[1]) };
            let fastest_s = PEAK_SPEED * (to_mm - at_mm).abs() / MAX_MM_PER_S;
            let seconds = fastest_s.max(0.2) * uniform(&mut rng, 1.0, 3.0);
            strokes.push(Stroke { start_s, seconds, from_mm: at_mm, to_mm });
            start_s += seconds + uniform(&mut rng, 0.2, 1.5);
            at_mm = to_mm;
        }
        let mut rng = stream(seed, Purpose::Motor, recording);
        let holding = (!still).then(|| SineSum::draw(&mut rng, 3, [0.05, 0.6], HOLDING_A));
        Self { strokes, holding, rotor_rad }
    }

    /// Draws the rotor's angle at the screw's zero.
    pub fn rotor_rad(seed: u64) -> f64 {
        uniform(&mut stream(seed, Purpose::Motor, 0), 0.0, TAU)
    }

    /// At rest at an opening in mm; `rotor_rad` is the rotor's angle at the screw's zero.
    pub fn resting(opening_mm: f64, rotor_rad: f64) -> Self {
        let at_rest = Stroke { start_s: 0.0, seconds: 1.0, from_mm: opening_mm, to_mm: opening_mm };
        Self { strokes: vec![at_rest], holding: None, rotor_rad }
    }

    /// Adds a move after all others, with a holding current of this frequency.
    pub fn add_stroke(&mut self, start_s: f64, seconds: f64, to_mm: f64, holding_hz: f64) {
        let from_mm = self.strokes.last().map_or(to_mm, |stroke| stroke.to_mm);
        self.strokes.push(Stroke { start_s, seconds, from_mm, to_mm });
        self.holding.get_or_insert_with(|| SineSum::one(HOLDING_A, holding_hz, 0.0));
    }

    /// Opening and motor state at a time in seconds.
    pub fn at(&self, time_s: f64) -> MotionState {
        let (opening_mm, speed) = self.opening(time_s);
        let current_a = self.holding.as_ref().map_or(STILL_A, |holding| {
            let driving = DRIVING_A * speed / MAX_MM_PER_S;
            (driving + holding.at(time_s)).clamp(-CURRENT_A, CURRENT_A)
        });
        MotionState {
            opening_mm,
            angle_rad: TAU * opening_mm / LEAD_MM + self.rotor_rad,
            current_a,
        }
    }

    /// Opening in mm and its speed in mm/s.
    fn opening(&self, time_s: f64) -> (f64, f64) {
        let begun = self.strokes.partition_point(|stroke| stroke.start_s <= time_s);
        let stroke = self.strokes[begun.saturating_sub(1)];
        let share = ((time_s - stroke.start_s) / stroke.seconds).clamp(0.0, 1.0);
        let along = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        let speed = 30.0 * (share * (1.0 - share)).powi(2) / stroke.seconds;
        let length_mm = stroke.to_mm - stroke.from_mm;
        (stroke.from_mm + length_mm * along, length_mm * speed)
    }
}

/// Backlash between the reported and the real opening.
#[derive(Clone, Copy, Debug)]
pub struct Backlash {
    play_mm: f64,
    real_mm: Option<f64>,
}

impl Backlash {
    /// Full backlash in mm.
    pub fn new(play_mm: f64) -> Self {
        Self { play_mm, real_mm: None }
    }

    /// Real opening for a reported one.
    pub fn follow(&mut self, reported_mm: f64) -> f64 {
        let half = 0.5 * self.play_mm;
        let before = self.real_mm.unwrap_or(reported_mm);
        let real = before.clamp(reported_mm - half, reported_mm + half);
        self.real_mm = Some(real);
        real
    }
}

/// Gravity in m/s^2.
pub const GRAVITY: f64 = 9.81;

/// Maximum roll and pitch in rad; pitch avoids the singularity of the ZYX angles.
const ROLL_RAD: f64 = 2.2;
const PITCH_RAD: f64 = 1.2;

/// Amplitude of the yaw oscillation around a slow rotation.
const YAW_RAD: f64 = 1.0;

/// Frequency ranges of rotation and translation.
const ROTATION_HZ: [f64; 2] = [0.02, 0.12];
const TRANSLATION_HZ: [f64; 2] = [0.4, 2.5];

/// Maximum acceleration along each body axis; the norm stays below 6 m/s^2.
const ACCELERATION_MPS2: f64 = 3.4;

/// Orientation and motion during a recording.
#[derive(Clone, Debug)]
pub struct AttitudeProfile {
    /// Roll, pitch and yaw; none for a level gripper.
    rotation: Option<[SineSum; 3]>,
    yaw: (f64, f64),
    acceleration: [SineSum; 3],
}

/// Orientation and specific force at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// Roll, pitch, yaw in rad, body to world, ZYX, wrapped.
    pub angles_rad: [f64; 3],
    /// Rotation from body to world axes.
    pub to_world: Rotation3<f64>,
    /// Specific force in m/s^2, body axes: reaction to gravity, and acceleration.
    pub specific_force: Vector3<f64>,
}

impl AttitudeProfile {
    /// Draws rotation and acceleration for a recording.
    pub fn draw(programme: Programme, seed: u64, recording: u32) -> Self {
        let mut rng = stream(seed, Purpose::Attitude, recording);
        let rotation = [ROLL_RAD, PITCH_RAD, YAW_RAD]
            .map(|peak| SineSum::draw(&mut rng, 3, ROTATION_HZ, peak));
        Self {
            rotation: (programme != Programme::Level).then_some(rotation),
            yaw: (uniform(&mut rng, -PI, PI), uniform(&mut rng, -0.15, 0.15)),
            acceleration: [0, 1, 2]
                .map(|_| SineSum::draw(&mut rng, 4, TRANSLATION_HZ, ACCELERATION_MPS2)),
        }
    }

    /// Orientation at a time in seconds.
    pub fn at(&self, time_s: f64) -> Orientation {
        let angles_rad = match &self.rotation {
            None => [0.0; 3],
            Some(rotation) => {
                let [roll, pitch, yaw] = [0, 1, 2].map(|i| rotation[i].at(time_s));
                let (start, speed) = self.yaw;
                [roll, pitch, wrapped(start + speed * time_s + yaw)]
            }
        };
        Orientation::new(angles_rad, Vector3::from_fn(|i, _| self.acceleration[i].at(time_s)))
    }
}

impl Orientation {
    /// From roll, pitch and yaw, and the acceleration in m/s^2 in body axes.
    pub fn new(angles_rad: [f64; 3], acceleration: Vector3<f64>) -> Self {
        let [roll, pitch, yaw] = angles_rad;
        let to_world = Rotation3::from_euler_angles(roll, pitch, yaw);
        Self {
            angles_rad,
            to_world,
            specific_force: to_world.inverse() * Vector3::new(0.0, 0.0, GRAVITY) + acceleration,
        }
    }

    /// Angular rate in rad/s, body axes, of an orientation over time in seconds.
    pub fn rate_rad_s(at: impl Fn(f64) -> Self, time_s: f64) -> Vector3<f64> {
        const STEP_S: f64 = 1e-4;
        let [before, after] = [-STEP_S, STEP_S].map(|step_s| at(time_s + 0.5 * step_s).to_world);
        (before.inverse() * after).scaled_axis() / STEP_S
    }
}

/// Wraps an angle to -pi to pi.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_respect_speed_range_and_current_limit() {
        let stroke = OpeningProfile::draw(Programme::Bench, 1, 1, 30.0);
        let openings: Vec<f64> =
            (0..30_000).map(|ms| stroke.at(f64::from(ms) * 1e-3).opening_mm).collect();
        let fastest = openings.windows(2).map(|w| (w[1] - w[0]).abs() * 1e3);
        let fastest = fastest.fold(0.0, f64::max);
        assert!((20.0..=58.001).contains(&fastest), "{fastest}");
        assert!(openings.iter().all(|mm| (5.0..=45.0).contains(mm)));
        let currents = (0..30_000).map(|ms| stroke.at(f64::from(ms) * 1e-3).current_a);
        let (min, max) = currents.fold((0.0_f64, 0.0_f64), |(l, m), a| (l.min(a), m.max(a)));
        assert!(min < -2.0 && max > 2.0 && min >= -10.0 && max <= 10.0);
    }

    #[test]
    fn still_programme_is_constant() {
        let stroke = OpeningProfile::draw(Programme::Still, 1, 1, 30.0);
        assert_eq!(stroke.at(0.0), stroke.at(17.0));
        assert_eq!(stroke.at(3.0).opening_mm, 5.0);
    }

    #[test]
    fn backlash_delays_the_real_opening_after_reversal() {
        let mut backlash = Backlash::new(0.3);
        let real = [10.0, 11.0, 10.8, 10.0].map(|mm| backlash.follow(mm));
        let expected = [10.0, 10.85, 10.85, 10.15];
        assert!(real.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{real:?}");
    }

    #[test]
    fn level_gripper_measures_gravity_along_z() {
        let attitude = AttitudeProfile::draw(Programme::Level, 1, 1);
        for step in 0..3000 {
            let orientation = attitude.at(f64::from(step) * 0.01);
            let motion = orientation.specific_force - Vector3::new(0.0, 0.0, 9.81);
            assert!(orientation.angles_rad == [0.0; 3] && motion.norm() < 6.0);
        }
    }

    #[test]
    fn tilted_gripper_measures_gravity_along_its_own_axes() {
        // A level gripper with the same seed has the same acceleration.
        let [level, tilted] = [Programme::Level, Programme::Bench]
            .map(|programme| AttitudeProfile::draw(programme, 1, 1));
        for step in 0..300 {
            let time_s = f64::from(step) * 0.1;
            let tilted = tilted.at(time_s);
            let motion = level.at(time_s).specific_force - Vector3::new(0.0, 0.0, GRAVITY);
            let [roll, pitch, _] = tilted.angles_rad;
            let down = [-pitch.sin(), roll.sin() * pitch.cos(), roll.cos() * pitch.cos()];
            let gravity = tilted.specific_force - motion;
            assert!((gravity - GRAVITY * Vector3::from(down)).norm() < 1e-9, "{time_s} s");
        }
    }

    #[test]
    fn angular_rate_integrates_to_the_orientation() {
        let attitude = AttitudeProfile::draw(Programme::Bench, 1, 1);
        let mut to_world = attitude.at(0.0).to_world;
        for step in 0..2000 {
            let rate = Orientation::rate_rad_s(
                |time_s| attitude.at(time_s),
                (f64::from(step) + 0.5) * 1e-3,
            );
            to_world *= Rotation3::from_scaled_axis(rate * 1e-3);
        }
        let error_rad = (to_world.inverse() * attitude.at(2.0).to_world).angle();
        assert!(error_rad < 1e-4, "{error_rad}");
    }

    #[test]
    fn bench_programme_covers_large_angles() {
        let attitude = AttitudeProfile::draw(Programme::Bench, 1, 1);
        for axis in 0..3 {
            let angles = (0..300).map(|step| attitude.at(f64::from(step) * 0.1).angles_rad[axis]);
            let (min, max) = angles.fold((PI, -PI), |(l, m), a| (l.min(a), m.max(a)));
            assert!(max - min > 0.8, "{axis}: {min} to {max}");
        }
    }
}
