//! Magnets that pass the gripper one after the other, and the detection of each.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use sim::external_fields::PassingMagnet;
use sim::random::{Purpose, stream, uniform};

/// Distance of the closest approach from the gripper's centre in mm; log-uniform, as duration and field.
const DISTANCE_MM: [f64; 2] = [55.0, 250.0];
const DURATION_S: [f64; 2] = [0.03, 3.0];
/// Maximum field at a sensor in gauss.
const MAX_FIELD_G: [f64; 2] = [15.0, 300.0];
/// Pause between two magnets in seconds.
const PAUSE_S: f64 = 1.5;
/// Earliest start of the first magnet.
const FIRST_S: f64 = 3.0;
/// Force error, as a fraction of the range, above which detection is required: 20 N of MAGPIE's 250 N.
const ALARM_FRACTION: f64 = 20.0 / 250.0;
/// Frames from the force error to the flag within which a magnet counts as detected.
pub const MAX_LATENCY: u32 = 20;

/// Draws one magnet after the other over a recording.
pub struct DisturbanceSequence {
    rng: ChaCha8Rng,
    recording: u32,
    sensors: u32,
    /// All magnets have passed by this time.
    end_s: f64,
    pub magnet: Option<PassingMagnet>,
    next_s: f64,
}

/// Force error in newtons above which detection is required, for a sensor with a range of `range_n`.
pub fn alarm_error_n(range_n: f64) -> f64 {
    ALARM_FRACTION * range_n
}

/// Detection of one magnet.
#[derive(Clone, Copy, Debug, Default)]
pub struct DisturbanceEvent {
    /// First frame with a force error above [`alarm_error_n`].
    pub error_at: Option<u32>,
    /// First frame with the flag set while the magnet's field was present.
    pub flag_at: Option<u32>,
}

impl DisturbanceSequence {
    /// Magnets over `seconds` of a recording of a gripper with this many sensors.
    pub fn new(seed: u64, recording: u32, seconds: f64, sensors: u32) -> Self {
        Self {
            rng: stream(seed, Purpose::ExternalMagnet, recording),
            recording,
            sensors,
            end_s: seconds,
            magnet: None,
            next_s: FIRST_S,
        }
    }

    /// Field of the passing magnet at a sensor, in gauss, body axes.
    pub fn field(&self, sensor: u32, time_s: f64) -> Vector3<f64> {
        let magnet = self.magnet.as_ref();
        magnet.map_or_else(Vector3::zeros, |magnet| magnet.field(self.recording, sensor, time_s))
    }

    /// Removes a magnet that has passed and starts the next one, but only while the flag is clear. True
    /// when one starts.
    pub fn advance(&mut self, time_s: f64, flag: bool) -> bool {
        if let Some(magnet) = &self.magnet
            && time_s > magnet.support_s()[1]
        {
            (self.magnet, self.next_s) = (None, time_s + PAUSE_S);
        }
        if flag || self.magnet.is_some() || time_s < self.next_s {
            return false;
        }
        let rng = &mut self.rng;
        let mut log_uniform = |[min, max]: [f64; 2]| uniform(rng, min.ln(), max.ln()).exp();
        let distance_mm = log_uniform(DISTANCE_MM);
        let duration_s = log_uniform(DURATION_S);
        let max_g = log_uniform(MAX_FIELD_G);
        let (recording, sensors) = (self.recording, self.sensors);
        let passing = |rng: &mut ChaCha8Rng, closest_s: f64| {
            let (when, path) = ((recording, closest_s), (distance_mm, duration_s));
            PassingMagnet::on_random_path(rng, when, path, max_g, sensors)
        };
        let [from, to] = passing(&mut self.rng.clone(), 0.0).support_s();
        let half_s = 0.5 * (to - from);
        if time_s + 2.0 * half_s > self.end_s {
            self.next_s = f64::INFINITY;
            return false;
        }
        self.magnet = Some(passing(&mut self.rng, time_s + half_s));
        true
    }
}

impl DisturbanceEvent {
    /// Frames from the force error to the flag: negative if the flag was first, infinite without one of them.
    pub fn latency(&self) -> f64 {
        match (self.error_at, self.flag_at) {
            (Some(error), Some(flag)) => f64::from(flag) - f64::from(error),
            _ => f64::INFINITY,
        }
    }

    /// Adds one frame; `is_wrong` where a force error exceeds [`alarm_error_n`].
    pub fn update(&mut self, frame: u32, is_wrong: bool, flag: bool) {
        if is_wrong {
            self.error_at.get_or_insert(frame);
        }
        if flag {
            self.flag_at.get_or_insert(frame);
        }
    }
}
