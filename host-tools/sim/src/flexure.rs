//! One flexure in time: stiffening spring with stop, friction, damper and creep.
//!
//! `c w' + R(w - d) + friction(w) = F`, where the spring's force `R` also drives the delayed
//! displacement `d` of a Kelvin-Voigt element in series: `tau d' = share R / k - d`. Each step solves the
//! first equation for the displacement at its end (implicit Euler: a ramp arrives late by exactly
//! c/k, whatever the step).

use crate::friction::JenkinsFriction;

/// Displacement at which stiffening is specified, in mm: full travel.
pub const REFERENCE_MM: f64 = 0.5;

/// Tolerance of a step's force balance in newtons.
const BALANCE_N: f64 = 1e-9;

/// Threshold of a load cycle in newtons, both signs.
const CYCLE_N: f64 = 5.0;

/// Integration steps of a pause.
const PAUSE_STEPS: u32 = 20;

/// Parameters of one flexure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlexureParameters {
    /// Stiffness at zero deflection.
    pub stiffness_n_per_mm: f64,
    /// Growth of the stiffness at [`REFERENCE_MM`], 0.05 for 5 %.
    pub stiffening: f64,
    /// Load at which the stop engages, and the share of the compliance that it removes.
    pub stop: (f64, f64),
    /// Coulomb friction in parallel with the spring, in newtons.
    pub friction_n: f64,
    /// Retardation time in seconds.
    pub lag_s: f64,
    /// Delayed share of the compliance, and its time constant in seconds.
    pub creep: (f64, f64),
    /// Final growth of the compliance, and the number of load cycles for 63 % of it.
    pub softening: (f64, f64),
}

/// Displacement and internal state of a flexure.
#[derive(Clone, Debug)]
pub struct Flexure {
    build: FlexureParameters,
    friction: JenkinsFriction,
    stop_mm: f64,
    at_mm: f64,
    delayed_mm: f64,
    softness: f64,
    cycles: Cycles,
}

/// Counter of load cycles: a crossing from below the negative to above the positive threshold.
#[derive(Clone, Copy, Debug, Default)]
struct Cycles {
    counted: u32,
    below: bool,
}

impl Cycles {
    /// True if this load completes a cycle.
    fn push(&mut self, load_n: f64) -> bool {
        let completed = self.below && load_n > CYCLE_N;
        self.counted += u32::from(completed);
        self.below = (self.below && !completed) || load_n < -CYCLE_N;
        completed
    }
}

impl Flexure {
    /// A flexure that has never been loaded.
    pub fn new(build: FlexureParameters) -> Self {
        let mut flexure = Self {
            build,
            friction: JenkinsFriction::new(build.friction_n),
            stop_mm: f64::INFINITY,
            at_mm: 0.0,
            delayed_mm: 0.0,
            softness: 1.0,
            cycles: Cycles::default(),
        };
        let (knee_n, share) = build.stop;
        if share > 0.0 {
            flexure.stop_mm = flexure.solve(0.0, |at_mm| {
                let (force, slope) = flexure.spring(at_mm);
                (force - knee_n, slope)
            });
        }
        flexure
    }

    /// Displacement in mm.
    pub fn at_mm(&self) -> f64 {
        self.at_mm
    }

    /// Load cycles since the campaign began.
    pub fn cycles(&self) -> u32 {
        self.cycles.counted
    }

    /// Advances by `dt_s` to a force of `force_n`; returns the displacement.
    pub fn step(&mut self, force_n: f64, dt_s: f64) -> f64 {
        if self.cycles.push(force_n) {
            let (growth, cycles) = self.build.softening;
            self.softness = 1.0 - growth * libm::expm1(-f64::from(self.cycles.counted) / cycles);
        }
        let damper = self.build.stiffness_n_per_mm * self.build.lag_s / dt_s;
        let before = self.at_mm;
        self.at_mm = self.solve(before, |at_mm| {
            let (spring, stiffness) = self.spring(at_mm - self.delayed_mm);
            let (friction, stick) = self.friction.force(at_mm);
            let force = damper * (at_mm - before) + spring + friction;
            (force - force_n, damper + stiffness + stick)
        });
        self.friction.follow(self.at_mm);
        self.creep(dt_s);
        self.at_mm
    }

