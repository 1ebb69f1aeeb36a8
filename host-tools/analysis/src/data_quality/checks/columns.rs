//! Values of single columns: unit, variation, range, resolution, outliers.

use crate::data_quality::checks::{Channel, CheckContext, Found, by_table, clock};
use crate::data_quality::evidence::{Evidence, Magnitude};
use crate::data_quality::fix::{Fix, FixKind, Repair};
use crate::data_quality::scan::RecordingScan;
use crate::data_quality::scan::column::{ColumnScan, FEW, Quantity, Run};
use firmware::config::constants;
use model_export::effects::CATALOGUE;
use model_export::recordings::Location;
use model_export::recordings::columns::FieldUnit;
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

/// Standard gravity in m/s².
const GRAVITY: f64 = 9.806_65;
/// Highest plausible sensor temperature in degrees Celsius.
const HOTTEST_C: f64 = 120.0;
/// A median above this, in degrees Celsius, is more likely a room temperature in Fahrenheit.
const HOT_C: f64 = 85.0;
/// Plausible temperatures in kelvin, including a warm motor.
const KELVIN: std::ops::Range<f64> = 233.0..423.0;
/// Openings below this, in millimetres, that vary are metres: the widest gripper opens 0.2 m.
const SMALLEST_MM: f64 = 0.2;
/// Openings above this are micrometres.
const WIDEST_MM: f64 = 1000.0;
/// Motor currents above this are milliamperes.
const MOST_A: f64 = 200.0;

/// Detected unit of the values.
#[derive(Clone, Debug, PartialEq)]
struct Misfit {
    found: &'static str,
    wanted: &'static str,
    magnitude: Magnitude,
    /// Factor and offset to the expected unit, where unambiguous.
    cure: Option<(f64, f64)>,
}

/// Units of fields, temperatures and covariates.
pub fn wrong_units<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let mut found = channel_units(context);
    found.extend(covariate_units(context));
    found
}

/// Minimum factor between the noise of a field channel and that of the others. Axes of one type of sensor differ by less
/// than three.
const MIN_NOISE_FACTOR: f64 = 30.0;
/// Maximum factor between the noise's ratio to other channels and the magnitude's ratio to the same axis of other sensors.
const SAME_FACTOR: f64 = 10.0;
/// Maximum difference in decades between the noise's ratio and a power of ten.
const NAMED_DECADES: f64 = 0.15;

/// Single field channels in another unit: noise and magnitude differ from those of the other channels by one factor.
fn channel_units<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let fields: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() && one.column.rows >= LEAST_ROWS)
        .collect();
    let mut groups: Vec<(i32, f64, Vec<Channel>)> = Vec::new();
    for one in &fields {
        let Some(ratio) = noise_ratio(one, &fields) else { continue };
        if ratio.max(ratio.recip()) < MIN_NOISE_FACTOR || !has_magnitude(one, &fields, ratio) {
            continue;
        }
        let decades = ratio.log10().round() as i32;
        match groups.iter_mut().find(|(other, ..)| *other == decades) {
            Some((.., seen)) => seen.push(*one),
            None => groups.push((decades, ratio, vec![*one])),
        }
    }
    groups
        .iter()
        .map(|(decades, ratio, seen)| channel_unit(context, *decades, *ratio, seen))
        .collect()
}

/// Noise of a channel relative to the median of all other fields of the recording, both in gauss.
fn noise_ratio(one: &Channel, fields: &[Channel]) -> Option<f64> {
    let noise = |one: &Channel| one.column.noise() * one.column.scale;
    let others = fields.iter().filter(|other| {
        other.recording == one.recording
            && other.column.name != one.column.name
            && other.column.is_noisy()
    });
    let median = median(others.map(noise).collect())?;
    (one.column.is_noisy() && median > 0.0).then(|| noise(one) / median)
}

