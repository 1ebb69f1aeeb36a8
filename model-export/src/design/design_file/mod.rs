//! `design.toml`: a complete design, written by hand or by `magpie design optimize`.
//!
//! Its first keys are those of the `[design]` table of a recording, so that the file also serves as nominal
//! design of a fit or a simulation. A stiffness below that of the beam is due to the mount behind it: finger,
//! screws, rail. Without a stated stiffness it is that of the beam.

use crate::design::beam::{Beam, Support};
use crate::design::material::{MATERIALS, Material, Strength};
use crate::error::{DataError, ErrorKind, Location, closest_match};
use crate::fit::parameters;
use crate::input::{self, check_plausible};
use crate::recordings::description::{MagnetSpec, NominalDesign as Nominal, parse_toml};
use firmware::config::constants::{self, Constant, assumed, stated};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// First line of every generated design file.
pub const MARK: &str = "# design of magpie";

/// Tolerance of a stated stiffness relative to the beam, for rounding in the file.
const ROUNDING: f64 = 1e-3;

/// Complete design of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorDesign {
    /// Gap from the magnet's face to the Hall element at rest, in mm.
    pub gap_mm: f64,
    /// Stiffness of the lateral axis in N/mm; `None`: that of the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_x_n_per_mm: Option<f64>,
    /// Stiffness of the longitudinal axis in N/mm; `None`: that of the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_z_n_per_mm: Option<f64>,
    /// Required force range of each axis, either sign, in N.
    #[serde(default = "force_range_n")]
    pub force_range_n: f64,
    /// Number of sensors.
    #[serde(default = "sensors")]
    pub sensors: u32,
    /// The magnet.
    pub magnet: MagnetSpec,
    /// The lateral flexure.
    pub flexure_x: Flexure,
    /// The longitudinal flexure.
    pub flexure_z: Flexure,
    /// The Hall sensor.
    #[serde(default)]
    pub sensor: HallSpec,
    /// Mechanical requirements.
    #[serde(default)]
    pub limits: Requirements,
    /// Manufacturing tolerances.
    #[serde(default)]
    pub tolerances: DesignTolerances,
    /// Custom materials by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub material: BTreeMap<String, CustomMaterial>,
}

/// Flexure beam, in the file's units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flexure {
    /// Boundary conditions.
    pub support: Support,
    /// Name of a catalogue or custom material.
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
pub struct HallSpec {
    /// Range of each axis, either sign, in gauss.
    pub range_gauss: f64,
    /// Gauss per count.
    pub gauss_per_lsb: f64,
    /// Noise of one reading in gauss, root mean square.
    pub noise_gauss: f64,
    /// Depth of the Hall element below the surface of its package, in mm.
    pub package_mm: f64,
}

/// Mechanical requirements of a flexure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Requirements {
    /// Displacement of the mechanical stop in mm.
    pub stroke_mm: f64,
    /// Required life in reversed cycles of the full range.
    pub life_cycles: f64,
    /// Safety factor against yield and fatigue.
    pub safety: f64,
}

/// Manufacturing tolerances, either way; by default the priors of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DesignTolerances {
    /// Offset of the magnet across the gap, in mm.
    pub offset_mm: f64,
    /// Gap in mm.
    pub gap_mm: f64,
    /// Tilt of the magnet in degrees.
    pub tilt_deg: f64,
    /// Remanence, relative.
    pub remanence: f64,
}

/// A material that is not in the catalogue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CustomMaterial {
    /// Young's modulus in GPa.
    pub modulus_gpa: f64,
    /// Yield stress in MPa.
    pub yield_mpa: f64,
    /// Basquin's coefficient in MPa.
    pub fatigue_coefficient_mpa: f64,
    /// Basquin's exponent, negative.
    pub fatigue_exponent: f64,
}

fn force_range_n() -> f64 {
    constants::FORCE_RANGE.value
}

fn sensors() -> u32 {
    constants::SENSORS.value as u32
}

impl Default for HallSpec {
    fn default() -> Self {
        Self {
            range_gauss: constants::SENSOR_RANGE.value,
            gauss_per_lsb: constants::SENSOR_SCALE.value,
            noise_gauss: constants::SENSOR_NOISE.value,
            package_mm: PACKAGE.value,
        }
    }
}

impl Default for Requirements {
    fn default() -> Self {
        Self { stroke_mm: STROKE.value, life_cycles: LIFE.value, safety: SAFETY.value }
    }
}

