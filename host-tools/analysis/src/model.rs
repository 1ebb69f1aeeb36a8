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
        let file = ModelFile::read(path)?;
        Ok(Self { effects: file.effect_terms(path)?, path: path.to_path_buf(), file })
    }

    /// A fitted base, which has no effects.
    pub fn base(path: impl Into<PathBuf>, file: ModelFile) -> Self {
        Self { path: path.into(), file, effects: Vec::new() }
    }

    /// Whether the error of one of its effects has such an origin.
    pub fn has_origin(&self, is_origin: impl Fn(ErrorOrigin) -> bool) -> bool {
        self.effects.iter().any(|effect| is_origin(effect.error_origin()))
    }

    /// Index of a recording with this hash among those of the fit, or one beyond the last.
    pub fn place_of(&self, sha256: &str) -> usize {
        let fitted = &self.file.provenance.recordings;
        fitted.iter().position(|other| other.sha256 == sha256).unwrap_or(fitted.len())
    }
}
