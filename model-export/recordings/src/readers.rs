//! Readers of `hall.csv` (fields in gauss, continuous angles) and `force.csv` (newtons).

use std::collections::BTreeMap;
use std::path::Path;

use firmware::config::constants;
use firmware::sensors::hall::a31301;

use crate::align::Sample;
use crate::columns::{
    Axis, FieldUnit, ForceColumn, HallColumn, STATOR_CURRENTS, force_column, hall_column, is_angle,
};
use crate::csv_table::{CellRule, ClockMonitor, CsvRow, CsvTable, missing_clock, period_us};
use crate::description::{NominalDesign, RECORDING_FILE, RecordingDescription};
use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::noise::WhiteNoise;
use crate::units;

/// Parses the header: index of `t_us`, and index and meaning of every other column.
fn parse_header<C: PartialEq>(
    table: &CsvTable,
    clock: C,
    parse: impl Fn(&str) -> Result<C, ErrorKind>,
) -> Result<(usize, Vec<usize>, Vec<C>), DataError> {
    let time_column = table.header().iter().position(|name| name == "t_us");
    let time_column = time_column.ok_or_else(|| missing_clock(table))?;
    let (mut indices, mut columns) = (Vec::new(), Vec::new());
    for (i, name) in table.header().iter().enumerate() {
        let column = parse(name).map_err(|kind| kind.at(table.header_location(name)))?;
        if column != clock {
            indices.push(i);
            columns.push(column);
        }
    }
    Ok((time_column, indices, columns))
}

/// Values beyond this multiple of the range are not saturated: a saturated sensor stays at the end of its range.
const SATURATED_WITHIN: f64 = 1.1;

/// Rows of a channel at the end of its range or beyond.
#[derive(Clone, Copy, Debug, Default)]
struct Saturation {
    rows: u64,
    /// Line of the first.
    line: u64,
    max_gauss: f64,
}

/// Reader of `hall.csv`: scales counts, marks saturation, unwraps angles.
pub(super) struct HallReader {
    pub(super) table: CsvTable,
    time_column: usize,
    /// Index in the row of each channel.
    indices: Vec<usize>,
    /// Meaning of each channel; [`STATOR_CURRENTS`] last where they can be computed.
    pub(super) columns: Vec<HallColumn>,
    pub(super) period_us: f64,
    gauss_per_lsb: f64,
    /// Fields of at least this magnitude are saturated.
    limit_gauss: f64,
    pub(super) clock: ClockMonitor,
    noise: Vec<WhiteNoise>,
    /// Factor of the noise of each channel ([`RecordingDescription::noise_factor`]).
    noise_factors: Vec<f64>,
    /// Saturated rows of each channel.
    saturated: Vec<Saturation>,
    last_angle: Vec<Option<f64>>,
    motor: Option<MotorChannels>,
}

/// Source of the stator-frame currents. They are computed row by row, before averaging: the average of a
/// rotating current is zero.
struct MotorChannels {
    quadrature_current: usize,
    mechanical_angle: usize,
    pole_pairs: f64,
}

impl MotorChannels {
    fn find(columns: &[HallColumn], description: &RecordingDescription) -> Option<Self> {
        let channel = |column: &str| {
            columns
                .iter()
                .position(|c| matches!(c, HallColumn::Covariate { name } if name == column))
        };
        let design = description.design.as_ref();
        let stated = design.and_then(NominalDesign::pole_pairs);
        Some(Self {
            quadrature_current: channel("motor_iq_a")?,
            mechanical_angle: channel("motor_angle_rad")?,
            pole_pairs: stated.unwrap_or(constants::POLE_PAIRS.value),
        })
    }

    /// Alpha and beta current in amperes, with zero direct current.
    fn stator_currents(&self, values: &[f64]) -> [f64; 2] {
        let iq = values[self.quadrature_current];
        let electrical = self.pole_pairs * values[self.mechanical_angle];
        [-iq * libm::sin(electrical), iq * libm::cos(electrical)]
    }
}

impl HallReader {
    pub(super) fn open(
        mut table: CsvTable,
        description: &RecordingDescription,
        folder: &Path,
    ) -> Result<Self, DataError> {
        let parse = |name: &str| hall_column(name, &description.covariates);
        let (time_column, indices, mut columns) = parse_header(&table, HallColumn::Time, parse)?;
        check_fields(&table, &columns)?;
        let motor = MotorChannels::find(&columns, description);
        if motor.is_some() {
            columns.extend(
                STATOR_CURRENTS.map(|name| HallColumn::Covariate { name: name.to_owned() }),
            );
        }
        let is_raw = columns.iter().any(|column| column.is_raw_field());
        let gauss_per_lsb = match (is_raw, description.gauss_per_lsb) {
            (true, None) => {
                let example = "gauss_per_lsb = 0.125 (the sensor's scale)";
                let location = Location::file(&folder.join(RECORDING_FILE)).column("gauss_per_lsb");
                return Err(ErrorKind::MissingKey { example }.at(location));
            }
            (_, scale) => scale.unwrap_or(1.0),
        };
        table.set_rules(time_column, vec![CellRule::Number; table.header().len()]);
        table.limit_magnitudes();
        let period_us = period_us(&mut table, time_column)?;
        let noise_factor = |channel: usize| {
            let index = indices.get(channel);
            index.map_or(1.0, |&index| description.noise_factor(&table.header()[index]))
        };
        let noise_factors = (0..columns.len()).map(noise_factor).collect();
        Ok(Self {
            time_column,
            noise: vec![WhiteNoise::default(); columns.len()],
            noise_factors,
            saturated: vec![Saturation::default(); columns.len()],
            last_angle: vec![None; columns.len()],
            clock: ClockMonitor::new(period_us),
            motor,
            table,
            indices,
            columns,
            period_us,
            gauss_per_lsb,
            limit_gauss: description.saturated_gauss(is_raw),
        })
    }

