//! Signal quality: `outlier` (rows far from both neighbours) and `coarse_steps` (insufficient resolution).

use crate::data_quality::Finding;
use crate::data_quality::checks::{Channel, CheckContext, by_table, clock, digits, verb};
use crate::data_quality::scan::channel::FEW;
use crate::data_quality::scan::{ColumnScan, Quantity};
use model_export::recordings::columns::FieldUnit;

/// Threshold in standard deviations of the noise.
const FAR: f64 = 20.0;

/// Outliers in the fields.
pub fn check_outliers(context: &mut CheckContext) {
    let spikes = |one: &Channel| {
        let noise = one.column.spikes.noise()?;
        // Rounding may hide the noise; a single quantisation step is no outlier.
        let height = FAR * noise.max(0.3 * one.column.grid.step());
        one.column.spikes.above(height).map(|found| (found, noise))
    };
    let seen: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() && spikes(one).is_some())
        .collect();
    let height = |one: &Channel| spikes(one).map_or(0.0, |((_, most, _), noise)| most / noise);
    let worst = seen.iter().max_by(|a, b| height(a).total_cmp(&height(b)));
    let Some(worst) = worst else { return };
    let Some(((_, most, line), noise)) = spikes(worst) else {
        return;
    };
    let rows: u64 = seen.iter().filter_map(spikes).map(|((n, _, _), _)| n).sum();
    let message = format!(
        "{}: {} from both neighbours by more than {FAR} times the noise; the largest here, in {}, by {} G at a noise of {} G. Look for disturbed transfers, and remove these rows: averaging spreads them",
        context.whose(&seen),
        match rows {
            1 => "1 value deviates".to_owned(),
            n => format!("{n} values deviate"),
        },
        worst.column.name,
        digits(most * worst.column.scale),
        digits(noise * worst.column.scale),
    );
    let place = worst.at(line);
    context.explain(&seen);
    context.findings.push(Finding { id: "outlier", place, message, stops: false, fix: None });
}

/// Ratio of step to white noise above which noise does not dither the steps. Rounding alone appears as a
/// noise of 0.29 steps, a ratio of 3.5.
const STEPS_OF_NOISE: f64 = 2.0;
/// Minimum number of distinct values of a column.
const LEAST_VALUES: usize = 5;
/// Minimum span in steps: a few values may have a common divisor by coincidence.
const LEAST_STEPS: f64 = 10.0;

/// Quantisation of every column except angles and accelerations.
pub fn check_resolution(context: &mut CheckContext) {
    let coarse: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| step(one.column).is_some())
        // Repeated samples hide the noise.
        .filter(|one| one.column.quantity.is_field() || !clock::any(one.table))
        .collect();
    for seen in by_table(coarse) {
        let coarseness = |one: &Channel| step(one.column).unwrap_or(0.0) / one.column.span();
        let worst = seen.iter().max_by(|a, b| coarseness(a).total_cmp(&coarseness(b)));
        let Some(worst) = worst else { continue };
        let step = step(worst.column).unwrap_or(0.0);
        let counts = match worst.column.quantity {
            Quantity::Field { unit: FieldUnit::Lsb, .. } => "counts ",
            _ => "",
        };
        let message = format!(
            "{} {} in coarse steps, the coarsest in {}: every value is {} {counts}from the next, {} steps over the span, which adds an error of {} that averaging does not remove; write more digits, or look for bits lost in a driver",
            context.whose(&seen),
            verb(&seen, "changes", "change"),
            worst.column.name,
            digits(step),
            digits(worst.column.span() / step),
            digits(step / 12_f64.sqrt()),
        );
        let place = worst.at(2);
        context.explain(&seen);
        context.findings.push(Finding {
            id: "coarse_steps",
            place,
            message,
            stops: false,
            fix: None,
        });
    }
}

/// Quantisation step, where it is too coarse.
fn step(column: &ColumnScan) -> Option<f64> {
    let span = column.span();
    match column.quantity {
        Quantity::Field { unit: FieldUnit::Lsb, .. } => {
            let divisor = column.grid.divisor()? as f64;
            (divisor > 1.0 && span >= LEAST_STEPS * divisor).then_some(divisor)
        }
        Quantity::Covariate if column.name != "opening_mm" => None,
        _ => {
            let (distinct, step) = (column.grid.distinct()?, column.grid.step());
            let few = distinct >= LEAST_VALUES && span < FEW as f64 * step;
            (few && step > STEPS_OF_NOISE * column.noise()).then_some(step)
        }
    }
}
