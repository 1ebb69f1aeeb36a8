//! Progress of a diagnosis, its first answer, and the request to end it early.

use model_export::stop;
use std::cell::Cell;

use crate::diagnose::candidates::ScreenedEffect;

/// Share of the selection that the base fit takes.
const BASE: f64 = 0.1;
/// Time of the work on all rows in times of the selection, for each row of its sample.
const ALL_ROWS: f64 = 0.1;

/// A candidate of the first screening.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstCandidate {
    pub effect: String,
    /// Reduction of the held-out squared error by the linearised model, as a fraction.
    pub gain: f64,
}

type OnStage<'a> = Box<dyn Fn(&str, f64) + 'a>;
type OnScreening<'a> = Box<dyn Fn(&[FirstCandidate]) + 'a>;

/// What a diagnosis reports while it runs, and asks.
pub struct Observer<'a> {
    /// Receives the stage of the work and the estimated share that is done.
    on_stage: OnStage<'a>,
    /// Receives the significant candidates of the first screening, best first.
    on_screening: OnScreening<'a>,
    /// Whether to end with what is known.
    is_stopped: Box<dyn Fn() -> bool + 'a>,
    /// Share of the present part of the work that is done at the end of the present stage.
    share: Cell<f64>,
    /// Where the present part begins and ends, as shares of the whole.
    part: Cell<[f64; 2]>,
    was_stopped: Cell<bool>,
}

impl Default for Observer<'_> {
    fn default() -> Self {
        Self::new(|_, _| (), |_| (), || false)
    }
}

impl<'a> Observer<'a> {
    /// From the receivers of stage and share, of the first candidates, and the request to stop.
    pub fn new(
        on_stage: impl Fn(&str, f64) + 'a,
        on_screening: impl Fn(&[FirstCandidate]) + 'a,
        is_stopped: impl Fn() -> bool + 'a,
    ) -> Self {
        Self {
            on_stage: Box::new(on_stage),
            on_screening: Box::new(on_screening),
            is_stopped: Box::new(is_stopped),
            share: Cell::new(0.0),
            part: Cell::new([0.0, 1.0]),
            was_stopped: Cell::new(false),
        }
    }

    /// Begins a stage that takes this fraction of what remains of the present part: how many stages follow is unknown.
    pub(super) fn stage(&self, name: &str, fraction: f64) {
        let ([from, to], share) = (self.part.get(), self.share.get());
        (self.on_stage)(name, from + share * (to - from));
        self.share.set(share + fraction * (1.0 - share));
    }

    /// Begins with the fit of the base.
    pub(super) fn begin(&self) {
        self.stage("fitting the model", BASE);
    }

    /// The part that has begun is a selection on a sample of one in `ratio` rows; work on all rows follows.
    pub(super) fn select_on_sample(&self, ratio: f64) {
        self.part.set([0.0, 1.0 / (1.0 + ALL_ROWS * ratio)]);
    }

    /// The rest of the work begins.
    pub(super) fn begin_rest(&self) {
        self.part.set([self.part.get()[1], 1.0]);
        self.share.set(0.0);
    }

    /// Reports the significant candidates.
    pub(super) fn screened(&self, screened: &[ScreenedEffect]) {
        let significant = screened.iter().filter(|one| one.is_significant());
        let first = significant.map(|one| FirstCandidate {
            effect: one.candidate.name().to_owned(),
            gain: one.evidence.gain(),
        });
        (self.on_screening)(&first.collect::<Vec<_>>());
    }

    /// Whether to end with what is known.
    pub(super) fn is_stopped(&self) -> bool {
        stop::check();
        if (self.is_stopped)() {
            self.was_stopped.set(true);
        }
        self.was_stopped.get()
    }

    /// Whether the diagnosis ended early.
    pub(super) fn was_stopped(&self) -> bool {
        self.was_stopped.get()
    }
}
