//! The networks over a window of rows, and the loss of what they say.

use std::sync::OnceLock;

use candle_core::{Device, Result, Tensor, Var};

use super::parameters::{Parameters, Size, place};
use super::recurrence::Recurrence;

/// Least logarithm of a standard deviation that the loss knows, in shares of the scale of the forces:
/// below a two thousandth of it noise is all there is, and the slope of the loss would be all about
/// single rows.
pub const LEAST_LOG_SIGMA: f64 = -7.6;
/// Greatest: beyond twice the scale nothing is told any more.
pub const GREATEST_LOG_SIGMA: f64 = 0.7;

/// The parameters as the library's variables, for one pass.
pub struct Weights {
    /// In the order of [`place`].
    pub all: Vec<Var>,
    size: Size,
}

/// The state of both layers, each `networks x streams x hidden`.
#[derive(Clone, Debug, PartialEq)]
pub struct State(pub [Vec<f32>; 2]);

impl State {
    /// As the device begins.
    pub fn zero(size: Size, streams: usize) -> Self {
        let zero = vec![0.0; size.networks * streams * size.hidden];
        Self([zero.clone(), zero])
    }
}

impl Weights {
    /// Copies the parameters.
    pub fn of(parameters: &Parameters) -> Result<Self> {
        let all = parameters
            .all
            .iter()
            .map(|p| Var::from_slice(&p.values, p.shape.as_slice(), &Device::Cpu));
        Ok(Self {
            all: all.collect::<Result<_>>()?,
            size: parameters.size,
        })
    }

    /// Outputs, `networks x streams*rows x outputs`, for inputs `networks x streams*rows x inputs`;
    /// the state goes on.
    pub fn forward(&self, inputs: &Tensor, streams: usize, state: &mut State) -> Result<Tensor> {
        let Size {
            networks, hidden, ..
        } = self.size;
        let rows = inputs.dim(1)? / streams;
        let mut flow = inputs.clone();
        for (parameters, state) in place::LAYERS.iter().zip(&mut state.0) {
            let [input, recurrent, bias] = parameters.map(|i| self.all[i].as_tensor());
            let operation = Recurrence {
                hidden,
                streams,
                rows,
                start: std::mem::take(state),
                kept: OnceLock::new(),
            };
            let states = flow.matmul(input)?.apply_op3(recurrent, bias, operation)?;
            *state = states
                .narrow(2, rows - 1, 1)?
                .flatten_all()?
                .to_vec1::<f32>()?;
            flow = states.reshape((networks, streams * rows, hidden))?;
        }
        flow.matmul(self.all[place::HEAD_WEIGHTS].as_tensor())?
            .broadcast_add(self.all[place::HEAD_BIAS].as_tensor())
    }
}

/// Sum of the negative logarithm of the likelihood of each network, without its constant, in nats:
/// one number for each. Outputs hold, sensor by sensor, two means and two logarithms of the standard
/// deviation; `truth` and `weight` two forces for each sensor, the weight zero where there is none.
pub fn losses(outputs: &Tensor, truth: &Tensor, weight: &Tensor) -> Result<Tensor> {
    let (networks, rows, forces) = truth.dims3()?;
    let split = outputs.reshape((networks, rows, forces / 2, 4))?;
    let half = |from: usize| {
        split
            .narrow(3, from, 2)?
            .contiguous()?
            .reshape((networks, rows, forces))
    };
    let log_sigma = half(2)?.clamp(LEAST_LOG_SIGMA, GREATEST_LOG_SIGMA)?;
    let share = ((half(0)? - truth)? * log_sigma.neg()?.exp()?)?;
    let each = ((share.sqr()? * 0.5)? + log_sigma)?;
    (each * weight)?.sum((1, 2))
}
