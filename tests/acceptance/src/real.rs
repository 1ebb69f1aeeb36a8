//! Measurements by others: what the commands answer about each set, compared with what is known about it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use analysis::diagnose::formulas::harmonics::TURN;
use analysis::progress;
use anyhow::{Context, Result, ensure};
use model_export::recordings::units::round_significant;
use serde_json::Value;
use tests::{data, real_data};

use crate::magpie;
use crate::results::{Section, markdown_table};

/// Sets that are answered as known, at least.
const MIN_RIGHT: usize = 9;

/// A set, and what is known about it.
struct Set {
    folder: &'static str,
    what: &'static str,
    check: fn(&Set, &Files) -> Result<Vec<Claim>>,
}

/// What is known, whether it was answered, and the answer in short.
struct Claim {
    known: &'static str,
    is_answered: bool,
    answer: String,
}

fn claim(known: &'static str, is_answered: bool, answer: impl Into<String>) -> Claim {
    Claim { known, is_answered, answer: answer.into() }
}

const SETS: [Set; 10] = [
    Set {
        folder: "eflesh_normal",
        what: "5 Hall sensors over magnets in a lattice",
        check: lattice,
    },
    Set { folder: "px4_earth_field", what: "magnetometer on a vehicle", check: earth_field },
    Set { folder: "nist_pontius", what: "load cell, 20 loads twice", check: pontius },
    Set { folder: "odrive_cogging", what: "cogging of a brushless motor", check: cogging },
    Set { folder: "imu_thermal", what: "gyroscope in a thermal chamber", check: thermal_chamber },
    Set { folder: "eflesh_spatial", what: "probe on a grid over 5 Hall sensors", check: grid },
    Set { folder: "soft_finger_static", what: "soft finger, rows shuffled", check: soft_finger },
    Set { folder: "magnetometer_wrap", what: "driver that wraps an axis", check: wrapped },
    Set {
        folder: "nist_handbook",
        what: "load cell, acoustic microscope, thermocouple",
        check: handbook,
    },
    Set { folder: "rosbag2", what: "bags of ROS 2, whole and broken", check: bags },
];

