//! Progress on stderr: bars on a terminal, else a line every ten seconds.

use std::fmt::Write;
use std::io::{self, IsTerminal};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{
    HumanCount, HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle,
    TermLike,
};

/// A bar over `steps`, removed when dropped.
pub fn progress_bar(message: &'static str, steps: usize) -> ProgressBar {
    let bar = ProgressBar::new(steps as u64);
    styled(bar, "{msg:<28} [{bar:30}] {pos}/{len} {elapsed}{about}", message)
}

/// A spinner with the number and rate of rows, where the total is unknown.
pub fn row_spinner(message: &'static str) -> ProgressBar {
    let template = "{msg:<28} {spinner} {human_pos} rows, {per_sec}";
    styled(ProgressBar::new_spinner(), template, message)
}

/// A bar over recordings; [`show_rows`] adds the rows.
pub fn recording_bar(message: &'static str, recordings: usize) -> ProgressBar {
    let template = "{msg:<44} [{bar:20}] {pos}/{len} {elapsed}{about}";
    styled(ProgressBar::new(recordings as u64), template, message)
}

/// Shows the number of rows so far.
pub fn show_rows(bar: &ProgressBar, message: &str, rows: u64) {
    bar.set_message(format!("{message}, {} rows", HumanCount(rows)));
}

/// A spinner behind a changing message.
pub fn status_spinner(message: &'static str) -> ProgressBar {
    styled(ProgressBar::new_spinner(), "{msg} {spinner}", message)
}

/// A bar over training epochs with the maximum remaining time.
pub fn epoch_bar(message: &'static str, epochs: u32, done: u32) -> ProgressBar {
    let bar = ProgressBar::new(u64::from(epochs)).with_position(u64::from(done));
    let template = "{msg:<44} [{bar:20}] {pos}/{len} {elapsed}{at_most}";
    let bar = styled(bar, template, message);
    bar.reset_eta();
    bar
}

/// Stage, share done and time left of work whose length is estimated.
pub struct Stages {
    bar: ProgressBar,
    start: Instant,
    /// When the work is expected to end.
    end: Arc<Mutex<Option<Instant>>>,
}

const BAR_STEPS: f64 = 1000.0;
/// Share of the work from which the rest is estimated.
const LEAST_SHARE: f64 = 0.1;

impl Stages {
    /// Begins now.
    #[allow(clippy::new_without_default, reason = "it starts a clock")]
    pub fn new() -> Self {
        let end: Arc<Mutex<Option<Instant>>> = Arc::default();
        let of_bar = Arc::clone(&end);
        // An estimate that has passed is none.
        let until = move |_: &ProgressState, out: &mut dyn Write| {
            let end = *of_bar.lock().unwrap_or_else(PoisonError::into_inner);
            let left =
                end.map_or(Duration::ZERO, |end| end.saturating_duration_since(Instant::now()));
            if left >= Duration::from_secs(1) {
                // Text in memory.
                let _ = write!(out, ", about {:#} left", HumanDuration(left));
            }
        };
        let template = "{msg:<60} [{bar:20}] {elapsed}{until}";
        let bar = ProgressBar::new(BAR_STEPS as u64);
        let style = ProgressStyle::with_template(template);
        if let Ok(style) = style {
            bar.set_style(style.with_key("until", until).progress_chars("=> "));
        }
        Self { bar: shown(bar, ""), start: Instant::now(), end }
    }

    /// Shows the stage that begins and the estimated share that is done.
    pub fn set(&self, stage: &str, share: f64) {
        let elapsed = self.start.elapsed();
        let left = (share >= LEAST_SHARE).then(|| elapsed.mul_f64(1.0 / share - 1.0));
        let end = left.map(|left| Instant::now() + left);
        *self.end.lock().unwrap_or_else(PoisonError::into_inner) = end;
        self.bar.set_message(format!("{stage}, {:.0} % done", 100.0 * share));
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
        let style = style
            .with_key("about", |state: &ProgressState, out: &mut dyn Write| {
                left(state, "about", mean_left(state), out)
            })
            .with_key("at_most", |state: &ProgressState, out: &mut dyn Write| {
                left(state, "at most", state.eta(), out)
            });
        bar.set_style(style.progress_chars("=> "));
    }
    shown(bar, message)
}

fn shown(bar: ProgressBar, message: &'static str) -> ProgressBar {
    if !io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::term_like(Box::new(Lines::new())));
    }
    bar.set_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// Time left at the mean rate: that of the last seconds is none where a step takes minutes.
fn mean_left(state: &ProgressState) -> Duration {
    let steps = state.len().unwrap_or(0).saturating_sub(state.pos());
    state.elapsed().mul_f64(steps as f64 / state.pos().max(1) as f64)
}

/// The time left, unknown before the first step.
fn left(state: &ProgressState, qualifier: &str, time: Duration, out: &mut dyn Write) {
    if state.pos() > 0 {
        // Text in memory.
        let _ = write!(out, ", {qualifier} {:#} left", HumanDuration(time));
    }
}

/// Time between two lines where stderr is no terminal.
const LINE_PERIOD: Duration = Duration::from_secs(10);
/// Columns of such a line.
const LINE_WIDTH: u16 = 120;

/// A file or pipe in place of a terminal: every ten seconds one line of what a terminal would show.
#[derive(Debug)]
struct Lines {
    /// Text since the last flush, and the time of the next line.
    state: Mutex<(String, Instant)>,
}

impl Lines {
    fn new() -> Self {
        Self { state: Mutex::new((String::new(), Instant::now() + LINE_PERIOD)) }
    }
}

impl TermLike for Lines {
    fn width(&self) -> u16 {
        LINE_WIDTH
    }

    fn move_cursor_up(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.write_str(text)
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        let (shown, _) = &mut *self.state.lock().unwrap_or_else(PoisonError::into_inner);
        shown.push_str(text);
        Ok(())
    }

    fn clear_line(&self) -> io::Result<()> {
        Ok(())
    }

    fn flush(&self) -> io::Result<()> {
        let (shown, next) = &mut *self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let text = std::mem::take(shown);
        let now = Instant::now();
        if now >= *next && !text.trim().is_empty() {
            eprintln!("{}", text.trim());
            *next = now + LINE_PERIOD;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_is_due_after_its_period() {
        let lines = Lines::new();
        let next = |lines: &Lines| lines.state.lock().unwrap().1;
        let first = next(&lines);
        lines.write_str("half done").unwrap();
        lines.flush().unwrap();
        assert_eq!(next(&lines), first, "a line before its time");
        lines.state.lock().unwrap().1 = Instant::now();
        lines.write_str("  ").unwrap();
        lines.flush().unwrap();
        assert!(next(&lines) <= Instant::now(), "an empty line");
        lines.write_str("half done").unwrap();
        lines.flush().unwrap();
        assert!(next(&lines) > Instant::now() + LINE_PERIOD / 2);
    }
}
