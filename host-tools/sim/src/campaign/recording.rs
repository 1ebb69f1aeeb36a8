//! One recording: sample clocks, reference sensor, and the files of board and reference.

use crate::campaign::excitation::Excitation;
use crate::campaign::gripper::{CampaignGripper, CampaignTime};
use crate::campaign::settings::{CampaignSettings, start_s};
use crate::effects::Effects;
use crate::hall_sensor::HallNoise;
use crate::motion::{LEAD_MM, POLE_PAIRS};
use crate::random::{Purpose, normal, stream, uniform};
use anyhow::{Context, Result};
use csv::Writer;
use flate2::Compression;
use flate2::write::GzEncoder;
use model_export::effects::catalogue::{CLOCK_SKEW, REFERENCE_DRIFT, REFERENCE_FILTER};
use model_export::recordings::columns::{Axis, COVARIATES};
use model_export::recordings::description::RecordingDescription;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::TAU;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

/// Noise of a temperature in K, one standard deviation (assumed of ordinary parts, as those below).
const TEMPERATURE_C: f64 = 0.05;
/// Noise of [`COVARIATES`] in mm, A, rad and m/s^2.
const COVARIATE_NOISE: [f64; COVARIATES.len()] =
    [0.005, 0.02, 0.002, 0.05, 0.05, 0.05, 0.002, 0.002, 0.002];

/// Unloaded time before the first row.
pub const SETTLING_S: f64 = 1.0;

/// A compressed CSV file.
type CsvFile = Writer<GzEncoder<BufWriter<File>>>;

/// Writes one recording.
pub struct RecordingWriter<'a> {
    /// Settings of the campaign.
    pub settings: &'a CampaignSettings,
    /// Simulated effects.
    pub effects: &'a Effects,
    /// Number of the recording.
    pub recording: u32,
    /// Excitation of the recording.
    pub excitation: &'a Excitation,
    /// Clocks of board and reference.
    pub clocks: [SampleClock; 2],
}

impl RecordingWriter<'_> {
    /// Writes the three files of the recording into a new folder; the gripper advances in time.
    pub fn write(&self, folder: &Path, gripper: &mut CampaignGripper) -> Result<()> {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        self.description().write(folder)?;
        self.hall(folder, gripper)
            .and_then(|()| self.force(folder))
            .with_context(|| format!("cannot write {}", folder.display()))
    }

    /// Independent of the simulated effects.
    fn description(&self) -> RecordingDescription {
        let mut design = self.settings.design.clone();
        design.more.insert("motor_pole_pairs".into(), (POLE_PAIRS as i64).into());
        design.more.insert("screw_lead_mm_per_rev".into(), LEAD_MM.into());
        let start_s = start_s(self.settings.seconds, self.recording);
        let text = format!(
            "simulated bench, {} sensors, lateral and longitudinal load",
            self.settings.sensors
        );
        let mut description = RecordingDescription::new(text, start_s);
        description.gauss_per_lsb = Some(self.settings.part.gauss_per_lsb);
        description.range_gauss = Some(self.settings.part.range_gauss);
        description.design = Some(design);
        description
    }

    fn hall(&self, folder: &Path, gripper: &mut CampaignGripper) -> Result<()> {
        let mut table = create(folder, "hall.csv.gz")?;
        table.write_record(hall_columns(self.settings.sensors))?;
        let mut sampler = RecordingSampler::new(self.settings, self.recording);
        // With clock skew the board records the field of an earlier time.
        let skew_s = 1e-3 * self.effects.size(CLOCK_SKEW.id);
        let mut last_s = f64::NAN;
        for (stamp_us, true_s) in self.clocks[0].ticks(self.excitation.seconds()) {
            let time_s = true_s - skew_s;
            let since_s = if last_s.is_nan() { SETTLING_S } else { time_s - last_s };
            last_s = time_s;
            let sample = sampler.sample(gripper, self.excitation, time_s, since_s);
            let mut row = vec![stamp_us.to_string()];
            for (field_g, temperature_c) in sample.sensors {
                let counts = self.settings.part.counts(field_g);
                row.extend(counts.map(|count| count.to_string()));
                row.push(format!("{temperature_c:.2}"));
            }
            let written = sample.covariates.iter().zip(DECIMALS);
            row.extend(written.map(|(value, decimals)| format!("{value:.decimals$}")));
            table.write_record(&row)?;
        }
        close(table)
    }

    fn force(&self, folder: &Path) -> Result<()> {
        let mut table = create(folder, "force.csv.gz")?;
        table.write_record(force_columns(0..self.settings.sensors))?;
        let start_s = start_s(self.settings.seconds, self.recording);
        let mut rng = stream(self.settings.seed, Purpose::ReferenceNoise, self.recording);
        let mut references =
            vec![ReferenceSensor::new(self.effects); self.settings.sensors as usize];
        for (stamp_us, true_s) in self.clocks[1].ticks(self.excitation.seconds()) {
            let mut row = vec![stamp_us.to_string()];
            for (sensor, reference) in references.iter_mut().enumerate() {
                let load = |time_s| self.excitation.load(sensor, time_s);
                for newtons in reference.read(true_s, start_s, load) {
                    let noise = self.settings.reference_noise_n * normal(&mut rng);
                    row.push(format!("{:.3}", newtons + noise));
                }
            }
            table.write_record(&row)?;
        }
        close(table)
    }
}

