//! Whether what is sensed fits together: [`Watch`] in every period, [`Fit`], [`Runaway`] and [`SupplyWatch`] in
//! every tick of the outer loops.
//!
//! | what | how it shows |
//! | --- | --- |
//! | a current sensor that is off | the phases' currents do not sum to nothing |
//! | an open phase, a half bridge that does not switch | the currents do not follow though there is voltage enough |
//! | a rotor's sensor that is stuck | its counts do not flicker as those of a living one do |
//! | a rotor's sensor that has slipped on its shaft | the magnets' voltage is not where its angle has it |
//! | a rotor that runs away | the current that should brake it does not |

use super::limits::Limits;
use super::number::greater;
use super::settings::Machine;
use super::stage::Sensed;
use super::state::Trip;
use super::transform::Dq;
use super::{MOTION_PERIODS, PERIOD_S};

/// The voltages' mean takes this share of each tick's: half a millisecond.
const SHARE: f32 = 0.41;
/// Periods of driving before the voltages are judged.
const SETTLES: u16 = 20;
/// Periods of a tick.
const PERIODS: u16 = MOTION_PERIODS as u16;
/// Share of the voltage up to which currents are asked to follow.
const FOLLOWS: f32 = 0.7;

/// Sensors that cannot be right.
#[derive(Clone, Copy, Debug, Default)]
pub struct Watch {
    unsummed: u16,
    counts: Option<u16>,
    repeated: u16,
}

/// Whether currents and voltages belong together while the motor is driven.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fit {
    driven: u16,
    /// Mean of the voltage that nothing explains.
    beside: Dq,
    unexplained: u16,
    unfollowed: u16,
}

/// What a period of driving is judged by.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// What was sensed.
    pub measured: Dq,
    /// What was sensed a period before.
    pub before: Dq,
    /// What is followed.
    pub asked: Dq,
    /// The voltage that brought it about.
    pub voltage: Dq,
    /// The greatest that the bus gives.
    pub greatest_v: f32,
    /// Electrical, in rad/s.
    pub speed: f32,
}

impl Watch {
    /// Takes what every period senses.
    ///
    /// # Errors
    /// It cannot be true.
    pub fn note(
        &mut self,
        sensed: &Sensed,
        [u, v, w]: [f32; 3],
        limits: &Limits,
    ) -> Result<(), Trip> {
        let sum_a = (u + v + w).abs();
        count(&mut self.unsummed, sum_a > limits.sum_a, 1);
        let counts = sensed.angle.ok();
        let repeats = counts.is_some() && counts == self.counts;
        count(&mut self.repeated, repeats, 1);
        self.counts = counts;
        match () {
            () if self.unsummed >= limits.sum_periods => Err(Trip::CurrentSense),
            () if self.repeated >= limits.stuck_periods => Err(Trip::Encoder),
            () => Ok(()),
        }
    }
}

impl Fit {
    /// Takes a tick of driving.
    ///
    /// # Errors
    /// Currents and voltages do not belong together.
    pub fn judge(&mut self, seen: &Seen, machine: &Machine, limits: &Limits) -> Result<(), Trip> {
        count(&mut self.driven, true, PERIODS);
        let induced_v = seen.speed * machine.flux_wb();
        let left = left(seen, machine, induced_v);
        self.beside.d += SHARE * (left.d - self.beside.d);
        self.beside.q += SHARE * (left.q - self.beside.q);
        let bound_v = limits.beside_v + limits.beside * induced_v.abs();
        let is_beside = self.beside.squared() > bound_v * bound_v;
        let has_settled = self.driven > SETTLES;
        count(&mut self.unexplained, is_beside && has_settled, PERIODS);
        let off = Dq {
            d: seen.asked.d - seen.measured.d,
            q: seen.asked.q - seen.measured.q,
        };
        let asked_a = greater(seen.asked.q.abs(), seen.asked.d.abs());
        let turning_v = induced_v.abs() + seen.speed.abs() * machine.inductance_h * asked_a;
        let needed_v = machine.resistance_ohm * asked_a + turning_v;
        let is_off = off.squared() > limits.unfollowed_a * limits.unfollowed_a;
        let could_follow = needed_v < FOLLOWS * seen.greatest_v;
        count(&mut self.unfollowed, is_off && could_follow, PERIODS);
        match () {
            () if self.unexplained >= limits.beside_periods => Err(Trip::Encoder),
            () if self.unfollowed >= limits.unfollowed_periods => Err(Trip::CurrentSense),
            () => Ok(()),
        }
    }
}

