//! Progress bars on stderr of a terminal; long work also reports to a file or pipe.

use std::cell::Cell;
use std::time::{Duration, Instant};

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

/// Stage, share done and time left of work whose length is estimated: a bar on a terminal, else a line at most every
/// ten seconds.
pub struct Stages {
    bar: ProgressBar,
    start: Instant,
    next_line_s: Cell<f64>,
}

/// Seconds between two lines where stderr is no terminal.
const LINE_S: f64 = 10.0;
/// Steps of the bar.
const BAR_STEPS: f64 = 1000.0;

impl Stages {
    /// Begins now.
    #[allow(clippy::new_without_default, reason = "it starts a clock")]
    pub fn new() -> Self {
        let template = "{msg:<60} [{bar:20}] {elapsed}";
        let bar = styled(ProgressBar::new(BAR_STEPS as u64), template, "");
        Self { bar, start: Instant::now(), next_line_s: Cell::new(LINE_S) }
    }

    /// Shows the stage that begins and the estimated share that is done.
    pub fn set(&self, stage: &str, share: f64) {
        let elapsed_s = self.start.elapsed().as_secs_f64();
        let left = if share > 0.0 {
            format!(", about {:.0} s left", (elapsed_s / share - elapsed_s).max(1.0))
        } else {
            String::new()
        };
        let text = format!("{stage}, {:.0} % done{left}", 100.0 * share);
        if self.bar.is_hidden() && elapsed_s >= self.next_line_s.get() {
            eprintln!("{elapsed_s:.0} s: {text}");
            self.next_line_s.set(elapsed_s + LINE_S);
        }
        self.bar.set_message(text);
        self.bar.set_position((BAR_STEPS * share) as u64);
    }

    /// A line above the bar, or on stderr.
    pub fn line(&self, text: &str) {
        self.bar.suspend(|| eprintln!("{text}"));
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

fn styled(bar: ProgressBar, template: &str, message: &'static str) -> ProgressBar {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
