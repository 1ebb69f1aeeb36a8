//! Where a model comes from: recordings, clocks, sensor.

use firmware::params;
use serde::{Deserialize, Serialize};

use crate::fit::{FitError, Options};
use crate::recordings::campaign::fingerprint;
use crate::recordings::{Campaign, Problem};

/// Where a model's numbers come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the campaign's folder.
    pub campaign: String,
    /// The recordings that were fitted.
    pub recordings: Vec<Fitted>,
    /// Rows on the reference's clock, all recordings.
    pub rows: usize,
    /// Half the averaging window in milliseconds.
    pub half_window_ms: f64,
    /// Delay of the reference that was assumed, in milliseconds.
    pub delay_ms: f64,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Version of the tool.
    pub tool: String,
}

/// A recording that a model was fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// Name of its folder.
    pub name: String,
    /// SHA-256 over its files.
    pub sha256: String,
    /// When it was recorded, if it says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
}

impl Provenance {
    /// What `campaign` and the options of the fit are.
    pub fn of(campaign: &Campaign, delay_us: f64, options: Options) -> Result<Self, FitError> {
        let absolute = campaign
            .folder
            .canonicalize()
            .unwrap_or_else(|_| campaign.folder.clone());
        let half_widths = campaign.recordings.iter().map(|r| r.half_width_s);
        Ok(Self {
            campaign: absolute
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            recordings: campaign
                .recordings
                .iter()
                .map(|recording| {
                    Ok(Fitted {
                        name: recording.name.clone(),
                        sha256: fingerprint(&recording.folder)?,
                        recorded: recording.description.recorded.clone(),
                    })
                })
                .collect::<Result<_, Problem>>()?,
            rows: campaign.recordings.iter().map(|r| r.time_s.len()).sum(),
            half_window_ms: 1e3 * half_widths.fold(0.0, f64::max),
            delay_ms: 1e-3 * delay_us,
            seed: options.seed,
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
        })
    }
}

/// How counts become gauss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorScale {
    /// Gauss for each count.
    pub gauss_per_lsb: f64,
    /// Range of each axis in gauss, either way.
    pub range_gauss: f64,
    /// True where the recordings do not say it and the part's own is assumed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub assumed: bool,
}

impl SensorScale {
    /// What the recordings say, else the A31301's.
    pub fn of(campaign: &Campaign) -> Self {
        let description = campaign
            .recordings
            .first()
            .map(|recording| &recording.description);
        let stated = description.and_then(|d| d.gauss_per_lsb.zip(d.range_gauss));
        let (gauss_per_lsb, range_gauss) =
            stated.unwrap_or((params::SENSOR_SCALE.value, params::SENSOR_RANGE.value));
        Self {
            gauss_per_lsb,
            range_gauss,
            assumed: stated.is_none(),
        }
    }
}
