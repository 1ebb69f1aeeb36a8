//! Training data: recordings as the device measures them, and their scaling.

use std::ops::Range;

use crate::gru::network::{Input, ScaledInput, Target};
use crate::gru::train::TrainError;
use crate::gru::train::backprop::StreamRows;

/// One sensor of one recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorSequence {
    /// Number of the sensor.
    pub number: u32,
    /// The compensated field of every row of the board, in G.
    pub field_g: Vec<[f32; 3]>,
    /// The ideal model's force of every row, Fx and Fz in N.
    pub ideal_n: Vec<[f32; 2]>,
    /// Rows with a reference force, Fx and Fz in N.
    pub truth_n: Vec<(usize, [f32; 2])>,
    /// Parity residual of the field of every row, in G.
    pub parity_residual_g: Vec<f32>,
}

/// One recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    /// Its name.
    pub name: String,
    /// Rows of the board, the same for every sensor.
    pub rows: usize,
    /// One for each sensor, the same in every recording.
    pub tracks: Vec<SensorSequence>,
}

/// Inputs and outputs of the networks.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Topology {
    /// Axes of the field, 0, 1, 2 for x, y, z.
    pub axes: Vec<usize>,
    /// Whether the ideal model's force is an input as well.
    pub ideal: bool,
    /// Target of the means.
    pub target: Target,
    /// One network for all sensors; else one for each.
    pub shared: bool,
    /// Units of a layer.
    pub hidden: usize,
}

impl Topology {
    /// Sensors of each network.
    pub fn groups(&self, sensors: &[u32]) -> Vec<Vec<u32>> {
        if self.shared {
            vec![sensors.to_vec()]
        } else {
            sensors.iter().map(|&sensor| vec![sensor]).collect()
        }
    }

    /// Inputs of a network for these sensors, in order.
    pub fn inputs(&self, sensors: &[u32]) -> Vec<Input> {
        let of_sensor = |&sensor: &u32| {
            let field = self.axes.iter().map(move |&axis| Input::Field { sensor, axis });
            let ideal = [0, 1].map(|axis| Input::Ideal { sensor, axis });
            field.chain(ideal.into_iter().filter(|_| self.ideal))
        };
        sensors.iter().flat_map(of_sensor).collect()
    }
}

impl Sequence {
    /// A range of rows as a recording of its own, without reference forces before row `known` of the whole.
    pub fn part(&self, rows: Range<usize>, known: usize) -> Self {
        let rows = rows.start.min(self.rows)..rows.end.min(self.rows);
        let track = |track: &SensorSequence| {
            let inside = |row: usize| rows.contains(&row) && row >= known;
            let truth = track.truth_n.iter().filter(|(row, _)| inside(*row));
            SensorSequence {
                number: track.number,
                field_g: track.field_g[rows.clone()].to_vec(),
                ideal_n: track.ideal_n[rows.clone()].to_vec(),
                truth_n: truth.map(|&(row, n)| (row - rows.start, n)).collect(),
                parity_residual_g: track
                    .parity_residual_g
                    .get(rows.clone())
                    .unwrap_or_default()
                    .to_vec(),
            }
        };
        Self {
            name: self.name.clone(),
            rows: rows.len(),
            tracks: self.tracks.iter().map(track).collect(),
        }
    }

    /// The data of a sensor.
    pub fn track(&self, number: u32) -> Option<&SensorSequence> {
        self.tracks.iter().find(|track| track.number == number)
    }

    /// The values of one input, row by row.
    fn values(&self, input: Input) -> Box<dyn Iterator<Item = f64> + '_> {
        match input {
            Input::Field { sensor, axis } => Box::new(
                self.track(sensor)
                    .into_iter()
                    .flat_map(move |track| track.field_g.iter().map(move |g| f64::from(g[axis]))),
            ),
            Input::Ideal { sensor, axis } => Box::new(
                self.track(sensor)
                    .into_iter()
                    .flat_map(move |track| track.ideal_n.iter().map(move |n| f64::from(n[axis]))),
            ),
        }
    }
}

impl SensorSequence {
    /// Target at each row with a reference force.
    pub fn targets(&self, target: Target) -> impl Iterator<Item = (usize, [f64; 2])> + '_ {
        self.truth_n.iter().map(move |&(row, truth)| {
            let ideal = self.ideal_n[row];
            let rest = |axis: usize| match target {
                Target::Force => f64::from(truth[axis]),
                Target::Residual => f64::from(truth[axis]) - f64::from(ideal[axis]),
            };
            (row, [rest(0), rest(1)])
        })
    }
}

/// Width of the extra weight around zero force, relative to the force range: the paper's networks have a larger
/// uncertainty than the ideal model there (25 N of 250).
pub const ZERO_FORCE_WIDTH: f64 = 0.1;

