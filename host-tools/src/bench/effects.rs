//! Which effects a campaign has, how large each is, and how it differs from sensor to sensor.

use std::str::FromStr;

use anyhow::{Context, Result, bail};
use model_export::recordings::problem::closest;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use super::draw::{Purpose, between, stream};
use super::sizes::{SIZES, Size, size_of};

/// Share by which sensors differ in the size of an effect that is not a material's.
const SPREAD: f64 = 0.1;

/// Hidden sizes lie between these multiples of typical size and strength.
const HIDDEN: [f64; 2] = [0.8, 1.25];

/// Typical neighbours are too weak to make a play of the screw visible.
const NEIGHBOUR_FOR_BACKLASH: f64 = 3.0;

/// Time constants that are not drawn.
const CREEP_S: f64 = 10.0;
const SOFTENING_CYCLES: f64 = 8.0;

/// The flexures on which friction acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Flexures {
    /// The grasping one.
    Lateral,
    /// That of the ground reaction.
    Longitudinal,
    /// Both, with the same friction.
    Both,
}

/// One effect, as it was asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// What it is.
    pub kind: &'static Size,
    /// Its size in the kind's unit.
    pub size: f64,
    /// Where friction acts; of no meaning elsewhere.
    pub flexures: Flexures,
}

impl Effect {
    fn new(kind: &'static Size, size: f64) -> Self {
        Self {
            kind,
            size,
            flexures: Flexures::Lateral,
        }
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
                bail!("{other:?} is no flexure; write lateral, longitudinal or both")
            }
            None => (text, None),
        };
        let (id, size) = match text.split_once('=') {
            Some((id, size)) => (id, Some(size)),
            None => (text, None),
        };
        let kind = size_of(id).ok_or_else(|| unknown(id))?;
        if flexures.is_some() && kind.id != "hysteresis" {
            bail!("{id} acts on no flexure of its own; leave out what follows the colon");
        }
        let size = match size {
            Some(size) => size.parse().with_context(|| {
                format!(
                    "{size:?} is no size; write {id}={} for example",
                    kind.typical()
                )
            })?,
            None => kind.typical(),
        };
        if !kind.possible.contains(&size) {
            let (least, most) = (kind.possible.start(), kind.possible.end());
            bail!(
                "{id}={size} is not possible here; give {least} to {most} {}",
                kind.unit()
            );
        }
        Ok(Self {
            flexures: flexures.unwrap_or(Flexures::Lateral),
            ..Self::new(kind, size)
        })
    }
}

fn unknown(id: &str) -> anyhow::Error {
    let ids: Vec<&str> = SIZES.iter().map(|size| size.id).collect();
    let hint = closest(id, ids.iter().copied())
        .map_or_else(String::new, |near| format!("did you mean {near}? "));
    anyhow::anyhow!(
        "{id:?} is not known; {hint}The effects are {}",
        ids.join(", ")
    )
}

/// Draws `count` different effects, each near its typical size times `strength`.
pub fn hide(seed: u64, count: usize, strength: f64) -> Result<Vec<Effect>> {
    let mut rng = stream(seed, Purpose::Hiding, 0);
    let mut kinds: Vec<&'static Size> = SIZES.iter().filter(|size| size.hidden).collect();
    if count > kinds.len() {
        bail!("only {} effects can be hidden; ask for fewer", kinds.len());
    }
    kinds.shuffle(&mut rng);
    let mut effects = Vec::new();
    for kind in kinds.into_iter().take(count) {
        let size = kind.typical() * strength * between(&mut rng, HIDDEN[0], HIDDEN[1]);
        let (least, most) = (*kind.possible.start(), *kind.possible.end());
        let flexures = match between(&mut rng, 0.0, 3.0) {
            u if u < 1.0 => Flexures::Lateral,
            u if u < 2.0 => Flexures::Longitudinal,
            _ => Flexures::Both,
        };
        effects.push(Effect {
            flexures,
            ..Effect::new(kind, size.clamp(least, most))
        });
    }
    Ok(effects)
}

/// All effects of a campaign, each with its size in every sensor. What is absent has size zero,
/// which is how the bench's physics leave it out.
#[derive(Clone, Debug, PartialEq)]
pub struct Effects {
    /// In the order of the table of sizes.
    pub chosen: Vec<Chosen>,
    /// Time constant of creep in seconds.
    pub creep_s: f64,
    /// Load cycles in which 63 % of the softening come.
    pub softening_cycles: f64,
}

/// An effect with its size in every sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// As it was asked for.
    pub effect: Effect,
    /// Sizes in the sensors; their mean is the effect's size.
    pub each: Vec<f64>,
    /// The effect that needs this one, where it was not asked for itself.
    pub needed_by: Option<&'static str>,
}

