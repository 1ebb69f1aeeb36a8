//! Recurrent networks over a frame's estimates: what the ideal model leaves, memory above all.
//!
//! A table of networks names its sizes in its type, so an image links the kernel of these sizes and no
//! other; without networks it links none.

use crate::fixed::{clamped, share_of};
use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::model::gru::Run;
use crate::model::network::{FORCE_BITS, Guard, Network, Source, Target, Told};
use crate::units::Force;

/// Steps every network over the estimates of one frame and puts what it tells into them, each network
/// with its own `runs`.
///
/// A network that lacks an input begins anew: it has lost time. Until it has warmed up the estimates
/// stay as they were.
#[inline(never)]
pub fn apply<const INPUTS: usize, const HIDDEN: usize, const TOLD: usize, const NETWORKS: usize>(
    networks: &[Network<INPUTS, HIDDEN, TOLD>; NETWORKS],
    runs: &mut [Run<INPUTS, HIDDEN, TOLD>; NETWORKS],
    estimates: &mut [Estimate; SENSORS],
) {
    // Every network sees the ideal model alone, not what another one made of it.
    let seen = *estimates;
    for (network, run) in networks.iter().zip(runs) {
        let Some(told) = run.step(network, |source| value(&seen, source)) else {
            continue;
        };
        let heads = network.sensors.iter().zip(&network.guards);
        for ((&sensor, guard), told) in heads.zip(&told) {
            if let Some(estimate) = estimates.get_mut(usize::from(sensor)) {
                correct(estimate, network.target, guard, told);
            }
        }
    }
}

/// What a source says, in its unit; nothing where its sensor is missing.
fn value(estimates: &[Estimate; SENSORS], source: Source) -> Option<i32> {
    let present = |sensor: u8| {
        let estimate = estimates.get(usize::from(sensor))?;
        (estimate.validity != Validity::Missing).then_some(estimate)
    };
    match source {
        Source::None => Some(0),
        Source::Field { sensor, axis } => {
            let field = present(sensor)?.field.get(usize::from(axis))?;
            Some(field.0)
        }
        Source::Ideal { sensor, axis } => {
            let force = present(sensor)?.force.get(usize::from(axis))?;
            Some(force.0)
        }
    }
}

fn correct(estimate: &mut Estimate, target: Target, guard: &Guard, told: &Told) {
    if estimate.validity == Validity::Missing {
        return;
    }
    let [x, z] = estimate.force;
    let [mean_x, mean_z] = told.mean;
    estimate.force = match target {
        Target::Force => told.mean,
        Target::Rest => [
            Force(x.0.saturating_add(mean_x.0)),
            Force(z.0.saturating_add(mean_z.0)),
        ],
    };
    let [apart_x, apart_z] = [(0, x), (1, z)].map(|(axis, ideal)| {
        let told = estimate.force.get(axis).map_or(ideal.0, |force| force.0);
        told.saturating_sub(ideal.0).saturating_abs()
    });
    let [sigma_x, sigma_z] = told.sigma;
    let [x, z] = beyond(guard, estimate, [apart_x, apart_z]);
    estimate.told_sigma = Some(told.sigma);
    estimate.sigma = Some([
        Force(sigma_x.0.saturating_add(x)),
        Force(sigma_z.0.saturating_add(z)),
    ]);
}

