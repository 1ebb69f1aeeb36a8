//! What was done, added to `recording.toml`.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use toml_edit::{DocumentMut, value};

/// Adds what was done to the key `description`; everything else stays as it is written.
pub fn extend(path: &Path, done: &[String]) -> Result<()> {
    let named = || format!("{}", path.display());
    let text = fs::read_to_string(path).with_context(named)?;
    let extended = with_words(&text, &done.join("; ")).with_context(named)?;
    fs::write(path, extended).with_context(named)
}

fn with_words(text: &str, done: &str) -> Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let before = document
        .get("description")
        .and_then(|item| item.as_str())
        .unwrap_or_default();
    let after = match before.is_empty() {
        true => format!("mended: {done}"),
        false => format!("{before} (mended: {done})"),
    };
    document["description"] = value(after);
    Ok(document.to_string())
}

#[cfg(test)]
mod tests {
    use super::with_words;

    #[test]
    fn everything_but_the_description_stays_byte_for_byte() {
        let text = "format = 1\ndescription = \"bench\"\nstart_s  =  0.0 # first\n[design]\ngap_mm = 1.50\n";
        let expected = text.replace("\"bench\"", "\"bench (mended: rows sorted)\"");
        assert_eq!(with_words(text, "rows sorted").unwrap(), expected);
    }
}
