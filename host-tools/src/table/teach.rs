//! The networks of the table: each learns from the same seconds, and a block at their end tells it
//! when to stop, and calibrates the standard deviations that it tells.

use std::cell::RefCell;
use std::path::Path;

use anyhow::Result;
use indicatif::ProgressBar;
use model_export::gru::file::{NetworkFile, Provenance};
use model_export::gru::train::course::{Course, Settings};
use model_export::gru::train::lesson::Sequence;
use model_export::inverse::build::Built;
use model_export::recordings::raw::RawStream;

use super::data::Data;
use super::refit::Refitted;
use super::variant::{Behind, Variant};
use crate::commands::train::sigma::Sigma;
use crate::lessons::sequence;
use crate::networks::Networks;
use crate::progress;
use crate::replay::Models;

/// Share of the seconds, at their end, by which the epoch is chosen.
const STOPPING: f64 = 0.2;
/// Most of the last recording that this may take, so that some of it is learned from.
const MOST_OF_LAST: f64 = 0.8;
/// Seconds before that block which only bring the state to where it would be.
const LEAD_S: f64 = 1.0;
/// Training on less than this takes more epochs, since an epoch then has fewer steps.
const MANY_S: f64 = 50.0;
/// But not more than so many times as many.
const MOST_EPOCHS: f64 = 3.0;

/// How networks are trained.
pub struct Plan {
    settings: Settings,
    hidden: usize,
    /// What a row without force counts in [`Variant::Gru3AxisNearZero`].
    pub near_zero: f64,
    /// Epochs times seconds: what training costs.
    bar: ProgressBar,
    step: RefCell<(usize, usize)>,
}

/// Networks and how they were found.
pub struct Taught {
    /// On a gripper that has been on for a while.
    pub networks: Networks,
}

/// What is learned from behind each kind of physics.
pub struct Lessons {
    fitted: Part,
    with_effects: Option<Part>,
    /// Seconds that tell when to stop.
    pub stopping_s: f64,
}

struct Part {
    lessons: Vec<Sequence>,
    stopping: Sequence,
}

impl Lessons {
    /// Runs the first `seconds` of the recordings through the device's code.
    pub fn of(data: &Data, refitted: &Refitted, seconds: f64) -> Result<Self> {
        let shares = data.shares_s(seconds);
        let last = shares.last().copied().unwrap_or(0.0);
        let stopping_s = (STOPPING * seconds).min(MOST_OF_LAST * last);
        let part = |behind: Behind| -> Result<Option<Part>> {
            let Some(built) = refitted.behind(behind) else {
                return Ok(None);
            };
            Ok(Some(part(data, built, &shares, stopping_s)?))
        };
        let Some(fitted) = part(Behind::Fitted)? else {
            anyhow::bail!("the ideal model could not be fitted");
        };
        Ok(Self {
            fitted,
            with_effects: part(Behind::Effects)?,
            stopping_s,
        })
    }

    fn behind(&self, behind: Behind) -> Option<&Part> {
        match behind {
            Behind::Nominal => None,
            Behind::Fitted => Some(&self.fitted),
            Behind::Effects => self.with_effects.as_ref(),
        }
    }
}

/// The recordings' beginnings as the device sees them, the last of them cut in two.
fn part(data: &Data, built: &Built, shares_s: &[f64], stopping_s: f64) -> Result<Part> {
    let mut lessons = Vec::new();
    let mut stopping = Sequence::default();
    let ends = shares_s.len();
    let recordings = data.campaign.recordings.iter().zip(shares_s);
    for (at, (recording, &share_s)) in recordings.enumerate() {
        let stream = RawStream::open(&recording.folder, &recording.description, data.alignment)?;
        let whole = sequence(Models::of(built), &recording.name, stream, |_| ())?;
        let per_s = whole.rows as f64 / recording.span_s();
        let row = |seconds: f64| (seconds * per_s).round() as usize;
        // The board's rows may go on for a little after the reference's last.
        let end = match share_s < recording.span_s() {
            true => row(share_s),
            false => whole.rows,
        };
        if at + 1 < ends {
            lessons.push(whole.part(0..end, 0));
        } else {
            let cut = end.saturating_sub(row(stopping_s));
            lessons.push(whole.part(0..cut, 0));
            stopping = whole.part(cut.saturating_sub(row(LEAD_S))..end, cut);
        }
    }
    Ok(Part { lessons, stopping })
}

