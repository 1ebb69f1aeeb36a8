//! Fitted parameters: values and errors against the truth, one number in every result, and the recording that identifies what is
//! open.

use std::f64::consts::PI;

use serde_json::Value;
use tests::campaign_copy::{CampaignCopy, CsvTable};

use crate::workdir::{WorkDir, campaign, text};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap()
}

/// True parameters of each sensor by name, in the units of a fit.
fn truth(dir: &WorkDir, name: &str) -> Vec<Vec<(String, f64)>> {
    let file: toml::Table = dir.read(name).parse().unwrap();
    let axes = |key: &str| match key {
        "stiffness_n_per_mm" => ("stiffness", &["x", "z"][..], 1.0),
        "offset_mm" => ("offset", &["x", "z"][..], 1.0),
        "tilt_rad" => ("tilt", &["x", "z"][..], 180.0 / PI),
        "rotation_rad" => ("rotation", &["x", "y", "z"][..], 180.0 / PI),
        "bias_g" => ("bias", &["x", "y", "z"][..], 1.0),
        other => panic!("{other}"),
    };
    let of_sensor = |sensor: &toml::Value| {
        let mut all = Vec::new();
        for (key, value) in sensor.as_table().unwrap() {
            match value {
                toml::Value::Float(value) => {
                    all.push((key.split('_').next().unwrap().to_owned(), *value));
                }
                toml::Value::Array(values) => {
                    let (name, axes, scale) = axes(key);
                    let named = axes.iter().zip(values);
                    all.extend(named.map(|(axis, value)| {
                        (format!("{name}_{axis}"), scale * value.as_float().unwrap())
                    }));
                }
                _ => {}
            }
        }
        assert_eq!(all.len(), 14, "{all:?}");
        all
    };
    file["sensor"].as_array().unwrap().iter().map(of_sensor).collect()
}

fn find<'a>(parameters: &'a [Value], sensor: usize, name: &str) -> &'a Value {
    let is_it = |one: &&Value| one["sensor"] == sensor && one["name"] == name;
    parameters.iter().find(is_it).unwrap()
}

#[test]
fn standard_errors_cover_the_truth() {
    let (mut all, mut near) = (0, 0);
    for seed in ["11", "12", "13"] {
        let dir = WorkDir::empty();
        dir.stdout(&["simulate", "-o", "campaign", "--seed", seed]);
        let fit = dir.json("fit campaign -o model.toml --json");
        for (sensor, truth) in truth(&dir, "campaign-truth.toml").iter().enumerate() {
            for (name, truth) in truth {
                let one = find(list(&fit["parameters"]), sensor, name);
                let errors = (number(&one["value"]) - truth).abs() / number(&one["std_error"]);
                assert!(errors < 3.0, "seed {seed}, sensor {sensor} {name}: {errors} errors");
                all += 1;
                near += usize::from(errors < 1.0);
            }
        }
    }
    // Of 168 normal deviates 115 ± 6 are within 1; where the prior decides, more.
    assert_eq!(all, 168);
    assert!((95..=150).contains(&near), "{near} within one standard error");
}

#[test]
fn distance_from_the_design_contains_the_tolerance() {
    let dir = WorkDir::with_model("clean");
    let compared = dir.json(&["compare", "model.toml", &campaign("clean"), "--json"]);
    let gap = find(list(&compared["parameters"]), 0, "gap");
    assert_eq!((number(&gap["nominal"]), number(&gap["prior_width"])), (1.5, 0.1));
    assert_eq!(gap["prior"], "manufacturing_tolerance");
    let sigma = 0.1_f64.hypot(number(&gap["std_error"]));
    let deviation = (number(&gap["value"]) - 1.5) / sigma;
    assert!((number(&gap["deviation"]) - deviation).abs() < 1e-9);
}

