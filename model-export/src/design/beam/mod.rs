//! Flexure: a straight beam of constant section under a transverse force, at large deflections.
//!
//! Von Karman's equations: `N = EA (u' + w'^2/2)`, `N' = 0`, `EI w'''' = N w''` between the loads. With both
//! ends clamped, the axial force `N` grows with the square of the deflection. With a free end it is zero: the
//! deflection is that of the linear beam, and the second-order terms are shortening and slope of the tip.
//!
//! Rotations are moderate: against the exact inextensible cantilever (Bisshopp and Drucker, Quarterly of
//! Applied Mathematics 3, 1945) deflection and shortening are within 2 % up to [`MODERATE_SLOPE_RAD`]. Shear is
//! neglected: it adds about 0.8 (t/L)^2 to the compliance of a cantilever.

use serde::{Deserialize, Serialize};

/// Tip slope of a cantilever up to which deflection and shortening are within 2 % of the exact solution.
pub const MODERATE_SLOPE_RAD: f64 = 0.15;

/// Boundary conditions of a beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Support {
    /// Clamped at one end, force and magnet at the free end.
    ClampedFree,
    /// Clamped at both ends, force and magnet in the middle.
    ClampedClamped,
    /// Clamped at one end; the other, with force and magnet, is guided: no rotation, no axial motion.
    ClampedGuided,
}

impl Support {
    /// All variants.
    pub const ALL: [Self; 3] = [Self::ClampedFree, Self::ClampedClamped, Self::ClampedGuided];

    /// Name in a design file.
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
    /// Boundary conditions.
    pub support: Support,
    /// Young's modulus in Pa.
    pub modulus_pa: f64,
}

/// Response of a beam at the magnet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamResponse {
    /// Deflection along the force, in m.
    pub deflection_m: f64,
    /// Slope at the magnet in rad.
    pub slope_rad: f64,
    /// Deflection of the guide in m.
    pub shortening_m: f64,
    /// Maximum bending stress, in the outer fibre at a clamp, in Pa.
    pub bending_pa: f64,
    /// Axial stress in Pa.
    pub axial_pa: f64,
    /// Axial force in N.
    pub axial_n: f64,
}

impl BeamResponse {
    /// Maximum total stress in Pa.
    pub(crate) fn stress_pa(&self) -> f64 {
        self.bending_pa + self.axial_pa
    }

    /// Equivalent fully reversed stress amplitude in Pa. The axial stress keeps its sign under reversed load,
    /// which gives a mean stress; rule of Smith, Watson and Topper (Dowling et al., Fatigue Fract. Engng.
    /// Mater. Struct. 32, 2009).
    pub(crate) fn reversed_pa(&self) -> f64 {
        (self.stress_pa() * self.bending_pa).sqrt()
    }
}

impl Beam {
    /// Area of the section in m^2.
    pub(crate) fn area_m2(&self) -> f64 {
        self.width_m * self.thickness_m
    }