/// Of the voltage what resistance, inductance and the turning magnets do not explain.
fn left(seen: &Seen, machine: &Machine, induced_v: f32) -> Dq {
    let Seen {
        measured,
        before,
        voltage,
        ..
    } = seen;
    let resistance = machine.resistance_ohm;
    let rate = machine.inductance_h / PERIOD_S;
    let turning = seen.speed * machine.inductance_h;
    Dq {
        d: voltage.d - resistance * measured.d - rate * (measured.d - before.d)
            + turning * measured.q,
        q: voltage.q
            - resistance * measured.q
            - rate * (measured.q - before.q)
            - turning * measured.d
            - induced_v,
    }
}

fn count(periods: &mut u16, counts: bool, more: u16) {
    *periods = if counts {
        periods.saturating_add(more)
    } else {
        0
    };
}

/// A rotor that runs away, looked for in the outer loops' ticks.
#[derive(Clone, Copy, Debug, Default)]
pub struct Runaway {
    ticks: u8,
    /// Its speed as it began, in rad/s.
    began: f32,
}

impl Runaway {
    /// Takes a tick: speed asked for and speed in rad/s, and the current along q in amperes that is asked for.
    ///
    /// # Errors
    /// The rotor is too fast, and for all the current that should brake it becomes no slower.
    pub fn note(&mut self, [asked, speed]: [f32; 2], q: f32, limits: &Limits) -> Result<(), Trip> {
        let beyond = speed - asked;
        let is_braked = beyond * q < 0.0 && q.abs() > limits.runaway_a;
        // Slower than asked for is late, not away; and at rest the speed's sign is noise.
        let is_fast = beyond.abs() > limits.runaway && speed.abs() > limits.runaway;
        let is_away = is_fast && beyond * speed > 0.0;
        if !(is_braked && is_away) {
            self.ticks = 0;
            return Ok(());
        }
        if self.ticks == 0 {
            self.began = speed.abs();
        }
        self.ticks = self.ticks.saturating_add(1);
        let is_due = u16::from(self.ticks) * u16::from(MOTION_PERIODS) > limits.runaway_periods;
        match is_due && speed.abs() >= self.began {
            true => Err(Trip::Runaway),
            false => Ok(()),
        }
    }
}

/// What the bus voltage is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Supply {
    /// As it should be.
    #[default]
    Sound,
    /// Too low to drive.
    Low,
    /// Too high: the windings are shorted until it has fallen.
    High,
}

impl Supply {
    fn of(bus_v: f32, limits: &Limits) -> Self {
        let [low_v, _] = limits.low_v;
        match () {
            () if bus_v > limits.high_v => Self::High,
            () if bus_v < low_v => Self::Low,
            () => Self::Sound,
        }
    }
}

/// Keeps what the bus was for so long that those who look each millisecond see it.
#[derive(Clone, Copy, Debug, Default)]
pub struct SupplyWatch {
    told: Supply,
    ticks: u8,
}

impl SupplyWatch {
    /// Ticks for which it is kept.
    const KEPT: u8 = 12;

    /// Takes a tick's voltage.
    pub fn note(&mut self, bus_v: f32, limits: &Limits) {
        let now = Supply::of(bus_v, limits);
        match now {
            Supply::Sound => {
                self.ticks = self.ticks.saturating_sub(1);
                if self.ticks == 0 {
                    self.told = Supply::Sound;
                }
            }
            Supply::Low | Supply::High => (self.told, self.ticks) = (now, Self::KEPT),
        }
    }

