//! `magpie diagnose`: which physical effect is missing from a model.

use anstyle::{AnsiColor, Style};
use anyhow::Result;
use model_export::model_file::ModelFile;
use serde_json::{Value, json};

use crate::analysis::compare::campaign_reader::read_campaign;
use crate::analysis::compare::format::field;
use crate::analysis::compare::pipeline::compare;
use crate::analysis::data_quality::scan_files;
use crate::analysis::diagnose::suggestions::{Invocation, suggest};
use crate::analysis::diagnose::{
    Diagnosis, StaircaseStep, Suggestion, Unexplained, Verdict, format,
};
use crate::commands::args::{CompareArgs, ExprArgs};
use crate::commands::compare::data_findings;
use crate::report;
use crate::terminal::{self, NARROW_WIDTH};

/// Identify the physical effects that are missing from a model, with the evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie diagnose model.toml tests/data/friction -o report.html
  cargo magpie diagnose model.toml my-campaign --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'
  cargo magpie diagnose model.toml tests/data/demo --json | jq '.accepted'")]
pub struct Args {
    #[command(flatten)]
    common: CompareArgs,
    #[command(flatten)]
    exprs: ExprArgs,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    common.check_output()?;
    let diagnosis = run_diagnosis(args)?;
    terminal::print_result(
        common.input.json,
        || to_json(&diagnosis),
        || format_report(&diagnosis),
    )?;
    if common.output.is_some() {
        let input = &common.input;
        let alignment = input.align.alignment()?;
        let comparison = compare(&input.model, &input.campaign, None, alignment, input.options())?;
        common.write_report(&comparison, &report::diagnosis::sections(&diagnosis))?;
    }
    Ok(())
}

fn run_diagnosis(args: &Args) -> Result<Diagnosis> {
    let input = &args.common.input;
    let model = ModelFile::read(&input.model)?;
    let options = input.options();
    let findings = scan_files(&input.campaign, |_| ())?;
    if findings.iter().any(|finding| finding.stops) {
        return Ok(Diagnosis {
            verdict: crate::analysis::compare::format::stopped_verdict(&findings),
            findings,
            ..Diagnosis::default()
        });
    }
    let alignment = input.align.alignment()?;
    let campaign = read_campaign(&input.campaign, alignment)?;
    let formulas = args.exprs.parse(&campaign)?;
    let bar = terminal::row_spinner("diagnosing");
    let report_step = |step: &str| bar.set_message(step.to_owned());
    let mut diagnosis = crate::analysis::diagnose::diagnose(
        &campaign,
        &model,
        &input.model,
        &formulas,
        options,
        &report_step,
    )?;
    bar.finish_and_clear();
    diagnosis.findings = findings;
    diagnosis.campaign = input.campaign.display().to_string();
    diagnosis.next = suggest(
        &diagnosis,
        &Invocation {
            model: &diagnosis.model,
            campaign: &diagnosis.campaign,
            delay_ms: 1e-3 * alignment.delay_us,
            base: model.base,
            own: &formulas,
        },
    );
    Ok(diagnosis)
}

const HEADING: Style = Style::new().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();

