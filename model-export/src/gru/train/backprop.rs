//! Loss and gradients of one network over one stream of rows.

#![allow(unsafe_code)] // Instructions that not every processor has.

use crate::gru::recurrence::{
    LayerGradients, LayerTape, LayerWeights, add_scaled, exp, outer_products, transposed,
    weighted_sums,
};
use crate::gru::train::parameters::{TrainableParameters, index};

/// Lower clamp of the logarithm of the standard deviation, relative to the force scale: below 1/2000 single
/// rows would dominate the gradient.
pub const MIN_LOG_SIGMA: f32 = -7.6;
/// Upper clamp: twice the scale carries no information.
pub const MAX_LOG_SIGMA: f32 = 0.7;

/// Weights of one network in both directions.
#[derive(Debug)]
pub struct NetworkWeights<'a> {
    layers: [LayerWeights<'a>; 2],
    /// `hidden x outputs`.
    head: &'a [f32],
    head_bias: &'a [f32],
    transposed_states: [Vec<f32>; 2],
    transposed_input: Vec<f32>,
    transposed_head: Vec<f32>,
}

impl<'a> NetworkWeights<'a> {
    /// Of one of several networks.
    pub fn of(parameters: &'a TrainableParameters, network: usize) -> Self {
        let of = |tensor: usize| parameters.all[tensor].of(network);
        let layers = index::LAYERS.map(|[input, state, bias]| LayerWeights {
            input: of(input),
            state: of(state),
            bias: of(bias),
        });
        let head_bias = of(index::HEAD_BIAS);
        let head = of(index::HEAD_WEIGHTS);
        let width = layers[0].bias.len() / 2;
        Self {
            transposed_states: layers.map(|layer| transposed(layer.state, width)),
            transposed_input: transposed(layers[1].input, width),
            transposed_head: transposed(head, head_bias.len()),
            layers,
            head,
            head_bias,
        }
    }
}

#[derive(Clone, Debug, Default)]
pub struct StreamRows {
    /// `rows x inputs`.
    pub inputs: Vec<f32>,
    /// True outputs, `rows x forces`.
    pub truth: Vec<f32>,
    /// The same: weight in the loss, zero without a reference.
    pub weight: Vec<f32>,
}

/// States, loss and gradients of a network over windows of one stream.
#[derive(Clone, Debug)]
pub struct StreamPass {
    /// Rows of this window.
    pub rows: StreamRows,
    /// Outputs, `rows x outputs`: two means and two logarithms of the standard deviation for each sensor.
    pub outputs: Vec<f32>,
    /// Weighted negative log-likelihood of the window without its constant, in nats.
    pub loss: f64,
    /// Gradients of that loss by the parameters, in the order of [`index`].
    pub gradients: Vec<Vec<f32>>,
    tapes: [LayerTape; 2],
    /// Gradient of the loss by the outputs.
    output_gradient: Vec<f32>,
    /// The same by the states of the first and of the second layer.
    state_gradients: [Vec<f32>; 2],
}

impl StreamPass {
    /// From the reset state, in windows of `rows` rows.
    pub fn new(parameters: &TrainableParameters, rows: usize) -> Self {
        let size = parameters.size;
        let states = vec![0.0; rows * size.hidden];
        let outputs = vec![0.0; rows * size.outputs];
        Self {
            rows: StreamRows::default(),
            output_gradient: outputs.clone(),
            outputs,
            loss: 0.0,
            gradients: parameters.all.iter().map(|tensor| vec![0.0; tensor.each()]).collect(),
            tapes: [0, 1].map(|_| LayerTape::new(size.hidden, rows)),
            state_gradients: [states.clone(), states],
        }
    }

