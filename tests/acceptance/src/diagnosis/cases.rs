//! Simulated effects of every campaign, its excitation and its expected diagnosis.

use std::ops::Range;

use sim::effects::{EFFECT_KINDS, EffectKind};

/// Cases with a common rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Group {
    /// One effect of the catalogue with its typical magnitude.
    Typical,
    /// One effect with 0.3 of its typical magnitude.
    Small,
    /// No effect, with three kinds of noise.
    Nothing,
    /// Two effects that share no covariate.
    Pairs,
    /// Effects that are not in the catalogue.
    Outside,
    /// Inconclusive recordings, which must be reported as such.
    Always,
    /// The same with the recording that the diagnosis proposes.
    Planned,
}

impl Group {
    /// All, in the order of the table.
    pub const ALL: [Self; 7] = [
        Self::Typical,
        Self::Small,
        Self::Nothing,
        Self::Pairs,
        Self::Outside,
        Self::Always,
        Self::Planned,
    ];

    /// Description in the table.
    pub fn description(self) -> &'static str {
        match self {
            Self::Typical => "one effect of typical magnitude",
            Self::Small => "one effect of 0.3 of its typical magnitude",
            Self::Nothing => "none; white noise, correlated noise, a random walk",
            Self::Pairs => "two effects without a common covariate",
            Self::Outside => "one that is not in the catalogue",
            Self::Always => "inconclusive recordings",
            Self::Planned => "inconclusive recordings and the proposed one",
        }
    }

    /// Campaigns of each kind.
    pub fn seeds(self) -> u64 {
        match self {
            Self::Typical => 3,
            Self::Small => 2,
            // Under each of three noises.
            Self::Nothing => 67,
            Self::Pairs => 1,
            Self::Outside => 3,
            Self::Always => 1,
            Self::Planned => 3,
        }
    }
}

