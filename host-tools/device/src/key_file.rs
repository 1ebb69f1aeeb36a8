//! File with the key that a gripper and its hosts share: 32 hexadecimal digits in one line, readable by its owner only.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use firmware::protocol::authentication::{KEY_BYTES, Key};
use model_export::input;
use model_export::output::write_private;

use crate::session::Credentials;

/// Environment variable with the path of the file.
pub const VARIABLE: &str = "MAGPIE_KEY_FILE";

/// The file that is used without an option: that of [`VARIABLE`], or `magpie/key` in the user's configuration folder.
pub fn default_path() -> Option<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from);
    folder(VARIABLE).or_else(|| {
        let config = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))?;
        Some(config.join("magpie").join("key")).filter(|path| path.exists())
    })
}

/// Node number and key of a gripper, for a session: the key of this file, else of [`default_path`], else none.
///
/// # Errors
/// As [`read`].
pub fn credentials(node: u16, path: Option<PathBuf>) -> Result<Credentials> {
    let key = path.or_else(default_path).map_or(Ok(Key::NONE), |path| read(&path))?;
    Ok(Credentials { node, key })
}

/// Reads a key.
///
/// # Errors
/// No regular file, too long, unreadable, readable by others, or not a key.
pub fn read(path: &Path) -> Result<Key> {
    let name = path.display();
    let text = input::read_text(path).context("cannot read the key")?;
    check_mode(path)?;
    let Some(key) = parse(text.trim()) else {
        bail!(
            "{name}: a key file has one line of 32 hexadecimal digits, not all zero; `cargo magpie board key new` writes one"
        );
    };
    Ok(key)
}

/// Writes a new random key to a file that does not exist yet.
///
/// # Errors
/// The file exists or cannot be written: it appears complete or not at all.
pub fn create(path: &Path) -> Result<Key> {
    let mut key = Key::NONE;
    getrandom::fill(&mut key.0).context("the system has no random numbers")?;
    let digits: String = key.0.iter().map(|byte| format!("{byte:02x}")).collect();
    write_private(path, format!("{digits}\n").as_bytes()).context("cannot create the key file")?;
    Ok(key)
}

fn parse(digits: &str) -> Option<Key> {
    let mut key = Key::NONE;
    if digits.len() != 2 * KEY_BYTES || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    for (place, byte) in key.0.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&digits[2 * place..2 * place + 2], 16).ok()?;
    }
    (key != Key::NONE).then_some(key)
}

#[cfg(unix)]
fn check_mode(path: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt;
    let mode = fs::metadata(path)?.permissions().mode();
    if mode & 0o077 != 0 {
        let name = path.display();
        bail!("{name}: other users can read or write the key: run `chmod 600 {name}`");
    }
    Ok(())
}

#[cfg(not(unix))]
fn check_mode(_: &Path) -> Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn created_key_is_read_again_and_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        let key = create(&path).unwrap();
        assert_eq!(read(&path).unwrap(), key);
        assert!(create(&path).is_err());
        assert_eq!(read(&path).unwrap(), key);
    }

    #[cfg(unix)]
    #[test]
    fn key_that_others_can_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        create(&path).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("chmod 600"));
    }

    #[test]
    fn only_32_digits_are_a_key() {
        assert_eq!(parse("000102030405060708090a0b0c0d0e0F").unwrap().0[15], 15);
        for text in ["", "00", &"0".repeat(32), &"g".repeat(32), &"+1".repeat(16), &"é".repeat(16)]
        {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
