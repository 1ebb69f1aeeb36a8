//! Progress bars, on stderr of a terminal only.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `steps`, removed when dropped.
pub fn progress_bar(message: &'static str, steps: usize) -> ProgressBar {
    let bar = ProgressBar::new(steps as u64);
    styled(bar, "{msg:<28} [{bar:30}] {pos}/{len} {elapsed}", message)
}

/// A spinner with the number and rate of rows, where the total is unknown.
pub fn row_spinner(message: &'static str) -> ProgressBar {
    let template = "{msg:<28} {spinner} {human_pos} rows, {per_sec}";
    styled(ProgressBar::new_spinner(), template, message)
}

/// A spinner behind a changing message.
pub fn status_spinner(message: &'static str) -> ProgressBar {
    styled(ProgressBar::new_spinner(), "{msg} {spinner}", message)
}

/// A bar over training epochs with the maximum remaining time.
pub fn epoch_bar(message: &'static str, epochs: u32, done: u32) -> ProgressBar {
    let bar = ProgressBar::new(u64::from(epochs)).with_position(u64::from(done));
    let template = "{msg:<44} [{bar:20}] {pos}/{len} {elapsed}, at most {eta} left";
    let bar = styled(bar, template, message);
    bar.reset_eta();
    bar
}

/// A bar whose length grows as work is announced, with the maximum remaining time.
pub fn growing_bar() -> ProgressBar {
    let template = "{msg:<44} [{bar:20}] {elapsed}, at most {eta} left";
    styled(ProgressBar::new(0), template, "fitting the physics")
}

fn styled(bar: ProgressBar, template: &str, message: &'static str) -> ProgressBar {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
