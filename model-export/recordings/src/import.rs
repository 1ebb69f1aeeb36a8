//! Conversion of third-party tables to a campaign, as specified by a [`Mapping`]. Values are converted, not
//! filtered or resampled.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use flate2::Compression;
use flate2::write::GzEncoder;

use crate::align::Alignment;
use crate::campaign::Campaign;
use crate::columns::is_angle;
use crate::csv_table::{CellRule, CsvRow, CsvTable};
use crate::description::{JoinedChannel, RecordingDescription, TimeOrigin};
use crate::error::{DataError, ErrorKind, Location, Notice, closest_match};
use crate::mapping::{
    ATTITUDE_COLUMNS, ColumnMapping, Mapping, TableMapping, conversion, conversion_factor,
    euler_angles,
};
use crate::mcap::{self, BagTopics, Join, Undecodable};
use crate::output::{StagingDir, check_vacant};
use crate::units::{find_unit, round_significant};

/// Significant digits of imported values: exceeds the resolution of any sensor, avoids 0.30000000000000004.
const IMPORTED_DIGITS: usize = 9;

/// An imported recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// Path of the folder.
    pub folder: PathBuf,
    /// Rows of its tables.
    pub rows: RowCounts,
}

/// Number of board rows, reference rows, reference rows with a force.
pub type RowCounts = (u64, u64, u64);

/// Converts `sources` (files, or folders where the mapping names the two files) to the campaign `target`,
/// which must not exist; a failed import leaves no folder. `done` is called with each converted source.
pub fn import(
    mapping_path: &Path,
    sources: &[PathBuf],
    target: &Path,
    done: impl Fn(&Path),
) -> Result<(Vec<Imported>, Vec<Notice>), DataError> {
    let mapping = Mapping::read(mapping_path)?;
    check_vacant(target)?;
    let draft = StagingDir::new(target, "import")?;
    if !mapping.starts_s.is_empty() && mapping.starts_s.len() != sources.len() {
        let found = format!("{} starts for {} sources", mapping.starts_s.len(), sources.len());
        let kind = ErrorKind::bad_value(found, "give one for each source, in their order");
        return Err(kind.at(Location::file(mapping_path).column("starts_s")));
    }
    let mut start = CampaignStart::default();
    let mut joins = Vec::new();
    let mut imported = Vec::new();
    for (i, source) in sources.iter().enumerate() {
        let name = (i + 1).to_string();
        let folder = draft.path().join(&name);
        std::fs::create_dir(&folder)
            .map_err(|error| ErrorKind::Unwritable(error).at(Location::file(target)))?;
        start.stated_s = mapping.starts_s.get(i).copied();
        let (rows, joined, cut) = import_one(&mapping, mapping_path, source, &folder, &mut start)?;
        joins.extend(cut);
        let place = Location::file(&target.join(&name));
        let notice = |message| Notice { location: place.clone(), message };
        joins.extend(joined.iter().map(ToString::to_string).map(notice));
        imported.push(Imported { folder: target.join(name), rows });
        done(source);
    }
    // Validation by the regular reader, before anything becomes visible.
    let campaign = Campaign::read(draft.path(), Alignment { delay_us: 0.0 }, |_| ())
        .map_err(|error| error.moved(draft.path(), target))?;
    let notices = campaign.notices().map(|notice| notice.moved(draft.path(), target));
    let notices = notices.chain(joins).collect();
    draft.commit(target)?;
    Ok((imported, notices))
}

/// Start times of the recordings in the campaign.
#[derive(Default)]
struct CampaignStart {
    first_us: Option<f64>,
    end_us: f64,
    /// That of the present source, where the mapping states it.
    stated_s: Option<f64>,
}

