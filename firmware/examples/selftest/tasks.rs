//! The tasks: instructions of a millisecond with four sensor readings, forces by ideal model and networks, grip, messages and
//! the check of the tables.
//!
//! Buses answer at once; the time of drivers, interrupts and executor is not included. All tasks are polled as often as any
//! of them has output, which is more often than an executor would.

use core::cell::Cell;
use core::convert::Infallible;
use core::fmt::{Error, Result as Printed, Write};
use core::future::{Future, poll_fn, ready};
use core::pin::{Pin, pin};
use core::task::{Context, Poll, Waker};

use embassy_futures::join::{join, join3, join4};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_can::{Frame, StandardId};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation, SevenBitAddress};
use firmware::board::MotorPort;
use firmware::clock::Clock;
use firmware::config::limits::{DetectionLimits, GripLimits};
use firmware::estimator::Estimator;
use firmware::estimator::gru::GruBank;
use firmware::grip::GripController;
use firmware::model::formats::{Guard, Input, InputSource, Network, Target};
use firmware::model::integrity::Scrub;
use firmware::model::tables::TABLES;
use firmware::motor::MotorCommand;
use firmware::motor::screw::Screw;
use firmware::protocol::can::{CanError, CanFrame, CanReceiver, CanSender};
use firmware::protocol::frame_id;
use firmware::protocol::messages::Version;
use firmware::sensors::hall::a31301::{A31301, encode};
use firmware::sensors::hall::{HallReading, SENSORS, SensorBus};
use firmware::system::faults::Fault;
use firmware::tasks::{self, GripInputs, GripLoop, SharedState};

use crate::counts::Counter;
use crate::vectors;

/// Counted milliseconds, after the first check of the tables.
const TICKS: u64 = 200;
/// Maximum time of that check.
const MAX_START_TICKS: u64 = 5000;
/// Frames of a flood in a millisecond: the shortest ones at 1 Mbit/s.
const FLOOD: u32 = 21;

/// Prints mean and maximum of a millisecond, and the mean during a flood.
pub fn print(counter: &Counter, out: &mut impl Write) -> Printed {
    let [mean, max] = count(counter, 0).ok_or(Error)?;
    let [flooded, _] = count(counter, FLOOD).ok_or(Error)?;
    writeln!(out, "loops_mean {mean}")?;
    writeln!(out, "loops_tick {max}")?;
    writeln!(out, "loops_flood {flooded}")
}

/// Mean and maximum of the instructions of a millisecond; `None` if too few packets were sent.
fn count(counter: &Counter, frames: u32) -> Option<[u32; 2]> {
    let world = World::default();
    let shared = &SharedState::<CriticalSectionRawMutex>::new();
    let mut estimator = Estimator::new(&TABLES, GruBank::<_, _, _, SENSORS>::new(&NETWORKS));
    let mut grip = GripController::new(GripLimits::GRIPPER, Screw::A, true);
    let limits = DetectionLimits::GRIPPER;
    let buses = [Bus(&world), Bus(&world)];
    let sense =
        tasks::sense::<A31301, _, _, _>(buses, [0x60, 0x63, 0x6C, 0x6F], &limits, &world, shared);
    let mut state = GripLoop::default();
    let step = |inputs: &GripInputs| state.step(&mut grip, inputs, &mut IdleMotor, shared);
    let estimate = tasks::estimate(&mut estimator, || None, step, &limits, &world, shared);
    let report = tasks::transmit(CanBus(&world), (1, Version::default()), |_| (), &world, shared);
    let mut all = pin!(join(
        join3(sense, estimate, report),
        join4(
            tasks::transmit_serial(SerialLine(&world), shared),
            tasks::receive_can(CanBus(&world), &limits, &world, shared),
            tasks::scrub(
                &TABLES,
                NETWORKS.each_ref().map(|one| Some(one as &dyn Scrub)),
                &world,
                shared
            ),
            discard_frames(shared),
        ),
    ));
    let (mut sum, mut max) = (0, 0);
    let mut millisecond = || {
        world.frames.set(frames);
        // Sensors answer at once. The configuration of one is read back in the first half.
        for _ in 0..2 {
            world.time_us.set(world.time_us.get() + 500);
            run(&world, all.as_mut());
        }
    };
    let mut start = 0..MAX_START_TICKS;
    while !shared.tables_checked.signaled() {
        start.next()?;
        millisecond();
    }
    for _ in 0..TICKS {
        let count = counter.instructions(&mut millisecond);
        sum += count;
        max = max.max(count);
    }
    // Check that the counted work includes packets, forces, valid tables, and the flood.
    let has_sent = world.packets.get() > TICKS as u32 && world.sent.get() > TICKS as u32 / 10;
    let is_sound = !shared.is_active(Fault::TablesUnsound);
    let is_flood_detected = shared.is_active(Fault::Flooded) == (frames > 0);
    (has_sent && is_sound && is_flood_detected).then_some([sum / TICKS as u32, max])
}

