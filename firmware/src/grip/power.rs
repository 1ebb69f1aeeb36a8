//! A millisecond of the power layer: faults found, reacted to, latched, cleared; the session followed.

use super::profile::TRIP_N;
use super::react::{Reaction, TRIPPED, fault_of, strongest};
use super::states::{Phase, Power, Task};
use super::table::{self, PowerEvent};
use super::{Arming, Cause, Grip, Inputs, Outputs};
use crate::motor::State;
use crate::motor::plausible::Supply;
use crate::params;
use crate::status::Fault;
use crate::units::Force;

/// Milliseconds for which a host's clear counts.
const CLEARS_MS: u8 = 5;
impl Grip {
    /// Notes the faults that this layer can see.
    pub(super) fn find_faults(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let tripped = match inputs.motor.state {
            State::Tripped(trip) => Some(fault_of(trip)),
            _ => None,
        };
        for fault in TRIPPED {
            self.note(fault, tripped == Some(fault), 0, outputs);
        }
        let is_armed = inputs.motor.state == State::Armed;
        let is_out = is_armed && inputs.motor.supply != Supply::Sound;
        let detail = (inputs.motor.bus_v * 1e3) as u32;
        self.note(Fault::Supply, is_out, detail, outputs);
        self.note(Fault::Hot, is_armed && inputs.motor.is_hot, 0, outputs);
        self.find_stray(inputs, outputs);
        let is_lost = self.lost_ticks >= self.limits.blind_ticks;
        self.note(Fault::Blind, is_lost, 0, outputs);
        let is_over = self.unbelieved_ticks == 0 && self.force_n > TRIP_N;
        let detail = (self.force_n * Force::PER_NEWTON as f32) as u32;
        self.note(Fault::OverForce, is_over, detail, outputs);
        let is_foot = self.power == Power::Enabled && self.task == Task::Foot;
        let is_overloaded = is_foot && self.standing.peak_n > self.limits.overload_n;
        // Latched: until a host clears it.
        if is_overloaded || inputs.clear {
            let detail = self.standing.peak_detail();
            self.note(Fault::FootOverload, is_overloaded, detail, outputs);
        }
        let is_lost = self.power == Power::Enabled && self.task == Task::Lost;
        self.note(Fault::ObjectLost, is_lost, 0, outputs);
        if inputs.clear {
            // Of the moment in which they were found.
            self.note(Fault::Jammed, false, 0, outputs);
            self.note(Fault::StrokeWrong, false, 0, outputs);
        }
    }

    /// Whether the opening can be what it is told to be: between its ends, and where the fingers would have met
    /// they press. Else it is forgotten.
    fn find_stray(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let limits = &self.limits;
        let opening_mm = inputs
            .motor
            .opening_mm
            .filter(|_| self.task != Task::Homing);
        let is_stray = opening_mm.is_some_and(|mm| {
            let is_met = mm < -limits.stray_mm && self.force_n < limits.contact_n;
            is_met || mm > params::STROKE.value as f32 + limits.stray_mm
        });
        self.stray_ms = match is_stray {
            true => self.stray_ms.saturating_add(1),
            false => 0,
        };
        if self.stray_ms >= limits.stray_ms {
            let detail = (opening_mm.unwrap_or_default().abs() * 1e3) as u32;
            self.note(Fault::StrokeWrong, true, detail, outputs);
            outputs.opening_mm = Some(f32::NAN);
            self.stray_ms = 0;
        }
    }

    /// Reacts to faults, hosts and what has ended.
    pub(super) fn follow_power(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let bits = inputs.faults | self.faults.bits();
        self.clearing_ms = match inputs.clear {
            true => CLEARS_MS,
            false => self.clearing_ms.saturating_sub(1),
        };
        if self.clears() {
            self.latch.clear(|fault| is_active(bits, fault));
        }
        self.react(bits);
        if inputs.stop {
            self.happens(PowerEvent::QuickStop);
        }
        self.advance(inputs);
        let is_busy = self.is_gripped || self.task.moves() || self.task == Task::Foot;
        let strange = is_active(bits, Fault::StrangeFrames) && !is_busy;
        if strange {
            self.happens(PowerEvent::Disable);
        }
        let is_off = matches!(self.power, Power::FaultReaction | Power::Fault);
        let forbids = strongest(bits, Phase::Moving, self.locks)
            .is_some_and(|(reaction, _)| reaction > Reaction::QuickStop);
        let ends = strange && self.power == Power::Armed;
        let is_unsound = is_active(bits, Fault::TablesUnsound) || inputs.is_sound != Some(true);
        let is_kept = is_off || forbids || ends || is_unsound || inputs.is_calibrating;
        outputs.may_arm = !is_kept;
        outputs.arming = match (self.power, inputs.motor.state) {
            (Power::Armed, State::Disarmed) => Some(Arming::Arm),
            // What hangs on a screw that is driven back gives way slowly while the windings are shorted.
            (Power::Fault, _) if self.reaction == Reaction::Brake && !self.clears() => None,
            (Power::Safe | Power::Fault, State::Arming | State::Armed | State::Tripped(_)) => {
                Some(Arming::Disarm)
            }
            _ => None,
        };
    }

