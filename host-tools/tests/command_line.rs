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
    for command in ["fit", "import"] {
        let help = text(&magpie(&[command, "--help"]).stdout);
        assert!(
            help.contains("Examples:") && help.contains(&format!("  magpie {command} ")),
            "{help}"
        );
    }
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
