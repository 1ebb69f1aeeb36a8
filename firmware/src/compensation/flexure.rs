//! Effects of the flexures and the mass on them: viscous lag, creep, hard stops, the fingertip's weight and inertia.

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::fixed_point::{Force, mul_q, saturate};

/// Fractional bits of [`ViscousLagTable::lead`] and [`ViscousLagTable::rate`].
pub const LAG_BITS: u32 = 16;
/// Additional fractional bits of the filtered force.
const LAG_STATE_BITS: u32 = 12;

/// Viscous lag of the flexures: the force leads the deflection by the lag times the deflection's rate. The rate is
/// noisy and taken after two low-pass filters, whose time constant the exporter chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViscousLagTable {
    /// Lag divided by the filters' time constant, for Fx and Fz.
    pub lead: [i32; 2],
    /// Gain of the filters per tick.
    pub rate: i32,
}

/// Filters for Fx and Fz; the first reading initialises them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViscousLagState {
    filters: [Option<[i64; 2]>; 2],
}

impl ViscousLagTable {
    /// Applies the lead to the forces derived from the deflection.
    pub fn compensate(&self, force: [Force; 2], state: &mut ViscousLagState) -> [Force; 2] {
        let [x, z] = &mut state.filters;
        let [fx, fz] = force;
        let [lx, lz] = self.lead;
        [self.axis(fx, lx, x), self.axis(fz, lz, z)]
    }

    fn axis(&self, force: Force, lead: i32, filters: &mut Option<[i64; 2]>) -> Force {
        let now = i64::from(force.0) << LAG_STATE_BITS;
        let [first, second] = filters.unwrap_or([now; 2]);
        let low_pass = |from: i64, to: i64| {
            // 131 kN at most, so that the product with the rate fits 64 bits.
            let step = i64::from(saturate(to.saturating_sub(from) >> 8));
            from.saturating_add((step * i64::from(self.rate)) >> (LAG_BITS - 8))
        };
        let first = low_pass(first, now);
        let second = low_pass(second, first);
        *filters = Some([first, second]);
        // The filters' difference is the rate of the once filtered force times the time constant.
        let slope = saturate((first.saturating_sub(second)) >> LAG_STATE_BITS);
        Force(force.0.saturating_add(mul_q(slope, lead, LAG_BITS)))
    }
}

/// Creep components per axis: a fast and a slow one.
pub const CREEP_PARTS: usize = 2;
/// Fractional bits of [`CreepTable::share`] and [`CreepTable::rate`].
pub const CREEP_BITS: u32 = 30;
/// Additional fractional bits of the delayed forces.
const CREEP_STATE_BITS: u32 = 20;

/// Creep of the flexures: under load the deflection grows by components that follow the force with their own time
/// constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CreepTable {
    /// Relative additional deflection of each component, for Fx and Fz.
    pub share: [[i32; CREEP_PARTS]; 2],
    /// Gain of each component's low pass per tick.
    pub rate: [i32; CREEP_PARTS],
}

/// Delayed forces for Fx and Fz; the first reading initialises them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CreepState {
    delayed: [Option<[i64; CREEP_PARTS]>; 2],
}

impl CreepTable {
    /// Subtracts the creep from the forces derived from the deflection.
    pub fn compensate(&self, force: [Force; 2], state: &mut CreepState) -> [Force; 2] {
        let [x, z] = &mut state.delayed;
        let [fx, fz] = force;
        let [sx, sz] = &self.share;
        [self.axis(fx, sx, x), self.axis(fz, sz, z)]
    }

