//! What `magpie diagnose` shows in the terminal.

use anstyle::{AnsiColor, Style};

use crate::commands::compare::text::findings;
use crate::compare::words::field;
use crate::diagnose::{Diagnosis, Next, Verdict, words};
use crate::show::{self, NARROW};

const HEAD: Style = Style::new().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const DOUBTFUL: Style = AnsiColor::Yellow.on_default().bold();

/// The page.
pub fn text(diagnosis: &Diagnosis) -> String {
    let mut page = findings(&diagnosis.findings);
    if diagnosis.staircase.is_empty() {
        return page + &paragraph(&diagnosis.verdict);
    }
    page += &verdicts(diagnosis);
    page += &staircase(diagnosis);
    page += &found(diagnosis);
    page += &ties(diagnosis);
    page += &unjudged(diagnosis);
    page += &left(diagnosis);
    let style = match diagnosis.at_floor {
        true => GOOD,
        false => DOUBTFUL,
    };
    page += &styled(style, &diagnosis.verdict);
    page + &next(&diagnosis.next)
}

/// What was found, without the table of everything that was not.
pub fn story(diagnosis: &Diagnosis) -> String {
    let mut page = staircase(diagnosis);
    page += &found(diagnosis);
    page += &ties(diagnosis);
    page += &left(diagnosis);
    page + "\n"
}

fn paragraph(text: &str) -> String {
    show::wrapped(text, NARROW)
}

fn styled(style: Style, text: &str) -> String {
    // Each line for itself: a reader that shows one line keeps its colour.
    paragraph(text)
        .lines()
        .map(|line| format!("{style}{line}{style:#}\n"))
        .collect()
}

fn verdicts(diagnosis: &Diagnosis) -> String {
    let mut table = show::table(["effect", "verdict", "gain", "p", "how much, or why not"]);
    table.set_width(NARROW);
    for verdict in &diagnosis.verdicts {
        table.add_row([
            verdict.effect.clone(),
            words::word(verdict),
            match verdict.gain.is_finite() {
                true => format!("{:.1} %", 100.0 * verdict.gain.max(0.0)),
                false => "-".to_owned(),
            },
            match verdict.p_adjusted.is_finite() {
                true => format!("{:.3}", verdict.p_adjusted),
                false => "-".to_owned(),
            },
            verdict.short.clone(),
        ]);
    }
    let mut page = format!("{table}\n");
    if diagnosis
        .verdicts
        .iter()
        .any(|v| words::is_there(v) && v.provisional)
    {
        page += &paragraph(words::PROVISIONAL);
    }
    page + &paragraph(&words::chance(diagnosis)) + "\n"
}

fn staircase(diagnosis: &Diagnosis) -> String {
    let mut table = show::table(["the error falls", "held out", "x floor", "as force / N"]);
    table.set_width(NARROW);
    for stair in &diagnosis.staircase {
        table.add_row([
            words::added(stair),
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

/// What was found: its size beside the typical one, why it is believed, its physics.
fn found(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| words::is_there(v)) {
        page += &styled(HEAD, &heading(verdict));
        page += &paragraph(&format!("  {}", words::physics(verdict)));
        page += &paragraph(&format!("  {}\n", words::sentence(verdict)));
    }
    page
}

fn heading(verdict: &Verdict) -> String {
    match words::size(verdict).as_str() {
        "" => verdict.effect.clone(),
        size => format!("{}: {size}", verdict.effect),
    }
}

/// For each tie the recordings that would tell.
fn ties(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for tie in words::ties(diagnosis) {
        page += &styled(HEAD, &format!("Not told apart: {}", tie.effects.join(", ")));
        for alike in &tie.alike {
            page += &paragraph(&format!("  {alike}."));
        }
        page += &recordings("To tell, record", &tie.record);
        page.push('\n');
    }
    page
}

/// What cannot be judged, reason by reason.
fn unjudged(diagnosis: &Diagnosis) -> String {
    let groups = words::unjudged(diagnosis);
    if groups.is_empty() {
        return String::new();
    }
    let mut page = format!("{HEAD}Not judgeable from these recordings{HEAD:#}\n");
    for group in groups {
        page += &paragraph(&format!("  {}: {}.", group.effects.join(", "), group.why));
        page += &recordings("To judge, record", &group.record);
    }
    page + "\n"
}

fn recordings(head: &str, list: &[(String, String)]) -> String {
    let mut page = String::new();
    for (effects, record) in list {
        page += &match list.len() {
            1 => paragraph(&format!("    {head}: {record}")),
            _ => paragraph(&format!("    {head}, for {effects}: {record}")),
        };
    }
    page
}

/// What no effect explains, or that nothing is left.
fn left(diagnosis: &Diagnosis) -> String {
    if diagnosis.at_floor {
        return styled(GOOD, &words::stop(diagnosis)) + "\n";
    }
    let mut page = String::new();
    for one in &diagnosis.unexplained {
        page += &styled(DOUBTFUL, &words::unexplained(one));
    }
    match page.is_empty() {
        true => page,
        false => page + &paragraph(&format!("  {}", words::EXPR)) + "\n",
    }
}

/// Commands stand on lines of their own, unbroken: they are to be copied.
fn next(next: &Next) -> String {
    let mut page = String::new();
    if !next.words.is_empty() {
        page += &format!("\n{}", paragraph(&next.words));
    }
    for command in &next.commands {
        page += &format!("  {command}\n");
    }
    page
}

#[cfg(test)]
mod tests;