    /// Outputs of [`StreamPass::rows`]; the next window continues from the last state.
    pub fn predict(&mut self, weights: &NetworkWeights) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has these instructions.
            return unsafe { self.predict_avx2(weights) };
        }
        self.predict_portable(weights);
    }

    /// Outputs, loss and gradients of [`StreamPass::rows`]; the next window continues from the last state.
    pub fn train(&mut self, weights: &NetworkWeights) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has these instructions.
            return unsafe { self.train_avx2(weights) };
        }
        self.train_portable(weights);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn predict_avx2(&mut self, weights: &NetworkWeights) {
        self.predict_portable(weights);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn train_avx2(&mut self, weights: &NetworkWeights) {
        self.train_portable(weights);
    }

    #[inline(always)]
    fn predict_portable(&mut self, weights: &NetworkWeights) {
        self.forward(weights);
        self.tapes.iter_mut().for_each(LayerTape::carry_state);
    }

    #[inline(always)]
    fn train_portable(&mut self, weights: &NetworkWeights) {
        self.forward(weights);
        self.differentiate_loss(weights.head_bias.len());
        if self.rows.weight.iter().any(|weight| *weight > 0.0) {
            self.backward(weights);
        } else {
            self.gradients.iter_mut().for_each(|gradient| gradient.fill(0.0));
        }
        self.tapes.iter_mut().for_each(LayerTape::carry_state);
    }

    #[inline(always)]
    fn forward(&mut self, weights: &NetworkWeights) {
        let [first, second] = &mut self.tapes;
        first.forward(weights.layers[0], &self.rows.inputs);
        second.forward(weights.layers[1], first.states());
        let outputs = weights.head_bias.len();
        let hidden = weights.head.len() / outputs;
        let rows = self.outputs.chunks_exact_mut(outputs);
        for (row, state) in rows.zip(second.states().chunks_exact(hidden)) {
            weighted_sums(row, weights.head_bias, state, weights.head);
        }
    }

    /// The loss, and its gradient by the outputs.
    #[inline(always)]
    fn differentiate_loss(&mut self, outputs: usize) {
        self.loss = 0.0;
        self.output_gradient.fill(0.0);
        let forces = outputs / 2;
        let rows = self.outputs.chunks_exact(outputs);
        let rows = rows.zip(self.output_gradient.chunks_exact_mut(outputs));
        let known = self.rows.truth.chunks_exact(forces).zip(self.rows.weight.chunks_exact(forces));
        for ((outputs, gradient), (truth, weight)) in rows.zip(known) {
            for (force, (truth, &weight)) in truth.iter().zip(weight).enumerate() {
                if weight == 0.0 {
                    continue;
                }
                let mean = mean_output(force);
                let raw = outputs[mean + 2];
                let log_sigma = raw.clamp(MIN_LOG_SIGMA, MAX_LOG_SIGMA);
                let precision = exp(-log_sigma);
                let share = (outputs[mean] - truth) * precision;
                self.loss += f64::from(weight * (0.5 * share * share + log_sigma));
                gradient[mean] = weight * share * precision;
                if raw == log_sigma {
                    gradient[mean + 2] = weight * (1.0 - share * share);
                }
            }
        }
    }

    #[inline(always)]
    fn backward(&mut self, weights: &NetworkWeights) {
        let [first, second] = &mut self.tapes;
        let [by_first, by_second] = &mut self.state_gradients;
        let outputs = weights.head_bias.len();
        let hidden = weights.head.len() / outputs;
        let zero = vec![0.0; hidden];
        let gradients = self.output_gradient.chunks_exact(outputs);
        for (by_state, gradient) in by_second.chunks_exact_mut(hidden).zip(gradients.clone()) {
            weighted_sums(by_state, &zero, gradient, &weights.transposed_head);
        }
        let [input_1, state_1, bias_1, input_2, state_2, bias_2, head, head_bias] =
            &mut self.gradients[..]
        else {
            return;
        };
        outer_products(head, second.states(), (&self.output_gradient, outputs));
        head_bias.fill(0.0);
        gradients.for_each(|gradient| add_scaled(head_bias, 1.0, gradient));
        let into = LayerGradients { input: input_2, state: state_2, bias: bias_2 };
        second.backward(&weights.transposed_states[1], first.states(), by_second, into);
        second.input_gradient(&weights.transposed_input, by_first);
        let into = LayerGradients { input: input_1, state: state_1, bias: bias_1 };
        first.backward(&weights.transposed_states[0], &self.rows.inputs, by_first, into);
    }
}

/// Place of a force's mean in the outputs; the logarithm of its standard deviation is two after it.
pub fn mean_output(force: usize) -> usize {
    force / 2 * 4 + force % 2
}
