//! How long a network remembers how it began.

use super::float::FloatState;
use super::network::Network;

/// Outputs that differ by less have forgotten: a thousandth of the forces' scale.
const FORGOTTEN: f64 = 1e-3;
/// The longest warm-up, in steps: ten seconds at 1 kHz. A network that holds a memory without end, as
/// friction does, gets this much.
pub const LONGEST: u16 = 10_000;

/// Steps until a run from the reset and runs that have seen every input at either end of its range
/// tell the same, all inputs resting in the middle.
pub fn steps(network: &Network) -> u16 {
    let inputs = network.inputs.len();
    let driven = [-1.0, 1.0].map(|end| {
        let mut state = FloatState::at(network, 0.0);
        let held = vec![end; inputs];
        (0..LONGEST).for_each(|_| drop(state.step(network, &held)));
        state
    });
    let rest = vec![0.0; inputs];
    let slowest = driven.into_iter().map(|mut driven| {
        let mut reset = FloatState::at(network, 0.0);
        let mut last_apart = 0;
        for step in 1..=LONGEST {
            let pairs = reset
                .step(network, &rest)
                .into_iter()
                .zip(driven.step(network, &rest));
            if pairs.into_iter().any(|(a, b)| (a - b).abs() > FORGOTTEN) {
                last_apart = step;
            }
        }
        last_apart
    });
    slowest.max().unwrap_or(0)
}