impl Default for DesignTolerances {
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
    /// Beam of this flexure with the modulus of its material.
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

impl SensorDesign {
    /// MAGPIE's design, from the firmware's constants and the paper's steel beam.
    pub fn magpie() -> Self {
        let nominal = Nominal::magpie();
        let flexure = Flexure {
            support: Support::ClampedFree,
            material: MATERIALS[0].name.to_owned(),
            length_mm: constants::BEAM_LENGTH.value,
            width_mm: BEAM_WIDTH.value,
            thickness_mm: BEAM_THICKNESS.value,
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
            sensor: HallSpec::default(),
            limits: Requirements::default(),
            tolerances: DesignTolerances::default(),
            material: BTreeMap::new(),
        }
    }

    /// Nominal design for fits, simulations and models.
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

    /// Flexure of the lateral (0) or longitudinal (1) axis.
    pub fn flexure(&self, axis: usize) -> &Flexure {
        match axis {
            0 => &self.flexure_x,
            _ => &self.flexure_z,
        }
    }

    /// Stiffness of an axis at small loads, beam and mount, in N/mm.
    pub fn stiffness_n_per_mm(&self, axis: usize) -> f64 {
        self.specified_stiffness(axis).unwrap_or_else(|| self.beam_n_per_mm(axis))
    }

    /// Stiffness of the beam of an axis, in N/mm.
    pub fn beam_n_per_mm(&self, axis: usize) -> f64 {
        let flexure = self.flexure(axis);
        let strength = self.strength(axis);
        1e-3 * flexure.beam(&strength).stiffness_n_per_m()
    }

    /// Compliance of the mount in m/N.
    pub(crate) fn mount_m_per_n(&self, axis: usize) -> f64 {
        let compliance = 1e-3 / self.stiffness_n_per_mm(axis) - 1e-3 / self.beam_n_per_mm(axis);
        compliance.max(0.0)
    }

    /// Material of an axis; the first of the catalogue in an unchecked design.
    pub fn strength(&self, axis: usize) -> Strength {
        let name = &self.flexure(axis).material;
        let own = self.material.get(name).map(CustomMaterial::strength);
        own.or_else(|| Material::named(name).map(Material::strength))
            .unwrap_or_else(|| MATERIALS[0].strength())
    }

    fn specified_stiffness(&self, axis: usize) -> Option<f64> {
        match axis {
            0 => self.stiffness_x_n_per_mm,
            _ => self.stiffness_z_n_per_mm,
        }
    }

    /// Reads and validates a design.
    ///
    /// # Errors
    /// Unreadable file, unknown key, or invalid value.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let text = input::read_text(path)?;
        let design: Self = parse_toml(path, &text)?;
        design.check(path)?;
        Ok(design)
    }

    /// The design at `path`, or MAGPIE's without one.
    ///
    /// # Errors
    /// As of [`SensorDesign::read`].
    pub fn read_or_magpie(path: Option<&Path>) -> Result<Self, DataError> {
        path.map_or_else(|| Ok(Self::magpie()), Self::read)
    }

    /// Content of the file; errors name `path`.
    pub fn to_toml(&self, path: &Path) -> Result<String, DataError> {
        let text = toml::to_string(self)
            .map_err(|error| ErrorKind::Toml(error.to_string()).at(Location::file(path)))?;
        Ok(format!("{MARK}\n{text}"))
    }
}

impl CustomMaterial {
    /// Properties in SI units.
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

impl SensorDesign {
    /// Validates the design; the error names the key.
    pub(super) fn check(&self, path: &Path) -> Result<(), DataError> {
        let bad = |key: &str, found: String, advice: String| {
            Err(ErrorKind::BadValue { found, advice }.at(Location::file(path).column(key)))
        };
        for (key, value) in self.above_zero() {
            if !(value.is_finite() && value > 0.0) {
                return bad(&key, format!("{value:?}"), "give a number above zero".to_owned());
            }
            check_plausible(&key, value)
                .map_err(|kind| kind.at(Location::file(path).column(&*key)))?;
        }
        for (key, value) in self.not_below_zero() {
            if !(value.is_finite() && value >= 0.0) {
                return bad(key, format!("{value:?}"), "give zero or more".to_owned());
            }
            if value > 0.0 {
                check_plausible(key, value)
                    .map_err(|kind| kind.at(Location::file(path).column(key)))?;
            }
        }
        for (name, own) in &self.material {
            if !(-2.0..0.0).contains(&own.fatigue_exponent) {
                let advice = "the fatigue strength falls with the number of cycles: give a number below zero, down to -2";
                return bad(
                    &format!("material.{name}.fatigue_exponent"),
                    own.fatigue_exponent.to_string(),
                    advice.to_owned(),
                );
            }
        }
        for (axis, letter) in ["x", "z"].into_iter().enumerate() {
            self.check_axis(path, axis, letter)?;
        }
        Ok(())
    }