#[test]
fn fit_comparison_and_page_show_one_number() {
    let dir = WorkDir::empty();
    let clean = campaign("clean");
    let fit = dir.json(&["fit", &clean, "-o", "model.toml", "--json"]);
    let compared = dir.json(&["compare", "model.toml", &clean, "-o", "page.html", "--json"]);
    for key in ["parameters", "correlations", "unidentified"] {
        assert!(!list(&fit[key]).is_empty(), "{key}");
        assert_eq!(fit[key], compared[key], "{key}");
    }
    let correlations = &fit["correlations"][0];
    assert_eq!((list(&correlations["names"]).len(), list(&correlations["rows"]).len()), (14, 13));
    let printed = text(&dir.stdout(&["fit", &clean]));
    let page = dir.read("page.html");
    let row = printed.lines().find(|line| line.trim_start().starts_with("gap mm")).unwrap();
    let values: Vec<&str> = row.split_whitespace().skip(4).collect();
    assert_eq!(values.len(), 4, "{row}");
    for value in values {
        assert!(page.contains(&format!("<td>{value}</td>")), "{value}");
    }
    for words in [
        "href=\"#parameters\"",
        "aria-label=\"Correlations of the 14 parameters of sensor 3.\"",
        "Furthest from the design",
        "Not identified, the prior decides",
        "To identify them: ",
    ] {
        assert!(page.contains(words), "{words}");
    }
    for words in
        ["Furthest from the design", "Not identified, the prior decides", "To identify them"]
    {
        assert!(printed.contains(words), "{words}");
    }
}

/// What is open, by sensor and the name with the largest weight, and the recording that would identify it.
fn open(fit: &Value) -> Vec<(u64, String, String)> {
    let largest = |shares: &Value| {
        let shares = shares.as_object().unwrap().iter();
        let largest = shares.max_by(|a, b| number(a.1).abs().total_cmp(&number(b.1).abs()));
        largest.unwrap().0.clone()
    };
    let of = |one: &Value| {
        let remedy = one["remedy"].as_str().unwrap().to_owned();
        (one["sensor"].as_u64().unwrap(), largest(&one["shares"]), remedy)
    };
    list(&fit["unidentified"]).iter().map(of).collect()
}

#[test]
fn named_load_identifies_what_weak_loads_leave_open() {
    let dir = WorkDir::empty();
    let fitted = |load: &str| {
        dir.stdout(&["simulate", "-o", load, "--seed", "7", "--sensors", "2", "--load", load]);
        dir.json(&["fit", load, "--json"])
    };
    let weak = open(&fitted("0.5"));
    assert_eq!(weak.len(), 2, "{weak:?}");
    for (_, name, remedy) in &weak {
        assert!(name == "bias_y" || name == "remanence", "{name}");
        assert_eq!(remedy, "one more recording with a lateral load to ±250 N");
    }
    // Up to 250 N.
    let strong = open(&fitted("1.25"));
    assert!(strong.is_empty(), "{strong:?}");
}

#[test]
fn unrecorded_force_is_to_be_recorded() {
    let remove = |table: &mut CsvTable| {
        (0..4).for_each(|sensor| table.remove(&format!("f{sensor}_x_n")));
    };
    let copy = CampaignCopy::of("clean").change(&[1, 2, 3], "force.csv", remove);
    let fit = WorkDir::empty().json(&["fit", &copy.path().display().to_string(), "--json"]);
    let stiffness = open(&fit).into_iter().filter(|(_, name, _)| name == "stiffness_x");
    let remedies: Vec<String> = stiffness.map(|(.., remedy)| remedy).collect();
    assert_eq!(remedies, ["a recording with a lateral load of both signs"; 4]);
}

#[test]
fn parameters_of_an_effect_are_next_to_those_of_the_base() {
    let dir = WorkDir::with_model("friction");
    let friction = campaign("friction");
    let added =
        dir.json(&["add", "model.toml", &friction, "hysteresis", "-o", "better.toml", "--json"]);
    let own = list(&added["parameters"]).iter().filter(|one| one["effect"] == "hysteresis");
    let own: Vec<&Value> = own.collect();
    assert!(!own.is_empty());
    for one in own {
        let sensors = list(&added["effects"][0]["sensors"]);
        let sensor = sensors.iter().find(|sensor| sensor["number"] == one["sensor"]).unwrap();
        let same = &sensor["parameters"][one["name"].as_str().unwrap()];
        for key in ["value", "std_error", "identifiable", "unit", "prior_width"] {
            assert_eq!(one[key], same[key], "{key}");
        }
    }
    dir.stdout(&["compare", "better.toml", &friction, "-o", "page.html"]);
    assert!(dir.read("page.html").contains("hysteresis."));
}