    /// Second moment of the section in m^4.
    pub(crate) fn second_moment_m4(&self) -> f64 {
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

    /// Response to a force in N, of either sign.
    pub fn bend(&self, force_n: f64) -> BeamResponse {
        match self.support {
            Support::ClampedFree => self.bend_free(force_n),
            Support::ClampedClamped | Support::ClampedGuided => self.bend_clamped(force_n),
        }
    }

    fn bend_free(&self, force_n: f64) -> BeamResponse {
        let deflection_m = force_n / self.stiffness_n_per_m();
        BeamResponse {
            deflection_m,
            slope_rad: 1.5 * deflection_m / self.length_m,
            shortening_m: 0.6 * deflection_m * deflection_m / self.length_m,
            bending_pa: self.fibre_pa(force_n.abs() * self.length_m),
            axial_pa: 0.0,
            axial_n: 0.0,
        }
    }

    fn bend_clamped(&self, force_n: f64) -> BeamResponse {
        let (section, spans) = self.spans();
        let span = section.bend(force_n / spans);
        BeamResponse {
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

    /// Spans between a clamp and the magnet, and their number: the section at the magnet does not rotate, so
    /// that a beam clamped at both ends is two guided ones.
    fn spans(&self) -> (Span, f64) {
        let spans = match self.support {
            Support::ClampedClamped => 2.0,
            Support::ClampedFree | Support::ClampedGuided => 1.0,
        };
        let span = Span {
            length_m: self.length_m / spans,
            stiffness_nm2: self.modulus_pa * self.second_moment_m4(),
            gyration_m: self.thickness_m / 12.0_f64.sqrt(),
        };
        (span, spans)
    }
}

#[cfg(test)]
mod tests;

/// A span between a clamp and a guide, which stretches as it bends. With the axial force `N` and `u = (l/2)
/// sqrt(N / EI)`, the deflection under a force `V` is `w = V l^3 / (4 EI) (u - tanh u) / u^3`; the elongation
/// `N l / EA = 1/2 int w'^2` relates `V` to `u`. Both are explicit in `u` (Timoshenko), so that one equation
/// remains to be solved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) length_m: f64,
    /// EI in N m^2.
    pub(super) stiffness_nm2: f64,
    /// Radius of gyration of the section, sqrt(I/A), in m.
    pub(super) gyration_m: f64,
}

/// Response of a span.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretched {
    /// Motion of the guide in m.
    pub(super) deflection_m: f64,
    /// Maximum moment, at both ends, in N m.
    pub(super) moment_nm: f64,
    /// Axial force in N.
    pub(super) axial_n: f64,
}

/// Derivatives of tanh at zero as a series: the coefficients of u, u^3, u^5, ...
const TANH: [f64; 8] = [
    1.0,
    -1.0 / 3.0,
    2.0 / 15.0,
    -17.0 / 315.0,
    62.0 / 2835.0,
    -1382.0 / 155_925.0,
    21_844.0 / 6_081_075.0,
    -929_569.0 / 638_512_875.0,
];

/// Below this argument the series is exact to 1e-11, above it the closed form to 1e-12.
const SMALL: f64 = 0.2;

/// Relative accuracy of a solution.
const ACCURACY: f64 = 1e-13;

impl Span {
    /// Under a force in N, of either sign.
    pub(super) fn bend(&self, force_n: f64) -> Stretched {
        let load = force_n.abs() / self.force_scale_n();
        // The force is convex in u and the start is not below the solution: Newton's method converges
        // monotonically.
        let start = (load / 60.0_f64.sqrt()).min((load / 8.0_f64.sqrt()).cbrt());
        let u = solve(load, start);
        let half_m = 0.5 * self.length_m;
        Stretched {
            deflection_m: (self.gyration_m * deflection_share(u)).copysign(force_n),
            moment_nm: force_n.abs() * half_m * (1.0 - u * u * slack(u)),
            axial_n: self.stiffness_nm2 * (u / half_m).powi(2),
        }
    }

    /// Force in N for which [`force_share`] is one.
    fn force_scale_n(&self) -> f64 {
        4.0 * self.stiffness_nm2 * self.gyration_m / self.length_m.powi(3)
    }
}

/// Dimensionless force `V l^3 / (4 EI r)`, in units of [`Span::force_scale_n`].
fn force_share(u: f64) -> f64 {
    u * (8.0 / stretch(u)).sqrt()
}

/// Deflection in units of the radius of gyration.
fn deflection_share(u: f64) -> f64 {
    force_share(u) * slack(u)
}

/// `(u - tanh u) / u^3`: 1/3 without axial force, decreasing with it.
fn slack(u: f64) -> f64 {
    if u > SMALL {
        return (u - u.tanh()) / u.powi(3);
    }
    let terms = TANH.iter().skip(1).rev();
    terms.fold(0.0, |sum, term| sum * u * u - term)
}

/// `(3/2 - 3/2 tanh u / u - 1/2 tanh^2 u) / u^4`, of the integral of `w'^2`.
fn stretch(u: f64) -> f64 {
    if u > SMALL {
        let tanh = u.tanh();
        return (1.5 - 1.5 * tanh / u - 0.5 * tanh * tanh) / u.powi(4);
    }
    // tanh^2 = 1 - d tanh/du: weighted coefficients of tanh.
    let terms = TANH.iter().enumerate().skip(2).rev();
    terms.fold(0.0, |sum, (n, term)| sum * u * u + (n as f64 - 1.0) * term)
}

/// Solves [`force_share`]`(u) = value` by Newton's method with numerical derivatives.
fn solve(value: f64, start: f64) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let mut u = start;
    for _ in 0..60 {
        let step = 1e-5 * u;
        let slope = (force_share(u + step) - force_share(u - step)) / (2.0 * step);
        let next = u - (force_share(u) - value) / slope;
        // Keeps u positive.
        let next = next.max(0.1 * u);
        let done = (next - u).abs() <= ACCURACY * u;
        u = next;
        if done {
            break;
        }
    }
    u
}
