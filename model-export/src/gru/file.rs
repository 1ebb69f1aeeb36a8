//! Network file: weights, scaling and provenance.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::error::ErrorKind;
use crate::gru::network::{GATES, Layer, Network, OUTPUTS, ScaledInput, Target, TrainedRange};
use crate::gru::tensors::{self, NamedTensor, TensorFile, TensorFileKind};
use crate::gru::train::dataset::Topology;
use crate::gru::train::trainer::{BestEpoch, TrainingSettings};
use crate::input::MAX_HIDDEN;
use crate::output::Output;
use crate::recordings::recording::hex;
use crate::recordings::{DataError, Location};

/// Version of the format.
pub const FORMAT: u32 = 1;

/// Trained networks of one gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkFile {
    /// Provenance.
    pub provenance: NetworkProvenance,
    /// One for each sensor, or one for all.
    pub networks: Vec<Network>,
}

/// Provenance of networks, without time and path: the same training gives the same bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NetworkProvenance {
    /// Version of the tool.
    pub tool: String,
    /// SHA-256 of the model file that compensated the fields.
    pub model_sha256: String,
    /// Name of the campaign's folder.
    pub campaign: String,
    /// Recordings.
    pub recordings: Vec<TrainingRecording>,
    /// Assumed delay of the reference in milliseconds.
    pub delay_ms: f64,
    /// Inputs and outputs of the networks.
    pub topology: Topology,
    /// Training settings.
    pub settings: TrainingSettings,
    /// Best epoch of each network, with its losses.
    pub found: Vec<BestEpoch>,
}

/// A recording of the training or validation set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecording {
    /// Name of the folder.
    pub name: String,
    /// SHA-256 over the files.
    pub sha256: String,
    /// Whether it is the validation recording for early stopping.
    pub held_out: bool,
}

#[derive(Serialize, Deserialize)]
struct Description {
    format: u32,
    provenance: NetworkProvenance,
    networks: Vec<Scales>,
}

/// A network without weights.
#[derive(Serialize, Deserialize)]
struct Scales {
    sensors: Vec<u32>,
    inputs: Vec<ScaledInput>,
    target: Target,
    hidden: usize,
    force_n: [f64; 2],
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    guards: Vec<TrainedRange>,
}

/// SHA-256 over the weights of networks alone.
pub fn fingerprint(networks: &[Network]) -> String {
    let mut hash = Sha256::new();
    for array in networks.iter().flat_map(|network| arrays(0, network)) {
        let bytes = array.values.iter().flat_map(|value| value.to_le_bytes());
        hash.update(bytes.collect::<Vec<u8>>());
    }
    hex(&hash.finalize())
}