impl Effects {
    /// Spreads the effects over the sensors; `scatter` scales how much these differ.
    pub fn new(effects: &[Effect], seed: u64, sensors: u32, scatter: f64) -> Result<Self> {
        let mut effects = effects.to_vec();
        let mut needed_by = None;
        let has = |effects: &[Effect], id: &str| effects.iter().any(|e| e.kind.id == id);
        if has(&effects, "screw_backlash")
            && !has(&effects, "neighbour_magnet")
            && let Some(kind) = size_of("neighbour_magnet")
        {
            effects.push(Effect::new(kind, NEIGHBOUR_FOR_BACKLASH * kind.typical()));
            needed_by = Some("screw_backlash");
        }
        let mut chosen = Vec::new();
        for (number, kind) in (0..).zip(SIZES) {
            let mut same = effects.iter().filter(|effect| effect.kind == kind);
            let Some(effect) = same.next() else { continue };
            if same.next().is_some() {
                bail!("{} is asked for twice; keep one", kind.id);
            }
            let spread = if kind.shared { 0.0 } else { SPREAD * scatter };
            chosen.push(Chosen {
                each: each(seed, number, sensors, spread)
                    .iter()
                    .map(|share| share * effect.size)
                    .collect(),
                effect: effect.clone(),
                needed_by: needed_by.filter(|_| kind.id == "neighbour_magnet"),
            });
        }
        Ok(Self {
            chosen,
            creep_s: CREEP_S,
            softening_cycles: SOFTENING_CYCLES,
        })
    }

    /// The same with time constants that nobody was told.
    pub fn with_hidden_times(self, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::TimeConstants, 0);
        Self {
            creep_s: between(&mut rng, 4.0, 20.0),
            softening_cycles: between(&mut rng, 4.0, 15.0),
            ..self
        }
    }

    fn of(&self, id: &str) -> Option<&Chosen> {
        self.chosen
            .iter()
            .find(|chosen| chosen.effect.kind.id == id)
    }

    /// Size of an effect, 0 where the campaign does not have it.
    pub fn size(&self, id: &str) -> f64 {
        self.of(id).map_or(0.0, |chosen| chosen.effect.size)
    }

    /// Its size in one sensor.
    pub fn each(&self, id: &str, sensor: u32) -> f64 {
        let size = |chosen: &Chosen| chosen.each.get(sensor as usize).copied();
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

/// Factors of mean 1, one for each sensor.
fn each(seed: u64, number: u32, sensors: u32, spread: f64) -> Vec<f64> {
    let mut rng = stream(seed, Purpose::Sizes, number);
    let raw: Vec<f64> = (0..sensors)
        .map(|_| between(&mut rng, 1.0 - spread, 1.0 + spread))
        .collect();
    let mean = raw.iter().sum::<f64>() / raw.len() as f64;
    raw.iter().map(|factor| factor / mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(text: &str) -> String {
        text.parse::<Effect>().unwrap_err().to_string()
    }

    #[test]
    fn an_effect_is_read_with_its_size_and_its_flexures() {
        let effect: Effect = "hysteresis=1.5:both".parse().unwrap();
        assert_eq!((effect.size, effect.flexures), (1.5, Flexures::Both));
        assert_eq!("earth_field".parse::<Effect>().unwrap().size, 0.48);
    }

    #[test]
    fn a_misspelt_effect_is_told_its_neighbour_and_the_list() {
        let said = sentence("crep");
        assert!(said.contains("did you mean creep?") && said.contains("earth_field"));
    }

    #[test]
    fn an_impossible_size_is_told_what_is_possible() {
        assert!(sentence("hard_stop=120").ends_with("give 0 to 95 %"));
        assert!(sentence("creep=much").contains("write creep=2"));
        assert!(sentence("creep=NaN").contains("not possible"));
        assert!(sentence("creep=2:both").contains("no flexure of its own"));
    }

    #[test]
    fn sensors_differ_by_a_tenth_and_their_mean_is_the_size() {
        let effects = Effects::new(&["creep=4".parse().unwrap()], 3, 4, 1.0).unwrap();
        let each = &effects.chosen[0].each;
        assert!((each.iter().sum::<f64>() / 4.0 - 4.0).abs() < 1e-12);
        assert!(each.iter().all(|size| (size / 4.0 - 1.0).abs() < 0.25) && each[0] != each[1]);
        assert_eq!(effects.size("softening"), 0.0);
    }

    #[test]
    fn a_material_is_the_same_everywhere_and_backlash_brings_a_neighbour() {
        let wanted = ["screw_backlash", "magnet_temperature"].map(|id| id.parse().unwrap());
        let effects = Effects::new(&wanted, 3, 4, 1.0).unwrap();
        assert!((0..4).all(|sensor| effects.each("magnet_temperature", sensor) == -0.11));
        assert!((effects.size("neighbour_magnet") - 6.0).abs() < 1e-12);
    }

    #[test]
    fn hidden_effects_are_different_ones_and_depend_on_the_seed() {
        let ids = |seed| -> Vec<&str> {
            let hidden = hide(seed, 4, 1.0).unwrap();
            hidden.iter().map(|effect| effect.kind.id).collect()
        };
        let mut first = ids(1);
        assert!(first == ids(1) && (2..5).any(|seed| ids(seed) != first));
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), 4);
    }
}
