//! What an earlier study of the same motor and screws found by a program of its own, without play,
//! cogging and give of the screw.

use firmware::motor::stage::Drive;
use firmware::params;

use crate::plant::Plant;
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

/// Greatest force after full speed at contact with something rigid.
fn peak_n(lead: Lead, drive: Drive, refined: u32) -> f64 {
    let mut parameters = Parameters::plain(lead);
    // The study's friction: of the screw alone.
    parameters.screw.friction = if lead == Lead::A { 2.2 } else { 0.61 };
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.refine(refined);
    plant.hold(Some(&Object::new(0.04, 1000.0)));
    plant.train.speed_rad_s = params::RATED_SPEED.value;
    plant.train.travel_m_s = params::RATED_SPEED.value * lead.travel_m_per_rad();
    let mut peak_n = 0.0_f64;
    for _ in 0..2000 {
        plant.step(drive);
        peak_n = peak_n.max(plant.grip_n());
    }
    peak_n
}

#[test]
fn power_off_or_brake_at_contact_ends_where_the_study_found() {
    for (lead, off_n, brake_n) in [(Lead::A, 264.0, 71.0), (Lead::B, 376.0, 133.0)] {
        let (off, brake) = (peak_n(lead, Drive::Off, 1), peak_n(lead, Drive::Brake, 1));
        println!("{lead:?}: off {off:.1} N ({off_n}), brake {brake:.1} N ({brake_n})");
        assert!((off / off_n - 1.0).abs() < 0.05, "{lead:?}: {off}");
        assert!((brake / brake_n - 1.0).abs() < 0.05, "{lead:?}: {brake}");
    }
}

#[test]
fn steps_half_as_long_change_the_peak_by_less_than_a_thousandth() {
    for drive in [Drive::Off, Drive::Brake] {
        let (coarse, fine) = (peak_n(Lead::B, drive, 1), peak_n(Lead::B, drive, 2));
        println!("{drive:?}: {coarse} {fine}");
        assert!(
            (coarse / fine - 1.0).abs() < 1e-3,
            "{drive:?}: {coarse} {fine}"
        );
    }
}
