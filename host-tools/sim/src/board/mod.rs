//! The gripper's board without hardware: the firmware's tasks in virtual time, with simulated buses and flash.
//!
//! The same [`Connections`] also surround an image in an emulated chip
//! ([`crate::closed_loop::emulated_board`]), which is slower and complete.
//!
//! - [`clock`]: virtual time.
//! - [`world`]: what the sensors measure.
//! - [`i2c`]: sensor buses, with sensors, registers and levels.
//! - [`inertial`]: inertial sensor on SPI.
//! - [`can`], [`host`]: CAN bus and a host on it.
//! - [`serial`]: serial line.
//! - [`flash`]: memory of the settings.
//!
//! Not simulated in virtual time: execution times, interrupts and their priorities, drivers, electrical behaviour.

pub mod can;
pub mod clock;
pub mod flash;
pub mod forger;
pub mod host;
pub mod i2c;
pub mod inertial;
pub mod serial;
pub mod world;

use crate::board::can::{CanBus, CanController};
use crate::board::clock::VirtualClock;
use crate::board::flash::Flash;
use crate::board::i2c::{I2cSensor, SensorBusWires, SimulatedI2c};
use crate::board::inertial::{InertialSensor, SharedInertialSensor, SimulatedSpi};
use crate::board::serial::SerialLink;
use crate::board::world::{NoMotor, SimulatedMotor, World, WorldClock};
use embassy_futures::join::join;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use firmware::board::MotorPort;
use firmware::clock::Clock;
use firmware::config::limits::{DetectionLimits, GripLimits};
use firmware::estimator::{self, Estimate, Estimator};
use firmware::grip::GripController;
use firmware::model::calibration::{
    Calibration, CalibrationMemory, CompensationMemory, POOL_INTEGERS, Payload,
};
use firmware::model::formats::{EXP_ENTRIES, Tables};
use firmware::motor::MotorCommand;
use firmware::motor::limits::Temperatures;
use firmware::motor::screw::Screw;
use firmware::parameters::{self, Parameters};
use firmware::protocol::{DEFAULT_NODE, firmware_version};
use firmware::sensors::hall::a31301::A31301;
use firmware::sensors::hall::{HallSensor, SENSORS};
use firmware::sensors::imu::Lsm6ds3;
use firmware::sensors::thermistor;
use firmware::system::crash::{Crash, CrashKind};
use firmware::system::faults::Event;
use firmware::system::nv_storage::ParameterStore;
use firmware::system::nv_storage::calibration::CalibrationSlots;
use firmware::tasks::calibration::{
    CalibrationDefect, CalibrationOrigin, CalibrationService, LinkedCalibration, Memories,
};
use firmware::tasks::temperatures::BoardTemperatures;
use firmware::tasks::{self, GripInputs, GripLoop, HostService, SharedState};
use futures::executor::{LocalPool, block_on};
use futures::task::LocalSpawnExt;
use model_export::gru::pack::{self, NetworkRun, PackedNetwork};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::quantise::TableSet;
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// Hardware number of this board in its version message.
const HARDWARE: u8 = 0;

/// Motor of the board and its limits.
pub struct MotorConnection {
    /// Simulated motor.
    pub motor: Box<dyn SimulatedMotor>,
    /// Screw parameters of the firmware.
    pub screw: Screw,
    /// Thresholds of the grasp.
    pub grasp: GripLimits,
}

impl MotorConnection {
    /// A board without a motor.
    pub fn none() -> Self {
        Self { motor: Box::new(NoMotor), screw: Screw::A, grasp: GripLimits::GRIPPER }
    }
}

/// Motor commands of the grasp task.
struct MotorCommands {
    motor: Rc<RefCell<Box<dyn SimulatedMotor>>>,
    clock: VirtualClock,
    crashed: Rc<Cell<Option<Crash>>>,
}

impl MotorPort for MotorCommands {
    fn order(&mut self, order: MotorCommand) -> Result<(), MotorCommand> {
        let time_us = self.clock.now_us();
        self.motor.borrow_mut().order(time_us, order)
    }

