//! One sensor over one recording, thinned, with what the model says of it.

use model_export::effects::Track;
use model_export::fit::rows::Part;
use model_export::fit::score::floor_squared;
use model_export::recordings::Recording;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;

use super::{Beside, Predict};

/// Most rows that a search looks at: a mistake of the rig shows in every row.
const MOST_ROWS: usize = 500;
/// Fewer rows tell nothing.
const LEAST_ROWS: usize = 20;
/// Step in newtons for the field's answer to a force: small beside any load, large beside rounding.
const STEP_N: f64 = 1.0;

/// One sensor over one recording.
pub struct Case<'a> {
    /// Number of the sensor.
    pub sensor: u32,
    /// Number of the recording, from zero.
    pub recording: usize,
    /// Its forces' columns.
    pub forces: &'a [(u32, Axis)],
    /// All its rows.
    pub part: &'a Part,
    /// Those of them that are looked at.
    pub rows: Vec<usize>,
    /// The track at these rows.
    pub track: Track,
    /// The field at these rows in gauss.
    pub measured: Vec<Vector3<f64>>,
    /// What the model says there as everything was recorded.
    pub modelled: Vec<Vector3<f64>>,
    /// Mean square that a perfect model would leave, in gauss squared, mean of the axes.
    pub floor: f64,
    /// Mean square of what this model leaves.
    pub as_recorded: f64,
    predict: Predict<'a>,
}

impl<'a> Case<'a> {
    /// `None` where there are too few rows, or the model says no number.
    pub fn new(sensor: &Beside<'a>, recording: usize, part: &'a Part) -> Option<Self> {
        let stride = part.len().div_ceil(MOST_ROWS).max(1);
        let rows: Vec<usize> = (0..part.len()).step_by(stride).collect();
        let track = part.track.at(&rows);
        let measured: Vec<Vector3<f64>> = rows.iter().map(|&row| part.field_g[row]).collect();
        let modelled = (sensor.predict)(&track);
        let as_recorded = mean_square(&measured, &modelled);
        let usable = rows.len() >= LEAST_ROWS && as_recorded.is_finite();
        let mut case = Self {
            sensor: sensor.rows.sensor,
            recording,
            forces: &sensor.rows.forces,
            part,
            rows,
            track,
            measured,
            modelled,
            floor: 0.0,
            as_recorded,
            predict: sensor.predict,
        };
        case.floor = case.mean_floor();
        usable.then_some(case)
    }

    fn mean_floor(&self) -> f64 {
        let answers = [0, 1].map(|axis| {
            let mut forces = self.track.force_n.clone();
            forces.iter_mut().for_each(|force| force[axis] += STEP_N);
            let moved = self.modelled_under(&Track {
                force_n: forces,
                ..self.track.clone()
            });
            let slope = |(after, before): (&Vector3<f64>, &Vector3<f64>)| (after - before) / STEP_N;
            moved
                .iter()
                .zip(&self.modelled)
                .map(slope)
                .collect::<Vec<_>>()
        });
        let at = |row: usize| {
            let slopes = self
                .forces
                .iter()
                .map(|(_, axis)| answers[usize::from(*axis == Axis::Z)][row]);
            floor_squared(self.part, slopes).sum() / 3.0
        };
        (0..self.rows.len()).map(at).sum::<f64>() / self.rows.len().max(1) as f64
    }

    /// Where the rows of the part are among the recording's.
    pub fn indices_of_part(&self, recording: &Recording) -> Vec<usize> {
        // They are some of them, in order.
        let mut next = 0;
        let place = |time: &f64| {
            next += recording
                .time_s
                .get(next..)?
                .iter()
                .position(|t| t == time)?
                + 1;
            Some(next - 1)
        };
        self.part.time_s.iter().filter_map(place).collect()
    }

    /// Where the rows that are looked at are among the recording's.
    pub fn indices(&self, recording: &Recording) -> Vec<usize> {
        let all = self.indices_of_part(recording);
        let rows = self.rows.iter();
        rows.filter_map(|&row| all.get(row).copied()).collect()
    }

    /// What the model says of another track.
    pub fn modelled_under(&self, track: &Track) -> Vec<Vector3<f64>> {
        (self.predict)(track)
    }

    /// Mean square of measured minus modelled over another track.
    pub fn left_under(&self, track: &Track) -> f64 {
        mean_square(&self.measured, &self.modelled_under(track))
    }
}

/// Mean over rows and axes of the squared difference; infinite where that is no number.
pub fn mean_square(measured: &[Vector3<f64>], modelled: &[Vector3<f64>]) -> f64 {
    let squares = measured
        .iter()
        .zip(modelled)
        .map(|(a, b)| (a - b).norm_squared());
    let mean = squares.sum::<f64>() / (3 * measured.len().max(1)) as f64;
    match mean.is_finite() && measured.len() == modelled.len() {
        true => mean,
        false => f64::INFINITY,
    }
}
