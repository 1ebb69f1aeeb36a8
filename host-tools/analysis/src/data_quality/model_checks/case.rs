//! One sensor over one recording, measured and predicted.

use model_export::effects::ExcitationSeries;
use model_export::fit::cross_validation::noise_variance;
use model_export::fit::rows::{RecordingRows, SensorRows};
use model_export::physics::SensorOrientation;
use model_export::recordings::Recording;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;

/// Predicted field in gauss for each row of a track.
pub type Predict<'a> = &'a (dyn Fn(&ExcitationSeries) -> Vec<Vector3<f64>> + Sync);

/// Measured rows of one sensor and its model.
#[derive(Clone, Copy)]
pub struct SensorPrediction<'a> {
    /// Measured rows.
    pub rows: &'a SensorRows,
    /// Model prediction.
    pub predict: Predict<'a>,
}

/// Maximum number of rows for a search: a setup error affects every row.
const MOST_ROWS: usize = 500;
/// Minimum number of rows.
const LEAST_ROWS: usize = 20;
/// Step in newtons of the numerical derivative of the field: small against any load, large against rounding.
const STEP_N: f64 = 1.0;

/// One sensor over one recording.
pub struct Case<'a> {
    /// Number of the sensor, from 1.
    pub sensor: u32,
    /// Zero-based number of the recording.
    pub recording: usize,
    /// Columns of its forces.
    pub forces: &'a [(u32, Axis)],
    pub part: &'a RecordingRows,
    /// Indices of the subsample.
    pub rows: Vec<usize>,
    /// Covariates and forces of the subsample.
    pub track: ExcitationSeries,
    /// Measured field of the subsample in gauss, as recorded: in the sensor's axes.
    pub measured: Vec<Vector3<f64>>,
    /// Predicted field with the columns as recorded, in the sensor's axes.
    pub modelled: Vec<Vector3<f64>>,
    /// Mean square of the noise in gauss squared, mean of the axes.
    pub floor: f64,
    /// Mean square of the model's residual.
    pub as_recorded: f64,
    predict: Predict<'a>,
    orientation: SensorOrientation,
}

impl<'a> Case<'a> {
    /// `None` with too few rows or a prediction that is not finite.
    pub fn new(
        sensor: &SensorPrediction<'a>,
        recording: usize,
        part: &'a RecordingRows,
    ) -> Option<Self> {
        let stride = part.len().div_ceil(MOST_ROWS).max(1);
        let rows: Vec<usize> = (0..part.len()).step_by(stride).collect();
        let track = part.track.at(&rows);
        let orientation = sensor.rows.orientation;
        let measured = rows.iter().map(|&row| orientation.to_sensor(part.field_g[row])).collect();
        let mut case = Self {
            sensor: sensor.rows.sensor,
            recording,
            forces: &sensor.rows.forces,
            part,
            rows,
            track,
            measured,
            modelled: Vec::new(),
            floor: 0.0,
            as_recorded: 0.0,
            predict: sensor.predict,
            orientation,
        };
        case.modelled = case.modelled_under(&case.track);
        case.as_recorded = mean_square(&case.measured, &case.modelled);
        case.floor = case.mean_floor();
        let usable = case.rows.len() >= LEAST_ROWS && case.as_recorded.is_finite();
        usable.then_some(case)
    }

    fn mean_floor(&self) -> f64 {
        let answers = [0, 1].map(|axis| {
            let mut forces = self.track.force_n.clone();
            forces.iter_mut().for_each(|force| force[axis] += STEP_N);
            let moved =
                self.modelled_under(&ExcitationSeries { force_n: forces, ..self.track.clone() });
            let slope = |(after, before): (&Vector3<f64>, &Vector3<f64>)| (after - before) / STEP_N;
            moved.iter().zip(&self.modelled).map(slope).collect::<Vec<_>>()
        });
        let at = |row: usize| {
            let slopes =
                self.forces.iter().map(|(_, axis)| answers[usize::from(*axis == Axis::Z)][row]);
            noise_variance(self.part, Some(self.rows[row]), slopes).sum() / 3.0
        };
        (0..self.rows.len()).map(at).sum::<f64>() / self.rows.len().max(1) as f64
    }

    /// Indices of the part's rows in the recording.
    pub fn indices_of_part(&self, recording: &Recording) -> Vec<usize> {
        let mut next = 0;
        let place = |time: &f64| {
            next += recording.time_s.get(next..)?.iter().position(|t| t == time)? + 1;
            Some(next - 1)
        };
        self.part.time_s.iter().filter_map(place).collect()
    }

    /// Indices of the subsample in the recording.
    pub fn indices(&self, recording: &Recording) -> Vec<usize> {
        let all = self.indices_of_part(recording);
        let rows = self.rows.iter();
        rows.filter_map(|&row| all.get(row).copied()).collect()
    }

    /// Prediction for another track, in the sensor's axes.
    pub fn modelled_under(&self, track: &ExcitationSeries) -> Vec<Vector3<f64>> {
        let fields = (self.predict)(track).into_iter();
        fields.map(|field| self.orientation.to_sensor(field)).collect()
    }

    /// Mean square of the residual for another track.
    pub fn left_under(&self, track: &ExcitationSeries) -> f64 {
        mean_square(&self.measured, &self.modelled_under(track))
    }
}

/// Mean over rows and axes of the squared difference; infinite where it is not a number.
pub fn mean_square(measured: &[Vector3<f64>], modelled: &[Vector3<f64>]) -> f64 {
    let squares = measured.iter().zip(modelled).map(|(a, b)| (a - b).norm_squared());
    let mean = squares.sum::<f64>() / (3 * measured.len().max(1)) as f64;
    if mean.is_finite() && measured.len() == modelled.len() { mean } else { f64::INFINITY }
}