/// Runs all sets.
pub fn evaluate() -> Result<Section> {
    let bar = progress::progress_bar("measurements by others", SETS.len());
    let mut rows = Vec::new();
    let mut right = 0;
    for set in &SETS {
        let source = real_data(set.folder).with_context(|| {
            format!("{}: the measurements are not there; see tests/data/README.md", set.folder)
        })?;
        let folder = tempfile::tempdir()?;
        let files = Files { source, folder: folder.path().to_owned() };
        let claims = (set.check)(set, &files).with_context(|| set.folder)?;
        right += usize::from(claims.iter().all(|claim| claim.is_answered));
        for (place, claim) in claims.into_iter().enumerate() {
            let name =
                if place == 0 { format!("{}: {}", set.folder, set.what) } else { String::new() };
            let mark = if claim.is_answered { "" } else { "NO" };
            rows.push([name, claim.known.to_owned(), claim.answer, mark.to_owned()]);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Section {
        id: "real",
        title: "Measurements by others",
        extent: format!("{} sets", SETS.len()),
        conditions: format!(
            "Public measurements, each imported, fitted and diagnosed with the commands; held-out errors as each set's folds allow. What is known is from the \
             origin of each set, or from regressions outside this project. Specified: everything known is answered in at least \
             {MIN_RIGHT} of {} sets ({right}).",
            SETS.len()
        ),
        tables: markdown_table(["set", "known", "answered", ""], rows),
        is_met: Some(right >= MIN_RIGHT),
    })
}

/// Source of a set, and a folder for what is made of it.
struct Files {
    source: PathBuf,
    folder: PathBuf,
}

/// Mapping file of this project.
fn mapping(name: &str) -> PathBuf {
    data(&format!("{name}.mapping.toml"))
}

impl Files {
    fn sources(&self, names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(|name| self.source.join(name)).collect()
    }

    /// One table of each group of rows, in the order of the groups' first rows; `group` receives the cells of a row and its number.
    fn split(
        &self,
        file: &str,
        group: impl Fn(&BTreeMap<&str, &str>, usize) -> String,
    ) -> Result<Vec<PathBuf>> {
        let text = fs::read_to_string(self.source.join(file))?;
        let mut lines = text.lines();
        let header = lines.next().context("an empty table")?;
        let names: Vec<&str> = header.split(',').collect();
        let mut groups: Vec<(String, String)> = Vec::new();
        for (row, line) in lines.enumerate() {
            let cells = names.iter().copied().zip(line.split(',')).collect();
            let own = group(&cells, row);
            match groups.iter_mut().find(|(name, _)| *name == own) {
                Some((_, text)) => *text += &format!("{line}\n"),
                None => groups.push((own, format!("{header}\n{line}\n"))),
            }
        }
        let written = groups.into_iter().enumerate().map(|(place, (_, text))| {
            let path = self.folder.join(format!("{file}-{place:02}.csv"));
            fs::write(&path, text)?;
            Ok(path)
        });
        written.collect()
    }

    /// Imports, fits with the polynomial base and diagnoses; `name` of the campaign.
    fn diagnosed(
        &self,
        name: &str,
        mapping: &Path,
        sources: &[PathBuf],
        fit: &[&str],
    ) -> Result<Answer> {
        let campaign = self.folder.join(name);
        let model = self.folder.join(format!("{name}.toml"));
        let mut import = vec!["import".into(), mapping.to_owned()];
        import.extend_from_slice(sources);
        import.extend(["-o".into(), campaign.clone()]);
        magpie::run(&import, None)?;
        let mut words: Vec<PathBuf> = ["fit".into(), campaign.clone()].into();
        words.extend(["--base", "polynomial", "-o"].map(PathBuf::from));
        words.push(model.clone());
        words.extend(fit.iter().map(PathBuf::from));
        let fitted = magpie::json(&words, None)?;
        let diagnosis = magpie::json(&["diagnose".as_ref(), &*model, &campaign], None)?;
        Ok(Answer { fitted, diagnosis })
    }
}

/// Results of `fit` and `diagnose`.
struct Answer {
    fitted: Value,
    diagnosis: Value,
}

impl Answer {
    fn list(&self, key: &str) -> &[Value] {
        self.diagnosis[key].as_array().map_or(&[], Vec::as_slice)
    }

    /// Effects of the catalogue that are named, provisionally or not, alone or among others.
    fn effects(&self) -> Vec<&str> {
        let steps = self.list("staircase").iter().filter_map(|step| step["added"].as_array());
        let names = steps.flatten().filter_map(Value::as_str);
        let is_formula =
            |name: &str| self.list("formulas").iter().any(|formula| formula["name"] == name);
        names.filter(|name| !is_formula(name)).collect()
    }

    /// Formulas of the covariates.
    fn formulas(&self) -> Vec<&str> {
        let effects =
            self.list("formulas").iter().filter_map(|formula| formula["effects"].as_array());
        effects.flatten().filter_map(|effect| effect["expression"].as_str()).collect()
    }

    /// Right-hand side of each formula, those of several targets once.
    fn terms(&self) -> Vec<&str> {
        let mut terms: Vec<&str> = self
            .formulas()
            .iter()
            .filter_map(|text| Some(text.split_once('=')?.1.trim()))
            .collect();
        terms.dedup();
        terms
    }

    fn has_term(&self, text: &str) -> bool {
        self.formulas().iter().any(|formula| formula.contains(text))
    }

    fn finding(&self, id: &str) -> Option<&str> {
        let finding = self.list("findings").iter().find(|finding| finding["id"] == id)?;
        finding["message"].as_str()
    }

    /// Held-out error of the field of the model as it is, and after the last step, in gauss.
    fn errors_g(&self) -> [f64; 2] {
        let steps = self.list("staircase");
        [steps.first(), steps.last()]
            .map(|step| step.and_then(|step| step["held_out_rms_g"].as_f64()).unwrap_or(f64::NAN))
    }

    fn fall(&self) -> String {
        let [before, after] = self.errors_g().map(|error| round_significant(error, 3));
        format!("{before} to {after}")
    }

    fn is_at_floor(&self) -> bool {
        self.diagnosis["at_floor"] == true
    }

    fn verdict(&self) -> &str {
        self.diagnosis["verdict"].as_str().unwrap_or_default()
    }

    /// Noise floor of the fit in gauss, root mean square over the axes.
    fn floor_g(&self) -> f64 {
        let axes = self.fitted["axes"].as_array().map_or(&[][..], Vec::as_slice);
        let squares: Vec<f64> = axes
            .iter()
            .filter_map(|axis| axis["floor_g"].as_f64())
            .map(|floor| floor.powi(2))
            .collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }
}

/// Names in short.
fn named(names: &[&str]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join("; ") }
}

