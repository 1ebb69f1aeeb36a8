//! Simulated effects: units and valid magnitudes, selection, variation between sensors.

use crate::random::{Purpose, stream, uniform};
use anyhow::{Context, Result, bail};
use model_export::effects::find;
use model_export::recordings::error::closest_match;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Relative variation between sensors of effects that are not a material property.
const VARIATION: f64 = 0.1;

/// Range of random magnitudes, as multiples of the typical one.
const RANDOM_RANGE: [f64; 2] = [0.8, 1.25];

/// Factor on a typical neighbour magnet; weaker ones do not reveal backlash.
const NEIGHBOUR_FOR_BACKLASH: f64 = 3.0;

/// Default time constants.
const CREEP_S: f64 = 10.0;
const SOFTENING_CYCLES: f64 = 8.0;

/// The flexures on which friction acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Flexures {
    /// Direction of the grasp.
    Lateral,
    /// Direction of the ground reaction.
    Longitudinal,
    /// Both, with the same friction.
    Both,
}

/// One effect with its magnitude.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Kind of the effect.
    pub kind: &'static EffectKind,
    /// Magnitude in the kind's unit.
    pub size: f64,
    /// Flexures with friction; unused by other effects.
    pub flexures: Flexures,
}

impl Effect {
    fn new(kind: &'static EffectKind, size: f64) -> Self {
        Self { kind, size, flexures: Flexures::Lateral }
    }
}

impl FromStr for Effect {
    type Err = anyhow::Error;

    /// Reads `ID`, `ID=SIZE`, and for friction `hysteresis=SIZE:FLEXURES`.
    fn from_str(text: &str) -> Result<Self> {
        let (text, flexures) = match text.rsplit_once(':') {
            Some((text, "lateral")) => (text, Some(Flexures::Lateral)),
            Some((text, "longitudinal")) => (text, Some(Flexures::Longitudinal)),
            Some((text, "both")) => (text, Some(Flexures::Both)),
            Some((_, other)) => {
                bail!("unknown flexure {other:?}; use lateral, longitudinal or both")
            }
            None => (text, None),
        };
        let (id, size) = match text.split_once('=') {
            Some((id, size)) => (id, Some(size)),
            None => (text, None),
        };
        let kind = find_kind(id).ok_or_else(|| unknown(id))?;
        if flexures.is_some() && kind.id != "hysteresis" {
            bail!("{id} takes no flexure; remove the part after the colon");
        }
        let size = match size {
            Some(size) => size.parse().with_context(|| {
                format!("invalid magnitude {size:?}; use {id}={} for example", kind.typical())
            })?,
            None => kind.typical(),
        };
        if !kind.possible.contains(&size) {
            let (min, max) = (kind.possible.start(), kind.possible.end());
            bail!("{id}={size} is out of range; valid are {min} to {max} {}", kind.unit());
        }
        Ok(Self { flexures: flexures.unwrap_or(Flexures::Lateral), ..Self::new(kind, size) })
    }
}

fn unknown(id: &str) -> anyhow::Error {
    let ids: Vec<&str> = EFFECT_KINDS.iter().map(|size| size.id).collect();
    let hint = closest_match(id, ids.iter().copied())
        .map_or_else(String::new, |near| format!("did you mean {near}? "));
    anyhow::anyhow!("unknown effect {id:?}; {hint}available effects: {}", ids.join(", "))
}

/// Draws `count` different effects near their typical magnitude times `strength`.
pub fn draw_random_effects(seed: u64, count: usize, strength: f64) -> Result<Vec<Effect>> {
    let mut rng = stream(seed, Purpose::RandomEffects, 0);
    let mut kinds: Vec<&'static EffectKind> =
        EFFECT_KINDS.iter().filter(|size| size.hidden).collect();
    if count > kinds.len() {
        bail!("only {} effects can be drawn at random", kinds.len());
    }
    kinds.shuffle(&mut rng);
    let mut effects = Vec::new();
    for kind in kinds.into_iter().take(count) {
        let size = kind.typical() * strength * uniform(&mut rng, RANDOM_RANGE[0], RANDOM_RANGE[1]);
        let (min, max) = (*kind.possible.start(), *kind.possible.end());
        let flexures = match uniform(&mut rng, 0.0, 3.0) {
            u if u < 1.0 => Flexures::Lateral,
            u if u < 2.0 => Flexures::Longitudinal,
            _ => Flexures::Both,
        };
        effects.push(Effect { flexures, ..Effect::new(kind, size.clamp(min, max)) });
    }
    Ok(effects)
}

