//! What one sensor met over one recording: the reference's forces and every covariate, row by row.

use std::collections::BTreeMap;

use crate::recordings::Recording;
use crate::recordings::columns::Axis;

use super::memory::{self, LoneReading};

/// Rows of one sensor over one recording, on the reference's clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Place of the recording in the campaign, from zero.
    pub recording: usize,
    /// Start of the recording in seconds since the campaign began.
    pub start_s: f64,
    /// Seconds that the recordings before it span: with it, every instant of a campaign has one
    /// time, even where nobody wrote down when a recording began.
    pub before_s: f64,
    /// Since the recording's first row, in seconds.
    pub time_s: Vec<f64>,
    /// Lateral and longitudinal force of the reference in newtons; zero where it has no such axis.
    pub force_n: Vec<[f64; 2]>,
    /// The same without the reference's white noise. What has memory or a derivative is computed
    /// from this, so that no effect can seem to help by averaging that noise away.
    pub smooth_n: Vec<[f64; 2]>,
    /// Rate of the force in N/s.
    pub rate_n_per_s: Vec<[f64; 2]>,
    /// What smoothing makes of a single row's noise.
    pub lone_reading: LoneReading,
    /// Load cycles of each axis since the campaign began, as [`Cycles`] counts them.
    pub cycles: Vec<[f64; 2]>,
    /// The sensor's temperature in degrees Celsius; empty where it was not recorded.
    pub temperature_c: Vec<f64>,
    /// Covariates of the whole gripper by column.
    pub covariates: BTreeMap<String, Vec<f64>>,
}

impl Track {
    /// The rows `usable` of `sensor` in `recording`, under the two forces of these places (`None`
    /// where an axis has no reference).
    pub fn new(
        recording: &Recording,
        place: (usize, f64),
        sensor: u32,
        forces: [Option<(u32, Axis)>; 2],
        usable: &[usize],
    ) -> Self {
        let pick = |values: &[f64]| -> Vec<f64> { usable.iter().map(|&i| values[i]).collect() };
        let first_s = recording.time_s.first().copied().unwrap_or(0.0);
        let time_s: Vec<f64> = usable
            .iter()
            .map(|&i| recording.time_s[i] - first_s)
            .collect();
        let columns = forces.map(|force| {
            let track = force.and_then(|force| recording.forces.get(&force));
            track.map_or_else(|| vec![0.0; usable.len()], |track| pick(&track.newtons))
        });
        let smoothed = columns
            .each_ref()
            .map(|values| memory::smooth(&time_s, values));
        let pair = |of: &dyn Fn(usize, usize) -> f64| {
            (0..usable.len()).map(|i| [of(0, i), of(1, i)]).collect()
        };
        let temperature = recording
            .sensors
            .get(&sensor)
            .map(|track| &track.temperature_c);
        Self {
            recording: place.0,
            start_s: recording.description.start_s,
            before_s: place.1,
            cycles: Vec::new(),
            lone_reading: LoneReading::among(&time_s),
            force_n: pair(&|axis, i| columns[axis][i]),
            smooth_n: pair(&|axis, i| smoothed[axis].0[i]),
            rate_n_per_s: pair(&|axis, i| smoothed[axis].1[i]),
            temperature_c: temperature
                .filter(|t| !t.is_empty())
                .map_or_else(Vec::new, |t| pick(t)),
            covariates: recording
                .covariates
                .iter()
                .map(|(name, values)| (name.clone(), pick(values)))
                .collect(),
            time_s,
        }
    }

    /// The same rows under other forces in newtons, one pair a row; what is smooth and the rates are
    /// formed anew, the count of load cycles stays.
    pub fn under(&self, force_n: Vec<[f64; 2]>) -> Self {
        let [x, z] = [0, 1].map(|axis| {
            let column: Vec<f64> = force_n.iter().map(|force| force[axis]).collect();
            memory::smooth(&self.time_s, &column)
        });
        let pair = |x: &[f64], z: &[f64]| x.iter().zip(z).map(|(x, z)| [*x, *z]).collect();
        Self {
            smooth_n: pair(&x.0, &z.0),
            rate_n_per_s: pair(&x.1, &z.1),
            force_n,
            ..self.clone()
        }
    }