fn lattice(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let sources = files.sources(&["run1.csv", "run2.csv", "run3.csv"]);
    let found =
        files.diagnosed(set.folder, &mapping("eflesh_normal"), &sources, &["--degree", "5"])?;
    let [before, after] = found.errors_g();
    Ok(vec![
        claim(
            "a drift over the session",
            found.effects().contains(&"field_drift"),
            named(&found.effects()),
        ),
        claim(
            "further steps, 0.71 to about 0.35 G held out",
            before < 0.73 && after < 0.375,
            format!("{} G, {}", found.fall(), named(&found.terms())),
        ),
        claim(
            "structure remains, the floor of 0.03 G is not reached",
            !found.is_at_floor(),
            found.verdict(),
        ),
    ])
}

fn earth_field(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let found = files.diagnosed(
        set.folder,
        &mapping("px4_earth_field"),
        &files.sources(&["sample_mag.csv"]),
        &[],
    )?;
    let [_, after] = found.errors_g();
    Ok(vec![
        claim(
            "the Earth's field and nothing else",
            found.effects() == ["earth_field"] && found.terms().is_empty(),
            named(&found.effects()),
        ),
        claim("0.0149 to 0.0075 G held out", after < 0.008, format!("{} G", found.fall())),
        claim(
            "offset and field are confounded, the heading moved by 28 degrees",
            found.verdict().contains("yaw 28 degrees"),
            found.verdict(),
        ),
    ])
}

fn pontius(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let runs = files.split("pontius.csv", |cells, _| cells["run"].to_owned())?;
    let found = files.diagnosed(set.folder, &mapping("nist_pontius"), &runs, &[])?;
    let line = files.diagnosed("line", &mapping("nist_pontius"), &runs, &["--degree", "1"])?;
    let floor_g = found.floor_g();
    Ok(vec![
        claim(
            "a straight line is not enough, a parabola is",
            line.diagnosis["higher_degree"]["degree"] == 2
                && found.diagnosis["higher_degree"].is_null(),
            line.verdict(),
        ),
        claim(
            "nothing beyond the parabola",
            found.is_at_floor() && found.effects().is_empty() && found.terms().is_empty(),
            found.verdict(),
        ),
        claim(
            "pure error 2.147e-4, of which 1.942e-4 without the difference of the two runs",
            (floor_g / 1.942e-4 - 1.0).abs() < 0.01,
            format!("{floor_g:.3e}"),
        ),
    ])
}

fn cogging(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let mapping = files.source.join("mapping.toml");
    let maps = files.sources(&["map_a_16.csv", "map_b_16.csv"]);
    let found = files.diagnosed(set.folder, &mapping, &maps, &[])?;
    let has = |harmonic: u32| found.has_term(&format!("({harmonic}*{TURN})"));
    let [_, after] = found.errors_g();
    let is_other = |effect: &&str| *effect != TURN;
    let covariates: Vec<&str> = found
        .list("formulas")
        .iter()
        .filter_map(|of| of["covariates"].as_array())
        .flatten()
        .filter_map(Value::as_str)
        .collect();
    Ok(vec![
        claim(
            "7, 28, 14, 36, 12 and 84 periods a turn",
            [7, 28, 14, 36, 12, 84].into_iter().all(has),
            named(&found.terms()),
        ),
        claim(
            "no drift and no temperature",
            found.effects().is_empty() && !covariates.iter().any(is_other),
            named(&found.effects()),
        ),
        claim(
            "the residual falls below 0.1 A (a map predicts its repetition to 0.066 A)",
            after < 0.1,
            format!("{} A", found.fall()),
        ),
    ])
}

