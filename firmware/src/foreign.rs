//! A foreign magnet is noticed: signals over one frame of the gripper, a vote, a latch.
//!
//! | signal | what speaks | when |
//! | --- | --- | --- |
//! | [`Signals::sigma`] | a network's own standard deviation | above 25 N for 5 frames |
//! | [`Signals::split`] | network and ideal model disagree | by more than 40 N and 20 %, for 5 frames |
//! | [`Signals::parity`] | the fields lie beside their surfaces ([`crate::model::parity`]), all sensors together | [`PARITY`] |
//! | [`Signals::common`] | they do so in the same direction at all sensors (a far magnet) | [`COMMON`] |
//! | [`Signals::outside`] | a field is outside the design box or the sensor's range | for 5 frames |
//!
//! Two of these, or the parity alone above [`PARITY_ALONE`], raise the flag; it falls after half a
//! second without any. What changes slowly (heat, ageing, an effect that nobody modelled) is no magnet:
//! each departure from the surface is counted from its own mean over some 8 seconds, and averaged over
//! some 8 ms against noise. While a magnet is suspected that mean stands still, so that all is well once
//! the magnet is gone. One that is put down and stays is taken for what is normal after a minute, and
//! raises the flag again when it goes.
//!
//! The thresholds are in standard deviations of what the fit leaves beside the surface, which the tables
//! hold. They were set by `cargo bench -p host-tools --bench foreign_magnet`.

use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::units::Force;

/// Squared departures of all sensors, each in its spreads, that count as a signal.
pub const PARITY: i32 = 40;
/// The same that need no second signal.
pub const PARITY_ALONE: i32 = 56;
/// Square of the sum of all departures, in spreads, over the number of sensors.
pub const COMMON: i32 = 40;
/// Standard deviation of a force above which a network says that it does not know, in newtons.
pub const SIGMA_N: i32 = 25;
/// Difference of network and ideal model: newtons, and a fifth of the ideal model's force beside.
pub const SPLIT_N: i32 = 40;

/// Frames for which these three must last.
const LASTING: u8 = 5;
/// Frames without any signal after which the flag falls.
const QUIET: u16 = 500;
/// Frames after a start in which nothing is said: the mean is still forming.
const SETTLING: u32 = 256;
/// The average over noise takes an eighth of each frame.
const FAST_SHIFT: u32 = 3;
/// The mean takes this share of each frame, once it has seen as many.
const SLOW_SHIFT: u32 = 13;
/// Frames of suspicion without a break after which the means begin anew.
const STAYS: u32 = 60_000;
/// Fractional bits of the average, over the unit of a field; the same as those of a spread.
const FAST_BITS: u32 = crate::model::parity::SPREAD_BITS;
/// Fractional bits of the mean beyond those of the average.
const SLOW_BITS: u32 = 16;
/// Departures are followed up to this, in units of a field: thousands of gauss.
const MOST: i32 = 1 << 20;
/// An average less its mean counts up to this: a hundred gauss.
const MOST_APART: i32 = 1 << 22;
/// Fractional bits of a share (a departure in spreads), and its greatest.
const SHARE_BITS: u32 = 8;
const MOST_SHARE: i32 = 1 << 14;

/// What speaks for a foreign magnet in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// A network does not know.
    pub sigma: bool,
    /// A network and the ideal model disagree.
    pub split: bool,
    /// The fields lie beside their surfaces.
    pub parity: bool,
    /// Far beside: enough alone.
    pub parity_alone: bool,
    /// In the same direction at all sensors.
    pub common: bool,
    /// A field is where no force brings it.
    pub outside: bool,
}

impl Signals {
    /// True where a foreign magnet is to be assumed.
    pub fn vote(&self) -> bool {
        let all = [
            self.sigma,
            self.split,
            self.parity,
            self.common,
            self.outside,
        ];
        self.parity_alone || all.iter().filter(|&&speaks| speaks).count() >= 2
    }

    fn any(&self) -> bool {
        *self != Self::default()
    }
}

/// What the signals are made of: what a bench sweeps thresholds over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measures {
    /// Squared departures of all sensors, with 16 fractional bits.
    pub parity: i32,
    /// Squared sum of the departures over the number of sensors, with 16 fractional bits.
    pub common: i32,
    /// The greatest standard deviation that a network told.
    pub sigma: Force,
    /// The greatest difference of network and ideal model beyond a fifth of the force.
    pub split: Force,
}

/// One sensor's departure from its surface.
#[derive(Clone, Copy, Debug, Default)]
struct Track {
    /// Frames since it began; it stays at the end of its range.
    frames: u32,
    fast: i32,
    slow: i64,
}

/// Frames for which something has lasted.
#[derive(Clone, Copy, Debug, Default)]
struct Lasting(u8);

/// The detector of one gripper.
#[derive(Clone, Copy, Debug, Default)]
pub struct Detector {
    tracks: [Track; SENSORS],
    sigma: Lasting,
    split: Lasting,
    outside: Lasting,
    /// Frames for which a magnet has been suspected without a break.
    suspected: u32,
    flag: bool,
    quiet: u16,
    /// Of the latest frame.
    pub signals: Signals,
    /// Of the latest frame.
    pub measures: Measures,
}

