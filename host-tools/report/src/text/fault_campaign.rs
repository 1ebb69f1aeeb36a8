//! Text and JSON of a fault campaign.

use std::path::Path;

use analysis::numbers;
use serde_json::{Value, json};
use sim::faults::campaign::{self, CampaignResult, FaultSummary, RequirementSummary};
use sim::faults::injection::{COVERED_BY_OTHER_TESTS, HARDWARE_ONLY};

use crate::text::terminal;

/// The result in some sentences.
pub fn summary(result: &CampaignResult) -> String {
    let (first, count) = result.seeds;
    let last = first + count - 1;
    let seeds = match count {
        1 => format!("seed {last}"),
        _ => format!("seeds {first} to {last}"),
    };
    let violations: u32 = result.summaries.iter().map(|summary| summary.forbidden).sum();
    let passed = result.summaries.iter().filter(|summary| summary.is_met()).count();
    let mut text = format!(
        "{} runs, {seeds}, both screws, contacts of {} N/mm, uncertain parameters perturbed by up to 20 %. {passed} of \
         {} faults and states meet the specification; {violations} forbidden transitions.",
        result.runs,
        campaign::CONTACTS.map(|stiffness| stiffness.to_string()).join(", "),
        result.summaries.len(),
    );
    let kept = result.requirements.iter().filter(|requirement| requirement.is_met()).count();
    let runs: usize = result.requirements.iter().map(|requirement| requirement.runs).sum();
    if runs > 0 {
        text += &format!(
            " {kept} of {} bounds of the hazard table are kept, {runs} runs.",
            result.requirements.len()
        );
    }
    if result.unreached > 0 {
        text += &format!(" {} runs did not reach their state.", result.unreached);
    }
    if result.fault_free.hours > 0.0 {
        text += &format!(
            " {} false alarms in {} fault-free virtual hours.",
            result.fault_free.alarms,
            numbers::decimal(result.fault_free.hours, 2)
        );
    }
    text
}

/// The report as text; `report` is the path of the HTML report. Faults over all states, what failed for each state.
pub fn format_report(result: &CampaignResult, report: Option<&Path>) -> String {
    let mut page = terminal::paragraph(&summary(result));
    let heads = ["hazard table", "quantity", "bound", "worst", "runs", "within"];
    let mut table = terminal::table(heads);
    for requirement in result.requirements.iter().filter(|requirement| requirement.runs > 0) {
        table.add_row(requirement_cells(requirement));
    }
    page += &format!("{table}\n");
    let heads = ["fault", "states", "runs", "detected", "p99, ms", "limit", "as specified"];
    let mut table = terminal::table(heads);
    for of_fault in result.summaries.chunk_by(|one, next| one.fault == next.fault) {
        table.add_row(fault_cells(of_fault));
    }
    page += &format!("{table}\n");
    let failed: Vec<&FaultSummary> =
        result.summaries.iter().filter(|summary| !summary.is_met()).collect();
    if !failed.is_empty() {
        let heads = ["failed", "state", "runs", "detected", "p99, ms", "peak, N", "final state"];
        let mut table = terminal::table(heads);
        for summary in failed {
            let [_, p99_ms, _] = summary.latency_ms;
            table.add_row([
                summary.fault.specification().description.to_owned(),
                state_name(summary),
                summary.runs.to_string(),
                summary.found.to_string(),
                numbers::decimal(p99_ms, 2),
                numbers::decimal(summary.peak_n, 0),
                summary.ends_words(),
            ]);
        }
        page += &format!("{table}\n");
    }
    let named = |rows: &[(u8, &str)]| {
        let named = rows.iter().map(|(_, words)| *words);
        named.collect::<Vec<_>>().join("; ")
    };
    page +=
        &terminal::paragraph(&format!("Not simulated, needs hardware: {}.", named(&HARDWARE_ONLY)));
    page += &terminal::paragraph(&format!(
        "Covered by other tests: {}.",
        named(&COVERED_BY_OTHER_TESTS)
    ));
    page += &terminal::paragraph(&format!(
        "States are named in firmware/README.md; each fault in each state: --output FILE or --json. Simulated; motor \
         constants assumed. {} s.",
        numbers::decimal(result.seconds, 0)
    ));
    page += &terminal::report_line(report);
    page
}

/// Description, states, runs, detected, greatest p99 latency, its limit, runs as specified.
fn fault_cells(summaries: &[FaultSummary]) -> [String; 7] {
    let facts = summaries.first().map(|summary| summary.fault.specification());
    let sum = |count: fn(&FaultSummary) -> usize| summaries.iter().map(count).sum::<usize>();
    let p99_ms = summaries.iter().map(|summary| summary.latency_ms[1]).fold(0.0, f64::max);
    let met = summaries.iter().filter(|summary| summary.is_met()).count();
    [
        facts.as_ref().map_or_else(String::new, |facts| facts.description.to_owned()),
        summaries.len().to_string(),
        sum(|summary| summary.runs).to_string(),
        sum(|summary| summary.found).to_string(),
        numbers::decimal(p99_ms, 2),
        facts.map_or_else(String::new, |facts| numbers::decimal(facts.within_ms, 1)),
        if met == summaries.len() { "all".to_owned() } else { format!("{met} states (failed)") },
    ]
}

/// Operating state in lower case.
pub fn state_name(summary: &FaultSummary) -> String {
    format!("{:?}", summary.state).to_lowercase()
}

/// Description, quantity, bound, worst value, runs, runs within the bound.
pub fn requirement_cells(requirement: &RequirementSummary) -> [String; 6] {
    let failed = if requirement.is_met() { "" } else { " (failed)" };
    let direction = if requirement.is_minimum { "at least" } else { "at most" };
    [
        requirement.description.clone(),
        requirement.quantity.to_owned(),
        format!("{direction} {}", requirement.bound),
        numbers::decimal(requirement.worst, 2),
        requirement.runs.to_string(),
        format!("{}{failed}", requirement.kept),
    ]
}

/// The object of `--json`.
pub fn to_json(result: &CampaignResult, report: Option<&Path>) -> Value {
    let rows = result.summaries.iter().map(|summary| {
        let facts = summary.fault.specification();
        let [median, p99, max] = summary.latency_ms;
        json!({
            "row": facts.number,
            "fault": facts.description,
            "code": facts.fault as u16,
            "state": state_name(summary),
            "runs": summary.runs,
            "detected": summary.found,
            "p50_ms": median,
            "p99_ms": p99,
            "max_ms": max,
            "limit_ms": facts.within_ms,
            "peak_n": summary.peak_n,
            "max_n": summary.max_n,
            "specified": summary.specified,
            "forbidden": summary.forbidden,
            "ends": summary.ends_words(),
            "is_met": summary.is_met(),
        })
    });
    let requirements = result.requirements.iter().map(|requirement| {
        json!({
            "description": requirement.description,
            "quantity": requirement.quantity,
            "bound": requirement.bound,
            "is_minimum": requirement.is_minimum,
            "worst": requirement.worst,
            "runs": requirement.runs,
            "kept": requirement.kept,
            "is_met": requirement.is_met(),
        })
    });
    json!({
        "simulated": true,
        "from_seed": result.seeds.0,
        "seeds": result.seeds.1,
        "runs": result.runs,
        "unreached": result.unreached,
        "seconds": result.seconds,
        "false_alarm_hours": result.fault_free.hours,
        "false_alarms": result.fault_free.alarms,
        "report": report,
        "rows": rows.collect::<Vec<_>>(),
        "requirements": requirements.collect::<Vec<_>>(),
    })
}
