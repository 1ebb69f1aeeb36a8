//! All sensors of a campaign fitted, each on its own core.

use rayon::prelude::*;

use super::cylinder::{self, CylinderFit};
use super::polynomial::{self, PolynomialFit};
use super::rows::SensorRows;
use super::{AxisScore, FitError, Options, orientation};
use crate::physics::ForwardModel;
use crate::recordings::description::Design;
use crate::recordings::{Campaign, Notice, Place};

/// The fits of all sensors, in the order of their numbers.
#[derive(Clone, Debug)]
pub enum Fits {
    /// Cylinder base, with the nominal design it departs from.
    Cylinder(Design, Vec<CylinderFit>),
    /// Polynomial base.
    Polynomial(Vec<PolynomialFit>),
}

impl Fits {
    /// Held-out scores of every sensor and axis.
    pub fn scores(&self) -> Vec<AxisScore> {
        match self {
            Self::Cylinder(_, fits) => fits.iter().flat_map(|fit| fit.scores.clone()).collect(),
            Self::Polynomial(fits) => fits.iter().flat_map(|fit| fit.scores.clone()).collect(),
        }
    }
}

/// Fits the cylinder base to every sensor whose two forces were recorded; a sensor without them
/// is named in a notice. `done` is called after each sensor, from any thread.
pub fn cylinder(
    campaign: &Campaign,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<(Fits, Vec<Notice>), FitError> {
    let design = campaign.design().ok_or_else(|| FitError::NoDesign {
        place: Place::file(&campaign.folder),
    })?;
    let nominal = ForwardModel::nominal(design);
    let (mut rows, mut missing) = (Vec::new(), Vec::new());
    for sensor in campaign.sensors() {
        match SensorRows::with_own_forces(campaign, sensor) {
            Ok(found) => rows.push(found),
            Err(error @ FitError::NoForce { .. }) => missing.push(error),
            Err(error) => return Err(error),
        }
    }
    if rows.is_empty()
        && let Some(first) = missing.into_iter().next()
    {
        return Err(first);
    }
    let notices = campaign
        .sensors()
        .into_iter()
        .filter(|sensor| !rows.iter().any(|r| r.sensor == *sensor))
        .map(|sensor| Notice {
            place: Place::file(&campaign.folder),
            message: format!("sensor {sensor} was not fitted, since f{sensor}_x_n and f{sensor}_z_n were not both recorded"),
        })
        .collect();
    for rows in &rows {
        rows.check_moving(campaign)?;
        orientation::check(campaign, rows.sensor, &nominal)?;
    }
    let fits = rows
        .par_iter()
        .map(|rows| {
            let fit = cylinder::fit(rows, &nominal, options)?;
            done(rows.sensor);
            Ok(fit)
        })
        .collect::<Result<_, FitError>>()?;
    Ok((Fits::Cylinder(design.clone(), fits), notices))
}

/// Fits the polynomial base to every sensor.
pub fn polynomial(
    campaign: &Campaign,
    degree: Option<usize>,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<Fits, FitError> {
    let fits = campaign
        .sensors()
        .par_iter()
        .map(|&sensor| {
            let rows = SensorRows::with_recorded_forces(campaign, sensor)?;
            rows.check_moving(campaign)?;
            let fit = polynomial::fit(&rows, degree, options)?;
            done(sensor);
            Ok(fit)
        })
        .collect::<Result<_, FitError>>()?;
    Ok(Fits::Polynomial(fits))
}