impl CampaignStart {
    /// Start in seconds of a recording whose clock begins at `origin_us`, and its origin.
    fn next(&mut self, is_one_clock: bool, origin_us: f64) -> (f64, TimeOrigin) {
        if is_one_clock {
            let first_us = *self.first_us.get_or_insert(origin_us);
            return ((origin_us - first_us).round() / 1e6, TimeOrigin::Measured);
        }
        match self.stated_s {
            Some(stated_s) => (stated_s, TimeOrigin::Stated),
            None => (self.end_us.round() / 1e6, TimeOrigin::Assumed),
        }
    }
}

/// Times since 1970 that a clock can have, in microseconds: 2001 to 2100.
const EPOCH_US: std::ops::Range<f64> = 1e15..4.1e15;

/// Date and time of a clock that counts since 1970.
fn date(time_us: f64) -> Option<String> {
    let since = EPOCH_US.contains(&time_us).then(|| Duration::from_secs_f64(1e-6 * time_us))?;
    Some(humantime::format_rfc3339_seconds(UNIX_EPOCH + since).to_string())
}

fn import_one(
    mapping: &Mapping,
    mapping_path: &Path,
    source: &Path,
    folder: &Path,
    start: &mut CampaignStart,
) -> Result<(RowCounts, Vec<JoinedChannel>, Vec<Notice>), DataError> {
    let (hall, force) = rayon::join(
        || SourceTable::open(&mapping.hall, CellRule::Number, mapping_path, source),
        || SourceTable::open(&mapping.force, CellRule::Optional, mapping_path, source),
    );
    let (mut hall, mut force) = (hall?, force?);
    let origin_us = hall.first_time_us()?;
    let recorded = date(origin_us - hall.clock_offset_us);
    let joined: Vec<JoinedChannel> = hall.joined.iter().chain(&force.joined).cloned().collect();
    let force_path = folder.join("force.csv.gz");
    let (hall_written, force_written) = rayon::join(
        || hall.write(&folder.join("hall.csv.gz"), origin_us, false),
        || force.write(&force_path, origin_us, true),
    );
    let ((hall_rows, _, last_us), (force_rows, measured, _)) = (hall_written?, force_written?);
    let mut cut = hall.cut_notices();
    // Both tables may be of one file.
    cut.extend(force.cut_notices());
    cut.dedup();
    // Without any force the times are kept.
    if measured == 0 {
        SourceTable::open(&mapping.force, CellRule::Optional, mapping_path, source)?.write(
            &force_path,
            origin_us,
            false,
        )?;
    }
    let (start_s, origin) = start.next(mapping.one_clock, origin_us);
    start.end_us += last_us;
    let mut description = RecordingDescription::new(mapping.description.clone(), start_s);
    description.start = Some(origin);
    let is_untimed = mapping.hall.clock.row_s.is_some();
    description.clock = is_untimed.then_some(TimeOrigin::Assumed);
    description.recorded = recorded;
    description.joined = joined.clone();
    description.covariates = mapping.covariates();
    description.range_gauss = mapping.range_gauss;
    description.gauss_per_lsb = mapping.gauss_per_lsb;
    description.design = mapping.design.clone();
    description.write(folder)?;
    Ok(((hall_rows, force_rows, measured), joined, cut))
}

/// One table of a source and the conversion of its columns.
struct SourceTable {
    table: CsvTable,
    clock: SourceClock,
    clock_offset_us: f64,
    /// Topics with a clock of their own.
    joined: Vec<JoinedChannel>,
    /// Files of a bag that were cut off.
    cut: Vec<Notice>,
    columns: Vec<SourceColumn>,
    /// Indices of the quaternion's columns.
    attitude: Option<[usize; 4]>,
}

#[derive(Clone, Copy)]
enum SourceClock {
    /// Index of its column, and its unit in microseconds.
    Column(usize, f64),
    /// Distance of the rows in microseconds.
    Rows(f64),
}

impl SourceClock {
    /// Time of a row, of which `before` precede it.
    fn time_us(self, row: &CsvRow, before: u64) -> f64 {
        match self {
            Self::Column(column, factor) => row.cells[column] * factor,
            Self::Rows(step_us) => before as f64 * step_us,
        }
    }
}