impl Plan {
    /// With these settings, networks of `hidden` units a layer.
    pub fn new(settings: Settings, hidden: usize, near_zero: f64) -> Self {
        Self {
            settings,
            hidden,
            near_zero,
            bar: progress::table(),
            step: RefCell::new((0, 0)),
        }
    }

    /// Seed of everything that is drawn.
    pub fn seed(&self) -> u64 {
        self.settings.seed
    }

    /// Most epochs of a training on everything.
    pub fn most_epochs(&self) -> u32 {
        self.settings.epochs
    }

    /// Epochs on so many seconds.
    fn epochs(&self, seconds: f64) -> u32 {
        let more = (MANY_S / seconds).sqrt().clamp(1.0, MOST_EPOCHS);
        (f64::from(self.settings.epochs) * more).round() as u32
    }

    /// What a training on so many seconds costs, at the most.
    fn cost(&self, seconds: f64) -> u64 {
        (f64::from(self.epochs(seconds)) * seconds.max(1.0)) as u64
    }

    /// Says beforehand which trainings come, by their seconds.
    pub fn announce(&self, seconds: impl Iterator<Item = f64>) {
        for seconds in seconds {
            self.bar.inc_length(self.cost(seconds));
            self.step.borrow_mut().1 += 1;
        }
    }

    /// Nothing comes any more.
    pub fn close(&self) {
        self.bar.finish_and_clear();
    }

    /// Trains the networks of a way; `None` where it has none.
    pub fn teach(
        &self,
        variant: Variant,
        lessons: &Lessons,
        built: &Built,
        seconds: f64,
    ) -> Result<Option<Taught>> {
        let (Some(topology), Some(part)) = (
            variant.topology(self.hidden),
            lessons.behind(variant.behind()),
        ) else {
            return Ok(None);
        };
        let epochs = self.epochs(seconds);
        let settings = Settings {
            epochs,
            patience: self.settings.patience.max(epochs / 3),
            near_zero: match variant {
                Variant::Gru3AxisNearZero => self.near_zero,
                _ => self.settings.near_zero,
            },
            ..self.settings.clone()
        };
        let mut course = Course::new(settings, topology, &part.lessons, &part.stopping)?;
        let (number, all) = {
            let mut step = self.step.borrow_mut();
            step.0 += 1;
            *step
        };
        let (before, cost) = (self.bar.position(), self.cost(seconds));
        while !course.finished() {
            let progress = course.epoch()?;
            self.bar.set_message(format!(
                "{number} of {all}: {}, {seconds:.0} s",
                variant.words()
            ));
            let share = f64::from(progress.epoch) / f64::from(epochs);
            self.bar.set_position(before + (share * cost as f64) as u64);
        }
        self.bar.set_position(before + cost);
        let sigma = Sigma::of(&course, &part.lessons, &part.stopping, built)?;
        let mut networks = course.networks();
        sigma.apply(&mut networks);
        let provenance = Provenance {
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
            model_sha256: built.header.inputs_sha256.clone(),
            campaign: built.header.campaign.clone(),
            recordings: Vec::new(),
            delay_ms: built.model.provenance.delay_ms,
            topology: course.topology.clone(),
            settings: course.settings.clone(),
            found: course.found.clone(),
        };
        let file = NetworkFile {
            provenance,
            networks,
        };
        let networks = Networks::of(file, Path::new(variant.words()), built)?.settled();
        Ok(Some(Taught { networks }))
    }
}
