//! The three half bridges: what a drive puts on the motor's terminals, mean over a period of the pulses.

use firmware::motor::stage::Drive;

/// What the bridges are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverter {
    /// Share of a period in which both switches of a leg are off at its edges.
    pub dead_share: f64,
    /// Forward voltage of the diodes, in V.
    pub diode_v: f64,
}

/// Below this a phase's current changes its sign within a period, by its ripple, and the dead time's error
/// shrinks with it; in A.
const RIPPLE_A: f64 = 0.2;

/// What a terminal does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terminals {
    /// Switched: the share of the bus voltage on each.
    Held([f64; 3]),
    /// Left to the diodes.
    Free,
}

impl Inverter {
    /// The terminals with these currents into the phases, in A.
    pub fn terminals(&self, drive: Drive, currents_a: &[f64; 3]) -> Terminals {
        match drive {
            Drive::Off => Terminals::Free,
            Drive::Brake => Terminals::Held([0.0; 3]),
            Drive::Duty(duties) => Terminals::Held([0, 1, 2].map(|phase| {
                self.share(f64::from(duties[phase]), currents_a[phase])
            })),
        }
    }

    /// Share of the bus voltage on a terminal: during the dead time the current chooses the diode. A leg
    /// that does not switch has none, and what is no number switches nothing on.
    fn share(&self, duty: f64, current_a: f64) -> f64 {
        if duty > 0.0 && duty < 1.0 {
            let lost = self.dead_share * (current_a / RIPPLE_A).clamp(-1.0, 1.0);
            (duty - lost).clamp(0.0, 1.0)
        } else if duty >= 1.0 {
            1.0
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INVERTER: Inverter = Inverter {
        dead_share: 0.01,
        diode_v: 0.8,
    };

    fn held(duties: [f32; 3], currents_a: [f64; 3]) -> [f64; 3] {
        match INVERTER.terminals(Drive::Duty(duties), &currents_a) {
            Terminals::Held(shares) => shares,
            Terminals::Free => panic!("a duty holds its terminals"),
        }
    }

    #[test]
    fn the_dead_time_takes_a_hundredth_from_a_current_that_flows_in_and_gives_it_to_one_that_flows_out()
    {
        let shares = held([0.5, 0.5, 0.5], [5.0, -5.0, 0.0]);
        assert_eq!(shares, [0.49, 0.51, 0.5]);
    }

    #[test]
    fn a_leg_that_does_not_switch_has_no_dead_time() {
        assert_eq!(held([0.0, 1.0, f32::NAN], [-5.0, 5.0, 5.0]), [0.0, 1.0, 0.0]);
    }
}
