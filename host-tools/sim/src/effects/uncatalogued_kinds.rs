//! The kinds of effect outside the catalogue: physics, unit and range of the magnitude, covariates.
//!
//! All magnitudes are assumed. The typical ones raise the error of the base model to between two and six noise floors in a
//! campaign of 3 x 30 s.

use super::kind::{EffectKind, VARIATION};
use model_export::effects::SimulatedMagnitude;

/// Relative variation between sensors of an effect that depends on how its part is mounted.
const MOUNTING: f64 = 0.4;

/// All kinds; the random streams follow those of the catalogue.
pub const KINDS: [EffectKind; 15] = [
    SCREW_RIPPLE,
    CROSS_TERM,
    UNLOGGED,
    STRESSED_PIN,
    WARM_LEAKAGE,
    WRIST_POLES,
    GUIDE_RIPPLE,
    BODY_BENDING,
    BRACKET_LAG,
    OVERHANG,
    CLEARANCE,
    CABLE_PULL,
    WIPER_DRAG,
    RATE_GAIN,
    BRACKET_SOFTENING,
];

/// A kind whose magnitude varies from sensor to sensor.
const fn kind(
    id: &'static str,
    (typical, unit): (f64, &'static str),
    (random_stream, range): (u32, (f64, f64)),
    meaning: &'static str,
    equation: &'static str,
    covariates: &'static [&'static str],
) -> EffectKind {
    EffectKind {
        id,
        typical,
        unit,
        magnitude: SimulatedMagnitude { random_stream, range, meaning, shared: false },
        variation: MOUNTING,
        is_in_catalogue: false,
        equation,
        covariates,
    }
}

/// The same with one magnitude for all sensors.
const fn shared(kind: EffectKind) -> EffectKind {
    EffectKind { magnitude: SimulatedMagnitude { shared: true, ..kind.magnitude }, ..kind }
}

/// Longitudinal motion of the magnet with the screw's turn: the only one that also acts in the closed loop.
pub const SCREW_RIPPLE: EffectKind = EffectKind {
    variation: VARIATION,
    ..kind(
        "screw_ripple",
        (2.0, "um"),
        (23, (-50.0, 50.0)),
        "longitudinal motion of the magnet with the screw's turn",
        "dz = a sin(2 pi opening/lead)",
        &["opening_mm"],
    )
};

/// Field proportional to a product of two covariates, equal at all sensors.
pub const CROSS_TERM: EffectKind = shared(kind(
    "cross_term",
    (1.0, "G"),
    (24, (-50.0, 50.0)),
    "field of current times opening: 10 A, 10 mm off the middle",
    "B + b iq/10 A (opening - 15 mm)/10 mm",
    &["motor_iq_a", "opening_mm"],
));

/// Field of which no covariate is recorded, equal at all sensors.
pub const UNLOGGED: EffectKind = shared(kind(
    "unlogged",
    (3.0, "G"),
    (25, (0.0, 50.0)),
    "greatest field of a disturbance that nobody records",
    "B + b(t)",
    &[],
));

/// The grip bends a steel pin of the guide, and mechanical stress changes the magnetisation of steel (Villari effect). The
/// pin's stray field at the sensor changes as the finger slides along it.
pub const STRESSED_PIN: EffectKind = kind(
    "stressed_pin",
    (2.0, "G"),
    (26, (-50.0, 50.0)),
    "field of a stressed pin: 100 N, 20 mm from its middle",
    "B + b Fx/100 N (opening - 15 mm)/20 mm",
    &["fx_n", "opening_mm"],
);

/// A ferrite sleeve carries the return flux of the motor's wires. Its permeability changes with temperature, and with it
/// the part of the wires' field that is not cancelled: current times temperature.
pub const WARM_LEAKAGE: EffectKind = kind(
    "warm_leakage",
    (6.0, "G"),
    (27, (-50.0, 50.0)),
    "field of a ferrite sleeve: 10 A, 10 K above 25 C",
    "B + b iq/10 A (T - 25 C)/10 K",
    &["motor_iq_a", "temp_c"],
);

/// The arm's roll joint has a motor with magnets behind a gear. Its rotor's stray field passes the gripper several times
/// per turn of the joint.
pub const WRIST_POLES: EffectKind = kind(
    "wrist_poles",
    (1.0, "G"),
    (28, (-50.0, 50.0)),
    "amplitude of the field of the roll joint's rotor",
    "B + b sin(n roll + phase)",
    &["roll_rad"],
);

