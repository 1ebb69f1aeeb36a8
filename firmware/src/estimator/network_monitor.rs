//! Supervision of the networks: a network that deviates from the ideal model too far and too long is replaced by it
//! until it agrees again.
//!
//! An external magnet causes such a deviation as well; it is detected from the field ([`crate::estimator::disturbance`])
//! and invalidates all forces.

use crate::config::limits::DetectionLimits;
use crate::estimator::estimate::Estimate;
use crate::fixed_point::Force;
use crate::sensors::hall::SENSORS;

/// A deviation up to the ideal model's force divided by this is accepted.
const TOLERANCE_DIVISOR: i32 = 5;

/// Absolute deviations of a network from the ideal model, Fx and Fz.
pub(super) fn deviations(ideal: [Force; 2], network: [Force; 2]) -> [i32; 2] {
    let [ideal_x, ideal_z] = ideal;
    let [x, z] = network;
    [(x, ideal_x), (z, ideal_z)]
        .map(|(network, ideal)| network.0.saturating_sub(ideal.0).saturating_abs())
}

/// Deviations of a network from the ideal model beyond a fifth of the ideal model's force, Fx and Fz.
pub(super) fn excess_deviations(ideal: [Force; 2], network: [Force; 2]) -> [Force; 2] {
    let [x, z] = deviations(ideal, network);
    let [ideal_x, ideal_z] = ideal;
    [(x, ideal_x), (z, ideal_z)].map(|(deviation, ideal)| {
        Force(deviation.saturating_sub(ideal.0.saturating_abs() / TOLERANCE_DIVISOR))
    })
}

/// Monitor of all sensors' networks.
#[derive(Clone, Copy, Debug)]
pub struct NetworkMonitor {
    limit: Force,
    ticks: u8,
    /// Successive ticks of deviation.
    deviating: [u8; SENSORS],
}

impl NetworkMonitor {
    /// Monitor before the first frame.
    pub const fn new(limits: &DetectionLimits) -> Self {
        Self {
            limit: Force(limits.divergence_n.saturating_mul(1 << Force::BITS)),
            ticks: limits.divergence_ticks,
            deviating: [0; SENSORS],
        }
    }

    /// Compares the estimates with `ideal`, those before the networks, and replaces the forces of diverged networks.
    pub fn update(&mut self, ideal: &[Estimate; SENSORS], estimates: &mut [Estimate; SENSORS]) {
        for (ticks, (ideal, estimate)) in self.deviating.iter_mut().zip(ideal.iter().zip(estimates))
        {
            let mut excess = excess_deviations(ideal.force, estimate.force).into_iter();
            let deviates =
                estimate.network_sigma.is_some() && excess.any(|excess| excess > self.limit);
            *ticks = if deviates { ticks.saturating_add(1) } else { 0 };
            if *ticks >= self.ticks {
                estimate.force = ideal.force;
                (estimate.sigma, estimate.network_sigma) = (None, None);
            }
        }
    }

    /// Whether a sensor's network is replaced.
    pub fn network_diverged(&self, sensor: usize) -> bool {
        self.deviating.get(sensor).is_some_and(|ticks| *ticks >= self.ticks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::Validity;

    fn estimates(newtons: i32, network: bool) -> [Estimate; SENSORS] {
        [Estimate {
            force: [Force(newtons << Force::BITS), Force(0)],
            network_sigma: network.then_some([Force(1 << Force::BITS); 2]),
            validity: Validity::Valid,
            ..Estimate::MISSING
        }; SENSORS]
    }

    #[test]
    fn a_deviation_above_40_n_and_a_fifth_diverges_after_two_frames() {
        // At 100 N of the ideal model the limit is 60 N.
        let ideal = estimates(100, false);
        for (newtons, diverges) in [(161, true), (160, false), (39, true), (40, false)] {
            let mut monitor = NetworkMonitor::new(&DetectionLimits::GRIPPER);
            let mut frame = || {
                let mut frame = estimates(newtons, true);
                monitor.update(&ideal, &mut frame);
                frame[2].force[0].0 >> Force::BITS
            };
            assert_eq!(frame(), newtons);
            assert_eq!(frame(), if diverges { 100 } else { newtons });
            assert_eq!(monitor.network_diverged(2), diverges);
            let mut near = estimates(101, true);
            monitor.update(&ideal, &mut near);
            assert_eq!(near, estimates(101, true));
            assert!(!monitor.network_diverged(2));
        }
    }

    #[test]
    fn estimates_without_a_network_never_diverge() {
        let mut monitor = NetworkMonitor::new(&DetectionLimits::GRIPPER);
        let mut frame = estimates(300, false);
        (0..9).for_each(|_| monitor.update(&estimates(100, false), &mut frame));
        assert_eq!(frame, estimates(300, false));
    }
}