    /// Pause without load: creep decays, friction keeps its state.
    pub fn pause(&mut self, seconds: f64) {
        for _ in 0..PAUSE_STEPS {
            self.step(0.0, seconds / f64::from(PAUSE_STEPS));
        }
    }

    fn creep(&mut self, dt_s: f64) {
        let (share, time_s) = self.build.creep;
        if share > 0.0 {
            let (spring, _) = self.spring(self.at_mm - self.delayed_mm);
            let end = share * spring / self.build.stiffness_n_per_mm;
            self.delayed_mm -= (end - self.delayed_mm) * libm::expm1(-dt_s / time_s);
        }
    }

    /// Force of the spring in N at a displacement, and its slope in N/mm.
    fn spring(&self, at_mm: f64) -> (f64, f64) {
        let stiffness = self.build.stiffness_n_per_mm;
        let unsoftened = at_mm / self.softness;
        let bend = self.build.stiffening * (unsoftened / REFERENCE_MM).powi(2);
        let force = stiffness * unsoftened * (1.0 + bend);
        let slope = stiffness * (1.0 + 3.0 * bend) / self.softness;
        let beyond = at_mm.abs() - self.stop_mm;
        if beyond <= 0.0 {
            return (force, slope);
        }
        let (_, share) = self.build.stop;
        let stop = stiffness * share / (1.0 - share);
        (force + (stop * beyond).copysign(at_mm), slope + stop)
    }

