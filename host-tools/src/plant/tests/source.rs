//! A source of quadrature current for tests: it looks into the plant, as no control may.

use firmware::motor::stage::Drive;

use crate::plant::{PERIOD_S, Plant};

/// Voltages on d and q, in V, as duties about the middle of the bus.
pub fn voltage(plant: &Plant, direct_v: f64, quadrature_v: f64) -> Drive {
    let windings = plant.parameters().windings;
    // The angle in the middle of the period that comes.
    let rotor = &plant.train;
    let middle_rad = rotor.angle_rad + 0.5 * PERIOD_S * rotor.speed_rad_s;
    let electrical_rad = windings.pole_pairs * (middle_rad - plant.parameters().zero_rad);
    Drive::Duty([0.0, 1.0, 2.0].map(|phase: f64| {
        let (sin, cos) = (electrical_rad - phase * std::f64::consts::TAU / 3.0).sin_cos();
        let volts = direct_v * cos - quadrature_v * sin;
        (0.5 + volts / plant.bus.voltage_v) as f32
    }))
}

/// The duties that bring a quadrature current of this many ampere by the end of the next period, as far as
/// the bus allows, and no direct current.
pub fn current(plant: &Plant, quadrature_a: f64) -> Drive {
    let windings = plant.parameters().windings;
    let [direct, quadrature] = plant.direct_quadrature_a();
    let turning = windings.pole_pairs * plant.train.speed_rad_s;
    let reactance = turning * windings.inductance_h;
    // Half of what would bring it in one period, for the mean of the period counts.
    let gain = 0.5 * windings.inductance_h / PERIOD_S;
    let direct_v = -reactance * quadrature_a - gain * direct;
    let quadrature_v = windings.resistance_ohm * quadrature_a
        + turning * windings.flux_wb
        + gain * (quadrature_a - quadrature);
    voltage(plant, direct_v, quadrature_v)
}

/// Goes on under a source of current until `done`; false if two seconds were not enough.
pub fn drive_until(
    plant: &mut Plant,
    current_a: impl Fn(f64) -> f64,
    done: impl Fn(&Plant) -> bool,
) -> bool {
    let start_s = plant.time_s();
    while plant.time_s() - start_s < 2.0 {
        if done(plant) {
            return true;
        }
        let drive = current(plant, current_a(plant.time_s() - start_s));
        plant.step(drive);
    }
    false
}

/// Goes on so long under one drive.
pub fn hold(plant: &mut Plant, drive: Drive, seconds: f64) {
    let periods = (seconds / PERIOD_S).round() as u32;
    for _ in 0..periods {
        plant.step(drive);
    }
}
