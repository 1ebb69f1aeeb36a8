//! The gripper's board without hardware, in two layers with the same surroundings ([`Connections`]): the firmware's loops
//! in virtual time ([`Board`]), fast; and the image in an emulated chip ([`emulated::EmulatedBoard`]), complete.
//!
//! - [`time`]: virtual time.
//! - [`world`]: what the sensors feel.
//! - [`i2c`]: a bus with sensors, registers and levels.
//! - [`can`]: a CAN bus.
//! - [`line`](mod@line): a serial line.
//! - [`host`]: a host on it.
//! - [`flash`]: where parameters are kept.
//! - [`recorded`], [`pressed`]: worlds.
//! - [`emulated`]: the image in an emulated chip.
//!
//! What the loops in virtual time do not show: how long the chip computes (virtual time stands still meanwhile), interrupts
//! and their levels, the chip's drivers, electrical behaviour.

pub mod can;
pub mod emulated;
pub mod flash;
pub mod host;
pub mod i2c;
pub mod line;
pub mod pressed;
pub mod recorded;
pub mod time;
pub mod world;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use embassy_futures::join::join;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use firmware::clock::Clock;
use firmware::crash::{Crash, Kind};
use firmware::estimator::Estimator;
use firmware::events::Event;
use firmware::grip::Grip;
use firmware::hall::Part;
use firmware::hall::a31301::A31301;
use firmware::limits::{Grasp, Limits};
use firmware::loops::{self, Around, Desk, Exchange, Reins, Turns};
use firmware::model::table::Tables;
use firmware::motor::Order;
use firmware::motor::screw::Screw;
use firmware::parameters::{self, Parameters};
use firmware::store::Store;
use firmware::wire::messages::Version;
use firmware::wire::{DEFAULT_NODE, PROTOCOL};
use futures::executor::LocalPool;
use futures::task::LocalSpawnExt;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::quantise::TableSet;

use can::{CanBus, Controller};
use flash::Flash;
use i2c::{Sensor, SimulatedBus, Wires};
use line::Line;
use time::VirtualClock;
use world::{Motor, NoMotor, Now, World};

use crate::networks::Networks;

/// This board in [`Version`].
const HARDWARE: u8 = 0;

/// What the board drives.
pub struct Driven {
    /// The motor.
    pub motor: Box<dyn Motor>,
    /// The screw behind it, as the firmware knows it.
    pub screw: Screw,
    /// Where something counts as wrong in the grasp.
    pub grasp: Grasp,
}

impl Driven {
    /// Nothing.
    pub fn nothing() -> Self {
        Self {
            motor: Box::new(NoMotor),
            screw: Screw::A,
            grasp: Grasp::GRIPPER,
        }
    }
}

/// The way to the motor.
struct Orders {
    motor: Rc<RefCell<Box<dyn Motor>>>,
    clock: VirtualClock,
    crashed: Rc<Cell<Option<Crash>>>,
}

impl Reins for Orders {
    fn order(&mut self, order: Order) -> Result<(), Order> {
        let time_us = self.clock.now_us();
        self.motor.borrow_mut().order(time_us, order)
    }

    fn give_up(&mut self) {
        self.motor.borrow_mut().restart(self.clock.now_us());
        self.crashed.set(Some(Crash::new(Kind::Corruption)));
    }
}

/// What runs on the board.
pub struct Program {
    /// The tables.
    pub tables: TableSet,
    /// What is undone around them.
    pub compensations: Vec<OwnedCompensation>,
    /// Networks over them.
    pub networks: Option<Networks>,
    /// What hosts have set and saved.
    pub parameters: Parameters,
    /// Where something counts as wrong.
    pub limits: Limits,
}

/// What is around a board, whichever way its program runs.
#[derive(Clone)]
pub struct Connections {
    /// Its buses with two sensors each.
    pub buses: [Rc<RefCell<Wires>>; 2],
    /// Its CAN bus.
    pub can: Rc<RefCell<CanBus>>,
    /// Its serial line.
    pub line: Rc<RefCell<Line>>,
    /// What its sensors measure.
    pub now: Rc<RefCell<Now>>,
}

impl Connections {
    /// Four sensors in a world; those that the world does not know are not on the buses.
    pub fn new(world: Box<dyn World>) -> Self {
        let now = Rc::new(RefCell::new(Now::new(world)));
        let readings = now.borrow_mut().at(0).readings;
        let buses = [[0, 1], [2, 3]].map(|numbers| {
            let sensors = numbers.map(|number| {
                let mut sensor = Sensor::new(number, A31301::ADDRESSES[number]);
                sensor.unplugged = readings[number].is_none();
                sensor
            });
            Rc::new(RefCell::new(Wires::new(sensors.to_vec(), now.clone())))
        });
        Self {
            buses,
            can: Rc::default(),
            line: Rc::default(),
            now,
        }
    }

