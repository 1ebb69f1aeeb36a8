//! A motor of a few lines, and the control armed on it.

use core::f64::consts::TAU;

use super::super::*;
use crate::motor::screw::Screw;
use crate::motor::stage::Drive;

/// Sub-steps of a period.
const STEPS: u32 = 10;

/// A motor with sinusoidal magnets behind ideal switches: what the control knows of, and what it does not.
pub struct Bench {
    pub resistance: f64,
    pub inductance: f64,
    pub flux: f64,
    pub pole_pairs: f64,
    pub inertia: f64,
    pub dry: f64,
    /// Torque that opens, in newton metres.
    pub load: f64,
    pub bus: f64,
    /// Of the bus, which the supply feeds and never unloads; zero: a bus that never gives way.
    pub capacitance: f64,
    pub swapped: bool,
    /// Of the sensor, in turns.
    pub sits: f64,
    /// A speed in rad/s that it is turned with, whatever its torque.
    pub turned: Option<f64>,
    pub current: [f64; 2],
    pub speed: f64,
    pub angle: f64,
    pub drive: Drive,
    pub sensed: Sensed,
    flickers: bool,
}

impl Bench {
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
            sits: 0.0,
            turned: None,
            current: [0.0; 2],
            speed: 0.0,
            angle: 0.0,
            drive: Drive::Off,
            sensed: Sensed {
                phases: [2048; 3],
                bus: 1600,
                angle: Ok(0),
            },
            flickers: false,
        }
    }

    fn swap(&self, [u, v, w]: [f64; 3]) -> [f64; 3] {
        match self.swapped {
            true => [u, w, v],
            false => [u, v, w],
        }
    }

    /// The period in which `drive` holds; senses in its middle.
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
            Drive::Off => {
                self.current = [0.0; 2];
                [0.0; 3]
            }
            Drive::Brake => [0.0; 3],
            Drive::Duty(duties) => self.swap(duties.map(f64::from)),
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
            if self.drive != Drive::Off {
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

    /// Friction stops and never reverses.
    fn turn(&mut self, torque: f64, dt: f64) {
        let free = self.speed + dt * torque / self.inertia;
        let friction = dt * self.dry / self.inertia;
        self.speed = free.signum() * (free.abs() - friction).max(0.0);
        self.speed = self.turned.unwrap_or(self.speed);
        self.angle += dt * self.speed;
    }

    fn sense(&mut self) {
        let [alpha, beta] = self.current;
        let side = 3_f64.sqrt() / 2.0 * beta;
        let phases = self.swap([alpha, side - 0.5 * alpha, -side - 0.5 * alpha]);
        // A living sensor flickers by a count.
        self.flickers = !self.flickers;
        let flicker = f64::from(u8::from(self.flickers)) / 16384.0;
        let turns = self.angle / TAU + self.sits + flicker;
        self.sensed = Sensed {
            phases: phases
                .map(|current| (2048.0 + current / 0.0125).round().clamp(0.0, 4095.0) as u16),
            bus: (self.bus / 0.015).round() as u16,
            angle: Ok((turns * 16384.0).floor() as i64 as u16 & 0x3fff),
        };
    }

    /// Runs a motor's control for some periods; calls `each` after each.
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

impl PowerStage for Bench {
    fn drive(&mut self, drive: Drive) {
        self.drive = drive;
    }
}

pub fn armed(bench: &mut Bench, settings: Settings) -> Motor {
    let mut motor = Motor::new(settings);
    motor.obey(Order::Arm);
    bench.run(&mut motor, 600, |_, _| {});
    assert_eq!(motor.telling().state, State::Armed);
    motor.obey(Order::Opening { opening_mm: 40.0 });
    motor
}

/// A period with the outer tick in it.
pub fn both(motor: &mut Motor, sensed: &Sensed) -> Drive {
    if let Some(ask) = motor.ask.take() {
        motor.inner.hear(ask);
    }
    let drive = motor.inner.tick(sensed);
    motor.ask = Some(motor.outer.tick(motor.inner.felt()));
    drive
}