/// Polls until there is no more input or output.
fn run(world: &World, mut all: Pin<&mut impl Future>) {
    let mut context = Context::from_waker(Waker::noop());
    let mut before = None;
    while before.replace(world.traffic()) != Some(world.traffic()) {
        let _ = all.as_mut().poll(&mut context);
    }
}

/// Discards the received frames.
async fn discard_frames(shared: &SharedState<CriticalSectionRawMutex>) {
    loop {
        let _ = shared.rx_frames.receive().await;
    }
}

/// Four networks of two layers of 16 units, one for each sensor. The weights do not affect the time: all are zero.
static NETWORKS: [Network<2, 8, 1>; SENSORS] = [network(0), network(1), network(2), network(3)];

const fn network(sensor: u8) -> Network<2, 8, 1> {
    let [x, y, z] = [input(sensor, 0), input(sensor, 1), input(sensor, 2)];
    Network {
        sensors: [sensor],
        target: Target::Rest,
        inputs: [[x, y], [z, x]],
        force: [1 << 10; 2],
        warm_up: 3,
        guards: [Guard::NONE],
        weights: vectors::zero_weights(),
        check: CHECKS[sensor as usize % SENSORS],
    }
}

const fn input(sensor: u8, axis: u8) -> Input {
    Input { source: InputSource::Field { sensor, axis }, offset: 0, gain: 1 << 20 }
}

/// Checksums of the four networks, as the exporter would write them.
const CHECKS: [u32; SENSORS] = [0x22b8_8686, 0xd23e_45b5, 0x18c4_06a1, 0xe842_c592];

/// Time and traffic.
#[derive(Default)]
struct World {
    time_us: Cell<u64>,
    /// Frames to be received.
    frames: Cell<u32>,
    /// Sent frames and packets.
    sent: Cell<u32>,
    packets: Cell<u32>,
}

impl World {
    fn traffic(&self) -> [u32; 3] {
        [self.frames.get(), self.sent.get(), self.packets.get()]
    }
}

impl Clock for World {
    fn now_us(&self) -> u64 {
        self.time_us.get()
    }

    async fn until(&self, time_us: u64) {
        poll_fn(|_| if self.now_us() >= time_us { Poll::Ready(()) } else { Poll::Pending }).await;
    }
}

/// A bus with four sensors that answer at once.
struct Bus<'w>(&'w World);

impl ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl I2c<SevenBitAddress> for Bus<'_> {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Infallible> {
        let flicker = (self.0.now_us() as u32 / 1000 % 7) as i16;
        let bytes = encode(HallReading {
            field: [i16::from(address), flicker, 4000 + flicker],
            temperature: 100,
        });
        for operation in operations {
            if let Operation::Read(into) = operation {
                into.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
            }
        }
        Ok(())
    }
}

impl SensorBus for Bus<'_> {
    async fn recover(&mut self) -> bool {
        true
    }
}

/// A CAN bus that accepts every frame at once.
struct CanBus<'w>(&'w World);

impl CanSender for CanBus<'_> {
    fn send(&mut self, _: &CanFrame) -> impl Future<Output = Result<(), CanError>> {
        self.0.sent.set(self.0.sent.get() + 1);
        ready(Ok(()))
    }

    fn rejoin(&mut self) {}
}

impl CanReceiver for CanBus<'_> {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        let frames = &self.0.frames;
        let left = poll_fn(|_| frames.get().checked_sub(1).map_or(Poll::Pending, Poll::Ready));
        frames.set(left.await);
        let id = StandardId::new(frame_id(1, 0x1F)).unwrap_or(StandardId::ZERO);
        CanFrame::new(id, &[]).ok_or(CanError::Transient)
    }
}

/// A serial line that accepts every byte at once.
struct SerialLine<'w>(&'w World);

impl embedded_io_async::ErrorType for SerialLine<'_> {
    type Error = Infallible;
}

impl embedded_io_async::Write for SerialLine<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.packets.set(self.0.packets.get() + 1);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A motor that accepts every order.
struct IdleMotor;

impl MotorPort for IdleMotor {
    fn order(&mut self, _: MotorCommand) -> Result<(), MotorCommand> {
        Ok(())
    }

    fn shut_down(&mut self) {}
}