/// One campaign, and what is expected of its diagnosis.
#[derive(Clone, Debug)]
pub struct Case {
    /// Simulated effects, each with a factor on its typical magnitude.
    pub hidden: Vec<(&'static str, f64)>,
    /// Excitation.
    pub programme: &'static str,
    /// Additional noise.
    pub noise: &'static str,
    /// Seed of the campaign.
    pub seed: u64,
    /// Expected diagnosis.
    pub expected: Expected,
}

/// Expected diagnosis of a campaign.
#[derive(Clone, Debug)]
pub enum Expected {
    /// Every simulated effect, alone or among equivalent ones, and no other.
    Names,
    /// No effect; the residual is attributed to the covariate, if one is given.
    NoName(Option<&'static str>),
    /// No effect; formulas of exactly these recorded columns.
    Formula(&'static [&'static str]),
    /// One of these verdicts on this effect, and no wrong effect.
    Verdict(&'static str, &'static [&'static str]),
    /// Each predicted decision is right, together with the recording that the diagnosis of the others proposes.
    PredictedDecisions,
}

impl Case {
    fn new(hidden: &[(&'static str, f64)], seed: u64, expected: Expected) -> Self {
        Self { hidden: hidden.to_vec(), programme: "bench", noise: "white", seed, expected }
    }

    /// Whether this effect is simulated. Backlash shows in the field of the magnet whose opening it is.
    pub fn hides(&self, effect: &str) -> bool {
        let is_needed = |id: &str| id == "screw_backlash" && effect == "neighbour_magnet";
        self.hidden.iter().any(|(id, _)| *id == effect || is_needed(id))
    }
}

/// Effects of the catalogue with a covariate in the format. (Backlash is only observable with the magnet
/// whose opening it is.)
const SINGLE: [&str; 22] = [
    "geometric_stiffening",
    "tip_slope",
    "cross_coupling",
    "hard_stop",
    "hysteresis",
    "viscous_lag",
    "creep",
    "softening",
    "fingertip_mass",
    "neighbour_magnet",
    "motor_leakage",
    "earth_field",
    "external_magnet",
    "magnet_temperature",
    "sensor_temperature",
    "thermal_gap",
    "demagnetisation",
    "field_drift",
    "sensor_compression",
    "clock_skew",
    "reference_filter",
    "reference_drift",
];

/// One effect for each covariate: effects that share one are not combined in pairs.
const KINDS: [&str; 8] = [
    "hysteresis",
    "geometric_stiffening",
    "neighbour_magnet",
    "motor_leakage",
    "earth_field",
    "magnet_temperature",
    "cross_coupling",
    "creep",
];

/// Effects outside the catalogue of which no name is expected, and the covariate that the residual follows.
const UNNAMED: [(&str, Option<&str>); 3] =
    [("screw_ripple", Some("motor_angle_rad")), ("cross_term", None), ("unlogged", None)];

/// Effects outside the catalogue that a formula of recorded columns represents: all others.
pub fn formulas() -> impl Iterator<Item = &'static EffectKind> {
    let is_unnamed = |kind: &&EffectKind| UNNAMED.iter().any(|(id, _)| *id == kind.id);
    EFFECT_KINDS.iter().filter(move |kind| !kind.is_in_catalogue && !is_unnamed(kind))
}

/// The cases of a group.
pub fn of(group: Group, seeds: Range<u64>) -> Vec<Case> {
    seeds.flat_map(|seed| with_seed(group, seed)).collect()
}

fn with_seed(group: Group, seed: u64) -> Vec<Case> {
    let single = |factor: f64| {
        let case = move |id: &&'static str| Case::new(&[(*id, factor)], seed, Expected::Names);
        SINGLE.iter().map(case).collect()
    };
    match group {
        Group::Typical => single(1.0),
        Group::Small => single(0.3),
        Group::Nothing => ["white", "ar1", "walk"]
            .map(|noise| Case { noise, ..Case::new(&[], seed, Expected::NoName(None)) })
            .to_vec(),
        Group::Pairs => pairs(seed),
        Group::Outside => {
            let case = |id, expected| Case::new(&[(id, 1.0)], seed, expected);
            let unnamed = UNNAMED.map(|(id, follows)| case(id, Expected::NoName(follows)));
            let formulas = formulas().map(|kind| case(kind.id, Expected::Formula(kind.covariates)));
            unnamed.into_iter().chain(formulas).collect()
        }
        Group::Always => always(seed),
        Group::Planned => always(seed)
            .into_iter()
            .map(|case| Case { expected: Expected::PredictedDecisions, ..case })
            .collect(),
    }
}

fn pairs(seed: u64) -> Vec<Case> {
    let mut cases = Vec::new();
    for (i, one) in KINDS.iter().enumerate() {
        for other in &KINDS[i + 1..] {
            // Both depend on the force history.
            if (*one, *other) != ("hysteresis", "creep") {
                let hidden = [(*one, 1.0), (*other, 1.0)];
                cases.push(Case::new(&hidden, seed, Expected::Names));
            }
        }
    }
    cases
}

fn always(seed: u64) -> Vec<Case> {
    const OPEN: &[&str] = &["tied", "shadow"];
    const NOT: &[&str] = &["not_judgeable"];
    let expected = |programme, hidden, message| Case {
        programme,
        ..Case::new(&[(hidden, 1.0)], seed, Expected::Verdict(hidden, message))
    };
    vec![
        expected("still", "neighbour_magnet", NOT),
        expected("still", "screw_backlash", NOT),
        expected("level", "earth_field", NOT),
        expected("isothermal", "magnet_temperature", NOT),
        expected("isothermal", "thermal_gap", NOT),
        expected("same-warm-up", "magnet_temperature", &["tied"]),
        expected("same-warm-up", "sensor_temperature", &["tied"]),
        expected("single-sine", "clock_skew", OPEN),
        expected("single-sine", "viscous_lag", OPEN),
        expected("single-sine", "hysteresis", OPEN),
    ]
}
