//! A training on disk, from which it goes on as if nothing had happened.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::course::{Best, Course, Settings};
use super::lesson::Topology;
use super::parameters::Parameters;
use crate::gru::tensors::{self, Array, Arrays, Kind};
use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// What a checkpoint must agree in with the training that resumes it, and how far it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Description {
    /// Version of the tool: another may train otherwise.
    tool: String,
    /// Hashes of everything that is learned from.
    inputs: String,
    settings: Settings,
    topology: Topology,
    epoch: u32,
    steps: u32,
    found: Vec<Best>,
}

impl Description {
    fn of(course: &Course, inputs: &str) -> Self {
        Self {
            tool: env!("CARGO_PKG_VERSION").to_owned(),
            inputs: inputs.to_owned(),
            settings: course.settings.clone(),
            topology: course.topology.clone(),
            epoch: course.epoch,
            steps: course.adam.steps,
            found: course.found.clone(),
        }
    }

    /// What it is about, as a person would name it, where it is not the same.
    fn difference(&self, other: &Self) -> Option<&'static str> {
        if self.tool != other.tool {
            Some("another version of the tool")
        } else if self.inputs != other.inputs {
            Some("another model, other recordings or another --delay-ms")
        } else if self.topology != other.topology {
            Some("other networks (--axes, --inputs, --target, --hidden, --shared)")
        } else if self.settings != other.settings {
            Some("another --seed, --epochs, --patience, --rate or --near-zero")
        } else {
            None
        }
    }
}

/// The four sets of numbers that a training is made of, each under its name.
fn parts(course: &Course) -> [(&'static str, &Parameters); 4] {
    [
        ("now", &course.parameters),
        ("best", &course.best),
        ("slope", &course.adam.first),
        ("squares", &course.adam.second),
    ]
}

/// Writes the training as it is now, whole or not at all. `inputs` tells what is learned from: the
/// same text, the same data.
pub fn write(path: &Path, course: &Course, inputs: &str) -> Result<(), Problem> {
    let arrays: Vec<Array> = parts(course)
        .iter()
        .flat_map(|(part, parameters)| {
            parameters.all.iter().map(move |parameter| Array {
                name: format!("{part}.{}", parameter.name),
                shape: parameter.shape.clone(),
                values: parameter.values.clone(),
            })
        })
        .collect();
    tensors::write(
        path,
        Kind::Checkpoint,
        &Description::of(course, inputs),
        &arrays,
    )
}

/// Brings a training that has not begun to where the checkpoint is.
pub fn resume(path: &Path, course: &mut Course, inputs: &str) -> Result<(), Problem> {
    let (found, mut arrays): (Description, _) = tensors::read(path, Kind::Checkpoint)?;
    if let Some(difference) = found.difference(&Description::of(course, inputs)) {
        let found = format!("resuming a training with {difference}");
        let advice = "give the same arguments as before, or begin anew without --resume".to_owned();
        return Err(Fault::BadValue { found, advice }.at(Place::file(path)));
    }
    fill(&mut course.parameters, "now", &mut arrays)?;
    fill(&mut course.best, "best", &mut arrays)?;
    fill(&mut course.adam.first, "slope", &mut arrays)?;
    fill(&mut course.adam.second, "squares", &mut arrays)?;
    course.epoch = found.epoch;
    course.adam.steps = found.steps;
    course.found = found.found;
    Ok(())
}

fn fill(parameters: &mut Parameters, part: &str, arrays: &mut Arrays) -> Result<(), Problem> {
    for parameter in &mut parameters.all {
        let name = format!("{part}.{}", parameter.name);
        parameter.values = arrays.take(&name, &parameter.shape)?;
    }
    Ok(())
}