/// True if the magnitude differs by about `ratio` from the same axis of the other sensors. Without another sensor, noise alone does
/// not tell a unit from a noisy channel.
fn has_magnitude(one: &Channel, fields: &[Channel], ratio: f64) -> bool {
    let size = |one: &Channel| one.column.sample.size(1.0).unwrap_or(0.0) * one.column.scale;
    let axis = |one: &Channel| match one.column.quantity {
        Quantity::Field { axis, .. } => Some(axis),
        _ => None,
    };
    let others = fields.iter().filter(|other| {
        other.recording == one.recording
            && other.column.name != one.column.name
            && axis(other) == axis(one)
    });
    let Some(median) = median(others.map(size).collect()) else {
        return false;
    };
    let off = size(one) / median / ratio;
    off.is_finite() && (SAME_FACTOR.recip()..=SAME_FACTOR).contains(&off)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn channel_unit<'a>(
    context: &CheckContext,
    decades: i32,
    ratio: f64,
    seen: &[Channel<'a>],
) -> Found<'a> {
    let is_named = (ratio.log10() - f64::from(decades)).abs() <= NAMED_DECADES;
    let factor = 10_f64.powi(decades);
    let fix =
        is_named.then(|| conversion(FixKind::ConvertColumns, seen, (10_f64.powi(-decades), 0.0)));
    let evidence = Evidence::ChannelUnit {
        columns: context.columns_in(seen),
        noise_ratio: ratio,
        factor: is_named.then_some(factor),
    };
    Found::new(seen[0].at(2), evidence).stopping(fix).explaining(seen)
}

/// Conversion of columns by a factor and an offset.
fn conversion(kind: FixKind, seen: &[Channel], (factor, offset): (f64, f64)) -> Fix {
    let of = |one: &Channel| Repair::convert(&one.table.path, &one.column.name, factor, offset);
    Fix { kind, repairs: seen.iter().map(of).collect() }
}

/// Magnitudes of temperatures and covariates.
fn covariate_units<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let covariates: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| matches!(one.column.quantity, Quantity::Temperature | Quantity::Covariate))
        .collect();
    let mut groups: Vec<(Misfit, Vec<Channel>)> = Vec::new();
    for one in covariates {
        let Some(misfit) = misfit(&context.recordings[one.recording], one.column) else {
            continue;
        };
        let same = |(other, _): &&mut (Misfit, Vec<Channel>)| {
            other.found == misfit.found && other.wanted == misfit.wanted
        };
        match groups.iter_mut().find(same) {
            Some((_, seen)) => seen.push(one),
            None => groups.push((misfit, vec![one])),
        }
    }
    groups.iter().map(|(misfit, seen)| wrong_unit(context, misfit, seen)).collect()
}

fn wrong_unit<'a>(context: &CheckContext, misfit: &Misfit, seen: &[Channel<'a>]) -> Found<'a> {
    let &Misfit { found, wanted, magnitude, .. } = misfit;
    let kind = FixKind::ConvertUnit(found, wanted);
    let fix = misfit.cure.map(|cure| conversion(kind, seen, cure));
    let evidence = Evidence::CovariateUnit {
        columns: context.columns_in(seen),
        found,
        expected: wanted,
        certain: fix.is_some(),
        example: seen[0].column.name.clone(),
        magnitude,
    };
    Found::new(seen[0].at(2), evidence).stopping(fix).explaining(seen)
}

fn misfit(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let size = |share: f64| column.sample.size(share).unwrap_or(0.0);
    let misfit = |found, wanted, magnitude, cure| Some(Misfit { found, wanted, magnitude, cure });
    let up_to = || Magnitude::Maximum(size(1.0));
    match column.name.as_str() {
        "roll_rad" | "pitch_rad" if size(1.0) > TAU => {
            misfit("degrees", "rad", up_to(), Some((PI / 180.0, 0.0)))
        }
        "yaw_rad" if size(1.0) > TAU => yaw(recording, column),
        "opening_mm" if size(1.0) > WIDEST_MM => misfit("um", "mm", up_to(), Some((1e-3, 0.0))),
        "opening_mm" if size(1.0) < SMALLEST_MM && column.span() > 0.0 => {
            misfit("m", "mm", up_to(), Some((1e3, 0.0)))
        }
        "motor_iq_a" if size(0.95) > MOST_A => misfit("mA", "A", up_to(), Some((1e-3, 0.0))),
        name if name.starts_with("accel_") => acceleration(recording),
        _ if column.quantity == Quantity::Temperature => temperature(column),
        _ => None,
    }
}