impl NetworkFile {
    /// Writes the file, whole or not at all.
    pub fn write(&self, output: &Output) -> Result<(), DataError> {
        let arrays: Vec<NamedTensor> = self
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
        tensors::write(output, TensorFileKind::Network, &description, &arrays)
    }

    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let (description, mut arrays): (Description, _) =
            tensors::read(path, TensorFileKind::Network)?;
        if description.format != FORMAT {
            let found = format!("format {}", description.format);
            let advice = format!("this version reads format {FORMAT}: train again");
            return Err(ErrorKind::BadValue { found, advice }.at(Location::file(path)));
        }
        if let Some(large) = description.networks.iter().find(|scales| scales.hidden > MAX_HIDDEN) {
            let found = format!("a layer of {} units", large.hidden);
            let advice = format!("the limit is {MAX_HIDDEN}: train again");
            return Err(ErrorKind::BadValue { found, advice }.at(Location::file(path)));
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

fn arrays(number: usize, network: &Network) -> Vec<NamedTensor> {
    let array = |name: &str, shape: Vec<usize>, values: &[f32]| NamedTensor {
        name: format!("network{number}.{name}"),
        shape,
        values: values.to_vec(),
    };
    let widths = [network.inputs.len(), network.hidden];
    let mut arrays = Vec::new();
    for (i, (layer, width)) in network.layers.iter().zip(widths).enumerate() {
        let all =
            [&layer.input_weights, &layer.state_weights, &layer.input_bias, &layer.state_bias];
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
            guards: network.guards.clone(),
        }
    }

    fn with(self, number: usize, arrays: &mut TensorFile) -> Result<Network, DataError> {
        let mut take =
            |name: String, shape: &[usize]| arrays.take(&format!("network{number}.{name}"), shape);
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
            guards: self.guards,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::network::Input;
    use super::*;
    use crate::output::Overwrite;

    fn network(hidden: usize, inputs: usize) -> Network {
        let values = |count: usize| (0..count).map(|i| 0.1 * i as f32 - 0.7).collect::<Vec<_>>();
        let layer = |width: usize| Layer {
            input_weights: values(GATES * hidden * width),
            state_weights: values(GATES * hidden * hidden),
            input_bias: values(GATES * hidden),
            state_bias: values(GATES * hidden),
        };
        let input = |axis| ScaledInput {
            input: Input::Field { sensor: 2, axis },
            middle: 0.1 + 0.2,
            span: 1.0 / 3.0,
        };
        Network {
            sensors: vec![2],
            inputs: (0..inputs).map(input).collect(),
            target: Target::Residual,
            hidden,
            layers: [layer(inputs), layer(hidden)],
            head_weights: values(OUTPUTS * hidden),
            head_bias: values(OUTPUTS),
            force_n: [1e2 / 3.0, 2e2 / 7.0],
            guards: vec![TrainedRange {
                parity_residual_g: [-0.1, 0.3],
                newtons_per_g: [0.85, 1.37],
                disagreement_n: [1.1, 2.2],
            }],
        }
    }

    fn file() -> NetworkFile {
        NetworkFile {
            provenance: NetworkProvenance {
                tool: "magpie".to_owned(),
                model_sha256: "ab".to_owned(),
                campaign: "bench".to_owned(),
                recordings: Vec::new(),
                delay_ms: 0.1,
                topology: Topology {
                    axes: vec![0, 2],
                    ideal: false,
                    target: Target::Residual,
                    shared: false,
                    hidden: 2,
                },
                settings: TrainingSettings {
                    seed: 1,
                    epochs: 2,
                    patience: 3,
                    rate: 0.1,
                    near_zero: 1.0,
                    force_range_n: 250.0,
                },
                found: Vec::new(),
            },
            networks: vec![network(2, 3), network(2, 3)],
        }
    }

    fn output(path: &Path) -> Result<Output, DataError> {
        Output::check(path, TensorFileKind::Network.mark(), Vec::new(), Overwrite::NEVER)
    }

    fn refused(path: &Path) -> String {
        NetworkFile::read(path).unwrap_err().to_string()
    }

    #[test]
    fn network_file_round_trips_and_may_be_overwritten() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network");
        file().write(&output(&path).unwrap()).unwrap();
        let first = std::fs::read(&path).unwrap();
        assert_eq!(NetworkFile::read(&path).unwrap(), file());
        file().write(&output(&path).unwrap()).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), first);
    }

    #[test]
    fn array_of_wrong_shape_is_rejected_by_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network");
        let arrays: Vec<NamedTensor> = arrays(0, &network(3, 3));
        let description = Description {
            format: FORMAT,
            provenance: file().provenance,
            networks: vec![Scales::of(&network(2, 3))],
        };
        tensors::write(&output(&path).unwrap(), TensorFileKind::Network, &description, &arrays)
            .unwrap();
        let message = refused(&path);
        assert!(message.contains(": network0.layer1.input_weights has the shape"), "{message}");
        assert!(message.contains("[9, 3] where [6, 3] is expected"), "{message}");
    }

    #[test]
    fn missing_and_non_finite_arrays_are_rejected_by_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network");
        let description = || Description {
            format: FORMAT,
            provenance: file().provenance,
            networks: vec![Scales::of(&network(2, 3))],
        };
        let mut all = arrays(0, &network(2, 3));
        all.retain(|array| array.name != "network0.head.bias");
        tensors::write(&output(&path).unwrap(), TensorFileKind::Network, &description(), &all)
            .unwrap();
        assert!(refused(&path).contains("network0.head.bias is missing"));
        let mut all = arrays(0, &network(2, 3));
        all[5].values[1] = f32::NAN;
        tensors::write(&output(&path).unwrap(), TensorFileKind::Network, &description(), &all)
            .unwrap();
        assert!(
            refused(&path)
                .contains("network0.layer2.state_weights contains a number that is not finite")
        );
    }

    #[test]
    fn foreign_files_are_neither_read_nor_overwritten() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network");
        let text = "# my notes, which are long enough to hold whatever mark there is in our files";
        std::fs::write(&path, text).unwrap();
        assert!(refused(&path).contains("this is not a network"));
        assert!(output(&path).unwrap_err().to_string().contains("not overwritten"));
        // Safetensors of other origin.
        let foreign = br#"{"__metadata__":{"format":"pt"}}"#;
        let mut bytes = (foreign.len() as u64).to_le_bytes().to_vec();
        bytes.extend(foreign);
        std::fs::write(&path, &bytes).unwrap();
        assert!(refused(&path).contains("this is not a network"));
        assert!(output(&path).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn number_of_units_is_limited() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network.safetensors");
        for (hidden, words) in
            [(MAX_HIDDEN + 1, "the limit is 1024"), (MAX_HIDDEN, "has the shape")]
        {
            let mut one = file();
            one.networks.iter_mut().for_each(|network| network.hidden = hidden);
            let scales = one.networks.iter().map(Scales::of).collect();
            let description = Description {
                format: FORMAT,
                provenance: one.provenance.clone(),
                networks: scales,
            };
            let arrays = arrays(0, &network(2, 3));
            tensors::write(&output(&path).unwrap(), TensorFileKind::Network, &description, &arrays)
                .unwrap();
            assert!(refused(&path).contains(words), "{}", refused(&path));
        }
    }

    #[test]
    fn truncated_file_is_reported_as_damaged() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("network");
        file().write(&output(&path).unwrap()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 40]).unwrap();
        assert!(refused(&path).contains("damaged"), "{}", refused(&path));
    }
}
