use super::*;
use std::f64::consts::FRAC_PI_2;

/// The paper's beam, of steel.
const PAPER: Beam = Beam {
    length_m: 0.03,
    width_m: 0.015,
    thickness_m: 0.005,
    support: Support::ClampedFree,
    modulus_pa: 197e9,
};

/// A leaf that deflects by several thicknesses.
const LEAF: Beam = Beam {
    length_m: 0.04,
    width_m: 0.01,
    thickness_m: 0.000_5,
    support: Support::ClampedClamped,
    modulus_pa: 114e9,
};

fn relative(found: f64, expected: f64) -> f64 {
    (found / expected - 1.0).abs()
}

fn clamped(support: Support) -> Beam {
    Beam { support, ..LEAF }
}

/// One step of Runge and Kutta's fourth order.
fn step<const N: usize>(
    y: [f64; N],
    h: f64,
    derivative: impl Fn(&[f64; N]) -> [f64; N],
) -> [f64; N] {
    let moved = |by: f64, slope: [f64; N]| std::array::from_fn(|i| y[i] + by * slope[i]);
    let a = derivative(&y);
    let b = derivative(&moved(0.5 * h, a));
    let c = derivative(&moved(0.5 * h, b));
    let d = derivative(&moved(h, c));
    std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]))
}