    /// The next row, fields in gauss.
    pub(super) fn next_row(&mut self) -> Result<Option<Sample>, DataError> {
        let Some(row) = self.table.next_row()? else {
            return Ok(None);
        };
        let t_us = row.cells[self.time_column];
        self.clock.update(&row, t_us);
        let mut values = Vec::with_capacity(self.columns.len());
        for channel in 0..self.indices.len() {
            values.push(self.convert(channel, &row)?);
        }
        if let Some(motor) = &self.motor {
            values.extend(motor.stator_currents(&values));
        }
        Ok(Some(Sample { t_us, values }))
    }

    /// [`HallReader::next_row`] with NaN for saturated fields; updates the noise estimates.
    pub(super) fn next_sample(&mut self) -> Result<Option<Sample>, DataError> {
        let mut sample = self.next_row()?;
        for (channel, value) in sample.iter_mut().flat_map(|s| s.values.iter_mut().enumerate()) {
            let is_field = matches!(self.columns[channel], HallColumn::Field { .. });
            if is_field && value.abs() >= self.limit_gauss {
                let saturated = &mut self.saturated[channel];
                if saturated.rows == 0 {
                    saturated.line = self.clock.line;
                }
                saturated.rows += 1;
                saturated.max_gauss = saturated.max_gauss.max(value.abs());
                *value = f64::NAN;
            }
            self.noise[channel].push(*value);
        }
        Ok(sample)
    }

    /// Fields in gauss, angles unwrapped, other columns unchanged.
    fn convert(&mut self, channel: usize, row: &CsvRow) -> Result<f64, DataError> {
        let cell = row.cells[self.indices[channel]];
        match &self.columns[channel] {
            column if column.is_raw_field() => self.scale(channel, cell, row),
            HallColumn::Covariate { name } if is_angle(name) => {
                // Unwrapped, since rows are averaged later: the mean of 6.28 and 0.01 is not 3.1.
                let turn = std::f64::consts::TAU;
                let angle = match self.last_angle[channel] {
                    Some(last) => cell - turn * ((cell - last) / turn).round(),
                    None => cell,
                };
                self.last_angle[channel] = Some(angle);
                Ok(angle)
            }
            _ => Ok(cell),
        }
    }

    fn scale(&self, channel: usize, counts: f64, row: &CsvRow) -> Result<f64, DataError> {
        let (low, high) = (f64::from(a31301::FIELD_LIMITS.0), f64::from(a31301::FIELD_LIMITS.1));
        if !(low..=high).contains(&counts) || counts.fract() != 0.0 {
            let kind = ErrorKind::OutOfRange {
                value: counts,
                bits: constants::SENSOR_BITS.value as u32,
                low,
                high,
            };
            return Err(kind.at(self.table.cell_location(row.line, self.indices[channel])));
        }
        Ok(counts * self.gauss_per_lsb)
    }

    /// A notice where the rows are not at the device's rate, for which they are interpolated or left out in a replay.
    pub(super) fn rate_notice(&self) -> Option<Notice> {
        let tick_us = constants::TICK_US as f64;
        let done = match self.period_us / tick_us {
            ratio if ratio >= 1.5 => "interpolated",
            ratio if ratio > 0.0 && ratio <= 2.0 / 3.0 => "left out in part",
            _ => return None,
        };
        Some(Notice {
            location: self.table.header_location("t_us"),
            message: format!(
                "rows are {:.2} ms apart: {done} where the device's code is replayed, which has one every {:.0} ms",
                1e-3 * self.period_us,
                1e-3 * tick_us
            ),
        })
    }

    /// White noise of one row, each channel.
    pub(super) fn noise(&self) -> Vec<Option<f64>> {
        let noise = self.noise.iter().zip(&self.noise_factors);
        noise.map(|(noise, factor)| Some(factor * noise.estimate()?)).collect()
    }

