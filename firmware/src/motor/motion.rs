//! The outer loops' tick, 4 kHz: from the set-point to the currents that the innermost loop follows.

use super::*;

impl Motor {
    /// Goes on by a tick. To be called after every [`MOTION_PERIODS`]th call of [`Motor::current_tick`].
    pub fn motion_tick(&mut self) {
        const SECONDS: f32 = 1.0 / MOTION_HZ as f32;
        let limits = self.settings.limits;
        self.heat.add(&limits, self.measured.squared(), SECONDS);
        let rotor_mm = self.rotor_mm();
        let screw = &self.settings.screw;
        self.opening_mm = rotor_mm.and_then(|rotor_mm| {
            let home = self.home.as_mut()?;
            Some(home.play.opening_mm(screw, rotor_mm))
        });
        self.held_by = Active::default();
        if self.state == State::Armed {
            self.draw_bounds();
            self.ask(rotor_mm);
        }
    }

    fn draw_bounds(&mut self) {
        let around = Around {
            speed: self.tracker.speed(),
            bus_v: self.bus_v,
            heat: self.heat,
            temperatures: self.temperatures,
            speed_gain: self.speed_gains.proportional,
        };
        let mut bounds = Bounds::draw(&self.settings, &around);
        let most = self.setpoint.most_a();
        bounds.low_a = within(bounds.low_a, -most, most);
        bounds.high_a = within(bounds.high_a, -most, most);
        self.bounds = bounds;
    }

    fn ask(&mut self, rotor_mm: Option<f32>) {
        let speed = self.tracker.speed();
        let (q, is_held) = match self.setpoint {
            Setpoint::Off | Setpoint::Brake => return,
            Setpoint::Current { closing_a } => {
                let given = within(closing_a, self.bounds.low_a, self.bounds.high_a);
                (given, given != closing_a)
            }
            Setpoint::Speed { closing_mm_s, .. } => self.ask_speed(closing_mm_s, rotor_mm, speed),
            Setpoint::Position {
                opening_mm,
                speed_mm_s,
                ..
            } => self.ask_place(opening_mm, speed_mm_s, rotor_mm, speed),
        };
        self.held_by.set(Limit::Current, is_held);
        let amplitude_a = self.bounds.amplitude_a;
        let (asked, burns) =
            regeneration::burning(&self.settings, q, speed, self.bus_v, amplitude_a);
        self.held_by
            .set(Limit::Regeneration, burns || self.is_shorted);
        // Said to be no number by the next tick.
        self.asked = asked;
    }

    /// A speed, slower where the way ends or is not known.
    fn ask_speed(&mut self, closing_mm_s: f32, rotor_mm: Option<f32>, speed: f32) -> (f32, bool) {
        let limits = &self.settings.limits;
        let [closed, open] = limits.ends_mm;
        let [slowest, fastest, limit] = match rotor_mm {
            Some(mm) => {
                let to_end = |way: f32| PositionLoop::GAIN * greater(way, 0.0);
                [-to_end(open - mm), to_end(mm - closed), f32::INFINITY]
            }
            None => [-limits.homing_mm_s, limits.homing_mm_s, limits.homing_mm_s],
        };
        let given = within(closing_mm_s, slowest, fastest);
        let is_slowed = given != closing_mm_s;
        self.held_by
            .set(Limit::EndStop, is_slowed && limit.is_infinite());
        self.held_by
            .set(Limit::NotHomed, is_slowed && limit.is_finite());
        let screw = &self.settings.screw;
        let asked = within(screw.rotor_speed(given), -limits.speed, limits.speed);
        let ahead_a = speed::ahead_a(&self.settings.machine, asked, 0.0);
        self.follow_speed([asked, speed], ahead_a)
    }

    /// A place on the way between the ends; where the opening is not known, the rotor is held still.
    fn ask_place(
        &mut self,
        opening_mm: f32,
        speed_mm_s: f32,
        rotor_mm: Option<f32>,
        speed: f32,
    ) -> (f32, bool) {
        let (Some(position), Some(rotor_mm)) = (&mut self.position, rotor_mm) else {
            self.held_by.set(Limit::NotHomed, true);
            return self.follow_speed([0.0, speed], 0.0);
        };
        let [_, open] = self.settings.limits.ends_mm;
        let target = within(opening_mm, 0.0, open);
        self.held_by.set(Limit::EndStop, target != opening_mm);
        let wanted = position.tick(&self.settings, target, speed_mm_s, rotor_mm);
        let limit = self.settings.limits.speed;
        let asked = within(wanted.speed, -limit, limit);
        self.follow_speed([asked, speed], wanted.ahead_a)
    }

    /// The current for a speed asked for and the one that is, unless the rotor runs away from it.
    fn follow_speed(&mut self, speeds: [f32; 2], ahead_a: f32) -> (f32, bool) {
        let limits = &self.settings.limits;
        if let Err(trip) = self.runaway.note(speeds, self.asked.q, limits) {
            self.trip(trip);
            return (0.0, false);
        }
        self.speed
            .decide(&self.speed_gains, speeds, ahead_a, &self.bounds)
    }
}