/// The balls of the linear guide enter its loaded zone one after another and displace the carriage laterally, once per
/// ball: a period of the opening that is not the screw's lead.
pub const GUIDE_RIPPLE: EffectKind = kind(
    "guide_ripple",
    (2.5, "um"),
    (29, (-50.0, 50.0)),
    "amplitude of the carriage's lateral motion with the balls",
    "dx = a sin(2 pi opening/p + phase)",
    &["opening_mm"],
);

/// The gripper's body, held at the flange, bends under its own weight and inertia. The part across the plane of motion
/// changes the gap; the catalogue's fingertip mass only acts in that plane.
pub const BODY_BENDING: EffectKind = kind(
    "body_bending",
    (1.5, "um"),
    (30, (-50.0, 50.0)),
    "growth of the gap by a bending body at 1 g along y",
    "dy = a accel_y/g",
    &["accel_y_mps2"],
);

/// The sensor's bracket has more heat capacity than the board with the thermometer. While their temperatures differ, the two
/// bend like a bimetal and shift the magnet along z.
pub const BRACKET_LAG: EffectKind = kind(
    "bracket_lag",
    (0.7, "um/K"),
    (31, (-50.0, 50.0)),
    "longitudinal shift by board temperature minus bracket's",
    "dz = a (T - L), tau L' = T - L, L = T at the start of a recording",
    &["temp_c"],
);

/// The finger hangs on its guide by a length that changes with the opening, and the guide yields under the moment of the
/// longitudinal load: a compliance that depends on the opening.
pub const OVERHANG: EffectKind = kind(
    "overhang",
    (3.0, "%"),
    (32, (-50.0, 50.0)),
    "growth of the longitudinal compliance 20 mm off the middle",
    "Fz (1 + c (opening - 25 mm)/20 mm)",
    &["fz_n", "opening_mm"],
);

/// A bolted joint has clearance and a preload. Where the longitudinal load exceeds the preload the joint moves from one
/// side of its clearance to the other: a step that saturates on both sides, at a load that is not zero.
pub const CLEARANCE: EffectKind = kind(
    "clearance",
    (2.0, "N"),
    (33, (-50.0, 50.0)),
    "half the step of a joint's clearance, as longitudinal force",
    "Fz + a tanh((Fz - f0)/w)",
    &["fz_n"],
);

/// A cable is held at the palm and at the finger. Its free length grows with the opening, and with it the mass whose weight
/// and inertia across the plane pull the finger sideways.
pub const CABLE_PULL: EffectKind = kind(
    "cable_pull",
    (0.15, "kg"),
    (34, (-5.0, 5.0)),
    "mass of the cable that pulls along x, at an opening of 40 mm",
    "Fx + m accel_y opening/40 mm",
    &["accel_y_mps2", "opening_mm"],
);

/// A textile wiper on the screw drags the finger in the direction of its motion, almost independently of the speed.
pub const WIPER_DRAG: EffectKind = kind(
    "wiper_drag",
    (1.5, "N"),
    (35, (-50.0, 50.0)),
    "lateral drag of a wiper while the opening changes",
    "Fx + a tanh(v/v0), v the speed of the opening",
    &["opening_mm"],
);

/// A Hall element alternates the direction of its supply (spinning current) and averages. Where the field changes between
/// two phases a residue remains: the gain of one axis falls with the rate of the load.
pub const RATE_GAIN: EffectKind = kind(
    "rate_gain",
    (3.0, "%"),
    (36, (-50.0, 50.0)),
    "loss of gain of the x axis at a load rate of 500 N/s",
    "Bx (1 - c |dFx/dt|/500 N/s), x axis of the element",
    &["fx_n"],
);

/// The printed bracket of the sensor softens with temperature. The weight and inertia of its board, whose centre of mass
/// is off the bracket's axis, then turn the sensor about x.
pub const BRACKET_SOFTENING: EffectKind = kind(
    "bracket_softening",
    (3.0, "mrad"),
    (37, (-100.0, 100.0)),
    "rotation of the sensor at 1 g along z, 10 K above 25 C",
    "element rotated about x by a accel_z/g (T - 25 C)/10 K",
    &["accel_z_mps2", "temp_c"],
);