    fn shut_down(&mut self) {
        self.motor.borrow_mut().restart(self.clock.now_us());
        self.crashed.set(Some(Crash::new(CrashKind::Corruption)));
    }
}

/// Program of the board.
pub struct Program {
    /// Force tables.
    pub tables: TableSet,
    /// Compensations of the tables.
    pub compensations: Vec<OwnedCompensation>,
    /// Residual networks.
    pub networks: Option<Vec<Box<dyn PackedNetwork>>>,
    /// Origin of tables and networks, as TOML.
    pub description: &'static str,
    /// Saved settings.
    pub parameters: Parameters,
    /// Thresholds of the sensors.
    pub limits: DetectionLimits,
}

/// Run networks behind the tables.
struct NetworkBank<'a>(Vec<Box<dyn NetworkRun + 'a>>);

impl estimator::NetworkBank for NetworkBank<'_> {
    fn apply(&mut self, frame: &mut [Estimate; SENSORS]) {
        pack::apply(&mut self.0, frame);
    }
}

/// Connections of a board, for the tasks in virtual time and for an emulated chip.
#[derive(Clone)]
pub struct Connections {
    /// Sensor buses with two sensors each.
    pub buses: [Rc<RefCell<SensorBusWires>>; 2],
    /// Inertial sensor.
    pub inertial: SharedInertialSensor,
    /// CAN bus.
    pub can: Rc<RefCell<CanBus>>,
    /// Serial line.
    pub line: Rc<RefCell<SerialLink>>,
    /// Measured quantities.
    pub now: Rc<RefCell<WorldClock>>,
}

impl Connections {
    /// Four sensors in a world; those without a reading are not on the buses.
    pub fn new(world: Box<dyn World>) -> Self {
        let now = Rc::new(RefCell::new(WorldClock::new(world)));
        let readings = now.borrow_mut().at(0).readings;
        let buses = [[0, 1], [2, 3]].map(|numbers| {
            let sensors = numbers.map(|number| {
                let mut sensor = I2cSensor::new(number, A31301::ADDRESSES[number]);
                sensor.unplugged = readings[number].is_none();
                sensor
            });
            Rc::new(RefCell::new(SensorBusWires::new(sensors.to_vec(), now.clone())))
        });
        let inertial = Rc::new(RefCell::new(InertialSensor::new(now.clone())));
        Self { buses, inertial, can: Rc::default(), line: Rc::default(), now }
    }

    /// A copy in its present state, which goes on with a copy of its world.
    pub fn copy(&self, world: Box<dyn World>) -> Self {
        let now = Rc::new(RefCell::new(self.now.borrow().copy(world)));
        let buses = self.buses.each_ref().map(|bus| Rc::new(RefCell::new(bus.borrow().copy(&now))));
        let inertial = Rc::new(RefCell::new(self.inertial.borrow().copy(&now)));
        let can = Rc::new(RefCell::new(self.can.borrow().clone()));
        let line = Rc::new(RefCell::new(self.line.borrow().clone()));
        Self { buses, inertial, can, line, now }
    }

    /// Modifies a sensor, by its number on the gripper.
    pub fn change_sensor(&self, number: usize, change: impl Fn(&mut I2cSensor)) {
        for bus in &self.buses {
            let sensors = &mut bus.borrow_mut().sensors;
            let chosen = sensors.iter_mut().filter(|sensor| sensor.number == number);
            chosen.for_each(&change);
        }
    }
}

/// A board without hardware.
pub trait SimulatedBoard {
    /// Runs until a time in microseconds since power-on.
    ///
    /// # Errors
    /// The program cannot continue.
    fn run_until(&mut self, time_us: u64) -> anyhow::Result<()>;

    /// Connections of the board.
    fn connections(&self) -> &Connections;

    /// State of the grasp; none where only CAN messages report it.
    fn grip_status(&self) -> Option<tasks::GripSummary> {
        None
    }

    /// Flips a bit of the grasp's shadow state ([`firmware::grip::redundant_copy`]) in the program's memory.
    fn corrupt_grasp_memory(&mut self, bit: u32);

