//! Simulated effects: units and valid magnitudes, selection, variation between sensors.

use crate::random::{Purpose, stream, uniform};
use anyhow::{Context, Result, bail};
use model_export::effects::catalogue::{HYSTERESIS, NEIGHBOUR_MAGNET, SCREW_BACKLASH};
use model_export::effects::{CATALOGUE, Simulation, find};
use model_export::error::closest_match;
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::LazyLock;

mod kind;
pub mod uncatalogued_kinds;

pub use kind::EffectKind;
use kind::VARIATION;

/// Limit of the variation: no sensor loses an effect, and none has it with the opposite sign.
const MAX_VARIATION: f64 = 0.8;

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
        if flexures.is_some() && kind.id != HYSTERESIS.id {
            bail!("{id} takes no flexure; remove the part after the colon");
        }
        let size = match size {
            Some(size) => size.parse().with_context(|| {
                format!("invalid magnitude {size:?}; use {id}={} for example", kind.typical)
            })?,
            None => kind.typical,
        };
        let (min, max) = kind.magnitude.range;
        if !(min..=max).contains(&size) {
            bail!("{id}={size} is out of range; valid are {min} to {max} {}", kind.unit);
        }
        Ok(Self { flexures: flexures.unwrap_or(Flexures::Lateral), ..Self::new(kind, size) })
    }
}

fn unknown(id: &str) -> anyhow::Error {
    let ids: Vec<&str> = EFFECT_KINDS.iter().map(|kind| kind.id).collect();
    let hint = closest_match(id, ids.iter().copied())
        .map_or_else(String::new, |near| format!("did you mean {near}? "));
    let (catalogue, others): (Vec<&str>, Vec<&str>) =
        ids.into_iter().partition(|id| find(id).is_ok());
    anyhow::anyhow!(
        "unknown effect {id:?}; {hint}available effects: {}; beyond the catalogue: {}",
        catalogue.join(", "),
        others.join(", ")
    )
}

/// Maximum factor on random effects: beyond it all have their maximum.
pub const MAX_STRENGTH: f64 = 100.0;

/// Draws `count` different effects near their typical magnitude times `strength`.
///
/// Each effect has a stream of its own: another effect in the catalogue changes what a seed draws only where it is drawn.
pub fn draw_random_effects(seed: u64, count: usize, strength: f64) -> Result<Vec<Effect>> {
    let drawn = |kind: &'static EffectKind| {
        let mut rng = stream(seed, Purpose::RandomEffects, kind.magnitude.random_stream);
        (uniform(&mut rng, 0.0, 1.0), kind, rng)
    };
    let mut kinds: Vec<_> =
        EFFECT_KINDS.iter().filter(|kind| kind.is_in_catalogue).map(drawn).collect();
    if count > kinds.len() {
        bail!("only {} effects can be drawn at random", kinds.len());
    }
    kinds.sort_by(|(a, ..), (b, ..)| a.total_cmp(b));
    let mut effects = Vec::new();
    for (_, kind, mut rng) in kinds.into_iter().take(count) {
        let size = kind.typical * strength * uniform(&mut rng, RANDOM_RANGE[0], RANDOM_RANGE[1]);
        let (min, max) = kind.magnitude.range;
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
        if has(&effects, SCREW_BACKLASH.id)
            && !has(&effects, NEIGHBOUR_MAGNET.id)
            && let Some(kind) = find_kind(NEIGHBOUR_MAGNET.id)
        {
            effects.push(Effect::new(kind, NEIGHBOUR_FOR_BACKLASH * kind.typical));
            needed_by = Some(SCREW_BACKLASH.id);
        }
        let mut chosen = Vec::new();
        for kind in EFFECT_KINDS.iter() {
            let mut same = effects.iter().filter(|effect| effect.kind == kind);
            let Some(effect) = same.next() else { continue };
            if same.next().is_some() {
                bail!("{} is given twice", kind.id);
            }
            let variation = if kind.magnitude.shared { 0.0 } else { kind.variation * scatter };
            let variation = variation.min(MAX_VARIATION);
            let shares = each(seed, kind.magnitude.random_stream, sensors, variation);
            chosen.push(AssignedEffect {
                each: shares.iter().map(|share| share * effect.size).collect(),
                effect: effect.clone(),
                needed_by: needed_by.filter(|_| kind.id == NEIGHBOUR_MAGNET.id),
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
        let size = self.each(HYSTERESIS.id, sensor);
        match self.of(HYSTERESIS.id).map(|chosen| chosen.effect.flexures) {
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

/// All simulated effects in the order of their random streams: those of the catalogue, and those outside of it.
pub static EFFECT_KINDS: LazyLock<Vec<EffectKind>> = LazyLock::new(|| {
    let simulated = CATALOGUE.into_iter().filter_map(|effect| match effect.simulation {
        Simulation::Magnitude(magnitude) => Some(EffectKind {
            id: effect.id,
            typical: effect.size.typical,
            unit: effect.size.unit,
            magnitude,
            variation: VARIATION,
            is_in_catalogue: true,
            equation: effect.equation,
            covariates: &[],
        }),
        Simulation::Never(_) => None,
    });
    let mut kinds: Vec<EffectKind> = simulated.chain(uncatalogued_kinds::KINDS).collect();
    kinds.sort_by_key(|kind| kind.magnitude.random_stream);
    kinds
});

/// The effect with this identifier.
pub fn find_kind(id: &str) -> Option<&'static EffectKind> {
    EFFECT_KINDS.iter().find(|kind| kind.id == id)
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
    fn typical_magnitudes_are_valid_and_streams_are_unique() {
        let streams = EFFECT_KINDS.iter().map(|kind| kind.magnitude.random_stream);
        let next = streams.max().map_or(0, |last| last + 1);
        for (i, kind) in EFFECT_KINDS.iter().enumerate() {
            let (min, max) = kind.magnitude.range;
            assert!((min..=max).contains(&kind.typical), "{}", kind.id);
            let stream = kind.magnitude.random_stream;
            let same =
                EFFECT_KINDS[..i].iter().any(|other| other.magnitude.random_stream == stream);
            assert!(!same, "random_stream {stream} of {} is in use; {next} is free", kind.id);
        }
    }

    #[test]
    fn every_definition_fits_its_help_line() {
        assert!(EFFECT_KINDS.iter().all(|kind| kind.magnitude.meaning.len() <= 62));
    }
}
