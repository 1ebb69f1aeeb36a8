//! A file of trained networks: their weights, and where they come from.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::network::{GATES, Layer, Network, OUTPUTS, ScaledInput, Target};
use super::tensors::{self, Array, Arrays, Kind};
use super::train::course::{Best, Settings};
use super::train::lesson::Topology;
use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// Version of the file.
pub const FORMAT: u32 = 1;

/// Trained networks of one gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkFile {
    /// Where they come from.
    pub provenance: Provenance,
    /// One for each sensor, or one for all.
    pub networks: Vec<Network>,
}

/// Where networks come from. No time and no path: the same training gives the same bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the tool.
    pub tool: String,
    /// SHA-256 of the model file whose compensation the fields went through.
    pub model_sha256: String,
    /// Name of the campaign's folder.
    pub campaign: String,
    /// Its recordings.
    pub recordings: Vec<Recorded>,
    /// Delay of the reference that was assumed, in milliseconds.
    pub delay_ms: f64,
    /// What the networks see and tell.
    pub topology: Topology,
    /// How the training went.
    pub settings: Settings,
    /// Where the weights of each network were found, with their losses.
    pub found: Vec<Best>,
}

/// A recording that networks were trained with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recorded {
    /// Name of its folder.
    pub name: String,
    /// SHA-256 over its files.
    pub sha256: String,
    /// True for the one that was not learned from: the weights were chosen by it.
    pub held_out: bool,
}

/// The description in the file.
#[derive(Serialize, Deserialize)]
struct Description {
    format: u32,
    provenance: Provenance,
    networks: Vec<Scales>,
}

/// All of a network but its weights.
#[derive(Serialize, Deserialize)]
struct Scales {
    sensors: Vec<u32>,
    inputs: Vec<ScaledInput>,
    target: Target,
    hidden: usize,
    force_n: [f64; 2],
}

impl NetworkFile {
    /// Writes the file, whole or not at all.
    pub fn write(&self, path: &Path) -> Result<(), Problem> {
        let arrays: Vec<Array> = self
            .networks
            .iter()
            .enumerate()
            .flat_map(|(number, network)| arrays(number, network))
            .collect();
        let description = Description {
            format: FORMAT,
            provenance: self.provenance.clone(),
            networks: self.networks.iter().map(Scales::of).collect(),
        };
        tensors::write(path, Kind::Network, &description, &arrays)
    }

    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        let (description, mut arrays): (Description, _) = tensors::read(path, Kind::Network)?;
        if description.format != FORMAT {
            let found = format!("format {}", description.format);
            let advice = format!("this version reads format {FORMAT}: train again");
            return Err(Fault::BadValue { found, advice }.at(Place::file(path)));
        }
        let networks = description.networks.into_iter().enumerate();
        Ok(Self {
            provenance: description.provenance,
            networks: networks
                .map(|(number, scales)| scales.with(number, &mut arrays))
                .collect::<Result<_, _>>()?,
        })
    }
}

/// Shapes of a layer's arrays, by name.
fn layer_shapes(inputs: usize, hidden: usize) -> [(&'static str, Vec<usize>); 4] {
    let rows = GATES * hidden;
    [
        ("input_weights", vec![rows, inputs]),
        ("state_weights", vec![rows, hidden]),
        ("input_bias", vec![rows]),
        ("state_bias", vec![rows]),
    ]
}

fn arrays(number: usize, network: &Network) -> Vec<Array> {
    let array = |name: &str, shape: Vec<usize>, values: &[f32]| Array {
        name: format!("network{number}.{name}"),
        shape,
        values: values.to_vec(),
    };
    let widths = [network.inputs.len(), network.hidden];
    let mut arrays = Vec::new();
    for (i, (layer, width)) in network.layers.iter().zip(widths).enumerate() {
        let all = [
            &layer.input_weights,
            &layer.state_weights,
            &layer.input_bias,
            &layer.state_bias,
        ];
        for ((name, shape), values) in layer_shapes(width, network.hidden).into_iter().zip(all) {
            arrays.push(array(&format!("layer{}.{name}", i + 1), shape, values));
        }
    }
    let outputs = OUTPUTS * network.sensors.len();
    let shape = vec![outputs, network.hidden];
    arrays.push(array("head.weights", shape, &network.head_weights));
    arrays.push(array("head.bias", vec![outputs], &network.head_bias));
    arrays
}

impl Scales {
    fn of(network: &Network) -> Self {
        Self {
            sensors: network.sensors.clone(),
            inputs: network.inputs.clone(),
            target: network.target,
            hidden: network.hidden,
            force_n: network.force_n,
        }
    }

    fn with(self, number: usize, arrays: &mut Arrays) -> Result<Network, Problem> {
        let mut take = |name: String, shape: &[usize]| {
            arrays.take(&format!("network{number}.{name}"), shape)
        };
        let mut layer = |i: usize, width: usize| {
            let [input, state, input_bias, state_bias] = layer_shapes(width, self.hidden)
                .map(|(name, shape)| take(format!("layer{i}.{name}"), &shape));
            Ok(Layer {
                input_weights: input?,
                state_weights: state?,
                input_bias: input_bias?,
                state_bias: state_bias?,
            })
        };
        let layers = [layer(1, self.inputs.len())?, layer(2, self.hidden)?];
        let outputs = OUTPUTS * self.sensors.len();
        Ok(Network {
            head_weights: take("head.weights".to_owned(), &[outputs, self.hidden])?,
            head_bias: take("head.bias".to_owned(), &[outputs])?,
            layers,
            sensors: self.sensors,
            inputs: self.inputs,
            target: self.target,
            hidden: self.hidden,
            force_n: self.force_n,
        })
    }
}