/// Yaw in rad may exceed one turn: it is unambiguous only if roll or pitch are in degrees too.
fn yaw(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let most = column.sample.size(1.0)?;
    let others = ["roll_rad", "pitch_rad"];
    let sure = recording.table("hall.csv").is_some_and(|hall| {
        let others = others.iter().filter_map(|name| hall.column(name));
        others.filter_map(|column| column.sample.size(1.0)).any(|most| most > TAU)
    });
    // Beyond a turn in degrees it can only be continuous rad.
    (sure || most <= 360.0).then(|| Misfit {
        found: "degrees",
        wanted: "rad",
        magnitude: Magnitude::Maximum(most),
        cure: sure.then_some((PI / 180.0, 0.0)),
    })
}

fn temperature(column: &ColumnScan) -> Option<Misfit> {
    let median = column.sample.median()?;
    let (found, cure) = match median {
        t if t <= HOT_C => return None,
        // A furnace or a thermocouple: no other unit has a room temperature here.
        _ if column.extent.0 < KELVIN.start && column.extent.1 > KELVIN.end => return None,
        t if t <= HOTTEST_C => ("degrees Fahrenheit", None),
        t if KELVIN.contains(&t) => ("kelvin", Some((1.0, -273.15))),
        _ => ("another unit", None),
    };
    Some(Misfit { found, wanted: "degrees Celsius", magnitude: Magnitude::Median(median), cure })
}

/// All three axes by the magnitude of the vector: at rest it is gravity.
fn acceleration(recording: &RecordingScan) -> Option<Misfit> {
    let norm = recording.table("hall.csv")?.acceleration.median()?;
    let (found, factor) = match norm {
        n if (0.8..1.25).contains(&n) => ("g", GRAVITY),
        n if (800.0..1250.0).contains(&n) => ("thousandths of g", 1e-3 * GRAVITY),
        _ => return None,
    };
    Some(Misfit {
        found,
        wanted: "m/s2",
        magnitude: Magnitude::VectorLength(norm),
        cure: Some((factor, 0.0)),
    })
}

/// Minimum number of rows; a shorter recording may be constant by coincidence.
const LEAST_ROWS: u64 = 20;
/// A single run with this share of the rows at the extreme value is not clipping.
const ONE_STAY: f64 = 0.95;
/// Runs that begin within this time in microseconds have one cause.
const TOGETHER_US: f64 = 100_000.0;

/// Fields and forces that do not change, throughout or for a stretch.
pub fn stuck_channels<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let measured = measured(context);
    let mut all = Vec::new();
    let throughout = |one: &&Channel| one.column.rows >= LEAST_ROWS && one.column.span() == 0.0;
    let constant: Vec<Channel> = measured.iter().filter(throughout).copied().collect();
    for seen in by_table(constant) {
        let (whole, some): (Vec<Channel>, Vec<Channel>) =
            seen.iter().partition(|one| context.everywhere(&seen, &one.column.name));
        for (seen, whole) in [(whole, true), (some, false)] {
            if !seen.is_empty() {
                all.push(never_changes(context, &seen, whole));
            }
        }
    }
    let frozen = |one: Channel<'_>| Some(one.column.frozen()?).filter(|run| !is_an_end(&one, run));
    let stretches: Vec<(Channel, Run)> =
        measured.into_iter().filter_map(|one| frozen(one).map(|run| (one, run))).collect();
    all.extend(together(stretches).iter().map(|group| frozen_for(context, group)));
    all
}

/// Fields and forces.
fn measured<'a>(context: &CheckContext<'a>) -> Vec<Channel<'a>> {
    let is_measured =
        |one: &Channel| one.column.quantity.is_field() || one.column.quantity == Quantity::Force;
    context.columns().into_iter().filter(is_measured).collect()
}

