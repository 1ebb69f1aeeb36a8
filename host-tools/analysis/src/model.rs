//! A model as the analyses use it: read once, with its effects.

use std::path::{Path, PathBuf};

use model_export::effects::{EffectTerm, ErrorOrigin};
use model_export::model_file::ModelFile;
use model_export::recordings::DataError;

/// A model with its effects.
#[derive(Clone, Debug)]
pub struct Model {
    /// Its file in messages and results; a name where there is no file.
    pub path: PathBuf,
    pub file: ModelFile,
    /// Effects of the file.
    pub effects: Vec<EffectTerm>,
}

impl Model {
    /// Reads a model file.
    ///
    /// # Errors
    /// It cannot be read, or an effect is invalid.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        Self::of(path, ModelFile::read(path)?)
    }

    /// The content of a model file; `path` names it in messages.
    ///
    /// # Errors
    /// An effect is invalid.
    pub fn of(path: &Path, file: ModelFile) -> Result<Self, DataError> {
        Ok(Self { effects: file.effect_terms(path)?, path: path.to_path_buf(), file })
    }

    /// Whether the error of one of its effects has such an origin.
    pub fn has_origin(&self, is_origin: impl Fn(ErrorOrigin) -> bool) -> bool {
        self.effects.iter().any(|effect| is_origin(effect.error_origin()))
    }

    /// Whether the device does not compensate the error of one of its effects, so that recordings are corrected for it.
    pub fn needs_corrections(&self) -> bool {
        self.has_origin(|origin| origin != ErrorOrigin::Compensated)
    }

    /// Index of a recording with this hash among those of the fit, or one beyond the last.
    pub fn place_of(&self, sha256: &str) -> usize {
        let fitted = &self.file.provenance.recordings;
        fitted.iter().position(|other| other.sha256 == sha256).unwrap_or(fitted.len())
    }
}
