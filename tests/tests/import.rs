//! Import of third-party tables: units, signs, clocks, missing values, error messages.

use std::fs;
use std::path::PathBuf;

use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::import::import;
use model_export::recordings::{Campaign, DataError};
use tempfile::TempDir;

const MAPPING: &str = r#"
description = "another test bench"
[hall]
clock = { from = "time", unit = "ms" }
columns = [
  { from = "mx", unit = "mT", to = "s0_x_gauss" },
  { from = "my", unit = "mT", to = "s0_y_gauss", scale = -1 },
  { from = "mz", unit = "mT", to = "s0_z_gauss" },
  { from = "height", unit = "m", to = "stage_mm" },
]
[force]
clock = { from = "scale_time", unit = "s" }
columns = [{ from = "mass", unit = "kg", to = "f0_z_n", missing = -1 }]
"#;

/// Rows every 10 ms; the source's clocks start at 5 s.
fn source() -> String {
    let mut text = "time,scale_time,mx,my,mz,height,mass,note\n".to_owned();
    for i in 0..40 {
        let mass = if i % 2 == 0 { "-1".to_owned() } else { format!("0.{i:02}") };
        text += &format!(
            "{},{},1.5,-2.5,0.25,0.012,{mass},ok\n",
            5000 + 10 * i,
            5.0 + 0.01 * f64::from(i)
        );
    }
    text
}

struct ImportFixture {
    folder: TempDir,
}

impl ImportFixture {
    fn import(mapping: &str, source: &str) -> (Self, Result<PathBuf, DataError>) {
        let fixture = Self { folder: TempDir::new().unwrap() };
        let at = |name: &str| fixture.folder.path().join(name);
        fs::write(at("mapping.toml"), mapping).unwrap();
        fs::write(at("source.csv"), source).unwrap();
        let sources = [at("source.csv"), at("source.csv")];
        let result = import(&at("mapping.toml"), &sources, &at("campaign"), |_| ());
        let campaign = at("campaign");
        (fixture, result.map(|_| campaign))
    }
}

fn error_of(mapping: &str, source: &str) -> String {
    let (fixture, result) = ImportFixture::import(mapping, source);
    let remaining: Vec<_> = fs::read_dir(fixture.folder.path()).unwrap().collect();
    assert_eq!(remaining.len(), 2, "a failed import left files");
    let message = result.unwrap_err().to_string();
    message.replace(&fixture.folder.path().display().to_string(), "")
}

#[test]
fn units_signs_clocks_and_missing_values_are_converted() {
    let (_fixture, result) = ImportFixture::import(MAPPING, &source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let first = &campaign.recordings[0];
    // 1.5 mT are 15 G; -2.5 mT inverted are 25 G.
    assert_eq!(first.sensors[&0].field_g[3], [15.0, 25.0, 2.5]);
    assert_eq!(first.covariates["stage_mm"][3], 12.0);
    let force = &first.forces[&(0, Axis::Z)].newtons;
    assert!(force.iter().any(|n| n.is_nan()));
    let max = force.iter().copied().filter(|n| n.is_finite()).fold(0.0, f64::max);
    // The last row has no window: 0.37 kg is the maximum used.
    assert!((max - 0.37 * 9.80665).abs() < 1e-9, "{max}");
    // Both clocks start with the recording; without a common clock recordings are contiguous.
    assert_eq!(first.time_s[0], 0.01);
    assert_eq!(campaign.recordings[1].description.start_s, 0.39);
}

#[test]
fn a_common_clock_preserves_the_distance_of_recordings() {
    let (_fixture, result) =
        ImportFixture::import(&MAPPING.replace("[hall]", "one_clock = true\n[hall]"), &source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    assert_eq!(campaign.recordings[1].description.start_s, 0.0);
}

#[test]
fn an_error_in_mapping_or_source_is_reported_with_a_remedy() {
    let mapping = |from: &str, to: &str| (MAPPING.replace(from, to), source());
    let cases = [
        (
            mapping("\"kg\"", "\"Kg\""),
            "column f0_z_n: the unit \"Kg\" is not allowed here; did you mean \"kg\"?",
        ),
        (mapping("\"kg\"", "\"mm\""), "f0_z_n is not in a unit that \"mm\" converts to"),
        (mapping("s0_x_gauss", "s0_x_guass"), "s0_x_guass"),
        (
            mapping("\"mass\"", "\"maas\""),
            "source.csv, line 1, column maas: the column is missing from the header; did you mean mass?",
        ),
        (mapping("missing", "mising"), "mapping.toml, line 13: is invalid: unknown field `mising`"),
        (
            (MAPPING.to_owned(), source().replace("5100,5.1,1.5", "5100,5.1,oops")),
            "source.csv, line 12, column mx: \"oops\" is not a number",
        ),
        (
            (
                TURNING.to_owned(),
                turning_source()
                    .replace("\n100,1.5,-2.5,0.25,2,0,0,2", "\n100,1.5,-2.5,0.25,0,0,0,0"),
            ),
            "source.csv, line 12, column qw: the quaternion 0, 0, 0, 0",
        ),
    ];
    for ((mapping, source), expected) in cases {
        let error = error_of(&mapping, &source);
        assert!(error.contains(expected), "{error}");
    }
}

/// A bench with an attitude and without a reference force.
const TURNING: &str = r#"
description = "a magnetometer"
[hall]
clock = { from = "time", unit = "ms" }
columns = [
  { from = "mx", unit = "mT", to = "s0_x_gauss" },
  { from = "my", unit = "mT", to = "s0_y_gauss" },
  { from = "mz", unit = "mT", to = "s0_z_gauss" },
]
attitude = { w = "qw", x = "qx", y = "qy", z = "qz" }
[force]
clock = { from = "time", unit = "ms" }
columns = []
"#;

fn turning_source() -> String {
    let mut text = "time,mx,my,mz,qw,qx,qy,qz\n".to_owned();
    for i in 0..40 {
        text += &format!("{},1.5,-2.5,0.25,2,0,0,2\n", 10 * i);
    }
    text
}

#[test]
fn a_quaternion_is_converted_without_a_force() {
    let (_fixture, result) = ImportFixture::import(TURNING, &turning_source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let first = &campaign.recordings[0];
    assert!(first.forces.is_empty());
    assert!((first.covariates["yaw_rad"][3] - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
    assert!(first.covariates["roll_rad"][3].abs() < 1e-6);
}