/// A clipped channel stays at its limit as long as the load does.
fn is_an_end(seen: &Channel, run: &Run) -> bool {
    let at_limit = run.value <= seen.column.limits.0 || run.value >= seen.column.limits.1;
    let cut_off = seen.column.cut_off();
    // Noise splits a run at a limit; a channel that froze at its peak has a single run.
    at_limit
        || cut_off.is_some_and(|(value, rows)| {
            value == run.value && (run.rows as f64) < ONE_STAY * rows as f64
        })
}

fn never_changes<'a>(context: &CheckContext, seen: &[Channel<'a>], whole: bool) -> Found<'a> {
    let first = seen[0];
    let evidence = Evidence::StuckThroughout {
        columns: context.columns_in(seen),
        value: common(seen.iter().map(|one| one.column.extent.0)),
        at_limit: seen.iter().all(|one| one.column.at_limit.0 > 0),
        in_every_recording: whole,
    };
    let found = Found::new(first.at(2), evidence).explaining(seen);
    if whole { found.stopping(None) } else { found }
}

/// The value, where all are equal.
fn common(mut values: impl Iterator<Item = f64>) -> Option<f64> {
    let first = values.next()?;
    values.all(|value| value == first).then_some(first)
}

fn frozen_for<'a>(context: &CheckContext, group: &[(Channel<'a>, Run)]) -> Found<'a> {
    let (first, run) = group[0];
    let seen: Vec<Channel> = group.iter().map(|(one, _)| *one).collect();
    let evidence = Evidence::Frozen {
        columns: context.columns_in(&seen),
        from_s: first.table.second(run.from_us),
        to_s: first.table.second(run.to_us),
        rows: run.rows,
        value: common(group.iter().map(|(_, run)| run.value)),
        noise: first.column.noise(),
    };
    Found::new(first.at(run.line), evidence).explaining(&seen)
}

/// Groups runs of one recording that begin together.
fn together<'a>(stretches: Vec<(Channel<'a>, Run)>) -> Vec<Vec<(Channel<'a>, Run)>> {
    let mut groups: Vec<Vec<(Channel, Run)>> = Vec::new();
    for (one, run) in stretches {
        let belongs = |group: &&mut Vec<(Channel, Run)>| {
            let (other, first) = group[0];
            other.table.path == one.table.path && (first.from_us - run.from_us).abs() < TOGETHER_US
        };
        match groups.iter_mut().find(belongs) {
            Some(group) => group.push((one, run)),
            None => groups.push(vec![(one, run)]),
        }
    }
    groups
}

/// Fields and forces at the end of their range, or clipped before it.
pub fn saturation<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let mut all = Vec::new();
    for seen in by_table(measured(context)) {
        let (at_limit, others): (Vec<Channel>, Vec<Channel>) =
            seen.iter().partition(|one| one.column.at_limit.0 > 0);
        let cut_off: Vec<Channel> =
            others.into_iter().filter(|one| one.column.cut_off().is_some()).collect();
        all.extend(at_its_end(context, &at_limit));
        all.extend(cut_short(context, &cut_off));
    }
    all
}

fn at_its_end<'a>(context: &CheckContext, seen: &[Channel<'a>]) -> Option<Found<'a>> {
    let share = |one: &Channel| one.column.at_limit.0 as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let evidence = Evidence::Saturated {
        columns: context.columns_in(seen),
        worst: worst.column.name.clone(),
        share: share(worst),
    };
    Some(Found::new(worst.at(worst.column.at_limit.1), evidence).explaining(seen))
}

fn cut_short<'a>(context: &CheckContext, seen: &[Channel<'a>]) -> Option<Found<'a>> {
    let rows = |one: &Channel| one.column.cut_off().map_or(0, |(_, rows)| rows);
    let share = |one: &Channel| rows(one) as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let (value, _) = worst.column.cut_off()?;
    let evidence = Evidence::Clipped {
        columns: context.columns_in(seen),
        worst: worst.column.name.clone(),
        share: share(worst),
        value,
        at_rest: value == 0.0 && worst.column.quantity == Quantity::Force,
    };
    let is_lost = worst.column.quantity == Quantity::Force && value != 0.0;
    let found = Found::new(worst.at(2), evidence).explaining(seen);
    // No model explains what the reference did not measure.
    Some(if is_lost && share(worst) > CLIPPED_REFERENCE { found.stopping(None) } else { found })
}