/// Zero of a rising function, by halving.
fn zero(mut low: f64, mut high: f64, of: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if of(middle) < 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Force in newtons under which the beam deflects by up to its thickness.
fn force_at(beam: &Beam, deflection_m: f64) -> f64 {
    let most_n = 10.0 * beam.stiffness_n_per_m() * deflection_m;
    zero(0.0, most_n, |force_n| beam.bend(force_n).deflection_m - deflection_m)
}

const STEPS: usize = 1000;

/// Von Karman's equations of a guided span integrated from its clamp, for a pull and a moment there:
/// deflection, slope, and the integral of half the squared slope at the guide.
fn integrate(beam: &Beam, length_m: f64, force_n: f64, axial_n: f64, moment_nm: f64) -> [f64; 3] {
    let stiffness = beam.modulus_pa * beam.second_moment_m4();
    let mut y = [0.0; 4];
    let h = length_m / STEPS as f64;
    for _ in 0..STEPS {
        // Place, deflection, slope, stretch. The moment at x is M0 - V x + N w.
        y = step(y, h, |[x, w, slope, _]| {
            let curvature = (moment_nm - force_n * x + axial_n * w) / stiffness;
            [1.0, *slope, curvature, 0.5 * slope * slope]
        });
    }
    [y[1], y[2], y[3]]
}

/// Deflection, pull and moment of a guided span, by shooting.
fn shoot(beam: &Beam, length_m: f64, force_n: f64) -> [f64; 3] {
    // The slope at the guide is linear in the moment at the clamp.
    let moment = |axial_n: f64| {
        let max_nm = force_n * length_m;
        let [none, all] = [0.0, max_nm]
            .map(|moment_nm| integrate(beam, length_m, force_n, axial_n, moment_nm)[1]);
        max_nm * none / (none - all)
    };
    let rigid = beam.modulus_pa * beam.area_m2();
    // A string without bending stiffness is pulled more.
    let max_n = (0.5 * rigid * force_n * force_n).cbrt();
    let axial_n = zero(0.0, max_n, |axial_n| {
        let [_, _, stretch_m] = integrate(beam, length_m, force_n, axial_n, moment(axial_n));
        axial_n * length_m / rigid - stretch_m
    });
    let moment_nm = moment(axial_n);
    [integrate(beam, length_m, force_n, axial_n, moment_nm)[0], axial_n, moment_nm]
}

/// The exact inextensible cantilever under a tip force of constant direction, by `P L^2 / EI`: deflection
/// and shortening by its length, and the slope of its tip.
fn elastica(load: f64) -> [f64; 3] {
    let run = |clamp: f64| {
        let mut y = [0.0, clamp, 0.0, 0.0];
        for _ in 0..STEPS {
            // Slope, curvature, and the tip's place.
            y = step(y, 1.0 / STEPS as f64, |[slope, curvature, _, _]| {
                [*curvature, -load * slope.cos(), slope.sin(), 1.0 - slope.cos()]
            });
        }
        y
    };
    let clamp = zero(0.0, load.max(1e-9) * FRAC_PI_2, |clamp| run(clamp)[1]);
    let [slope, _, deflection, shortening] = run(clamp);
    [deflection, shortening, slope]
}

#[test]
fn small_deflections_equal_textbook_formulas() {
    for (support, stiffness, moment) in [
        (Support::ClampedFree, 3.0, 1.0),
        (Support::ClampedClamped, 192.0, 0.125),
        (Support::ClampedGuided, 12.0, 0.5),
    ] {
        let beam = Beam { support, ..PAPER };
        // E I = 197e9 * 0.015 * 0.005^3 / 12 = 30.78125 N m^2.
        let expected = stiffness * 30.781_25 / 2.7e-5;
        assert!(relative(beam.stiffness_n_per_m(), expected) < 1e-12);
        for force_n in [1e-3, 0.5, -1.0] {
            let bent = beam.bend(force_n);
            assert!(relative(bent.deflection_m, force_n / expected) < 1e-6);
            // The outer fibre is 2.5 mm from the middle.
            let stress = moment * force_n.abs() * 0.03 * 2.5e-3 / 1.5625e-10;
            assert!(relative(bent.bending_pa, stress) < 1e-6);
        }
    }
}

#[test]
fn clamped_beams_equal_a_shooting_solution() {
    for (support, spans) in [(Support::ClampedClamped, 2.0), (Support::ClampedGuided, 1.0)] {
        let beam = clamped(support);
        let small_n = beam.stiffness_n_per_m() * beam.thickness_m;
        for share in [0.1, 1.0, 10.0, 100.0] {
            let force_n = share * small_n;
            let found = beam.bend(force_n);
            let [deflection, axial, moment] = shoot(&beam, beam.length_m / spans, force_n / spans);
            let bending = moment * 0.5 * beam.thickness_m / beam.second_moment_m4();
            let what = format!("{support:?} {share}");
            assert!(relative(found.deflection_m, deflection) < 1e-4, "{what}");
            assert!(relative(found.axial_n, axial) < 1e-4, "{what}");
            assert!(relative(found.bending_pa, bending) < 1e-4, "{what}");
        }
    }
}

#[test]
fn cantilever_equals_a_shooting_solution() {
    // Clamp at the root, no moment at the tip: the moment at the root is the force times the length.
    let beam = Beam { support: Support::ClampedFree, ..LEAF };
    let force_n = 0.5;
    let root_nm = force_n * beam.length_m;
    let [deflection, slope, shortening] = integrate(&beam, beam.length_m, force_n, 0.0, root_nm);
    let found = beam.bend(force_n);
    assert!(relative(found.deflection_m, deflection) < 1e-4);
    assert!(relative(found.slope_rad, slope) < 1e-4);
    assert!(relative(found.shortening_m, shortening) < 1e-4);
}

#[test]
fn clamped_beam_is_slightly_softer_than_roark_s_table() {
    // Young and Budynas, Roark's Formulas for Stress and Strain, 7th ed., 8.3: both ends fixed,
    // central load, w + A w^3 / (16 I) = W l^3 / (2 pi^4 EI): one cosine for the shape, which is too stiff.
    let beam = clamped(Support::ClampedClamped);
    let stiffness = beam.modulus_pa * beam.second_moment_m4();
    for (thicknesses, least, most) in [(0.2, 0.012, 0.02), (0.5, 0.015, 0.03), (1.0, 0.03, 0.05)] {
        let w = thicknesses * beam.thickness_m;
        let cubic = beam.area_m2() / (16.0 * beam.second_moment_m4());
        let published = (w + cubic * w.powi(3)) * 2.0 * std::f64::consts::PI.powi(4) * stiffness
            / beam.length_m.powi(3);
        let stiffer = published / force_at(&beam, w) - 1.0;
        assert!((least..most).contains(&stiffer), "{thicknesses}: {stiffer}");
    }
}

#[test]
fn initial_stiffening_equals_the_beam_constraint_model() {
    // Awtar, Slocum and Sevincer, J. Mech. Des. 129 (2007) 625: f = 12 y + 1.2 p y, and the axial force of clamped
    // ends from p t^2/12 = 0.6 y^2: a share 0.72 (w/t)^2 is gained.
    for support in [Support::ClampedClamped, Support::ClampedGuided] {
        let beam = clamped(support);
        let w = 0.02 * beam.thickness_m;
        let gained = force_at(&beam, w) / (beam.stiffness_n_per_m() * w) - 1.0;
        assert!(relative(gained, 0.72 * 0.02 * 0.02) < 1e-3, "{gained}");
    }
}

#[test]
fn elastica_equals_published_values() {
    // Mattiasson, Int. J. Num. Meth. Eng. 17 (1981) 145, of Bisshopp and Drucker's elliptic integrals:
    // P L^2 / EI, deflection, shortening, slope.
    for [load, deflection, shortening, slope] in [
        [0.2, 0.066_36, 0.002_65, 0.099_64],
        [1.0, 0.301_72, 0.056_43, 0.461_35],
        [2.0, 0.493_46, 0.160_64, 0.781_75],
    ] {
        let found = elastica(load);
        for (found, published) in found.into_iter().zip([deflection, shortening, slope]) {
            assert!((found - published).abs() < 1e-5, "{load}: {found}");
        }
    }
}

#[test]
fn cantilever_is_exact_only_up_to_moderate_slopes() {
    let beam = Beam { support: Support::ClampedFree, ..LEAF };
    let off = |slope_rad: f64| {
        let load = 2.0 * slope_rad;
        let force_n =
            load * beam.modulus_pa * beam.second_moment_m4() / beam.length_m / beam.length_m;
        let found = beam.bend(force_n);
        assert!(relative(found.slope_rad, slope_rad) < 1e-12);
        let [deflection, shortening, _] = elastica(load);
        let deflection = relative(found.deflection_m, deflection * beam.length_m);
        deflection.max(relative(found.shortening_m, shortening * beam.length_m))
    };
    assert!(off(0.05) < 0.003);
    let moderate = off(MODERATE_SLOPE_RAD);
    assert!((0.008..0.02).contains(&moderate), "{moderate}");
    assert!(off(0.5) > 0.1);
}

#[test]
fn axial_force_and_shortening_depend_on_the_support() {
    let free = Beam { support: Support::ClampedFree, ..LEAF };
    let (once, twice) = (free.bend(0.2), free.bend(0.4));
    assert_eq!(once.axial_n, 0.0);
    assert!(relative(twice.deflection_m, 2.0 * once.deflection_m) < 1e-12);
    assert!(relative(twice.shortening_m, 4.0 * once.shortening_m) < 1e-12);
    let bent = clamped(Support::ClampedClamped).bend(20.0);
    assert!(bent.shortening_m == 0.0 && bent.slope_rad == 0.0 && bent.axial_n > 0.0);
    assert!(bent.reversed_pa() > bent.bending_pa && bent.reversed_pa() < bent.stress_pa());
}
