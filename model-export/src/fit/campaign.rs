//! From a campaign to its fits.

use std::sync::OnceLock;

use rayon::prelude::*;

use super::base::{Base, CylinderBase, PolynomialBase};
use super::folds::Split;
use super::joint::{self, JointFit};
use super::polynomial::{self, PolynomialFit};
use super::rows::SensorRows;
use super::sensor::State;
use super::{AxisScore, FitError, Options, orientation};
use crate::effects::Addition;
use crate::physics::ForwardModel;
use crate::recordings::description::Design;
use crate::recordings::{Campaign, Notice, Place};

/// The fits of all sensors, in the order of their numbers.
#[derive(Clone, Debug)]
pub enum Fits {
    /// Cylinder base, with the nominal design it departs from.
    Cylinder(Design, JointFit),
    /// Polynomial base.
    Polynomial(Vec<PolynomialFit>),
}

impl Fits {
    /// Held-out scores of every sensor and axis.
    pub fn scores(&self) -> Vec<AxisScore> {
        match self {
            Self::Cylinder(_, fit) => fit
                .sensors
                .iter()
                .flat_map(|fit| fit.scores.clone())
                .collect(),
            Self::Polynomial(fits) => fits.iter().flat_map(|fit| fit.scores.clone()).collect(),
        }
    }
}

/// What a fit with effects needs of a campaign.
pub struct Prepared {
    /// Rows of each sensor that can be fitted.
    pub rows: Vec<SensorRows>,
    /// The base of each.
    pub bases: Vec<Box<dyn Base>>,
    /// The nominal design; `None` with the polynomial base.
    pub design: Option<Design>,
    /// With the polynomial base: the polynomials from which it departs.
    pub polynomials: Vec<PolynomialFit>,
    /// Sensors that could not be fitted.
    pub notices: Vec<Notice>,
    /// The fits of the bases alone, once they were needed.
    alone: OnceLock<Vec<State>>,
}

impl Prepared {
    /// With the cylinder base, for every sensor whose two forces were recorded; a sensor without them
    /// is named in a notice.
    pub fn cylinder(campaign: &Campaign) -> Result<Self, FitError> {
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
        for rows in &rows {
            rows.check_moving(campaign)?;
            orientation::check(campaign, rows.sensor, &nominal)?;
        }
        let base = || Box::new(CylinderBase { nominal }) as Box<dyn Base>;
        Ok(Self {
            bases: rows.iter().map(|_| base()).collect(),
            notices: left_out(campaign, &rows),
            rows,
            design: Some(design.clone()),
            polynomials: Vec::new(),
            alone: OnceLock::new(),
        })
    }

    /// With polynomials of `degree` of whatever forces were recorded (chosen by held-out error where
    /// it is not given).
    ///
    /// # Errors
    /// Among others: more than one force along an axis, since an effect would not know which it
    /// belongs to.
    pub fn polynomial(
        campaign: &Campaign,
        degree: Option<usize>,
        options: Options,
    ) -> Result<Self, FitError> {
        let (rows, polynomials): (Vec<_>, Vec<_>) = polynomials(campaign, degree, options, |_| ())?
            .into_iter()
            .unzip();
        let base = |(fit, rows): (&PolynomialFit, &SensorRows)| {
            let width_g = rows.field_span().amax();
            let base = PolynomialBase::new(fit.model.clone(), width_g);
            base.map(|base| Box::new(base) as Box<dyn Base>)
                .ok_or_else(|| FitError::ManyForces {
                    place: Place::file(&campaign.folder),
                    sensor: fit.sensor,
                })
        };
        Ok(Self {
            bases: polynomials
                .iter()
                .zip(&rows)
                .map(base)
                .collect::<Result<_, _>>()?,
            rows,
            design: None,
            polynomials,
            notices: Vec::new(),
            alone: OnceLock::new(),
        })
    }

    /// Fits the base with these effects, judged by `split`. `done` is called after each sensor, from
    /// any thread.
    pub fn fit(
        &self,
        effects: &[Addition],
        split: Split,
        options: Options,
        done: impl Fn(u32) + Sync,
    ) -> Result<JointFit, FitError> {
        let alone = match self.alone.get() {
            Some(alone) => alone,
            None => {
                let alone = joint::bases(&self.rows, &self.bases)?;
                self.alone.get_or_init(|| alone)
            }
        };
        joint::fit(
            &self.rows,
            &self.bases,
            alone,
            effects,
            split,
            options,
            done,
        )
    }

    /// How a fit with these effects is judged.
    pub fn split(&self, effects: &[Addition]) -> Split {
        Split::of(
            &self.rows,
            effects.iter().any(Addition::lives_in_one_recording),
        )
    }
}

fn left_out(campaign: &Campaign, rows: &[SensorRows]) -> Vec<Notice> {
    campaign
        .sensors()
        .into_iter()
        .filter(|sensor| !rows.iter().any(|r| r.sensor == *sensor))
        .map(|sensor| Notice {
            place: Place::file(&campaign.folder),
            message: format!("sensor {sensor} was not fitted, since f{sensor}_x_n and f{sensor}_z_n were not both recorded"),
        })
        .collect()
}

/// Fits the cylinder base alone.
pub fn cylinder(
    campaign: &Campaign,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<(Fits, Vec<Notice>), FitError> {
    let prepared = Prepared::cylinder(campaign)?;
    let fit = prepared.fit(&[], prepared.split(&[]), options, done)?;
    let design = prepared.design.ok_or_else(|| FitError::NoDesign {
        place: Place::file(&campaign.folder),
    })?;
    Ok((Fits::Cylinder(design, fit), prepared.notices))
}

/// Fits the polynomial base to every sensor.
pub fn polynomial(
    campaign: &Campaign,
    degree: Option<usize>,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<Fits, FitError> {
    let fits = polynomials(campaign, degree, options, done)?;
    Ok(Fits::Polynomial(
        fits.into_iter().map(|(_, fit)| fit).collect(),
    ))
}

fn polynomials(
    campaign: &Campaign,
    degree: Option<usize>,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<Vec<(SensorRows, PolynomialFit)>, FitError> {
    campaign
        .sensors()
        .par_iter()
        .map(|&sensor| {
            let rows = SensorRows::with_recorded_forces(campaign, sensor)?;
            rows.check_moving(campaign)?;
            let fit = polynomial::fit(&rows, degree, options)?;
            done(sensor);
            Ok((rows, fit))
        })
        .collect()
}