/// Share of clipped rows from which a reference cannot be used.
const CLIPPED_REFERENCE: f64 = 0.02;

/// Sensors without a temperature in recordings where others have one.
pub fn missing_temperatures<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let mut groups: Vec<(Vec<u32>, Location, Vec<usize>)> = Vec::new();
    for (recording, table) in context.tables() {
        let of_fields = table.columns.iter().filter_map(|column| match column.quantity {
            Quantity::Field { sensor, .. } => Some(sensor),
            _ => None,
        });
        let of_fields: BTreeSet<u32> = of_fields.collect();
        let has = |sensor: &u32| table.column(&format!("s{sensor}_temp_c")).is_some();
        let missing: Vec<u32> = of_fields.iter().copied().filter(|sensor| !has(sensor)).collect();
        if missing.is_empty() || missing.len() == of_fields.len() {
            continue;
        }
        if let Some((.., hit)) = groups.iter_mut().find(|(sensors, ..)| *sensors == missing) {
            hit.push(recording);
            continue;
        }
        let column = format!("s{}_temp_c", missing[0]);
        let place = Location::file(&table.path).line(1).column(column);
        groups.push((missing, place, vec![recording]));
    }
    let found = |(sensors, place, hit): (Vec<u32>, Location, Vec<usize>)| {
        let recordings = context.recordings_in(hit);
        Found::new(place, Evidence::MissingTemperature { sensors, recordings })
    };
    groups.into_iter().map(found).collect()
}

/// A covariate with a spread below this multiple of its white noise counts as constant.
const MOVES: f64 = 1.5;
/// Minimum number of rows for an estimate of the spread.
const MIN_COVARIATE_ROWS: f64 = 20.0;

/// Covariates that do not vary over the whole campaign.
pub fn constant_covariates<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let columns = context.columns();
    let mut names: Vec<&str> = Vec::new();
    for one in &columns {
        let covariate = matches!(one.column.quantity, Quantity::Temperature | Quantity::Covariate);
        if covariate && !names.contains(&one.column.name.as_str()) {
            names.push(&one.column.name);
        }
    }
    let of = |name: &str| -> Vec<Channel> {
        let same = columns.iter().filter(|one| one.column.name == name);
        same.copied().collect()
    };
    let still: Vec<&str> = names.into_iter().filter(|name| is_constant(&of(name))).collect();
    let groups = same_cause(&still).into_iter();
    groups
        .map(|group| {
            let seen: Vec<Channel> = group.iter().map(|name| of(name)[0]).collect();
            Found::new(seen[0].at(2), no_variation(&group, &seen))
        })
        .collect()
}

/// Groups columns with one cause: the sensors' temperatures, or the opening and the rotor that sets it.
fn same_cause<'a>(still: &[&'a str]) -> Vec<Vec<&'a str>> {
    let kind = |name: &str| match name {
        "motor_angle_rad" if still.contains(&"opening_mm") => "opening_mm".to_owned(),
        name if name.ends_with("_temp_c") => "temp_c".to_owned(),
        name => name.to_owned(),
    };
    let mut groups: Vec<Vec<&str>> = Vec::new();
    for name in still {
        match groups.iter_mut().find(|group| kind(group[0]) == kind(name)) {
            Some(group) => group.push(name),
            None => groups.push(vec![name]),
        }
    }
    groups
}

/// True where the spread over all recordings does not exceed the noise.
fn is_constant(seen: &[Channel]) -> bool {
    let moments = || seen.iter().map(|one| one.column.moments());
    let rows: f64 = moments().map(|(rows, _, _)| rows).sum();
    let mean = moments().map(|(rows, mean, _)| rows * mean).sum::<f64>() / rows;
    let squares: f64 =
        moments().map(|(rows, own, squares)| squares + rows * (own - mean).powi(2)).sum();
    let noise = seen.iter().map(|one| one.column.noise()).fold(0.0, f64::max);
    // An exactly written constant has no noise.
    let rounding = 1e-9 * mean.abs();
    rows >= MIN_COVARIATE_ROWS && (squares / rows).sqrt() <= (MOVES * noise).max(rounding)
}

