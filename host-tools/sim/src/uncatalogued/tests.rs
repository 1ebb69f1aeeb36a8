//! Each effect outside the catalogue acts at one point of the chain, on its own covariates, and vanishes without them.

use super::*;
use crate::effects::uncatalogued_kinds::*;
use crate::effects::{EffectKind, Effects};
use std::f64::consts::TAU;

/// One sensor of a gripper of four, with one effect.
fn drawn(effect: &str, seed: u64, sensor: u32) -> UncataloguedEffects {
    let effects = Effects::new(&[effect.parse().unwrap()], seed, 4, 1.0).unwrap();
    UncataloguedEffects::draw(&effects, seed, sensor)
}

/// Nothing acts: opening and temperature are those at which the products vanish.
const REST: Covariates = Covariates {
    recording: 1,
    session_s: 0.0,
    load_n: [0.0; 2],
    opening_mm: 15.0,
    current_a: 0.0,
    warm_k: 0.0,
    specific_force: Vector3::new(0.0, 0.0, 0.0),
    roll_rad: 0.0,
};

/// Everything acts.
const BUSY: Covariates = Covariates {
    session_s: 3.0,
    load_n: [120.0, -70.0],
    opening_mm: 37.3,
    current_a: -6.0,
    warm_k: 8.0,
    specific_force: Vector3::new(3.0, -8.0, 6.0),
    roll_rad: 0.9,
    ..REST
};

const ZERO_CURRENT: Covariates = Covariates { current_a: 0.0, ..BUSY };
const ZERO_LATERAL: Covariates = Covariates { load_n: [0.0, -70.0], ..BUSY };
const WEIGHTLESS: Covariates = Covariates { specific_force: REST.specific_force, ..BUSY };

/// Shortly before [`BUSY`].
const EARLIER: Covariates = Covariates { opening_mm: 37.2, warm_k: 7.9, ..BUSY };

/// Contribution after `before`, an eighth of a second earlier, in the same recording.
fn after(effects: &UncataloguedEffects, before: Covariates, now: Covariates) -> Contribution {
    let mut effects = effects.clone();
    effects.advance(Covariates { session_s: now.session_s - 0.125, ..before });
    effects.advance(now)
}

/// `at` with one recorded column changed.
fn with_changed(at: Covariates, column: &str) -> Covariates {
    let mut at = at;
    match column {
        "fx_n" => at.load_n[0] -= 31.0,
        "fz_n" => at.load_n[1] += 140.0,
        "opening_mm" => at.opening_mm -= 3.9,
        "motor_iq_a" => at.current_a += 2.3,
        "temp_c" => at.warm_k -= 2.9,
        "accel_x_mps2" => at.specific_force.x += 1.7,
        "accel_y_mps2" => at.specific_force.y += 1.7,
        "accel_z_mps2" => at.specific_force.z += 1.7,
        "roll_rad" => at.roll_rad += 0.21,
        "session_s" => at.session_s += 2.0,
        other => panic!("{other}"),
    }
    at
}

const COLUMNS: [&str; 10] = [
    "fx_n",
    "fz_n",
    "opening_mm",
    "motor_iq_a",
    "temp_c",
    "accel_x_mps2",
    "accel_y_mps2",
    "accel_z_mps2",
    "roll_rad",
    "session_s",
];

/// Kinds of this module with recorded covariates.
fn recorded() -> impl Iterator<Item = EffectKind> {
    KINDS.into_iter().filter(|kind| ![SCREW_RIPPLE.id, UNLOGGED.id].contains(&kind.id))
}

#[test]
fn effect_depends_on_its_covariates_and_on_no_other() {
    for kind in recorded() {
        let effects = drawn(kind.id, 3, 1);
        for column in COLUMNS {
            let changed = with_changed(BUSY, column);
            let differs = after(&effects, EARLIER, BUSY) != after(&effects, EARLIER, changed);
            assert_eq!(differs, kind.covariates.contains(&column), "{} {column}", kind.id);
        }
    }
}

/// Names of the points of the chain at which a contribution acts.
fn points(sum: &Contribution) -> Vec<&'static str> {
    let [dx, dy, dz] = sum.displacement_mm.into();
    let [rx, ry, rz] = sum.rotation_rad.into();
    let [gx, gy, gz] = sum.gain.into();
    let [fx, fz] = sum.force_n;
    let values = [
        ("force x", fx),
        ("force z", fz),
        ("dx", dx),
        ("dy", dy),
        ("dz", dz),
        ("field", sum.field_g.norm()),
        ("rotation x", rx),
        ("rotation y or z", ry.hypot(rz)),
        ("gain x", gx),
        ("gain y or z", gy.hypot(gz)),
    ];
    values.into_iter().filter(|(_, value)| *value != 0.0).map(|(name, _)| name).collect()
}

