//! Magnets that pass one after the other, and what became of each.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use crate::bench::draw::{Purpose, between, stream};
use crate::bench::foreign::ForeignMagnet;

/// Distance of the closest approach from the gripper's middle in mm, duration in seconds, greatest field in
/// gauss: each drawn evenly in its logarithm.
const DISTANCE_MM: [f64; 2] = [55.0, 250.0];
const PASS_S: [f64; 2] = [0.03, 3.0];
const GREATEST_G: [f64; 2] = [15.0, 300.0];
/// Between a magnet that is gone and the next that comes, in seconds.
const APART_S: f64 = 1.5;
/// The first may come after this.
const FIRST_S: f64 = 3.0;
/// A force that is off by more of its range is worth an alarm: 20 N of MAGPIE's 250 N.
const OFF: f64 = 20.0 / 250.0;
/// Frames within which it has to come.
pub const IN_TIME: u32 = 20;

/// Draws one magnet after the other through a recording.
pub struct Passages {
    rng: ChaCha8Rng,
    recording: u32,
    sensors: u32,
    /// No magnet's field is there any more at this time.
    end_s: f64,
    /// The one on its way.
    pub magnet: Option<ForeignMagnet>,
    next_s: f64,
}

/// Error in newtons that is worth an alarm, of a sensor for forces up to `range_n`.
pub fn worth_n(range_n: f64) -> f64 {
    OFF * range_n
}

/// What became of one magnet.
#[derive(Clone, Copy, Debug, Default)]
pub struct Passage {
    /// Frame in which a force was off by more than [`worth_n`] first.
    pub off_at: Option<u32>,
    /// Frame in which the flag rose first while its field was there.
    pub flag_at: Option<u32>,
    /// The greatest measures up to the end of the time within which it had to be noticed.
    pub greatest: [f64; 4],
}

impl Passages {
    /// Before the first, through so many seconds of a recording of a gripper with so many sensors.
    pub fn new(seed: u64, recording: u32, seconds: f64, sensors: u32) -> Self {
        Self {
            rng: stream(seed, Purpose::ForeignMagnet, recording),
            recording,
            sensors,
            end_s: seconds,
            magnet: None,
            next_s: FIRST_S,
        }
    }

    /// Field of the one on its way at a sensor, in gauss, body's axes.
    pub fn field(&self, sensor: u32, time_s: f64) -> Vector3<f64> {
        let magnet = self.magnet.as_ref();
        magnet.map_or_else(Vector3::zeros, |magnet| {
            magnet.field(self.recording, sensor, time_s)
        })
    }

    /// True where a new one sets out, which it does only while the flag is down; the one before is gone
    /// where `None` stands.
    pub fn at(&mut self, time_s: f64, flag: bool) -> bool {
        if let Some(magnet) = &self.magnet
            && time_s > magnet.felt_s()[1]
        {
            (self.magnet, self.next_s) = (None, time_s + APART_S);
        }
        if flag || self.magnet.is_some() || time_s < self.next_s {
            return false;
        }
        let rng = &mut self.rng;
        let mut even = |[least, most]: [f64; 2]| between(rng, least.ln(), most.ln()).exp();
        let (distance_mm, pass_s, greatest_g) = (even(DISTANCE_MM), even(PASS_S), even(GREATEST_G));
        let ahead_s = {
            let [from, to] = ForeignMagnet::passing(
                &mut self.rng.clone(),
                (self.recording, 0.0),
                (distance_mm, pass_s),
                greatest_g,
                self.sensors,
            )
            .felt_s();
            0.5 * (to - from)
        };
        if time_s + 2.0 * ahead_s > self.end_s {
            self.next_s = f64::INFINITY;
            return false;
        }
        self.magnet = Some(ForeignMagnet::passing(
            &mut self.rng,
            (self.recording, time_s + ahead_s),
            (distance_mm, pass_s),
            greatest_g,
            self.sensors,
        ));
        true
    }
}

impl Passage {
    /// Frames from the force's error to the flag; negative where the flag was first, infinite where
    /// one of them was not.
    pub fn latency(&self) -> f64 {
        match (self.off_at, self.flag_at) {
            (Some(off), Some(flag)) => f64::from(flag) - f64::from(off),
            _ => f64::INFINITY,
        }
    }

    /// One frame; `off` tells whether a force is off by more than [`worth_n`].
    pub fn note(&mut self, frame: u32, off: bool, flag: bool, measures: [f64; 4]) {
        if off {
            self.off_at.get_or_insert(frame);
        }
        if flag {
            self.flag_at.get_or_insert(frame);
        }
        if self.off_at.is_none_or(|at| frame <= at + IN_TIME) {
            for (greatest, now) in self.greatest.iter_mut().zip(measures) {
                *greatest = greatest.max(now);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_worth_an_alarm_is_the_same_share_of_every_range() {
        assert_eq!(worth_n(250.0), 20.0);
        assert!((worth_n(5.0) - 0.4).abs() < 1e-12);
    }
}