impl Detector {
    /// One frame: `ideal` are the estimates before the networks, `estimates` those after them. Marks each
    /// of these as disturbed while the flag is up, and tells the flag.
    #[inline(never)]
    pub fn watch(
        &mut self,
        ideal: &[Estimate; SENSORS],
        estimates: &mut [Estimate; SENSORS],
    ) -> bool {
        self.measure(ideal, estimates);
        let measures = self.measures;
        let above = |square: i32, limit: i32| square > limit << (2 * SHARE_BITS);
        let newtons = |limit: i32| Force(limit << Force::BITS);
        let parity = above(measures.parity, PARITY);
        let common = above(measures.common, COMMON);
        let outside = ideal.iter().any(|estimate| {
            matches!(
                estimate.validity,
                Validity::OutsideModel | Validity::Saturated
            )
        });
        self.signals = Signals {
            sigma: self.sigma.lasts(measures.sigma > newtons(SIGMA_N)),
            split: self.split.lasts(measures.split > newtons(SPLIT_N)),
            parity,
            parity_alone: above(measures.parity, PARITY_ALONE),
            common,
            outside: self.outside.lasts(outside),
        };
        self.suspected = match self.signals.any() {
            true => self.suspected.saturating_add(1),
            false => 0,
        };
        if self.suspected >= STAYS {
            (self.tracks, self.suspected) = ([Track::default(); SENSORS], 0);
        }
        self.latch();
        for estimate in estimates.iter_mut() {
            estimate.disturbed = self.flag;
        }
        self.flag
    }

    /// True while a foreign magnet is to be assumed.
    pub fn flag(&self) -> bool {
        self.flag
    }

    fn measure(&mut self, ideal: &[Estimate; SENSORS], estimates: &[Estimate; SENSORS]) {
        let (mut squares, mut sum, mut seen) = (0_i32, 0_i32, 0_usize);
        let mut measures = Measures::default();
        let suspected = self.suspected > 0;
        for (track, (ideal, told)) in self.tracks.iter_mut().zip(ideal.iter().zip(estimates)) {
            if let Some(share) = track.follow(ideal, suspected) {
                squares = squares.saturating_add(share * share);
                sum += share;
                seen += 1;
            }
            if let Some(sigma) = told.told_sigma {
                for ((sigma, told), ideal) in sigma.iter().zip(told.force).zip(ideal.force) {
                    let apart = told.0.saturating_sub(ideal.0).saturating_abs();
                    let beyond = Force(apart.saturating_sub(ideal.0.saturating_abs() / 5));
                    measures.sigma = measures.sigma.max(*sigma);
                    measures.split = measures.split.max(beyond);
                }
            }
        }
        measures.parity = squares;
        if seen == SENSORS {
            let square = i64::from(sum) * i64::from(sum) / SENSORS as i64;
            measures.common = crate::fixed::clamped(square);
        }
        self.measures = measures;
    }

    fn latch(&mut self) {
        if self.signals.vote() {
            (self.flag, self.quiet) = (true, 0);
        } else if self.signals.any() {
            self.quiet = 0;
        } else {
            self.quiet = self.quiet.saturating_add(1);
            self.flag &= self.quiet < QUIET;
        }
    }
}

impl Lasting {
    fn lasts(&mut self, now: bool) -> bool {
        self.0 = if now { self.0.saturating_add(1) } else { 0 };
        self.0 >= LASTING
    }
}

impl Track {
    /// The departure in spreads, counted from its own mean; nothing before there is one. A sensor that
    /// is missing begins anew: it has lost time.
    fn follow(&mut self, estimate: &Estimate, suspected: bool) -> Option<i32> {
        if estimate.validity == Validity::Missing {
            *self = Self::default();
            return None;
        }
        let now = estimate.parity.departure.0.clamp(-MOST, MOST) << FAST_BITS;
        if self.frames == 0 {
            (self.fast, self.slow) = (now, i64::from(now) << SLOW_BITS);
        }
        self.frames = self.frames.saturating_add(1);
        self.fast += (now - self.fast) >> FAST_SHIFT;
        if !suspected || self.frames <= SETTLING {
            // One over the number of frames, then a fixed share.
            let shift = (u32::BITS - self.frames.leading_zeros()).min(SLOW_SHIFT);
            self.slow += ((i64::from(self.fast) << SLOW_BITS) - self.slow) >> shift;
        }
        let mean = crate::fixed::clamped(self.slow >> SLOW_BITS);
        let apart = (self.fast - mean).clamp(-MOST_APART, MOST_APART);
        let share = (apart << SHARE_BITS).checked_div(estimate.parity.spread)?;
        (self.frames > SETTLING).then(|| share.clamp(-MOST_SHARE, MOST_SHARE))
    }
}

#[cfg(test)]
mod tests;
