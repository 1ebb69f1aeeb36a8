//! `magpie add` and `magpie remove`: a model refitted with other effects.

use std::path::PathBuf;

use analysis::compare::campaign_reader::read_campaign;
use analysis::edit_model::{edited_effects, edited_output, find_effects, refit};
use analysis::model::Model;
use anyhow::{Result, bail};
use model_export::effects::EffectTerm;
use model_export::recordings::Campaign;
use report::text::edit_model::{format_report, to_json};
use report::text::terminal;

use crate::commands::args::{CampaignArgs, ExprArgs, ForceArg};
use crate::commands::output::print_notes;

/// Arguments of `add` and `remove`.
#[derive(Debug, clap::Args)]
struct EditArgs {
    #[command(flatten)]
    input: CampaignArgs,
    /// Model file to write.
    #[arg(short, long, value_name = "NEW")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
}

/// Reads the inputs, refits before and after the edit, prints the report and writes the new model.
fn edit(
    args: &EditArgs,
    edit_effects: impl Fn(&Model, &Campaign) -> Result<Vec<EffectTerm>>,
) -> Result<()> {
    let model = Model::read(&args.input.model)?;
    let alignment = args.input.fit.align.of_model(&model.file)?;
    let options = args.input.fit.options();
    let campaign = read_campaign(&args.input.campaign, alignment)?;
    let after = edit_effects(&model, &campaign)?;
    let check = |path| edited_output(path, &model, &after, &campaign, args.force.overwrite());
    let output = args.output.as_deref().map(check).transpose()?;
    let edited = refit(campaign, &model, after, alignment, options)?;
    print_notes(&edited.notes);
    terminal::print_result(args.input.fit.json, || to_json(&edited), || format_report(&edited))?;
    if let Some(output) = &output {
        edited.model.write_output(output)?;
    }
    if !args.input.fit.json {
        terminal::print_written(args.output.as_deref(), "-o NEW")?;
    }
    Ok(())
}

/// Add physical effects to a model, refit it, and report the error before and after.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie add model.toml tests/data/demo neighbour_magnet -o better.toml
  cargo magpie add model.toml my-campaign hysteresis magnet_temperature -o better.toml
  cargo magpie add model.toml my-campaign -o better.toml --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'

In a formula, names ending in a unit are covariates (the recording's columns, opening_rate_mm_per_s, fx_n, fz_n, \
fx_rate_n_per_s, fz_rate_n_per_s, temp_c, time_s, session_s), names with a --range are nonlinear parameters, all \
others are coefficients. lag(COVARIATE, SECONDS) is the covariate after a first-order low pass; SECONDS is a \
number or a name with a --range. TARGET is a force (fx_n, fz_n), a displacement of the magnet (dx_um, dy_um, \
dz_um), its tilt (tilt_x_mrad, tilt_z_mrad), a field (bx_g, by_g, bz_g), a gain (gain_percent, gain_x_percent, \
...) or a rotation of the sensor (rotation_x_mrad, ...).")]
pub struct AddArgs {
    #[command(flatten)]
    edit: EditArgs,
    /// Catalogue effects (listed by `magpie effects`).
    #[arg(value_name = "EFFECT")]
    effects: Vec<String>,
    #[command(flatten)]
    exprs: ExprArgs,
}

/// Runs the command.
pub fn run_add(args: &AddArgs) -> Result<()> {
    if args.effects.is_empty() && args.exprs.is_empty() {
        bail!("name an effect (`cargo magpie effects` lists them), or give a formula with --expr");
    }
    edit(&args.edit, |model, campaign| {
        let added = find_effects(&args.effects, &args.exprs.parse(campaign)?)?;
        edited_effects(model, added, &[])
    })
}

/// Remove effects from a model, refit it, and report the error before and after.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie remove better.toml my-campaign creep -o model.toml")]
pub struct RemoveArgs {
    #[command(flatten)]
    edit: EditArgs,
    /// Names of effects of the model.
    #[arg(value_name = "EFFECT", required = true)]
    effects: Vec<String>,
}

/// Runs the command.
pub fn run_remove(args: &RemoveArgs) -> Result<()> {
    edit(&args.edit, |model, _| edited_effects(model, Vec::new(), &args.effects))
}
