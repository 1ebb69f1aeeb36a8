//! Flexure materials: stiffness, yield and fatigue.
//!
//! S-N curves are Basquin's, `amplitude = coefficient (2 cycles)^exponent`, fully reversed, smooth specimens,
//! median life; for printed PLA, where laboratories differ by a factor of two and more, 90 % survival. Notches
//! and rough surfaces are covered by the safety factor of a design.

use firmware::config::constants::{Constant, assumed, stated};

/// Catalogue material with sources.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Name in a design file.
    pub name: &'static str,
    /// Metal, otherwise plastic.
    pub metal: bool,
    /// Young's modulus in GPa.
    pub modulus: Constant,
    /// Stress at 0.2 % of permanent strain, or at the yield point of a plastic, in MPa.
    pub yields: Constant,
    /// Basquin's coefficient in MPa.
    pub fatigue_coefficient: Constant,
    /// Basquin's exponent.
    pub fatigue_exponent: Constant,
}

/// Mechanical properties of a catalogue or custom material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strength {
    /// Young's modulus in Pa.
    pub modulus_pa: f64,
    /// Yield stress in Pa.
    pub yield_pa: f64,
    /// Basquin's coefficient in Pa.
    pub fatigue_coefficient_pa: f64,
    /// Basquin's exponent, negative.
    pub fatigue_exponent: f64,
}

impl Strength {
    /// Fully reversed stress amplitude in Pa for a life of `cycles`, at most yield.
    pub(crate) fn fatigue_pa(&self, cycles: f64) -> f64 {
        let basquin_pa = self.fatigue_coefficient_pa * (2.0 * cycles).powf(self.fatigue_exponent);
        basquin_pa.min(self.yield_pa)
    }
}

impl Material {
    /// Catalogue material by name.
    pub fn named(name: &str) -> Option<&'static Self> {
        MATERIALS.iter().find(|material| material.name == name)
    }

    /// Properties in SI units.
    pub fn strength(&self) -> Strength {
        Strength {
            modulus_pa: 1e9 * self.modulus.value,
            yield_pa: 1e6 * self.yields.value,
            fatigue_coefficient_pa: 1e6 * self.fatigue_coefficient.value,
            fatigue_exponent: self.fatigue_exponent.value,
        }
    }

    /// Constants with their sources.
    pub fn constants(&self) -> [Constant; 4] {
        [self.modulus, self.yields, self.fatigue_coefficient, self.fatigue_exponent]
    }
}

const fn modulus(value: f64, source: &'static str) -> Constant {
    stated("Young's modulus", value, "GPa", source)
}

const fn yields(value: f64, source: &'static str) -> Constant {
    stated("yield", value, "MPa", source)
}

const fn coefficient(value: f64, source: &'static str) -> Constant {
    stated("fatigue coefficient", value, "MPa", source)
}

const fn exponent(value: f64, source: &'static str) -> Constant {
    stated("fatigue exponent", value, "", source)
}

const fn assumed_coefficient(value: f64, source: &'static str) -> Constant {
    assumed("fatigue coefficient", value, "MPa", source)
}

const fn assumed_exponent(value: f64, source: &'static str) -> Constant {
    assumed("fatigue exponent", value, "", source)
}