/// Effects of a campaign with their magnitude in every sensor. Absent effects have magnitude zero,
/// which removes their physics.
#[derive(Clone, Debug, PartialEq)]
pub struct Effects {
    /// In the order of the table of sizes.
    pub chosen: Vec<AssignedEffect>,
    /// Time constant of creep in seconds.
    pub creep_s: f64,
    /// Load cycles for 63 % of the softening.
    pub softening_cycles: f64,
}

/// An effect with its magnitude in every sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct AssignedEffect {
    /// Kind and mean magnitude.
    pub effect: Effect,
    /// Magnitude in each sensor.
    pub each: Vec<f64>,
    /// Effect that requires this one, where it was added implicitly.
    pub needed_by: Option<&'static str>,
}

impl Effects {
    /// Distributes the effects over the sensors; `scatter` scales the variation between them.
    pub fn new(effects: &[Effect], seed: u64, sensors: u32, scatter: f64) -> Result<Self> {
        let mut effects = effects.to_vec();
        let mut needed_by = None;
        let has = |effects: &[Effect], id: &str| effects.iter().any(|e| e.kind.id == id);
        if has(&effects, "screw_backlash")
            && !has(&effects, "neighbour_magnet")
            && let Some(kind) = find_kind("neighbour_magnet")
        {
            effects.push(Effect::new(kind, NEIGHBOUR_FOR_BACKLASH * kind.typical()));
            needed_by = Some("screw_backlash");
        }
        let mut chosen = Vec::new();
        for (number, kind) in (0..).zip(EFFECT_KINDS) {
            let mut same = effects.iter().filter(|effect| effect.kind == kind);
            let Some(effect) = same.next() else { continue };
            if same.next().is_some() {
                bail!("{} is given twice", kind.id);
            }
            let variation = if kind.shared { 0.0 } else { VARIATION * scatter };
            chosen.push(AssignedEffect {
                each: each(seed, number, sensors, variation)
                    .iter()
                    .map(|share| share * effect.size)
                    .collect(),
                effect: effect.clone(),
                needed_by: needed_by.filter(|_| kind.id == "neighbour_magnet"),
            });
        }
        Ok(Self { chosen, creep_s: CREEP_S, softening_cycles: SOFTENING_CYCLES })
    }

    /// The same with random time constants.
    pub fn with_random_time_constants(self, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::TimeConstants, 0);
        Self {
            creep_s: uniform(&mut rng, 4.0, 20.0),
            softening_cycles: uniform(&mut rng, 4.0, 15.0),
            ..self
        }
    }

    fn of(&self, id: &str) -> Option<&AssignedEffect> {
        self.chosen.iter().find(|chosen| chosen.effect.kind.id == id)
    }

    /// Magnitude of an effect, 0 where the campaign does not have it.
    pub fn size(&self, id: &str) -> f64 {
        self.of(id).map_or(0.0, |chosen| chosen.effect.size)
    }

    /// Its magnitude in one sensor.
    pub fn each(&self, id: &str, sensor: u32) -> f64 {
        let size = |chosen: &AssignedEffect| chosen.each.get(sensor as usize).copied();
        self.of(id).and_then(size).unwrap_or(0.0)
    }

    /// Friction of the lateral and the longitudinal flexure of one sensor, in newtons.
    pub fn friction_n(&self, sensor: u32) -> [f64; 2] {
        let size = self.each("hysteresis", sensor);
        match self.of("hysteresis").map(|chosen| chosen.effect.flexures) {
            None => [0.0; 2],
            Some(Flexures::Lateral) => [size, 0.0],
            Some(Flexures::Longitudinal) => [0.0, size],
            Some(Flexures::Both) => [size; 2],
        }
    }
}

