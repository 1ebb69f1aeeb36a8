//! The board's table as samples in gauss.

use std::path::Path;

use firmware::hall::a31301;
use firmware::params;

use super::align::Sample;
use super::clock::{ClockWatch, no_clock, period_us};
use super::columns::{Axis, FieldUnit, HallColumn, STATOR_CURRENTS, hall_column, is_angle};
use super::description::{Description, FILE};
use super::layout::Layout;
use super::noise::WhiteNoise;
use super::problem::{Fault, Notice, Place, Problem};
use super::table::{Cells, Row, Table};

/// Reads `hall.csv`: scale, saturation, angles through their wrap.
pub(super) struct HallReader {
    pub(super) table: Table,
    time_column: usize,
    /// Index in the row, and its meaning.
    picks: Vec<usize>,
    pub(super) columns: Vec<HallColumn>,
    pub(super) period_us: f64,
    gauss_per_lsb: f64,
    /// Field at or above this is saturated.
    limit_gauss: f64,
    pub(super) clock: ClockWatch,
    pub(super) noise: Vec<WhiteNoise>,
    saturated: Vec<(u64, u64)>,
    last_angle: Vec<Option<f64>>,
    motor: Option<Motor>,
}

/// The motor's columns, from which the currents in the stator's frame are formed row by row: once
/// averaged, a current that turns has vanished.
struct Motor {
    /// Channels of the quadrature current and of the mechanical angle.
    channels: (usize, usize),
    pole_pairs: f64,
}

impl Motor {
    fn find(columns: &[HallColumn], description: &Description) -> Option<Self> {
        let channel = |column: &str| {
            columns
                .iter()
                .position(|c| matches!(c, HallColumn::Covariate { name } if name == column))
        };
        let design = description.design.as_ref();
        let stated = design.and_then(|design| design.number("motor_pole_pairs"));
        Some(Self {
            channels: (channel("motor_iq_a")?, channel("motor_angle_rad")?),
            pole_pairs: stated.unwrap_or(params::POLE_PAIRS.value),
        })
    }

    /// Alpha and beta current in amperes where all current is quadrature current.
    fn currents(&self, values: &[f64]) -> [f64; 2] {
        let (iq, angle) = (values[self.channels.0], values[self.channels.1]);
        let electrical = self.pole_pairs * angle;
        [-iq * libm::sin(electrical), iq * libm::cos(electrical)]
    }
}

impl HallReader {
    pub(super) fn open(
        mut table: Table,
        description: &Description,
        folder: &Path,
    ) -> Result<Self, Problem> {
        if !table.header().iter().any(|name| name == "t_us") {
            return Err(no_clock(&table));
        }
        let mut time_column = None;
        let (mut picks, mut columns) = (Vec::new(), Vec::new());
        for (i, name) in table.header().iter().enumerate() {
            match hall_column(name, &description.covariates) {
                Ok(HallColumn::Time) => time_column = Some(i),
                Ok(column) => {
                    picks.push(i);
                    columns.push(column);
                }
                Err(fault) => return Err(fault.at(table.header_place(name))),
            }
        }
        let time_column = time_column.ok_or_else(|| no_clock(&table))?;
        check_fields(&table, &columns)?;
        let motor = Motor::find(&columns, description);
        if motor.is_some() {
            columns.extend(STATOR_CURRENTS.map(|name| HallColumn::Covariate {
                name: name.to_owned(),
            }));
        }
        let raw = columns.iter().any(|c| {
            matches!(
                c,
                HallColumn::Field {
                    unit: FieldUnit::Lsb,
                    ..
                }
            )
        });
        let gauss_per_lsb = match (raw, description.gauss_per_lsb) {
            (true, None) => {
                let example = "gauss_per_lsb = 0.125 (the sensor's scale)";
                let place = Place::file(&folder.join(FILE)).column("gauss_per_lsb");
                return Err(Fault::MissingKey { example }.at(place));
            }
            (_, scale) => scale.unwrap_or(1.0),
        };
        table.rules(time_column, vec![Cells::Number; table.header().len()]);
        let period_us = period_us(&mut table, time_column)?;
        Ok(Self {
            time_column,
            noise: vec![WhiteNoise::default(); columns.len()],
            saturated: vec![(0, 0); columns.len()],
            last_angle: vec![None; columns.len()],
            clock: ClockWatch::new(period_us),
            motor,
            table,
            picks,
            columns,
            period_us,
            gauss_per_lsb,
            limit_gauss: description.saturated_gauss(raw),
        })
    }

