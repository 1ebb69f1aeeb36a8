//! Fits of a whole campaign.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::prelude::*;

use crate::effects::EffectTerm;
use crate::fit::base_model::{BaseKind, BaseModel, CylinderBase, PolynomialBase};
use crate::fit::cross_validation::CvSplit;
use crate::fit::joint::{self, BaseFits, JointFit};
use crate::fit::polynomial::{self, PolynomialFit};
use crate::fit::profile_likelihood::shape_profiles;
use crate::fit::rows::{SensorRows, own_forces};
use crate::fit::{AxisScore, FitError, FitOptions, orientation};
use crate::physics::{ForwardModel, SensorMounting};
use crate::recordings::columns::Axis;
use crate::recordings::description::NominalDesign;
use crate::recordings::in_order;
use crate::recordings::{Campaign, Location, Notice, Recording};

/// Fits of all sensors, in ascending order of their numbers.
#[derive(Clone, Debug)]
pub enum CampaignFits {
    /// Cylinder base, with its nominal design.
    Cylinder(NominalDesign, JointFit),
    /// Polynomial base.
    Polynomial(Vec<PolynomialFit>),
}

impl CampaignFits {
    /// Held-out scores of every sensor and axis.
    pub fn scores(&self) -> Vec<AxisScore> {
        match self {
            Self::Cylinder(_, fit) => {
                fit.sensors.iter().flat_map(|fit| fit.scores.clone()).collect()
            }
            Self::Polynomial(fits) => fits.iter().flat_map(|fit| fit.scores.clone()).collect(),
        }
    }
}

/// Rows and base models of a campaign, prepared for fits with effects.
pub struct FitSetup {
    /// Rows of each sensor that can be fitted.
    pub rows: Vec<SensorRows>,
    /// Base model of each sensor.
    pub bases: Vec<Arc<dyn BaseModel>>,
    /// The nominal design; `None` with the polynomial base.
    pub design: Option<NominalDesign>,
    /// Start polynomials of the polynomial base.
    pub polynomials: Vec<PolynomialFit>,
    /// One notice for each sensor that was not fitted.
    pub notices: Vec<Notice>,
    /// Fits without effects, computed on first use.
    base_fits: OnceLock<BaseFits>,
    /// Whether the rows are a sample, on which the shapes of effects are searched.
    is_sample: bool,
    /// Splits of models with transient effects, by the names of their effects.
    transient_splits: Mutex<BTreeMap<Vec<String>, CvSplit>>,
}

/// Rows of each recording on which the shapes of effects are searched, and by which effects and formulas are selected; the models
/// of the result are fitted to all rows. Where the residual is white noise, standard errors during the selection are larger by the
/// root of the ratio.
pub const SEARCH_ROWS: usize = 600;
/// Residual in noise floors up to which a fit with initial states is at its minimum.
const SETTLED: f64 = 1.1;
/// Rows of each recording on which initial states are searched again.
const STATE_ROWS: usize = 2400;
/// Share of the error by which that search must be better than the one on a sample.
const CLEARLY: f64 = 0.01;

impl FitSetup {
    /// With the cylinder base, for every sensor with a force recorded; the others, and forces that were not, are reported as notices.
    pub fn cylinder(campaign: &Campaign) -> Result<Self, FitError> {
        Self::cylinder_mounted(campaign, |_| None)
    }

