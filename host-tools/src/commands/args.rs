//! Arguments that several commands share.

use std::path::{Path, PathBuf};

use analysis::edit_model::parse_formulas;
use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;
use model_export::effects::EffectTerm;
use model_export::effects::expression::ParameterRange;
use model_export::fit::FitOptions;
use model_export::model_file::ModelFile;
use model_export::output::{Output, Overwrite};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::fingerprints;

use analysis::compare::Comparison;
use report::html::Section;
use report::text::terminal;

/// Clock alignment.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct AlignArgs {
    /// Delay of the reference's clock, added to its time stamps before alignment with the field [default: that of the model file;
    /// of a fit 0]. A constant delay of a logger belongs into the mapping of the import: `offset_s` of the force's clock.
    #[arg(long, value_name = "MS", allow_negative_numbers = true)]
    delay_ms: Option<f64>,
}

/// Maximum delay: an hour, as between time zones.
const MAX_DELAY_MS: f64 = 3.6e6;

impl AlignArgs {
    /// The alignment for a fit.
    pub fn alignment(self) -> Result<Alignment> {
        Ok(Alignment { delay_us: 1e3 * self.given_ms()?.unwrap_or_default() })
    }

    /// The alignment for recordings that a model is used with.
    pub fn of_model(self, model: &ModelFile) -> Result<Alignment> {
        Ok(model.alignment(self.given_ms()?))
    }

    /// The delay of `--delay-ms`.
    pub fn given_ms(self) -> Result<Option<f64>> {
        let is_possible = |ms: &f64| (-MAX_DELAY_MS..=MAX_DELAY_MS).contains(ms);
        if let Some(ms) = self.delay_ms.filter(|ms| !is_possible(ms)) {
            bail!(
                "--delay-ms {ms:?} is not possible here; give up to {MAX_DELAY_MS} ms either way"
            );
        }
        Ok(self.delay_ms)
    }
}

/// Whether a command replaces another file at its output path.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ForceArg {
    /// Replace the output file, whatever it holds [default: only an earlier result of the same inputs].
    #[arg(long)]
    force: bool,
}

impl ForceArg {
    /// What the command does with another file.
    pub fn overwrite(self) -> Overwrite {
        match self.force {
            true => Overwrite::Forced,
            false => Overwrite::UNFORCED,
        }
    }

    /// Refuses `--force` where a command writes a folder.
    pub fn check_folder(self, path: &Path) -> Result<()> {
        if self.force {
            let path = path.display();
            bail!("--force replaces a file, and {path} is to be a folder: leave --force out");
        }
        Ok(())
    }

    /// The HTML report at `path`, of these inputs.
    pub fn page(self, path: Option<&Path>, inputs: Vec<String>) -> Result<Option<Output>> {
        let check = |path| Output::check(path, report::html::MARK, inputs, self.overwrite());
        Ok(path.map(check).transpose()?)
    }
}

/// A model and a campaign to evaluate or refit it on.
#[derive(Debug, clap::Args)]
pub struct CampaignArgs {
    /// Model file written by `magpie fit`.
    pub model: PathBuf,
    /// Folder of recordings (or one recording).
    pub campaign: PathBuf,
    /// Options of the fits.
    #[command(flatten)]
    pub fit: FitArgs,
}

/// Options of every command that fits.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct FitArgs {
    /// Clock alignment.
    #[command(flatten)]
    pub align: AlignArgs,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

impl FitArgs {
    /// Options of every fit.
    pub fn options(&self) -> FitOptions {
        FitOptions { seed: self.seed, ..FitOptions::default() }
    }
}

/// A model, a campaign and an optional HTML report.
#[derive(Debug, clap::Args)]
pub struct CompareArgs {
    /// The model and the campaign.
    #[command(flatten)]
    pub input: CampaignArgs,
    /// HTML report to write.
    #[arg(short, long, value_name = "REPORT")]
    pub output: Option<PathBuf>,
    /// Whether another file is replaced.
    #[command(flatten)]
    pub force: ForceArg,
}