    /// The next row: fields in gauss.
    pub(super) fn next_row(&mut self) -> Result<Option<Sample>, Problem> {
        let Some(row) = self.table.next_row()? else {
            return Ok(None);
        };
        let t_us = row.cells[self.time_column];
        self.clock.tick(&row, t_us);
        let mut values = Vec::with_capacity(self.picks.len());
        for channel in 0..self.picks.len() {
            values.push(self.convert(channel, &row)?);
        }
        if let Some(motor) = &self.motor {
            values.extend(motor.currents(&values));
        }
        Ok(Some(Sample { t_us, values }))
    }

    /// [`HallReader::next_row`] with NaN for what is saturated, its noise taken note of.
    pub(super) fn next_sample(&mut self) -> Result<Option<Sample>, Problem> {
        let mut sample = self.next_row()?;
        for (channel, value) in sample
            .iter_mut()
            .flat_map(|s| s.values.iter_mut().enumerate())
        {
            let is_field = matches!(self.columns[channel], HallColumn::Field { .. });
            if is_field && value.abs() >= self.limit_gauss {
                let (count, line) = &mut self.saturated[channel];
                *line = if *count == 0 { self.clock.line } else { *line };
                *count += 1;
                *value = f64::NAN;
            }
            self.noise[channel].push(*value);
        }
        Ok(sample)
    }

    /// Fields in gauss, angles continuous, the rest as it is.
    fn convert(&mut self, channel: usize, row: &Row) -> Result<f64, Problem> {
        let cell = row.cells[self.picks[channel]];
        match &self.columns[channel] {
            HallColumn::Field {
                unit: FieldUnit::Lsb,
                ..
            } => self.scale(channel, cell, row),
            HallColumn::Covariate { name } if is_angle(name) => {
                // Follow the angle through its wrap: the mean of 6.28 and 0.01 is not 3.1.
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

    fn scale(&self, channel: usize, counts: f64, row: &Row) -> Result<f64, Problem> {
        let (low, high) = (
            f64::from(a31301::FIELD_LIMITS.0),
            f64::from(a31301::FIELD_LIMITS.1),
        );
        if !(low..=high).contains(&counts) || counts.fract() != 0.0 {
            let fault = Fault::OutsideWord {
                value: counts,
                bits: params::SENSOR_BITS.value as u32,
                low,
                high,
            };
            return Err(fault.at(self.table.cell_place(row.line, self.picks[channel])));
        }
        Ok(counts * self.gauss_per_lsb)
    }

    pub(super) fn saturation_notices(&self) -> Vec<Notice> {
        let channels = self.saturated.iter().zip(&self.picks);
        channels
            .filter(|((count, _), _)| *count > 0)
            .map(|((count, line), pick)| Notice {
                place: self.table.cell_place(*line, *pick),
                message: format!(
                    "saturated in {count} rows, first here; rows that lean on them were left out: widen the gap or lower the load"
                ),
            })
            .collect()
    }
}

fn check_fields(table: &Table, columns: &[HallColumn]) -> Result<(), Problem> {
    let layout = Layout {
        hall: columns.to_vec(),
        forces: Vec::new(),
    };
    let sensors = layout.sensors();
    if sensors.is_empty() {
        return Err(Fault::NoField.at(Place::file(table.path()).line(1)));
    }
    for sensor in sensors {
        let of_sensor = |column: &&HallColumn| matches!(column, HallColumn::Field { sensor: s, .. } if *s == sensor);
        let fields: Vec<_> = columns.iter().filter(of_sensor).collect();
        let unit = match fields.first() {
            Some(HallColumn::Field {
                unit: FieldUnit::Gauss,
                ..
            }) => "gauss",
            _ => "lsb",
        };
        for axis in Axis::ALL {
            let name = format!("s{sensor}_{}_{unit}", axis.letter());
            let count = fields
                .iter()
                .filter(|c| matches!(c, HallColumn::Field { axis: a, .. } if *a == axis))
                .count();
            let advice = match count {
                1 => continue,
                0 => format!(
                    "sensor {sensor} needs all three axes in one unit: add it, or remove its other columns"
                ),
                _ => format!(
                    "sensor {sensor} has this axis both as raw counts and converted: keep one of the two"
                ),
            };
            return Err(Fault::MissingColumn { advice }.at(table.header_place(&name)));
        }
    }
    Ok(())
}
