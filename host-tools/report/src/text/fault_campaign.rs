//! Text and JSON of a fault campaign.

use std::path::Path;

use analysis::numbers;
use serde_json::{Value, json};
use sim::faults::campaign::{self, CampaignResult, RequirementSummary};
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
    let violations: u32 = result.summaries.iter().map(|tally| tally.forbidden).sum();
    let passed = result.summaries.iter().filter(|tally| tally.is_met()).count();
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

/// The report as text; `report` is the path of the HTML report.
pub fn format_report(result: &CampaignResult, report: Option<&Path>) -> String {
    let mut table = terminal::table([
        "row",
        "fault",
        "state",
        "runs",
        "detected",
        "p50, ms",
        "p99",
        "max",
        "limit",
        "peak, N",
        "final state",
    ]);
    for tally in &result.summaries {
        let facts = tally.fault.specification();
        let [median, p99, max] = tally.latency_ms.map(|ms| numbers::decimal(ms, 2));
        let failed = if tally.is_met() { "" } else { " (failed)" };
        table.add_row([
            facts.number.to_string(),
            facts.description.to_owned(),
            format!("{:?}", tally.state).to_lowercase(),
            tally.runs.to_string(),
            tally.found.to_string(),
            median,
            p99,
            max,
            numbers::decimal(facts.within_ms, 1),
            numbers::decimal(tally.peak_n, 0),
            format!("{}{failed}", tally.ends_words()),
        ]);
    }
    let named = |rows: &[(u8, &str)]| {
        let named = rows.iter().map(|(number, words)| format!("{number} {words}"));
        named.collect::<Vec<_>>().join("; ")
    };
    let mut page = terminal::paragraph(&summary(result));
    page += &format!("{table}\n");
    let heads = ["hazard table", "runs", "kept", "quantity", "bound", "worst"];
    let mut table = terminal::table(heads);
    for requirement in result.requirements.iter().filter(|requirement| requirement.runs > 0) {
        table.add_row(requirement_cells(requirement));
    }
    page += &format!("{table}\n");
    page +=
        &terminal::paragraph(&format!("Not simulated, needs hardware: {}.", named(&HARDWARE_ONLY)));
    page += &terminal::paragraph(&format!(
        "Covered by other tests: {}.",
        named(&COVERED_BY_OTHER_TESTS)
    ));
    page += &terminal::paragraph(&format!(
        "Simulated; motor constants assumed. {} s.",
        numbers::decimal(result.seconds, 0)
    ));
    page += &terminal::report_line(report);
    page
}

/// Description, runs, runs within the bound, quantity, bound, worst value.
pub fn requirement_cells(requirement: &RequirementSummary) -> [String; 6] {
    let failed = if requirement.is_met() { "" } else { " (failed)" };
    let direction = if requirement.is_minimum { "at least" } else { "at most" };
    [
        requirement.description.clone(),
        requirement.runs.to_string(),
        format!("{}{failed}", requirement.kept),
        requirement.quantity.to_owned(),
        format!("{direction} {}", requirement.bound),
        numbers::decimal(requirement.worst, 2),
    ]
}

/// The object of `--json`.
pub fn to_json(result: &CampaignResult, report: Option<&Path>) -> Value {
    let rows = result.summaries.iter().map(|tally| {
        let facts = tally.fault.specification();
        let [median, p99, max] = tally.latency_ms;
        json!({
            "row": facts.number,
            "fault": facts.description,
            "code": facts.fault as u16,
            "situation": format!("{:?}", tally.state).to_lowercase(),
            "runs": tally.runs,
            "found": tally.found,
            "p50_ms": median,
            "p99_ms": p99,
            "most_ms": max,
            "asked_ms": facts.within_ms,
            "peak_n": tally.peak_n,
            "specified": tally.specified,
            "forbidden": tally.forbidden,
            "ends": tally.ends_words(),
            "is_met": tally.is_met(),
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
        "quiet_hours": result.fault_free.hours,
        "false_alarms": result.fault_free.alarms,
        "report": report,
        "rows": rows.collect::<Vec<_>>(),
        "requirements": requirements.collect::<Vec<_>>(),
    })
}
