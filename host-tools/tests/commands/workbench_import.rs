//! `magpie workbench` with tables of other programs: the form, what it imports, and what it refuses.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use tests::campaign_copy::CsvTable;
use tests::data;

use crate::workdir::served::Served;
use crate::workdir::{WorkDir, campaign};

const SOURCES: &str = "run1.csv run2.csv run3.csv";

/// The recordings of `friction` as a logger writes them: other names, units and separators, both sides in one table.
fn foreign() -> WorkDir {
    /// Name, column of the recording and factor.
    const COLUMNS: [(&str, &str, f64); 14] = [
        ("time (ms)", "t_us", 1e-3),
        ("Mag0X [mT]", "s0_x_lsb", 0.0125),
        ("Mag0Y [mT]", "s0_y_lsb", 0.0125),
        ("Mag0Z [mT]", "s0_z_lsb", 0.0125),
        ("Mag1X [mT]", "s1_x_lsb", 0.0125),
        ("Mag1Y [mT]", "s1_y_lsb", 0.0125),
        ("Mag1Z [mT]", "s1_z_lsb", 0.0125),
        ("Temp0", "s0_temp_c", 1.0),
        ("Temp1", "s1_temp_c", 1.0),
        ("finger width (um)", "opening_mm", 1e3),
        ("Load0_x (g)", "f0_x_n", 1.0 / 9.806_65e-3),
        ("Load0_z (g)", "f0_z_n", 1.0 / 9.806_65e-3),
        ("Load1_x (g)", "f1_x_n", 1.0 / 9.806_65e-3),
        ("Load1_z (g)", "f1_z_n", 1.0 / 9.806_65e-3),
    ];
    let dir = WorkDir::empty();
    for number in 1..=3 {
        let read = |name: &str| CsvTable::read(&data(&format!("friction/{number}/{name}")));
        let (hall, force) = (read("hall.csv.gz"), read("force.csv.gz"));
        let forces: BTreeMap<&String, &Vec<String>> =
            force.rows.iter().map(|row| (&row[0], row)).collect();
        let mut lines = vec![COLUMNS.map(|(name, ..)| name).join(";")];
        lines.extend(hall.rows.iter().map(|row| {
            let cell = |(_, of, factor): (&str, &str, f64)| {
                let text = match of.starts_with('f') {
                    true => forces.get(&row[0]).map(|row| &row[force.index(of)]),
                    false => Some(&row[hall.index(of)]),
                };
                let value = text.map(|text| factor * text.parse::<f64>().unwrap());
                value.map_or_else(String::new, |value| format!("{value:.4}"))
            };
            COLUMNS.map(cell).join(";")
        }));
        std::fs::write(dir.path(&format!("run{number}.csv")), lines.join("\n") + "\n").unwrap();
    }
    dir
}

const DESIGN: &str = "\n[design]\ngap_mm = 1.5\nstiffness_x_n_per_mm = 500.0\nstiffness_z_n_per_mm = 800.0\nforce_range_n = 250\n\
    magnet = { shape = \"cylinder\", diameter_mm = 3, length_mm = 2, remanence_t = 1.2, axis = \"y\" }\n";

fn page(served: &Served) -> String {
    let (status, page) = served.request(
        &format!("GET /?token={}", served.token),
        &format!("host: {}\r\n", served.host),
        "",
    );
    assert_eq!(status, 200, "{page}");
    page
}

/// Status and answer of an import with this mapping.
fn import(served: &Served, text: &str, campaign: &str) -> (u16, Value) {
    let mapping = format!("{campaign}.toml");
    served.ask("import", &json!({ "text": text, "mapping": mapping, "campaign": campaign }))
}

/// The mapping that the form shows, as the command proposes it.
fn proposed(dir: &WorkDir) -> String {
    dir.stdout(&format!("import --guess {SOURCES} -o guessed.toml"));
    dir.read("guessed.toml")
}