    /// Does something to a sensor, by its number on the gripper.
    pub fn change_sensor(&self, number: usize, change: impl Fn(&mut Sensor)) {
        for bus in &self.buses {
            let sensors = &mut bus.borrow_mut().sensors;
            let chosen = sensors.iter_mut().filter(|sensor| sensor.number == number);
            chosen.for_each(&change);
        }
    }
}

/// A board without hardware, whichever way its program runs.
pub trait SimulatedBoard {
    /// Goes on until this time, in microseconds since it was switched on.
    ///
    /// # Errors
    /// The program cannot go on.
    fn run_until(&mut self, time_us: u64) -> anyhow::Result<()>;

    /// What is around it.
    fn connections(&self) -> &Connections;

    /// Where the grasp stands; none where only its messages say so.
    fn stands(&self) -> Option<loops::Stands> {
        None
    }

    /// Turns a bit of what the grasp keeps ([`firmware::grip::kept`]) in the program's memory.
    fn spoil_grasp(&mut self, bit: u32);

    /// Faults and clearings of buses since the last call, with the board's own time in microseconds.
    fn take_events(&mut self) -> Vec<(u64, Event)>;
}

/// The firmware's loops in virtual time.
pub struct Board {
    pool: LocalPool,
    /// Its time.
    pub clock: VirtualClock,
    /// What is around it.
    pub connections: Connections,
    /// Its CAN controller.
    pub controller: Rc<Controller>,
    /// What aborted transfers have left in the controllers of its buses.
    pub residues: [Rc<Cell<Option<u8>>>; 2],
    /// What its loops hand to each other.
    pub exchange: Rc<Exchange<NoopRawMutex>>,
    /// What was told to its log, and when.
    pub events: Rc<RefCell<Vec<(u64, Event)>>>,
    /// Its grasp. What is done to its memory goes wrong.
    pub grip: Rc<RefCell<Grip>>,
    program: Rc<Program>,
    motor: Rc<RefCell<Box<dyn Motor>>>,
    screw: Screw,
    grasp: Grasp,
    /// What ended the program, until it is started again.
    crashed: Rc<Cell<Option<Crash>>>,
}

impl Board {
    /// Switches a board without a motor on in a world.
    pub fn start(program: Program, world: Box<dyn World>) -> Self {
        Self::start_with(program, world, Driven::nothing())
    }

    /// Switches a board on in a world.
    pub fn start_with(program: Program, world: Box<dyn World>, driven: Driven) -> Self {
        let clock = VirtualClock::default();
        let connections = Connections::new(world);
        let controller = Controller::new(connections.can.clone(), clock.clone());
        let grip = grasp(&program, driven.screw, driven.grasp);
        let mut board = Self {
            pool: LocalPool::new(),
            clock,
            connections,
            controller,
            residues: Default::default(),
            exchange: Rc::new(Exchange::new()),
            events: Rc::default(),
            grip: Rc::new(RefCell::new(grip)),
            program: Rc::new(program),
            motor: Rc::new(RefCell::new(driven.motor)),
            screw: driven.screw,
            grasp: driven.grasp,
            crashed: Rc::default(),
        };
        board.spawn_loops();
        board
    }

    /// Starts the program that crashed, which takes no time here. Actors of others are gone, and so is what hosts
    /// have set and not saved.
    fn restart(&mut self, crash: Crash) {
        self.pool = LocalPool::new();
        self.exchange = Rc::new(Exchange::new());
        self.grip = Rc::new(RefCell::new(grasp(&self.program, self.screw, self.grasp)));
        self.exchange.note_crash(&crash);
        self.spawn_loops();
    }

