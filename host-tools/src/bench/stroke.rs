//! How the fingers open and close, and how the motor turns with them.

use std::f64::consts::TAU;

use super::draw::{Purpose, between, stream};
use super::programme::Programme;
use super::waves::Waves;

/// The opening stays between these.
const OPENING_MM: [f64; 2] = [5.0, 45.0];

/// Fastest opening of the gripper.
const FASTEST_MM_PER_S: f64 = 58.0;

/// Greatest speed of a minimum-jerk stroke, in strokes over its duration (Flash and Hogan 1985).
const PEAK_SPEED: f64 = 1.875;

/// Lead of the screw, as `recording.toml` states it.
pub const LEAD_MM: f64 = 3.213;

/// Pole pairs of the motor.
pub const POLE_PAIRS: f64 = 7.0;

/// Greatest current of the motor.
const CURRENT_A: f64 = 10.0;

/// Current that goes with the fastest opening, and the greatest that holds.
const DRIVING_A: f64 = 4.0;
const HOLDING_A: f64 = 7.0;

/// Current of a gripper that holds one opening.
const STILL_A: f64 = 3.0;

/// Opening and motor during one recording.
#[derive(Clone, Debug)]
pub struct Stroke {
    strokes: Vec<One>,
    holding: Option<Waves>,
    /// Turn of the rotor against the screw's zero.
    rotor_rad: f64,
}

/// One smooth move, followed by a stop.
#[derive(Clone, Copy, Debug)]
struct One {
    start_s: f64,
    seconds: f64,
    from_mm: f64,
    to_mm: f64,
}

/// What the fingers and the motor do at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Opening in mm, by the motor.
    pub opening_mm: f64,
    /// Mechanical angle of the motor in rad, not wrapped.
    pub angle_rad: f64,
    /// Quadrature current in A.
    pub current_a: f64,
}

impl Stroke {
    /// Draws strokes for a recording.
    pub fn draw(programme: Programme, seed: u64, recording: u32, seconds: f64) -> Self {
        let rotor_rad = between(&mut stream(seed, Purpose::Motor, 0), 0.0, TAU);
        let mut rng = stream(seed, Purpose::Strokes, recording);
        let still = programme == Programme::Still;
        let mut strokes = Vec::new();
        let mut at_mm = match still {
            true => OPENING_MM[0],
            false => between(&mut rng, OPENING_MM[0], OPENING_MM[1]),
        };
        let mut start_s = between(&mut rng, 0.3, 1.0);
        while strokes.is_empty() || (!still && start_s < seconds) {
            let to_mm = match still {
                true => at_mm,
                false => between(&mut rng, OPENING_MM[0], OPENING_MM[1]),
            };
            let fastest_s = PEAK_SPEED * (to_mm - at_mm).abs() / FASTEST_MM_PER_S;
            let seconds = fastest_s.max(0.2) * between(&mut rng, 1.0, 3.0);
            strokes.push(One {
                start_s,
                seconds,
                from_mm: at_mm,
                to_mm,
            });
            start_s += seconds + between(&mut rng, 0.2, 1.5);
            at_mm = to_mm;
        }
        let mut rng = stream(seed, Purpose::Motor, recording);
        let holding = (!still).then(|| Waves::draw(&mut rng, 3, [0.05, 0.6], HOLDING_A));
        Self {
            strokes,
            holding,
            rotor_rad,
        }
    }

    /// Opening and motor at a time in seconds.
    pub fn at(&self, time_s: f64) -> Drive {
        let (opening_mm, speed) = self.opening(time_s);
        let current_a = self.holding.as_ref().map_or(STILL_A, |holding| {
            let driving = DRIVING_A * speed / FASTEST_MM_PER_S;
            (driving + holding.at(time_s)).clamp(-CURRENT_A, CURRENT_A)
        });
        Drive {
            opening_mm,
            angle_rad: TAU * opening_mm / LEAD_MM + self.rotor_rad,
            current_a,
        }
    }

    /// Opening in mm and its speed in mm/s.
    fn opening(&self, time_s: f64) -> (f64, f64) {
        let begun = self.strokes.partition_point(|one| one.start_s <= time_s);
        let one = self.strokes[begun.saturating_sub(1)];
        let share = ((time_s - one.start_s) / one.seconds).clamp(0.0, 1.0);
        let along = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        let speed = 30.0 * (share * (1.0 - share)).powi(2) / one.seconds;
        let stroke = one.to_mm - one.from_mm;
        (one.from_mm + stroke * along, stroke * speed)
    }
}

/// Play between the reported opening and the real one.
#[derive(Clone, Copy, Debug)]
pub struct Backlash {
    play_mm: f64,
    real_mm: Option<f64>,
}

impl Backlash {
    /// Full play in mm; the screw rests on one flank at first.
    pub fn new(play_mm: f64) -> Self {
        Self {
            play_mm,
            real_mm: None,
        }
    }

    /// The real opening when the motor says `reported_mm`.
    pub fn follow(&mut self, reported_mm: f64) -> f64 {
        let half = 0.5 * self.play_mm;
        let before = self.real_mm.unwrap_or(reported_mm);
        let real = before.clamp(reported_mm - half, reported_mm + half);
        self.real_mm = Some(real);
        real
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_are_smooth_and_no_faster_than_the_gripper() {
        let stroke = Stroke::draw(Programme::Bench, 1, 1, 30.0);
        let openings: Vec<f64> = (0..30_000)
            .map(|ms| stroke.at(f64::from(ms) * 1e-3).opening_mm)
            .collect();
        let fastest = openings.windows(2).map(|w| (w[1] - w[0]).abs() * 1e3);
        let fastest = fastest.fold(0.0, f64::max);
        assert!((20.0..=58.001).contains(&fastest), "{fastest}");
        assert!(openings.iter().all(|mm| (5.0..=45.0).contains(mm)));
        let currents = (0..30_000).map(|ms| stroke.at(f64::from(ms) * 1e-3).current_a);
        let (least, most) = currents.fold((0.0_f64, 0.0_f64), |(l, m), a| (l.min(a), m.max(a)));
        assert!(least < -2.0 && most > 2.0 && least >= -10.0 && most <= 10.0);
    }

    #[test]
    fn a_gripper_that_stands_still_keeps_opening_and_current() {
        let stroke = Stroke::draw(Programme::Still, 1, 1, 30.0);
        assert_eq!(stroke.at(0.0), stroke.at(17.0));
        assert_eq!(stroke.at(3.0).opening_mm, 5.0);
    }

    #[test]
    fn after_a_turn_back_the_real_opening_waits_for_the_full_play() {
        let mut backlash = Backlash::new(0.3);
        let real = [10.0, 11.0, 10.8, 10.0].map(|mm| backlash.follow(mm));
        let expected = [10.0, 10.85, 10.85, 10.15];
        assert!(
            real.iter()
                .zip(expected)
                .all(|(a, b)| (a - b).abs() < 1e-12),
            "{real:?}"
        );
    }
}