/// The table of a bag with the columns of a mapping, its joined topics, and that it was cut off.
fn bag_table(
    mapping: &TableMapping,
    rule: CellRule,
    path: &Path,
) -> Result<(CsvTable, Vec<JoinedChannel>, Vec<Notice>), DataError> {
    let columns = mapping.columns.iter().map(|column| column.from.as_str());
    let attitude = mapping.attitude.iter().flat_map(|attitude| attitude.columns());
    let mut columns: Vec<&str> = columns.chain(attitude).collect();
    columns.sort_unstable();
    columns.dedup();
    let clock = mapping.clock.from.as_str();
    let is_wanted = |topic: &str| {
        let is_of_topic =
            |column: &str| column.strip_prefix(topic).is_some_and(|rest| rest.starts_with('.'));
        columns.iter().chain([&clock]).any(|column| is_of_topic(column))
    };
    let BagTopics { topics, notices } = mcap::read_topics(path, is_wanted, Undecodable::Refuse)?;
    // Half a turn in the unit of the source: between two angles that are further apart it has wrapped.
    let half_turn = |name: &str| {
        let column = mapping.columns.iter().find(|column| column.from == name)?;
        let unit = find_unit(&column.unit).filter(|_| is_angle(&column.to))?;
        Some(std::f64::consts::PI / unit.factor)
    };
    let columns: Vec<(&str, Option<f64>)> =
        columns.into_iter().map(|name| (name, half_turn(name))).collect();
    let join = if rule == CellRule::Number { Join::EveryRow } else { Join::Once };
    let joined = mcap::join_topics(path, &topics, clock, &columns, join)?;
    let mut channels = joined.joined;
    for channel in &mut channels {
        let is_own = |column: &&ColumnMapping| channel.columns.contains(&column.from);
        let own = mapping.columns.iter().filter(is_own).map(|column| column.to.clone());
        channel.columns = own.collect();
    }
    Ok((CsvTable::from_text(path, joined.text)?, channels, notices))
}

struct SourceColumn {
    index: usize,
    to: String,
    factor: f64,
    offset: f64,
    missing: Option<f64>,
}

impl SourceColumn {
    /// Value in the unit of the target; of counts between two messages the nearest one.
    fn converted(&self, value: f64, is_joined: bool) -> f64 {
        let value = value * self.factor + self.offset;
        if is_joined && self.to.ends_with("_lsb") { value.round() } else { value }
    }
}

impl SourceTable {
    fn open(
        mapping: &TableMapping,
        rule: CellRule,
        mapping_path: &Path,
        source: &Path,
    ) -> Result<Self, DataError> {
        let path = match &mapping.file {
            Some(file) => source.join(file),
            None => source.to_path_buf(),
        };
        let (mut table, joined, cut) = if mcap::is_bag(&path) {
            bag_table(mapping, rule, &path)?
        } else {
            (CsvTable::open_foreign(&path)?, Vec::new(), Vec::new())
        };
        let index = |name: &str| {
            table.header().iter().position(|column| column == name).ok_or_else(|| {
                let columns = table.header().iter().map(String::as_str);
                let advice = closest_match(name, columns).map_or_else(
                    || format!("the columns are {}", table.header().join(", ")),
                    |near| format!("did you mean {near}?"),
                );
                ErrorKind::MissingColumn { advice }.at(table.header_location(name))
            })
        };
        let clock_factor =
            conversion_factor(mapping_path, &mapping.clock.unit, "t_us", &mapping.clock.from)?;
        let clock = match mapping.clock.row_s {
            Some(row_s) => SourceClock::Rows(1e6 * row_s),
            None => SourceClock::Column(index(&mapping.clock.from)?, clock_factor),
        };
        let mut columns = Vec::new();
        for column in &mapping.columns {
            let conversion = conversion(mapping_path, &column.unit, &column.to, &column.to)?;
            columns.push(SourceColumn {
                index: index(&column.from)?,
                to: column.to.clone(),
                factor: column.scale * conversion.factor,
                offset: conversion.offset,
                missing: column.missing,
            });
        }
        let attitude = match &mapping.attitude {
            None => None,
            Some(attitude) => {
                let [w, x, y, z] = attitude.columns().map(&index);
                Some([w?, x?, y?, z?])
            }
        };
        let mut rules = vec![CellRule::Ignored; table.header().len()];
        for column in attitude.into_iter().flatten() {
            rules[column] = CellRule::Number;
        }
        for column in &columns {
            rules[column.index] = rule;
        }
        match clock {
            SourceClock::Column(column, _) => {
                // A row without a time is one of the other table of the same file.
                rules[column] = CellRule::Optional;
                table.set_rules(column, rules);
            }
            SourceClock::Rows(_) => table.set_untimed_rules(rules),
        }
        let first = match mapping.clock.from_first_row {
            true => table.peek()?.map_or(0.0, |row| clock.time_us(row, 0)),
            false => 0.0,
        };
        let clock_offset_us = mapping.clock.offset_s * 1e6 - first;
        Ok(Self { table, clock, clock_offset_us, joined, cut, columns, attitude })
    }