    /// The same with known mountings of the sensors; those of others are found from the recordings.
    pub(crate) fn cylinder_mounted(
        campaign: &Campaign,
        known: impl Fn(u32) -> Option<SensorMounting> + Sync,
    ) -> Result<Self, FitError> {
        let design = campaign
            .design()
            .ok_or_else(|| FitError::NoDesign { place: Location::file(&campaign.folder) })?;
        let nominal = ForwardModel::nominal(design);
        let (mut rows, mut missing) = (Vec::new(), Vec::new());
        let sensors = campaign.sensors();
        let found = sensors.par_iter().map(|&sensor| SensorRows::with_own_forces(campaign, sensor));
        for found in found.collect::<Vec<_>>() {
            match found {
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
        if let Some(rows) = rows.iter().find(|rows| rows.copied_axes().contains(&true)) {
            let place = Location::file(&campaign.folder);
            return Err(FitError::MissingAxes { place, sensor: rows.sensor });
        }
        let rows_of_all = &rows;
        let mounted = in_order(rows.par_iter().map(|rows| {
            rows.check_excitation(campaign)?;
            match known(rows.sensor) {
                Some(mounting) => {
                    orientation::check(campaign, rows, &nominal, mounting)?;
                    Ok((mounting, None))
                }
                None => orientation::find(campaign, rows, rows_of_all, &nominal),
            }
        }))?;
        let base = |mounting: &SensorMounting| {
            Arc::new(CylinderBase { nominal: mounting.nominal(&nominal) }) as Arc<dyn BaseModel>
        };
        let bases = mounted.iter().map(|(mounting, _)| base(mounting)).collect();
        let mut notices = left_out(campaign, &rows, BaseKind::Cylinder);
        let mounted = rows.into_iter().zip(mounted).map(|(rows, (mounting, notice))| {
            notices.extend(notice);
            rows.turned(mounting.orientation)
        });
        let rows = mounted.collect();
        Ok(Self {
            bases,
            notices,
            rows,
            design: Some(design.clone()),
            polynomials: Vec::new(),
            base_fits: OnceLock::new(),
            is_sample: false,
            transient_splits: Mutex::default(),
        })
    }

    /// With polynomials of the recorded forces, of the given degree or of the least degree that serves all sensors.
    ///
    /// # Errors
    /// Several forces along one axis: effects could not be assigned to one of them.
    pub fn polynomial(
        campaign: &Campaign,
        degree: Option<usize>,
        options: FitOptions,
    ) -> Result<Self, FitError> {
        let (rows, polynomials): (Vec<_>, Vec<_>) =
            polynomials(campaign, degree, options, |_| ())?.into_iter().unzip();
        let base = |(fit, rows): (&PolynomialFit, &SensorRows)| {
            let width_g = rows.field_span().amax();
            let base = PolynomialBase::new(fit.model.clone(), width_g);
            base.map(|base| Arc::new(base) as Arc<dyn BaseModel>).ok_or_else(|| {
                FitError::ManyForces { place: Location::file(&campaign.folder), sensor: fit.sensor }
            })
        };
        let notices = left_out(campaign, &rows, BaseKind::Polynomial);
        Ok(Self {
            bases: polynomials.iter().zip(&rows).map(base).collect::<Result<_, _>>()?,
            rows,
            design: None,
            polynomials,
            notices,
            base_fits: OnceLock::new(),
            is_sample: false,
            transient_splits: Mutex::default(),
        })
    }

    /// The same, as a sample of the rows of another setup.
    fn into_sample(self) -> Self {
        Self { is_sample: true, ..self }
    }

    /// The same bases with other rows; sensors without a base are left out.
    pub fn with_rows(&self, rows: Vec<SensorRows>) -> Self {
        let base = |rows: &SensorRows| {
            let place = self.rows.iter().position(|own| own.sensor == rows.sensor)?;
            self.bases.get(place).cloned()
        };
        let (rows, bases): (Vec<_>, Vec<_>) =
            rows.into_iter().filter_map(|rows| base(&rows).map(|base| (rows, base))).unzip();
        Self {
            rows,
            bases,
            design: self.design.clone(),
            polynomials: self.polynomials.clone(),
            notices: Vec::new(),
            base_fits: OnceLock::new(),
            is_sample: false,
            transient_splits: Mutex::default(),
        }
    }

    /// The same with at most `count` rows of each recording.
    pub fn sampled(&self, count: usize) -> Self {
        self.with_rows(self.rows.iter().map(|rows| rows.at_most(|_| count)).collect()).into_sample()
    }

    /// The same, of more than ten recordings with the first of each fold of the cross-validation only.
    pub fn sampled_by_fold(&self, count: usize) -> Self {
        let of = |rows: &SensorRows| {
            let split = CvSplit::Recordings(rows.parts.len());
            let is_first =
                |place: usize| place == 0 || split.fold_of(place) != split.fold_of(place - 1);
            rows.at_most(|place| if is_first(place) { count } else { 0 })
        };
        self.with_rows(self.rows.iter().map(of).collect()).into_sample()
    }

    /// Number of recordings, with rows or not: that of the parameters of each recording.
    pub fn recordings(&self) -> usize {
        self.rows.first().map_or(0, |rows| rows.parts.len())
    }

    /// Number of recordings with rows of any sensor.
    pub fn recording_count(&self) -> usize {
        self.rows.iter().map(SensorRows::filled_parts).max().unwrap_or(0)
    }

    /// Rows of all sensors.
    pub fn row_count(&self) -> usize {
        self.rows.iter().map(SensorRows::len).sum()
    }

    /// Fits the base with these effects, cross-validated by `split`. Of many rows the shapes of the effects are searched on a
    /// sample, as a diagnosis searches them. `done` is called after each sensor, from any thread.
    pub fn fit(
        &self,
        effects: &[EffectTerm],
        split: CvSplit,
        options: FitOptions,
        done: impl Fn(u32) + Sync,
    ) -> Result<JointFit, FitError> {
        let sample = (!effects.is_empty() && !self.is_sample)
            .then(|| self.sampled_by_fold(SEARCH_ROWS))
            .filter(|sample| sample.row_count() < self.row_count());
        let near = sample.and_then(|sample| sample.fit_once(effects, options).ok());
        self.fit_near(near.as_ref(), effects, (split, options), done)
    }

    /// The same, from the fit `near` of these effects to a sample of the rows; without one, all rows are searched.
    pub fn fit_near(
        &self,
        near: Option<&JointFit>,
        effects: &[EffectTerm],
        how: (CvSplit, FitOptions),
        done: impl Fn(u32) + Sync,
    ) -> Result<JointFit, FitError> {
        let base_fits = self.base_fits()?;
        let fit = |near: Option<&JointFit>, done: &(dyn Fn(u32) + Sync)| {
            joint::fit(&self.rows, &self.bases, base_fits, effects, near, how, done)
        };
        let of_sample = near.and_then(|near| fit(Some(near), &done).ok());
        // Where a sample determines too little, all rows are searched.
        let Some(of_sample) = of_sample else { return fit(None, &done) };
        let rms_g = of_sample.tally().mean_square().sqrt();
        let has_states = effects.iter().any(EffectTerm::has_initial_state);
        if !has_states || rms_g <= SETTLED * of_sample.tally().floor_g() {
            return Ok(of_sample);
        }
        // The states of friction at the start of a recording may be those of another minimum: where structure is left, they are
        // searched on more rows.
        let denser = self.sampled(STATE_ROWS);
        let direct = denser.fit_once(effects, how.1)?;
        let known = denser.refit(&of_sample, effects, CvSplit::Recordings(0), how.1)?;
        let is_better =
            direct.fitted_mean_square() < (1.0 - CLEARLY).powi(2) * known.fitted_mean_square();
        if is_better { fit(Some(&direct), &|_| ()) } else { Ok(of_sample) }
    }

    /// A fit without cross-validation.
    fn fit_once(&self, effects: &[EffectTerm], options: FitOptions) -> Result<JointFit, FitError> {
        let how = (CvSplit::Recordings(0), options);
        joint::fit(&self.rows, &self.bases, self.base_fits()?, effects, None, how, |_| ())
    }

    /// The same, from a fit `near` of these effects to a sample of the rows ([`FitSetup::sampled`]): the shapes of the effects
    /// are not searched again.
    pub fn refit(
        &self,
        near: &JointFit,
        effects: &[EffectTerm],
        split: CvSplit,
        options: FitOptions,
    ) -> Result<JointFit, FitError> {
        let (base_fits, how) = (self.base_fits()?, (split, options));
        joint::fit(&self.rows, &self.bases, base_fits, effects, Some(near), how, |_| ())
    }

    /// Searches the shapes of the effects that the recordings do not exclude, for the standard errors of their magnitudes.
    pub fn search_profiles(&self, fit: &mut JointFit, effects: &[EffectTerm]) {
        let mut effects = effects.to_vec();
        effects.sort_by_key(EffectTerm::stage);
        fit.profiles = shape_profiles((&self.rows, &self.bases), &effects, fit);
    }

    fn base_fits(&self) -> Result<&BaseFits, FitError> {
        if let Some(base_fits) = self.base_fits.get() {
            return Ok(base_fits);
        }
        let base_fits = BaseFits::new(&self.rows, &self.bases)?;
        Ok(self.base_fits.get_or_init(|| base_fits))
    }

    /// Cross-validation split for a fit with these effects: by recordings, or within them if an effect is transient.
    pub fn split(&self, effects: &[EffectTerm]) -> CvSplit {
        if !effects.iter().any(EffectTerm::is_transient) {
            return CvSplit::of(&self.rows);
        }
        let mut names: Vec<String> = effects.iter().map(|of| of.name().to_owned()).collect();
        names.sort_unstable();
        names.dedup();
        let mut known = self.transient_splits.lock().unwrap_or_else(PoisonError::into_inner);
        *known.entry(names).or_insert_with_key(|names| {
            let named = |name: &String| effects.iter().find(|effect| effect.name() == name);
            let effects: Vec<EffectTerm> = names.iter().filter_map(named).cloned().collect();
            CvSplit::within(&self.rows, self.correlation_s(&effects))
        })
    }

    /// Longest correlation time in seconds of the residual with these effects; zero where they cannot be fitted.
    fn correlation_s(&self, effects: &[EffectTerm]) -> f64 {
        let sample = self.sampled_by_fold(SEARCH_ROWS);
        let setup = if sample.row_count() < self.row_count() { &sample } else { self };
        let fit = setup.fit_once(effects, FitOptions::default());
        let sensors = fit.map_or_else(|_| Vec::new(), |fit| fit.sensors);
        sensors.iter().map(|sensor| sensor.correlation_s).fold(0.0, f64::max)
    }
}

/// What of the campaign is not fitted: sensors without a force, forces that were not measured, and rows of a long campaign.
fn left_out(campaign: &Campaign, rows: &[SensorRows], base: BaseKind) -> Vec<Notice> {
    let notice = |message| Notice { location: Location::file(&campaign.folder), message };
    let sensors = campaign.sensors().into_iter();
    let without = sensors.filter(|sensor| !rows.iter().any(|own| own.sensor == *sensor));
    let of_sensors = without.map(|sensor| {
        let is_incomplete = |recording: &&Recording| {
            let mut forces = own_forces(sensor).into_iter();
            !forces.all(|force| recording.forces.contains_key(&force))
        };
        let incomplete = campaign.recordings.iter().filter(is_incomplete);
        let names: Vec<&str> = incomplete.map(|recording| recording.name.as_str()).collect();
        let place = if names.len() == campaign.recordings.len() {
            String::new()
        } else {
            format!(" in recording {}", names.join(", "))
        };
        notice(format!(
            "sensor {sensor} was not fitted, since f{sensor}_x_n and f{sensor}_z_n were not both recorded{place}"
        ))
    });
    let of_forces = unmeasured(campaign, rows, base).into_iter().map(notice);
    let stride = rows.iter().map(|rows| rows.stride).max().unwrap_or(1);
    let of_rows = (stride > 1).then(|| {
        notice(format!(
            "one in {stride} of the {} rows is fitted: where the residual is white noise, standard errors are {:.1} times those with all rows",
            campaign.row_count(),
            (stride as f64).sqrt()
        ))
    });
    of_sensors.chain(of_forces).chain(of_rows).collect()
}

/// Forces at the places of sensors that their models are not fitted to, each with the consequence.
fn unmeasured(campaign: &Campaign, rows: &[SensorRows], base: BaseKind) -> Vec<String> {
    let mut sensors: BTreeMap<(u32, Axis), Vec<String>> = BTreeMap::new();
    for rows in rows {
        let Some((place, _)) = rows.forces.first() else { continue };
        for force in own_forces(*place).into_iter().filter(|force| !rows.forces.contains(force)) {
            sensors.entry(force).or_default().push(rows.sensor.to_string());
        }
    }
    let sentence = |(force, sensors): ((u32, Axis), Vec<String>)| {
        let (place, axis) = (force.0, force.1.letter());
        let is_recorded = campaign.recordings.iter().any(|of| of.forces.contains_key(&force));
        let why = if is_recorded { "is zero within its noise" } else { "was not recorded" };
        let consequence = match base {
            BaseKind::Cylinder => {
                format!("stiffness_{axis} is not identifiable (?) and stays at the design's value")
            }
            BaseKind::Polynomial => format!("F{axis} is not estimated"),
        };
        let plural = if sensors.len() > 1 { "s" } else { "" };
        format!(
            "f{place}_{axis}_n {why}: for sensor{plural} {} the force along {axis} is assumed to be zero, and {consequence}; a force that acts along {axis} changes the field, and this error is part of that of the measured force",
            sensors.join(", ")
        )
    };
    sensors.into_iter().map(sentence).collect()
}

/// Fits the cylinder base without effects.
pub fn cylinder(
    campaign: &Campaign,
    options: FitOptions,
    done: impl Fn(u32) + Sync,
) -> Result<(CampaignFits, Vec<Notice>), FitError> {
    let setup = FitSetup::cylinder(campaign)?;
    let fit = setup.fit(&[], setup.split(&[]), options, done)?;
    let design = setup
        .design
        .ok_or_else(|| FitError::NoDesign { place: Location::file(&campaign.folder) })?;
    Ok((CampaignFits::Cylinder(design, fit), setup.notices))
}

/// Fits the polynomial base to every sensor.
pub fn polynomial(
    campaign: &Campaign,
    degree: Option<usize>,
    options: FitOptions,
    done: impl Fn(u32) + Sync,
) -> Result<(CampaignFits, Vec<Notice>), FitError> {
    let (fits, rows): (Vec<_>, Vec<_>) = polynomials(campaign, degree, options, done)?
        .into_iter()
        .map(|(rows, fit)| (fit, rows))
        .unzip();
    Ok((CampaignFits::Polynomial(fits), left_out(campaign, &rows, BaseKind::Polynomial)))
}

fn polynomials(
    campaign: &Campaign,
    degree: Option<usize>,
    options: FitOptions,
    done: impl Fn(u32) + Sync,
) -> Result<Vec<(SensorRows, PolynomialFit)>, FitError> {
    let rows = in_order(campaign.sensors().par_iter().map(|&sensor| {
        let rows = SensorRows::with_recorded_forces(campaign, sensor)?;
        rows.check_excitation(campaign).map(|()| rows)
    }))?;
    if let (Some(degree @ 1..), Some(first)) = (degree, rows.first())
        && rows.iter().all(|rows| rows.forces.is_empty())
    {
        return Err(FitError::DegreeWithoutForce { sensor: first.sensor, degree });
    }
    let fits = in_order(
        rows.par_iter()
            .map(|rows| polynomial::fit(rows, degree, options).inspect(|_| done(rows.sensor))),
    )?;
    // All sensors have the degree that one of them needs: effects that are not in the model yet hide the curvature of another.
    let common = fits.iter().map(|fit| fit.model.degree).max();
    in_order(rows.into_par_iter().zip(fits).map(|(rows, fit)| {
        if Some(fit.model.degree) == common || rows.forces.is_empty() {
            return Ok((rows, fit));
        }
        let raised = polynomial::fit(&rows, common, options)?;
        Ok((rows, PolynomialFit { tried: fit.tried, ..raised }))
    }))
}
