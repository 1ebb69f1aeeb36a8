//! A flexure: a straight beam of constant section under a force across it, at large deflections.
//!
//! Von Karman's equations, with the dimensions that they must have: `N = EA (u' + w'^2/2)`, `N' = 0`,
//! `EI w'''' = N w''` between the loads. With both ends held, `N` grows with the square of the deflection
//! (`stretching`). With a free end there is none: the deflection is that of the linear beam, and what is
//! left of the second order is that the tip comes down and leans.
//!
//! Von Karman's rotations are moderate: against the exact curve of an inextensible cantilever (Bisshopp and
//! Drucker, Quarterly of Applied Mathematics 3, 1945) deflection and shortening are within 2 % up to
//! [`MODERATE_SLOPE_RAD`]. Shear is left out: it adds about 0.8 (t/L)^2 to the compliance of a cantilever.

mod stretching;

use serde::{Deserialize, Serialize};

/// Slope of a cantilever's tip up to which deflection and shortening are within 2 % of the exact curve's.
pub const MODERATE_SLOPE_RAD: f64 = 0.15;

/// How a beam is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Support {
    /// Held at one end, loaded and carrying the magnet at the other, which is free.
    ClampedFree,
    /// Held at both ends, loaded and carrying the magnet in the middle.
    ClampedClamped,
    /// Held at one end; the other, loaded and carrying the magnet, moves only across the beam: a guide
    /// keeps it from turning and from coming closer.
    ClampedGuided,
}

impl Support {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::ClampedFree, Self::ClampedClamped, Self::ClampedGuided];

    /// As in a file.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClampedFree => "clamped-free",
            Self::ClampedClamped => "clamped-clamped",
            Self::ClampedGuided => "clamped-guided",
        }
    }
}

/// A straight beam of rectangular section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Free length in m.
    pub length_m: f64,
    /// Width, across the motion, in m.
    pub width_m: f64,
    /// Thickness, along the motion, in m.
    pub thickness_m: f64,
    /// How it is held.
    pub support: Support,
    /// Young's modulus in Pa.
    pub modulus_pa: f64,
}

/// A beam under load, where the magnet sits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bent {
    /// Motion along the force, in m.
    pub deflection_m: f64,
    /// How far the magnet leans, in rad.
    pub slope_rad: f64,
    /// How far the magnet comes towards the beam's root, in m.
    pub shortening_m: f64,
    /// Greatest stress of bending, in the outer fibre at a clamp, in Pa.
    pub bending_pa: f64,
    /// Stress of the pull along the beam, in Pa.
    pub axial_pa: f64,
    /// Pull along the beam, in N.
    pub axial_n: f64,
}

impl Bent {
    /// Greatest stress in Pa: bending and pull together.
    pub fn stress_pa(&self) -> f64 {
        self.bending_pa + self.axial_pa
    }

    /// Amplitude in Pa of the reversed stress that tires as much as this load, reversed. The pull does not
    /// change its sign with the load, so each cycle has a mean; Smith, Watson and Topper's rule (Dowling et
    /// al., Fatigue Fract. Engng. Mater. Struct. 32, 2009).
    pub fn reversed_pa(&self) -> f64 {
        (self.stress_pa() * self.bending_pa).sqrt()
    }
}

impl Beam {
    /// Area of the section in m^2.
    pub fn area_m2(&self) -> f64 {
        self.width_m * self.thickness_m
    }

    /// Second moment of the section in m^4.
    pub fn second_moment_m4(&self) -> f64 {
        self.width_m * self.thickness_m.powi(3) / 12.0
    }

    /// Stiffness at small loads in N/m: 3, 192 or 12 EI/L^3.
    pub fn stiffness_n_per_m(&self) -> f64 {
        let share = match self.support {
            Support::ClampedFree => 3.0,
            Support::ClampedClamped => 192.0,
            Support::ClampedGuided => 12.0,
        };
        share * self.modulus_pa * self.second_moment_m4() / self.length_m.powi(3)
    }

    /// The beam under a force in N, of either sign.
    pub fn bend(&self, force_n: f64) -> Bent {
        match self.support {
            Support::ClampedFree => self.bend_free(force_n),
            Support::ClampedClamped | Support::ClampedGuided => self.bend_held(force_n),
        }
    }

    /// Force in N that moves the magnet by `deflection_m`.
    pub fn force_at(&self, deflection_m: f64) -> f64 {
        match self.support {
            Support::ClampedFree => self.stiffness_n_per_m() * deflection_m,
            Support::ClampedClamped | Support::ClampedGuided => {
                let (section, spans) = self.spans();
                spans * section.force_at(deflection_m)
            }
        }
    }

    fn bend_free(&self, force_n: f64) -> Bent {
        let deflection_m = force_n / self.stiffness_n_per_m();
        Bent {
            deflection_m,
            slope_rad: 1.5 * deflection_m / self.length_m,
            shortening_m: 0.6 * deflection_m * deflection_m / self.length_m,
            bending_pa: self.fibre_pa(force_n.abs() * self.length_m),
            axial_pa: 0.0,
            axial_n: 0.0,
        }
    }

    fn bend_held(&self, force_n: f64) -> Bent {
        let (section, spans) = self.spans();
        let span = section.bend(force_n / spans);
        Bent {
            deflection_m: span.deflection_m,
            slope_rad: 0.0,
            shortening_m: 0.0,
            bending_pa: self.fibre_pa(span.moment_nm),
            axial_pa: span.axial_n / self.area_m2(),
            axial_n: span.axial_n,
        }
    }

    /// Stress in the outer fibre, half a thickness from the middle, in Pa.
    fn fibre_pa(&self, moment_nm: f64) -> f64 {
        moment_nm * 0.5 * self.thickness_m / self.second_moment_m4()
    }

    /// The spans between a clamp and the magnet, and how many share the force: no cross-section turns where
    /// the magnet sits, so that a beam held at both ends is two guided ones.
    fn spans(&self) -> (stretching::Span, f64) {
        let spans = match self.support {
            Support::ClampedClamped => 2.0,
            Support::ClampedFree | Support::ClampedGuided => 1.0,
        };
        let span = stretching::Span {
            length_m: self.length_m / spans,
            stiffness_nm2: self.modulus_pa * self.second_moment_m4(),
            gyration_m: self.thickness_m / 12.0_f64.sqrt(),
        };
        (span, spans)
    }
}

#[cfg(test)]
mod tests;
