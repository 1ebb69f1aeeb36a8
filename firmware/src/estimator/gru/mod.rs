//! Inference of the recurrent networks on a frame's estimates.
//!
//! The type of a network contains its sizes, so an image links only the kernel of these sizes, and none without
//! networks.
//!
//! **Reset.** All states zero, as at the start of training. For the first [`Network::warm_up`] steps the outputs
//! depend more on that start than on the inputs and are not used. The exporter determines this number for each network:
//! the steps until a reset and a past with all inputs at the end of their range give the same outputs.

pub mod scale;

use crate::estimator::network_monitor::deviations;
use crate::estimator::{Estimate, NetworkBank, Validity};
use crate::fixed_point::{Force, mul_q, saturate};
use crate::model::calibration::Networks;
use crate::model::formats::{
    FORCE_BITS, GruState, Guard, Input, InputSource, Network, OUTPUTS, Pair, Prediction, Target,
};
use crate::model::kernel::gru;
use crate::sensors::hall::SENSORS;

/// State of a network with its number of steps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GruInference<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// State of the layers.
    pub state: GruState<INPUTS, HIDDEN, HEADS>,
    /// Steps since the reset, saturating.
    pub steps: u16,
    /// Whether [`Self::prepare`] was called since the last step.
    is_prepared: bool,
}

impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>
    GruInference<INPUTS, HIDDEN, HEADS>
{
    /// State after a reset.
    pub const RESET: Self = Self { state: GruState::RESET, steps: 0, is_prepared: false };

    /// Does what of the next step needs no input.
    pub fn prepare(&mut self, network: &Network<INPUTS, HIDDEN, HEADS>) {
        if !self.is_prepared {
            gru::prepare(&network.weights, &mut self.state);
            self.is_prepared = true;
        }
    }

    /// One step; `value` reads an input in the unit of its source. Returns `None` during the warm-up. A missing
    /// input resets the network, because it breaks the time series.
    #[inline(never)] // Called in two places, for networks of two sizes.
    pub fn step(
        &mut self,
        network: &Network<INPUTS, HIDDEN, HEADS>,
        value: impl Fn(InputSource) -> Option<i32>,
    ) -> Option<[Prediction; HEADS]> {
        if !read_inputs(&mut self.state.input, &network.inputs, value) {
            *self = Self::RESET;
            return None;
        }
        self.prepare(network);
        gru::finish(&network.weights, &mut self.state);
        self.is_prepared = false;
        self.steps = self.steps.saturating_add(1);
        let predictions = predictions(network.force, &self.state.outputs);
        (self.steps > network.warm_up).then_some(predictions)
    }
}

/// Reads and scales the inputs; false if one is missing.
///
/// Like [`predictions`] and [`reader`] without the sizes of the layers in its type, of which a host compiles all.
#[cfg_attr(target_os = "none", inline(always))]
fn read_inputs(
    scaled: &mut [Pair],
    inputs: &[[Input; 2]],
    value: impl Fn(InputSource) -> Option<i32>,
) -> bool {
    let mut is_complete = true;
    for (scaled, pair) in scaled.iter_mut().zip(inputs) {
        *scaled = pair.map(|input| {
            let value = value(input.source);
            is_complete &= value.is_some();
            scale::input(input, value.unwrap_or_default())
        });
    }
    is_complete
}

#[cfg_attr(target_os = "none", inline(always))]
fn predictions<const HEADS: usize>(
    force: [i32; 2],
    outputs: &[[i32; OUTPUTS]; HEADS],
) -> [Prediction; HEADS] {
    outputs.map(|outputs| scale::prediction(force, outputs))
}

/// At most `NETWORKS` networks of one size with their states.
#[derive(Clone, Debug)]
pub struct GruBank<
    'n,
    const INPUTS: usize,
    const HIDDEN: usize,
    const HEADS: usize,
    const NETWORKS: usize,
> {
    networks: &'n [Network<INPUTS, HIDDEN, HEADS>],
    runs: [GruInference<INPUTS, HIDDEN, HEADS>; NETWORKS],
    ahead: [Option<Step<HEADS>>; NETWORKS],
}

/// Result of [`GruInference::step`].
type Step<const HEADS: usize> = Option<[Prediction; HEADS]>;

