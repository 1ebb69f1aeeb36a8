//! The motor control on a simple simulated motor.

use crate::motor::power_stage::BridgeCommand;
use crate::motor::screw::Screw;
use core::f64::consts::TAU;

mod commissioning;
mod loops;
mod protection;

use crate::motor::*;

/// Integration steps per period.
const STEPS: u32 = 10;

/// A motor with sinusoidal flux and ideal switches.
pub struct MotorModel {
    pub resistance: f64,
    pub inductance: f64,
    pub flux: f64,
    pub pole_pairs: f64,
    pub inertia: f64,
    pub dry: f64,
    /// Opening torque in N m.
    pub load: f64,
    pub bus: f64,
    /// Capacitance of the bus, whose supply takes no energy back; zero: constant voltage.
    pub capacitance: f64,
    pub swapped: bool,
    /// What the current sensors make of the phase currents.
    pub senses: fn([f64; 3]) -> [f64; 3],
    /// Offset of the sensor in turns.
    pub offset: f64,
    /// Imposed speed in rad/s.
    pub imposed_speed: Option<f64>,
    pub current: [f64; 2],
    pub speed: f64,
    pub angle: f64,
    pub drive: BridgeCommand,
    pub sensed: MotorSamples,
    noise: bool,
}

impl MotorModel {
    pub fn new() -> Self {
        let machine = Settings::assumed(Screw::A).machine;
        Self {
            resistance: machine.resistance_ohm.into(),
            inductance: machine.inductance_h.into(),
            flux: machine.flux_wb().into(),
            pole_pairs: machine.pole_pairs.into(),
            inertia: machine.inertia_kg_m2.into(),
            dry: machine.dry_nm.into(),
            load: 0.0,
            bus: 24.0,
            capacitance: 0.0,
            swapped: false,
            senses: |phases| phases,
            offset: 0.0,
            imposed_speed: None,
            current: [0.0; 2],
            speed: 0.0,
            angle: 0.0,
            drive: BridgeCommand::Off,
            sensed: MotorSamples { phases: [2048; 3], bus: 1600, angle: Ok(0) },
            noise: false,
        }
    }

    fn swap(&self, [u, v, w]: [f64; 3]) -> [f64; 3] {
        if self.swapped { [u, w, v] } else { [u, v, w] }
    }

    /// One period with the command of `drive`, sampled in its middle.
    pub fn period(&mut self) {
        for step in 0..STEPS {
            if step == STEPS / 2 {
                self.sense();
            }
            self.step(f64::from(PERIOD_S) / f64::from(STEPS));
        }
    }

    fn step(&mut self, dt: f64) {
        let duties = match self.drive {
            BridgeCommand::Off => {
                self.current = [0.0; 2];
                [0.0; 3]
            }
            BridgeCommand::Brake => [0.0; 3],
            BridgeCommand::Duty(duties) => self.swap(duties.map(f64::from)),
        };
        let [u, v, w] = duties.map(|duty| duty * self.bus);
        let volts = [(2.0 * u - v - w) / 3.0, (v - w) / 3_f64.sqrt()];
        let electrical = self.pole_pairs * self.angle;
        let (sin, cos) = electrical.sin_cos();
        let induced = self.pole_pairs * self.speed * self.flux;
        let magnets = [-sin * induced, cos * induced];
        let mut power = 0.0;
        for axis in 0..2 {
            power += 1.5 * volts[axis] * self.current[axis];
            let drop = volts[axis] - self.resistance * self.current[axis] - magnets[axis];
            if self.drive != BridgeCommand::Off {
                self.current[axis] += dt * drop / self.inductance;
            }
        }
        if self.capacitance > 0.0 {
            self.bus = (self.bus - dt * power / (self.bus * self.capacitance)).max(24.0);
        }
        let q = cos * self.current[1] - sin * self.current[0];
        let torque = 1.5 * self.pole_pairs * self.flux * q - self.load;
        self.turn(torque, dt);
    }

    /// Dry friction decelerates to zero at most.
    fn turn(&mut self, torque: f64, dt: f64) {
        let free = self.speed + dt * torque / self.inertia;
        let friction = dt * self.dry / self.inertia;
        self.speed = free.signum() * (free.abs() - friction).max(0.0);
        self.speed = self.imposed_speed.unwrap_or(self.speed);
        self.angle += dt * self.speed;
    }

    fn sense(&mut self) {
        let [alpha, beta] = self.current;
        let side = 3_f64.sqrt() / 2.0 * beta;
        let phases = self.swap([alpha, side - 0.5 * alpha, -side - 0.5 * alpha]);
        // Noise of one count.
        self.noise = !self.noise;
        let noise_turns = f64::from(u8::from(self.noise)) / 16384.0;
        let turns = self.angle / TAU + self.offset + noise_turns;
        self.sensed = MotorSamples {
            phases: (self.senses)(phases)
                .map(|current| (2048.0 + current / 0.0125).round().clamp(0.0, 4095.0) as u16),
            bus: (self.bus / 0.015).round() as u16,
            angle: Ok((turns * 16384.0).floor() as i64 as u16 & 0x3fff),
        };
    }

    /// Runs the control for some periods and calls `each` after each.
    pub fn run(&mut self, motor: &mut Motor, periods: u32, mut each: impl FnMut(&Self, &Motor)) {
        for _ in 0..periods {
            self.period();
            let sensed = self.sensed;
            motor.period(&sensed, self);
            each(self, motor);
        }
    }

    pub fn q(&self) -> f64 {
        let (sin, cos) = (self.pole_pairs * self.angle).sin_cos();
        cos * self.current[1] - sin * self.current[0]
    }

    pub fn opening(&self, screw: Screw) -> f64 {
        40.0 - self.angle * f64::from(screw.ratio_mm)
    }
}

impl PowerStage for MotorModel {
    fn drive(&mut self, drive: BridgeCommand) {
        self.drive = drive;
    }
}

pub fn armed(model: &mut MotorModel, settings: Settings) -> Motor {
    let mut motor = Motor::new(settings);
    motor.handle_command(MotorCommand::Arm);
    model.run(&mut motor, 600, |_, _| {});
    assert_eq!(motor.status().state, MotorState::Armed);
    motor.handle_command(MotorCommand::SetOpening { opening_mm: 40.0 });
    motor
}

/// A period with a tick of the motion loop.
pub fn both(motor: &mut Motor, sensed: &MotorSamples) -> BridgeCommand {
    if let Some(ask) = motor.pending.take() {
        motor.inner.apply(ask);
    }
    let drive = motor.inner.tick(sensed);
    motor.pending = Some(motor.outer.tick(motor.inner.take_report()));
    drive
}
