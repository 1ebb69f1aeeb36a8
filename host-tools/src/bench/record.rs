//! One recording written: what the board and the reference would have stored.

use std::f64::consts::TAU;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result};
use csv::Writer;
use flate2::Compression;
use flate2::write::GzEncoder;
use model_export::recordings::columns::{Axis, COVARIATES};
use model_export::recordings::description::Description;
use rand_chacha::ChaCha8Rng;

use super::clocks::Clock;
use super::draw::{Purpose, normal, stream};
use super::effects::Effects;
use super::element::Noise;
use super::gripper::{Gripper, Moment};
use super::programme::Excitation;
use super::reference::Reference;
use super::stroke::{LEAD_MM, POLE_PAIRS};
use super::{Settings, start_s};

/// Noise of a temperature in K, one standard deviation (assumed of ordinary parts, as those below).
pub const TEMPERATURE_C: f64 = 0.05;
/// Noise of the board's other channels.
const OPENING_MM: f64 = 0.005;
const CURRENT_A: f64 = 0.02;
const ANGLE_RAD: f64 = 0.002;
const ACCELERATION_MPS2: f64 = 0.05;

/// Before its first row a recording stands unloaded for this long.
pub const SETTLING_S: f64 = 1.0;

/// A table being written, packed.
type Table = Writer<GzEncoder<BufWriter<File>>>;

/// A recording about to be written.
pub struct Recorder<'a> {
    /// How the bench is set.
    pub settings: &'a Settings,
    /// What the gripper has.
    pub effects: &'a Effects,
    /// Number of the recording.
    pub recording: u32,
    /// What is done to the gripper.
    pub excitation: &'a Excitation,
    /// Clocks of board and reference.
    pub clocks: [Clock; 2],
}

impl Recorder<'_> {
    /// Writes the recording's three files into a new folder; the gripper goes on in time.
    pub fn write(&self, folder: &Path, gripper: &mut Gripper) -> Result<()> {
        fs::create_dir_all(folder)
            .with_context(|| format!("{} cannot be made", folder.display()))?;
        self.description().write(folder)?;
        self.hall(folder, gripper)
            .and_then(|()| self.force(folder))
            .with_context(|| format!("{} cannot be written", folder.display()))
    }

    /// The same words whatever is hidden in the recording.
    fn description(&self) -> Description {
        let mut design = self.settings.design.clone();
        design
            .more
            .insert("motor_pole_pairs".into(), (POLE_PAIRS as i64).into());
        design
            .more
            .insert("screw_lead_mm_per_rev".into(), LEAD_MM.into());
        let start_s = start_s(self.settings.seconds, self.recording);
        let words = format!(
            "simulated bench, {} sensors, lateral and longitudinal load",
            self.settings.sensors
        );
        let mut description = Description::new(words, start_s);
        description.gauss_per_lsb = Some(self.settings.part.gauss_per_lsb);
        description.range_gauss = Some(self.settings.part.range_gauss);
        description.design = Some(design);
        description
    }

    fn hall(&self, folder: &Path, gripper: &mut Gripper) -> Result<()> {
        let seed = self.settings.seed;
        let mut table = create(folder, "hall.csv.gz")?;
        table.write_record(hall_columns(self.settings.sensors))?;
        let mut noises: Vec<Noise> = (0..self.settings.sensors)
            .map(|sensor| self.settings.noise_of(self.recording, sensor))
            .collect();
        let mut rng = stream(seed, Purpose::Covariates, self.recording);
        // Where the field is late against the reference, the board sees what has been.
        let late_s = 1e-3 * self.effects.size("clock_skew");
        let mut before_s = f64::NAN;
        for (stamp_us, true_s) in self.clocks[0].ticks(self.settings.seconds) {
            let time_s = true_s - late_s;
            let since_s = match before_s.is_nan() {
                true => SETTLING_S,
                false => time_s - before_s,
            };
            before_s = time_s;
            let moment = Moment {
                recording: self.recording,
                time_s,
                since_s,
            };
            let fields = gripper.go_on(self.settings, self.excitation, moment);
            let mut row = vec![stamp_us.to_string()];
            for (sensor, (field, noise)) in fields.iter().zip(&mut noises).enumerate() {
                let counts = self.settings.part.counts(field + noise.next(since_s));
                row.extend(counts.map(|count| count.to_string()));
                let warmth = self.excitation.temperature_c(sensor, time_s);
                row.push(format!("{:.2}", warmth + TEMPERATURE_C * normal(&mut rng)));
            }
            let around = covariates(self.excitation, time_s, &mut rng);
            let written = around.iter().zip(DECIMALS);
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
        let mut references = vec![Reference::new(self.effects); self.settings.sensors as usize];
        for (stamp_us, true_s) in self.clocks[1].ticks(self.settings.seconds) {
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

/// Decimals of the columns of [`COVARIATES`] in a file.
const DECIMALS: [usize; COVARIATES.len()] = [3, 3, 4, 3, 3, 3, 4, 4, 4];

/// The columns of [`COVARIATES`] with their noise, in their order.
pub fn covariates(
    excitation: &Excitation,
    time_s: f64,
    rng: &mut ChaCha8Rng,
) -> [f64; COVARIATES.len()] {
    let mut noisy = |value: f64, noise: f64| value + noise * normal(rng);
    let drive = excitation.drive(time_s);
    let standing = excitation.standing(time_s);
    let opening_mm = noisy(drive.opening_mm, OPENING_MM);
    let current_a = noisy(drive.current_a, CURRENT_A);
    let angle_rad = noisy(drive.angle_rad, ANGLE_RAD).rem_euclid(TAU);
    let felt: [f64; 3] = standing.specific_force.into();
    let [x, y, z] = felt.map(|felt| noisy(felt, ACCELERATION_MPS2));
    let [roll, pitch, yaw] = standing.angles_rad.map(|angle| noisy(angle, ANGLE_RAD));
    [opening_mm, current_a, angle_rad, x, y, z, roll, pitch, yaw]
}

fn hall_columns(sensors: u32) -> Vec<String> {
    let mut columns = vec!["t_us".to_owned()];
    columns.extend((0..sensors).flat_map(sensor_columns));
    columns.extend(COVARIATES.iter().map(|name| (*name).to_owned()));
    columns
}

/// Columns of a sensor in `hall.csv`: its raw counts and its temperature.
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

fn create(folder: &Path, name: &str) -> Result<Table> {
    let file = BufWriter::new(File::create_new(folder.join(name))?);
    Ok(Writer::from_writer(GzEncoder::new(
        file,
        Compression::fast(),
    )))
}

/// Errors of the last bytes would be lost in a drop.
fn close(table: Table) -> Result<()> {
    let packed = table.into_inner().map_err(|error| error.into_error())?;
    packed
        .finish()?
        .into_inner()
        .map_err(|error| error.into_error())?;
    Ok(())
}
