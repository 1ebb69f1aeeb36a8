//! Result of a recording as text and JSON.

use std::path::Path;

use analysis::diagnose::recording_check::RecordingCheck;
use analysis::numbers;
use analysis::reference_delay::ReferenceAlignment;
use device::recorder::{CoveredRange, RecordingCounts};
use report::text::{recording_check, terminal};
use serde_json::{Value, json};

use crate::commands::record::guide::StepResult;

/// Result of a recording.
pub struct Summary<'a> {
    pub(super) output: &'a Path,
    pub(super) start_s: f64,
    pub(super) tally: &'a RecordingCounts,
    /// None without a reference force.
    pub(super) alignment: Option<&'a ReferenceAlignment>,
    /// Steps of the plan, if there was one.
    pub(super) steps: Option<&'a [StepResult]>,
    /// Time in the recording at which the reference ended, before the recording did.
    pub(super) reference_end_s: Option<f64>,
    /// Number of poses sent to the board; none where the source has none.
    pub(super) poses: Option<u64>,
    pub(super) check: Option<&'a CheckResult>,
    /// Which has no covariates, as a virtual board.
    pub(super) is_on_bus: bool,
    pub(super) is_virtual: bool,
    /// The connection was lost, which ended the recording.
    pub(super) is_cut: bool,
}

/// Covered ranges, and the effects on which the recording can decide.
pub struct CheckResult {
    pub(super) ranges: Vec<CoveredRange>,
    /// Number of forces that the board estimated and no reference measured.
    pub(super) estimated_forces: usize,
    pub(super) effects: RecordingCheck,
}

impl Summary<'_> {
    /// As text.
    pub(super) fn format(&self) -> String {
        let Self {
            output,
            start_s,
            tally,
            alignment,
            steps,
            reference_end_s,
            poses,
            check,
            is_on_bus,
            is_virtual,
            is_cut,
        } = *self;
        let seconds = |us: u64| us as f64 * 1e-6;
        let numbers = |sensors: &[usize]| {
            let numbers: Vec<String> = sensors.iter().map(usize::to_string).collect();
            numbers.join(", ")
        };
        let mut text = format!(
            "Recorded to {}: {:.1} s, {} rows of sensors {}; start_s = {}.\n",
            output.display(),
            seconds(tally.span_us),
            tally.rows,
            numbers(&tally.sensors),
            numbers::decimal(start_s, 3),
        );
        match tally.gaps {
            0 if is_cut => text += "No rows lost before the connection was lost.\n",
            0 => text += "No rows lost.\n",
            gaps => {
                let gaps = if gaps == 1 { "1 gap".to_owned() } else { format!("{gaps} gaps") };
                let (longest_us, at_us) = tally.longest_us;
                text += &format!(
                    "Lost: {} rows in {gaps} of t_us, the longest {:.1} ms at {:.3} s.\n",
                    tally.lost,
                    1e3 * seconds(longest_us),
                    seconds(at_us),
                );
            }
        }
        text += &steps.map_or_else(String::new, format_steps);
        text += &match tally.covariates.as_slice() {
            [] => {
                let why = match (is_virtual, is_on_bus) {
                    (true, _) => " (a virtual board has none)",
                    (_, true) => " (only a serial line carries them)",
                    _ => "",
                };
                format!(
                    "No covariates{why}: effects of opening, motor and orientation cannot be diagnosed.\n"
                )
            }
            names => terminal::paragraph(&format!("Covariates: {}.", names.join(", "))),
        };
        if !is_virtual && !is_on_bus && !tally.covariates.contains(&"opening_mm") {
            text += "The opening was unknown: home the gripper first (cargo magpie grasp --port PATH --home --position 40).\n";
        }
        if tally.without_covariates > 0 {
            text += &format!(
                "Excluded: {} rows in which a covariate was missing.\n",
                tally.without_covariates
            );
        }
        if tally.left_out > tally.without_covariates {
            let silent = tally.silent.iter().enumerate();
            let silent =
                silent.filter(|(sensor, count)| **count > 0 && tally.sensors.contains(sensor));
            let silent: Vec<String> =
                silent.map(|(sensor, count)| format!("sensor {sensor} in {count}")).collect();
            text += &terminal::paragraph(&format!(
                "Excluded: {} rows without a reading of all sensors ({}).",
                tally.left_out - tally.without_covariates,
                silent.join(", ")
            ));
        }
        text += &terminal::paragraph(&match alignment {
        None => "force.csv has times but no forces: replace it by the reference's table (t_us from the same start) before \
                 fit, compare and replay."
            .to_owned(),
        Some(ReferenceAlignment { doubt: Some(doubt), .. }) => format!(
            "Reference: {} rows; its delay cannot be determined, because {}. t_us of force.csv is that of arrival.",
            tally.reference_rows,
            doubt.text()
        ),
        Some(ReferenceAlignment { delay, doubt: None }) => delay.map_or_else(String::new, |delay| {
            let [low_ms, high_ms] = delay.interval_s.map(|s| 1e3 * s);
            format!(
                "Reference: {} rows; delay {:.2} ms, standard error {:.2} ms, 95 % from {low_ms:.2} to {high_ms:.2} ms; the \
                 fields explain {:.1} % of its variance. {}t_us of force.csv is corrected by it.",
                tally.reference_rows,
                1e3 * delay.delay_s,
                1e3 * delay.standard_error_s,
                100.0 * delay.explained,
                match delay.lag_s {
                    [0.0, 0.0] => String::new(),
                    [x_s, z_s] => format!(
                        "The {} fields lag by another {:.2} ms, as of viscous lag: diagnose. ",
                        if x_s > z_s { "lateral" } else { "longitudinal" },
                        1e3 * x_s.max(z_s)
                    ),
                }
            )
        }),
    });
        if let Some(end_s) = reference_end_s {
            text += &terminal::paragraph(&format!(
                "Incomplete: the reference ended after {end_s:.1} s of {:.1} s.",
                seconds(tally.span_us)
            ));
        }
        if let Some(poses) = poses {
            text += &terminal::paragraph(&match tally.covariates.contains(&"yaw_rad") {
                true => format!("Pose: {poses} samples sent to the board."),
                false => format!(
                    "Pose: {poses} samples sent to the board, whose covariates did not contain it: it is not recorded."
                ),
            });
        }
        text + &check.map_or_else(String::new, format_check)
    }

    /// As one JSON object.
    pub(super) fn to_json(&self) -> Value {
        let Self {
            output, start_s, tally, alignment, steps, reference_end_s, poses, check, ..
        } = *self;
        json!({
            "recording": output,
            "start_s": start_s,
            "span_s": tally.span_us as f64 * 1e-6,
            "sensors": tally.sensors,
            "rows": tally.rows,
            "lost_rows": tally.lost,
            "gaps": tally.gaps,
            "connection_lost": self.is_cut,
            "longest_gap_s": tally.longest_us.0 as f64 * 1e-6,
            "longest_gap_at_s": tally.longest_us.1 as f64 * 1e-6,
            "covariates": tally.covariates,
            "left_out_rows": tally.left_out,
            "rows_without_covariates": tally.without_covariates,
            "silent_rows": tally.silent,
            "reference": alignment.is_some(),
            "reference_ended_s": reference_end_s,
            "steps": steps.map(|steps| steps.iter().map(step_json).collect::<Vec<_>>()),
            "pose_messages": poses,
            "check": check.map(check_json),
            "reference_rows": tally.reference_rows,
            "reference_delay": alignment.and_then(|alignment| alignment.delay),
            "reference_delay_applied": alignment.map(|alignment| alignment.doubt.is_none()),
            "reference_delay_doubt": alignment.and_then(|alignment| alignment.doubt),
        })
    }
}