    fn axis(
        &self,
        force: Force,
        share: &[i32; CREEP_PARTS],
        delayed: &mut Option<[i64; CREEP_PARTS]>,
    ) -> Force {
        let mut parts = delayed.unwrap_or([i64::from(force.0) << CREEP_STATE_BITS; CREEP_PARTS]);
        // Each is below 2^33: no overflow of the sum.
        let creep: i64 = parts
            .iter()
            .zip(share)
            .map(|(part, share)| {
                (i64::from(saturate(part >> CREEP_STATE_BITS)) * i64::from(*share)) >> CREEP_BITS
            })
            .sum();
        let corrected = saturate(i64::from(force.0) - creep);
        for (part, rate) in parts.iter_mut().zip(&self.rate) {
            let step = (i64::from(corrected) << CREEP_STATE_BITS).saturating_sub(*part);
            // In whole force units, so that the product with the rate fits 64 bits.
            let step = i64::from(saturate(step >> CREEP_STATE_BITS));
            *part =
                part.saturating_add((step * i64::from(*rate)) >> (CREEP_BITS - CREEP_STATE_BITS));
        }
        *delayed = Some(parts);
        Force(corrected)
    }
}

/// Fractional bits of [`HardStopTable::beyond`].
pub const HARD_STOP_BITS: u32 = 16;

/// Hard stops of the flexures. Smooth basis functions miss the knee by newtons, so the ideal model inverts the flexure
/// without its stop and the force on the stop is added here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HardStopTable {
    /// Force at the stop for Fx and Fz, in force units, for both signs.
    pub knee: [i32; 2],
    /// Force added per unit above the knee: for Fx and Fz, positive and negative.
    pub beyond: [[i32; 2]; 2],
}

impl HardStopTable {
    /// Adds the force on the stops to the forces derived from the deflection.
    pub fn compensate(&self, force: [Force; 2]) -> [Force; 2] {
        let [fx, fz] = force;
        let [kx, kz] = self.knee;
        let [bx, bz] = self.beyond;
        [(fx, kx, bx), (fz, kz, bz)].map(|(force, knee, [positive, negative])| {
            let is_negative = force.0 < 0;
            let factor = if is_negative { negative } else { positive };
            let excess = force.0.saturating_abs().saturating_sub(knee).max(0);
            let added = mul_q(excess, factor, HARD_STOP_BITS);
            let added = if is_negative { added.saturating_neg() } else { added };
            Force(force.0.saturating_add(added))
        })
    }
}

/// Fractional bits of [`FingertipMassTable::mass`].
pub const MASS_BITS: u32 = 20;

/// Weight and inertia of the fingertip on its flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FingertipMassTable {
    /// Force units per mm/s^2.
    pub mass: i32,
}

