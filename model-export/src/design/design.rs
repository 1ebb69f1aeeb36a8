//! `design.toml`: a whole design, as a person writes it and as `magpie design pick` does.
//!
//! Its first keys are those of the `[design]` table of a recording, so that the file is the nominal design of
//! a fit and of a simulation as it is. What a flexure's beam does not explain of an axis's stiffness is the
//! mount behind it: finger, screws, rail. Where no stiffness is given, it is the beam's alone.

mod check;

use std::collections::BTreeMap;
use std::path::Path;

use firmware::params;
use serde::{Deserialize, Serialize};

use super::beam::{Beam, Support};
use super::material::{MATERIALS, Material, Strength};
use crate::fit::parameters;
use crate::output::write_output;
use crate::recordings::description::{Design as Nominal, Magnet, parse_toml};
use crate::recordings::problem::{Fault, Place, Problem};

/// First line of every design that the tool writes.
pub const MARK: &str = "# design of magpie";

/// A beam may be softer than the stiffness of its axis by this share: the file's digits.
const ROUNDING: f64 = 1e-3;

/// A design.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// From the magnet's face to the Hall element at rest, in mm.
    pub gap_mm: f64,
    /// Stiffness of the lateral axis in N/mm; `None` where it is the beam's alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_x_n_per_mm: Option<f64>,
    /// Stiffness of the longitudinal axis in N/mm; `None` where it is the beam's alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_z_n_per_mm: Option<f64>,
    /// Force that each axis must measure, either sign, in N.
    #[serde(default = "force_range_n")]
    pub force_range_n: f64,
    /// Number of sensors.
    #[serde(default = "sensors")]
    pub sensors: u32,
    /// The magnet.
    pub magnet: Magnet,
    /// The lateral flexure.
    pub flexure_x: Flexure,
    /// The longitudinal flexure.
    pub flexure_z: Flexure,
    /// The Hall sensor.
    #[serde(default)]
    pub sensor: Sensor,
    /// What is asked of it.
    #[serde(default)]
    pub limits: Limits,
    /// How far the made differs from the meant.
    #[serde(default)]
    pub tolerances: Tolerances,
    /// Materials of the user's own, by their names.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub material: BTreeMap<String, OwnMaterial>,
}

/// A flexure: its beam, in the file's units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flexure {
    /// How the beam is held.
    pub support: Support,
    /// A name of the table, or of the file's own materials.
    pub material: String,
    /// Free length in mm.
    pub length_mm: f64,
    /// Width, across the motion, in mm.
    pub width_mm: f64,
    /// Thickness, along the motion, in mm.
    pub thickness_mm: f64,
}

/// A Hall sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sensor {
    /// Range of each axis, either sign, in gauss.
    pub range_gauss: f64,
    /// One count in gauss.
    pub gauss_per_lsb: f64,
    /// Noise of one reading, root mean square, in gauss.
    pub noise_gauss: f64,
    /// From the Hall element to the surface of its package, in mm.
    pub package_mm: f64,
}

/// What a flexure must bear, and how far it may move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Motion at which a stop takes over, in mm.
    pub stroke_mm: f64,
    /// Reversed cycles of the full range that the flexure must last.
    pub life_cycles: f64,
    /// Stress by which the material yields or tires, by the stress that is allowed.
    pub safety: f64,
}

/// How far the made differs from the meant, either way: by default as a fit takes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Place of the magnet across the gap, in mm.
    pub offset_mm: f64,
    /// Gap in mm.
    pub gap_mm: f64,
    /// Tilt of the magnet in degrees.
    pub tilt_deg: f64,
    /// Remanence, a share.
    pub remanence: f64,
}

/// A material that the table does not hold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnMaterial {
    /// Young's modulus in GPa.
    pub modulus_gpa: f64,
    /// Yield stress in MPa.
    pub yield_mpa: f64,
    /// Basquin's coefficient in MPa.
    pub fatigue_coefficient_mpa: f64,
    /// Basquin's exponent, below zero.
    pub fatigue_exponent: f64,
}

fn force_range_n() -> f64 {
    params::FORCE_RANGE.value
}

fn sensors() -> u32 {
    params::SENSORS.value as u32
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            range_gauss: params::SENSOR_RANGE.value,
            gauss_per_lsb: params::SENSOR_SCALE.value,
            noise_gauss: params::SENSOR_NOISE.value,
            package_mm: super::assumed::PACKAGE.value,
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            stroke_mm: super::assumed::STROKE.value,
            life_cycles: super::assumed::LIFE.value,
            safety: super::assumed::SAFETY.value,
        }
    }
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            offset_mm: parameters::tolerance("offset_x"),
            gap_mm: parameters::tolerance("gap"),
            tilt_deg: parameters::tolerance("tilt_x"),
            remanence: parameters::tolerance("remanence"),
        }
    }
}

