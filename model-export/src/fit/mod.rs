//! Physical model fitted to a campaign, with error bars, identifiability and cross-validation.
//!
//! - [`rows`]: usable rows of one sensor with its reference forces and their noise.
//! - [`orientation`]: swapped or flipped axes and wrong units, detected before the fit.
//! - [`parameters`]: free parameters with start and prior width; the cylinder model's parameters and Jacobian.
//! - [`polynomial`]: the base model without a known geometry.
//! - [`base_model`]: both base models behind one trait.
//! - [`cross_validation`]: splits, held-out error and noise floor.
//! - [`held_out`]: held-out residuals of a linearised model.
//! - [`problem`]: one sensor's fields and Jacobian as a function of all its parameters.
//! - [`block_bootstrap`]: error bars for autocorrelated residuals.
//! - `identifiability`: which combinations of parameters the data determine.
//! - [`solver`]: Levenberg-Marquardt on all three axes jointly.
//! - [`sensor_fit`]: the fit of one sensor, step by step.
//! - `linearisation`: a fitted model linearised at its solution, with regressions per recording.
//! - `initial_guess`: grid search for the shape parameters of effects, least squares for their coefficients.
//! - [`joint`]: all sensors together, with pooled shared parameters.
//! - [`effect_size`]: magnitude of an effect over all sensors.
//! - [`recording_differences`]: zeros and places that differ between recordings.
//! - [`score_test`]: test of a candidate effect without refitting.
//! - `profile_likelihood`: fits with other values of a shape, with their likelihoods (`shape_profile`).
//! - [`campaign`]: from a campaign to its fits.

pub mod base_model;
pub mod block_bootstrap;
pub mod campaign;
pub mod cross_validation;
pub mod effect_size;
pub mod held_out;
pub mod identifiability;
mod initial_guess;
pub mod joint;
mod linearisation;
pub mod orientation;
pub mod parameters;
pub mod polynomial;
pub mod problem;
mod profile_likelihood;
pub mod recording_differences;
pub mod rows;
pub mod score_test;
pub mod sensor_fit;
mod shape_profile;
pub mod solver;
pub(crate) mod tall_products;

pub use campaign::CampaignFits;
pub use cross_validation::AxisScore;

use crate::recordings::{DataError, Location};

/// A campaign that cannot be fitted as it is.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum FitError {
    #[error(transparent)]
    Recording(#[from] DataError),
    #[error(
        "{place}: there is no [design] table, so the geometry is unknown; add it to recording.toml or to the mapping of the import (`cargo magpie import --help` shows one), or, where it is unknown, fit with --base polynomial"
    )]
    NoDesign { place: Location },
    #[error(
        "{place}: the force on sensor {sensor} along {axis} was not recorded; record {axis} as well, or fit with --base polynomial"
    )]
    NoForce { place: Location, sensor: u32, axis: &'static str },
    #[error(
        "{place}: no forces; replace force.csv by the table of the reference sensor, with t_us from the same start"
    )]
    NoForces { place: Location },
    #[error(
        "sensor {sensor}: a polynomial of degree {degree} needs a force, and none was recorded; leave out --degree (constants alone are then fitted), or record a force"
    )]
    DegreeWithoutForce { sensor: u32, degree: usize },
    #[error(
        "sensor {sensor}: a polynomial of degree {degree} in {forces} forces has more than {max} terms, the limit; reduce --degree, or remove columns of force.csv"
    )]
    TooManyTerms { sensor: u32, degree: usize, forces: usize, max: usize },
    #[error(
        "{place}: sensor {sensor} has {rows} usable rows and the fit needs {needed}; record longer"
    )]
    TooFewRows { place: Location, sensor: u32, rows: usize, needed: usize },
    #[error(
        "{place}: sensor {sensor} is saturated in {share:.0} % of the rows; check gauss_per_lsb, range_gauss and the unit of its columns, or widen the gap"
    )]
    Saturated { place: Location, sensor: u32, share: f64 },
    #[error(
        "{place}: the channel never changes; the sensor is stuck or not connected: repair it, or remove the columns of sensor {sensor}"
    )]
    Stuck { place: Location, sensor: u32 },
    #[error(
        "{place}: the forces on sensor {sensor} were recorded here and not in every recording; complete them, or move this recording to a campaign of its own"
    )]
    ForcesDiffer { place: Location, sensor: u32 },
    #[error(
        "{place}: sensor {sensor} has several forces along one axis, so effects cannot be assigned to one of them; leave one fN_x_n and one fN_z_n"
    )]
    ManyForces { place: Location, sensor: u32 },
    #[error(
        "{place}: sensor {sensor} was not recorded on three independent axes, which the magnet's model needs; add them, or fit with --base polynomial"
    )]
    MissingAxes { place: Location, sensor: u32 },
    #[error("{place}: {what}; {advice}")]
    Orientation { place: Location, what: String, advice: String },
    #[error(
        "{place}: the force does not move beyond its noise: a constant load does not determine the response; record with a varying load, or remove this column: the force is then assumed to be zero"
    )]
    ConstantForce { place: Location },
    #[error(
        "the fit of sensor {sensor} did not converge ({reason}); check the nominal design in recording.toml, or fit with --base polynomial"
    )]
    NotConverged { sensor: u32, reason: String },
}

impl FitError {
    /// File, line and column, where the cause is in one.
    pub fn place(&self) -> Option<&Location> {
        match self {
            Self::Recording(error) => Some(&error.location),
            Self::NoDesign { place }
            | Self::NoForce { place, .. }
            | Self::NoForces { place }
            | Self::TooFewRows { place, .. }
            | Self::Saturated { place, .. }
            | Self::Stuck { place, .. }
            | Self::MissingAxes { place, .. }
            | Self::ForcesDiffer { place, .. }
            | Self::ManyForces { place, .. }
            | Self::Orientation { place, .. }
            | Self::ConstantForce { place } => Some(place),
            Self::DegreeWithoutForce { .. }
            | Self::TooManyTerms { .. }
            | Self::NotConverged { .. } => None,
        }
    }
}

/// Bootstrap options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FitOptions {
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Resamples of the bootstrap.
    pub draws: usize,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self { seed: 1, draws: 400 }
    }
}
