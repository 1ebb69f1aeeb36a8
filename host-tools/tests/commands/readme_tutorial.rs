//! The section of `CALIBRATION.md` on another sensor: other magnet, other stiffness, three sensors.

use crate::workdir::WorkDir;

/// Section of the page with this title.
fn section(name: &str) -> &'static str {
    let page = include_str!("../../CALIBRATION.md");
    let (_, from) = page.split_once(&format!("\n## {name}\n")).unwrap();
    from.split_once("\n## ").map_or(from, |(section, _)| section)
}

/// Text of the first code block of this kind.
fn block<'a>(section: &'a str, kind: &str) -> &'a str {
    let (_, from) = section.split_once(&format!("```{kind}\n")).unwrap();
    from.split_once("```").unwrap().0
}

#[test]
fn commands_of_the_page_make_tables_for_another_sensor() {
    let (dir, section) = (WorkDir::empty(), section("Another sensor"));
    std::fs::write(dir.path("tube.toml"), block(section, "toml")).unwrap();
    let lines = block(section, "console").lines();
    let commands: Vec<&str> = lines
        .filter_map(|line| line.strip_prefix("cargo magpie "))
        .map(|line| line.split('#').next().unwrap_or(line))
        .collect();
    assert_eq!(commands.len(), 4, "{commands:?}");
    for command in &commands {
        dir.stdout(command);
    }
    let tables = dir.read("tube-tables.rs");
    assert!(tables.contains("static SENSORS: [SensorTable; 3]"));

    let replayed = dir.json("replay tube-model.toml tube --json");
    let axes = replayed["sensors"].as_array().unwrap();
    assert_eq!(axes.len(), 6, "{replayed}");
    for axis in axes {
        let [error_n, noise_n] = ["rmse_n", "noise_n"].map(|key| axis[key].as_f64().unwrap());
        assert!((0.8..1.3).contains(&(error_n / noise_n)), "{axis}");
    }
}