impl FingertipMassTable {
    /// Subtracts weight and inertia; `None` without an acceleration.
    pub fn compensate(&self, force: [Force; 2], inputs: &AuxiliaryInputs) -> Option<[Force; 2]> {
        let [x, _, z] = inputs.acceleration?;
        let [fx, fz] = force;
        Some([(fx, x), (fz, z)].map(|(force, acceleration)| {
            let own = mul_q(acceleration, self.mass, MASS_BITS);
            Force(force.0.saturating_sub(own))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_numbers_in_the_tables_saturate_instead_of_overflowing() {
        let ends = [i32::MIN, -1, 0, 1, i32::MAX];
        for (a, b) in ends.into_iter().flat_map(|a| ends.map(|b| (a, b))) {
            let stop = HardStopTable { knee: [a; 2], beyond: [[b; 2]; 2] };
            let lag = ViscousLagTable { lead: [a; 2], rate: b };
            let creep = CreepTable { share: [[a; CREEP_PARTS]; 2], rate: [b; CREEP_PARTS] };
            let (mut lag_state, mut creep_state) = Default::default();
            for force in ends.repeat(4) {
                let [added, _] = stop.compensate([Force(force); 2]);
                // Factors below zero reduce a force above the knee.
                assert!(b < 0 || force == 0 || i64::from(added.0) * i64::from(force) > 0);
                lag.compensate([Force(force); 2], &mut lag_state);
                creep.compensate([Force(force); 2], &mut creep_state);
            }
        }
    }

    #[test]
    fn a_ramp_with_10_ms_of_viscous_lag_is_corrected() {
        let one = f64::from(1 << LAG_BITS);
        let table = ViscousLagTable { lead: [(0.5 * one) as i32; 2], rate: (one / 20.0) as i32 };
        let mut state = ViscousLagState::default();
        let mut error = 0.0;
        for ms in 0..2000 {
            // 100 N/s, measured 10 ms late.
            let late = (0.1 * (f64::from(ms) - 10.0)).max(0.0);
            let force = Force((late * Force::PER_NEWTON) as i32);
            let [x, _] = table.compensate([force; 2], &mut state);
            error = x.newtons() - 0.1 * f64::from(ms);
        }
        assert!(error.abs() < 0.06, "{error}");
    }

    #[test]
    fn a_deflection_creeping_by_two_percent_gives_a_steady_force() {
        // 1.2 % with 1 s and 0.8 % with 10 s at 1 kHz.
        let one = f64::from(1 << CREEP_BITS);
        let (share, rate) = ([0.012, 0.008], [1e-3, 1e-4]);
        let table = CreepTable {
            share: [share.map(|share| (share * one) as i32); 2],
            rate: rate.map(|rate| (rate * one) as i32),
        };
        let mut state = CreepState::default();
        table.compensate([Force(0); 2], &mut state);
        let mut delayed = [0.0; CREEP_PARTS];
        for tick in 0..60_000 {
            let deflection = 100.0 + share[0] * delayed[0] + share[1] * delayed[1];
            for (delayed, rate) in delayed.iter_mut().zip(rate) {
                *delayed += (100.0 - *delayed) * rate;
            }
            let force = Force((deflection * Force::PER_NEWTON) as i32);
            let [x, z] = table.compensate([force; 2], &mut state);
            assert_eq!(x, z);
            let newtons = x.newtons();
            assert!((newtons - 100.0).abs() < 0.02, "{tick}: {newtons}");
        }
    }

    #[test]
    fn creep_saturates_for_extreme_tables_and_forces() {
        for share in [i32::MIN, i32::MAX] {
            for rate in [i32::MIN, i32::MAX] {
                let table =
                    CreepTable { share: [[share; CREEP_PARTS]; 2], rate: [rate; CREEP_PARTS] };
                let mut state = CreepState::default();
                for force in [i32::MIN, i32::MAX, 0].into_iter().cycle().take(300) {
                    table.compensate([Force(force); 2], &mut state);
                }
            }
        }
        // A negative share adds: twice a half.
        let table = CreepTable {
            share: [[-(1 << (CREEP_BITS - 1)); CREEP_PARTS]; 2],
            rate: [0; CREEP_PARTS],
        };
        let extreme = [Force(i32::MAX), Force(i32::MIN)];
        let found = table.compensate(extreme, &mut CreepState::default());
        assert_eq!(found, extreme);
    }

    #[test]
    fn the_force_on_a_stop_is_added_above_the_knee_per_sign() {
        // 60 % lost above 100 N: 150 N are measured as 120.
        let beyond = (1.5 * f64::from(1 << HARD_STOP_BITS)) as i32;
        let table = HardStopTable { knee: [100 << 10; 2], beyond: [[beyond, 0], [beyond; 2]] };
        for (newtons, expected) in
            [(80, [80.0, 80.0]), (120, [150.0, 150.0]), (-120, [-120.0, -150.0])]
        {
            let found = table.compensate([Force(newtons << 10); 2]);
            assert_eq!(found.map(Force::newtons), expected);
        }
    }

    #[test]
    fn a_tenth_of_a_kilogram_weighs_one_newton() {
        // 0.1 kg are 1e-4 N per mm/s^2.
        let mass = (1e-4 * Force::PER_NEWTON * f64::from(1 << MASS_BITS)) as i32;
        let inputs = AuxiliaryInputs { acceleration: Some([9810, 0, -9810]), ..Default::default() };
        let [x, z] =
            FingertipMassTable { mass }.compensate([Force(0), Force(1024)], &inputs).unwrap();
        assert!((x.newtons() + 0.981).abs() < 2e-3 && (z.newtons() - 1.981).abs() < 2e-3);
    }
}
