//! The innermost tick, 20 kHz: from what is sensed to what the switches do.

use super::*;

impl Motor {
    /// What the switches do in the next period. To be called in each, in the middle of which `sensed` was
    /// sensed.
    pub fn current_tick(&mut self, sensed: &Sensed) -> Drive {
        self.bus_v = sensing::bus_v(sensed);
        let tracked = self
            .tracker
            .take(sensed.angle, self.settings.angle_age_periods);
        if tracked.is_err() {
            self.home = None;
        }
        let phases = self.swapped(self.offsets.amperes(sensed));
        let known = match self.state {
            State::Tripped(trip) => return trip.drive(),
            State::Arming => return self.take_offsets(sensed),
            State::Disarmed | State::Refused(_) => Ok(()),
            State::Armed | State::Commissioning => tracked
                .map_err(|_| Trip::Encoder)
                .and(self.check(sensed, phases))
                .and(self.fits(sensed, phases)),
        };
        let current = AlphaBeta::of_phases(phases);
        match (known, self.state) {
            (Err(trip), _) => self.trip(trip),
            (_, State::Armed) => self.follow(phases, current),
            (_, State::Commissioning) => self.measure(phases, current),
            _ => {
                self.see(current);
                Drive::Off
            }
        }
    }

    /// Phases V and W change places where they are wired so; twice is as before. Commissioning finds out anew.
    fn swapped(&self, [u, v, w]: [f32; 3]) -> [f32; 3] {
        match self.settings.wiring.is_swapped && self.state != State::Commissioning {
            true => [u, w, v],
            false => [u, v, w],
        }
    }

    /// What must hold while the switches may be on.
    fn check(&self, sensed: &Sensed, phases: [f32; 3]) -> Result<(), Trip> {
        let limits = &self.settings.limits;
        let speed = self.tracker.speed();
        let [u, v, w] = phases;
        if !(u + v + w + speed).is_finite() {
            return Err(Trip::NotANumber);
        }
        let greatest_a = greater(u.abs(), greater(v.abs(), w.abs()));
        if sensing::is_at_end(sensed) || greatest_a > limits.trip_a {
            return Err(Trip::OverCurrent);
        }
        match speed.abs() > limits.trip_speed {
            true => Err(Trip::OverSpeed),
            false => Ok(()),
        }
    }

    /// What must fit together once the sensors' offsets are known; commissioning looks for itself.
    fn fits(&mut self, sensed: &Sensed, phases: [f32; 3]) -> Result<(), Trip> {
        match self.state {
            State::Armed => self.watch.note(sensed, phases, &self.settings.limits),
            _ => Ok(()),
        }
    }

    fn take_offsets(&mut self, sensed: &Sensed) -> Drive {
        match self.zeroing.take(sensed) {
            None => Drive::Off,
            Some(Err(_)) => self.trip(Trip::CurrentSense),
            Some(Ok(_)) if !self.tracker.is_known() => self.trip(Trip::Encoder),
            Some(Ok(offsets)) => {
                self.offsets = offsets;
                self.rest();
                self.state = match self.commissioning {
                    Some(_) => State::Commissioning,
                    None => State::Armed,
                };
                Drive::Off
            }
        }
    }

    /// The currents as seen from the rotor.
    fn see(&mut self, current: AlphaBeta) {
        self.rotor = Direction::of(self.tracker.electrical(&self.settings));
        self.measured = current.turning(self.rotor);
    }

    fn follow(&mut self, phases: [f32; 3], current: AlphaBeta) -> Drive {
        self.see(current);
        let limits = &self.settings.limits;
        self.supply.note(self.bus_v, limits);
        let [_, burns] = limits.burn_v;
        self.is_shorted = self.bus_v > limits.high_v || (self.is_shorted && self.bus_v > burns);
        match self.setpoint {
            Setpoint::Off => {
                self.rest();
                Drive::Off
            }
            _ if self.bus_v < DEAD_BUS_V => {
                self.rest();
                Drive::Off
            }
            _ if self.is_shorted => {
                self.rest();
                Drive::Brake
            }
            Setpoint::Brake => {
                self.rest();
                Drive::Brake
            }
            Setpoint::Current { .. } | Setpoint::Speed { .. } | Setpoint::Position { .. } => {
                self.control(phases)
            }
        }
    }

    fn control(&mut self, phases: [f32; 3]) -> Drive {
        let machine = &self.settings.machine;
        let speed = self.tracker.speed() * f32::from(machine.pole_pairs);
        let driven = Driven {
            measured: self.measured,
            asked: self.asked,
            voltage: self.decided.voltage,
            greatest_v: svpwm::greatest_v(self.bus_v),
            speed,
        };
        if let Err(trip) = self.watch.judge(&driven, machine, &self.settings.limits) {
            return self.trip(trip);
        }
        self.decided = self.currents.decide(
            &self.windings,
            self.asked,
            self.measured,
            speed,
            svpwm::greatest_v(self.bus_v),
        );
        let voltage = self
            .decided
            .voltage
            .fixed(self.rotor.turned(speed * DELAY_S));
        self.switch(voltage, phases)
    }

    fn measure(&mut self, phases: [f32; 3], current: AlphaBeta) -> Drive {
        self.see(current);
        let Some(commissioning) = &mut self.commissioning else {
            return self.trip(Trip::NotANumber);
        };
        let seen = Seen {
            alpha_a: current.alpha,
            angle: self.tracker.angle(),
            greatest_v: svpwm::greatest_v(self.bus_v),
        };
        match commissioning.tick(&seen) {
            Next::Drive(voltage) => self.switch(voltage, phases),
            Next::Ended(result) => {
                self.disarm();
                match result {
                    Ok(found) => self.adopt(found),
                    Err(refusal) => self.state = State::Refused(refusal),
                }
                Drive::Off
            }
        }
    }

    fn adopt(&mut self, found: Found) {
        self.found = Some(found);
        let machine = &mut self.settings.machine;
        machine.resistance_ohm = found.resistance_ohm;
        machine.inductance_h = found.inductance_h;
        machine.pole_pairs = found.pole_pairs;
        self.settings.wiring = found.wiring;
        self.windings = Windings::of(machine);
    }

    /// Duties for a voltage; what is no number ends here.
    fn switch(&mut self, voltage: AlphaBeta, phases: [f32; 3]) -> Drive {
        let duties = svpwm::with_dead_time(svpwm::duties(voltage, self.bus_v), phases);
        let [u, v, w] = duties;
        match (u + v + w).is_finite() {
            true => Drive::Duty(self.swapped(duties)),
            false => self.trip(Trip::NotANumber),
        }
    }
}
