//! One case: simulate, fit, diagnose, by the tool's own commands.

use std::path::Path;
use std::process::Command;

use host_tools::bench::sizes::size_of;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::evidence::Around;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde_json::Value;
use tempfile::TempDir;

use super::cases::{Case, Expected};
use super::judge::{Judged, judge};

/// Blocks play no part in how far a known change stands out.
const BLOCK_S: f64 = 5.0;

/// What came of a case.
pub struct Outcome {
    /// What was said, held against what was hidden.
    pub judged: Judged,
    /// How many error bars what was hidden stands out, from the simulator's truth; NaN where nothing was.
    pub z: f64,
    /// What was accepted.
    accepted: String,
    /// Held-out error in floors, before and after.
    floors: (f64, f64),
}

impl Outcome {
    /// One line.
    pub fn line(&self, case: &Case) -> String {
        let hidden: Vec<String> = case
            .hidden
            .iter()
            .map(|(id, by)| format!("{id} x {by}"))
            .collect();
        format!(
            "{:<12} {} [{} {} seed {}] z {:.0}: {} ({:.2} -> {:.2} floors)",
            self.judged.word(),
            hidden.join(" + "),
            case.programme,
            case.noise,
            case.seed,
            self.z,
            self.accepted,
            self.floors.0,
            self.floors.1,
        )
    }
}

/// Runs a case.
pub fn run(case: &Case) -> Outcome {
    let folder = TempDir::new().expect("a folder for the campaign");
    let campaign = folder.path().join("campaign");
    let model = folder.path().join("model.toml");
    simulate(case, true, &campaign);
    magpie(&["fit".as_ref(), &campaign, "-o".as_ref(), &model]);
    let said = magpie(&["diagnose".as_ref(), &model, &campaign, "--json".as_ref()]);
    let said: Value = serde_json::from_slice(&said).expect("one JSON object");
    let z = match (&case.expected, case.hidden.is_empty()) {
        (Expected::Names, false) => {
            let clean = folder.path().join("clean");
            simulate(case, false, &clean);
            stands_out(&clean, &campaign)
        }
        _ => f64::NAN,
    };
    let floors = |stair: Option<&Value>| {
        let number = |name: &str| stair.and_then(|s| s[name].as_f64()).unwrap_or(f64::NAN);
        number("held_out_rms_g") / number("floor_g")
    };
    let stairs = said["staircase"].as_array();
    Outcome {
        judged: judge(case, &said),
        z,
        accepted: said["accepted"].to_string(),
        floors: (
            floors(stairs.and_then(|s| s.first())),
            floors(stairs.and_then(|s| s.last())),
        ),
    }
}

fn simulate(case: &Case, hidden: bool, to: &Path) {
    let seed = case.seed.to_string();
    let mut arguments = vec![
        "simulate",
        "--programme",
        case.programme,
        "--noise",
        case.noise,
    ];
    arguments.extend(["--seed", &seed, "-o"]);
    let mut arguments: Vec<&Path> = arguments.into_iter().map(Path::new).collect();
    arguments.push(to);
    let effects: Vec<String> = case
        .hidden
        .iter()
        .map(|(id, factor)| {
            let typical = size_of(id).map_or(0.0, |size| size.typical());
            format!("{id}={}", typical * factor)
        })
        .collect();
    for effect in effects.iter().filter(|_| hidden) {
        arguments.extend([Path::new("--effect"), Path::new(effect)]);
    }
    magpie(&arguments);
}

fn magpie(arguments: &[&Path]) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(arguments)
        // The bench keeps every core busy itself.
        .env("RAYON_NUM_THREADS", "1")
        .output()
        .expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    output.stdout
}

/// How far the fields of two campaigns, which differ in one thing, stand apart beside what a fit absorbs.
fn stands_out(clean: &Path, hidden: &Path) -> f64 {
    let read = |folder: &Path| {
        let campaign =
            Campaign::read(folder, Alignment { delay_us: 0.0 }, |_| ()).expect("a campaign");
        Prepared::cylinder(&campaign).expect("forces and a design")
    };
    let (clean, hidden) = (read(clean), read(hidden));
    let fit = clean
        .fit(&[], clean.split(&[]), Options::default(), |_| ())
        .expect("a fit");
    let around = Around::new(&clean, &[], &fit, BLOCK_S);
    around.stands_out(|sensor, part, row| {
        let at = |of: &Prepared| {
            let part = &of.rows[sensor].parts[part];
            Some((*part.field_g.get(row)?, *part.track.force_n.get(row)?))
        };
        match (at(&hidden), at(&clean)) {
            (Some((field, force)), Some((clean, without))) => (
                field - clean,
                [0, 1].map(|axis| force[axis] - without[axis]),
            ),
            _ => (nalgebra::Vector3::zeros(), [0.0; 2]),
        }
    })
}
