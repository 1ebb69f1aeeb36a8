//! Simulated calibration campaigns: recordings of a gripper with known physics, to test fit and diagnosis.
//!
//! Simulation and fit share the closed-form fields of magnets (validated against MagpyLib), the recording format and
//! the nominal design, nothing else. The mechanics are integrated in time: stiffening springs, stick-slip friction,
//! dampers and creep elements as differential equations, counted load cycles, moving magnets, drifting clocks. No
//! effect is simulated as the regressor that a fit would estimate.
//!
//! Not simulated: heat flow, vibration of the fingers, a motor controller, lost transfers, an uncalibrated reference.
//!
//! - [`settings`]: size, noise and effects of a campaign.
//! - [`excitation`]: load, motion and temperature over time.
//! - [`gripper`]: all sensors in time.
//! - [`plan`]: steps of a planned recording.
//! - [`recording`]: clocks, reference sensor, files.
//! - [`truth`]: the simulated effects, written outside the campaign.

pub mod excitation;
pub mod gripper;
pub mod plan;
pub mod recording;
pub mod settings;
pub mod truth;

use std::path::{Path, PathBuf};

use anyhow::Result;
use firmware::config::constants;
use model_export::output::{StagingDir, check_absent, check_vacant, write_new};

use crate::campaign::excitation::Excitation;
use crate::campaign::gripper::CampaignGripper;
use crate::campaign::recording::{RecordingWriter, SampleClock};
use crate::campaign::settings::{CampaignSettings, start_s};
use crate::campaign::truth::Truth;

/// Writes a campaign to a new folder, and its true parameters outside of it (by default next to it); both appear complete. `done` is
/// called after each recording. Returns the true parameters and their path.
///
/// # Errors
/// The settings are impossible, something has one of the paths, or a file cannot be written.
pub fn write(
    settings: &CampaignSettings,
    output: &Path,
    truth: Option<&Path>,
    done: impl Fn(),
) -> Result<(Truth, PathBuf)> {
    settings.check()?;
    let truth_path = match truth {
        Some(path) => path.to_path_buf(),
        None => truth::default_path(output)?,
    };
    truth::check_outside(&truth_path, output)?;
    check_vacant(output)?;
    check_absent(&truth_path)?;
    let staging = StagingDir::new(output, "simulate")?;
    let truth = simulate(settings, staging.path(), done)?;
    // Both are new, or neither is: another process may have written them in the meantime.
    write_new(&truth_path, truth.text()?.as_bytes())?;
    if let Err(error) = staging.commit(output) {
        let _ = std::fs::remove_file(&truth_path);
        return Err(error.into());
    }
    Ok((truth, truth_path))
}

/// Writes the recordings of a campaign into a folder; `done` is called after each of them.
///
/// # Errors
/// An effect is given twice, or a file cannot be written.
pub fn simulate(settings: &CampaignSettings, folder: &Path, done: impl Fn()) -> Result<Truth> {
    let (seed, seconds) = (settings.seed, settings.seconds);
    let effects = settings.effects()?;
    let numbers = settings.numbers();
    let excitations: Vec<Excitation> = numbers.clone().map(|n| settings.excitation(n)).collect();
    let rates_hz = [constants::SENSE_RATE.value, constants::REFERENCE_RATE.value];
    let clocks: Vec<[SampleClock; 2]> =
        numbers.clone().map(|n| SampleClock::draw(seed, n, rates_hz)).collect();
    let mut gripper = CampaignGripper::new(settings, &effects, &excitations);
    for ((recording, excitation), &clocks) in numbers.zip(&excitations).zip(&clocks) {
        let writer = RecordingWriter { settings, effects: &effects, recording, excitation, clocks };
        writer.write(&folder.join(recording.to_string()), &mut gripper)?;
        let next_s = start_s(seconds, recording + 1) - start_s(seconds, recording);
        gripper.pause((next_s - excitation.seconds()).max(0.0));
        done();
    }
    Truth::new(settings, &effects, &gripper, &clocks)
}