/// Steps of a plan whose ranges were not covered.
fn format_steps(steps: &[StepResult]) -> String {
    let uncovered = (1..).zip(steps).filter(|(_, step)| !step.uncovered.is_empty());
    let lines: Vec<String> = uncovered
        .map(|(number, step)| {
            let ranges = step.uncovered.iter();
            let ranges = ranges.map(|(name, share)| format!("{name} {:.0} %", 100.0 * share));
            format!("step {number} ({})", ranges.collect::<Vec<_>>().join(", "))
        })
        .collect();
    match lines.as_slice() {
        [] => format!("Plan: all {} steps are covered.\n", steps.len()),
        lines => terminal::paragraph(&format!("Plan: not covered: {}.", lines.join("; "))),
    }
}

/// Duration, and the ranges that were not covered with their shares.
fn step_json(step: &StepResult) -> Value {
    let uncovered = step.uncovered.iter();
    let uncovered: Vec<Value> = uncovered
        .map(|(quantity, share)| json!({ "quantity": quantity, "share": share }))
        .collect();
    json!({ "seconds": step.seconds, "not_covered": uncovered })
}

/// Covered ranges, then the effects.
fn format_check(check: &CheckResult) -> String {
    let mut table = terminal::table(["quantity", "covered", "needed", "unit", "share"]);
    for range in &check.ranges {
        table.add_row([
            range.quantity.to_owned(),
            format!("{:.1} to {:.1}", range.min, range.max),
            format!("{:.1}", range.needed),
            range.unit.to_owned(),
            format!("{:.0} %", 100.0 * range.share()),
        ]);
    }
    terminal::right_align(&mut table, 1);
    let forces = match check.estimated_forces {
        0 => String::new(),
        count => terminal::paragraph(&format!(
            "{count} forces are estimates of the board, in this check only: record a reference before fit and diagnose."
        )),
    };
    format!("{table}\n{forces}{}", recording_check::format_check(&check.effects))
}

fn check_json(check: &CheckResult) -> Value {
    let ranges = check.ranges.iter().map(|range| {
        let mut object = json!(range);
        object["share"] = range.share().into();
        object
    });
    json!({
        "ranges": ranges.collect::<Vec<_>>(),
        "estimated_forces": check.estimated_forces,
        "effects": recording_check::check_json(&check.effects),
    })
}