    /// A host clears, or did so a moment ago: what the motor tripped on goes once it is disarmed.
    const fn clears(&self) -> bool {
        self.clearing_ms > 0
    }

    /// Does what the strongest active fault asks for; the first is kept.
    fn react(&mut self, bits: u32) {
        let phase = match self.power {
            Power::Enabled => self.task.phase(self.has_settled),
            _ if self.is_gripped => Phase::Holding,
            _ => Phase::Moving,
        };
        let Some((reaction, fault)) = strongest(bits, phase, self.locks) else {
            return;
        };
        let event = match (reaction, self.power) {
            (Reaction::Warn | Reaction::Hold, _) => return,
            (Reaction::QuickStop, Power::Enabled) => PowerEvent::QuickStop,
            (Reaction::QuickStop, _) => return,
            (Reaction::Brake | Reaction::Off, _) => PowerEvent::Fault,
        };
        let state = self.state();
        let (is_foot, at_ms) = (phase == Phase::Foot, self.now_ms);
        if self.happens(event) {
            self.reaction = reaction;
            self.backs_off = fault == Fault::OverForce && !is_foot;
            self.latch.note(Cause {
                fault,
                state,
                at_ms,
            });
        }
    }

    /// What follows from the session, the self-test, and what has ended.
    fn advance(&mut self, inputs: &Inputs) {
        let host = &inputs.host;
        let event = match self.power {
            Power::Boot => Some(PowerEvent::Started),
            Power::SelfTest => inputs.is_sound.map(|is_sound| match is_sound {
                true => PowerEvent::Passed,
                false => PowerEvent::Failed,
            }),
            Power::Safe if inputs.is_calibrating => Some(PowerEvent::CalibrationBegan),
            Power::Calibrating => (!inputs.is_calibrating).then_some(PowerEvent::CalibrationEnded),
            Power::Safe => (host.is_offered || host.is_open).then_some(PowerEvent::NonceOffered),
            Power::ArmPending if host.is_open => Some(PowerEvent::SessionOpened),
            Power::ArmPending => (!host.is_offered).then_some(PowerEvent::NonceExpired),
            // Where a load hangs on a screw that is driven back, it is held without a host.
            Power::Armed => (!host.is_open && (self.locks || !self.is_gripped))
                .then_some(PowerEvent::SessionClosed),
            Power::Enabled => None,
            Power::QuickStop => self.has_stopped().then_some(PowerEvent::Stopped),
            Power::FaultReaction => {
                let is_over = self.has_rested() || self.power_ms >= self.limits.stop_ms;
                is_over.then_some(PowerEvent::Reacted)
            }
            Power::Fault => {
                let is_gone = self.latch.cause().is_none() && inputs.is_sound == Some(true);
                (self.clears() && is_gone).then_some(PowerEvent::Cleared)
            }
        };
        if let Some(event) = event {
            self.happens(event);
        }
    }

    /// Whether the fingers rest, and have since it was seen to.
    fn has_rested(&self) -> bool {
        self.rests() && self.power_ms >= u32::from(self.limits.resting_ms)
    }

    fn has_stopped(&self) -> bool {
        let has_backed_off = !self.backs_off || self.force_n < 1.2 * self.limits.backed_off_n;
        (self.has_rested() && has_backed_off) || self.power_ms >= self.limits.stop_ms
    }

    /// Takes an event of the power layer; whether anything followed.
    pub(super) fn happens(&mut self, event: PowerEvent) -> bool {
        let Some(to) = table::power(self.power, event) else {
            return false;
        };
        if self.power == Power::Enabled {
            self.seen = None;
        }
        if matches!(to, Power::QuickStop | Power::Armed) {
            self.place_mm = None;
        }
        if matches!(to, Power::Safe | Power::Fault) {
            // Nothing is driven: what hung on the fingers hangs on the screw alone.
            self.is_gripped &= self.locks;
        }
        self.power = to;
        self.power_ms = 0;
        true
    }
}

/// Whether a fault is among the heartbeat's bits.
pub(super) fn is_active(bits: u32, fault: Fault) -> bool {
    bits & (1 << fault.place()) != 0
}
