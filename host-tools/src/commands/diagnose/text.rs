//! What `magpie diagnose` shows in the terminal.

use model_export::effects::find;

use crate::commands::compare::text::findings;
use crate::compare::words::field;
use crate::diagnose::{Diagnosis, Kind, Verdict};
use crate::show;

/// The page.
pub fn text(diagnosis: &Diagnosis) -> String {
    let mut page = findings(&diagnosis.findings);
    if diagnosis.staircase.is_empty() {
        return page + &show::paragraph(&diagnosis.verdict);
    }
    page += &staircase(diagnosis);
    page += &verdicts(diagnosis);
    page += &paragraphs(diagnosis);
    page += &records(diagnosis);
    page += &show::paragraph(&format!(
        "Chance: wild bootstrap over {} blocks of {:.1} s, all candidates together, seed {}.",
        diagnosis.blocks, diagnosis.block_s, diagnosis.seed
    ));
    page.push('\n');
    page + &show::paragraph(&diagnosis.verdict)
}

fn staircase(diagnosis: &Diagnosis) -> String {
    let mut table = show::table(["the error falls", "held out", "x floor", "as force / N"]);
    for (i, stair) in diagnosis.staircase.iter().enumerate() {
        table.add_row([
            match i {
                0 => "the model as it is".to_owned(),
                _ => format!("+ {}", stair.added.join(" or ")),
            },
            field(stair.held_out_rms_g),
            format!("{:.2}", stair.held_out_rms_g / stair.floor_g),
            stair
                .held_out_rmse_n
                .map_or_else(|| "-".to_owned(), |n| format!("{n:.3}")),
        ]);
    }
    show::right_align(&mut table, 1);
    format!("{table}\n\n")
}

fn verdicts(diagnosis: &Diagnosis) -> String {
    let mut table = show::table(["effect", "verdict", "gain", "p", "z typical", "why"]);
    for verdict in &diagnosis.verdicts {
        let number = |value: f64, digits: usize| match value.is_finite() {
            true => format!("{value:.digits$}"),
            false => "-".to_owned(),
        };
        table.add_row([
            verdict.effect.clone(),
            word(verdict),
            match verdict.gain.is_nan() {
                true => "-".to_owned(),
                false => format!("{:.1} %", 100.0 * verdict.gain.max(0.0)),
            },
            number(verdict.p_adjusted, 3),
            number(verdict.z_typical, 1),
            verdict.reason.clone(),
        ]);
    }
    format!("{table}\n\n")
}

fn word(verdict: &Verdict) -> String {
    let word = match verdict.kind {
        Kind::Found => "FOUND",
        Kind::Tied => "TIED",
        Kind::Shadow => "SHADOW",
        Kind::NotJudgeable => "NOT JUDGEABLE",
        Kind::Absent => "ABSENT",
    };
    match verdict.provisional {
        true => format!("{word}, provisional"),
        false => word.to_owned(),
    }
}

/// The physics of what was found, with its size beside the typical one.
fn paragraphs(diagnosis: &Diagnosis) -> String {
    let there = |verdict: &&Verdict| matches!(verdict.kind, Kind::Found | Kind::Tied);
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(there) {
        let size = match verdict.value.is_finite() {
            true => format!(
                ": {} {}",
                show::with_error(verdict.value, verdict.std_error, verdict.value.abs()),
                verdict.unit
            ),
            false => String::new(),
        };
        let tied = match verdict.tied_with.as_slice() {
            [] => String::new(),
            tied => format!(" (or {})", tied.join(" or ")),
        };
        page += &show::paragraph(&format!("{}{tied}{size}", verdict.effect));
        if let Ok(effect) = find(&verdict.effect) {
            let typical = format!("Typical is {} {}.", effect.size.typical, effect.size.unit);
            page += &show::paragraph(&format!("  {} {typical}", effect.physics));
        }
        page.push('\n');
    }
    page
}

/// What to record, for what is tied or cannot be judged.
fn records(diagnosis: &Diagnosis) -> String {
    let open = |verdict: &&Verdict| !verdict.record.is_empty();
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(open) {
        page += &show::paragraph(&format!("  {}: {}", verdict.effect, verdict.record));
    }
    match page.is_empty() {
        true => page,
        false => format!("To know better, record:\n{page}\n"),
    }
}
