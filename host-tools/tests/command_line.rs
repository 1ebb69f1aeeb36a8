//! The command as a user meets it.

use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use tests::{data, real_data};

fn magpie(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(arguments)
        .output()
        .expect("the command runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn json_of(arguments: &[&str]) -> Value {
    let output = magpie(arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object on stdout and nothing else")
}

#[test]
fn fit_prints_one_json_object_with_axes_and_parameters() {
    let clean = data("clean");
    let json = json_of(&["fit", clean.to_str().unwrap(), "--json"]);
    let axes = json["axes"].as_array().unwrap();
    assert_eq!(axes.len(), 12);
    assert_eq!(
        (&axes[4]["sensor"], &axes[4]["axis"]),
        (&1.into(), &"y".into())
    );
    assert!(
        axes.iter()
            .all(|axis| axis["held_out_rms_g"].as_f64() > Some(0.0)
                && axis["floor_g"].as_f64() > Some(0.0))
    );
    let parameters = json["parameters"].as_array().unwrap();
    assert_eq!(parameters.len(), 4 * 14);
    let stiffness = parameters
        .iter()
        .find(|p| p["name"] == "stiffness_x" && p["sensor"] == 0)
        .unwrap();
    assert_eq!(stiffness["unit"], "N/mm");
    assert_eq!(stiffness["identifiable"], true);
    assert!(
        (stiffness["value"].as_f64().unwrap() - 501.1).abs() < 1.5,
        "{stiffness}"
    );
    assert!(stiffness["std_error"].as_f64().unwrap() < 1.0);
}

#[test]
fn the_same_seed_writes_the_same_model_byte_for_byte() {
    let folder = TempDir::new().unwrap();
    let models = ["a.toml", "b.toml"].map(|name| folder.path().join(name));
    for model in &models {
        let output = magpie(&[
            "fit",
            data("clean").to_str().unwrap(),
            "-o",
            model.to_str().unwrap(),
        ]);
        assert!(output.status.success());
        assert!(
            text(&output.stdout).contains("At the noise floor"),
            "{}",
            text(&output.stdout)
        );
    }
    let [a, b] = models.map(|model| std::fs::read(model).unwrap());
    assert_eq!(text(&a), text(&b));
}

#[test]
fn the_page_keeps_to_a_hundred_columns() {
    let output = magpie(&["fit", data("clean").to_str().unwrap()]);
    for line in text(&output.stdout).lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
}

#[test]
fn an_error_is_one_sentence_on_stderr_and_exit_code_1() {
    let output = magpie(&["fit", "no-such-campaign", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(output.stdout, b"");
    let said = text(&output.stderr);
    assert!(
        said.starts_with("magpie: no-such-campaign: cannot be read: "),
        "{said}"
    );
    assert_eq!(said.lines().count(), 1);
}

#[test]
fn every_command_s_help_has_an_example() {
    for command in ["fit", "import", "export", "replay", "simulate", "demo"] {
        let help = text(&magpie(&[command, "--help"]).stdout);
        assert!(
            help.contains("Examples:") && help.contains(&format!("  cargo magpie {command} ")),
            "{help}"
        );
    }
}

#[test]
fn replay_gives_forces_below_a_newton_on_a_recording_that_was_not_fitted() {
    let folder = TempDir::new().unwrap();
    let two = folder.path().join("two");
    for name in ["1", "2"] {
        std::fs::create_dir_all(two.join(name)).unwrap();
        for file in ["recording.toml", "hall.csv.gz", "force.csv.gz"] {
            std::fs::copy(
                data("clean").join(name).join(file),
                two.join(name).join(file),
            )
            .unwrap();
        }
    }
    let model = folder.path().join("model.toml");
    let model = model.to_str().unwrap();
    assert!(
        magpie(&["fit", two.to_str().unwrap(), "-o", model])
            .status
            .success()
    );
    let json = json_of(&["replay", model, data("clean/3").to_str().unwrap(), "--json"]);
    assert_eq!(
        (&json["rows"], &json["recordings"][0]["held_out"]),
        (&12_001.into(), &true.into())
    );
    for sensor in json["sensors"].as_array().unwrap() {
        let of = |key: &str| sensor[key].as_f64().unwrap();
        // Noise alone is 0.35 G through 1.17 and 0.73 G/N, and 0.15 N: far less would be a fault.
        let (least, most) = if sensor["axis"] == "x" {
            (0.25, 0.6)
        } else {
            (0.40, 0.9)
        };
        assert!((least..=most).contains(&of("tared_rmse_n")), "{sensor}");
        assert!(
            of("fixed_minus_float_rms_n") <= 0.1 && of("mean_n").abs() < 0.2,
            "{sensor}"
        );
        // What is left beyond white noise is the model's: little on clean data.
        let beyond = of("tared_rmse_n") / of("noise_n");
        assert!((0.97..1.08).contains(&beyond), "{sensor}");
        let parts = of("mean_n").hypot(of("std_n"));
        assert!((parts - of("rmse_n")).abs() < 1e-9, "{sensor}");
    }
    // The paper's ideal model, of the nominal design alone, is off by newtons.
    let nominal = json["nominal"].as_array().unwrap();
    assert!(
        nominal
            .iter()
            .all(|sensor| sensor["rmse_n"].as_f64() > Some(2.0))
    );
}

#[test]
fn the_committed_tables_are_those_of_the_demo() {
    let folder = TempDir::new().unwrap();
    let output = magpie(&["demo", "-o", folder.path().to_str().unwrap()]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let written = std::fs::read_to_string(folder.path().join("tables.rs")).unwrap();
    let committed = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../firmware/src/model/tables.rs"
    );
    assert!(
        written == std::fs::read_to_string(committed).unwrap(),
        "firmware/src/model/tables.rs is not the demo's: run `cargo magpie demo` and copy magpie-demo/tables.rs there"
    );
    let story = text(&output.stdout);
    for part in [
        "1. The recordings.",
        "2. The fit.",
        "3. The inverse.",
        "4. The judgement.",
        "5. Where it fails.",
        "6. Which physics is missing.",
        "AT NOISE FLOOR",
        "7. The error falls.",
    ] {
        assert!(story.contains(part), "{story}");
    }
    for line in story.lines() {
        assert!(
            line.chars().count() <= 100 || line.contains("MAGPIE_TABLES"),
            "{line}"
        );
    }
}

#[test]
fn a_model_with_a_broken_number_is_refused_by_its_name() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    let model = path.to_str().unwrap();
    assert!(
        magpie(&["fit", data("clean").to_str().unwrap(), "-o", model])
            .status
            .success()
    );
    let good = std::fs::read_to_string(&path).unwrap();
    let gap = good
        .split("[sensor.parameters.gap]\nvalue = ")
        .nth(1)
        .unwrap();
    let gap = gap.lines().next().unwrap();
    let said = |from: &str, to: &str| {
        std::fs::write(&path, good.replacen(from, to, 1)).unwrap();
        let output = magpie(&[
            "export",
            model,
            "-o",
            folder.path().join("tables.rs").to_str().unwrap(),
        ]);
        assert_eq!(output.status.code(), Some(1));
        text(&output.stderr)
    };
    let negative = said(gap, "-1.5");
    assert!(
        negative.contains("column gap of sensor 0: -1.5 is not possible here"),
        "{negative}"
    );
    let huge = said(gap, "1e9");
    assert!(huge.contains("does not determine the forces"), "{huge}");
    let scale = said("gauss_per_lsb = 0.125", "gauss_per_lsb = 0.0");
    assert!(
        scale.contains("column sensor_scale.gauss_per_lsb: 0 is not possible here"),
        "{scale}"
    );
    let twice = said("number = 1", "number = 0");
    assert!(twice.contains("it stands twice"), "{twice}");
}

#[test]
fn swapped_arguments_are_told_the_order() {
    let output = magpie(&["replay", data("clean/3").to_str().unwrap(), "model.toml"]);
    assert!(
        text(&output.stderr).contains("the order is MODEL CAMPAIGN"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn a_polynomial_has_no_tables_and_says_so() {
    let folder = TempDir::new().unwrap();
    let model = folder.path().join("model.toml");
    let model = model.to_str().unwrap();
    let fit = magpie(&[
        "fit",
        data("clean").to_str().unwrap(),
        "--base",
        "polynomial",
        "--degree",
        "3",
        "-o",
        model,
    ]);
    assert!(fit.status.success());
    let tables = folder.path().join("tables.rs");
    let output = magpie(&["export", model, "-o", tables.to_str().unwrap()]);
    assert!(
        text(&output.stderr).contains("a polynomial of the forces has no unique inverse"),
        "{}",
        text(&output.stderr)
    );
    assert!(!tables.exists());
}

#[test]
fn real_measurements_of_a_printed_lattice_are_imported_and_fitted() {
    let Some(source) = real_data("eflesh_normal") else {
        return;
    };
    let folder = TempDir::new().unwrap();
    let campaign = folder.path().join("eflesh");
    let campaign = campaign.to_str().unwrap();
    let mapping = data("eflesh_normal.mapping.toml");
    let runs =
        ["run1.csv", "run2.csv", "run3.csv"].map(|run| source.join(run).display().to_string());
    let [a, b, c] = &runs;
    let imported = json_of(&[
        "import",
        mapping.to_str().unwrap(),
        a,
        b,
        c,
        "-o",
        campaign,
        "--json",
    ]);
    for recording in imported["recordings"].as_array().unwrap() {
        assert_eq!(
            (&recording["hall_rows"], &recording["measured_rows"]),
            (&3600.into(), &1860.into())
        );
    }
    let fit = json_of(&[
        "fit",
        campaign,
        "--base",
        "polynomial",
        "--degree",
        "5",
        "--json",
    ]);
    assert_eq!(fit["axes"].as_array().unwrap().len(), 15);
    // 71 uT +- 3: what a polynomial of the force leaves, over all fifteen channels.
    let microtesla = 100.0 * fit["held_out_rms_g"].as_f64().unwrap();
    assert!((68.0..=74.0).contains(&microtesla), "{microtesla} uT");
    let again = magpie(&["import", mapping.to_str().unwrap(), a, "-o", campaign]);
    assert!(
        text(&again.stderr).contains("an import never overwrites"),
        "{}",
        text(&again.stderr)
    );
}