#[test]
fn effect_acts_at_one_point_of_the_chain() {
    let expected = [
        (CROSS_TERM, "field"),
        (STRESSED_PIN, "field"),
        (WARM_LEAKAGE, "field"),
        (WRIST_POLES, "field"),
        (GUIDE_RIPPLE, "dx"),
        (BODY_BENDING, "dy"),
        (BRACKET_LAG, "dz"),
        (OVERHANG, "force z"),
        (CLEARANCE, "force z"),
        (CABLE_PULL, "force x"),
        (WIPER_DRAG, "force x"),
        (RATE_GAIN, "gain x"),
        (BRACKET_SOFTENING, "rotation x"),
    ];
    assert_eq!(expected.len(), recorded().count());
    for (kind, point) in expected {
        assert_eq!(points(&after(&drawn(kind.id, 3, 1), REST, BUSY)), [point], "{}", kind.id);
    }
}

#[test]
fn products_vanish_with_either_factor() {
    let cases: [(EffectKind, [Covariates; 2]); 6] = [
        (CROSS_TERM, [ZERO_CURRENT, Covariates { opening_mm: 15.0, ..BUSY }]),
        (STRESSED_PIN, [ZERO_LATERAL, Covariates { opening_mm: 15.0, ..BUSY }]),
        (WARM_LEAKAGE, [ZERO_CURRENT, Covariates { warm_k: 0.0, ..BUSY }]),
        (
            OVERHANG,
            [Covariates { load_n: [120.0, 0.0], ..BUSY }, Covariates { opening_mm: 25.0, ..BUSY }],
        ),
        (CABLE_PULL, [WEIGHTLESS, Covariates { opening_mm: 0.0, ..BUSY }]),
        (BRACKET_SOFTENING, [WEIGHTLESS, Covariates { warm_k: 0.0, ..BUSY }]),
    ];
    for (kind, without) in cases {
        let effects = drawn(kind.id, 3, 2);
        assert_ne!(after(&effects, BUSY, BUSY), Contribution::default(), "{}", kind.id);
        for now in without {
            assert!(points(&after(&effects, BUSY, now)).is_empty(), "{} {now:?}", kind.id);
        }
    }
}

#[test]
fn rates_vanish_at_rest_and_at_the_start_of_a_recording() {
    for kind in [WIPER_DRAG, RATE_GAIN, BRACKET_LAG] {
        let effects = drawn(kind.id, 3, 0);
        assert!(points(&after(&effects, BUSY, BUSY)).is_empty(), "{}", kind.id);
        let mut new_recording = effects.clone();
        new_recording.advance(REST);
        let first = new_recording.advance(Covariates { recording: 2, ..BUSY });
        assert!(points(&first).is_empty(), "{}", kind.id);
    }
}

#[test]
fn magnitude_is_that_of_the_definition() {
    let size = |kind: &EffectKind| {
        Effects::new(&[kind.id.parse().unwrap()], 3, 4, 1.0).unwrap().each(kind.id, 1)
    };
    let at = |kind: &EffectKind, now: Covariates| after(&drawn(kind.id, 3, 1), REST, now);
    let near = |found: f64, kind: &EffectKind, unit: f64| {
        assert!((found.abs() / (unit * size(kind)) - 1.0).abs() < 1e-9, "{} {found}", kind.id);
    };
    let gravity = crate::motion::GRAVITY;
    let pressed = Covariates { load_n: [100.0, 0.0], opening_mm: 35.0, ..REST };
    near(at(&STRESSED_PIN, pressed).field_g.norm(), &STRESSED_PIN, 1.0);
    let hot = Covariates { current_a: 10.0, warm_k: 10.0, ..REST };
    near(at(&WARM_LEAKAGE, hot).field_g.norm(), &WARM_LEAKAGE, 1.0);
    let on_its_side =
        Covariates { specific_force: Vector3::new(0.0, gravity, 0.0), opening_mm: 40.0, ..REST };
    near(at(&BODY_BENDING, on_its_side).displacement_mm.y, &BODY_BENDING, 1e-3);
    near(at(&CABLE_PULL, on_its_side).force_n[0], &CABLE_PULL, gravity);
    let upright = Covariates { specific_force: Vector3::new(0.0, 0.0, gravity), ..hot };
    near(at(&BRACKET_SOFTENING, upright).rotation_rad.x, &BRACKET_SOFTENING, 1e-3);
    let open = Covariates { load_n: [0.0, 80.0], opening_mm: 45.0, ..REST };
    near(at(&OVERHANG, open).force_n[1], &OVERHANG, 0.8);
    // An eighth of a second after the unloaded gripper at rest: 500 N/s and 800 mm/s.
    near(at(&RATE_GAIN, Covariates { load_n: [62.5, 0.0], ..REST }).gain.x, &RATE_GAIN, 0.01);
    near(at(&WIPER_DRAG, Covariates { opening_mm: 115.0, ..REST }).force_n[0], &WIPER_DRAG, 1.0);
    let at_force =
        |fz_n: f64| at(&CLEARANCE, Covariates { load_n: [0.0, fz_n], ..REST }).force_n[1];
    near(0.5 * (at_force(250.0) - at_force(-250.0)), &CLEARANCE, 1.0);
}