impl<'n, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize, const NETWORKS: usize>
    GruBank<'n, INPUTS, HIDDEN, HEADS, NETWORKS>
{
    /// The networks after a reset; those beyond the number of states are ignored.
    pub const fn new(networks: &'n [Network<INPUTS, HIDDEN, HEADS>]) -> Self {
        Self {
            networks,
            runs: [const { GruInference::RESET }; NETWORKS],
            ahead: [const { None }; NETWORKS],
        }
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize, const NETWORKS: usize>
    NetworkBank for GruBank<'_, INPUTS, HIDDEN, HEADS, NETWORKS>
{
    fn prepare(&mut self, sensors: [bool; SENSORS]) {
        for (network, run) in self.networks.iter().zip(&mut self.runs) {
            if network.depends_only_on(sensors) {
                run.prepare(network);
            }
        }
    }

    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        apply(self.networks, &mut self.runs, &mut self.ahead, estimates);
    }

    fn step_ahead(&mut self, estimates: &[Estimate; SENSORS], sensors: [bool; SENSORS]) {
        for ((network, run), ahead) in self.networks.iter().zip(&mut self.runs).zip(&mut self.ahead)
        {
            *ahead = if network.depends_only_on(sensors) {
                Some(run.step(network, reader(estimates)))
            } else {
                run.prepare(network);
                None
            };
        }
    }
}

/// Networks of a calibration with their states.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one exists, in the sensing task")]
pub enum CalibratedBank<'n, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// Networks in the image's flash.
    Linked(GruBank<'n, INPUTS, HIDDEN, HEADS, SENSORS>),
    /// Networks in memory.
    Loaded(GruBank<'n, 2, 8, 1, SENSORS>),
}

impl<'n, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>
    CalibratedBank<'n, INPUTS, HIDDEN, HEADS>
{
    /// The networks after a reset.
    pub const fn new(networks: Networks<'n, INPUTS, HIDDEN, HEADS>) -> Self {
        match networks {
            Networks::Linked(networks) => Self::Linked(GruBank::new(networks)),
            Networks::Loaded(networks) => Self::Loaded(GruBank::new(networks)),
        }
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> NetworkBank
    for CalibratedBank<'_, INPUTS, HIDDEN, HEADS>
{
    fn prepare(&mut self, sensors: [bool; SENSORS]) {
        match self {
            Self::Linked(bank) => bank.prepare(sensors),
            Self::Loaded(bank) => bank.prepare(sensors),
        }
    }

    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        match self {
            Self::Linked(bank) => bank.apply(estimates),
            Self::Loaded(bank) => bank.apply(estimates),
        }
    }

    fn step_ahead(&mut self, estimates: &[Estimate; SENSORS], sensors: [bool; SENSORS]) {
        match self {
            Self::Linked(bank) => bank.step_ahead(estimates, sensors),
            Self::Loaded(bank) => bank.step_ahead(estimates, sensors),
        }
    }
}

/// Steps every network on a frame's estimates, unless it was stepped ahead, and merges the predictions into them. Estimates of
/// networks that are warming up stay unchanged, and so do those without an input of the compensation: the networks are
/// trained on compensated fields.
///
/// Not inlined: the check of the image finds the networks by this function.
#[inline(never)]
pub fn apply<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>(
    networks: &[Network<INPUTS, HIDDEN, HEADS>],
    runs: &mut [GruInference<INPUTS, HIDDEN, HEADS>],
    ahead: &mut [Option<Step<HEADS>>],
    estimates: &mut [Estimate; SENSORS],
) {
    // All of them before the first merge: inputs are those of the ideal model, not of other networks.
    for ((network, run), ahead) in networks.iter().zip(runs).zip(&mut *ahead) {
        ahead.get_or_insert_with(|| run.step(network, reader(estimates)));
    }
    for (network, ahead) in networks.iter().zip(ahead) {
        let Some(predictions) = ahead.take().flatten() else {
            continue;
        };
        let heads = network.sensors.iter().zip(&network.guards);
        for ((&sensor, guard), prediction) in heads.zip(&predictions) {
            if let Some(estimate) = estimates.get_mut(usize::from(sensor)) {
                merge(estimate, network.target, guard, prediction);
            }
        }
    }
}

fn reader(estimates: &[Estimate; SENSORS]) -> impl Fn(InputSource) -> Option<i32> {
    move |source| value(estimates, source)
}

/// Value of an input; `None` if its sensor is missing.
fn value(estimates: &[Estimate; SENSORS], source: InputSource) -> Option<i32> {
    let present = |sensor: u8| {
        let estimate = estimates.get(usize::from(sensor))?;
        (estimate.validity != Validity::Missing).then_some(estimate)
    };
    match source {
        InputSource::None => Some(0),
        InputSource::Field { sensor, axis } => {
            let field = present(sensor)?.field.get(usize::from(axis))?;
            Some(field.0)
        }
        InputSource::Ideal { sensor, axis } => {
            let force = present(sensor)?.force.get(usize::from(axis))?;
            Some(force.0)
        }
    }
}

fn merge(estimate: &mut Estimate, target: Target, guard: &Guard, prediction: &Prediction) {
    if estimate.validity == Validity::Missing || estimate.missing_inputs {
        return;
    }
    let ideal = estimate.force;
    let [x, z] = ideal;
    let [mean_x, mean_z] = prediction.mean;
    estimate.force = match target {
        Target::Force => prediction.mean,
        Target::Rest => [Force(x.0.saturating_add(mean_x.0)), Force(z.0.saturating_add(mean_z.0))],
    };
    let [sigma_x, sigma_z] = prediction.sigma;
    let [x, z] = extrapolation(guard, estimate, deviations(ideal, estimate.force));
    estimate.network_sigma = Some(prediction.sigma);
    estimate.sigma = Some([Force(sigma_x.0.saturating_add(x)), Force(sigma_z.0.saturating_add(z))]);
}

/// Increase of the standard deviations outside the network's training range: by the parity residual, and by the
/// `deviation` of the network from the ideal model.
fn extrapolation(guard: &Guard, estimate: &Estimate, [x, z]: [i32; 2]) -> [i32; 2] {
    let [min, max] = guard.residual;
    let residual = estimate.parity.residual;
    let outside = (i64::from(residual.0) - i64::from(max.0))
        .max(i64::from(min.0) - i64::from(residual.0))
        .max(0);
    let [force_x, force_z] = guard.force;
    let [max_x, max_z] = guard.deviation;
    [(force_x, max_x, x), (force_z, max_z, z)].map(|(force, max, deviation)| {
        let by_field = mul_q(saturate(outside), force, FORCE_BITS);
        by_field.saturating_add(deviation.saturating_sub(max.0).max(0))
    })
}

#[cfg(test)]
mod tests;
