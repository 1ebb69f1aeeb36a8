//! Base physics fitted to a campaign.
//!
//! - [`rows`]: what one sensor and its reference saw, row by row, with their noise.
//! - [`orientation`]: are the columns what they say? Swapped and flipped axes, wrong units.
//! - [`blocks`]: block bootstrap of a least-squares solution, for error bars that hold for
//!   residuals with memory.
//! - [`evidence`]: what speaks for an effect before it is fitted.
//! - [`folds`]: what is kept out of a fit to judge it.
//! - [`parameters`]: the parameters of the cylinder base, their tolerances and their Jacobian.
//! - [`slot`]: one number that a fit may move, of the base or of an effect.
//! - [`score`]: held-out error beside the noise floor.
//! - [`polynomial`]: the base where no geometry is known.
//! - [`base`]: both bases as a fit sees them.
//! - [`problem`]: one sensor's fields as a function of all its parameters.
//! - [`space`]: which combinations of parameters the data tell.
//! - [`solve`]: Levenberg-Marquardt on all three axes jointly.
//! - [`sensor`]: the fit of one sensor, step by step.
//! - [`normal`]: small regressions by recording.
//! - [`start`]: where the parameters of effects start from.
//! - [`pool`]: what all sensors share.
//! - [`size`]: how large an effect is over all sensors.
//! - [`ground`]: where an effect is sought from.
//! - [`joint`]: all sensors together, judged on what was kept out.
//! - [`campaign`]: from a campaign to its fits.

pub mod base;
pub mod blocks;
pub mod campaign;
pub mod evidence;
pub mod folds;
pub mod ground;
pub mod joint;
pub mod normal;
pub mod orientation;
pub mod parameters;
pub mod polynomial;
pub mod pool;
pub mod problem;
pub mod rows;
pub mod score;
pub mod sensor;
pub mod size;
pub mod slot;
pub mod solve;
pub mod space;
pub mod start;

pub use campaign::Fits;
pub use score::AxisScore;

use crate::recordings::{Place, Problem};

/// A campaign that cannot be fitted as it is.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum FitError {
    #[error(transparent)]
    Recording(#[from] Problem),
    #[error(
        "{place}: there is no [design] table, so the geometry is not known; add the nominal design, or fit with --base polynomial"
    )]
    NoDesign { place: Place },
    #[error(
        "{place}: the force on sensor {sensor} along {axis} was not recorded; record {axis} as well, or fit with --base polynomial"
    )]
    NoForce {
        place: Place,
        sensor: u32,
        axis: &'static str,
    },
    #[error(
        "sensor {sensor}: a polynomial of degree {degree} needs a force, and none was recorded; leave out --degree (constants alone are then fitted), or record a force"
    )]
    DegreeWithoutForce { sensor: u32, degree: usize },
    #[error(
        "{place}: sensor {sensor} has {rows} usable rows and the fit needs {needed}; record longer"
    )]
    TooFewRows {
        place: Place,
        sensor: u32,
        rows: usize,
        needed: usize,
    },
    #[error(
        "{place}: sensor {sensor} is saturated in {share:.0} % of the rows; check gauss_per_lsb, range_gauss and the unit of its columns, or widen the gap"
    )]
    Saturated {
        place: Place,
        sensor: u32,
        share: f64,
    },
    #[error(
        "{place}: the channel never changes; the sensor is stuck or not connected: repair it, or remove the columns of sensor {sensor}"
    )]
    Stuck { place: Place, sensor: u32 },
    #[error(
        "{place}: the forces on sensor {sensor} were recorded here and not in every recording; complete them, or move this recording to a campaign of its own"
    )]
    ForcesDiffer { place: Place, sensor: u32 },
    #[error(
        "{place}: sensor {sensor} is under several forces along one axis, so an effect would not know which it belongs to; keep one fN_x_n and one fN_z_n"
    )]
    ManyForces { place: Place, sensor: u32 },
    #[error("{place}: {what}; {advice}")]
    Orientation {
        place: Place,
        what: String,
        advice: String,
    },
    #[error(
        "{place}: the force does not move beyond its noise: from a constant load no response can be learnt; record with the load going up and down, or, if nothing ever pushes there, fit with --base polynomial and without this column"
    )]
    ConstantForce { place: Place },
    #[error(
        "the fit of sensor {sensor} did not converge ({reason}); check the nominal design in recording.toml, or fit with --base polynomial"
    )]
    NotConverged { sensor: u32, reason: String },
}

/// How a fit is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Resamples of the bootstrap.
    pub draws: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            draws: 400,
        }
    }
}
