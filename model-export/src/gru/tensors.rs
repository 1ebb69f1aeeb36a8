//! Named arrays of numbers with a description, in one file of safetensors.
//!
//! Such a file begins with the length of its header, then the header, a JSON object whose first entry
//! is the description. So what tells our files from others stands eight bytes in.

use std::collections::HashMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::output::{Mark, write_output};
use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// Bytes of a file before its header.
const LENGTH_BYTES: usize = 8;

/// One array.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Its name.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values, the last dimension fastest.
    pub values: Vec<f32>,
}

/// What kind of file it is: the words under which the description stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Trained networks.
    Network,
    /// A training that goes on later.
    Checkpoint,
}

impl Kind {
    fn key(self) -> &'static str {
        match self {
            Self::Network => "magpie network",
            Self::Checkpoint => "magpie training",
        }
    }

    /// What every file of this kind begins with, behind its length.
    pub fn mark(self) -> Mark<'static> {
        Mark {
            after: LENGTH_BYTES,
            text: match self {
                Self::Network => r#"{"__metadata__":{"magpie network":"#,
                Self::Checkpoint => r#"{"__metadata__":{"magpie training":"#,
            },
        }
    }
}

/// Writes a file, whole or not at all; the same arrays and description give the same bytes.
pub fn write(
    path: &Path,
    kind: Kind,
    description: &impl Serialize,
    arrays: &[Array],
) -> Result<(), Problem> {
    write_output(path, &bytes(kind, description, arrays, path)?, kind.mark())
}

fn bytes(
    kind: Kind,
    description: &impl Serialize,
    arrays: &[Array],
    path: &Path,
) -> Result<Vec<u8>, Problem> {
    let broken = |error: String| Fault::Toml(error).at(Place::file(path));
    let text = serde_json::to_string(description).map_err(|error| broken(error.to_string()))?;
    let data: Vec<Vec<u8>> = arrays
        .iter()
        .map(|array| array.values.iter().flat_map(|v| v.to_le_bytes()).collect())
        .collect();
    let views = arrays.iter().zip(&data).map(|(array, data)| {
        TensorView::new(Dtype::F32, array.shape.clone(), data).map(|view| (&array.name, view))
    });
    let views = views
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| broken(error.to_string()))?;
    // A single entry: several would stand in any order.
    let metadata = HashMap::from([(kind.key().to_owned(), text)]);
    serialize(views, Some(metadata)).map_err(|error| broken(error.to_string()))
}

/// A file that was read.
pub struct Arrays {
    path: std::path::PathBuf,
    arrays: HashMap<String, Array>,
}

/// Reads a file: its description, and its arrays.
pub fn read<D: DeserializeOwned>(path: &Path, kind: Kind) -> Result<(D, Arrays), Problem> {
    let at = |fault: Fault| fault.at(Place::file(path));
    if path.is_dir() {
        return Err(at(foreign(kind)));
    }
    let bytes = std::fs::read(path).map_err(|error| at(Fault::Unreadable(error)))?;
    let mark = kind.mark();
    let ours = bytes
        .get(mark.after..)
        .is_some_and(|rest| rest.starts_with(mark.text.as_bytes()));
    if !ours {
        return Err(at(foreign(kind)));
    }
    let damaged = |error: String| at(Fault::DamagedArrays(error));
    let (_, header) =
        SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
    let text = header
        .metadata()
        .as_ref()
        .and_then(|metadata| metadata.get(kind.key()))
        .ok_or_else(|| at(foreign(kind)))?;
    let description = serde_json::from_str(text).map_err(|error| damaged(error.to_string()))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
    let mut arrays = HashMap::new();
    for (name, view) in tensors.tensors() {
        if view.dtype() != Dtype::F32 {
            let found = format!("{name} holds {:?}", view.dtype());
            let advice = "numbers of 32 bits (F32) are expected".to_owned();
            return Err(at(Fault::BadValue { found, advice }));
        }
        let (words, _) = view.data().as_chunks::<4>();
        let array = Array {
            name: name.clone(),
            shape: view.shape().to_vec(),
            values: words.iter().map(|word| f32::from_le_bytes(*word)).collect(),
        };
        arrays.insert(name, array);
    }
    let path = path.to_path_buf();
    Ok((description, Arrays { path, arrays }))
}

fn foreign(kind: Kind) -> Fault {
    match kind {
        Kind::Network => Fault::ForeignNetwork,
        Kind::Checkpoint => Fault::ForeignCheckpoint,
    }
}

impl Arrays {
    /// Takes the array of this name, which must have this shape and finite values.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, Problem> {
        let at = |fault: Fault| fault.at(Place::file(&self.path));
        let name = name.to_owned();
        let Some(array) = self.arrays.remove(&name) else {
            return Err(at(Fault::MissingArray { name }));
        };
        if array.shape != shape {
            return Err(at(Fault::ArrayShape {
                name,
                found: array.shape,
                expected: shape.to_vec(),
            }));
        }
        if array.values.iter().any(|value| !value.is_finite()) {
            return Err(at(Fault::ArrayNotFinite { name }));
        }
        Ok(array.values)
    }
}