    fn spawn_loops(&mut self) {
        let program = self.program.clone();
        let limits = program.limits;
        let tables_id = program.tables.id;
        let parameters = program.parameters;
        let addresses = parameters.addresses();
        let shared = (self.clock.clone(), self.exchange.clone());
        let parts = move || shared.clone();
        let buses = [0, 1].map(|bus| SimulatedBus {
            wires: self.connections.buses[bus].clone(),
            clock: self.clock.clone(),
            residue: self.residues[bus].clone(),
        });
        let (clock, exchange) = parts();
        self.spawn(async move {
            loops::sense::<A31301, _, _, _>(buses, addresses, &limits, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let now = self.connections.now.clone();
        let tells = self.motor.clone();
        self.spawn(async move {
            let compensations: Vec<_> = program
                .compensations
                .iter()
                .map(OwnedCompensation::view)
                .collect();
            let tables = program.tables.tables(&compensations);
            let networks = program.networks.as_ref().map(Networks::run);
            let mut estimator = Estimator::new(&tables, networks);
            let around = || {
                let time_us = clock.now_us();
                Around {
                    surroundings: now.borrow_mut().at(time_us).around,
                    motor: tells.borrow_mut().telling(time_us),
                }
            };
            let scrub = loops::scrub::<_, Tables, 0, _, _>(&tables, &[], &clock, &exchange);
            let estimate = loops::estimate(&mut estimator, around, &limits, &clock, &exchange);
            join(scrub, estimate).await;
        });
        let (clock, exchange) = parts();
        let grip = self.grip.clone();
        let mut orders = Orders {
            motor: self.motor.clone(),
            clock,
            crashed: self.crashed.clone(),
        };
        self.spawn(async move {
            // As `loops::grip`, but for the grasp that others may spoil between two turns.
            let mut turns = Turns::default();
            loop {
                let felt = exchange.felt.wait().await;
                turns.take(&mut grip.borrow_mut(), &felt, &mut orders, &exchange);
            }
        });
        let (clock, exchange) = parts();
        let sender = can::Sender(self.controller.clone());
        let events = self.events.clone();
        self.spawn(async move {
            let log = |event| events.borrow_mut().push((clock.now_us(), event));
            let version = version(tables_id);
            loops::report(sender, (DEFAULT_NODE, version), log, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let out = line::Out {
            line: self.connections.line.clone(),
            clock,
        };
        self.spawn(async move { loops::telemetry(out, &exchange).await });
        let (clock, exchange) = parts();
        let receiver = can::Receiver(self.controller.clone());
        self.spawn(async move { loops::listen(receiver, &limits, &clock, &exchange).await });
        let (clock, exchange) = parts();
        let into = line::Into(self.connections.line.clone());
        self.spawn(async move {
            loops::listen_serial(into, DEFAULT_NODE, &limits, &clock, &exchange).await
        });
        let (clock, exchange) = parts();
        self.spawn(async move {
            let mut state = 1_u16;
            // Any sequence that does not repeat soon: nonces need not be secret here.
            let random = move || {
                state = state.wrapping_mul(25_173).wrapping_add(13_849);
                state
            };
            let mut store = Store::new(Flash::default(), 0);
            // A new flash takes what it is given.
            let _ = store.save(&parameters).await;
            let loaded = loops::begin(&mut store, &exchange).await;
            let desk = Desk {
                version: version(tables_id),
                store,
                loaded,
                random,
                // Whoever restarts a simulated board starts another.
                reboot: || {},
            };
            loops::command(desk, &clock, &exchange).await;
        });
        let passing = self.controller.clone().run();
        self.spawn(passing);
    }

    /// Lets somebody else act on the board's buses.
    pub fn spawn(&mut self, actor: impl Future<Output = ()> + 'static) {
        // The pool is there as long as its spawner.
        let _ = self.pool.spawner().spawn_local(actor);
    }

    /// Goes on until this time.
    pub fn run_until(&mut self, time_us: u64) {
        self.go_on();
        while self.clock.leap(time_us) {
            self.go_on();
        }
    }

    fn go_on(&mut self) {
        self.pool.run_until_stalled();
        if let Some(crash) = self.crashed.take() {
            self.restart(crash);
            self.pool.run_until_stalled();
        }
    }
}

impl SimulatedBoard for Board {
    fn run_until(&mut self, time_us: u64) -> anyhow::Result<()> {
        Self::run_until(self, time_us);
        Ok(())
    }

    fn connections(&self) -> &Connections {
        &self.connections
    }

    fn stands(&self) -> Option<loops::Stands> {
        Some(self.exchange.stands.get())
    }

    fn spoil_grasp(&mut self, bit: u32) {
        self.grip.borrow_mut().spoil(bit);
    }

    fn take_events(&mut self) -> Vec<(u64, Event)> {
        std::mem::take(&mut self.events.borrow_mut())
    }
}

fn grasp(program: &Program, screw: Screw, limits: Grasp) -> Grip {
    let locks = program.parameters.screw() == parameters::Screw::SelfLocking;
    Grip::new(limits, screw, locks)
}

fn version(tables: u16) -> Version {
    Version {
        protocol_major: PROTOCOL.0,
        protocol_minor: PROTOCOL.1,
        hardware: HARDWARE,
        tables,
        ..Version::default()
    }
}
