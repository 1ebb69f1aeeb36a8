//! A network that says something else than the physics: the ideal model's forces count until it comes back.
//!
//! A foreign magnet brings both apart as well, and is told apart by the field ([`crate::foreign`]); there no
//! force is believed. Here the network alone is not.

use crate::force::Estimate;
use crate::frame::SENSORS;
use crate::limits::Limits;
use crate::units::Force;

/// One over the share of the ideal model's force that is no difference.
const SHARE: i32 = 5;

/// The watch over the networks of all sensors.
#[derive(Clone, Copy, Debug)]
pub struct Astray {
    limit: Force,
    ticks: u8,
    apart: [u8; SENSORS],
}

impl Astray {
    /// No frame has been seen.
    pub const fn new(limits: &Limits) -> Self {
        Self {
            limit: Force(limits.astray_n.saturating_mul(1 << Force::BITS)),
            ticks: limits.astray_ticks,
            apart: [0; SENSORS],
        }
    }

    /// Takes a frame: `ideal` are the estimates before the networks, `estimates` those after them. Where a
    /// network has been astray for long enough, its sensor's force is the ideal model's.
    pub fn watch(&mut self, ideal: &[Estimate; SENSORS], estimates: &mut [Estimate; SENSORS]) {
        for (apart, (ideal, told)) in self.apart.iter_mut().zip(ideal.iter().zip(estimates)) {
            let is_apart = told.told_sigma.is_some() && are_apart(ideal, told, self.limit);
            *apart = if is_apart { apart.saturating_add(1) } else { 0 };
            if *apart >= self.ticks {
                told.force = ideal.force;
                (told.sigma, told.told_sigma) = (None, None);
            }
        }
    }

    /// Whether a sensor's network is astray.
    pub fn is_astray(&self, sensor: usize) -> bool {
        self.apart
            .get(sensor)
            .is_some_and(|apart| *apart >= self.ticks)
    }
}

/// Whether two estimates are apart by more than a limit, and a share of the first, along either axis.
fn are_apart(ideal: &Estimate, told: &Estimate, limit: Force) -> bool {
    ideal.force.iter().zip(told.force).any(|(ideal, told)| {
        let apart = told.0.saturating_sub(ideal.0).saturating_abs();
        apart > limit.0.saturating_add(ideal.0.saturating_abs() / SHARE)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::force::Validity;

    fn told(newtons: i32, sigma: bool) -> [Estimate; SENSORS] {
        [Estimate {
            force: [Force(newtons << Force::BITS), Force(0)],
            told_sigma: sigma.then_some([Force(1 << Force::BITS); 2]),
            validity: Validity::Valid,
            ..Estimate::MISSING
        }; SENSORS]
    }

    #[test]
    fn a_network_forty_newtons_and_a_fifth_away_for_two_frames_is_not_believed_until_it_comes_back()
    {
        // The ideal model says 100 N: 60 N away is the limit.
        for (says, falls_back) in [(161, true), (160, false), (39, true), (40, false)] {
            let mut astray = Astray::new(&Limits::GRIPPER);
            let ideal = told(100, false);
            let mut frame = || {
                let mut estimates = told(says, true);
                astray.watch(&ideal, &mut estimates);
                estimates[2].force[0].0 >> Force::BITS
            };
            assert_eq!(frame(), says);
            assert_eq!(frame(), if falls_back { 100 } else { says });
            assert_eq!(astray.is_astray(2), falls_back);
            let mut near = told(101, true);
            astray.watch(&ideal, &mut near);
            assert_eq!((near, astray.is_astray(2)), (told(101, true), false));
        }
    }

    #[test]
    fn without_a_network_nothing_is_astray() {
        let mut astray = Astray::new(&Limits::GRIPPER);
        let mut estimates = told(300, false);
        (0..9).for_each(|_| astray.watch(&told(100, false), &mut estimates));
        assert_eq!(estimates, told(300, false));
    }
}