    /// Root of a force balance (excess force and its positive slope): Newton steps, replaced by bisection where
    /// the corners of the friction make them diverge.
    fn solve(&self, start_mm: f64, balance: impl Fn(f64) -> (f64, f64)) -> f64 {
        let (mut at, mut low, mut high) = (start_mm, f64::NEG_INFINITY, f64::INFINITY);
        for _ in 0..60 {
            let (excess, slope) = balance(at);
            if excess.abs() < BALANCE_N {
                break;
            }
            if excess > 0.0 {
                high = at
            } else {
                low = at
            }
            let next = at - excess / slope;
            at = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: FlexureParameters = FlexureParameters {
        stiffness_n_per_mm: 500.0,
        stiffening: 0.0,
        stop: (0.0, 0.0),
        friction_n: 0.0,
        lag_s: 0.0,
        creep: (0.0, 10.0),
        softening: (0.0, 8.0),
    };
    const STEP_S: f64 = 2.5e-4;

    /// Linear load ramp; returns the final displacement.
    fn ramp(flexure: &mut Flexure, from_n: f64, to_n: f64, seconds: f64) -> f64 {
        let steps = (seconds / STEP_S).round() as u32;
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            flexure.step(from_n + share * (to_n - from_n), STEP_S);
        }
        flexure.at_mm()
    }

    #[test]
    fn stiffening_spring_solves_the_cubic() {
        let mut flexure = Flexure::new(FlexureParameters { stiffening: 0.05, ..PLAIN });
        for force in [-240.0, -10.0, 0.0, 100.0, 262.5] {
            let w = flexure.step(force, STEP_S);
            let back = 500.0 * w * (1.0 + 0.05 * (w / 0.5).powi(2));
            assert!((back - force).abs() < 1e-6, "{force}: {back}");
        }
        assert!((flexure.at_mm() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn hysteresis_half_width_is_the_friction_force() {
        let mut flexure = Flexure::new(FlexureParameters { friction_n: 2.5, ..PLAIN });
        ramp(&mut flexure, 0.0, 200.0, 1.0);
        let down = ramp(&mut flexure, 200.0, 0.0, 1.0);
        ramp(&mut flexure, 0.0, -200.0, 1.0);
        let up = ramp(&mut flexure, -200.0, 0.0, 1.0);
        let half_width_n = 0.5 * (down - up) * 500.0;
        assert!((half_width_n - 2.5).abs() < 1e-6, "{half_width_n}");
    }

    #[test]
    fn creep_after_a_step_has_its_share_and_time_constant() {
        let mut flexure = Flexure::new(FlexureParameters { creep: (0.02, 5.0), ..PLAIN });
        let first = flexure.step(100.0, STEP_S);
        let after_tau = ramp(&mut flexure, 100.0, 100.0, 5.0);
        let in_the_end = ramp(&mut flexure, 100.0, 100.0, 60.0);
        let share = (after_tau - first) / first;
        assert!((share / (0.02 * (1.0 - libm::exp(-1.0))) - 1.0).abs() < 1e-3, "{share}");
        assert!(((in_the_end - first) / first - 0.02).abs() < 1e-5);
    }

    #[test]
    fn ramp_response_lags_by_the_retardation_time() {
        let mut flexure = Flexure::new(FlexureParameters { lag_s: 0.01, ..PLAIN });
        let at = ramp(&mut flexure, 0.0, 100.0, 1.0);
        let lag_s = (100.0 - 500.0 * at) / 100.0;
        assert!((lag_s - 0.01).abs() < 1e-9, "{lag_s}");
    }

    #[test]
    fn stop_reduces_the_compliance_on_both_sides() {
        let mut flexure = Flexure::new(FlexureParameters { stop: (120.0, 0.6), ..PLAIN });
        for sign in [1.0, -1.0] {
            let knee = flexure.step(sign * 120.0, STEP_S);
            let beyond = flexure.step(sign * 170.0, STEP_S);
            assert!((knee.abs() - 0.24).abs() < 1e-9);
            assert!(((beyond - knee).abs() - 0.4 * 0.1).abs() < 1e-9);
        }
    }

    #[test]
    fn compliance_grows_with_load_cycles() {
        let mut flexure = Flexure::new(FlexureParameters { softening: (0.03, 2.0), ..PLAIN });
        for _ in 0..2 {
            ramp(&mut flexure, 0.0, -50.0, 0.1);
            ramp(&mut flexure, -50.0, 50.0, 0.1);
        }
        let grown = flexure.at_mm() / 0.1 - 1.0;
        assert_eq!(flexure.cycles(), 2);
        assert!((grown - 0.03 * (1.0 - libm::exp(-1.0))).abs() < 1e-9, "{grown}");
    }

    #[test]
    fn after_a_pause_only_friction_retains_displacement() {
        let slow = FlexureParameters { lag_s: 0.01, creep: (0.02, 5.0), ..PLAIN };
        for (friction_n, min, max) in [(0.0, 0.0, 1e-9), (2.5, 0.004, 0.006)] {
            let mut flexure = Flexure::new(FlexureParameters { friction_n, ..slow });
            ramp(&mut flexure, 0.0, 200.0, 1.0);
            flexure.pause(500.0);
            let remaining = flexure.at_mm().abs();
            assert!((min..=max).contains(&remaining), "{friction_n}: {remaining}");
        }
    }

    #[test]
    fn all_terms_together_converge() {
        let mut flexure = Flexure::new(FlexureParameters {
            stiffening: 0.05,
            stop: (120.0, 0.6),
            friction_n: 2.5,
            lag_s: 0.01,
            creep: (0.02, 5.0),
            softening: (0.03, 2.0),
            ..PLAIN
        });
        let up = ramp(&mut flexure, 0.0, 200.0, 1.0);
        let down = ramp(&mut flexure, 200.0, -200.0, 2.0);
        assert!(up > 0.25 && up < 0.35 && (up + down).abs() < 0.02, "{up} {down}");
    }
}
