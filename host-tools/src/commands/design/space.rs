//! Where designs are looked for, as options of a command.

use std::path::PathBuf;

use anyhow::{Result, bail};
use model_export::design::Design;
use model_export::design::beam::Support;
use model_export::design::interference::{DRAWS, Surroundings};
use model_export::design::material::{MATERIALS, Material};
use model_export::design::points::Sample;
use model_export::design::sweep::{COUNT, SIZES, Space};

/// Options of a sweep.
#[derive(Debug, clap::Args)]
pub struct SpaceArgs {
    /// Sensor, limits, tolerances and own materials are those of this design; otherwise MAGPIE's.
    #[arg(long, value_name = "DESIGN")]
    pub base: Option<PathBuf>,
    /// Designs that are judged; on a grid about so many.
    #[arg(long, value_name = "N", default_value_t = COUNT, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    pub count: u32,
    /// Which designs: sobol spreads them evenly, grid takes every combination of a few values of each size.
    #[arg(long, value_name = "SAMPLE", value_parser = parse_sample, default_value = "sobol")]
    pub sample: Sample,
    /// Another range of a size in mm: length, width and thickness of the beam, gap, diameter and height of
    /// the magnet; may be given several times.
    #[arg(long = "size", value_name = "NAME=MM..MM", value_parser = parse_size)]
    pub sizes: Vec<Size>,
    /// A material; may be given several times, otherwise all of the table.
    #[arg(long = "material", value_name = "NAME")]
    pub materials: Vec<String>,
    /// How the beams are held.
    #[arg(long, value_parser = parse_support, default_value = "clamped-free", value_name = "SUPPORT")]
    pub support: Support,
    /// Motion at which a stop takes over.
    #[arg(long, value_name = "MM")]
    pub stroke: Option<f64>,
    /// Reversed cycles of the full range.
    #[arg(long, value_name = "CYCLES")]
    pub life: Option<f64>,
    /// Stress that the material bears by the stress that is allowed.
    #[arg(long, value_name = "FACTOR")]
    pub safety: Option<f64>,
    /// Seed of the draws of misalignment: the same seed, the same numbers.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// A size and its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    place: usize,
    range_mm: [f64; 2],
}

impl SpaceArgs {
    /// What the space does not say.
    pub fn base(&self) -> Result<Design> {
        let mut base = match &self.base {
            Some(path) => Design::read(path)?,
            None => Design::magpie(),
        };
        let options = [
            ("--stroke", self.stroke),
            ("--life", self.life),
            ("--safety", self.safety),
        ];
        for (option, value) in options {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
                bail!("{option} {value} is not possible here; give a number above zero");
            }
        }
        let limits = &mut base.limits;
        limits.stroke_mm = self.stroke.unwrap_or(limits.stroke_mm);
        limits.life_cycles = self.life.unwrap_or(limits.life_cycles);
        limits.safety = self.safety.unwrap_or(limits.safety);
        Ok(base)
    }

    /// The space.
    pub fn space(&self, base: &Design) -> Result<Space> {
        let mut space = Space {
            support: self.support,
            sample: self.sample,
            ..Space::default()
        };
        for size in &self.sizes {
            space.sizes_mm[size.place] = size.range_mm;
        }
        if !self.materials.is_empty() {
            space.materials.clone_from(&self.materials);
        }
        for name in &space.materials {
            if Material::named(name).is_none() && !base.material.contains_key(name) {
                let known = MATERIALS.map(|material| material.name).join(", ");
                bail!(
                    "--material {name:?} is not known; take one of {known}, or describe it in --base under [material.NAME]"
                );
            }
        }
        Ok(space)
    }

    /// What is around a sensor.
    pub fn around(&self) -> Surroundings {
        Surroundings::assumed(self.seed, DRAWS)
    }
}

fn parse_size(text: &str) -> Result<Size, String> {
    let names = || SIZES.join(", ");
    let (name, range) = text
        .split_once('=')
        .ok_or("write it as NAME=MM..MM, for example gap=1.5..3")?;
    let place = SIZES
        .iter()
        .position(|size| *size == name)
        .ok_or_else(|| format!("{name:?} is no size; take one of {}", names()))?;
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let range_mm = match range.split_once("..") {
        Some((least, most)) => [number(least), number(most)],
        None => [number(range); 2],
    };
    match range_mm {
        [Some(least), Some(most)] if least > 0.0 && most >= least && most.is_finite() => Ok(Size {
            place,
            range_mm: [least, most],
        }),
        _ => Err(format!(
            "{range:?} is no range; write the least and the greatest in mm, as in 1.5..3, or one number"
        )),
    }
}

fn parse_support(text: &str) -> Result<Support, String> {
    let found = Support::ALL.into_iter().find(|one| one.name() == text);
    found.ok_or_else(|| {
        let names = Support::ALL.map(Support::name).join(", ");
        format!("take one of {names}")
    })
}

fn parse_sample(text: &str) -> Result<Sample, String> {
    let found = Sample::ALL.into_iter().find(|one| one.name() == text);
    found.ok_or_else(|| {
        let names = Sample::ALL.map(Sample::name).join(", ");
        format!("take one of {names}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_known_by_its_name() {
        for sample in Sample::ALL {
            assert_eq!(parse_sample(sample.name()), Ok(sample));
        }
        assert_eq!(
            parse_sample("random").unwrap_err(),
            "take one of sobol, grid"
        );
    }

    #[test]
    fn a_size_is_a_range_or_one_number() {
        let size = |text| parse_size(text).map(|size| (size.place, size.range_mm));
        assert_eq!(size("gap=1.5..3"), Ok((3, [1.5, 3.0])));
        assert_eq!(size("width=15"), Ok((1, [15.0, 15.0])));
        for wrong in ["gap", "gap=3..1", "gap=0..1", "hole=1..2", "gap=a..b"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_support_is_known_by_its_name_in_a_file() {
        for support in Support::ALL {
            assert_eq!(parse_support(support.name()), Ok(support));
        }
        assert!(parse_support("glued").is_err());
    }
}