#[test]
fn tables_become_the_campaign_of_the_workbench() {
    let dir = foreign();
    let mapping = proposed(&dir) + DESIGN;
    let served = Served::start(&dir, SOURCES);
    let form = page(&served);
    for expected in [
        "Mag0X [mT]",
        "aria-label=\"Values of Load1_z (g)\"",
        "value=\"s1_y_gauss\" data-of=\"gauss\" selected",
        "value=\"um\" data-of=\"mm\" selected",
        "taken as the opening between the fingertips",
        "the clocks begin anew with each file",
        "value=\"run1-campaign.mapping.toml\"",
    ] {
        assert!(form.contains(expected), "{expected}");
    }
    let base = json!({ "effects": [], "formulas": [] });
    let (status, answer) = served.ask("model", &base);
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("import the tables"), "{answer}");

    // Exchanged forces: it is imported, but cannot be fitted.
    let wrong =
        mapping.replace("f0_x_n", "f").replace("f0_z_n", "f0_x_n").replace("\"f\"", "\"f0_z_n\"");
    let (status, answer) = import(&served, &wrong, "run1-campaign");
    assert_eq!((status, &answer["is_refused"]), (200, &json!(true)), "{answer}");
    assert!(answer["notes"].to_string().contains("swapped"), "{answer}");
    assert_eq!(answer["next"][0], "run1-campaign-2");
    assert!(page(&served).contains("id=\"form\""));

    let (status, answer) = import(&served, &mapping, "run1-campaign-2");
    assert_eq!((status, &answer["is_refused"]), (200, &json!(false)), "{answer}");
    assert!(answer["text"].as_str().unwrap().contains("4467 with a force"), "{answer}");
    assert!(page(&served).contains("Could be missing"));
    let (status, state) = served.ask("model", &base);
    assert_eq!(status, 200, "{state}");
    let commands = state["commands"].as_array().unwrap();
    assert_eq!(
        commands[0],
        format!("cargo magpie import run1-campaign-2.toml {SOURCES} -o run1-campaign-2")
    );
    assert_eq!(commands[1], "cargo magpie fit run1-campaign-2 -o base.toml");
    let (_, found) =
        served.ask("diagnose", &json!({ "effects": [], "formulas": [], "plans": false }));
    assert!(found["evidence"]["hysteresis"].is_string(), "{found}");
    let model =
        json!({ "effects": ["hysteresis"], "formulas": [], "kind": "model", "path": "model.toml" });
    assert_eq!(served.ask("write", &model).0, 200);
    dir.stdout("replay model.toml run1-campaign-2");
    let (status, answer) = import(&served, &mapping, "third");
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("load this page again"), "{answer}");
}

#[test]
fn bad_mappings_and_outputs_are_refused_and_leave_nothing() {
    let dir = foreign();
    let mapping = proposed(&dir);
    let served = Served::start(&dir, SOURCES);
    std::fs::create_dir(dir.path("taken")).unwrap();
    std::fs::write(dir.path("taken/notes"), "mine").unwrap();
    let without_unit = mapping.replacen("unit = \"mT\"", "unit = \"\"", 1);
    let no_gap = mapping.clone() + &DESIGN.replace("gap_mm = 1.5\n", "");
    let starts = format!("starts_s = [0, 60]\n{mapping}");
    let zero = mapping.clone() + &DESIGN.replace("500.0", "0");
    for (text, campaign, expected) in [
        (&mapping, "taken", "it is not overwritten: choose another path"),
        (&mapping, "", "name the new folder"),
        (
            &without_unit,
            "new",
            "new.toml, column s0_x_gauss: the unit \"\" is not allowed here; accepted units: T, mT,",
        ),
        (&no_gap, "new", "missing field `gap_mm`"),
        (&starts, "new", "column starts_s: 2 starts for 3 sources"),
        (
            &zero,
            "new",
            "column design.stiffness_x_n_per_mm: 0.0 is not allowed here; give a positive number",
        ),
        (
            &mapping.replace("Load1_z (g)", "Load1_y (g)"),
            "new",
            "column Load1_y (g): the column is missing from the header; did you mean Load1_",
        ),
    ] {
        let (status, answer) = import(&served, text, campaign);
        assert_eq!(status, 422, "{expected}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains(expected), "{expected}: {answer}");
        assert!(!dir.path(&format!("{campaign}.toml")).exists(), "{campaign}");
        assert!(!dir.path("new").exists());
    }
    assert_eq!(dir.read("taken/notes"), "mine");
    // It goes on after errors.
    assert_eq!(import(&served, &mapping, "new").0, 200);
}

#[test]
fn tables_that_cannot_be_read_or_recognised_are_shown() {
    let dir = foreign();
    let table = dir.read("run2.csv");
    let (head, rest) = table.split_once('\n').unwrap();
    let channels: Vec<_> = (0..14).map(|number| format!("ch{number}")).collect();
    std::fs::write(dir.path("unnamed.csv"), format!("{}\n{rest}", channels.join(";"))).unwrap();
    let form = page(&Served::start(&dir, "unnamed.csv"));
    assert!(form.contains("No mapping is proposed") && form.contains("data-from=\"ch13\""));
    let bad = rest.replacen(';', ";x", 1);
    std::fs::write(dir.path("run2.csv"), format!("{head}\n{bad}")).unwrap();
    let form = page(&Served::start(&dir, SOURCES));
    assert!(form.contains("run2.csv, line 2, column Mag0X [mT]"));
    std::fs::write(dir.path("model.toml"), "").unwrap();
    for (paths, expected) in [
        ("nowhere.csv".to_owned(), "nowhere.csv"),
        ("model.toml".to_owned(), "not a campaign folder"),
        (format!("run1.csv {}", campaign("friction")), "give one campaign, or tables only"),
    ] {
        let message = dir.failure(&format!("workbench {paths}"));
        assert!(message.contains(expected), "{message}");
    }
}