    /// That the table, or a file of its bag, was cut off; complete after the last row.
    fn cut_notices(&self) -> Vec<Notice> {
        self.cut.iter().cloned().chain(self.table.cut_notice()).collect()
    }

    /// Time of the first row, which is not consumed.
    fn first_time_us(&mut self) -> Result<f64, DataError> {
        let first = self.table.peek()?.map(|row| self.clock.time_us(row, 0) + self.clock_offset_us);
        first.ok_or_else(|| ErrorKind::NoRows.at(Location::file(self.table.path())))
    }

    /// Writes all rows, or only those `with_values`: where one file holds both tables, most of its rows have no force. Returns the
    /// number of rows, the number of rows with any value, and the last time.
    fn write(
        &mut self,
        path: &Path,
        origin_us: f64,
        with_values: bool,
    ) -> Result<(u64, u64, f64), DataError> {
        let failed = |error| ErrorKind::Unwritable(error).at(Location::file(path));
        let file = File::create(path).map_err(failed)?;
        let mut out = GzEncoder::new(BufWriter::new(file), Compression::default());
        let names = self.columns.iter().map(|column| column.to.as_str());
        let angles = ATTITUDE_COLUMNS.iter().copied().filter(|_| self.attitude.is_some());
        let header: Vec<&str> = ["t_us"].into_iter().chain(names).chain(angles).collect();
        writeln!(out, "{}", header.join(",")).map_err(failed)?;
        let is_joined = !self.joined.is_empty();
        let (mut rows, mut measured, mut last_us, mut attitude) = (0, 0, 0.0, None);
        while let Some(row) = self.table.next_row()? {
            last_us = self.clock.time_us(&row, rows) + self.clock_offset_us - origin_us;
            let mut line = last_us.round().to_string();
            let mut any = false;
            for column in &self.columns {
                let value = row.cells[column.index];
                line.push(',');
                if !value.is_nan() && Some(value) != column.missing {
                    any = true;
                    line.push_str(
                        &round_significant(column.converted(value, is_joined), IMPORTED_DIGITS)
                            .to_string(),
                    );
                }
            }
            if let Some(columns) = self.attitude {
                let angles = euler_angles(columns.map(|column| row.cells[column]), attitude)
                    .map_err(|kind| kind.at(self.table.cell_location(row.line, columns[0])))?;
                for angle in angles {
                    line.push_str(&format!(",{}", round_significant(angle, IMPORTED_DIGITS)));
                }
                attitude = Some(angles);
            }
            if any || !with_values {
                writeln!(out, "{line}").map_err(failed)?;
            }
            rows += 1;
            measured += u64::from(any);
        }
        out.finish().and_then(|mut file| file.flush()).map_err(failed)?;
        Ok((rows, measured, last_us))
    }
}
