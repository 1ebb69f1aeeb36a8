//! One way on the held-out recording: every row through the device's code, floating point beside it.

use anyhow::{Result, bail};
use model_export::inverse::build::Built;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;

use super::data::Data;
use super::teach::Taught;
use super::variant::Variant;
use crate::coverage::Coverage;
use crate::replay::{Models, Observed, RecordingReplay, Sums, coverage, replay_watched};

/// Of how many rows one error is kept, for the histogram.
const KEPT: usize = 10;
/// Stretch that is shown over time, in seconds since the recording's start.
pub const SHOWN_S: [f64; 2] = [2.0, 12.0];

/// One force over all sensors, in newtons.
#[derive(Clone, Copy, Debug, Default)]
pub struct Axis {
    /// Floating point minus reference.
    pub float: Sums,
    /// The same after the tare; `None` where a sensor never rests.
    pub float_tared: Option<Sums>,
    /// The device minus reference.
    pub fixed: Sums,
    /// The same after the tare.
    pub fixed_tared: Option<Sums>,
    /// What white noise of sensor and reference would leave of the estimates.
    pub noise_n: f64,
}

/// A way with its figures.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The way.
    pub variant: Variant,
    /// Fx, Fz.
    pub axes: [Axis; 2],
    /// Shares of the rows within the standard deviations that are told, after the tare.
    pub coverage: Option<Coverage>,
    /// Rows in which the device called the estimate invalid.
    pub invalid: u64,
    /// Some of the device's errors of each force, in newtons.
    pub errors_n: [Vec<f64>; 2],
    /// The first sensor over [`SHOWN_S`].
    pub shown: Vec<Observed>,
}

impl Judged {
    /// Root mean square error of the device over both forces.
    pub fn rmse_n(&self) -> f64 {
        let [x, z] = self.axes;
        x.fixed.with(z.fixed).rms()
    }

    /// The same after the tare.
    pub fn tared_rmse_n(&self) -> Option<f64> {
        let [x, z] = self.axes;
        Some(x.fixed_tared?.with(z.fixed_tared?).rms())
    }
}

/// Judges a way.
pub fn judge(
    data: &Data,
    variant: Variant,
    built: &Built,
    taught: Option<&Taught>,
) -> Result<Judged> {
    let (description, _) = Description::read(&data.held_out)?;
    let stream = RawStream::open(&data.held_out, &description, data.alignment)?;
    let models = Models {
        networks: taught.map(|taught| &taught.networks),
        ..Models::of(built)
    };
    let (mut errors_n, mut shown) = ([Vec::new(), Vec::new()], Vec::new());
    let (mut first_s, mut count) = (None, 0_usize);
    let watch = |seen: Observed| {
        let time_s = seen.time_s - *first_s.get_or_insert(seen.time_s);
        if count.is_multiple_of(KEPT) {
            for (axis, errors) in errors_n.iter_mut().enumerate() {
                errors.push(seen.found_n[axis] - seen.reference_n[axis]);
            }
            if seen.sensor == 0 && (SHOWN_S[0]..=SHOWN_S[1]).contains(&time_s) {
                shown.push(Observed { time_s, ..seen });
            }
        }
        count += 1;
    };
    let replay = replay_watched(models, &data.held_out_name(), stream, |_| (), watch)?;
    let judged = [0, 1].map(|axis| pool(&replay, axis));
    if judged.iter().any(|axis| axis.fixed.rows() == 0.0) {
        bail!(
            "{}: in no row are a valid estimate of {} and a measured force together",
            data.held_out.display(),
            variant.words()
        );
    }
    Ok(Judged {
        variant,
        axes: judged,
        coverage: coverage(std::slice::from_ref(&replay)),
        invalid: replay.sensors.iter().map(|sensor| sensor.invalid).sum(),
        errors_n,
        shown,
    })
}

/// One force over all sensors.
fn pool(replay: &RecordingReplay, axis: usize) -> Axis {
    let tracks = || replay.sensors.iter().map(|sensor| &sensor.axes[axis]);
    let none = || Some(Sums::default());
    let both = |sum: Option<Sums>, tared: Option<Sums>| Some(sum?.with(tared?));
    let squares: f64 = tracks().map(|track| track.noise_n.powi(2)).sum();
    Axis {
        float: tracks().fold(Sums::default(), |sum, track| sum.with(track.float)),
        float_tared: tracks().fold(none(), |sum, track| both(sum, track.float_tared())),
        fixed: tracks().fold(Sums::default(), |sum, track| sum.with(track.error)),
        fixed_tared: tracks().fold(none(), |sum, track| both(sum, track.tared())),
        noise_n: (squares / replay.sensors.len().max(1) as f64).sqrt(),
    }
}
