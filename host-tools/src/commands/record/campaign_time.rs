//! When a recording starts in its campaign's time.

use std::path::Path;
use std::time::SystemTime;

use anyhow::{Result, bail};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::Description;

/// Seconds from the campaign's beginning to `now`, by the recordings beside `target`: each says when it
/// was recorded and where that lies in the campaign.
///
/// # Errors
/// A recording beside it cannot be read or has no date that tells a time of day.
pub fn start_s(target: &Path, now: SystemTime) -> Result<f64> {
    let beside = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // No folder, or one without recordings: the campaign begins.
    let Ok(folders) = recording_folders(beside) else {
        return Ok(0.0);
    };
    let mut latest_s = f64::NEG_INFINITY;
    for folder in folders.iter().filter(|folder| *folder != beside) {
        let (description, _) = Description::read(folder)?;
        let recorded = description.recorded.as_deref().unwrap_or_default();
        let Ok(recorded) = humantime::parse_rfc3339_weak(recorded) else {
            bail!(
                "{}: recording.toml says no date with a time (recorded = \"2026-01-31T12:00:00Z\"), so nobody knows how \
                 long after it this recording starts: give --start-s",
                folder.display()
            );
        };
        // A clock that was set back is no reason to start before another.
        let since = now.duration_since(recorded).unwrap_or_default();
        latest_s = latest_s.max(description.start_s + since.as_secs_f64());
    }
    Ok(if latest_s.is_finite() {
        latest_s.round()
    } else {
        0.0
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tempfile::TempDir;

    use super::*;

    fn recording(campaign: &Path, name: &str, start_s: f64, recorded: Option<&str>) {
        let folder = campaign.join(name);
        std::fs::create_dir(&folder).unwrap();
        let mut description = Description::new("", start_s);
        description.recorded = recorded.map(str::to_owned);
        description.write(&folder).unwrap();
    }

    #[test]
    fn the_first_starts_at_nought_and_others_as_long_after_it_as_the_clock_says() {
        let campaign = TempDir::new().unwrap();
        let target = campaign.path().join("2");
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(3600);
        assert_eq!(start_s(&target, now).unwrap(), 0.0);
        assert_eq!(start_s(&campaign.path().join("new/1"), now).unwrap(), 0.0);
        recording(campaign.path(), "1", 20.0, Some("1970-01-01T00:50:00Z"));
        assert_eq!(start_s(&target, now).unwrap(), 20.0 + 600.0);
    }

    #[test]
    fn where_a_neighbour_has_no_date_the_time_must_be_given() {
        let campaign = TempDir::new().unwrap();
        recording(campaign.path(), "1", 0.0, None);
        let error = start_s(&campaign.path().join("2"), SystemTime::now()).unwrap_err();
        assert!(error.to_string().contains("give --start-s"), "{error}");
    }
}