fn format_report(diagnosis: &Diagnosis) -> String {
    let mut page = data_findings(&diagnosis.findings);
    if diagnosis.staircase.is_empty() {
        return page + &paragraph(&diagnosis.verdict);
    }
    page += &verdict_table(diagnosis);
    page += &step_table(diagnosis);
    page += &accepted_effects(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &inconclusive_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    let style = if diagnosis.at_floor { GOOD } else { WARNING };
    page += &styled(style, &diagnosis.verdict);
    page + &next_commands(&diagnosis.next)
}

/// The accepted effects, without the table of all candidates.
pub fn format_summary(diagnosis: &Diagnosis) -> String {
    let mut page = step_table(diagnosis);
    page += &accepted_effects(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    page + "\n"
}

fn paragraph(text: &str) -> String {
    terminal::wrap(text, NARROW_WIDTH)
}

fn styled(style: Style, text: &str) -> String {
    // Line by line, so that a pager that shows one line keeps its color.
    paragraph(text).lines().map(|line| format!("{style}{line}{style:#}\n")).collect()
}

fn verdict_table(diagnosis: &Diagnosis) -> String {
    let mut table = terminal::table(["effect", "verdict", "gain", "p", "magnitude or reason"]);
    table.set_width(NARROW_WIDTH);
    for verdict in &diagnosis.verdicts {
        table.add_row([
            verdict.effect.clone(),
            format::verdict_label(verdict),
            if verdict.gain.is_finite() {
                format!("{:.1} %", 100.0 * verdict.gain.max(0.0))
            } else {
                "-".to_owned()
            },
            if verdict.p_adjusted.is_finite() {
                format!("{:.3}", verdict.p_adjusted)
            } else {
                "-".to_owned()
            },
            verdict.short.clone(),
        ]);
    }
    let mut page = format!("{table}\n");
    if diagnosis.verdicts.iter().any(|v| format::is_present(v) && v.provisional) {
        page += &paragraph(format::PROVISIONAL_NOTE);
    }
    page + &paragraph(&format::significance_note(diagnosis)) + "\n"
}

fn step_table(diagnosis: &Diagnosis) -> String {
    let mut table = terminal::table(["step", "held-out error", "x floor", "as force / N"]);
    table.set_width(NARROW_WIDTH);
    for stair in &diagnosis.staircase {
        table.add_row([
            format::added_effects(stair),
            field(stair.held_out_rms_g),
            format!("{:.2}", stair.held_out_rms_g / stair.floor_g),
            stair.held_out_rmse_n.map_or_else(|| "-".to_owned(), |n| format!("{n:.3}")),
        ]);
    }
    terminal::right_align(&mut table, 1);
    format!("{table}\n\n")
}

/// Accepted effects: estimated and typical magnitude, evidence, physics.
fn accepted_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| format::is_present(v)) {
        page += &styled(HEADING, &heading(verdict));
        page += &paragraph(&format!("  {}", format::physics(verdict)));
        page += &paragraph(&format!("  {}\n", format::reason_sentence(verdict)));
    }
    page
}

fn heading(verdict: &Verdict) -> String {
    match format::magnitude(verdict).as_str() {
        "" => verdict.effect.clone(),
        size => format!("{}: {size}", verdict.effect),
    }
}

/// Effects with equal evidence, and the recordings that would separate them.
fn equivalent_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for tie in format::equivalent_sets(diagnosis) {
        page += &styled(HEADING, &format!("Equivalent on these data: {}", tie.effects.join(", ")));
        for alike in &tie.alike {
            page += &paragraph(&format!("  {alike}."));
        }
        page += &suggested_recordings("To separate them, record", &tie.record);
        page.push('\n');
    }
    page
}

/// Inconclusive effects by reason.
fn inconclusive_effects(diagnosis: &Diagnosis) -> String {
    let groups = format::inconclusive_groups(diagnosis);
    if groups.is_empty() {
        return String::new();
    }
    let mut page = format!("{HEADING}Inconclusive from these recordings{HEADING:#}\n");
    for group in groups {
        page += &paragraph(&format!("  {}: {}.", group.effects.join(", "), group.why));
        page += &suggested_recordings("Record", &group.record);
    }
    page + "\n"
}

fn suggested_recordings(head: &str, list: &[(String, String)]) -> String {
    let mut page = String::new();
    for (effects, record) in list {
        page += &match list.len() {
            1 => paragraph(&format!("    {head}: {record}")),
            _ => paragraph(&format!("    {head}, for {effects}: {record}")),
        };
    }
    page
}

/// The residual that no effect explains.
fn unexplained_residual(diagnosis: &Diagnosis) -> String {
    if diagnosis.at_floor {
        return styled(GOOD, &format::at_floor_note(diagnosis)) + "\n";
    }
    let mut page = String::new();
    for one in &diagnosis.unexplained {
        page += &styled(WARNING, &format::unexplained(one));
    }
    if page.is_empty() {
        page
    } else {
        page + &paragraph(&format!("  {}", format::EXPR_HINT)) + "\n"
    }
}

/// Commands are not wrapped, so that they can be copied.
fn next_commands(next: &Suggestion) -> String {
    let mut page = String::new();
    if !next.words.is_empty() {
        page += &format!("\n{}", paragraph(&next.words));
    }
    for command in &next.commands {
        page += &format!("  {command}\n");
    }
    page
}

fn to_json(diagnosis: &Diagnosis) -> Value {
    let findings = diagnosis.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "message": finding.message,
            "stops": finding.stops,
        })
    });
    json!({
        "model": diagnosis.model,
        "campaign": diagnosis.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "verdicts": diagnosis.verdicts.iter().map(verdict_json).collect::<Vec<_>>(),
        "accepted": diagnosis.accepted,
        "unexplained": diagnosis.unexplained.iter().map(unexplained_json).collect::<Vec<_>>(),
        "at_floor": diagnosis.at_floor,
        "staircase": diagnosis.staircase.iter().map(stair_json).collect::<Vec<_>>(),
        "blocks": diagnosis.blocks,
        "block_s": diagnosis.block_s,
        "seed": diagnosis.seed,
        "next": diagnosis.next.commands,
        "verdict": diagnosis.verdict,
    })
}