/// Decimals of [`COVARIATES`] in the file.
const DECIMALS: [usize; COVARIATES.len()] = [3, 3, 4, 3, 3, 3, 4, 4, 4];

/// Samples of a recording before quantisation, in order of time.
pub struct RecordingSampler<'a> {
    settings: &'a CampaignSettings,
    recording: u32,
    noises: Vec<HallNoise>,
    rng: ChaCha8Rng,
}

/// One sample with noise.
pub struct RecordedSample {
    /// Field in gauss and temperature in degrees Celsius of each sensor.
    pub sensors: Vec<(Vector3<f64>, f64)>,
    /// Values of [`COVARIATES`].
    pub covariates: [f64; COVARIATES.len()],
}

impl<'a> RecordingSampler<'a> {
    /// Before the first sample of a recording.
    pub fn new(settings: &'a CampaignSettings, recording: u32) -> Self {
        let noise = |sensor| settings.noise_of(recording, sensor);
        Self {
            settings,
            recording,
            noises: (0..settings.sensors).map(noise).collect(),
            rng: stream(settings.seed, Purpose::Covariates, recording),
        }
    }

    /// Sample at a time, `since_s` after the previous one; advances the gripper.
    pub fn sample(
        &mut self,
        gripper: &mut CampaignGripper,
        excitation: &Excitation,
        time_s: f64,
        since_s: f64,
    ) -> RecordedSample {
        let time = CampaignTime { recording: self.recording, time_s, since_s };
        let fields_g = gripper.advance(self.settings, excitation, time);
        let noisy = fields_g.iter().zip(&mut self.noises).enumerate();
        let sensors = noisy.map(|(sensor, (field_g, noise))| {
            let temperature_c = excitation.temperature_c(sensor, time_s);
            let noise_c = TEMPERATURE_C * normal(&mut self.rng);
            (field_g + noise.next(since_s), temperature_c + noise_c)
        });
        let sensors = sensors.collect();
        RecordedSample { sensors, covariates: covariates(excitation, time_s, &mut self.rng) }
    }
}

/// Noisy values of [`COVARIATES`], in their order.
fn covariates(
    excitation: &Excitation,
    time_s: f64,
    rng: &mut ChaCha8Rng,
) -> [f64; COVARIATES.len()] {
    let mut values = excitation.covariates(time_s);
    for (value, noise) in values.iter_mut().zip(COVARIATE_NOISE) {
        *value += noise * normal(rng);
    }
    let [.., angle_rad, _, _, _, _, _, _] = &mut values;
    *angle_rad = angle_rad.rem_euclid(TAU);
    values
}

fn hall_columns(sensors: u32) -> Vec<String> {
    let mut columns = vec!["t_us".to_owned()];
    columns.extend((0..sensors).flat_map(sensor_columns));
    columns.extend(COVARIATES.iter().map(|name| (*name).to_owned()));
    columns
}

/// Columns of a sensor in `hall.csv`: raw counts and temperature.
pub fn sensor_columns(sensor: u32) -> [String; 4] {
    let [x, y, z] = Axis::ALL.map(|axis| format!("s{sensor}_{}_lsb", axis.letter()));
    [x, y, z, format!("s{sensor}_temp_c")]
}

/// Columns of `force.csv` for these sensors.
pub fn force_columns(sensors: impl IntoIterator<Item = u32>) -> Vec<String> {
    let mut columns = vec!["t_us".to_owned()];
    for sensor in sensors {
        columns.extend([format!("f{sensor}_x_n"), format!("f{sensor}_z_n")]);
    }
    columns
}

fn create(folder: &Path, name: &str) -> Result<CsvFile> {
    let file = BufWriter::new(File::create_new(folder.join(name))?);
    Ok(Writer::from_writer(GzEncoder::new(file, Compression::fast())))
}

/// Finishes the file explicitly, because a drop would lose errors.
fn close(table: CsvFile) -> Result<()> {
    let packed = table.into_inner().map_err(|error| error.into_error())?;
    packed.finish()?.into_inner().map_err(|error| error.into_error())?;
    Ok(())
}

/// Range of the first tick, in microseconds.
const FIRST_US: [f64; 2] = [20.0, 400.0];

/// Standard deviation of a clock's rate error (temperature-compensated crystals), in 1e-6.
const RATE_PPM: f64 = 1.0;