    /// A notice where the signal of a sensor is in another unit than gauss.
    pub(super) fn unit_notice(&self) -> Option<Notice> {
        let other = |(column, index): (&HallColumn, &usize)| match column {
            HallColumn::Field { unit: FieldUnit::Other(suffix), .. } => Some((*suffix, *index)),
            _ => None,
        };
        let (suffix, index) = self.columns.iter().zip(&self.indices).find_map(other)?;
        let symbol = units::symbol(suffix).unwrap_or(suffix);
        Some(Notice {
            location: self.table.header_location(&self.table.header()[index]),
            message: format!(
                "the signal is in {symbol}: read {symbol} where results are in G or gauss"
            ),
        })
    }

    pub(super) fn saturation_notices(&self) -> Vec<Notice> {
        let channels = self.saturated.iter().zip(&self.indices);
        channels
            .filter(|(saturated, _)| saturated.rows > 0)
            .map(|(Saturation { rows, line, max_gauss }, index)| Notice {
                location: self.table.cell_location(*line, *index),
                message: if *max_gauss <= SATURATED_WITHIN * self.limit_gauss {
                    format!("saturated in {rows} rows, first here; dependent rows were excluded: widen the gap or reduce the load")
                } else {
                    format!(
                        "beyond the sensor's range of ±{} G in {rows} rows, first here, up to {max_gauss} G: no saturation, which ends at \
                         the range; these rows were excluded: check range_gauss, the unit, and whether the counts wrap",
                        self.limit_gauss
                    )
                },
            })
            .collect()
    }
}

/// Every sensor needs one axis at least, none twice, and all in one unit.
fn check_fields(table: &CsvTable, columns: &[HallColumn]) -> Result<(), DataError> {
    let mut first: BTreeMap<u32, FieldUnit> = BTreeMap::new();
    let mut known: Vec<(u32, Axis)> = Vec::new();
    for column in columns {
        let HallColumn::Field { sensor, axis, unit } = column else { continue };
        let own = *first.entry(*sensor).or_insert(*unit);
        let advice = if known.contains(&(*sensor, *axis)) {
            format!("sensor {sensor} has this axis in two units: keep one of the two columns")
        } else if own != *unit {
            format!("sensor {sensor} needs all its axes in one unit: convert the others")
        } else {
            known.push((*sensor, *axis));
            continue;
        };
        let name = format!("s{sensor}_{}_{}", axis.letter(), own.suffix());
        return Err(ErrorKind::MissingColumn { advice }.at(table.header_location(&name)));
    }
    if known.is_empty() {
        return Err(ErrorKind::NoField.at(Location::file(table.path()).line(1)));
    }
    Ok(())
}

/// Reader of `force.csv`; forces may be missing. Without any force column, its rows are the instants at
/// which an unloaded sensor is sampled.
pub(super) struct ForceReader {
    pub(super) table: CsvTable,
    pub(super) time_column: usize,
    indices: Vec<usize>,
    pub(super) columns: Vec<ForceColumn>,
    pub(super) period_us: f64,
    pub(super) clock: ClockMonitor,
    noise: Vec<WhiteNoise>,
    /// As those of [`HallReader`].
    noise_factors: Vec<f64>,
}

impl ForceReader {
    pub(super) fn open(
        mut table: CsvTable,
        description: &RecordingDescription,
    ) -> Result<Self, DataError> {
        let (time_column, indices, columns) =
            parse_header(&table, ForceColumn::Time, force_column)?;
        let mut rules = vec![CellRule::Optional; table.header().len()];
        rules[time_column] = CellRule::Number;
        table.set_rules(time_column, rules);
        table.limit_magnitudes();
        let period_us = period_us(&mut table, time_column)?;
        Ok(Self {
            time_column,
            noise: vec![WhiteNoise::default(); columns.len()],
            noise_factors: indices
                .iter()
                .map(|&index| description.noise_factor(&table.header()[index]))
                .collect(),
            clock: ClockMonitor::new(period_us),
            table,
            indices,
            columns,
            period_us,
        })
    }

    /// White noise of one row in newtons, each force.
    pub(super) fn noise(&self) -> Vec<Option<f64>> {
        let noise = self.noise.iter().zip(&self.noise_factors);
        noise.map(|(noise, factor)| Some(factor * noise.estimate()?)).collect()
    }

    pub(super) fn next_row(&mut self) -> Result<Option<CsvRow>, DataError> {
        let row = self.table.next_row()?;
        if let Some(row) = &row {
            self.clock.update(row, row.cells[self.time_column]);
            for (noise, &index) in self.noise.iter_mut().zip(&self.indices) {
                noise.push(row.cells[index]);
            }
        }
        Ok(row)
    }

    pub(super) fn forces(&self, row: &CsvRow) -> Vec<f64> {
        self.indices.iter().map(|&index| row.cells[index]).collect()
    }

    /// Linear interpolation: `fraction` 0 at `before`, 1 at `after`.
    pub(super) fn interpolate(&self, before: &CsvRow, after: &CsvRow, fraction: f64) -> Vec<f64> {
        let value = |&index: &usize| {
            before.cells[index] + fraction * (after.cells[index] - before.cells[index])
        };
        self.indices.iter().map(value).collect()
    }
}
