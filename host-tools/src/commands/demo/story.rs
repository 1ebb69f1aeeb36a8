//! The second half of the story: where the model fails, which effect is missing, and the error falling as
//! it is added.

use std::path::Path;

use anyhow::{Context, Result};
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::model_file::ModelFile;
use model_export::recordings::Campaign;

use super::ALIGNMENT;
use crate::commands::change::{self, named};
use crate::commands::diagnose::text;
use crate::commands::replay;
use crate::compare::compute::compare;
use crate::compare::words;
use crate::diagnose::Diagnosis;
use crate::diagnose::compute::compute;
use crate::{progress, report, show};

/// What has been told so far.
pub struct Told<'a> {
    /// Folder of the whole campaign.
    pub folder: &'a Path,
    /// The recordings that were fitted.
    pub campaign: &'a Campaign,
    /// Folder of the recording that was put aside.
    pub held_out: &'a Path,
    /// The fitted model and its file.
    pub model: &'a ModelFile,
    /// See `model`.
    pub model_path: &'a Path,
    /// What the device made of the recording that was put aside.
    pub before: &'a replay::Outcome,
    /// Where everything goes.
    pub output: &'a Path,
    /// Of every fit.
    pub options: Options,
}

/// Steps of the error through the device's code: what was added, and newtons.
type Fall = Vec<(String, f64)>;

/// Tells the rest.
pub fn rest(told: &Told) -> Result<()> {
    let comparison = compare(told.model_path, told.folder, None, ALIGNMENT, told.options)?;
    show::page(&format!(
        "5. Where it fails. The model beside the measurement, over all recordings.\n\n{}\n",
        show::paragraph(&words::verdict(&comparison))
    ))?;
    let bar = progress::rows("diagnosing");
    let said = |what: &str| bar.set_message(what.to_owned());
    let mut diagnosis = compute(
        told.campaign,
        told.model,
        told.model_path,
        &[],
        told.options,
        &said,
    )?;
    bar.finish_and_clear();
    diagnosis.campaign = told.folder.display().to_string();
    show::page(&format!(
        "{}\n{}",
        show::paragraph(
            "6. Which physics is missing. Each effect of the catalogue is tried on the recordings that were \
             fitted, and judged by what it foretells of one of them from the others."
        ),
        text::story(&diagnosis)
    ))?;
    let fall = add(told, &diagnosis)?;
    show::page(&format!("7. The error falls.\n\n{}\n", table(told, &fall)))?;
    let path = told.output.join("report.html");
    report::write(&path, &comparison, &report::diagnosis::sections(&diagnosis))?;
    show::page(&format!(
        "8. To look at: {} shows all of it as plots.\n\n",
        path.display()
    ))?;
    Ok(())
}

/// Adds what was found, one effect after the other, and lets the device read the recording that was put
/// aside with each.
fn add(told: &Told, diagnosis: &Diagnosis) -> Result<Fall> {
    let mut fall = vec![(
        "the model as it was fitted".to_owned(),
        replay::report::rmse_n(&told.before.fitted),
    )];
    let mut added: Vec<Addition> = Vec::new();
    for (i, step) in diagnosis.accepted.iter().enumerate() {
        // Of a tie the story takes the first; a person would choose, or record what tells them apart.
        let first = step.first().context("an empty step")?.clone();
        added.extend(named(&[first], &[])?);
        let change = change::compute(
            told.campaign.clone(),
            told.model,
            Vec::new(),
            added.clone(),
            ALIGNMENT,
            told.options,
        )?;
        let path = told.output.join(format!("better-{}.toml", i + 1));
        change.model.write(&path)?;
        let after = replay::outcome(&path, told.held_out, None, ALIGNMENT)?;
        let newtons = replay::report::rmse_n(&after.fitted);
        fall.push((format!("+ {}", step.join(" or ")), newtons));
    }
    Ok(fall)
}

fn table(told: &Told, fall: &Fall) -> String {
    if fall.len() < 2 {
        return show::paragraph(
            "There is nothing to add: no effect of the catalogue was found missing. (A formula of your own is \
             a candidate like any other: `magpie diagnose --expr`.)",
        );
    }
    let mut table = show::table(["with", "error / N"]);
    for (with, newtons) in fall {
        table.add_row([with.clone(), format!("{newtons:.3}")]);
    }
    show::right_align(&mut table, 1);
    let tie = match fall.iter().any(|(with, _)| with.contains(" or ")) {
        true => {
            "Where it says \"or\", these recordings do not tell which; the story goes on with the first.\n"
        }
        false => "",
    };
    format!(
        "RMSE over all forces of the recording that was put aside, by the device's own code in integers:\n\n\
         {table}\n{tie}The models are better-1.toml and so on, in {}.\n",
        told.output.display()
    )
}
