//! A recording and what the device estimates from it as an MCAP file.

use std::path::Path;

use firmware::compensation::Compensation;
use firmware::estimator::Estimator;
use firmware::fixed_point::Force;
use firmware::sensors::hall::HallFrame;
use model_export::recordings::DataError;
use model_export::recordings::align::Alignment;
use model_export::recordings::csv_table::{CellRule, CsvRow, CsvTable};
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::mcap::{EstimatedForce, RecordingMcap, TopicColumns};
use model_export::recordings::stream::RawStream;

use crate::ReplayModels;
use crate::networks::NetworkSet;

/// A table of the recording with its clock.
struct Rows {
    table: CsvTable,
    clock: usize,
    names: Vec<String>,
    next: Option<CsvRow>,
}

impl Rows {
    fn open(folder: &Path, name: &'static str) -> Result<Self, DataError> {
        let mut table = CsvTable::open(folder, name)?;
        let header = table.header().to_vec();
        let clock = header.iter().position(|name| name == "t_us").unwrap_or(0);
        table.set_rules(clock, vec![CellRule::Optional; header.len()]);
        let names = header.into_iter().enumerate().filter(|(i, _)| *i != clock);
        let names = names.map(|(_, name)| name).collect();
        let next = table.next_row()?;
        Ok(Self { table, clock, names, next })
    }

    /// Calls `write` with time and values of each row up to a time in microseconds.
    fn write_until(
        &mut self,
        end_us: f64,
        mut write: impl FnMut(f64, &[f64]) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        while let Some(row) = self.next.take_if(|row| row.cells[self.clock] <= end_us) {
            let mut values = row.cells;
            let time_us = values.remove(self.clock);
            write(time_us, &values)?;
            self.next = self.table.next_row()?;
        }
        Ok(())
    }
}

/// Writes the recording in `folder` to a new file, with the estimates of the device's code.
///
/// # Errors
/// The recording cannot be read, or the file cannot be written.
pub fn write_recording(
    models: &ReplayModels,
    folder: &Path,
    alignment: Alignment,
    target: &Path,
) -> Result<(), DataError> {
    let (description, _) = RecordingDescription::read(folder)?;
    let mut hall = Rows::open(folder, "hall.csv")?;
    let mut force = Rows::open(folder, "force.csv")?;
    let rows = models.rows(RawStream::open(folder, &description, alignment)?);
    let sensors: Vec<u32> = rows.sensors().iter().map(|channels| channels.number).collect();
    let columns =
        TopicColumns { hall: &hall.names, force: &force.names, sensors: &sensors, state: &[] };
    let mut file = RecordingMcap::create(target, &description, columns)?;
    let compensations: Vec<Compensation> = models.compensation_views();
    let tables = models.tables.tables(&compensations);
    let mut estimator = Estimator::new(&tables, models.networks.map(NetworkSet::start));
    for row in rows {
        let row = row?;
        let time_us = 1e6 * row.raw.time_s;
        hall.write_until(time_us, |time_us, values| file.board(time_us, values))?;
        force.write_until(time_us, |time_us, values| file.reference(time_us, values))?;
        let frame = HallFrame { readings: row.readings, ..HallFrame::default() };
        let estimates = estimator.update(&frame, &row.inputs);
        if !row.is_recorded {
            continue;
        }
        let of_sensor = |number: &u32| {
            let estimate = estimates.get(*number as usize);
            estimate.map_or_else(EstimatedForce::default, |estimate| EstimatedForce {
                force_n: estimate
                    .validity
                    .is_in_range()
                    .then(|| estimate.force.map(Force::newtons)),
                sigma_n: estimate.sigma.map(|sigma| sigma.map(Force::newtons)),
            })
        };
        file.estimate(time_us, sensors.iter().map(of_sensor))?;
    }
    hall.write_until(f64::INFINITY, |time_us, values| file.board(time_us, values))?;
    force.write_until(f64::INFINITY, |time_us, values| file.reference(time_us, values))?;
    file.finish()
}
