//! What the sensors of a simulated board feel, millisecond by millisecond, and the motor at its lines.

use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::loops::FIRST_TICK_US;
use firmware::motor::{Order, Telling};
use firmware::params::TICK_US;
use firmware::surroundings::Surroundings;

/// One millisecond of the world.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// What each sensor's registers hold; nothing where the gripper lacks it.
    pub readings: [Option<Reading>; SENSORS],
    /// What the board knows beside the fields.
    pub around: Surroundings,
}

/// Something that goes on.
pub trait World {
    /// The next millisecond; nothing where it ends.
    fn next(&mut self) -> Option<Moment>;
}

/// The motor's interrupt, with all that it drives.
pub trait Motor {
    /// What it told last at this time.
    fn telling(&mut self, time_us: u64) -> Telling;

    /// Takes an order at this time; gives it back where the one before still waits.
    ///
    /// # Errors
    /// The order.
    fn order(&mut self, time_us: u64, order: Order) -> Result<(), Order>;

    /// Its outputs go off at this time, and it starts anew.
    fn restart(&mut self, time_us: u64);
}

/// No motor: nothing is told, whatever is ordered.
pub struct NoMotor;

impl Motor for NoMotor {
    fn telling(&mut self, _: u64) -> Telling {
        Telling::default()
    }

    fn order(&mut self, _: u64, _: Order) -> Result<(), Order> {
        Ok(())
    }

    fn restart(&mut self, _: u64) {}
}

/// The first millisecond begins so long before the first tick of sensing, so that no tick is near the end of one.
const MARGIN_US: u64 = 100;

/// A world on the board's clock: its first millisecond is that of the first tick of sensing, which comes
/// [`FIRST_TICK_US`] after the first transfer on a sensor bus.
pub struct Now {
    world: Box<dyn World>,
    moment: Moment,
    /// When the first millisecond begins, once that is known.
    begins_us: Option<u64>,
    /// Milliseconds taken so far.
    taken: u64,
    ended: bool,
}

impl Now {
    /// Begins.
    pub fn new(world: Box<dyn World>) -> Self {
        let mut now = Self {
            world,
            moment: Moment::default(),
            begins_us: None,
            taken: 0,
            ended: false,
        };
        now.at(0);
        now
    }

    /// The world at the time of a transfer from a sensor.
    pub fn at_transfer(&mut self, time_us: u64) -> &Moment {
        self.begins_us
            .get_or_insert(time_us + FIRST_TICK_US - MARGIN_US);
        self.at(time_us)
    }

    /// The world at this time; it stays at its end.
    pub fn at(&mut self, time_us: u64) -> &Moment {
        let begins_us = self.begins_us.unwrap_or(u64::MAX);
        let place = time_us.saturating_sub(begins_us) / TICK_US;
        while self.taken <= place && !self.ended {
            match self.world.next() {
                Some(moment) => {
                    self.moment = moment;
                    self.taken += 1;
                }
                None => self.ended = true,
            }
        }
        &self.moment
    }

    /// When its first millisecond began; none before the first transfer.
    pub fn begins_us(&self) -> Option<u64> {
        self.begins_us
    }

    /// Whether it has ended.
    pub fn ended(&self) -> bool {
        self.ended
    }
}