impl CompareArgs {
    /// The report, if one was requested; fails early if it could not be written later.
    pub fn page(&self) -> Result<Option<Output>> {
        match &self.output {
            Some(path) => self.force.page(Some(path), fingerprints(&self.input.campaign)?),
            None => Ok(None),
        }
    }

    /// Writes the report if one was requested; `sections` come from a diagnosis.
    pub fn write_report(
        &self,
        page: Option<&Output>,
        comparison: &Comparison,
        sections: &[Section],
    ) -> Result<()> {
        let Some(page) = page else {
            return Ok(());
        };
        report::html::write(page, comparison, sections)?;
        self.print_line(&format!("Report: {} (open in a browser)", page.path().display()))
    }

    /// Prints a line on stdout, or on stderr with `--json`.
    pub fn print_line(&self, line: &str) -> Result<()> {
        if self.input.fit.json {
            eprintln!("{line}");
        } else {
            terminal::print(&format!("{line}\n"))?;
        }
        Ok(())
    }
}

/// A grasped object by its contact stiffness, including the flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ObjectStiffness {
    /// Steel between the flexures.
    Rigid,
    /// Rubber.
    Medium,
    /// Foam.
    Soft,
}

impl ObjectStiffness {
    /// Contact stiffness in N/mm.
    pub fn contact_n_per_mm(self) -> f64 {
        match self {
            Self::Rigid => 333.0,
            Self::Medium => 50.0,
            Self::Soft => 5.0,
        }
    }
}

/// Parses the name of a stiffness.
///
/// # Errors
/// There is none; a number is a width, which another option has.
pub fn parse_object(text: &str) -> Result<ObjectStiffness, String> {
    ObjectStiffness::from_str(text, false).map_err(|_| match text.parse::<f64>() {
        Ok(_) => format!("give rigid, medium or soft; the width of an emulated object is --object-width-mm {text}"),
        Err(_) => "give rigid, medium or soft".to_owned(),
    })
}

/// Parses a number within an inclusive range.
pub fn parse_number(text: &str, (min, max): (f64, f64)) -> Result<f64, String> {
    let number = text.trim().parse().ok().filter(|number| (min..=max).contains(number));
    number.ok_or_else(|| format!("give a number from {min:e} to {max:e}"))
}

/// User-defined effects: formulas and the ranges of their nonlinear parameters.
#[derive(Debug, clap::Args)]
pub struct ExprArgs {
    /// User-defined effect: 'NAME: TARGET = FORMULA'.
    #[arg(long, value_name = "FORMULA")]
    expr: Vec<String>,
    /// Range in which the search for a nonlinear parameter of a formula starts, NAME=FROM..TO; the fit may leave it.
    #[arg(long, value_name = "NAME=FROM..TO", value_parser = parse_range)]
    range: Vec<ParameterRange>,
}

impl ExprArgs {
    /// True if no formula was given.
    pub fn is_empty(&self) -> bool {
        self.expr.is_empty()
    }

    /// Parses the formulas; each receives the ranges of the parameters that it contains.
    pub fn parse(&self, campaign: &Campaign) -> Result<Vec<EffectTerm>> {
        let first = campaign.recordings.first().context("the campaign is empty")?;
        let columns: Vec<String> = first.covariates.keys().cloned().collect();
        parse_formulas(&self.expr, &self.range, &columns)
            .map_err(|error| anyhow!("--expr: {error}"))
    }
}

/// Parses NAME=FROM..TO.
///
/// # Errors
/// The text has another form.
pub fn parse_range(text: &str) -> Result<ParameterRange, String> {
    let usage = || "write NAME=FROM..TO, as in p=2..5".to_owned();
    let (name, ends) = text.split_once('=').ok_or_else(usage)?;
    let (from, to) = ends.split_once("..").ok_or_else(usage)?;
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| usage());
    Ok(ParameterRange { name: name.trim().to_owned(), from: number(from)?, to: number(to)? })
}