    fn check_axis(&self, path: &Path, axis: usize, letter: &str) -> Result<(), DataError> {
        let place = |key: String| Location::file(path).column(key);
        let name = &self.flexure(axis).material;
        if Material::named(name).is_none() && !self.material.contains_key(name) {
            let names = MATERIALS.iter().map(|material| material.name);
            let names: Vec<&str> = names.chain(self.material.keys().map(String::as_str)).collect();
            let mut all = names.iter().copied();
            let similar = all
                .find(|one| one.eq_ignore_ascii_case(name))
                .or_else(|| closest_match(name, names.iter().copied()));
            let advice = match similar {
                Some(similar) => format!("did you mean {similar:?}?"),
                None => format!(
                    "the catalogue has {}; or define it under [material.NAME]",
                    names.join(", ")
                ),
            };
            let found = format!("{name:?}");
            return Err(ErrorKind::BadValue { found, advice }
                .at(place(format!("flexure_{letter}.material"))));
        }
        let beam = self.beam_n_per_mm(axis);
        if let Some(stiffness) = self.specified_stiffness(axis)
            && stiffness > (1.0 + ROUNDING) * beam
        {
            let advice = format!(
                "the beam alone has {beam:.1} N/mm, and a mount only makes it softer: \
                 leave the key out, or make the beam stiffer"
            );
            let found = stiffness.to_string();
            let key = format!("stiffness_{letter}_n_per_mm");
            return Err(ErrorKind::BadValue { found, advice }.at(place(key)));
        }
        Ok(())
    }

    /// Values that must be positive, with their keys.
    fn above_zero(&self) -> Vec<(String, f64)> {
        let mut sizes: Vec<(String, f64)> = Vec::new();
        let mut add = |key: &str, value: f64| sizes.push((key.to_owned(), value));
        for (axis, letter) in ["x", "z"].into_iter().enumerate() {
            let Flexure { length_mm, width_mm, thickness_mm, .. } = *self.flexure(axis);
            add(&format!("flexure_{letter}.length_mm"), length_mm);
            add(&format!("flexure_{letter}.width_mm"), width_mm);
            add(&format!("flexure_{letter}.thickness_mm"), thickness_mm);
        }
        add("sensor.range_gauss", self.sensor.range_gauss);
        add("sensor.gauss_per_lsb", self.sensor.gauss_per_lsb);
        add("force_range_n", self.force_range_n);
        add("sensors", f64::from(self.sensors));
        add("limits.stroke_mm", self.limits.stroke_mm);
        add("limits.life_cycles", self.limits.life_cycles);
        add("limits.safety", self.limits.safety);
        for (name, own) in &self.material {
            add(&format!("material.{name}.modulus_gpa"), own.modulus_gpa);
            add(&format!("material.{name}.yield_mpa"), own.yield_mpa);
            let coefficient = own.fatigue_coefficient_mpa;
            add(&format!("material.{name}.fatigue_coefficient_mpa"), coefficient);
        }
        // Gap, stiffness and magnet by the rules of a recording, under the keys of this file.
        let nominal = self.nominal().positive_values().into_iter();
        sizes.extend(nominal.map(|(key, value)| (key.replacen("design.", "", 1), value)));
        sizes
    }

    fn not_below_zero(&self) -> [(&'static str, f64); 6] {
        let tolerances = self.tolerances;
        [
            ("sensor.noise_gauss", self.sensor.noise_gauss),
            ("sensor.package_mm", self.sensor.package_mm),
            ("tolerances.offset_mm", tolerances.offset_mm),
            ("tolerances.gap_mm", tolerances.gap_mm),
            ("tolerances.tilt_deg", tolerances.tilt_deg),
            ("tolerances.remanence", tolerances.remanence),
        ]
    }
}

/// Width of the paper's beam.
pub const BEAM_WIDTH: Constant = stated("beam width", 15.0, "mm", "paper V-B");
/// Thickness of the paper's beam.
pub const BEAM_THICKNESS: Constant = stated("beam thickness", 5.0, "mm", "paper V-B");
/// Displacement of the mechanical stop.
pub const STROKE: Constant = stated("stroke of a flexure", 0.5, "mm", "paper V-B");
/// Life in reversed cycles of the full range.
pub const LIFE: Constant = assumed("life", 1e7, "cycles", "a step a second for four months");
/// Safety factor.
pub const SAFETY: Constant = assumed("safety", 1.5, "", "smooth specimens, no notches");
/// From the Hall element to the surface of its package.
pub const PACKAGE: Constant =
    assumed("depth of the Hall element", 0.4, "mm", "half a DFN of 0.75 mm");

/// Assumed defaults; manufacturing tolerances are those of a fit.
pub const ALL: [Constant; 6] = [BEAM_WIDTH, BEAM_THICKNESS, STROKE, LIFE, SAFETY, PACKAGE];
