//! Equations of the effects outside the catalogue, and the values that a seed draws for each sensor.

use super::{Conditions, Contribution};
use crate::effects::EffectKind;
use crate::effects::uncatalogued_kinds::{
    BODY_BENDING, BRACKET_LAG, BRACKET_SOFTENING, CABLE_PULL, CLEARANCE, CROSS_TERM, GUIDE_RIPPLE,
    OVERHANG, RATE_GAIN, STRESSED_PIN, UNLOGGED, WARM_LEAKAGE, WIPER_DRAG, WRIST_POLES,
};
use crate::motion::GRAVITY;
use crate::random::{Purpose, SineSum, sign, stream, uniform, unit_vector};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::TAU;

/// Ranges of the nonlinear parameters, all assumed.
pub const RANGES: Ranges = Ranges {
    // Between half the screw's lead and the lead, and away from both.
    ball_mm: [1.9, 2.8],
    poles_per_rev: [3.0, 6.0],
    lag_s: [3.0, 8.0],
    preload_n: [25.0, 60.0],
    width_n: [3.0, 6.0],
    drag_mm_per_s: [0.5, 3.0],
};

/// Ranges of the nonlinear parameters.
#[derive(Clone, Copy, Debug)]
pub struct Ranges {
    /// Period of the guide's balls, in mm of opening.
    pub ball_mm: [f64; 2],
    /// Periods of the roll joint's rotor in a turn of the joint.
    pub poles_per_rev: [f64; 2],
    /// Time constant of the bracket's temperature in seconds.
    pub lag_s: [f64; 2],
    /// Preload of the joint, either sign, in newtons.
    pub preload_n: [f64; 2],
    /// Load over which the clearance closes, in newtons.
    pub width_n: [f64; 2],
    /// Speed at which the wiper's drag reaches 76 % of its maximum, in mm/s.
    pub drag_mm_per_s: [f64; 2],
}

/// Current, and opening off the zero, at which the product of both is specified.
const PRODUCT_AT: (f64, f64) = (10.0, 10.0);
/// Opening at which the products with the opening are zero, in mm.
const PRODUCT_ZERO_MM: f64 = 15.0;
/// Openings off the zero, load, current and temperature at which the others are specified.
const OFF_MM: f64 = 20.0;
const LOAD_N: f64 = 100.0;
const CURRENT_A: f64 = 10.0;
const WARM_K: f64 = 10.0;
/// Opening in the middle of the stroke, in mm, where the overhang is that of the calibration.
const MIDDLE_MM: f64 = 25.0;
/// Opening at which the cable's mass is specified, in mm; none of it is free with the gripper closed.
const FREE_MM: f64 = 40.0;
/// Load rate at which the loss of gain is specified, in N/s.
const RATE_N_PER_S: f64 = 500.0;

/// Frequency range of the disturbance: that of the loads, and slower.
const DISTURBANCE_HZ: [f64; 2] = [0.03, 0.6];
/// Sines of each axis.
const SINES: u32 = 6;

/// Stream part of values that are equal in all sensors.
const GRIPPER: u32 = 0xffff;

/// One effect in one sensor: its drawn values. Its [kind](Law::kind) has the physics and the equation.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Law {
    CrossTerm {
        b_g: [f64; 3],
    },
    Unlogged {
        #[serde(skip)]
        disturbance: [SineSum; 3],
    },
    StressedPin {
        b_g: [f64; 3],
    },
    WarmLeakage {
        b_g: [f64; 3],
    },
    WristPoles {
        b_g: [f64; 3],
        n_per_rev: f64,
        phase_rad: f64,
    },
    GuideRipple {
        a_mm: f64,
        p_mm: f64,
        phase_rad: f64,
    },
    BodyBending {
        a_mm: f64,
    },
    BracketLag {
        a_mm_per_k: f64,
        tau_s: f64,
        #[serde(skip)]
        bracket_k: f64,
    },
    Overhang {
        c: f64,
    },
    Clearance {
        a_n: f64,
        f0_n: f64,
        w_n: f64,
    },
    CablePull {
        m_kg: f64,
    },
    WiperDrag {
        a_n: f64,
        v0_mm_per_s: f64,
    },
    RateGain {
        c: f64,
    },
    BracketSoftening {
        a_rad: f64,
    },
}

