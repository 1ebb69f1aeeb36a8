//! What is noted of a run.

use super::Rig;

/// The drive at one instant, as it is, not as it is sensed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Since the set-point came, in s.
    pub time_s: f64,
    /// Between the fingers, in mm.
    pub opening_mm: f64,
    /// What the position loop asks for, in mm; none without a place as set-point.
    pub asked_mm: Option<f64>,
    /// Speed of the opening, closing positive, in mm/s.
    pub closing_mm_s: f64,
    /// Direct and quadrature current in A.
    pub current_a: [f64; 2],
    /// Direct and quadrature voltage that the control decided, in V.
    pub voltage_v: [f64; 2],
    /// Bus voltage in V.
    pub bus_v: f64,
    /// Force between the fingers in N.
    pub force_n: f64,
}

impl Point {
    /// The drive now.
    pub fn of(rig: &Rig, start_s: f64) -> Self {
        let telling = rig.motor.telling();
        let plant = &rig.plant;
        Self {
            time_s: plant.time_s() - start_s,
            opening_mm: 1e3 * plant.opening_m(),
            asked_mm: telling.asked_mm.map(f64::from),
            closing_mm_s: 1e3 * plant.train.travel_m_s,
            current_a: plant.direct_quadrature_a(),
            voltage_v: [telling.voltage.d, telling.voltage.q].map(f64::from),
            bus_v: plant.bus.voltage_v,
            force_n: plant.grip_n(),
        }
    }
}

/// A run, point by point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// The points, one for each period of the pulses.
    pub points: Vec<Point>,
}

impl Trace {
    /// Goes on with a rig for so long, point by point.
    pub fn record(&mut self, rig: &mut Rig, start_s: f64, seconds: f64) {
        for _ in 0..super::periods(seconds) {
            rig.period();
            self.points.push(Point::of(rig, start_s));
        }
    }

    /// The greatest of something.
    pub fn most(&self, of: impl Fn(&Point) -> f64) -> f64 {
        self.points.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The mean of something over the last `seconds`.
    pub fn last(&self, seconds: f64, of: impl Fn(&Point) -> f64) -> f64 {
        let count = (super::periods(seconds) as usize).clamp(1, self.points.len().max(1));
        let tail = &self.points[self.points.len().saturating_sub(count)..];
        tail.iter().map(of).sum::<f64>() / tail.len() as f64
    }
}
