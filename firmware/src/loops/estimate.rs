//! Turns what was sensed into forces, and judges what that says of the sensors.

use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Felt, Finder};
use crate::balance::Balance;
use crate::clock::Clock;
use crate::estimator::{Estimator, Networks};
use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::hall::Reading;
use crate::hall::watch::{Condition, Watched};
use crate::limits::Limits;
use crate::motor::Telling;
use crate::parameters::Parameters;
use crate::params::TICK_US;
use crate::progress::Loop;
use crate::status::{Fault, Faults};
use crate::surroundings::Surroundings;
use crate::tare::{Step, Taring};
use crate::units::Force;
use crate::wire::serial::Tick;

/// What the board knows in a tick beside the fields.
#[derive(Clone, Copy, Debug, Default)]
pub struct Around {
    /// For those who undo it.
    pub surroundings: Surroundings,
    /// The motor.
    pub motor: Telling,
}

/// What the loop tells of a tick.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Which tick since boot.
    pub tick: u32,
    /// When it began, in microseconds since boot.
    pub begun_us: u64,
    /// The forces.
    pub estimates: [Estimate; SENSORS],
    /// What they were made of.
    pub readings: [Option<Reading>; SENSORS],
}

/// Estimates the forces of every frame that is sensed, for ever. `around` tells what the board knows beside
/// the fields.
pub async fn estimate<N: Networks, C: Clock, M: RawMutex>(
    estimator: &mut Estimator<'_, N>,
    mut around: impl FnMut() -> Around,
    limits: &Limits,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut judge = Judge::new(limits);
    let mut taring = None;
    let held = estimator.held();
    let bears_mass = !estimator.is_without_mass();
    let mut tick = 0_u32;
    let mut last_us = None;
    loop {
        let sensed = exchange.sensed.wait().await;
        exchange.progress.check_in(Loop::Estimate);
        let woken_us = clock.now_us();
        let Around {
            surroundings,
            motor,
        } = around();
        let mut estimates = estimator.step(&sensed.frame, &surroundings);
        let done_us = clock.now_us();
        let counts = &exchange.counts;
        for (worst, spent_us) in [
            (
                &counts.worst_tick_us,
                done_us.saturating_sub(sensed.begun_us),
            ),
            (&counts.worst_estimate_us, done_us.saturating_sub(woken_us)),
        ] {
            worst.fetch_max(spent_us as u32, Ordering::Relaxed);
        }
        // The tick's number goes on in time also where frames were lost on the way here.
        let ticks = last_us.replace(sensed.begun_us).map_or(0, |last_us| {
            (sensed.begun_us.saturating_sub(last_us) + TICK_US / 2) as u32 / TICK_US as u32
        });
        tick = tick.wrapping_add(ticks);
        judge.note(&sensed.watched, &estimates, exchange);
        let astray = [0, 1, 2, 3].map(|sensor| estimator.is_astray(sensor));
        judge.note_networks(astray, exchange);
        tare(&mut taring, &held, &mut estimates, exchange);
        exchange.felt.signal(Felt {
            estimates,
            motor,
            acceleration: surroundings.acceleration.filter(|_| bears_mass),
        });
        exchange.ticks.signal(Tick::of(&sensed.frame, &estimates));
        exchange.told.signal(Told {
            tick,
            begun_us: sensed.begun_us,
            estimates,
            readings: sensed.frame.readings,
        });
    }
}

/// Takes the tare off, and gathers another where a host wants one.
fn tare<M: RawMutex>(
    taring: &mut Option<Taring>,
    held: &[[Force; 2]; SENSORS],
    estimates: &mut [Estimate; SENSORS],
    exchange: &Exchange<M>,
) {
    if exchange.tare_wanted.try_take().is_some() {
        *taring = Some(Taring::new(*held));
    }
    if let Some(running) = taring {
        let step = running.take(estimates);
        if step != Step::Gathering {
            *taring = None;
            exchange.tare_ended.signal(step);
        }
    }
    exchange.parameter(Parameters::tare).apply(estimates);
}

/// Notes what is wrong with sensors and forces.
struct Judge {
    faults: Faults,
    balance: Balance,
    /// Ticks in a row in which a field was outside its box, and how many are a fault.
    outside: [u8; SENSORS],
    outside_ticks: u8,
}

impl Judge {
    fn new(limits: &Limits) -> Self {
        Self {
            faults: Faults::default(),
            balance: Balance::new(limits),
            outside: [0; SENSORS],
            outside_ticks: limits.outside_ticks,
        }
    }

    fn note_networks<M: RawMutex>(&mut self, astray: [bool; SENSORS], exchange: &Exchange<M>) {
        for (sensor, is_astray) in (0_u8..).zip(astray) {
            let fault = (Fault::NetworkAstray, sensor);
            exchange.note(Finder::Estimate, &mut self.faults, fault, is_astray, 0);
        }
    }

    fn note<M: RawMutex>(
        &mut self,
        watched: &[Watched; SENSORS],
        estimates: &[Estimate; SENSORS],
        exchange: &Exchange<M>,
    ) {
        let mut ok = 0;
        let sensors = watched.iter().zip(estimates).zip(&mut self.outside);
        for (sensor, ((watched, estimate), outside)) in (0_u8..).zip(sensors) {
            let age = u32::from(watched.age);
            let lost = watched.condition == Condition::Lost;
            let frozen = watched.condition == Condition::Frozen;
            *outside = match estimate.validity {
                Validity::OutsideModel => outside.saturating_add(1),
                _ => 0,
            };
            ok |= u32::from(!lost && !frozen) << sensor;
            for (fault, active) in [
                (Fault::SensorLost, lost),
                (Fault::SensorFrozen, frozen),
                (
                    Fault::SensorSaturated,
                    estimate.validity == Validity::Saturated,
                ),
                (Fault::OutsideModel, *outside >= self.outside_ticks),
            ] {
                exchange.note(
                    Finder::Estimate,
                    &mut self.faults,
                    (fault, sensor),
                    active,
                    age,
                );
            }
        }
        exchange.counts.sensors_ok.store(ok, Ordering::Relaxed);
        let difference = self.balance.note(estimates);
        let detail = difference.map_or(0, |force| force.0.unsigned_abs());
        let disturbed = estimates.iter().any(|estimate| estimate.disturbed);
        for (fault, active, detail) in [
            (Fault::Unbalanced, difference.is_some(), detail),
            (Fault::Disturbed, disturbed, 0),
        ] {
            exchange.note(
                Finder::Estimate,
                &mut self.faults,
                (fault, 0),
                active,
                detail,
            );
        }
    }
}
