//! The loops: instructions of a millisecond in which four sensors are read, their forces are estimated by ideal model
//! and networks, the grasp thinks, everything is told, and the tables are walked.
//!
//! Buses answer at once; what the chip's drivers, interrupts and executor take is not in it. All loops are polled
//! as often as any of them has something to send, which is more often than an executor would.

use core::cell::Cell;
use core::convert::Infallible;
use core::fmt::{Error, Result as Printed, Write};
use core::future::{Future, poll_fn, ready};
use core::pin::{Pin, pin};
use core::task::{Context, Poll, Waker};

use embassy_futures::join::{join, join4};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_can::{Frame, StandardId};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation, SevenBitAddress};
use firmware::clock::Clock;
use firmware::estimator::{Estimator, Running};
use firmware::frame::SENSORS;
use firmware::grip::Grip;
use firmware::hall::Reading;
use firmware::hall::a31301::{A31301, encode};
use firmware::hall::bus::SensorBus;
use firmware::limits::{Grasp, Limits};
use firmware::loops::{self, Around, Exchange, Reins};
use firmware::model::network::{Guard, Input, Network, Source, Target};
use firmware::model::tables::TABLES;
use firmware::motor::Order;
use firmware::motor::screw::Screw;
use firmware::status::Fault;
use firmware::wire::can::{CanError, CanFrame, CanReceiver, CanSender};
use firmware::wire::identifier;
use firmware::wire::messages::Version;

use crate::counts::Counter;
use crate::vectors;

/// Milliseconds that are counted, after those of the start.
const TICKS: u64 = 200;
const STARTS: u64 = 20;
/// Frames of a flood in a millisecond: the shortest there are, at 1 Mbit/s.
const FLOOD: u32 = 21;

/// Lines for a millisecond on the average and at the most, and for one of a flood on the average.
pub fn print(counter: &Counter, out: &mut impl Write) -> Printed {
    let [mean, greatest] = count(counter, 0).ok_or(Error)?;
    let [flooded, _] = count(counter, FLOOD).ok_or(Error)?;
    writeln!(out, "loops_mean {mean}")?;
    writeln!(out, "loops_tick {greatest}")?;
    writeln!(out, "loops_flood {flooded}")
}

/// Instructions of a millisecond, on the average and at the most; none if fewer packets left than there should.
fn count(counter: &Counter, frames: u32) -> Option<[u32; 2]> {
    let world = World::default();
    let exchange = &Exchange::<CriticalSectionRawMutex>::new();
    let mut estimator = Estimator::new(&TABLES, Running::start(&NETWORKS));
    let mut grip = Grip::new(Grasp::GRIPPER, Screw::A, true);
    let limits = Limits::GRIPPER;
    let buses = [Bus(&world), Bus(&world)];
    let sense =
        loops::sense::<A31301, _, _, _>(buses, [0x60, 0x63, 0x6C, 0x6F], &limits, &world, exchange);
    let estimate = loops::estimate(&mut estimator, Around::default, &limits, &world, exchange);
    let report = loops::report(
        Wire(&world),
        (1, Version::default()),
        |_| (),
        &world,
        exchange,
    );
    let mut all = pin!(join(
        join4(
            sense,
            estimate,
            loops::grip(&mut grip, Nobody, exchange),
            report
        ),
        join4(
            loops::telemetry(Line(&world), exchange),
            loops::listen(Wire(&world), &limits, &world, exchange),
            loops::scrub(&TABLES, &NETWORKS, &world, exchange),
            hear(exchange),
        ),
    ));
    let (mut sum, mut greatest) = (0, 0);
    for tick in 0..STARTS + TICKS {
        world.frames.set(frames);
        let mut millisecond = || {
            // Sensors answer within the millisecond: the loops' waits in it end at its end.
            world.time_us.set(world.time_us.get() + 1000);
            run(&world, all.as_mut());
        };
        if tick < STARTS {
            millisecond();
            continue;
        }
        let count = counter.instructions(millisecond);
        sum += count;
        greatest = greatest.max(count);
    }
    // Every tick's packet and forces, sound tables, and the flood: otherwise something else was counted.
    let has_told = world.packets.get() > TICKS as u32 && world.sent.get() > TICKS as u32 / 10;
    let is_sound = !exchange.is_active(Fault::TablesUnsound);
    let is_seen = exchange.is_active(Fault::Flooded) == (frames > 0);
    (has_told && is_sound && is_seen).then_some([sum / TICKS as u32, greatest])
}

/// Polls until nothing more comes in or goes out: within a poll each loop has what those before it in their order
/// hand on.
fn run(world: &World, mut all: Pin<&mut impl Future>) {
    let mut context = Context::from_waker(Waker::noop());
    let mut before = None;
    while before.replace(world.traffic()) != Some(world.traffic()) {
        let _ = all.as_mut().poll(&mut context);
    }
}

/// What a host's frames are taken out for.
async fn hear(exchange: &Exchange<CriticalSectionRawMutex>) {
    loop {
        let _ = exchange.heard.receive().await;
    }
}

/// Four networks of two layers of 16 units over the fields, one for each sensor. What their weights are takes no
/// time: all are zero.
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
        weights: vectors::nothing(),
        check: CHECKS[sensor as usize % SENSORS],
    }
}

const fn input(sensor: u8, axis: u8) -> Input {
    Input {
        source: Source::Field { sensor, axis },
        offset: 0,
        gain: 1 << 20,
    }
}

/// Checksums of the four networks, as the exporter would write them.
const CHECKS: [u32; SENSORS] = [0x22b8_8686, 0xd23e_45b5, 0x18c4_06a1, 0xe842_c592];

/// Time, and what has happened.
#[derive(Default)]
struct World {
    time_us: Cell<u64>,
    /// Frames that wait for the board.
    frames: Cell<u32>,
    /// Frames and packets of the board.
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
        poll_fn(|_| match self.now_us() >= time_us {
            true => Poll::Ready(()),
            false => Poll::Pending,
        })
        .await;
    }
}

/// A bus on which every sensor answers.
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
        let bytes = encode(Reading {
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

/// A CAN bus that takes every frame at once.
struct Wire<'w>(&'w World);

impl CanSender for Wire<'_> {
    fn send(&mut self, _: &CanFrame) -> impl Future<Output = Result<(), CanError>> {
        self.0.sent.set(self.0.sent.get() + 1);
        ready(Ok(()))
    }

    fn rejoin(&mut self) {}
}

impl CanReceiver for Wire<'_> {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        let frames = &self.0.frames;
        let left = poll_fn(|_| {
            frames
                .get()
                .checked_sub(1)
                .map_or(Poll::Pending, Poll::Ready)
        });
        frames.set(left.await);
        let id = StandardId::new(identifier(1, 0x1F)).unwrap_or(StandardId::ZERO);
        CanFrame::new(id, &[]).ok_or(CanError::Passing)
    }
}

/// A serial line that takes every byte at once.
struct Line<'w>(&'w World);

impl embedded_io_async::ErrorType for Line<'_> {
    type Error = Infallible;
}

impl embedded_io_async::Write for Line<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.packets.set(self.0.packets.get() + 1);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A motor that takes every order.
struct Nobody;

impl Reins for Nobody {
    fn order(&mut self, _: Order) -> Result<(), Order> {
        Ok(())
    }

    fn give_up(&mut self) {}
}