fn no_variation(group: &[&str], seen: &[Channel]) -> Evidence {
    let needed = |name: &str, column: &str| {
        name == column || (name == "temp_c" && column.ends_with("_temp_c"))
    };
    let effects = CATALOGUE
        .iter()
        .filter(|effect| {
            let mut needs = effect.needs.iter();
            needs.any(|need| needed(need, group[0]))
        })
        .map(|effect| effect.id);
    let columns = group.iter().zip(seen).map(|(name, one)| {
        let (_, mean, _) = one.column.moments();
        ((*name).to_owned(), if mean.abs() < one.column.noise() { 0.0 } else { mean })
    });
    Evidence::ConstantCovariates { columns: columns.collect(), effects: effects.collect() }
}

/// Threshold in standard deviations of the noise.
const FAR: f64 = 20.0;

/// Outliers in the fields.
pub fn outliers<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
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
    let Some((worst, ((_, most, line), noise))) = worst.and_then(|one| Some((one, spikes(one)?)))
    else {
        return Vec::new();
    };
    let rows: u64 = seen.iter().filter_map(spikes).map(|((n, _, _), _)| n).sum();
    let evidence = Evidence::Outliers {
        columns: context.columns_in(&seen),
        values: rows,
        threshold: FAR,
        worst: worst.column.name.clone(),
        deviation_g: most * worst.column.scale,
        noise_g: noise * worst.column.scale,
    };
    vec![Found::new(worst.at(line), evidence).explaining(&seen)]
}

/// Ratio of step to white noise above which noise does not dither the steps. Rounding alone appears as a
/// noise of 0.29 steps, a ratio of 3.5.
const STEPS_OF_NOISE: f64 = 2.0;
/// Minimum number of distinct values of a column.
const LEAST_VALUES: usize = 5;
/// Minimum span in steps: a few values may have a common divisor by coincidence.
const LEAST_STEPS: f64 = 10.0;

/// Minimum number of rows for each value: a load that a person sets has steps too, and is there for a few rows.
const ROWS_OF_VALUE: u64 = 4;

/// Quantisation of every column except angles and accelerations, of rows that sample a course of time.
pub fn coarse_steps<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let coarse: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| !context.recordings[one.recording].is_table_of_settings)
        .filter(|one| step(one.column).is_some())
        // Repeated samples hide the noise.
        .filter(|one| one.column.quantity.is_field() || !clock::any(one.table))
        .collect();
    by_table(coarse).iter().filter_map(|seen| coarsest(context, seen)).collect()
}

fn coarsest<'a>(context: &CheckContext, seen: &[Channel<'a>]) -> Option<Found<'a>> {
    let coarseness = |one: &Channel| step(one.column).unwrap_or(0.0) / one.column.span();
    let worst = seen.iter().max_by(|a, b| coarseness(a).total_cmp(&coarseness(b)))?;
    let step = step(worst.column).unwrap_or(0.0);
    let in_counts = matches!(worst.column.quantity, Quantity::Field { unit: FieldUnit::Lsb, .. });
    let evidence = Evidence::CoarseSteps {
        columns: context.columns_in(seen),
        worst: worst.column.name.clone(),
        step,
        in_counts,
        steps: worst.column.span() / step,
    };
    Some(Found::new(worst.at(2), evidence).explaining(seen))
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
            // The sensor's own resolution is not lost in a driver.
            let is_native = column.quantity == Quantity::Temperature
                && step * constants::TEMPERATURE_SCALE.value < 1.01;
            let few = distinct >= LEAST_VALUES
                && span < FEW as f64 * step
                && column.rows >= ROWS_OF_VALUE * distinct as u64
                && !is_native;
            (few && step > STEPS_OF_NOISE * column.noise()).then_some(step)
        }
    }
}
