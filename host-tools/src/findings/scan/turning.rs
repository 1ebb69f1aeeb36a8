//! How steadily the rotor turned.

use std::f64::consts::TAU;

/// Rows over which a speed is taken.
const ROWS: usize = 100;
/// Speeds within this share of their mean are steady.
const STEADY: f64 = 0.02;
/// Fewer speeds than this tell nothing.
const LEAST: f64 = 10.0;

/// Follows `motor_angle_rad`.
#[derive(Clone, Debug, Default)]
pub struct Turning {
    last: Option<(f64, f64)>,
    turned: f64,
    time_us: f64,
    rows: usize,
    /// Count, sum and sum of squares of the speeds in Hz.
    speeds: [f64; 3],
}

impl Turning {
    /// Takes the next angle in rad.
    pub fn push(&mut self, angle: f64, t_us: f64) {
        if let Some((before, at)) = self.last {
            let step = angle - before;
            self.turned += step - TAU * (step / TAU).round();
            self.time_us += t_us - at;
            self.rows += 1;
        }
        self.last = Some((angle, t_us));
        if self.rows == ROWS {
            let speed = self.turned / TAU / (1e-6 * self.time_us);
            self.speeds = [
                self.speeds[0] + 1.0,
                self.speeds[1] + speed,
                self.speeds[2] + speed * speed,
            ];
            (self.turned, self.time_us, self.rows) = (0.0, 0.0, 0);
        }
    }

    /// Turns per second, where they were steady throughout.
    pub fn steady_hz(&self) -> Option<f64> {
        let [count, sum, squares] = self.speeds;
        let mean = sum / count;
        let spread = (squares / count - mean * mean).max(0.0).sqrt();
        let steady = count >= LEAST && mean != 0.0 && spread <= STEADY * mean.abs();
        steady.then_some(mean.abs())
    }
}
