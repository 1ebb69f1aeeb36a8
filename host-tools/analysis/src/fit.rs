//! Fit of the base physics to a campaign.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Result, bail};
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::JointFit;
use model_export::fit::{self, CampaignFits, FitOptions};
use model_export::model_file::{BaseKind, ModelFile, Provenance};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::{Campaign, Location, Notice};

use crate::compare::ForceError;
use crate::compare::campaign_reader::check_distinct;
use crate::compare::force_errors::{ForceEvaluation, held_out_forces};
use crate::data_quality::campaign_checks::campaign_findings;
use crate::data_quality::{Finding, scan_files};
use crate::notes::{Note, collect};
use crate::progress;

/// A fitted model and what it was fitted to.
pub struct CampaignFit {
    /// The recordings.
    pub campaign: Campaign,
    /// Fits of all sensors.
    pub fits: CampaignFits,
    pub model: ModelFile,
    /// Held-out force error; `None` if the base has no inverse.
    pub force: Option<ForceError>,
    /// Notes on the recordings and on the fit.
    pub notes: Vec<Note>,
}

/// Reads a campaign and fits the base physics to all sensors. Without a `degree`, that of a polynomial is chosen by
/// held-out error.
///
/// # Errors
/// A recording cannot be read, two are the same data, or the fit fails.
pub fn fit_model(
    folder: &Path,
    base: BaseKind,
    degree: Option<u8>,
    alignment: Alignment,
    options: FitOptions,
) -> Result<CampaignFit> {
    collect(|notes| {
        // Files are scanned while others are read: recordings are often fewer than twice the cores.
        let steps = 2 * recording_folders(folder)?.len();
        let bar = progress::progress_bar("reading and checking", steps);
        let (campaign, scanned) = rayon::join(
            || Campaign::read(folder, alignment, |_| bar.inc(1)),
            || scan_files(folder, alignment, |_| bar.inc(1)),
        );
        bar.finish_and_clear();
        let campaign = campaign?;
        let findings = data_findings(scanned?, &campaign);
        let wrong_unit = findings.iter().find(|finding| finding.is_channel_unit()).cloned();
        notes.extend(campaign.notices().cloned().map(Note::Recording));
        notes.extend(unused_forces(&campaign).map(Note::Recording));
        let findings = findings.into_iter().chain(campaign_findings(&campaign));
        notes.extend(findings.map(Box::new).map(Note::SetupError));
        if let Some(finding) = wrong_unit {
            let advice = if finding.fix.is_some() {
                "a fit with --fix NEW corrects a copy"
            } else {
                "correct its scale, or remove the columns of its sensor"
            };
            bail!(
                "{}: its unit is not that of the other channels, see the note; {advice}",
                finding.place
            );
        }
        let (fits, notices) = fit_campaign(&campaign, base, degree, options)?;
        notes.extend(notices.into_iter().map(Note::Recording));
        let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
        let sources = provenance.recordings.iter();
        check_distinct(&provenance.campaign, sources.map(|r| (&*r.name, &*r.sha256)))?;
        let mut model = ModelFile::of(&campaign, &fits, provenance);
        let bar = progress::progress_bar("replaying on the device's code", 1);
        let evaluate = |setup: &FitSetup, fit: &JointFit| {
            let evaluated =
                held_out_forces((&campaign, &[]), setup, &[(fit, &[])], alignment, false, options);
            evaluated.map(|forces| forces.into_iter().next().unwrap_or_default())
        };
        let forces = match &fits {
            CampaignFits::Cylinder(_, fit) => evaluate(&FitSetup::cylinder(&campaign)?, fit)?,
            CampaignFits::Polynomial(_) if model.has_force_polynomials() => {
                let setup = model.fit_setup(&campaign, options)?;
                evaluate(&setup, &setup.fit(&[], setup.split(&[]), options, |_| ())?)?
            }
            CampaignFits::Polynomial(_) => ForceEvaluation::default(),
        };
        bar.finish_and_clear();
        model.inverse = forces.shape;
        notes.extend(forces.none.map(Note::NoForces));
        let force = forces.error;
        Ok(CampaignFit { campaign, fits, model, force, notes: std::mem::take(notes) })
    })
}

/// Forces on sensors without a field: probably with another number.
pub(crate) fn unused_forces(campaign: &Campaign) -> impl Iterator<Item = Notice> {
    let sensors = campaign.sensors();
    let forces: BTreeSet<u32> = campaign
        .recordings
        .iter()
        .flat_map(|recording| recording.forces.keys().map(|(sensor, _)| *sensor))
        .collect();
    let unused = forces.into_iter().filter(move |force| !sensors.contains(force));
    let folder = campaign.folder.clone();
    unused.map(move |force| Notice {
        location: Location::file(&folder).column(format!("f{force}")),
        message: format!(
            "forces of sensor {force} were recorded, but no field s{force}: they are not used; where they act on another sensor, \
             give them its number"
        ),
    })
}

/// Of the setup errors in its files those that affect the fit, except in files that a notice of the reader covers already.
pub(crate) fn data_findings(mut findings: Vec<Finding>, campaign: &Campaign) -> Vec<Finding> {
    let covers = |notice: &Notice, finding: &Finding| {
        let (of, place) = (&notice.location, &finding.place);
        of.file == place.file && (of.column.is_none() || of.column == place.column)
    };
    let is_new = |finding: &Finding| {
        // A constant covariate does not affect a fit that does not use it.
        finding.id != "constant_covariate"
            && (finding.stops || !campaign.notices().any(|notice| covers(notice, finding)))
    };
    findings.retain(is_new);
    findings
}

/// Fits the base physics to all sensors, with progress; also returns the notices of the fit.
pub fn fit_campaign(
    campaign: &Campaign,
    base: BaseKind,
    degree: Option<u8>,
    options: FitOptions,
) -> Result<(CampaignFits, Vec<Notice>)> {
    let bar = progress::progress_bar("fitting sensors", campaign.sensors().len());
    let result = match base {
        BaseKind::Cylinder => fit::campaign::cylinder(campaign, options, |_| bar.inc(1))?,
        BaseKind::Polynomial => {
            let degree = degree.map(usize::from);
            fit::campaign::polynomial(campaign, degree, options, |_| bar.inc(1))?
        }
    };
    bar.finish_and_clear();
    Ok(result)
}
