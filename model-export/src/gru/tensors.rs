//! Named arrays of numbers with a description, in one file of safetensors.
//!
//! The file begins with the length of its header and the header, a JSON object whose first entry is the
//! description. The mark of our files is therefore eight bytes in.

use std::collections::HashMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::ErrorKind;
use crate::input;
use crate::output::{FileSignature, NamedInputs, Output};
use crate::recordings::{DataError, Location};

/// Bytes of a file before its header.
const LENGTH_BYTES: usize = 8;

/// One array.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTensor {
    /// Its name.
    pub name: String,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values, the last dimension fastest.
    pub values: Vec<f32>,
}

/// File kind, by the key of its description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorFileKind {
    /// Trained networks.
    Network,
    /// Training checkpoint.
    Checkpoint,
}

impl TensorFileKind {
    fn key(self) -> &'static str {
        match self {
            Self::Network => "magpie network",
            Self::Checkpoint => "magpie training",
        }
    }

    /// Start of every file of this kind, after its length.
    pub fn mark(self) -> FileSignature<'static> {
        FileSignature {
            offset: LENGTH_BYTES,
            text: match self {
                Self::Network => r#"{"__metadata__":{"magpie network":"#,
                Self::Checkpoint => r#"{"__metadata__":{"magpie training":"#,
            },
            inputs: NamedInputs::Content(match self {
                Self::Network => |bytes| {
                    let description = json_description(Self::Network, bytes)?;
                    let recordings = description["provenance"]["recordings"].as_array()?.iter();
                    recordings.map(|one| Some(one["sha256"].as_str()?.to_owned())).collect()
                },
                Self::Checkpoint => |bytes| {
                    let description = json_description(Self::Checkpoint, bytes)?;
                    Some(vec![description["inputs"].as_str()?.to_owned()])
                },
            }),
        }
    }
}

/// Writes a file, whole or not at all.
pub fn write(
    output: &Output,
    kind: TensorFileKind,
    description: &impl Serialize,
    arrays: &[NamedTensor],
) -> Result<(), DataError> {
    output.write(&bytes(kind, description, arrays, output.path())?)
}

fn json_description(kind: TensorFileKind, bytes: &[u8]) -> Option<serde_json::Value> {
    let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
    serde_json::from_str(header.metadata().as_ref()?.get(kind.key())?).ok()
}

/// Content of a file; the same arrays and description give the same bytes. Errors name `path`.
fn bytes(
    kind: TensorFileKind,
    description: &impl Serialize,
    arrays: &[NamedTensor],
    path: &Path,
) -> Result<Vec<u8>, DataError> {
    let broken = |error: String| ErrorKind::Toml(error).at(Location::file(path));
    let text = serde_json::to_string(description).map_err(|error| broken(error.to_string()))?;
    let data: Vec<Vec<u8>> = arrays
        .iter()
        .map(|array| array.values.iter().flat_map(|v| v.to_le_bytes()).collect())
        .collect();
    let views = arrays.iter().zip(&data).map(|(array, data)| {
        TensorView::new(Dtype::F32, array.shape.clone(), data).map(|view| (&array.name, view))
    });
    let views = views.collect::<Result<Vec<_>, _>>().map_err(|error| broken(error.to_string()))?;
    // A single entry, since several would have no fixed order.
    let metadata = HashMap::from([(kind.key().to_owned(), text)]);
    serialize(views, Some(metadata)).map_err(|error| broken(error.to_string()))
}

/// Arrays of a file.
pub struct TensorFile {
    path: std::path::PathBuf,
    arrays: HashMap<String, NamedTensor>,
}

/// Reads description and arrays of a file.
pub fn read<D: DeserializeOwned>(
    path: &Path,
    kind: TensorFileKind,
) -> Result<(D, TensorFile), DataError> {
    let at = |fault: ErrorKind| fault.at(Location::file(path));
    if path.is_dir() {
        return Err(at(foreign(kind)));
    }
    let bytes = input::read_bytes(path, input::MAX_TENSORS_BYTES)?;
    let mark = kind.mark();
    let ours = bytes.get(mark.offset..).is_some_and(|rest| rest.starts_with(mark.text.as_bytes()));
    if !ours {
        return Err(at(foreign(kind)));
    }
    let damaged = |error: String| at(ErrorKind::DamagedArrays(error));
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
            return Err(at(ErrorKind::BadValue { found, advice }));
        }
        let (words, _) = view.data().as_chunks::<4>();
        let array = NamedTensor {
            name: name.clone(),
            shape: view.shape().to_vec(),
            values: words.iter().map(|word| f32::from_le_bytes(*word)).collect(),
        };
        arrays.insert(name, array);
    }
    let path = path.to_path_buf();
    Ok((description, TensorFile { path, arrays }))
}

fn foreign(kind: TensorFileKind) -> ErrorKind {
    match kind {
        TensorFileKind::Network => ErrorKind::NotANetwork,
        TensorFileKind::Checkpoint => ErrorKind::NotACheckpoint,
    }
}

impl TensorFile {
    /// Removes and returns the array `name`, which must have this shape and finite values.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, DataError> {
        let at = |fault: ErrorKind| fault.at(Location::file(&self.path));
        let name = name.to_owned();
        let Some(array) = self.arrays.remove(&name) else {
            return Err(at(ErrorKind::MissingArray { name }));
        };
        if array.shape != shape {
            return Err(at(ErrorKind::ArrayShape {
                name,
                found: array.shape,
                expected: shape.to_vec(),
            }));
        }
        if array.values.iter().any(|value| !value.is_finite()) {
            return Err(at(ErrorKind::ArrayNotFinite { name }));
        }
        Ok(array.values)
    }
}
