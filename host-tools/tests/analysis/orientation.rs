//! A gripper with turned sensors from import to tables, without a touched column.

use std::fs::{self, File};
use std::io;

use flate2::read::GzDecoder;
use serde_json::Value;
use tests::campaign_copy::change_tables;

use crate::workdir::WorkDir;

/// Tables of a simulated campaign, as another logger would have written them, and the mapping to import them.
fn logged(dir: &WorkDir, campaign: &str) -> Vec<String> {
    let mut sources = Vec::new();
    for recording in ["1", "2", "3"] {
        let source = format!("logged-{recording}");
        fs::create_dir(dir.path(&source)).unwrap();
        for table in ["hall.csv", "force.csv"] {
            let packed = dir.path(campaign).join(recording).join(format!("{table}.gz"));
            let mut from = GzDecoder::new(File::open(packed).unwrap());
            let mut to = File::create(dir.path(&source).join(table)).unwrap();
            io::copy(&mut from, &mut to).unwrap();
        }
        sources.push(source);
    }
    dir.stdout(&format!("import --guess {} -o guessed.toml", sources.join(" ")));
    let description = fs::read_to_string(dir.path(campaign).join("1/recording.toml")).unwrap();
    let (_, design) = description.split_once("[design]").unwrap();
    let mapping = dir
        .read("guessed.toml")
        .replace("# gauss_per_lsb", "gauss_per_lsb")
        .replace("# range_gauss", "range_gauss");
    fs::write(dir.path("mapping.toml"), format!("{mapping}\n[design]{design}")).unwrap();
    sources
}

#[test]
fn turned_sensors_need_no_changed_column() {
    let dir = WorkDir::empty();
    dir.stdout(
        "simulate -o simulated --seconds 8 --effect neighbour_magnet --orientation 0=+z+y-x \
         --orientation 2=-x+y-z --orientation 3=+z+x+y:reversed",
    );
    assert!(!dir.read("simulated/1/recording.toml").contains("orientation"));
    let truth = dir.read("simulated-truth.toml");
    assert!(truth.contains("orientation = \"+z+y-x\"") && truth.contains("\nremanence_t = -1."));
    let sources = logged(&dir, "simulated").join(" ");
    let imported = dir.run(&format!("import mapping.toml {sources} -o campaign"));
    let notes = String::from_utf8_lossy(&imported.stderr).into_owned();
    assert!(imported.status.success() && !notes.contains("a fit will refuse"), "{notes}");

    let fit = dir.json("fit campaign -o model.toml --json");
    let notices: Vec<&str> =
        fit["notices"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    for words in [
        "sensor 0 is mounted turned: its x, y and z are the gripper's z, y, -x;",
        "sensor 2 is mounted turned: its x, y and z are the gripper's -x, y, -z;",
        "sensor 3 is mounted turned: its x, y and z are the gripper's z, x, y, and the poles of its magnet exchanged;",
    ] {
        assert!(notices.iter().any(|notice| notice.contains(words)), "{notices:?}");
    }
    assert_eq!(notices.iter().filter(|notice| notice.contains("is mounted")).count(), 3);
    let diagnosis = dir.json("diagnose model.toml campaign --json");
    let verdicts = diagnosis["verdicts"].as_array().unwrap();
    let found: Vec<&str> = verdicts
        .iter()
        .filter(|verdict| verdict["verdict"] == "found")
        .filter_map(|verdict| verdict["effect"].as_str())
        .collect();
    assert_eq!(found, ["neighbour_magnet"], "{diagnosis}");
    dir.stdout("add model.toml campaign neighbour_magnet -o better.toml");

    let comparison = dir.json("compare better.toml campaign --json");
    assert_eq!(comparison["findings"].as_array().map(Vec::len), Some(0), "{comparison}");
    let replayed = dir.json("replay better.toml campaign --json");
    let axes = replayed["sensors"].as_array().unwrap();
    assert_eq!(axes.len(), 8, "{replayed}");
    for axis in axes {
        let [error_n, noise_n] = ["rmse_n", "noise_n"].map(|key| axis[key].as_f64().unwrap());
        assert!((0.8..1.3).contains(&(error_n / noise_n)), "{axis}");
    }
    dir.stdout("dev export better.toml -o tables.rs");
    let tables = dir.read("tables.rs");
    let maps: Vec<&str> =
        tables.lines().filter_map(|line| line.trim().strip_prefix("axes: ")).collect();
    assert_eq!(maps, ["AxisMap(0o016),", "AxisMap(0o210),", "AxisMap(0o614),", "AxisMap(0o021),"]);
}

/// A column that is exchanged after the fit is named as in the recording, whatever the orientation of the sensor.
#[test]
fn column_errors_of_a_turned_sensor_are_named_as_recorded() {
    let dir = WorkDir::empty();
    let turned = "--orientation 0=+z+y-x";
    dir.stdout(&format!("simulate -o sound --seconds 6 --sensors 1 {turned}"));
    dir.stdout("fit sound -o model.toml");
    dir.stdout(&format!("simulate -o broken --seconds 6 --sensors 1 {turned}"));
    change_tables(&dir.path("broken"), &[1, 2, 3], "hall.csv", |hall| {
        hall.exchange("s0_x_lsb", "s0_y_lsb");
    });
    let comparison = dir.json("compare model.toml broken --json");
    let first = &comparison["findings"][0];
    assert_eq!(first["id"], "axis_permuted", "{comparison}");
    let message = first["message"].as_str().unwrap_or_default();
    assert!(message.contains("s0_x_lsb is recorded as s0_y_lsb"), "{first}");
}

/// With a reference of one axis, a sensor that is mounted as in the design shows which one that is.
#[test]
fn reference_of_one_axis_determines_a_turned_sensor_next_to_a_nominal_one() {
    let dir = WorkDir::empty();
    for (campaign, sensors, is_fitted) in [("pair", 2, true), ("alone", 1, false)] {
        dir.stdout(&format!(
            "simulate -o {campaign} --seconds 6 --sensors {sensors} --orientation 0=+z+y-x"
        ));
        change_tables(&dir.path(campaign), &[1, 2, 3], "force.csv", |force| {
            (0..sensors).for_each(|sensor| force.remove(&format!("f{sensor}_z_n")));
        });
        let fit = dir.run(&format!("fit {campaign} -o {campaign}.toml --json"));
        assert_eq!(fit.status.success(), is_fitted, "{}", String::from_utf8_lossy(&fit.stderr));
        let output = if is_fitted { fit.stdout } else { fit.stderr };
        let words = if is_fitted {
            "sensor 0 is mounted turned: its x, y and z are the gripper's z, y, -x; "
        } else {
            "sensor 0 is not mounted as in the design: record f0_z_n, too"
        };
        let output = String::from_utf8_lossy(&output);
        assert!(output.contains(words), "{output}");
    }
}
