//! Whether a design can be: every number in its place, every name known.

use std::path::Path;

use super::{Design, ROUNDING};
use crate::design::material::{MATERIALS, Material};
use crate::recordings::problem::{Fault, Place, Problem, closest};

impl Design {
    /// The first thing that cannot be, with its key.
    pub(super) fn check(&self, path: &Path) -> Result<(), Problem> {
        let bad = |key: &str, found: String, advice: String| {
            Err(Fault::BadValue { found, advice }.at(Place::file(path).column(key)))
        };
        for (key, value) in self.above_zero() {
            if !(value.is_finite() && value > 0.0) {
                return bad(
                    &key,
                    value.to_string(),
                    "give a number above zero".to_owned(),
                );
            }
        }
        for (key, value) in self.not_below_zero() {
            if !(value.is_finite() && value >= 0.0) {
                return bad(key, value.to_string(), "give zero or more".to_owned());
            }
        }
        for (name, own) in &self.material {
            if !(own.fatigue_exponent.is_finite() && own.fatigue_exponent < 0.0) {
                let advice = "more cycles are borne at less stress: give a number below zero";
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

    fn check_axis(&self, path: &Path, axis: usize, letter: &str) -> Result<(), Problem> {
        let place = |key: String| Place::file(path).column(key);
        let name = &self.flexure(axis).material;
        if Material::named(name).is_none() && !self.material.contains_key(name) {
            let known = MATERIALS.iter().map(|material| material.name);
            let known: Vec<&str> = known
                .chain(self.material.keys().map(String::as_str))
                .collect();
            let alike = known
                .iter()
                .copied()
                .find(|one| one.eq_ignore_ascii_case(name));
            let meant = alike.or_else(|| closest(name, known.iter().copied()));
            let advice = match meant {
                Some(meant) => format!("did you mean {meant:?}?"),
                None => format!(
                    "known are {}; or describe it under [material.NAME]",
                    known.join(", ")
                ),
            };
            let found = format!("{name:?}");
            return Err(
                Fault::BadValue { found, advice }.at(place(format!("flexure_{letter}.material")))
            );
        }
        let (stated, beam) = (self.stated(axis), self.beam_n_per_mm(axis));
        match stated {
            Some(stiffness) if stiffness > (1.0 + ROUNDING) * beam => {
                let advice = format!(
                    "the beam alone has {beam:.1} N/mm, and what it stands on only makes it softer: \
                     leave the key out, or make the beam stiffer"
                );
                let found = stiffness.to_string();
                Err(Fault::BadValue { found, advice }
                    .at(place(format!("stiffness_{letter}_n_per_mm"))))
            }
            _ => Ok(()),
        }
    }

    /// Everything that must be above zero, by its key.
    fn above_zero(&self) -> Vec<(String, f64)> {
        let mut sizes: Vec<(String, f64)> = Vec::new();
        let mut add = |key: &str, value: f64| sizes.push((key.to_owned(), value));
        for (axis, letter) in ["x", "z"].into_iter().enumerate() {
            let flexure = self.flexure(axis);
            add(&format!("flexure_{letter}.length_mm"), flexure.length_mm);
            add(&format!("flexure_{letter}.width_mm"), flexure.width_mm);
            add(
                &format!("flexure_{letter}.thickness_mm"),
                flexure.thickness_mm,
            );
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
            add(
                &format!("material.{name}.fatigue_coefficient_mpa"),
                coefficient,
            );
        }
        // Gap, stiffness and magnet as in a recording, under their keys of this file.
        let nominal = self.nominal().sizes().into_iter();
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