/// Catalogue, metals first.
pub const MATERIALS: [Material; 6] = [
    Material {
        name: "17-4PH",
        metal: true,
        modulus: modulus(196.0, "AK Steel, 17-4 PH data bulletin"),
        yields: yields(1170.0, "ASTM A564, condition H900, least"),
        fatigue_coefficient: assumed_coefficient(
            2070.0,
            "through 0.9 of 1310 MPa at 10^3 cycles (Shigley's rule) and 670 MPa at 2 10^6, which by Smith, Watson \
             and Topper is 450 MPa at R = 0.1, wrought, as quoted by Spiller et al., Fract. Struct. Integr. 77 \
             (2026); 1.6 HV (Nakatani et al., Procedia Struct. Integr. 19 (2019)) agrees",
        ),
        fatigue_exponent: assumed_exponent(-0.074, "the same two points"),
    },
    Material {
        name: "Al 7075-T6",
        metal: true,
        modulus: modulus(71.7, "ASM Handbook 2, 7075"),
        yields: yields(462.0, "ASTM B209, plate of 6 to 12 mm, least"),
        fatigue_coefficient: coefficient(
            1466.0,
            "Dowling, Mechanical Behavior of Materials, table of strain-life constants; half of the 159 MPa at \
             5 10^8 cycles that the Aluminum Association gives (R. R. Moore)",
        ),
        fatigue_exponent: exponent(-0.143, "the same"),
    },
    Material {
        name: "Ti-6Al-4V",
        metal: true,
        modulus: modulus(113.8, "ASM Handbook 2, annealed"),
        yields: yields(828.0, "ASTM B265 grade 5, annealed, least"),
        fatigue_coefficient: coefficient(
            2030.0,
            "Dowling, Mechanical Behavior of Materials, table of S-N constants, solution treated and aged; two \
             thirds of the 510 MPa at 10^7 cycles that ASM and MatWeb give for annealed bar (smooth)",
        ),
        fatigue_exponent: exponent(-0.104, "the same"),
    },
    Material {
        name: "ABS",
        metal: false,
        modulus: modulus(2.3, "INEOS, Terluran GP-22, ISO 527, moulded"),
        yields: yields(45.0, "INEOS, Terluran GP-22, ISO 527, moulded"),
        fatigue_coefficient: assumed_coefficient(
            61.0,
            "0.6 of yield at 10^3 cycles; 10 MPa at 10^7, below the 12 to 20 MPa that Granta's MaterialUniverse \
             estimates for extruded ABS. No curve of moulded ABS with its numbers was found",
        ),
        fatigue_exponent: assumed_exponent(-0.108, "the same two points"),
    },
    Material {
        name: "PLA",
        metal: false,
        modulus: modulus(3.04, "Stratasys, PLA data sheet, ASTM D638, printed, XZ"),
        yields: yields(
            45.0,
            "Stratasys, PLA data sheet, ASTM D638, printed, XZ (Prusa gives 51 for Prusament)",
        ),
        fatigue_coefficient: coefficient(
            67.6,
            "Ezeh and Susmel, Int. J. Fatigue 126 (2019) 319, their design curve, of which nine tenths survive: a \
             tenth of the strength of 42.6 MPa at 2 10^6 cycles. Their median there is 10.4 MPa, that of Yaren et al., \
             Procedia Struct. Integr. 76 (2026), 6.3 at the most",
        ),
        fatigue_exponent: exponent(-0.182, "slope 5.5: the same"),
    },
    Material {
        name: "POM",
        metal: false,
        modulus: modulus(3.1, "DuPont, Delrin 500P, ISO 527"),
        yields: yields(70.0, "DuPont, Delrin 500P, ISO 527"),
        fatigue_coefficient: assumed_coefficient(
            81.0,
            "0.7 of yield at 10^3 cycles, 31 MPa at 10^6 (DuPont, Delrin design guide, ASTM D671, flexural); at 10^7 \
             below the 28.7 MPa that VDI 2736-2's curve for gears gives by Smith, Watson and Topper",
        ),
        fatigue_exponent: assumed_exponent(-0.066, "the same two points"),
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fatigue_strength_falls_with_life_and_stays_below_yield() {
        for material in &MATERIALS {
            let strength = material.strength();
            let lives = [1.0, 1e3, 1e5, 1e7, 1e9].map(|cycles| strength.fatigue_pa(cycles));
            assert!(lives.windows(2).all(|pair| pair[1] <= pair[0]), "{lives:?}");
            assert!(lives[0] <= strength.yield_pa);
            // From a few percent (printed plastic) to a half of yield (hard steel).
            let share = lives[3] / strength.yield_pa;
            assert!(share > 0.05 && share < 0.55, "{}: {share}", material.name);
        }
    }

    #[test]
    fn fatigue_curves_pass_their_two_points() {
        for (name, cycles, stress_pa) in [
            ("17-4PH", 1e3, 0.9 * 1310e6),
            ("17-4PH", 2e6, 670e6),
            ("ABS", 1e3, 0.6 * 45e6),
            ("ABS", 1e7, 10e6),
            ("PLA", 2e6, 4.26e6),
            ("POM", 1e3, 0.7 * 70e6),
            ("POM", 1e6, 31e6),
        ] {
            let found = Material::named(name).unwrap().strength().fatigue_pa(cycles);
            assert!((found / stress_pa - 1.0).abs() < 0.02, "{name} {cycles}: {found}");
        }
    }

    #[test]
    fn strain_life_curves_are_below_stated_endurance() {
        for (name, cycles, endurance_pa) in [
            // Aluminum Association, typical: rotating beam of R. R. Moore, fully reversed.
            ("Al 7075-T6", 5e8, 159e6),
            // ASM and MatWeb, annealed bar, smooth; stress ratio not stated.
            ("Ti-6Al-4V", 1e7, 510e6),
        ] {
            let found = Material::named(name).unwrap().strength().fatigue_pa(cycles);
            let share = found / endurance_pa;
            assert!((0.4..1.0).contains(&share), "{name}: {share}");
        }
    }

    #[test]
    fn material_names_are_unique_and_values_have_sources() {
        for (i, material) in MATERIALS.iter().enumerate() {
            assert!(MATERIALS[..i].iter().all(|other| other.name != material.name));
            assert_eq!(Material::named(material.name), Some(material));
            for constant in material.constants() {
                assert!(!constant.source.is_empty() && constant.value.is_finite());
            }
        }
        assert_eq!(Material::named("cheese"), None);
    }
}
