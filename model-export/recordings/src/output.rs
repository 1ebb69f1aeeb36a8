//! Output files: written atomically, never over files of another origin.

use std::fmt;
use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use tempfile::{NamedTempFile, TempDir};

use crate::error::{DataError, ErrorKind, Location, REMOVABLE};
use crate::recording::hex;

/// Bytes that identify a file of this tool, and how such a file names its inputs.
#[derive(Clone, Copy, Debug)]
pub struct FileSignature<'a> {
    /// Offset of the signature in bytes; some formats begin with a length.
    pub offset: usize,
    /// The signature.
    pub text: &'a str,
    /// How a file names what it was written from.
    pub inputs: NamedInputs,
}

/// How a file names what it was written from.
#[derive(Clone, Copy, Debug)]
pub enum NamedInputs {
    /// A comment in the second line, between these texts.
    Comment(&'static str, &'static str),
    /// The content, which this function reads.
    Content(fn(&[u8]) -> Option<Vec<String>>),
}

impl<'a> From<&'a str> for FileSignature<'a> {
    /// At offset zero, with a comment of the kind of the signature.
    fn from(text: &'a str) -> Self {
        let (open, close) = match text {
            page if page.starts_with("<!--") => ("<!-- inputs: ", " -->"),
            source if source.starts_with("//") => ("// inputs: ", ""),
            _ => ("# inputs: ", ""),
        };
        Self { offset: 0, text, inputs: NamedInputs::Comment(open, close) }
    }
}

impl FileSignature<'_> {
    fn is_of(&self, bytes: &[u8]) -> bool {
        bytes.get(self.offset..).is_some_and(|rest| rest.starts_with(self.text.as_bytes()))
    }

    fn inputs_of(&self, bytes: &[u8]) -> Option<Vec<String>> {
        let (open, close) = match self.inputs {
            NamedInputs::Comment(open, close) => (open, close),
            NamedInputs::Content(read) => return read(bytes),
        };
        let line = bytes.split(|byte| *byte == b'\n').nth(1)?;
        let names = str::from_utf8(line).ok()?.strip_prefix(open)?.strip_suffix(close)?;
        Some(names.split_whitespace().map(str::to_owned).collect())
    }
}

/// What a command does with another file at its output path.
#[derive(Clone, Copy, Debug)]
pub enum Overwrite {
    /// The user asked for it.
    Forced,
    /// It is kept; the error ends with this remedy.
    Refused {
        /// As in [`Overwrite::NEVER`].
        remedy: &'static str,
    },
}

impl Overwrite {
    /// Of a caller that replaces no other file.
    pub const NEVER: Self = Self::Refused { remedy: REMOVABLE };
    /// Of a command whose option `--force` is not given.
    pub const UNFORCED: Self = Self::Refused { remedy: "choose another path, or give --force" };
}

/// Digest of settings, by which output files name them as their input.
pub fn fingerprint_of(settings: &impl fmt::Debug) -> String {
    hex(&Sha256::digest(format!("{settings:?}").as_bytes())[..8])
}

/// A file that a command may write: nothing is at its path, or an earlier result of the same inputs, or the user forces it.
#[derive(Clone, Debug)]
pub struct Output {
    path: PathBuf,
    signature: FileSignature<'static>,
    inputs: Vec<String>,
    overwrite: Overwrite,
}

impl Output {
    /// Checks an output path, before long computations. An existing file is replaced only if it is empty or names nothing but
    /// these inputs, or some of them; symbolic links are followed.
    ///
    /// # Errors
    /// The path holds another file, or the file system refuses.
    pub fn check(
        path: &Path,
        signature: impl Into<FileSignature<'static>>,
        inputs: Vec<String>,
        overwrite: Overwrite,
    ) -> Result<Self, DataError> {
        let (path, signature) = (path.to_path_buf(), signature.into());
        let output = Self { path, signature, inputs, overwrite };
        output.target()?;
        Ok(output)
    }

    fn target(&self) -> Result<PathBuf, DataError> {
        let why = " and is not an earlier result of the same inputs";
        check_replaceable(&self.path, (self.overwrite, why), |bytes| {
            let named = self.signature.inputs_of(bytes);
            let is_own = |named: Vec<String>| named.iter().all(|name| self.inputs.contains(name));
            self.signature.is_of(bytes) && named.is_some_and(is_own)
        })
    }

