//! What is hidden, how it is recorded, and what must be output of it.

use std::ops::Range;

/// Cases that are counted together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// One effect of the catalogue at its typical size.
    Typical,
    /// The same at 0.3 of it.
    Small,
    /// Nothing is hidden, under three kinds of noise.
    Nothing,
    /// Two effects that share no covariate.
    Pairs,
    /// What no catalogue holds.
    Outside,
    /// Recordings that cannot tell, where one answer is right every time.
    Always,
}

impl Group {
    /// All, in the order of the table.
    pub const ALL: [Self; 6] =
        [Self::Typical, Self::Small, Self::Nothing, Self::Pairs, Self::Outside, Self::Always];

    /// Name on the command line.
    pub fn id(self) -> &'static str {
        match self {
            Self::Typical => "typical",
            Self::Small => "small",
            Self::Nothing => "nothing",
            Self::Pairs => "pairs",
            Self::Outside => "outside",
            Self::Always => "always",
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
            Self::Outside => 5,
            Self::Always => 1,
        }
    }
}

/// One campaign, and what is expected of its diagnosis.
#[derive(Clone, Debug)]
pub struct Case {
    /// Effects with the factor on their typical sizes.
    pub hidden: Vec<(&'static str, f64)>,
    /// What is done to the gripper.
    pub programme: &'static str,
    /// Additional noise.
    pub noise: &'static str,
    /// Seed of the campaign.
    pub seed: u64,
    /// What must be output.
    pub expected: Expected,
}

/// What must be output of a campaign.
#[derive(Clone, Debug)]
pub enum Expected {
    /// Every hidden effect, alone or tied, and nothing else.
    Names,
    /// No name; where a covariate is given, that it is followed.
    NoName(Option<&'static str>),
    /// One of these verdicts on this effect, and no wrong name.
    Verdict(&'static str, &'static [&'static str]),
}

impl Case {
    fn new(hidden: &[(&'static str, f64)], seed: u64, expected: Expected) -> Self {
        Self { hidden: hidden.to_vec(), programme: "bench", noise: "white", seed, expected }
    }

    /// True where this is hidden in it.
    pub fn hides(&self, effect: &str) -> bool {
        self.hidden.iter().any(|(id, _)| *id == effect)
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
            [("screw_ripple", Some("motor_angle_rad")), ("cross_term", None), ("unlogged", None)]
                .map(|(id, follows)| Case::new(&[(id, 1.0)], seed, Expected::NoName(follows)))
                .to_vec()
        }
        Group::Always => always(seed),
    }
}

fn pairs(seed: u64) -> Vec<Case> {
    let mut cases = Vec::new();
    for (i, one) in KINDS.iter().enumerate() {
        for other in &KINDS[i + 1..] {
            // Both remember the force.
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