/// A clock that stamps samples at a constant interval of its own time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampleClock {
    /// First stamp.
    pub first_us: u64,
    /// Step between stamps.
    pub period_us: u64,
    /// Rate error in 1e-6.
    pub fast_ppm: f64,
}

impl SampleClock {
    /// Draws the clocks of board and reference for a recording.
    pub fn draw(seed: u64, recording: u32, rates_hz: [f64; 2]) -> [Self; 2] {
        let mut rng = stream(seed, Purpose::Clocks, recording);
        rates_hz.map(|rate_hz| Self {
            first_us: uniform(&mut rng, FIRST_US[0], FIRST_US[1]).round() as u64,
            period_us: (1e6 / rate_hz).round() as u64,
            fast_ppm: RATE_PPM * normal(&mut rng),
        })
    }

    /// All stamps before an end in seconds, each with its true time in seconds.
    pub fn ticks(self, seconds: f64) -> impl Iterator<Item = (u64, f64)> {
        let end_us = (seconds * 1e6) as u64;
        let stamps = (0..).map(move |i| self.first_us + i * self.period_us);
        stamps.take_while(move |stamp_us| *stamp_us < end_us).map(move |stamp_us| {
            let true_us = stamp_us as f64 / (1.0 + self.fast_ppm * 1e-6);
            (stamp_us, true_us * 1e-6)
        })
    }
}

/// Maximum step of the filter's integration, in seconds.
const STEP_S: f64 = 2.5e-4;

/// Reference force sensor of one finger, both axes.
#[derive(Clone, Debug)]
pub struct ReferenceSensor {
    filter_s: f64,
    drift_n_per_s: f64,
    at_s: f64,
    input_n: [f64; 2],
    output_n: [f64; 2],
}

impl ReferenceSensor {
    /// Unloaded at the start of a recording.
    pub fn new(effects: &Effects) -> Self {
        Self {
            filter_s: 1e-3 * effects.size(REFERENCE_FILTER.id),
            drift_n_per_s: effects.size(REFERENCE_DRIFT.id) / 60.0,
            at_s: 0.0,
            input_n: [0.0; 2],
            output_n: [0.0; 2],
        }
    }

    /// Reading at a time of the recording, without noise; `load` is the true load at any time.
    pub fn read(&mut self, time_s: f64, start_s: f64, load: impl Fn(f64) -> [f64; 2]) -> [f64; 2] {
        if self.filter_s > 0.0 {
            self.filter_to(time_s, load);
        } else {
            self.output_n = load(time_s);
        }
        let [x, z] = self.output_n;
        [x + self.drift_n_per_s * (start_s + time_s), z]
    }

    /// `filter_s y' = F - y`, by the trapezoidal rule.
    fn filter_to(&mut self, time_s: f64, load: impl Fn(f64) -> [f64; 2]) {
        let steps = ((time_s - self.at_s) / STEP_S).ceil().max(1.0);
        let half = 0.5 * (time_s - self.at_s) / (steps * self.filter_s);
        let from_s = self.at_s;
        for step in 1..=steps as u32 {
            let share = f64::from(step) / steps;
            let input = load(from_s + share * (time_s - from_s));
            for ((output, &now), before) in self.output_n.iter_mut().zip(&input).zip(self.input_n) {
                *output += half * (before + now - 2.0 * *output) / (1.0 + half);
            }
            self.input_n = input;
        }
        self.at_s = time_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_error_is_a_few_ppm() {
        let [board, reference] = SampleClock::draw(4, 1, [1000.0, 100.0]);
        assert_ne!(board.first_us, reference.first_us);
        assert_eq!(board.ticks(30.0).count(), 30_000);
        for (stamp_us, true_s) in reference.ticks(30.0) {
            assert!((stamp_us as f64 * 1e-6 - true_s).abs() < 30.0 * 5e-6);
        }
    }

    fn reference(effect: &str) -> ReferenceSensor {
        ReferenceSensor::new(&Effects::new(&[effect.parse().unwrap()], 1, 1, 0.0).unwrap())
    }

    #[test]
    fn filtered_ramp_lags_by_the_time_constant() {
        let mut reference = reference("reference_filter=4");
        let mut reading = 0.0;
        for step in 1..=100 {
            let time_s = 0.01 * f64::from(step);
            reading = reference.read(time_s, 0.0, |t| [100.0 * t, 0.0])[0];
        }
        assert!((100.0 - reading - 0.4).abs() < 1e-6, "{reading}");
    }

    #[test]
    fn lateral_zero_drifts_with_session_time() {
        let reading = reference("reference_drift=0.4").read(30.0, 600.0, |_| [0.0; 2]);
        assert!((reading[0] - 4.2).abs() < 1e-12 && reading[1] == 0.0);
    }
}