    /// The path as the user gave it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a file that begins with the signature, and names the inputs in it; it appears complete.
    ///
    /// # Errors
    /// The path holds another file in the meantime, or the file system refuses.
    pub fn write(&self, bytes: &[u8]) -> Result<(), DataError> {
        let draft = match self.signature.inputs {
            NamedInputs::Content(_) => bytes.to_vec(),
            NamedInputs::Comment(open, close) => {
                let line = bytes.iter().position(|byte| *byte == b'\n').map_or(0, |end| end + 1);
                let (first, rest) = bytes.split_at(line);
                let named = format!("{open}{}{close}\n", self.inputs.join(" "));
                [first, named.as_bytes(), rest].concat()
            }
        };
        replace(&self.path, &self.target()?, &draft)
    }
}

/// Writes `bytes`; an existing file with another content is replaced only if the user forces it.
///
/// # Errors
/// The path holds another file, or the file system refuses.
pub fn write_same(path: &Path, bytes: &[u8], overwrite: Overwrite) -> Result<(), DataError> {
    let why = " and has another content";
    let target = check_replaceable(path, (overwrite, why), |existing| existing == bytes)?;
    replace(path, &target, bytes)
}

/// Writes `bytes` to a temporary file in the folder of `path` and renames it. An existing file is replaced
/// only if it is empty or has the signature: for a file that is one of the inputs of its command.
///
/// # Errors
/// The path holds a file of another origin, or the file system refuses.
pub fn write_output<'a>(
    path: &Path,
    bytes: &[u8],
    signature: impl Into<FileSignature<'a>>,
) -> Result<(), DataError> {
    replace(path, &check_output(path, signature)?, bytes)
}

fn replace(path: &Path, target: &Path, bytes: &[u8]) -> Result<(), DataError> {
    let draft = draft_file(path, target, bytes, SHARED)?;
    draft.persist(target).map_err(|error| unwritable(path, error.error))?;
    Ok(())
}

/// Writes `bytes` to a new file, which appears complete.
///
/// # Errors
/// Something has this path, also if it was created in the meantime; or the file system refuses.
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    begin_new(path, bytes).map(drop)
}

/// As [`write_new`], for a file that is continued: it appears with `bytes`.
///
/// # Errors
/// As [`write_new`].
pub(crate) fn begin_new(path: &Path, bytes: &[u8]) -> Result<File, DataError> {
    write_new_with(path, bytes, SHARED)
}

/// As [`write_new`], for a secret: others can neither read nor write the file.
///
/// # Errors
/// As [`write_new`].
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    write_new_with(path, bytes, PRIVATE).map(drop)
}

/// Permissions on Unix, reduced by the user's mask.
const SHARED: u32 = 0o666;
const PRIVATE: u32 = 0o600;

fn write_new_with(path: &Path, bytes: &[u8], mode: u32) -> Result<File, DataError> {
    check_absent(path)?;
    let draft = draft_file(path, path, bytes, mode)?;
    draft.persist_noclobber(path).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => ErrorKind::exists().at(Location::file(path)),
        _ => unwritable(path, error.error),
    })
}

/// A temporary file with this content in the folder of `target`; errors name `path`.
fn draft_file(
    path: &Path,
    target: &Path,
    bytes: &[u8],
    mode: u32,
) -> Result<NamedTempFile, DataError> {
    let failed = |error| unwritable(path, error);
    let prefix = format!("{DRAFT_PREFIX}output-");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(DRAFT_SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    remove_abandoned(folder_of(target));
    let mut draft = loop {
        let draft = builder.tempfile_in(folder_of(target)).map_err(failed)?;
        if is_claimed(draft.path(), Some(draft.as_file())) {
            break draft;
        }
    };
    draft.write_all(bytes).map_err(failed)?;
    draft.as_file().sync_all().map_err(failed)?;
    Ok(draft)
}

/// Checks that [`write_output`] may write `path` (call it before long computations); returns the resolved
/// path.
pub fn check_output<'a>(
    path: &Path,
    signature: impl Into<FileSignature<'a>>,
) -> Result<PathBuf, DataError> {
    let signature = signature.into();
    let why = " and is not a file of this command";
    check_replaceable(path, (Overwrite::NEVER, why), |bytes| signature.is_of(bytes))
}

