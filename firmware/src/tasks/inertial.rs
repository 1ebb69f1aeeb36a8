//! Reads the inertial sensor each millisecond and follows the tilt of the gripper.

use core::pin::pin;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::{Clock, ClockDelay, Timed, delay_us};
use crate::config::constants::TICK_US;
use crate::estimator::attitude::TiltFilter;
use crate::sensors::imu::{IMU_AXES, Imu, ImuReading};
use crate::system::faults::Event;
use crate::tasks::SharedState;

/// Shortest time-out of a reading, which takes 25 us at 5 MHz. It lasts until the next tick: a timer of its own would wake the task
/// after the reading has ended.
const READ_LIMIT_US: u64 = 500;
/// Pause before a sensor that is absent or has failed is started again.
const RESTART_US: u64 = 1_000_000;
/// Identical readings in a row of a sensor that has stopped measuring. A live one shows noise of several counts.
const FROZEN_READINGS: u8 = 50;

/// One measurement in gripper axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InertialSample {
    /// Specific force (gravity included) in mm/s^2.
    pub mm_s2: [i32; 3],
    /// Roll and pitch in radians.
    pub roll_pitch: Option<[f32; 2]>,
}

/// Reads the sensor and publishes its samples, while it is present and alive; otherwise none is published, and what
/// needs it is reported as missing.
pub async fn inertial<I: Imu, C: Clock, M: RawMutex>(
    mut imu: I,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut is_reported = false;
    loop {
        let is_present = imu.start(&mut ClockDelay(clock)).await.is_ok();
        // Its absence is reported once.
        if is_present || !is_reported {
            shared.events.post(Event::InertialSensor { is_present });
            is_reported = true;
        }
        if is_present {
            follow(&mut imu, clock, shared).await;
            shared.inertial.set(None);
            shared.events.post(Event::InertialSensor { is_present: false });
        }
        delay_us(clock, RESTART_US).await;
    }
}

/// Publishes samples until the sensor fails.
async fn follow<I: Imu, C: Clock, M: RawMutex>(imu: &mut I, clock: &C, shared: &SharedState<M>) {
    let mut filter = TiltFilter::default();
    let mut last: Option<Timed<ImuReading>> = None;
    let mut repeated = 0_u8;
    // Both tasks share an executor: a reading during the transfers of the Hall sensors would delay them.
    let mut begin_us = shared.next_tick_us(clock.now_us()).saturating_add(TICK_US / 2);
    let mut next = pin!(clock.until(begin_us));
    loop {
        next.as_mut().await;
        let time_us = clock.now_us();
        // After a delay the ticks begin anew.
        begin_us = begin_us.saturating_add(TICK_US).max(time_us.saturating_add(READ_LIMIT_US));
        next.set(clock.until(begin_us));
        let read = select(imu.read(), next.as_mut()).await;
        let Either::First(Ok(reading)) = read else { return };
        let is_same = last.is_some_and(|last| last.value == reading);
        repeated = if is_same { repeated.saturating_add(1) } else { 0 };
        if repeated >= FROZEN_READINGS {
            return;
        }
        let step_us = last.map_or(0, |last| time_us.saturating_sub(last.time_us));
        last = Some(Timed { time_us, value: reading });
        let mm_s2 = in_gripper_axes(reading.acceleration);
        let mut gravity = mm_s2;
        if let Some(transport) = shared.host_motion.get().acceleration_at(time_us) {
            for (gravity, transport) in gravity.iter_mut().zip(transport) {
                *gravity = gravity.saturating_sub(transport);
            }
        }
        const RAD_S_PER_MDPS: f32 = core::f32::consts::PI / 180e3;
        filter.update(
            gravity.map(|mm_s2| mm_s2 as f32 * 1e-3),
            in_gripper_axes(reading.rate).map(|mdps| mdps as f32 * RAD_S_PER_MDPS),
            step_us as f32 * 1e-6,
        );
        let value = InertialSample { mm_s2, roll_pitch: filter.roll_pitch() };
        shared.inertial.set(Some(Timed { time_us, value }));
    }
}

/// Rotates a vector from the sensor's axes by [`IMU_AXES`].
fn in_gripper_axes(vector: [i32; 3]) -> [i32; 3] {
    IMU_AXES.map(|row| {
        let terms = row.into_iter().zip(vector);
        terms.fold(0_i32, |sum, (factor, value)| {
            sum.saturating_add(value.saturating_mul(i32::from(factor)))
        })
    })
}