    /// Only these rows of it, in this order.
    pub fn at(&self, rows: &[usize]) -> Self {
        Self {
            time_s: pick(&self.time_s, rows),
            force_n: pick(&self.force_n, rows),
            smooth_n: pick(&self.smooth_n, rows),
            rate_n_per_s: pick(&self.rate_n_per_s, rows),
            cycles: pick(&self.cycles, rows),
            temperature_c: pick(&self.temperature_c, rows),
            covariates: self
                .covariates
                .iter()
                .map(|(name, values)| (name.clone(), pick(values, rows)))
                .collect(),
            lone_reading: self.lone_reading.clone(),
            ..*self
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// A covariate by its column name: what a recording names, or one of [`OWN`].
    pub fn covariate(&self, name: &str) -> Option<Vec<f64>> {
        let force = |axis: usize| self.force_n.iter().map(|force| force[axis]).collect();
        match name {
            "fx_n" => Some(force(0)),
            "fz_n" => Some(force(1)),
            "temp_c" => (!self.temperature_c.is_empty()).then(|| self.temperature_c.clone()),
            "time_s" => Some(self.time_s.clone()),
            "session_s" => Some(self.time_s.iter().map(|t| t + self.start_s).collect()),
            _ => self.covariates.get(name).cloned(),
        }
    }
}

/// The values at these rows; none where a column was not recorded.
pub(super) fn pick<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
    let found = rows.iter().filter_map(|&row| values.get(row));
    found.copied().collect()
}

/// Covariates that every sensor has beside the recording's own columns: its two forces, its
/// temperature, the time since the recording began and since the campaign began.
pub const OWN: [&str; 5] = ["fx_n", "fz_n", "temp_c", "time_s", "session_s"];

/// Turns of the load within this share of its swing are noise and no way.
const PLAY: f64 = 0.05;

/// Counts load cycles through the recordings of a campaign, in their order: the way that the load goes up
/// and down, in ways of a cycle of the first recording's swing. A small cycle counts less than a large
/// one, and a cycle counts as it goes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cycles {
    before: [f64; 2],
    /// Amplitude of the sine that is as strong as the load of the first recording; zero before it and
    /// where there was no load.
    swing_n: [f64; 2],
}

impl Cycles {
    /// The next recording.
    pub fn count(&mut self, track: &mut Track) {
        track.cycles = vec![self.before; track.len()];
        for axis in [0, 1] {
            let force: Vec<f64> = track.smooth_n.iter().map(|force| force[axis]).collect();
            if self.swing_n[axis] <= 0.0 {
                let squares: f64 = force.iter().map(|force| force * force).sum();
                self.swing_n[axis] = (2.0 * squares / force.len().max(1) as f64).sqrt();
            }
            let swing_n = self.swing_n[axis];
            if swing_n <= 0.0 {
                continue;
            }
            let way_n = way(&force, PLAY * swing_n);
            for (cycles, way_n) in track.cycles.iter_mut().zip(way_n) {
                // Up, back, down, back.
                cycles[axis] += way_n / (4.0 * swing_n);
            }
        }
        if let Some(last) = track.cycles.last() {
            self.before = *last;
        }
    }
}

/// The way gone so far by what follows the force with a play of so much either way.
fn way(force_n: &[f64], play_n: f64) -> Vec<f64> {
    let (mut at, mut way) = (force_n.first().copied().unwrap_or(0.0), 0.0);
    let step = |force: &f64| {
        let to = at.clamp(force - play_n, force + play_n);
        way += (to - at).abs();
        at = to;
        way
    };
    force_n.iter().map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_under_other_forces_has_their_rates_and_keeps_its_covariates() {
        let time_s: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.01).collect();
        let track = Track {
            force_n: vec![[1.0, 2.0]; 100],
            temperature_c: time_s.clone(),
            time_s,
            ..Track::default()
        };
        let ramp = track.time_s.iter().map(|t| [5.0 * t, -3.0]).collect();
        let under = track.under(ramp).at(&[10, 90]);
        assert_eq!(under.time_s, [0.1, 0.9]);
        assert_eq!(under.temperature_c, [0.1, 0.9]);
        assert!((under.smooth_n[1][0] - 4.5).abs() < 1e-9);
        assert!((under.rate_n_per_s[0][0] - 5.0).abs() < 1e-6);
        assert!(under.rate_n_per_s[1][1].abs() < 1e-6);
    }

    #[test]
    fn load_cycles_are_counted_through_recordings() {
        let time_s: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
        let sine = |t: &f64| [100.0 * (std::f64::consts::TAU * t).sin(), 0.0];
        let mut tracks = vec![
            Track {
                smooth_n: time_s.iter().map(sine).collect(),
                time_s,
                ..Track::default()
            };
            2
        ];
        let mut cycles = Cycles::default();
        tracks.iter_mut().for_each(|track| cycles.count(track));
        let last = |track: &Track| track.cycles.last().unwrap()[0];
        // Ten periods each; of each turn the play takes its width.
        assert!((last(&tracks[0]) - 10.0 * 0.95).abs() < 0.05);
        assert!((last(&tracks[1]) - 20.0 * 0.95).abs() < 0.1);
        assert_eq!(tracks[1].cycles[0][1], 0.0);
    }
}