/// Weight of a row with reference force `truth_n`: `1 + (at_zero - 1) exp(-u^2/2)`, where `u` is the force
/// relative to [`ZERO_FORCE_WIDTH`] of the range. `at_zero` is the weight at zero force; one gives even
/// weights.
pub fn zero_force_weight(truth_n: f64, range_n: f64, at_zero: f64) -> f64 {
    let u = truth_n / (ZERO_FORCE_WIDTH * range_n);
    1.0 + (at_zero - 1.0) * libm::exp(-0.5 * u * u)
}

/// Scaling of inputs and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Inputs of each network.
    pub inputs: Vec<Vec<ScaledInput>>,
    /// Force of a unit output in newtons.
    pub force_n: [f64; 2],
}

impl Scaling {
    /// Scaling by the range of the training data.
    pub fn of(
        training_data: &[Sequence],
        topology: &Topology,
        groups: &[Vec<u32>],
    ) -> Result<Self, TrainError> {
        let scaled = |input: Input| {
            let values = training_data.iter().flat_map(|recording| recording.values(input));
            let ends = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), value| {
                (a.min(value), b.max(value))
            });
            let span = 0.5 * (ends.1 - ends.0);
            if !(span.is_finite() && span > 0.0) {
                return Err(TrainError::ConstantInput { input });
            }
            Ok(ScaledInput { input, middle: 0.5 * (ends.0 + ends.1), span })
        };
        let inputs = groups
            .iter()
            .map(|sensors| topology.inputs(sensors).into_iter().map(scaled).collect())
            .collect::<Result<Vec<Vec<ScaledInput>>, TrainError>>()?;
        let tracks = || training_data.iter().flat_map(|recording| &recording.tracks);
        let max_target = |axis: usize| {
            tracks()
                .flat_map(|track| track.targets(topology.target))
                .map(|(_, target)| target[axis].abs())
                .fold(0.0, f64::max)
        };
        let force_n = [max_target(0), max_target(1)];
        if force_n.iter().all(|n| n.is_finite() && *n > 0.0) {
            Ok(Self { inputs, force_n })
        } else {
            Err(TrainError::NoTruth)
        }
    }
}

/// One recording, scaled: network by network, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaledSequence {
    /// Rows of the board.
    pub rows: usize,
    /// Inputs of a row.
    pub inputs: usize,
    /// Forces of a row.
    pub forces: usize,
    /// `networks x rows x inputs`.
    pub x: Vec<f32>,
    /// `networks x rows x forces`; zero without a reference.
    pub y: Vec<f32>,
    /// The same: weight of the row, zero without a reference.
    pub weight: Vec<f32>,
}

impl ScaledSequence {
    /// Scales a recording; `counts` is the weight by the force in newtons, see [`zero_force_weight`].
    pub fn of(
        sequence: &Sequence,
        scaling: &Scaling,
        groups: &[Vec<u32>],
        target: Target,
        counts: impl Fn(f64) -> f64,
    ) -> Self {
        let (rows, inputs) = (sequence.rows, scaling.inputs[0].len());
        let forces = 2 * groups[0].len();
        let mut x = vec![0.0; groups.len() * rows * inputs];
        let mut y = vec![0.0; groups.len() * rows * forces];
        let mut weight = y.clone();
        for (network, (sensors, scales)) in groups.iter().zip(&scaling.inputs).enumerate() {
            for (i, scale) in scales.iter().enumerate() {
                for (row, value) in sequence.values(scale.input).enumerate() {
                    let scaled = (value - scale.middle) / scale.span;
                    x[(network * rows + row) * inputs + i] = scaled as f32;
                }
            }
            for (place, &sensor) in sensors.iter().enumerate() {
                let tracks = sequence.track(sensor).into_iter();
                let targets = tracks.flat_map(|track| track.targets(target).zip(&track.truth_n));
                for ((row, target), (_, truth_n)) in targets {
                    for axis in 0..2 {
                        let at = (network * rows + row) * forces + 2 * place + axis;
                        y[at] = (target[axis] / scaling.force_n[axis]) as f32;
                        weight[at] = counts(f64::from(truth_n[axis])) as f32;
                    }
                }
            }
        }
        Self { rows, inputs, forces, x, y, weight }
    }

    /// Replaces `into` by `length` rows of a network from `from` on. Rows after the end repeat the last one with zero weight; all
    /// weights are zero where `counts` is false.
    pub fn window(
        &self,
        network: usize,
        from: usize,
        length: usize,
        counts: bool,
        into: &mut StreamRows,
    ) {
        for list in [&mut into.inputs, &mut into.truth, &mut into.weight] {
            list.clear();
        }
        for row in from..from + length {
            let at = network * self.rows + row.min(self.rows - 1);
            let forces = at * self.forces..(at + 1) * self.forces;
            into.inputs.extend(&self.x[at * self.inputs..(at + 1) * self.inputs]);
            into.truth.extend(&self.y[forces.clone()]);
            if counts && row < self.rows {
                into.weight.extend(&self.weight[forces])
            } else {
                into.weight.extend(std::iter::repeat_n(0.0, self.forces))
            }
        }
    }
}