    /// Faults and bus recoveries since the last call, with the board's own time in microseconds.
    fn take_events(&mut self) -> Vec<(u64, Event)>;
}

/// The firmware's tasks in virtual time.
pub struct VirtualTimeBoard {
    pool: LocalPool,
    /// Virtual time.
    pub clock: VirtualClock,
    /// Connections of the board.
    pub connections: Connections,
    /// CAN controller.
    pub controller: Rc<CanController>,
    /// Bytes that aborted transfers left in the bus controllers.
    pub residues: [Rc<Cell<Option<u8>>>; 2],
    /// Shared state of the tasks.
    pub exchange: Rc<SharedState<NoopRawMutex>>,
    /// Logged events with their times.
    pub events: Rc<RefCell<Vec<(u64, Event)>>>,
    /// Limits; tests corrupt its memory.
    pub grip: Rc<RefCell<GripController>>,
    /// The redundant copies of the grip follow corruptions of its memory.
    pub hides_corruption: bool,
    program: Rc<Program>,
    motor: Rc<RefCell<Box<dyn SimulatedMotor>>>,
    screw: Screw,
    grasp: GripLimits,
    /// Cause of a pending restart.
    crashed: Rc<Cell<Option<Crash>>>,
    /// A host has requested a reboot.
    rebooting: Rc<Cell<bool>>,
    /// Whether somebody presses the button.
    pub button: Rc<Cell<bool>>,
    /// Parameters and calibrations.
    pub flash: Flash,
}

/// What the estimator of a board runs.
enum RunningCalibration {
    /// The program's tables and networks.
    Linked,
    /// A calibration from the flash.
    Stored(Calibration<'static, 2, 8, 1>),
}

impl VirtualTimeBoard {
    /// Switches on a board without a motor.
    pub fn start(program: Program, world: Box<dyn World>) -> Self {
        Self::start_with_motor(program, world, MotorConnection::none())
    }

    /// Switches on a board with a motor.
    pub fn start_with_motor(
        program: Program,
        world: Box<dyn World>,
        motor: MotorConnection,
    ) -> Self {
        let clock = VirtualClock::default();
        let connections = Connections::new(world);
        let controller = CanController::new(connections.can.clone(), clock.clone());
        let grip = grasp(&program, motor.screw, motor.grasp);
        let mut board = Self {
            pool: LocalPool::new(),
            clock,
            connections,
            controller,
            residues: Default::default(),
            exchange: Rc::new(SharedState::new()),
            events: Rc::default(),
            grip: Rc::new(RefCell::new(grip)),
            hides_corruption: false,
            program: Rc::new(program),
            motor: Rc::new(RefCell::new(motor.motor)),
            screw: motor.screw,
            grasp: motor.grasp,
            crashed: Rc::default(),
            rebooting: Rc::default(),
            button: Rc::default(),
            flash: Flash::default(),
        };
        let mut store = ParameterStore::new(board.flash.clone(), flash::PARAMETERS);
        // Cannot fail on an empty flash.
        let _ = block_on(store.save(&board.program.parameters));
        board.spawn_loops();
        board
    }

    /// Switches the supply off and on.
    pub fn power_cycle(&mut self) {
        self.restart(None);
    }

    /// Restarts the program, in no time. Spawned actors and unsaved settings are lost.
    fn restart(&mut self, crash: Option<Crash>) {
        self.pool = LocalPool::new();
        self.exchange = Rc::new(SharedState::new());
        self.grip = Rc::new(RefCell::new(grasp(&self.program, self.screw, self.grasp)));
        if let Some(crash) = crash {
            self.exchange.record_crash(&crash);
        }
        self.spawn_loops();
    }