    /// What it is at this voltage, or was lately.
    pub fn told_with(&self, bus_v: f32, limits: &Limits) -> Supply {
        match Supply::of(bus_v, limits) {
            Supply::Sound => self.told,
            now => now,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;
    use crate::motor::settings::Settings;

    const LIMITS: Limits = Limits::GRIPPER;

    fn sensed(angle: u16) -> Sensed {
        Sensed {
            phases: [2048; 3],
            bus: 1600,
            angle: Ok(angle),
        }
    }

    #[test]
    fn currents_that_do_not_sum_to_nothing_for_ten_periods_are_not_believed() {
        let ends = |sum: f32, periods| {
            let mut watch = Watch::default();
            (0..periods).any(|period| {
                watch.note(&sensed(period), [sum, 3.0, -3.0], &LIMITS) == Err(Trip::CurrentSense)
            })
        };
        assert!(ends(0.81, 10) && !ends(0.81, 9) && !ends(0.79, 1000));
        assert!(ends(-0.81, 10));
    }

    #[test]
    fn counts_that_repeat_for_less_than_two_milliseconds_are_a_rotor_at_rest() {
        let ends = |repeats: u16| {
            let mut watch = Watch::default();
            (0..=repeats).any(|_| watch.note(&sensed(7), [0.0; 3], &LIMITS) == Err(Trip::Encoder))
        };
        assert!(ends(36) && !ends(35));
        let mut watch = Watch::default();
        assert!((0..1000).all(|period| {
            let flickers = if period % 30 == 0 { 8 } else { 7 };
            watch.note(&sensed(flickers), [0.0; 3], &LIMITS).is_ok()
        }));
    }

    /// A motor that turns steadily under a current, its sensor off by an angle in electrical radians.
    fn turning(speed: f32, q: f32, off: f32) -> Seen {
        let machine = Settings::assumed(Screw::A).machine;
        let induced_v = speed * machine.flux_wb();
        Seen {
            measured: Dq { d: 0.0, q },
            before: Dq { d: 0.0, q },
            asked: Dq { d: 0.0, q },
            voltage: Dq {
                d: -speed * machine.inductance_h * q - induced_v * off.sin(),
                q: machine.resistance_ohm * q + induced_v * off.cos(),
            },
            greatest_v: 13.0,
            speed,
        }
    }

    fn judged(seen: &Seen, periods: u16) -> Result<(), Trip> {
        let machine = Settings::assumed(Screw::A).machine;
        let mut fit = Fit::default();
        (0..periods / PERIODS).try_for_each(|_| fit.judge(seen, &machine, &LIMITS))
    }

    #[test]
    fn a_voltage_that_the_speed_does_not_explain_is_a_sensor_that_slipped() {
        // 114 rad/s and 7 pole pairs: 7.6 V; off by a sixth of a turn 7.6 V, bound 2.5 + 1.9 V.
        let sixth = core::f32::consts::FRAC_PI_3;
        assert_eq!(judged(&turning(798.0, 9.0, 0.0), 1000), Ok(()));
        assert_eq!(judged(&turning(798.0, 9.0, sixth), 41), Err(Trip::Encoder));
        assert_eq!(judged(&turning(798.0, 9.0, sixth), 39), Ok(()));
        // 30 degrees: 3.9 V.
        assert_eq!(judged(&turning(798.0, 9.0, 0.5 * sixth), 1000), Ok(()));
        // A fifth more resistance and flux.
        let mut warm = turning(798.0, 9.0, 0.0);
        warm.voltage.q *= 1.2;
        assert_eq!(judged(&warm, 1000), Ok(()));
    }

    #[test]
    fn a_current_that_does_not_follow_is_told_unless_the_voltage_is_short() {
        let mut open = turning(0.0, 0.0, 0.0);
        open.asked.q = 1.6;
        assert_eq!(judged(&open, 90), Err(Trip::CurrentSense));
        assert_eq!(judged(&open, 89), Ok(()));
        open.asked.q = 1.4;
        assert_eq!(judged(&open, 1000), Ok(()));
        let mut fast = turning(1200.0, 0.0, 0.0);
        fast.asked.q = 5.0;
        assert_eq!(judged(&fast, 1000), Ok(()));
    }

    #[test]
    fn a_rotor_that_brakes_is_not_away_and_one_that_runs_on_against_its_current_is() {
        let ends = |slower: f32, q: f32| {
            let mut runaway = Runaway::default();
            (0..20_u16).position(|tick| {
                let speed = 60.0 - slower * f32::from(tick);
                runaway.note([0.0, speed], q, &LIMITS).is_err()
            })
        };
        assert_eq!(ends(0.0, -9.6), Some(7));
        assert_eq!(ends(-3.0, -9.6), Some(7));
        assert_eq!(ends(0.5, -9.6), None);
        // It brakes while what is asked falls faster.
        let mut runaway = Runaway::default();
        assert!((0..20_u16).map(f32::from).all(|tick| {
            let speeds = [50.0 - 4.0 * tick, 62.0 - 0.5 * tick];
            runaway.note(speeds, -9.6, &LIMITS).is_ok()
        }));
        // It is held, and its noise would have it turn back.
        let mut runaway = Runaway::default();
        assert!((0..20).all(|_| runaway.note([29.0, -0.4], 9.6, &LIMITS).is_ok()));
        // Driven on, or hardly braked.
        assert_eq!((ends(0.0, 9.6), ends(0.0, -4.9)), (None, None));
    }

    #[test]
    fn a_voltage_out_of_bounds_is_seen_for_three_milliseconds() {
        let mut watch = SupplyWatch::default();
        for (volts, expected) in [
            (15.9, Supply::Low),
            (24.0, Supply::Low),
            (32.1, Supply::High),
        ] {
            watch.note(volts, &LIMITS);
            assert_eq!(watch.told_with(24.0, &LIMITS), expected, "{volts}");
        }
        (0..11).for_each(|_| watch.note(24.0, &LIMITS));
        assert_eq!(watch.told_with(24.0, &LIMITS), Supply::High);
        watch.note(24.0, &LIMITS);
        assert_eq!(watch.told_with(24.0, &LIMITS), Supply::Sound);
        assert_eq!(watch.told_with(15.9, &LIMITS), Supply::Low);
    }
}
