use approx::assert_abs_diff_eq;
use nalgebra::Vector3;

use super::*;
use crate::recordings::description::{Design, MagnetAxis};

fn magpie() -> Sensed {
    Sensed::of(ForwardModel::nominal(&Design::magpie()))
}

fn shift(sensed: &Sensed, name: &str) -> Shift {
    let shifts = of(sensed, &Surroundings::assumed(1, DRAWS));
    shifts.into_iter().find(|shift| shift.name == name).unwrap()
}

#[test]
fn the_earth_is_five_counts_and_nine_tenths_of_a_newton() {
    // 0.65 G through 0.731 G/N, the blunter of the two axes.
    let earth = shift(&magpie(), "Earth");
    assert_abs_diff_eq!(earth.resolutions, 5.2, epsilon = 1e-9);
    assert_abs_diff_eq!(earth.newtons, 0.65 / 0.7312, epsilon = 1e-3);
}

#[test]
fn a_neighbour_gives_three_tenths_of_a_gauss_at_35_mm_as_a_dipole_does() {
    // Br V / (4 pi r^3) beside a dipole: 1.2e4 G, 14.14 mm^3; r^2 = 35^2 + 2.5^2.
    let model = magpie().model;
    let r = 35.0_f64.hypot(2.5);
    let far = neighbour::field(&model, 35.0);
    let along = 1.2e4 * 14.137 / (4.0 * std::f64::consts::PI * r.powi(3));
    assert_abs_diff_eq!(far.norm(), along, epsilon = 0.02 * along);
    let distance = neighbour::distance_mm(&model, 0.3);
    assert!((34.0..36.5).contains(&distance), "{distance}");
    assert_abs_diff_eq!(
        neighbour::field(&model, distance).norm(),
        0.3,
        epsilon = 1e-5
    );
}

#[test]
fn at_the_paper_s_1_5_mm_a_neighbour_is_a_thousand_resolutions_not_three() {
    // Two magnets of 3 mm with 1.5 mm between them.
    let near = neighbour::field(&magpie().model, 4.5);
    assert_abs_diff_eq!(near.norm(), 132.5, epsilon = 0.1);
}

#[test]
fn a_percent_of_the_magnet_is_a_percent_of_the_force_and_a_little_more() {
    // 2.5 N of 250; the field bends (585 d - 80 d^3 at d = 0.5 mm, less with the other force), so that its
    // slope there tells a tenth more.
    let weaker = shift(&magpie(), "inhomogeneity");
    assert_abs_diff_eq!(weaker.newtons, 2.778, epsilon = 0.01);
}

#[test]
fn misalignment_is_what_its_parts_add_up_to() {
    let sensed = magpie();
    let model = sensed.model;
    // One part at a time: 0.1 mm sideways is 58.4 G, and 50 N of 500 N/mm.
    let aside = ForwardModel {
        offset_mm: [0.1, 0.0],
        ..model
    };
    let off_g = aside.field([0.0; 2]) - model.field([0.0; 2]);
    let rest = Inverse::at(&model, [0.0; 2]);
    assert_abs_diff_eq!(off_g.x, 58.4, epsilon = 0.1);
    assert_abs_diff_eq!(rest.greatest_n(off_g), 50.0, epsilon = 0.2);
    // On each lateral axis 29 G of place and 11 G of tilt, along the gap 58 G of it and 25 G of strength: 77 G
    // root mean square, and 95 % stay below 1.7 times that.
    let mounted = shift(&sensed, "misalignment");
    assert!((110.0..150.0).contains(&mounted.gauss), "{mounted:?}");
    // A tare leaves what scales with the load, and the coupling of the axes.
    let tared = shift(&sensed, "asymmetry");
    assert!((28.0..45.0).contains(&tared.newtons), "{tared:?}");
}

#[test]
fn a_sensor_made_perfectly_is_not_misaligned() {
    let none = Scatter {
        offset_mm: 0.0,
        gap_mm: 0.0,
        tilt_rad: 0.0,
        remanence: 0.0,
    };
    let sensed = Sensed {
        scatter: none,
        ..magpie()
    };
    assert_eq!(shift(&sensed, "misalignment").gauss, 0.0);
    assert!(shift(&sensed, "asymmetry").gauss < 1e-9);
}

#[test]
fn a_hundred_times_as_many_draws_of_another_seed_tell_the_same_to_three_deviations() {
    let of = |seed, draws| {
        let around = Surroundings::assumed(seed, draws);
        super::of(&magpie(), &around)[1].newtons
    };
    let (few, many) = (of(1, DRAWS), of(2, 20_000));
    assert!((few / many - 1.0).abs() < 0.15, "{few} {many}");
    assert_eq!(of(1, DRAWS), few);
}

#[test]
fn from_afar_the_motor_is_the_dipole_that_its_coils_add_up_to() {
    // 20 turns of 84 mm^2 are 1.68e-3 A m^2 for each ampere. Over the twelve teeth alpha adds them to 0.402
    // and -1.5 of that along y and z; 0.3 m away on y that is 1e-7 / 0.027 (2 * 0.675e-3, 2.52e-3) T.
    let far = motor::leakage_g_per_a(Vector3::new(0.0, 300.0, 0.0));
    assert_abs_diff_eq!(far[(1, 0)], 5.0e-5, epsilon = 0.3e-5);
    assert_abs_diff_eq!(far[(2, 0)], 9.3e-5, epsilon = 0.3e-5);
    // Close by, many poles are felt that fall faster than its third power.
    let near = motor::leakage_g_per_a(Vector3::new(0.0, 40.0, 0.0));
    assert!(near.norm() > 2.0 * (300.0_f64 / 40.0).powi(3) * far.norm());
}

#[test]
fn the_motor_s_leakage_is_some_of_a_gauss_and_half_a_newton() {
    let leakage = shift(&magpie(), "motor leakage");
    assert_abs_diff_eq!(leakage.gauss, 0.754, epsilon = 0.01);
    assert_abs_diff_eq!(leakage.newtons, 0.536, epsilon = 0.01);
}

#[test]
fn the_gripper_gives_three_eighths_of_a_millimetre_at_250_newtons() {
    // 0.3 mm at 200 N.
    let (sensed, around) = (magpie(), Surroundings::assumed(1, 1));
    assert_abs_diff_eq!(
        rigidity::opening_error_mm(&sensed, &around),
        0.375,
        epsilon = 1e-12
    );
    // A dipole's field falls by three times that share of the distance: 3 * 0.375 / 10.3 of it.
    let (whole, part) = (
        shift(&sensed, "neighbour magnet"),
        shift(&sensed, "rigidity"),
    );
    let share = part.gauss / whole.gauss;
    assert!((0.095..0.12).contains(&share), "{share}");
}

#[test]
fn a_sensor_that_is_blind_to_a_force_says_so() {
    // A magnet that lies along the lateral motion tells nothing of the longitudinal force at rest.
    let mut design = Design::magpie();
    design.magnet.axis = MagnetAxis::X;
    let lying = Sensed::of(ForwardModel::nominal(&design));
    assert_eq!(shift(&lying, "Earth").newtons, f64::INFINITY);
}