fn verdict_json(verdict: &Verdict) -> Value {
    json!({
        "effect": verdict.effect,
        "verdict": verdict.kind.id(),
        "provisional": verdict.provisional,
        "tied_with": verdict.tied_with,
        "gain": verdict.gain,
        "p_adjusted": verdict.p_adjusted,
        "value": verdict.value,
        "std_error": verdict.std_error,
        "unit": verdict.unit,
        "z_typical": verdict.z_typical,
        "reason": verdict.reason,
        "record": verdict.record,
    })
}

fn unexplained_json(unexplained: &Unexplained) -> Value {
    json!({ "covariate": unexplained.covariate, "share": unexplained.share })
}

fn stair_json(stair: &StaircaseStep) -> Value {
    json!({
        "added": stair.added,
        "held_out_rms_g": stair.held_out_rms_g,
        "held_out_rmse_n": stair.held_out_rmse_n,
        "floor_g": stair.floor_g,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::diagnose::fixture::full;

    /// The report without colors.
    fn uncolored(diagnosis: &Diagnosis) -> String {
        anstream::adapter::strip_str(&format_report(diagnosis)).to_string()
    }

    fn unwrapped(page: &str) -> String {
        page.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn lines_other_than_commands_fit_in_80_columns() {
        let page = uncolored(&full());
        for line in page.lines().filter(|line| !line.contains("magpie add")) {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }

    #[test]
    fn each_effect_takes_one_table_row() {
        let page = uncolored(&full());
        let table: Vec<&str> = page
            .lines()
            .skip_while(|line| !line.starts_with('─'))
            .skip(1)
            .take_while(|line| !line.starts_with('─'))
            .collect();
        assert_eq!(table.len(), 9, "{table:#?}");
        assert!(table[8].contains("ABSENT") && table[8].contains("< 0.08 of typical"));
    }

    #[test]
    fn equivalent_effects_list_recordings_that_separate_them() {
        let page = unwrapped(&uncolored(&full()));
        assert!(page.contains("Equivalent on these data: magnet_temperature, sensor_temperature"));
        assert!(page.contains(
            "To separate them, record, for magnet_temperature: Warm the gripper by 10 K"
        ));
        assert!(page.contains(
            "To separate them, record, for sensor_temperature: Warm and cool the unloaded"
        ));
    }

    #[test]
    fn inconclusive_effects_are_grouped_by_reason() {
        let page = unwrapped(&uncolored(&full()));
        assert!(page.contains(
            "tip_slope, geometric_stiffening: typical is too small. Record: Load each flexure"
        ));
        assert!(
            page.contains("earth_field: roll_rad was not recorded. Record: Rotate the unloaded")
        );
        assert!(page.contains("thermal_gap: it moves or changes the magnet"));
    }

    #[test]
    fn unexplained_residual_suggests_a_formula() {
        let mut diagnosis = full();
        let page = unwrapped(&uncolored(&diagnosis));
        assert!(page.contains(
            "UNEXPLAINED: 84 % of the residual follows the rotor angle (motor_angle_rad)"
        ));
        assert!(page.contains("--expr"));
        assert!(!page.contains("AT NOISE FLOOR"));
        diagnosis.at_floor = true;
        let page = unwrapped(&uncolored(&diagnosis));
        assert!(page.contains("AT NOISE FLOOR with what was found"));
        assert!(!page.contains("UNEXPLAINED"));
    }

    #[test]
    fn accepted_effect_has_magnitude_and_physics() {
        let page = unwrapped(&uncolored(&full()));
        let at = page.find("hysteresis: 7.982±0.010 N, friction force").unwrap();
        assert!(page[at..].contains("typical is 2.5 N Where the finger rubs on a guide"));
        assert!(page.contains("It takes away 99.4 %."));
    }

    #[test]
    fn report_ends_with_the_next_command() {
        let page = uncolored(&full());
        assert!(page.ends_with("\n  magpie add model.toml 'my <b>' hysteresis -o new.toml\n"));
    }

    #[test]
    fn provisional_verdict_is_marked_and_explained() {
        let mut diagnosis = full();
        diagnosis.verdicts[0].provisional = true;
        let page = uncolored(&diagnosis);
        assert!(page.contains(" FOUND? "));
        assert!(page.contains("A question mark: provisional"));
        assert!(!uncolored(&full()).contains("A question mark"));
    }
}