fn thermal_chamber(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let sources = files.sources(&["run1.csv", "run2.csv", "run3.csv"]);
    let found = files.diagnosed(set.folder, &files.source.join("mapping.toml"), &sources, &[])?;
    let [_, after] = found.errors_g();
    Ok(vec![
        claim(
            "the temperature, at least its square",
            found.has_term("temp_c^2"),
            named(&found.terms()),
        ),
        claim("a lag of the temperature", found.has_term("lag(temp_c"), named(&found.terms())),
        claim("a shift in time", found.has_term("time_s"), named(&found.terms())),
        claim("0.0011 rad/s or less", after < 1.1e-3, format!("{} rad/s", found.fall())),
        claim(
            "the three recordings follow one path",
            found.finding("dependent_recordings").is_some(),
            found.finding("dependent_recordings").unwrap_or("not stated"),
        ),
    ])
}

fn grid(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let parts = files.split("run1.csv", |_, row| (row / 961).to_string())?;
    let found = files.diagnosed(set.folder, &files.source.join("mapping.toml"), &parts, &[])?;
    let history = ["hysteresis", "viscous_lag", "creep", "lag("];
    let is_history = |name: &&str| history.iter().any(|own| name.contains(own));
    let floor_g = found.floor_g();
    let names = [found.effects(), found.terms()].concat();
    let drifts = names
        .iter()
        .filter(|name| {
            name.contains("drift") || name.contains("time_s") || name.contains("session_s")
        })
        .count();
    Ok(vec![
        claim("the depth is used", found.has_term("z_mm"), named(&found.terms())),
        claim("a drift, once", drifts == 1, named(&names)),
        claim("no effect of history", !names.iter().any(is_history), named(&names)),
        claim("floor near or below 0.3 G", floor_g < 0.3, format!("{floor_g:.3} G")),
    ])
}

fn soft_finger(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let sources = files.sources(&["run1.csv", "run2.csv", "run3.csv"]);
    let found = files.diagnosed(set.folder, &mapping("soft_finger_static"), &sources, &[])?;
    let order = found.finding("row_order");
    let is_of_time = |name: &&str| {
        ["time_s", "session_s", "lag(", "rate", "creep", "hysteresis", "drift"]
            .iter()
            .any(|own| name.contains(own))
    };
    let names = [found.effects(), found.terms()].concat();
    let [_, after] = found.errors_g();
    let moments =
        ["mx_nm", "my_nm", "mz_nm"].into_iter().filter(|name| found.has_term(name)).count();
    Ok(vec![
        claim(
            "the order of the rows carries no time",
            order.is_some(),
            order.unwrap_or("not stated"),
        ),
        claim("no effect of time or history", !names.iter().any(is_of_time), named(&names)),
        claim(
            "fy and the moments explain the rest",
            found.has_term("fy_n") && moments > 0,
            named(&found.terms()),
        ),
        claim("2.34 mm without, 1.79 with moments", after < 1.85, format!("{} mm", found.fall())),
    ])
}

fn wrapped(set: &Set, files: &Files) -> Result<Vec<Claim>> {
    let mapping = files.source.join("mapping.toml");
    let wrong =
        files.diagnosed(set.folder, &mapping, &files.sources(&["mag_bug_driver.csv"]), &[])?;
    let corrected =
        files.diagnosed("corrected", &mapping, &files.sources(&["mag_bug_fixed.csv"]), &[])?;
    let text = wrong.finding("wrapped").unwrap_or("not stated");
    Ok(vec![
        claim(
            "71 values wrapped by 65536 counts, 9.175 G",
            text.contains("65536") && text.contains("71 of 303") && text.contains("9.18"),
            text,
        ),
        claim(
            "not saturated",
            wrong.finding("saturated").is_none(),
            wrong.finding("saturated").unwrap_or("none"),
        ),
        claim(
            "nothing in the corrected driver's file",
            corrected.list("findings").is_empty(),
            corrected.verdict(),
        ),
    ])
}