    /// The newest calibration of the flash, decoded as the device does. Its memory is never freed, as on the device.
    fn load_calibration(
        &self,
    ) -> (RunningCalibration, CalibrationOrigin, Option<CalibrationDefect>) {
        let linked_origin = CalibrationOrigin::Linked(self.program.description);
        let slots = CalibrationSlots::new(flash::CALIBRATIONS);
        let mut flash = self.flash.clone();
        if block_on(slots.newest(&mut flash)).is_none() {
            let invalid = block_on(slots.has_invalid(&mut flash));
            let defect = invalid.then_some(CalibrationDefect::Invalid);
            return (RunningCalibration::Linked, linked_origin, defect);
        }
        let memories = Memories {
            calibration: Box::leak(Box::new(CalibrationMemory::EMPTY)),
            compensations: Box::leak(Box::new(CompensationMemory::EMPTY)),
            pool: Box::leak(vec![0; POOL_INTEGERS].into_boxed_slice()),
        };
        let none =
            Tables { id: 0, exp: &[0; EXP_ENTRIES], sensors: &[], compensations: &[], check: 0 };
        let payload = Payload { tables: Box::leak(Box::new(none)), networks: &[] };
        let linked = LinkedCalibration { payload, description: "" };
        let loading = tasks::calibration::load_calibration(&slots, &mut flash, memories, &linked);
        match block_on(loading) {
            (stored, origin @ CalibrationOrigin::Stored(_), defect) => {
                (RunningCalibration::Stored(stored), origin, defect)
            }
            (_, CalibrationOrigin::Linked(_), defect) => {
                (RunningCalibration::Linked, linked_origin, defect)
            }
        }
    }