#[test]
fn ripples_repeat_with_the_drawn_period_only() {
    for seed in 1..5 {
        let guide = drawn("guide_ripple", seed, 2);
        let Some(&Law::GuideRipple { p_mm, .. }) = guide.law("guide_ripple") else { panic!() };
        let x = |opening_mm: f64| {
            after(&guide, REST, Covariates { opening_mm, ..REST }).displacement_mm.x
        };
        let wrist = drawn("wrist_poles", seed, 2);
        let Some(&Law::WristPoles { n_per_rev, .. }) = wrist.law("wrist_poles") else { panic!() };
        let b = |roll_rad: f64| after(&wrist, REST, Covariates { roll_rad, ..REST }).field_g;
        assert!((x(20.3) - x(20.3 + p_mm)).abs() < 1e-12);
        assert!((b(0.3) - b(0.3 + TAU / n_per_rev)).norm() < 1e-9);
        let lead = crate::motion::LEAD_MM;
        let differs =
            |step: f64| (0..20).any(|i| (x(f64::from(i)) - x(f64::from(i) + step)).abs() > 5e-4);
        assert!(differs(lead) && differs(0.5 * lead) && differs(0.5 * p_mm), "{p_mm}");
    }
}

#[test]
fn bracket_follows_a_step_with_its_time_constant() {
    let mut effects = drawn("bracket_lag", 3, 0);
    let Some(&Law::BracketLag { tau_s, a_mm_per_k, .. }) = effects.law("bracket_lag") else {
        panic!()
    };
    effects.advance(REST);
    let mut z = 0.0;
    for step in 1..=1000 {
        let session_s = tau_s * 1e-3 * f64::from(step);
        z = effects.advance(Covariates { session_s, warm_k: 5.0, ..REST }).displacement_mm.z;
    }
    assert!((z / (5.0 * a_mm_per_k) - libm::exp(-1.0)).abs() < 1e-9, "{z}");
}

#[test]
fn unlogged_disturbance_depends_on_time_only_and_is_bounded() {
    let effects = drawn("unlogged=3", 3, 0);
    let at = |session_s: f64, at: Covariates| after(&effects, REST, Covariates { session_s, ..at });
    assert_eq!(at(2.0, REST), at(2.0, BUSY));
    let norms = (0..2000).map(|i| at(0.1 * f64::from(i), REST).field_g.norm());
    let max_field = norms.fold(0.0, f64::max);
    assert!((0.5..=3.0).contains(&max_field), "{max_field}");
}

#[test]
fn sensors_and_seeds_differ_and_are_reproducible() {
    for kind in KINDS.iter().filter(|kind| kind.id != SCREW_RIPPLE.id) {
        let law = |seed, sensor| drawn(kind.id, seed, sensor).law(kind.id).cloned().unwrap();
        assert_eq!(law(3, 1), law(3, 1), "{}", kind.id);
        assert_ne!(law(3, 1), law(4, 1), "{}", kind.id);
        // A field of the whole gripper is equal at all sensors.
        assert_eq!(law(3, 1) == law(3, 3), kind.magnitude.shared, "{}", kind.id);
    }
}

#[test]
fn nonlinear_parameters_fill_their_ranges_and_are_shared_where_stated() {
    let mut periods = Vec::new();
    for seed in 1..=200 {
        let of = |id: &str, sensor| drawn(id, seed, sensor).law(id).cloned().unwrap();
        let (Law::GuideRipple { p_mm, .. }, Law::GuideRipple { p_mm: other, .. }) =
            (of("guide_ripple", 0), of("guide_ripple", 3))
        else {
            panic!()
        };
        assert_eq!(p_mm, other);
        periods.push(p_mm);
        let Law::Clearance { f0_n, w_n, .. } = of("clearance", 0) else { panic!() };
        assert!((25.0..60.0).contains(&f0_n.abs()) && (3.0..6.0).contains(&w_n), "{f0_n} {w_n}");
    }
    let [min, max] = RANGES.ball_mm;
    let (low, high) = periods.iter().fold((f64::MAX, 0.0_f64), |(l, h), p| (l.min(*p), h.max(*p)));
    assert!(low >= min && high < max && low < min + 0.05 && high > max - 0.05, "{low} {high}");
}