/// Variation factors with mean 1, one per sensor.
fn each(seed: u64, number: u32, sensors: u32, variation: f64) -> Vec<f64> {
    let mut rng = stream(seed, Purpose::Sizes, number);
    let raw: Vec<f64> =
        (0..sensors).map(|_| uniform(&mut rng, 1.0 - variation, 1.0 + variation)).collect();
    let mean = raw.iter().sum::<f64>() / raw.len() as f64;
    raw.iter().map(|factor| factor / mean).collect()
}

/// A kind of effect, with unit and range of its magnitude.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectKind {
    /// Identifier on the command line and in the truth file.
    pub id: &'static str,
    /// Typical magnitude and unit, for effects outside the catalogue.
    own: Option<(f64, &'static str)>,
    /// Valid range of the magnitude.
    pub possible: RangeInclusive<f64>,
    /// Definition of the magnitude.
    pub meaning: &'static str,
    /// Property of a material or of the whole gripper: equal in every sensor.
    pub shared: bool,
    /// May be drawn at random; effects outside the catalogue are simulated by name only.
    pub hidden: bool,
}

impl EffectKind {
    /// Unit of the magnitude.
    pub fn unit(&self) -> &'static str {
        match self.own {
            Some((_, unit)) => unit,
            None => find(self.id).map_or("", |effect| effect.size.unit),
        }
    }

    /// Magnitude where none is given: the catalogue's.
    pub fn typical(&self) -> f64 {
        match self.own {
            Some((typical, _)) => typical,
            None => find(self.id).map_or(0.0, |effect| effect.size.typical),
        }
    }
}

const fn size(
    id: &'static str,
    possible: RangeInclusive<f64>,
    meaning: &'static str,
) -> EffectKind {
    EffectKind { id, own: None, possible, meaning, shared: false, hidden: true }
}

const fn shared(size: EffectKind) -> EffectKind {
    EffectKind { shared: true, ..size }
}

const fn by_name_only(typical: f64, unit: &'static str, size: EffectKind) -> EffectKind {
    EffectKind { own: Some((typical, unit)), hidden: false, ..size }
}

/// All simulated effects.
#[rustfmt::skip] // One line for each effect.
pub const EFFECT_KINDS: &[EffectKind] = &[
    size("geometric_stiffening", -20.0..=100.0, "growth of both flexures' stiffness at 0.5 mm"),
    size("tip_slope", -50.0..=50.0, "foreshortening of each flexure at 0.5 mm; the magnet leans"),
    size("neighbour_magnet", -50.0..=50.0, "field of the opposite finger's magnet at an opening of 10 mm"),
    size("motor_leakage", 0.0..=50.0, "norm of the nine coefficients (axes by currents), times 10 A"),
    shared(size("earth_field", 0.0..=5.0, "norm of the world's field")),
    shared(size("magnet_temperature", -1.0..=1.0, "change of remanence from 25 C")),
    size("sensor_temperature", 0.0..=5.0, "norm of the drift of the offset from 25 C"),
    size("thermal_gap", -10.0..=10.0, "growth of the gap from 25 C"),
    size("hysteresis", 0.0..=50.0, "Coulomb friction parallel to the flexure, half the loop width"),
    size("viscous_lag", 0.0..=200.0, "retardation time, lateral; half of it longitudinally"),
    size("creep", 0.0..=50.0, "delayed compliance, as a share of the instantaneous one"),
    size("softening", -20.0..=50.0, "growth of the compliance over many load cycles"),
    shared(size("clock_skew", -100.0..=100.0, "the field is recorded later than the reference says")),
    shared(size("reference_filter", 0.0..=200.0, "time constant of the reference's own filter")),
    size("cross_coupling", -20.0..=20.0, "share of Fz that acts as Fx, and -0.4 times as much back"),
    size("hard_stop", 0.0..=95.0, "compliance lost beyond 60 % of the greatest load"),
    size("fingertip_mass", 0.0..=2.0, "mass carried by the flexures"),
    shared(size("screw_backlash", 0.0..=5.0, "full play between the reported opening and the real one")),
    size("demagnetisation", -10.0..=10.0, "loss of remanence from the first recording to the second"),
    shared(size("external_magnet", 0.0..=200.0, "peak field of an external magnet that passes once")),
    shared(size("reference_drift", -5.0..=5.0, "steady wander of the reference's lateral zero")),
    size("field_drift", 0.0..=20.0, "norm of the final shift of the field"),
    size("sensor_compression", -5.0..=10.0, "loss of gain at 1300 G"),
    by_name_only(2.0, "um", size("screw_ripple", -50.0..=50.0, "longitudinal motion of the magnet with the screw's turn")),
    by_name_only(1.0, "G", shared(size("cross_term", -50.0..=50.0, "field of current times opening: 10 A, 10 mm off the middle"))),
    by_name_only(3.0, "G", shared(size("unlogged", 0.0..=50.0, "greatest field of a disturbance that nobody records"))),
];

