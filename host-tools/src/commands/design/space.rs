//! Arguments that define the design space of a search.

use std::path::PathBuf;

use anyhow::{Result, bail};
use model_export::design::SensorDesign;
use model_export::design::beam::Support;
use model_export::design::interference::{DRAWS, InterferenceSources};
use model_export::design::material::{MATERIALS, Material};
use model_export::design::sampling::SamplingMethod;
use model_export::design::sweep::{DEFAULT_COUNT, DesignSpace, SIZES};
use model_export::input::plausible_range;

/// The design space, its sampling and the constraints.
#[derive(Debug, clap::Args)]
pub struct SpaceArgs {
    /// Design that gives sensor, limits, tolerances and user-defined materials [default: MAGPIE].
    #[arg(long, value_name = "DESIGN")]
    pub base: Option<PathBuf>,
    /// Number of designs to evaluate (approximate for a grid).
    #[arg(long, value_name = "N", default_value_t = DEFAULT_COUNT, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    pub count: u32,
    /// Sampling: sobol (quasi-random) or grid (all combinations of a few values of each size).
    #[arg(long, value_name = "SAMPLE", value_parser = |text: &str| parse_name(SamplingMethod::ALL, SamplingMethod::name, text), default_value = "sobol")]
    pub sample: SamplingMethod,
    /// Range of a size in mm: length, width and thickness of the beam, gap, diameter and height of the magnet;
    /// may be given several times.
    #[arg(long = "size", value_name = "NAME=MM..MM", value_parser = parse_size)]
    pub sizes: Vec<Size>,
    /// Material; may be given several times [default: all known].
    #[arg(long = "material", value_name = "NAME")]
    pub materials: Vec<String>,
    /// Support of the beams.
    #[arg(long, value_parser = |text: &str| parse_name(Support::ALL, Support::name, text), default_value = "clamped-free", value_name = "SUPPORT")]
    pub support: Support,
    /// Displacement of the mechanical stop.
    #[arg(long, value_name = "MM")]
    pub stroke: Option<f64>,
    /// Fatigue life in fully reversed cycles of the full range.
    #[arg(long, value_name = "CYCLES")]
    pub life: Option<f64>,
    /// Safety factor on the stress.
    #[arg(long, value_name = "FACTOR")]
    pub safety: Option<f64>,
    /// Seed of the random misalignments.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// A size (index into `SIZES`) and its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    index: usize,
    range_mm: [f64; 2],
}

impl SpaceArgs {
    /// The fixed properties of the designs.
    pub fn base(&self) -> Result<SensorDesign> {
        let mut base = SensorDesign::read_or_magpie(self.base.as_deref())?;
        let options = [
            ("--stroke", "stroke_mm", self.stroke),
            ("--life", "life_cycles", self.life),
            ("--safety", "safety", self.safety),
        ];
        for (option, key, value) in options {
            let (min, max) = plausible_range(key);
            if let Some(value) = value.filter(|value| !(min..=max).contains(value)) {
                bail!("{option} {value:?} is not possible here; give {min} to {max:e}");
            }
        }
        let limits = &mut base.limits;
        limits.stroke_mm = self.stroke.unwrap_or(limits.stroke_mm);
        limits.life_cycles = self.life.unwrap_or(limits.life_cycles);
        limits.safety = self.safety.unwrap_or(limits.safety);
        Ok(base)
    }

    /// The design space; fails on an unknown material.
    pub fn space(&self, base: &SensorDesign) -> Result<DesignSpace> {
        let mut space =
            DesignSpace { support: self.support, sample: self.sample, ..DesignSpace::default() };
        for size in &self.sizes {
            space.sizes_mm[size.index] = size.range_mm;
        }
        if !self.materials.is_empty() {
            space.materials.clone_from(&self.materials);
        }
        for name in &space.materials {
            if Material::named(name).is_none() && !base.material.contains_key(name) {
                let known = MATERIALS.map(|material| material.name).join(", ");
                bail!(
                    "--material {name:?} is unknown; use one of {known}, or define it in --base under [material.NAME]"
                );
            }
        }
        Ok(space)
    }

    /// The assumed sources of interference.
    pub fn interference(&self) -> InterferenceSources {
        InterferenceSources::assumed(self.seed, DRAWS)
    }
}

fn parse_size(text: &str) -> Result<Size, String> {
    let names = || SIZES.join(", ");
    let (name, range) =
        text.split_once('=').ok_or("write it as NAME=MM..MM, for example gap=1.5..3")?;
    let index = SIZES
        .iter()
        .position(|size| *size == name)
        .ok_or_else(|| format!("{name:?} is no size; use one of {}", names()))?;
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let (least, most) = plausible_range("size_mm");
    let range_mm = match range.split_once("..") {
        Some((min, max)) => [number(min), number(max)],
        None => [number(range); 2],
    };
    match range_mm {
        [Some(min), Some(max)] if min >= least && max >= min && max <= most => {
            Ok(Size { index, range_mm: [min, max] })
        }
        _ => Err(format!(
            "{range:?} is no range of {least} to {most} mm; write minimum and maximum, as in 1.5..3, or one number"
        )),
    }
}

/// Parses the name of one of these values.
fn parse_name<T: Copy, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
    text: &str,
) -> Result<T, String> {
    let found = all.into_iter().find(|one| name(*one) == text);
    found.ok_or_else(|| format!("use one of {}", all.map(name).join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_and_support_are_parsed_by_name() {
        let sampling = |text| parse_name(SamplingMethod::ALL, SamplingMethod::name, text);
        assert!(SamplingMethod::ALL.iter().all(|one| sampling(one.name()) == Ok(*one)));
        assert_eq!(sampling("random").unwrap_err(), "use one of sobol, grid");
        let support = |text| parse_name(Support::ALL, Support::name, text);
        assert!(Support::ALL.iter().all(|one| support(one.name()) == Ok(*one)));
    }

    #[test]
    fn size_is_a_range_or_one_number() {
        let size = |text| parse_size(text).map(|size| (size.index, size.range_mm));
        assert_eq!(size("gap=1.5..3"), Ok((3, [1.5, 3.0])));
        assert_eq!(size("width=15"), Ok((1, [15.0, 15.0])));
        for wrong in [
            "gap",
            "gap=3..1",
            "gap=0..1",
            "gap=1e-320..1",
            "gap=1..1e308",
            "hole=1..2",
            "gap=a..b",
        ] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
