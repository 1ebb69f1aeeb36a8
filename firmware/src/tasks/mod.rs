//! What runs on the chip, and every static with its one writer.
//!
//! | task | rate | deadline | missed |
//! | --- | --- | --- | --- |
//! | [`sense`] | 1 kHz | the next tick | the late ticks follow at once until the task has caught up |
//! | [`report`] | 100 Hz | none | the bus sees an older estimate |

use defmt::{info, unwrap, warn};
use embassy_executor::Spawner;
use embassy_futures::join::join;
use embassy_stm32::can::Can;
use embassy_stm32::can::frame::Frame as CanFrame;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Ticker, with_timeout};

use crate::compensate::Memory;
use crate::force::{Estimate, Validity, estimate_all};
use crate::foreign::Detector;
use crate::frame::{Frame, SENSORS};
use crate::hall::a31301::A31301;
use crate::hall::watch::Watch;
use crate::hall::{Part, Sample};
use crate::hardware::board::{Board, SensorBus};
use crate::model::gru::Run;
use crate::model::tables::{NETWORKS, TABLES};
use crate::params;
use crate::recurrent;
use crate::surroundings::Surroundings;
use crate::wire;

/// Reports to one line in the log.
const REPORTS_PER_LINE: u8 = 100;
/// Ticks of the sensors to one report.
const TICKS_PER_REPORT: u32 = 10;
/// A frame that nobody acknowledges is given up after this.
const CAN_PATIENCE: Duration = Duration::from_millis(2);

/// The newest estimates. Written by [`sense`], drained by [`report`].
static ESTIMATES: Signal<CriticalSectionRawMutex, [Estimate; SENSORS]> = Signal::new();

/// Starts every task.
pub fn spawn(spawner: Spawner, board: Board) {
    info!("tables {:04x}, {} sensors", TABLES.id, TABLES.sensors.len());
    let [first, second] = board.sensor_buses;
    spawner.spawn(unwrap!(sense(first, second)));
    spawner.spawn(unwrap!(report(board.can)));
}

/// Reads the sensors, two on each bus side by side, and computes the forces.
#[embassy_executor::task]
async fn sense(mut first: SensorBus, mut second: SensorBus) {
    let [a, b, c, d] = A31301::ADDRESSES;
    let mut watches = [Watch::default(); SENSORS];
    let mut ticker = Ticker::every(Duration::from_hz(params::SENSE_RATE.value as u64));
    let mut ticks = 0_u32;
    let mut memories = [Memory::default(); SENSORS];
    let mut detector = Detector::default();
    let mut runs = [const { Run::RESET }; NETWORKS.len()];
    // Nothing on this board measures them yet: what needs them stays off, and the estimates say so.
    let around = Surroundings::default();
    loop {
        ticker.next().await;
        let time_us = Instant::now().as_micros() as u32;
        let ([r0, r1], [r2, r3]) =
            join(read_two(&mut first, [a, b]), read_two(&mut second, [c, d])).await;
        let mut samples = [r0, r1, r2, r3].into_iter();
        let frame = Frame {
            time_us,
            readings: watches
                .each_mut()
                .map(|watch| watch.note(samples.next().flatten()).reading),
        };
        let mut estimates = estimate_all(&TABLES, &frame, &around, &mut memories);
        let ideal = estimates;
        recurrent::apply(&NETWORKS, &mut runs, &mut estimates);
        detector.watch(&ideal, &mut estimates);
        ticks = ticks.wrapping_add(1);
        if ticks.is_multiple_of(TICKS_PER_REPORT) {
            ESTIMATES.signal(estimates);
        }
    }
}

async fn read_two(bus: &mut SensorBus, [one, other]: [u8; 2]) -> [Option<Sample>; 2] {
    [
        A31301::read(bus, one).await.ok(),
        A31301::read(bus, other).await.ok(),
    ]
}

/// Sends the forces of every sensor on the CAN bus, and now and then a line to the log.
#[embassy_executor::task]
async fn report(mut can: Can<'static>) {
    let mut counter = 0_u8;
    loop {
        let estimates = ESTIMATES.wait().await;
        for (sensor, estimate) in (0_u8..).zip(&estimates) {
            let message = wire::force(estimate, counter);
            let id = wire::identifier(
                wire::DEFAULT_NODE,
                wire::messages::Force::LAYOUT.number + sensor,
            );
            let bytes = message.to_bytes();
            if let Ok(frame) = CanFrame::new_standard(id, &bytes)
                && with_timeout(CAN_PATIENCE, can.write(&frame)).await.is_err()
            {
                warn!("nobody acknowledges on the CAN bus");
            }
        }
        if counter.is_multiple_of(REPORTS_PER_LINE) {
            for (sensor, estimate) in (0_u8..).zip(&estimates) {
                let [x, z] = estimate.force;
                info!(
                    "sensor {}: {} {} /1024 N, valid {}, disturbed {}, effects not undone for want of an input {}",
                    sensor,
                    x.0,
                    z.0,
                    estimate.validity == Validity::Valid,
                    estimate.disturbed,
                    estimate.lacking
                );
            }
        }
        counter = counter.wrapping_add(1);
    }
}
