//! The residuals with everything that they may depend on, row by row, thinned where there are many.

use nalgebra::Vector3;

use super::covariate::Covariate;
use model_export::effects::Track;

/// Rows of a sensor that are kept: five minutes at 100 Hz. Of more, every second, third and so on
/// is: what a residual depends on shows in these as well.
pub const MOST_ROWS: usize = 30_000;

/// The residuals of one sensor.
#[derive(Clone, Debug)]
pub struct SensorColumns {
    /// Number of the sensor.
    pub sensor: u32,
    /// The recording of each row, from zero.
    pub recording: Vec<u32>,
    /// Time in the recording, in seconds.
    pub time_s: Vec<f64>,
    /// Measured minus modelled, in gauss.
    pub residual_g: Vec<Vector3<f64>>,
    /// What a perfect model would leave, squared.
    pub floor_g2: Vec<Vector3<f64>>,
    /// The covariates, the same ones at every sensor.
    pub covariates: Vec<Column>,
}

/// A covariate, row by row.
#[derive(Clone, Debug)]
pub struct Column {
    /// Which.
    pub of: Covariate,
    /// Its values, NaN where a recording has none.
    pub values: Vec<f32>,
}

impl SensorColumns {
    /// Without rows.
    pub fn new(sensor: u32, covariates: &[Covariate]) -> Self {
        Self {
            sensor,
            recording: Vec::new(),
            time_s: Vec::new(),
            residual_g: Vec::new(),
            floor_g2: Vec::new(),
            covariates: covariates
                .iter()
                .map(|of| Column {
                    of: of.clone(),
                    values: Vec::new(),
                })
                .collect(),
        }
    }

    /// Every `stride`-th row of one recording.
    pub fn push(
        &mut self,
        recording: usize,
        track: &Track,
        residual_g: &[Vector3<f64>],
        floor_g2: &[Vector3<f64>],
        stride: usize,
    ) {
        let kept = || (0..track.len()).step_by(stride);
        self.recording.extend(kept().map(|_| recording as u32));
        self.time_s.extend(kept().map(|row| track.time_s[row]));
        self.residual_g.extend(kept().map(|row| residual_g[row]));
        self.floor_g2.extend(kept().map(|row| floor_g2[row]));
        for Column { of, values: column } in &mut self.covariates {
            match of.values(track, recording + 1) {
                Some(values) => column.extend(kept().map(|row| values[row] as f32)),
                None => column.extend(kept().map(|_| f32::NAN)),
            }
        }
    }

    /// The covariate of this name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.covariates.iter().find(|column| column.of.name == name)
    }

    /// Rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
}
