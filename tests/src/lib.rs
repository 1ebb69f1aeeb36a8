//! Fixtures of the integration tests: paths of test data, synthetic campaigns, images of the firmware.

pub mod campaign_copy;
pub mod image;
pub mod not_run;
pub mod points;

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use model_export::physics::ForwardModel;
use model_export::recordings::description::NominalDesign;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Path of a file or folder in `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// Folder of third-party measurements; `None` if not available, which is told at the end of the tests.
pub fn real_data(name: &str) -> Option<PathBuf> {
    external("real", "MAGPIE_REAL_DATA", name)
}

/// Folder of a campaign on which a diagnosis once was wrong; `None` if not available.
pub fn case(name: &str) -> Option<PathBuf> {
    external("cases", "MAGPIE_CASES", name)
}

/// Folder of a full campaign of the independent simulator, of which [`data`] has excerpts; `None` if not available.
pub fn full_campaign(name: &str) -> Option<PathBuf> {
    external("recordings", "MAGPIE_RECORDINGS", name)
}

/// Folder of data outside the repository: in that of the environment variable, else next to the checkout.
fn external(kind: &str, variable: &str, name: &str) -> Option<PathBuf> {
    let root = std::env::var_os(variable).map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(kind),
        PathBuf::from,
    );
    let folder = root.join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    let test = std::thread::current().name().unwrap_or("test").to_owned();
    not_run::note(
        [test.as_str()],
        &format!("set {variable} to a folder with {kind} data (tests/data/README.md)"),
    );
    None
}

/// Forward model of the nominal design without tolerances.
pub fn nominal() -> ForwardModel {
    ForwardModel::nominal(&NominalDesign::magpie())
}

/// `recording.toml` of the nominal design.
pub const RECORDING_TOML: &str = r#"format = 1
description = "test"
start_s = 0.0
gauss_per_lsb = 0.125
range_gauss = 2000.0
[design]
magnet = { shape = "cylinder", diameter_mm = 3.0, length_mm = 2.0, remanence_t = 1.2, axis = "y" }
gap_mm = 1.5
stiffness_x_n_per_mm = 500.0
stiffness_z_n_per_mm = 800.0
"#;

/// Synthetic campaign with the forward model of the fit: for tests of the statistics, not of the physics.
#[derive(Clone, Copy, Debug)]
pub struct SyntheticCampaign {
    /// Sensor.
    pub model: ForwardModel,
    /// Duration of a recording in seconds.
    pub seconds: f64,
    /// Standard deviation of white noise: of the field in gauss, of the reference in newtons.
    pub noise: (f64, f64),
    /// Seed of noise and load.
    pub seed: u64,
}

impl SyntheticCampaign {
    /// Lateral and longitudinal load in newtons.
    fn load(&self, recording: u64, time_s: f64) -> [f64; 2] {
        let phase = (self.seed * 7 + recording) as f64;
        let tau = std::f64::consts::TAU;
        [
            120.0 * (tau * 0.47 * time_s + phase).sin() * (1.0 - 0.4 * (tau * 0.11 * time_s).cos()),
            190.0
                * (tau * 0.61 * time_s + 2.0 * phase).sin()
                * (1.0 - 0.4 * (tau * 0.07 * time_s).sin()),
        ]
    }

    /// `hall.csv` and `force.csv` of a recording.
    pub fn tables(&self, recording: u64) -> (String, String) {
        let mut rng = ChaCha8Rng::seed_from_u64(1000 * self.seed + recording);
        let field_noise = Normal::new(0.0, self.noise.0).expect("a standard deviation");
        let force_noise = Normal::new(0.0, self.noise.1).expect("a standard deviation");
        let mut hall = "t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned();
        let mut force = "t_us,f0_x_n,f0_z_n\n".to_owned();
        for ms in 0..(self.seconds * 1000.0) as u64 {
            let load = self.load(recording, ms as f64 * 1e-3);
            let field = self.model.field(load);
            let counts = field.map(|g| ((g + field_noise.sample(&mut rng)) / 0.125).round());
            hall += &format!("{},{},{},{}\n", ms * 1000, counts.x, counts.y, counts.z);
            if ms % 10 == 0 {
                let [x, z] = load.map(|n| n + force_noise.sample(&mut rng));
                force += &format!("{},{x:.3},{z:.3}\n", ms * 1000);
            }
        }
        (hall, force)
    }

    /// Writes a campaign of this number of recordings.
    pub fn write_campaign(&self, folder: &Path, recordings: u64) {
        for recording in 1..=recordings {
            let (hall, force) = self.tables(recording);
            write_recording(&folder.join(recording.to_string()), RECORDING_TOML, &hall, &force);
        }
    }
}

/// Writes a recording, uncompressed.
pub fn write_recording(folder: &Path, description: &str, hall: &str, force: &str) {
    fs::create_dir_all(folder).expect("a folder");
    for (name, text) in [("recording.toml", description), ("hall.csv", hall), ("force.csv", force)]
    {
        fs::write(folder.join(name), text).expect("a file");
    }
}

/// Compresses a file with gzip and removes the original.
pub fn compress(folder: &Path, name: &str) {
    let plain = folder.join(name);
    let compressed = File::create(folder.join(format!("{name}.gz"))).expect("a file");
    let mut out = GzEncoder::new(compressed, Compression::fast());
    out.write_all(&fs::read(&plain).expect("the plain file")).expect("written");
    out.finish().expect("finished");
    fs::remove_file(plain).expect("removed");
}