impl Law {
    /// Draws the law of a kind with its magnitude in a sensor; none for kinds that are simulated elsewhere.
    pub fn draw(kind: &EffectKind, size: f64, seed: u64, sensor: u32) -> Option<Self> {
        let number = kind.magnitude.random_stream << 16;
        let mut gripper = stream(seed, Purpose::Uncatalogued, number | GRIPPER);
        let mut own = stream(seed, Purpose::Uncatalogued, number | sensor);
        let mut of_gripper = |[min, max]: [f64; 2]| uniform(&mut gripper, min, max);
        let field = |rng: &mut ChaCha8Rng| (unit_vector(rng) * size).into();
        let phase = |rng: &mut ChaCha8Rng| uniform(rng, 0.0, TAU);
        Some(match kind.id {
            // One stream of the whole gripper for both.
            id if id == CROSS_TERM.id || id == UNLOGGED.id => {
                let mut rng = stream(seed, Purpose::Uncatalogued, 0);
                let b_g = field(&mut rng);
                if id == CROSS_TERM.id {
                    return Some(Self::CrossTerm { b_g });
                }
                let peaks: [f64; 3] = field(&mut rng);
                let waves = |peak| SineSum::draw(&mut rng, SINES, DISTURBANCE_HZ, peak);
                Self::Unlogged { disturbance: peaks.map(waves) }
            }
            id if id == STRESSED_PIN.id => Self::StressedPin { b_g: field(&mut own) },
            id if id == WARM_LEAKAGE.id => Self::WarmLeakage { b_g: field(&mut own) },
            id if id == WRIST_POLES.id => Self::WristPoles {
                b_g: field(&mut own),
                n_per_rev: of_gripper(RANGES.poles_per_rev),
                phase_rad: phase(&mut own),
            },
            id if id == GUIDE_RIPPLE.id => Self::GuideRipple {
                a_mm: 1e-3 * size,
                p_mm: of_gripper(RANGES.ball_mm),
                phase_rad: phase(&mut own),
            },
            id if id == BODY_BENDING.id => Self::BodyBending { a_mm: 1e-3 * size },
            id if id == BRACKET_LAG.id => Self::BracketLag {
                a_mm_per_k: 1e-3 * size,
                tau_s: of_gripper(RANGES.lag_s),
                bracket_k: 0.0,
            },
            id if id == OVERHANG.id => Self::Overhang { c: 0.01 * size },
            id if id == CLEARANCE.id => {
                let [min, max] = RANGES.preload_n;
                Self::Clearance {
                    a_n: size,
                    f0_n: sign(&mut own) * uniform(&mut own, min, max),
                    w_n: uniform(&mut own, RANGES.width_n[0], RANGES.width_n[1]),
                }
            }
            // The loops of the two fingers are mirrored.
            id if id == CABLE_PULL.id => Self::CablePull { m_kg: size * side(sensor) },
            id if id == WIPER_DRAG.id => Self::WiperDrag {
                a_n: size * side(sensor),
                v0_mm_per_s: of_gripper(RANGES.drag_mm_per_s),
            },
            id if id == RATE_GAIN.id => Self::RateGain { c: 0.01 * size },
            id if id == BRACKET_SOFTENING.id => Self::BracketSoftening { a_rad: 1e-3 * size },
            _ => return None,
        })
    }

