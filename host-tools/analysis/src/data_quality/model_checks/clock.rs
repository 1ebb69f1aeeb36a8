//! `clock_skew`: constant offset between the two clocks.

use model_export::effects::ExcitationSeries;
use model_export::effects::operators::delayed;
use model_export::recordings::Location;
use model_export::recordings::smoothing::smooth;
use rayon::prelude::*;

use crate::data_quality::checks::Found;
use crate::data_quality::evidence::{Evidence, RecordingSet};
use crate::data_quality::model_checks::ModelResiduals;
use crate::data_quality::model_checks::case::Case;

/// Search range in milliseconds on each side and step; the wider range is used if the
/// optimum of the first is at its end.
const RANGES_MS: [(f64, f64); 2] = [(50.0, 5.0), (1000.0, 20.0)];
/// Number of bisections of the step: resolution of a hundredth of a millisecond.
const REFINEMENTS: usize = 10;
/// Smaller offsets are left to `magpie diagnose`, which compares them with similar effects.
const LEAST_MS: f64 = 1.5;
/// Minimum share of the error above the floor that the offset removes, over all sensors.
const FALLS: f64 = 0.7;
/// The same for every single sensor: the lag of one flexure is not a clock offset.
const FALLS_EACH: f64 = 0.5;
/// Minimum error above the floor, relative to the floor.
const ABOVE_FLOOR: f64 = 0.5;
/// Maximum difference in milliseconds of offsets that are one delay.
const SAME_MS: f64 = 1.0;

/// Clock offset of one recording.
#[derive(Clone, Copy, Debug)]
struct Shift {
    recording: usize,
    ms: f64,
    fall: f64,
    sensors: usize,
}

/// Clock offset of every recording without column errors.
pub fn offsets<'a>(residuals: &ModelResiduals<'a>) -> Vec<Found<'a>> {
    let recordings = 0..residuals.campaign.recordings.len();
    let shifts: Vec<Shift> = recordings
        .into_par_iter()
        .filter_map(|recording| {
            let own = residuals.sound.iter().filter(|case| case.recording == recording);
            shift(recording, &own.collect::<Vec<_>>())
        })
        .collect();
    let mut groups: Vec<Vec<Shift>> = Vec::new();
    for shift in shifts {
        let same = |group: &&mut Vec<Shift>| (group[0].ms - shift.ms).abs() < SAME_MS;
        match groups.iter_mut().find(same) {
            Some(group) => group.push(shift),
            None => groups.push(vec![shift]),
        }
    }
    groups.iter().map(|group| describe(residuals, group)).collect()
}

fn describe<'a>(residuals: &ModelResiduals<'a>, group: &[Shift]) -> Found<'a> {
    let campaign = residuals.campaign;
    let mean_ms = group.iter().map(|shift| shift.ms).sum::<f64>() / group.len() as f64;
    let fall = group.iter().map(|shift| shift.fall).fold(1.0, f64::min);
    let place = Location::file(&residuals.names.force(group[0].recording)).column("t_us");
    let hit = group.iter().map(|shift| shift.recording);
    let names = campaign.recordings.iter().map(|recording| &recording.name);
    let evidence = Evidence::ClockLag {
        lag_ms: mean_ms,
        recordings: RecordingSet::of(hit, names),
        sensors: group[0].sensors,
        share: fall,
        delay_ms: mean_ms + residuals.alignment.delay_us / 1e3,
    };
    Found::new(place, evidence)
}

fn shift(recording: usize, cases: &[&Case]) -> Option<Shift> {
    let delayable: Vec<Delayable> = cases.par_iter().map(|case| Delayable::of(case)).collect();
    let excess = |ms: f64| -> Vec<f64> {
        let above = |of: &Delayable| of.case.left_under(&of.later(1e-3 * ms)) / of.case.floor - 1.0;
        delayable.par_iter().map(above).collect()
    };
    let total = |each: &[f64]| each.iter().map(|above| above.max(0.0)).sum::<f64>();
    let at_once = excess(0.0);
    let before = total(&at_once);
    if cases.is_empty() || !before.is_finite() || before < ABOVE_FLOOR * cases.len() as f64 {
        return None;
    }
    // Clipped at the floor, the sum would be flat around its minimum.
    let ms = best(|ms| excess(ms).iter().sum());
    let each = excess(ms);
    let fall = 1.0 - total(&each) / before;
    // A sensor without error above the floor cannot improve.
    let everywhere = at_once
        .iter()
        .zip(&each)
        .all(|(before, after)| after.max(0.0) <= (1.0 - FALLS_EACH) * before.max(ABOVE_FLOOR));
    (ms.abs() > LEAST_MS && fall >= FALLS && everywhere).then_some(Shift {
        recording,
        ms,
        fall,
        sensors: cases.len(),
    })
}

/// Minimiser of the function in milliseconds.
fn best(of: impl Fn(f64) -> f64) -> f64 {
    let mut found = (0.0, f64::INFINITY);
    for (reach, mut step) in RANGES_MS {
        let steps = (reach / step) as i32;
        for ms in (-steps..=steps).map(|i| f64::from(i) * step) {
            let left = of(ms);
            if left < found.1 {
                found = (ms, left);
            }
        }
        if found.0.abs() + 0.5 * step > reach {
            continue;
        }
        for _ in 0..REFINEMENTS {
            step *= 0.5;
            for ms in [found.0 - step, found.0 + step] {
                let left = of(ms);
                if left < found.1 {
                    found = (ms, left);
                }
            }
        }
        break;
    }
    found.0
}

/// A column of the forces of a whole recording, with its rate.
struct Column {
    values: Vec<f64>,
    rate: Vec<f64>,
}

/// The forces of a case, to be read at other times.
struct Delayable<'a> {
    case: &'a Case<'a>,
    /// Smoothed forces and their rates, of both axes.
    columns: [[Column; 2]; 2],
}

impl<'a> Delayable<'a> {
    fn of(case: &'a Case<'a>) -> Self {
        let whole = &case.part.track;
        let columns = [&whole.smooth_n, &whole.rate_n_per_s].map(|pairs| {
            [0, 1].map(|axis| {
                let values: Vec<f64> = pairs.iter().map(|pair| pair[axis]).collect();
                let (_, rate) = smooth(&whole.time_s, &values);
                Column { values, rate }
            })
        });
        Self { case, columns }
    }

    /// Series with the forces of `delay_s` earlier, smoothed over the reference's noise at any shift: linear interpolation averages
    /// noise and would favour half a step.
    fn later(&self, delay_s: f64) -> ExcitationSeries {
        let time_s = &self.case.part.track.time_s;
        let [smooth_n, rate_n_per_s] = self.columns.each_ref().map(|pair| {
            let [x, z] = pair.each_ref().map(|of| delayed(time_s, &of.values, &of.rate, delay_s));
            self.case.rows.iter().map(|&row| [x[row], z[row]]).collect::<Vec<_>>()
        });
        let force_n = smooth_n.clone();
        ExcitationSeries { force_n, rate_n_per_s, smooth_n, ..self.case.track.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::best;

    #[test]
    fn offset_is_found_near_and_far() {
        for wanted in [-3.37, 0.2, 41.0, 340.0] {
            let found = best(|ms| (ms - wanted).powi(2));
            assert!((found - wanted).abs() < 0.03, "{wanted}: {found}");
        }
    }
}