    fn spawn_loops(&mut self) {
        let program = self.program.clone();
        let limits = program.limits;
        let (running, origin, defect) = self.load_calibration();
        let tables_id = match &running {
            RunningCalibration::Linked => program.tables.id,
            RunningCalibration::Stored(stored) => stored.tables.id,
        };
        let mut store = ParameterStore::new(self.flash.clone(), flash::PARAMETERS);
        let loaded = block_on(tasks::load_parameters(&mut store, &self.exchange));
        let addresses = loaded.parameters.addresses();
        let shared = (self.clock.clone(), self.exchange.clone());
        let parts = move || shared.clone();
        let buses = [0, 1].map(|bus| SimulatedI2c {
            wires: self.connections.buses[bus].clone(),
            clock: self.clock.clone(),
            residue: self.residues[bus].clone(),
        });
        let (clock, exchange) = parts();
        self.spawn(async move {
            tasks::sense::<A31301, _, _, _>(buses, addresses, &limits, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let sensor = self.connections.inertial.clone();
        self.spawn(async move {
            let imu = Lsm6ds3::new(SimulatedSpi { sensor, clock: clock.clone() });
            tasks::inertial::inertial(imu, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let motor = self.motor.clone();
        self.spawn(async move {
            let measure = || {
                let [motor, stage] = motor.borrow_mut().thermistors().map(thermistor::celsius);
                // The chip of this board has no temperature.
                BoardTemperatures { mcu: None, motor: Temperatures { motor, stage } }
            };
            tasks::temperatures::temperatures(measure, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let motor = self.motor.clone();
        let grip = self.grip.clone();
        let mut orders = MotorCommands {
            motor: self.motor.clone(),
            clock: clock.clone(),
            crashed: self.crashed.clone(),
        };
        self.spawn(async move {
            let motor = || Some(motor.borrow_mut().status(clock.now_us()));
            let mut state = GripLoop::default();
            let grip = |inputs: &GripInputs| {
                state.step(&mut grip.borrow_mut(), inputs, &mut orders, &exchange);
            };
            match running {
                RunningCalibration::Linked => {
                    let compensations: Vec<_> =
                        program.compensations.iter().map(OwnedCompensation::view).collect();
                    let tables = program.tables.tables(&compensations);
                    let networks = program.networks.as_ref();
                    let networks =
                        networks.map(|all| NetworkBank(all.iter().map(|one| one.run()).collect()));
                    let mut estimator = Estimator::new(&tables, networks);
                    let scrub = tasks::scrub(&tables, [None; SENSORS], &clock, &exchange);
                    let estimate =
                        tasks::estimate(&mut estimator, motor, grip, &limits, &clock, &exchange);
                    join(scrub, estimate).await;
                }
                RunningCalibration::Stored(stored) => {
                    let mut estimator = Estimator::new(&stored.tables, stored.bank());
                    let networks = stored.networks.scrubbed();
                    let scrub = tasks::scrub(&stored.tables, networks, &clock, &exchange);
                    let estimate =
                        tasks::estimate(&mut estimator, motor, grip, &limits, &clock, &exchange);
                    join(scrub, estimate).await;
                }
            }
        });
        let (clock, exchange) = parts();
        let sender = can::CanTx(self.controller.clone());
        let events = self.events.clone();
        self.spawn(async move {
            let log = |event| events.borrow_mut().push((clock.now_us(), event));
            let version = firmware_version(HARDWARE, tables_id);
            tasks::transmit(sender, (DEFAULT_NODE, version), log, &clock, &exchange).await;
        });
        let (clock, exchange) = parts();
        let out = serial::SerialTx { line: self.connections.line.clone(), clock };
        self.spawn(async move { tasks::transmit_serial(out, &exchange).await });
        let (clock, exchange) = parts();
        let receiver = can::CanRx(self.controller.clone());
        self.spawn(async move { tasks::receive_can(receiver, &limits, &clock, &exchange).await });
        let (clock, exchange) = parts();
        let into = serial::SerialRx(self.connections.line.clone());
        self.spawn(async move {
            tasks::receive_serial(into, DEFAULT_NODE, &limits, &clock, &exchange).await
        });
        let (clock, exchange) = parts();
        let (rebooting, button) = (self.rebooting.clone(), self.button.clone());
        self.spawn(async move {
            let mut state = 1_u64;
            // A pseudo-random sequence; challenges need not be secret here.
            let random = move || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                Some(state >> 16)
            };
            let service = HostService {
                version: firmware_version(HARDWARE, tables_id),
                store,
                loaded,
                calibration: CalibrationService {
                    slots: CalibrationSlots::new(flash::CALIBRATIONS),
                    origin,
                    defect,
                },
                configuration_defect: None,
                random,
                is_pressed: || button.get(),
                reboot: || rebooting.set(true),
            };
            tasks::host_service(service, &clock, &exchange).await;
        });
        let can_transfers = self.controller.clone().run();
        self.spawn(can_transfers);
    }

    /// Spawns an actor on the board's buses.
    pub fn spawn(&mut self, actor: impl Future<Output = ()> + 'static) {
        // The pool exists as long as its spawner.
        let _ = self.pool.spawner().spawn_local(actor);
    }

    /// Runs until a time in microseconds.
    pub fn run_until(&mut self, time_us: u64) {
        self.run_ready();
        while self.clock.advance(time_us) {
            self.run_ready();
        }
    }

    fn run_ready(&mut self) {
        self.pool.run_until_stalled();
        let crash = self.crashed.take();
        let is_rebooting = self.rebooting.take();
        if is_rebooting {
            self.motor.borrow_mut().restart(self.clock.now_us());
        }
        if is_rebooting || crash.is_some() {
            self.restart(crash);
            self.pool.run_until_stalled();
        }
    }
}

impl SimulatedBoard for VirtualTimeBoard {
    fn run_until(&mut self, time_us: u64) -> anyhow::Result<()> {
        Self::run_until(self, time_us);
        Ok(())
    }

    fn connections(&self) -> &Connections {
        &self.connections
    }

    fn grip_status(&self) -> Option<tasks::GripSummary> {
        Some(self.exchange.grip_summary.get())
    }

    fn corrupt_grasp_memory(&mut self, bit: u32) {
        let mut grip = self.grip.borrow_mut();
        grip.flip_bit(bit);
        if self.hides_corruption {
            grip.copy();
        }
    }

    fn take_events(&mut self) -> Vec<(u64, Event)> {
        std::mem::take(&mut self.events.borrow_mut())
    }
}

fn grasp(program: &Program, screw: Screw, limits: GripLimits) -> GripController {
    let locks = program.parameters.backdrivability() == parameters::Backdrivability::SelfLocking;
    GripController::new(limits, screw, locks)
}