impl Flexure {
    /// The beam, of a material of this modulus.
    pub fn beam(&self, strength: &Strength) -> Beam {
        Beam {
            length_m: 1e-3 * self.length_mm,
            width_m: 1e-3 * self.width_mm,
            thickness_m: 1e-3 * self.thickness_mm,
            support: self.support,
            modulus_pa: strength.modulus_pa,
        }
    }
}

impl Design {
    /// The gripper's own, from [`firmware::params`] and the paper's beam, of steel.
    pub fn magpie() -> Self {
        let nominal = Nominal::magpie();
        let flexure = Flexure {
            support: Support::ClampedFree,
            material: MATERIALS[0].name.to_owned(),
            length_mm: params::BEAM_LENGTH.value,
            width_mm: super::assumed::BEAM_WIDTH.value,
            thickness_mm: super::assumed::BEAM_THICKNESS.value,
        };
        Self {
            gap_mm: nominal.gap_mm,
            stiffness_x_n_per_mm: Some(nominal.stiffness_x_n_per_mm),
            stiffness_z_n_per_mm: Some(nominal.stiffness_z_n_per_mm),
            force_range_n: force_range_n(),
            sensors: sensors(),
            magnet: nominal.magnet,
            flexure_x: flexure.clone(),
            flexure_z: flexure,
            sensor: Sensor::default(),
            limits: Limits::default(),
            tolerances: Tolerances::default(),
            material: BTreeMap::new(),
        }
    }

    /// The nominal design of a fit, a simulation, a model.
    pub fn nominal(&self) -> Nominal {
        let [x, z] = [0, 1].map(|axis| self.stiffness_n_per_mm(axis));
        let mut more = toml::Table::new();
        more.insert("beam_length_mm".into(), self.flexure_x.length_mm.into());
        Nominal {
            magnet: self.magnet.clone(),
            gap_mm: self.gap_mm,
            stiffness_x_n_per_mm: x,
            stiffness_z_n_per_mm: z,
            force_range_n: Some(self.force_range_n),
            sensors: Some(self.sensors),
            more,
        }
    }

    /// The flexure of the lateral (0) or the longitudinal (1) axis.
    pub fn flexure(&self, axis: usize) -> &Flexure {
        match axis {
            0 => &self.flexure_x,
            _ => &self.flexure_z,
        }
    }

    /// Stiffness of that axis at small loads, beam and mount, in N/mm.
    pub fn stiffness_n_per_mm(&self, axis: usize) -> f64 {
        self.stated(axis)
            .unwrap_or_else(|| self.beam_n_per_mm(axis))
    }

    /// Stiffness of that axis's beam alone, in N/mm.
    pub fn beam_n_per_mm(&self, axis: usize) -> f64 {
        let flexure = self.flexure(axis);
        let strength = self.strength(axis);
        1e-3 * flexure.beam(&strength).stiffness_n_per_m()
    }

    /// What the mount gives, in m/N.
    pub fn mount_m_per_n(&self, axis: usize) -> f64 {
        let compliance = 1e-3 / self.stiffness_n_per_mm(axis) - 1e-3 / self.beam_n_per_mm(axis);
        compliance.max(0.0)
    }

    /// The numbers of that axis's material; those of the first one where a design was not checked.
    pub fn strength(&self, axis: usize) -> Strength {
        let name = &self.flexure(axis).material;
        let own = self.material.get(name).map(OwnMaterial::strength);
        own.or_else(|| Material::named(name).map(Material::strength))
            .unwrap_or_else(|| MATERIALS[0].strength())
    }

    fn stated(&self, axis: usize) -> Option<f64> {
        match axis {
            0 => self.stiffness_x_n_per_mm,
            _ => self.stiffness_z_n_per_mm,
        }
    }

    /// Reads and checks a design.
    ///
    /// # Errors
    /// The file cannot be read or understood, a key is unknown, or a number is not possible.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
        let design: Self = parse_toml(path, &text)?;
        design.check(path)?;
        Ok(design)
    }

    /// Writes the design; see [`write_output`].
    pub fn write(&self, path: &Path) -> Result<(), Problem> {
        let text = toml::to_string(self)
            .map_err(|error| Fault::Toml(error.to_string()).at(Place::file(path)))?;
        write_output(path, format!("{MARK}\n{text}").as_bytes(), MARK)
    }
}

impl OwnMaterial {
    /// Its numbers.
    pub fn strength(&self) -> Strength {
        Strength {
            modulus_pa: 1e9 * self.modulus_gpa,
            yield_pa: 1e6 * self.yield_mpa,
            fatigue_coefficient_pa: 1e6 * self.fatigue_coefficient_mpa,
            fatigue_exponent: self.fatigue_exponent,
        }
    }
}

#[cfg(test)]
mod tests;