/// The resolved path of an output file that may be written: nothing is there, or an empty file, or one that `is_same` accepts, or
/// any file that the user wants to replace. `why` continues "the output path exists" for another file.
fn check_replaceable(
    path: &Path,
    (overwrite, why): (Overwrite, &'static str),
    is_same: impl FnOnce(&[u8]) -> bool,
) -> Result<PathBuf, DataError> {
    let target = match path.symlink_metadata() {
        Ok(_) => path.canonicalize().map_err(|error| unwritable(path, error))?,
        Err(_) => path.to_path_buf(),
    };
    if target.exists() {
        let is_same = || {
            let is_short = target.metadata().is_ok_and(|file| file.len() <= MAX_REPLACED_BYTES);
            is_short && std::fs::read(&target).is_ok_and(|old| old.is_empty() || is_same(&old))
        };
        let refused = match overwrite {
            _ if target.is_dir() => Some((" and is a folder", "choose another path")),
            _ if !target.is_file() => Some((" and is not a regular file", "choose another path")),
            Overwrite::Forced => None,
            Overwrite::Refused { remedy } => (!is_same()).then_some((why, remedy)),
        };
        if let Some((why, remedy)) = refused {
            return Err(ErrorKind::OutputExists { why, remedy }.at(Location::file(path)));
        }
    }
    let folder = folder_of(&target);
    if !folder.exists() {
        return Err(ErrorKind::NoSuchFolder.at(Location::file(folder)));
    }
    // Permissions do not tell whether a file system accepts a file.
    let trial =
        tempfile::Builder::new().prefix(DRAFT_PREFIX).suffix(DRAFT_SUFFIX).tempfile_in(folder);
    trial.map_err(|error| unwritable(path, error))?;
    Ok(target)
}

/// Larger files are not read to see what they are: none that a command replaces is as long.
const MAX_REPLACED_BYTES: u64 = 1 << 30;

/// Start of the name of every temporary file and folder.
const DRAFT_PREFIX: &str = ".magpie-";
/// End of the name of every temporary file and folder.
const DRAFT_SUFFIX: &str = ".partial";

/// A temporary folder next to its target, renamed to it when complete and deleted otherwise.
///
/// Its writer holds a lock on it, which ends with the process: the next writer at this place deletes what a killed process
/// has left.
pub struct StagingDir {
    folder: TempDir,
    _lock: Option<File>,
}

impl StagingDir {
    /// A folder next to `target`; `purpose` is part of its name.
    ///
    /// # Errors
    /// The parent folder cannot be written.
    pub fn new(target: &Path, purpose: &str) -> Result<Self, DataError> {
        let parent = folder_of(target);
        let prefix = format!("{DRAFT_PREFIX}{purpose}-");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(DRAFT_SUFFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o777));
        }
        let failed = |error| unwritable(target, error);
        std::fs::create_dir_all(parent).map_err(failed)?;
        remove_abandoned(parent);
        loop {
            let folder = builder.tempdir_in(parent).map_err(failed)?;
            let lock = File::open(folder.path()).ok();
            if is_claimed(folder.path(), lock.as_ref()) {
                return Ok(Self { folder, _lock: lock });
            }
        }
    }

    /// Path of the temporary folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Renames the folder to `target`, where nothing or an empty folder may be.
    ///
    /// # Errors
    /// Another process has written `target` in the meantime, or the file system refuses; the temporary folder is deleted.
    pub fn commit(self, target: &Path) -> Result<(), DataError> {
        // Replaces nothing but an empty folder.
        match std::fs::rename(self.folder.path(), target) {
            Ok(()) => {
                let _ = self.folder.keep();
                Ok(())
            }
            Err(error) => {
                check_vacant(target)?;
                Err(unwritable(target, error))
            }
        }
    }
}

/// Locks a new draft; false if another process takes it for abandoned, before there was a lock. Where the file system has
/// no locks, nothing is ever taken for abandoned.
fn is_claimed(path: &Path, file: Option<&File>) -> bool {
    match file.map(File::try_lock) {
        Some(Err(TryLockError::WouldBlock)) => false,
        _ => path.exists(),
    }
}

