//! A span between a clamp and a guide: it cannot bend without getting longer.
//!
//! With the pull `N` and `u = (l/2) sqrt(N / EI)`, the guided span under a force `V` has
//! `w = V l^3 / (4 EI) (u - tanh u) / u^3`; the stretch that the bent curve needs,
//! `N l / EA = 1/2 int w'^2`, ties `V` to `u`. Both follow from one another in closed form by `u`, as in
//! Timoshenko's treatment of plates and beams with held edges, and one equation is left to solve.

/// A guided span.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Length in m.
    pub(super) length_m: f64,
    /// EI in N m^2.
    pub(super) stiffness_nm2: f64,
    /// Radius of gyration of the section, sqrt(I/A), in m.
    pub(super) gyration_m: f64,
}

/// A span under load.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretched {
    /// Motion of the guide in m.
    pub(super) deflection_m: f64,
    /// Greatest moment, at both ends, in N m.
    pub(super) moment_nm: f64,
    /// Pull in N.
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

/// Below this the series is exact to 1e-11, above it the closed form loses no more than 1e-12.
const SMALL: f64 = 0.2;

/// Relative accuracy of a solution.
const ACCURACY: f64 = 1e-13;

impl Span {
    /// Under a force in N, of either sign.
    pub(super) fn bend(&self, force_n: f64) -> Stretched {
        let load = force_n.abs() / self.force_scale_n();
        // The force is convex in u and never below either of its two ends, so that Newton's steps go down
        // from here to the solution.
        let start = (load / 60.0_f64.sqrt()).min((load / 8.0_f64.sqrt()).cbrt());
        let u = solve(load, start, force_share);
        let half_m = 0.5 * self.length_m;
        Stretched {
            deflection_m: (self.gyration_m * deflection_share(u)).copysign(force_n),
            moment_nm: force_n.abs() * half_m * (1.0 - u * u * slack(u)),
            axial_n: self.stiffness_nm2 * (u / half_m).powi(2),
        }
    }

    /// Force in N that moves the guide by `deflection_m`.
    pub(super) fn force_at(&self, deflection_m: f64) -> f64 {
        let share = deflection_m.abs() / self.gyration_m;
        let start = share * 3.0 / 60.0_f64.sqrt();
        let u = solve(share, start, deflection_share);
        (self.force_scale_n() * force_share(u)).copysign(deflection_m)
    }

    /// Force in N for which [`force_share`] is one.
    fn force_scale_n(&self) -> f64 {
        4.0 * self.stiffness_nm2 * self.gyration_m / self.length_m.powi(3)
    }
}

/// Force by [`Span::force_scale_n`]: `V l^3 / (4 EI r)`.
fn force_share(u: f64) -> f64 {
    u * (8.0 / stretch(u)).sqrt()
}

/// Deflection by the radius of gyration.
fn deflection_share(u: f64) -> f64 {
    force_share(u) * slack(u)
}

/// `(u - tanh u) / u^3`: a third where nothing pulls, less the more it does.
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
    // tanh^2 is one less the derivative of tanh: its coefficients are those of tanh, weighted.
    let terms = TANH.iter().enumerate().skip(2).rev();
    terms.fold(0.0, |sum, (n, term)| sum * u * u + (n as f64 - 1.0) * term)
}

/// Where `of` is `value`, by Newton's steps with a differentiated quotient.
fn solve(value: f64, start: f64, of: fn(f64) -> f64) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let mut u = start;
    for _ in 0..60 {
        let step = 1e-5 * u;
        let slope = (of(u + step) - of(u - step)) / (2.0 * step);
        let next = u - (of(u) - value) / slope;
        // Never below zero, whatever the quotient says.
        let next = next.max(0.1 * u);
        let done = (next - u).abs() <= ACCURACY * u;
        u = next;
        if done {
            break;
        }
    }
    u
}
