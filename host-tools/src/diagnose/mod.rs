//! Which physical effect a model lacks: evidence, ties, what cannot be judged, and what no effect
//! explains.
//!
//! - [`assemble`](mod@assemble): from a selection to verdicts.
//! - [`backward`]: what a later step made needless.
//! - [`candidates`]: what may be missing, and what these recordings cannot judge.
//! - [`compute`](mod@compute): from a model and a campaign to a diagnosis.
//! - [`contest`]: the significant candidates fitted anew, the best one added.
//! - [`excitation`]: whether the loads tell the force's history from its rate.
//! - [`kin`]: effects that can stand in for each other's form.
//! - [`left`]: what a model leaves.
//! - [`next`]: the command to type next.
//! - [`screening`]: every candidate around one fitted model.
//! - [`select`]: forward selection, one refit after the other.
//! - [`shape`]: what an effect takes away, over the covariate that it shows against.
//! - [`stage`]: a model on the way.
//! - [`ties`]: effects that explain the same, told apart.
//! - [`words`]: what terminal and report both say.
//!
//! [`Diagnosis`] is everything that is known; terminal, report and `--json` only show it.

pub mod assemble;
pub mod backward;
pub mod candidates;
pub mod compute;
pub mod contest;
pub mod excitation;
#[cfg(test)]
pub mod fixture;
pub mod kin;
pub mod left;
pub mod next;
pub mod screening;
pub mod select;
pub mod shape;
pub mod stage;
pub mod ties;
pub mod words;

use crate::compare::Finding;
pub use next::Next;
pub use shape::Shape;

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Diagnosis {
    /// The model's file.
    pub model: String,
    /// The campaign's folder.
    pub campaign: String,
    /// Mistakes of the rig; where one stops the work there is nothing else.
    pub findings: Vec<Finding>,
    /// One for each candidate, in the order in which a person would read them.
    pub verdicts: Vec<Verdict>,
    /// Steps that were accepted, each one effect or several that cannot be told apart.
    pub accepted: Vec<Vec<String>>,
    /// What no effect explains, the largest share first.
    pub unexplained: Vec<Unexplained>,
    /// True where what is left cannot be told from noise.
    pub at_floor: bool,
    /// The held-out error with every step.
    pub staircase: Vec<Stair>,
    /// What each step took away, in the order of the steps.
    pub shapes: Vec<Shape>,
    /// What to type next.
    pub next: Next,
    /// One line in words.
    pub verdict: String,
    /// Blocks of time that the bootstrap had.
    pub blocks: usize,
    /// Their length in seconds.
    pub block_s: f64,
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// What is said of one effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// It is there, and nothing else explains the same.
    Found,
    /// It, or one of those that it is tied with.
    Tied,
    /// It explains only what another explains better.
    Shadow,
    /// These recordings cannot tell.
    NotJudgeable,
    /// It is not there, beyond a bound.
    Absent,
}

impl Kind {
    /// For machines.
    pub fn id(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Tied => "tied",
            Self::Shadow => "shadow",
            Self::NotJudgeable => "not_judgeable",
            Self::Absent => "absent",
        }
    }
}

/// The verdict on one effect.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Its name.
    pub effect: String,
    /// What is said of it.
    pub kind: Kind,
    /// True where far more than noise stays unexplained: then names are provisional, and what stays
    /// keeps all others from being judged.
    pub provisional: bool,
    /// The others that explain the same.
    pub tied_with: Vec<String>,
    /// Share of the squared error left out that it took away when it was judged.
    pub gain: f64,
    /// Probability of as much by chance, over all candidates together; NaN where it was not judged.
    pub p_adjusted: f64,
    /// Its size and error bar, in `unit`; NaN where it was not fitted.
    pub value: f64,
    /// See `value`.
    pub std_error: f64,
    /// Unit of the size.
    pub unit: String,
    /// How many error bars the typical size is from nothing in these recordings.
    pub z_typical: f64,
    /// Why, in one sentence.
    pub reason: String,
    /// The same in few words, for a table; alike where the reasons are alike.
    pub short: String,
    /// What to record to know better; empty where nothing is to be known.
    pub record: String,
}

/// Structure that follows a covariate and no effect explains.
#[derive(Clone, Debug, PartialEq)]
pub struct Unexplained {
    /// The covariate.
    pub covariate: String,
    /// In words.
    pub words: String,
    /// Share of the squared residual above the floor.
    pub share: f64,
}

/// A step of the staircase.
#[derive(Clone, Debug, PartialEq)]
pub struct Stair {
    /// What was added; nothing on the first.
    pub added: Vec<String>,
    /// Held-out error over all channels, in gauss.
    pub held_out_rms_g: f64,
    /// The same as forces, in newtons; `None` without forces.
    pub held_out_rmse_n: Option<f64>,
    /// The floor, in gauss.
    pub floor_g: f64,
}