/// Whether this is the name of a temporary file or folder.
pub(crate) fn is_draft(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.starts_with(DRAFT_PREFIX) && name.ends_with(DRAFT_SUFFIX))
}

/// Deletes the drafts in `folder` whose writer has died: a process that lives holds its lock.
pub(crate) fn remove_abandoned(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let Ok(kind) = entry.file_type() else { continue };
        if !is_draft(&path) || !(kind.is_dir() || kind.is_file()) {
            continue;
        }
        let Ok(file) = File::open(&path) else { continue };
        if file.try_lock().is_err() {
            continue;
        }
        // The output does not depend on it.
        let _ = if kind.is_dir() {
            std::fs::remove_dir_all(&path)
        } else {
            std::fs::remove_file(&path)
        };
    }
}

/// Checks that `target` does not exist or is an empty folder.
///
/// # Errors
/// It exists.
pub fn check_vacant(target: &Path) -> Result<(), DataError> {
    match std::fs::read_dir(target).map(|mut entries| entries.next()) {
        Ok(None) => Ok(()),
        _ => check_absent(target),
    }
}

/// Checks that nothing has this path.
///
/// # Errors
/// It exists.
pub fn check_absent(target: &Path) -> Result<(), DataError> {
    match target.symlink_metadata() {
        Ok(_) => Err(ErrorKind::exists().at(Location::file(target))),
        Err(_) => Ok(()),
    }
}

/// Folder of a file.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn unwritable(path: &Path, error: std::io::Error) -> DataError {
    // Only the kind: the message would name the temporary file.
    ErrorKind::Unwritable(std::io::Error::from(error.kind())).at(Location::file(path))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn loser_of_two_writers_changes_nothing() {
        let folder = TempDir::new().unwrap();
        let target = folder.path().join("campaign");
        let [first, second] = ["first", "second"].map(|text| {
            let draft = StagingDir::new(&target, "test").unwrap();
            fs::write(draft.path().join("file"), text).unwrap();
            draft
        });
        assert_eq!(names(folder.path()).len(), 2);
        first.commit(&target).unwrap();
        let message = second.commit(&target).unwrap_err().to_string();
        assert!(message.contains("not overwritten"), "{message}");
        assert_eq!(names(folder.path()), ["campaign"]);
        assert_eq!(fs::read_to_string(target.join("file")).unwrap(), "first");
        let path = folder.path().join("truth");
        write_new(&path, b"first").unwrap();
        let message = write_new(&path, b"second").unwrap_err().to_string();
        assert!(message.contains("not overwritten"), "{message}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        assert_eq!(names(folder.path()), ["campaign", "truth"]);
    }

    #[test]
    fn campaign_is_read_without_the_recordings_of_killed_and_present_writers() {
        let folder = TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["1", ".magpie-record-dead.partial"] {
            fs::create_dir(path(name)).unwrap();
            fs::write(path(name).join("hall.csv"), "").unwrap();
        }
        let live = StagingDir::new(&path("2"), "record").unwrap();
        fs::write(live.path().join("hall.csv"), "").unwrap();
        assert_eq!(crate::campaign::recording_folders(folder.path()).unwrap(), [path("1")]);
        assert!(live.path().exists());
        drop(live);
        assert_eq!(names(folder.path()), ["1"]);
    }

    #[test]
    fn abandoned_drafts_are_deleted_and_others_stay() {
        let folder = TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir_all(path(".magpie-test-dead.partial/1")).unwrap();
        fs::write(path(".magpie-output-dead.partial"), "").unwrap();
        let others = [".magpie-settings", "data.partial", ".magpie-simulate-old"];
        for name in others {
            fs::create_dir(path(name)).unwrap();
        }
        let live = StagingDir::new(&path("campaign"), "test").unwrap();
        let draft = draft_file(&path("file"), &path("file"), b"", SHARED).unwrap();
        write_output(&path("model"), b"mark", "mark").unwrap();
        assert!(live.path().exists() && draft.path().exists());
        drop((live, draft));
        let mut expected: Vec<&str> = others.into_iter().chain(["model"]).collect();
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
    }
}
