//! What long work shows while it runs: on stderr, and only on a terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar of `steps`; it vanishes when it is dropped.
pub fn bar(what: &'static str, steps: usize) -> ProgressBar {
    let bar = ProgressBar::new(steps as u64);
    if let Ok(style) = ProgressStyle::with_template("{msg:<28} [{bar:30}] {pos}/{len} {elapsed}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(what);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// A count of rows whose end is not known.
pub fn rows(what: &'static str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    if let Ok(style) =
        ProgressStyle::with_template("{msg:<28} {spinner} {human_pos} rows, {per_sec}")
    {
        spinner.set_style(style);
    }
    spinner.set_message(what);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// A line whose text says how far something is that may have no end.
pub fn message(what: &'static str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{msg} {spinner}") {
        spinner.set_style(style);
    }
    spinner.set_message(what);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// A bar of epochs, of which some are done, with the time that is left at the most.
pub fn epochs(what: &'static str, epochs: u32, done: u32) -> ProgressBar {
    let bar = ProgressBar::new(u64::from(epochs)).with_position(u64::from(done));
    let template = "{msg:<44} [{bar:20}] {pos}/{len} {elapsed}, at most {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(what);
    bar.reset_eta();
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// A bar over several trainings, whose length grows as they are announced, with the time that is left
/// at the most.
pub fn table() -> ProgressBar {
    let bar = ProgressBar::new(0);
    let template = "{msg:<44} [{bar:20}] {elapsed}, at most {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message("fitting the physics");
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