    /// The kind of this law.
    pub fn kind(&self) -> &'static EffectKind {
        match self {
            Self::CrossTerm { .. } => &CROSS_TERM,
            Self::Unlogged { .. } => &UNLOGGED,
            Self::StressedPin { .. } => &STRESSED_PIN,
            Self::WarmLeakage { .. } => &WARM_LEAKAGE,
            Self::WristPoles { .. } => &WRIST_POLES,
            Self::GuideRipple { .. } => &GUIDE_RIPPLE,
            Self::BodyBending { .. } => &BODY_BENDING,
            Self::BracketLag { .. } => &BRACKET_LAG,
            Self::Overhang { .. } => &OVERHANG,
            Self::Clearance { .. } => &CLEARANCE,
            Self::CablePull { .. } => &CABLE_PULL,
            Self::WiperDrag { .. } => &WIPER_DRAG,
            Self::RateGain { .. } => &RATE_GAIN,
            Self::BracketSoftening { .. } => &BRACKET_SOFTENING,
        }
    }

    /// Adds the effect under these conditions; a lag advances in time.
    pub(super) fn add(&mut self, at: &Conditions, sum: &mut Contribution) {
        let now = &at.now;
        let [fx_n, fz_n] = now.load_n;
        let [_, accel_y, accel_z] = now.specific_force.into();
        let off_mm = now.opening_mm - PRODUCT_ZERO_MM;
        let mut add_field = |b_g: &[f64; 3], factor: f64| {
            sum.field_g += Vector3::from(*b_g) * factor;
        };
        match self {
            Self::CrossTerm { b_g } => {
                add_field(b_g, now.current_a / PRODUCT_AT.0 * (off_mm / PRODUCT_AT.1));
            }
            Self::Unlogged { disturbance } => {
                let field_g = disturbance.each_ref().map(|waves| waves.at(now.session_s));
                add_field(&field_g, 1.0);
            }
            Self::StressedPin { b_g } => add_field(b_g, fx_n / LOAD_N * (off_mm / OFF_MM)),
            Self::WarmLeakage { b_g } => {
                add_field(b_g, now.current_a / CURRENT_A * (now.warm_k / WARM_K));
            }
            Self::WristPoles { b_g, n_per_rev, phase_rad } => {
                add_field(b_g, libm::sin(*n_per_rev * now.roll_rad + *phase_rad));
            }
            Self::GuideRipple { a_mm, p_mm, phase_rad } => {
                let turned = TAU * now.opening_mm / *p_mm + *phase_rad;
                sum.displacement_mm.x += *a_mm * libm::sin(turned);
            }
            Self::BodyBending { a_mm } => sum.displacement_mm.y += *a_mm * accel_y / GRAVITY,
            Self::BracketLag { a_mm_per_k, tau_s, bracket_k } => {
                if at.since_s == 0.0 {
                    *bracket_k = now.warm_k;
                }
                *bracket_k -= (now.warm_k - *bracket_k) * libm::expm1(-at.since_s / *tau_s);
                sum.displacement_mm.z += *a_mm_per_k * (now.warm_k - *bracket_k);
            }
            Self::Overhang { c } => {
                sum.force_n[1] += *c * fz_n * (now.opening_mm - MIDDLE_MM) / OFF_MM;
            }
            Self::Clearance { a_n, f0_n, w_n } => {
                sum.force_n[1] += *a_n * libm::tanh((fz_n - *f0_n) / *w_n);
            }
            Self::CablePull { m_kg } => {
                sum.force_n[0] += *m_kg * accel_y * now.opening_mm / FREE_MM;
            }
            Self::WiperDrag { a_n, v0_mm_per_s } => {
                sum.force_n[0] += *a_n * libm::tanh(at.opening_mm_per_s / *v0_mm_per_s);
            }
            Self::RateGain { c } => {
                sum.gain.x -= *c * at.lateral_n_per_s.abs() / RATE_N_PER_S;
            }
            Self::BracketSoftening { a_rad } => {
                sum.rotation_rad.x += *a_rad * accel_z / GRAVITY * (now.warm_k / WARM_K);
            }
        }
    }
}

/// Sign of the direction to the opposite finger, as for the neighbouring magnet.
fn side(sensor: u32) -> f64 {
    if sensor.is_multiple_of(2) { 1.0 } else { -1.0 }
}
