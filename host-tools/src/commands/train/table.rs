//! `magpie train --table`: all ways of telling the force, side by side.

mod json;
mod text;

use anyhow::Result;

use super::{Args, HIDDEN};
use crate::report::{self, training};
use crate::show;
use crate::table::data::Data;
use crate::table::teach::Plan;
use crate::table::{compute, length};

/// What a row without force counts in the table's row for it, if not given.
const NEAR_ZERO: f64 = 4.0;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if let Some(path) = &args.output {
        model_export::output::check_output(path, report::MARK)?;
    }
    let alignment = args.clocks.alignment()?;
    let data = Data::read(
        &args.model,
        &args.campaign,
        args.hold_out,
        alignment,
        args.seed,
        !args.without_curve,
    )?;
    let settings = model_export::gru::train::course::Settings {
        near_zero: 1.0,
        ..args.settings(data.force_range_n())
    };
    let plan = Plan::new(
        settings,
        args.hidden.map_or(HIDDEN, usize::from),
        args.near_zero.unwrap_or(NEAR_ZERO),
    );
    plan.announce(length::trainings(&data).into_iter());
    let table = compute(&data, &plan, args.magnet_hours)?;
    let page = match args.json {
        true => format!("{}\n", json::object(&table, &plan)),
        false => text::page(&table, &plan),
    };
    show::page(&page)?;
    if let Some(path) = &args.output {
        report::write_sections(path, &training::title(&table), &training::sections(&table))?;
        if !args.json {
            show::page(&format!("Written to {}.\n", path.display()))?;
        }
    }
    Ok(())
}