/// The effect with this identifier.
pub fn find_kind(id: &str) -> Option<&'static EffectKind> {
    EFFECT_KINDS.iter().find(|size| size.id == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        text.parse::<Effect>().unwrap_err().to_string()
    }

    #[test]
    fn effect_is_parsed_with_magnitude_and_flexures() {
        let effect: Effect = "hysteresis=1.5:both".parse().unwrap();
        assert_eq!((effect.size, effect.flexures), (1.5, Flexures::Both));
        assert_eq!("earth_field".parse::<Effect>().unwrap().size, 0.48);
    }

    #[test]
    fn misspelt_effect_reports_a_suggestion_and_the_list() {
        let text = message("crep");
        assert!(text.contains("did you mean creep?") && text.contains("earth_field"));
    }

    #[test]
    fn magnitude_out_of_range_reports_the_valid_range() {
        assert!(message("hard_stop=120").ends_with("valid are 0 to 95 %"));
        assert!(message("creep=much").contains("use creep=2"));
        assert!(message("creep=NaN").contains("out of range"));
        assert!(message("creep=2:both").contains("takes no flexure"));
    }

    #[test]
    fn sensors_vary_around_the_specified_mean() {
        let effects = Effects::new(&["creep=4".parse().unwrap()], 3, 4, 1.0).unwrap();
        let each = &effects.chosen[0].each;
        assert!((each.iter().sum::<f64>() / 4.0 - 4.0).abs() < 1e-12);
        assert!(each.iter().all(|size| (size / 4.0 - 1.0).abs() < 0.25) && each[0] != each[1]);
        assert_eq!(effects.size("softening"), 0.0);
    }

    #[test]
    fn backlash_adds_a_neighbour_magnet() {
        let effects = ["screw_backlash", "magnet_temperature"].map(|id| id.parse().unwrap());
        let effects = Effects::new(&effects, 3, 4, 1.0).unwrap();
        assert!((0..4).all(|sensor| effects.each("magnet_temperature", sensor) == -0.11));
        assert!((effects.size("neighbour_magnet") - 6.0).abs() < 1e-12);
    }

    #[test]
    fn random_effects_are_distinct_and_seeded() {
        let ids = |seed| -> Vec<&str> {
            let hidden = draw_random_effects(seed, 4, 1.0).unwrap();
            hidden.iter().map(|effect| effect.kind.id).collect()
        };
        let mut first = ids(1);
        assert!(first == ids(1) && (2..5).any(|seed| ids(seed) != first));
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), 4);
    }

    #[test]
    fn typical_magnitudes_are_valid_and_ids_are_unique() {
        for (i, size) in EFFECT_KINDS.iter().enumerate() {
            assert!(size.possible.contains(&size.typical()), "{}", size.id);
            assert!(EFFECT_KINDS[..i].iter().all(|other| other.id != size.id));
        }
    }

    #[test]
    fn every_effect_of_the_catalogue_can_be_simulated() {
        for effect in model_export::effects::CATALOGUE {
            assert!(find_kind(effect.id).is_some_and(|size| size.own.is_none()), "{}", effect.id);
        }
    }

    #[test]
    fn every_definition_fits_its_help_line() {
        assert!(EFFECT_KINDS.iter().all(|size| size.meaning.len() <= 62));
    }
}
