//! Training checkpoint, from which training resumes with identical results.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::ErrorKind;
use crate::gru::tensors::{self, NamedTensor, TensorFile, TensorFileKind};
use crate::gru::train::dataset::Topology;
use crate::gru::train::parameters::TrainableParameters;
use crate::gru::train::trainer::{BestEpoch, Trainer, TrainingSettings};
use crate::output::Output;
use crate::recordings::{DataError, Location};

/// Identity of the training, which must match on resume, and its progress.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Description {
    /// Version of the tool.
    tool: String,
    /// Hashes of the training data.
    inputs: String,
    settings: TrainingSettings,
    topology: Topology,
    epoch: u32,
    steps: u32,
    found: Vec<BestEpoch>,
}

impl Description {
    fn of(trainer: &Trainer, inputs: &str) -> Self {
        Self {
            tool: env!("CARGO_PKG_VERSION").to_owned(),
            inputs: inputs.to_owned(),
            settings: trainer.settings.clone(),
            topology: trainer.topology.clone(),
            epoch: trainer.epoch,
            steps: trainer.adam.steps,
            found: trainer.found.clone(),
        }
    }

    /// Difference to another training, for messages.
    fn difference(&self, other: &Self) -> Option<&'static str> {
        if self.tool != other.tool {
            Some("another version of the tool")
        } else if self.inputs != other.inputs {
            Some("another model, other recordings or another --delay-ms")
        } else if self.topology != other.topology {
            Some("other networks (--axes, --inputs, --target, --hidden, --shared)")
        } else if self.settings != other.settings {
            Some("another --seed, --epochs, --patience, --rate or --zero-weight")
        } else {
            None
        }
    }
}

/// The four parameter sets of a training, by name.
fn parts(trainer: &Trainer) -> [(&'static str, &TrainableParameters); 4] {
    [
        ("now", &trainer.parameters),
        ("best", &trainer.best),
        ("slope", &trainer.adam.first),
        ("squares", &trainer.adam.second),
    ]
}

/// Writes the training atomically. `inputs` identifies the training data.
pub fn write(output: &Output, trainer: &Trainer, inputs: &str) -> Result<(), DataError> {
    let arrays: Vec<NamedTensor> = parts(trainer)
        .iter()
        .flat_map(|(part, parameters)| {
            parameters.all.iter().map(move |parameter| NamedTensor {
                name: format!("{part}.{}", parameter.name),
                shape: parameter.shape.clone(),
                values: parameter.values.clone(),
            })
        })
        .collect();
    tensors::write(output, TensorFileKind::Checkpoint, &Description::of(trainer, inputs), &arrays)
}

/// Restores a checkpoint into a new training.
pub fn resume(path: &Path, trainer: &mut Trainer, inputs: &str) -> Result<(), DataError> {
    let (found, mut arrays): (Description, _) = tensors::read(path, TensorFileKind::Checkpoint)?;
    if let Some(difference) = found.difference(&Description::of(trainer, inputs)) {
        let found = format!("resuming a training with {difference}");
        let advice = "use the same arguments as before, or start again without --resume".to_owned();
        return Err(ErrorKind::BadValue { found, advice }.at(Location::file(path)));
    }
    fill(&mut trainer.parameters, "now", &mut arrays)?;
    fill(&mut trainer.best, "best", &mut arrays)?;
    fill(&mut trainer.adam.first, "slope", &mut arrays)?;
    fill(&mut trainer.adam.second, "squares", &mut arrays)?;
    trainer.epoch = found.epoch;
    trainer.adam.steps = found.steps;
    trainer.found = found.found;
    Ok(())
}

fn fill(
    parameters: &mut TrainableParameters,
    part: &str,
    arrays: &mut TensorFile,
) -> Result<(), DataError> {
    for parameter in &mut parameters.all {
        let name = format!("{part}.{}", parameter.name);
        parameter.values = arrays.take(&name, &parameter.shape)?;
    }
    Ok(())
}