/// How far, in the unit of a force, a sensor is beyond what its network has learned from: its field
/// beside the surface, and the network (`apart`) from the ideal model.
fn beyond(guard: &Guard, estimate: &Estimate, [x, z]: [i32; 2]) -> [i32; 2] {
    let [least, most] = guard.departure;
    let departure = estimate.parity.departure;
    let outside = (i64::from(departure.0) - i64::from(most.0))
        .max(i64::from(least.0) - i64::from(departure.0))
        .max(0);
    let [force_x, force_z] = guard.force;
    let [split_x, split_z] = guard.split;
    [(force_x, split_x, x), (force_z, split_z, z)].map(|(force, split, apart)| {
        let by_field = share_of(clamped(outside), force, FORCE_BITS);
        by_field.saturating_add(apart.saturating_sub(split.0).max(0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::force::Beside;
    use crate::model::gru;
    use crate::model::network::{Head, Input, UnitPair, Weights};
    use crate::units::Field;

    /// Tells 1 N and 2 N with 1 N of deviation, whatever the field of sensor 1 is.
    fn constant(target: Target) -> [Network<1, 4, 1>; 1] {
        let input = Input {
            source: Source::Field { sensor: 1, axis: 2 },
            offset: 0,
            gain: 1 << 20,
        };
        let none = Input {
            source: Source::None,
            offset: 0,
            gain: 0,
        };
        let units = |()| UnitPair {
            bias: [[0; 3]; 2],
            input: [[[[0; 2]; 3]; 2]; 4],
            state_bias: [0; 2],
            state: [[[[0; 2]; 3]; 2]; 4],
        };
        let first = |()| UnitPair {
            bias: [[0; 3]; 2],
            input: [[[[0; 2]; 3]; 2]; 1],
            state_bias: [0; 2],
            state: [[[[0; 2]; 3]; 2]; 4],
        };
        [Network {
            sensors: [1],
            target,
            inputs: [[input, none]],
            force: [1 << 18; 2],
            warm_up: 3,
            guards: [Guard::NONE],
            weights: Weights {
                first: [(); 4].map(first),
                second: [(); 4].map(units),
                heads: [Head {
                    bias: [1 << 26, 2 << 26, 0, 0],
                    weights: [[[0; 2]; 4]; 4],
                }],
            },
            check: 0,
        }]
    }

    fn estimates() -> [Estimate; SENSORS] {
        [Estimate {
            force: [Force(100), Force(200)],
            validity: Validity::Valid,
            field: [Field(5); 3],
            ..Estimate::MISSING
        }; SENSORS]
    }

    /// The estimates of the last of so many frames.
    fn after(
        frames: u32,
        target: Target,
        runs: &mut [gru::Run<1, 4, 1>; 1],
    ) -> [Estimate; SENSORS] {
        let mut last = estimates();
        for _ in 0..frames {
            last = estimates();
            apply(&constant(target), runs, &mut last);
        }
        last
    }

    #[test]
    fn a_network_speaks_for_its_sensor_once_it_has_warmed_up() {
        let mut runs = [Run::RESET];
        assert_eq!(after(3, Target::Force, &mut runs), estimates());
        let [other, told, ..] = after(1, Target::Force, &mut runs);
        assert_eq!(told.force, [Force(1024), Force(2048)]);
        assert!(told.sigma.is_some_and(|[x, _]| (x.0 - 1024).abs() <= 1));
        assert_eq!((other.force, other.sigma), ([Force(100), Force(200)], None));
    }

    #[test]
    fn sigma_grows_where_the_field_or_the_force_is_beyond_what_was_learned() {
        let guard = Guard {
            departure: [Field(-10), Field(20)],
            force: [2 << FORCE_BITS, 3 << FORCE_BITS],
            split: [Force(50), Force(i32::MAX)],
        };
        let at = |departure| Estimate {
            parity: Beside {
                departure: Field(departure),
                spread: 1,
            },
            ..Estimate::MISSING
        };
        assert_eq!(beyond(&guard, &at(20), [50, 9999]), [0, 0]);
        assert_eq!(beyond(&guard, &at(25), [0, 0]), [10, 15]);
        assert_eq!(beyond(&guard, &at(-14), [57, 0]), [8 + 7, 12]);
        assert_eq!(beyond(&Guard::NONE, &at(i32::MIN), [i32::MAX; 2]), [0, 0]);
    }

    #[test]
    fn what_the_ideal_model_leaves_is_added_to_it() {
        let [_, told, ..] = after(4, Target::Rest, &mut [Run::RESET]);
        assert_eq!(told.force, [Force(1124), Force(2248)]);
    }

    #[test]
    fn a_network_that_lacks_an_input_begins_anew() {
        let mut runs = [Run::RESET];
        after(9, Target::Force, &mut runs);
        let mut lacking = estimates();
        lacking[1] = Estimate::MISSING;
        apply(&constant(Target::Force), &mut runs, &mut lacking);
        assert_eq!((lacking[1], runs[0].steps), (Estimate::MISSING, 0));
        assert_eq!(after(3, Target::Force, &mut runs), estimates());
    }

    #[test]
    fn without_networks_nothing_happens() {
        let networks: [Network<1, 4, 1>; 0] = [];
        let mut same = estimates();
        apply(&networks, &mut [], &mut same);
        assert_eq!(same, estimates());
    }
}