fn handbook(_: &Set, files: &Files) -> Result<Vec<Claim>> {
    let loads = files.sources(&["loadcell.csv"]);
    let cell = files.diagnosed("cell", &mapping("nist_load_cell"), &loads, &["--degree", "1"])?;
    let batches = files.split("acoustic_microscope.csv", |cells, _| cells["batch"].to_owned())?;
    let acoustic =
        files.diagnosed("acoustic", &mapping("nist_acoustic_microscope"), &batches, &[])?;
    let couple = files.diagnosed(
        "couple",
        &mapping("nist_thermocouple"),
        &files.sources(&["thermocouple.csv"]),
        &[],
    )?;
    let floor_g = cell.floor_g();
    let difference = acoustic.finding("recording_difference").unwrap_or("not stated");
    let [_, left] = couple.errors_g();
    Ok(vec![
        claim(
            "load cell: pure error 4.14e-5",
            (floor_g / 4.14e-5 - 1.0).abs() < 0.01,
            format!("{floor_g:.3e}"),
        ),
        claim(
            "load cell: a parabola instead of a line",
            cell.diagnosis["higher_degree"]["degree"] == 2,
            cell.verdict(),
        ),
        claim(
            "microscope: offsets of the batches",
            difference.contains("offset of the field"),
            difference,
        ),
        claim("microscope: no drift", acoustic.effects().is_empty(), named(&acoustic.effects())),
        claim(
            "thermocouple: a parabola of the temperature leaves 1.73",
            couple.has_term("temp_c^2") && left < 1.9,
            couple.fall(),
        ),
    ])
}

/// Numbers of a bag that is there in both formats.
const PAIR: &str = r#"description = "a bag in two formats"
[hall]
clock = { from = "b_basictypes.log_time", unit = "ns" }
columns = [{ from = "b_basictypes.int32_value", unit = "V", to = "s0_x_v" }]
[force]
clock = { from = "b_basictypes.log_time", unit = "ns" }
columns = []
"#;

fn bags(_: &Set, files: &Files) -> Result<Vec<Claim>> {
    let mut paths = Vec::new();
    find_bags(&files.source, &mut paths)?;
    ensure!(!paths.is_empty(), "no bags");
    let (mut broken, mut without_text) = (Vec::new(), Vec::new());
    let mut texts: BTreeMap<PathBuf, String> = BTreeMap::new();
    for (place, path) in paths.iter().enumerate() {
        let output = Command::new(std::env::current_exe()?)
            .args([magpie::SUBCOMMAND, "import", "--guess"])
            .arg(path)
            .arg("-o")
            .arg(files.folder.join(format!("{place}.toml")))
            .output()?;
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        match output.status.code() {
            Some(0 | 1) if text.contains("panicked") => broken.push(path.display().to_string()),
            Some(1) if text.trim().is_empty() => without_text.push(path.display().to_string()),
            Some(0 | 1) => {}
            _ => broken.push(path.display().to_string()),
        }
        texts.insert(path.clone(), text.replace(&path.display().to_string(), "BAG"));
    }
    let split: Vec<&str> = texts
        .iter()
        .filter(|(path, _)| path.ends_with("multiple_files"))
        .map(|(_, text)| text.as_str())
        .collect();
    let is_read = |text: &&str| !text.contains("a folder without .csv files");
    let mapping = files.folder.join("pair.toml");
    fs::write(&mapping, PAIR)?;
    let of_pair = |format: &str| {
        let source = files.source.join("rosbag2_py").join(format).join("convert_a");
        let target = files.folder.join(format);
        magpie::run(&["import".as_ref(), &*mapping, &source, "-o".as_ref(), &target], None)
    };
    let (in_mcap, in_sqlite) = (of_pair("mcap"), of_pair("sqlite3"));
    let refusal = in_sqlite.err().map_or_else(String::new, |error| format!("{error:#}"));
    let reason = refusal.split(": ").last().unwrap_or_default().to_owned();
    Ok(vec![
        claim(
            "no panic",
            broken.is_empty(),
            format!(
                "{} bags, {}",
                paths.len(),
                named(&broken.iter().map(String::as_str).collect::<Vec<_>>())
            ),
        ),
        claim(
            "a sentence for each that is refused",
            without_text.is_empty(),
            named(&without_text.iter().map(String::as_str).collect::<Vec<_>>()),
        ),
        claim(
            "bags of several files without metadata are read or named",
            !split.is_empty() && split.iter().all(is_read),
            split.join(" "),
        ),
        claim(
            "a pair in both formats: numbers from MCAP; SQLite has no definition of their message",
            in_mcap.is_ok()
                && reason.contains("the definition of its message type is not in the file"),
            reason,
        ),
    ])
}

/// Folders and files of messages below a folder.
fn find_bags(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let mut has_messages = false;
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            find_bags(&path, found)?;
        } else if path.extension().is_some_and(|own| own == "mcap" || own == "db3") {
            has_messages = true;
            found.push(path);
        }
    }
    if has_messages {
        found.push(folder.to_owned());
    }
    Ok(())
}
