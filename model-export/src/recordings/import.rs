//! Foreign tables turned into a campaign by a mapping file.
//!
//! A mapping says which column of the source becomes which column of a recording, and in what unit
//! it is; nothing is filtered or resampled. See [`Mapping`] for the keys.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Deserialize;

use super::align::Alignment;
use super::attitude::{ANGLES, Attitude, angles};
use super::campaign::Campaign;
use super::columns::{force_column, hall_column};
use super::description::{Description, Design, parse_toml};
use super::problem::{Fault, Notice, Place, Problem, closest};
use super::table::{Cells, Table};
use crate::quantity::{UNITS, column_unit, rounded, unit_named};

/// Digits that are kept: enough for any sensor, and no 0.30000000000000004.
const IMPORTED_DIGITS: usize = 9;

/// What a mapping file holds.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Goes into every `recording.toml`.
    pub description: String,
    /// One clock runs on through all sources: their distance in it is their distance in time.
    /// Otherwise recordings are placed end to end.
    #[serde(default)]
    pub one_clock: bool,
    /// Range of the sensor in gauss, if it is known.
    #[serde(default)]
    pub range_gauss: Option<f64>,
    /// Scale of columns that stay raw counts.
    #[serde(default)]
    pub gauss_per_lsb: Option<f64>,
    /// The nominal design, if it is known, as in `recording.toml`.
    #[serde(default)]
    pub design: Option<Design>,
    /// The board's side.
    pub hall: Side,
    /// The reference's side.
    pub force: Side,
}

/// One of the two tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Side {
    /// File in the source's folder; absent where the source is one file for both sides.
    #[serde(default)]
    pub file: Option<String>,
    /// The side's own clock.
    pub clock: Clock,
    /// Columns to take. The reference's may be none: a sensor that nothing pushes.
    pub columns: Vec<Column>,
    /// The quaternion from the body to the world (the board's side only); it becomes `roll_rad`,
    /// `pitch_rad` and `yaw_rad`.
    #[serde(default)]
    pub attitude: Option<Attitude>,
}

/// A clock of the source.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clock {
    /// Column of the source.
    pub from: String,
    /// Its unit.
    pub unit: String,
    /// Added to it, in seconds: brings two clocks of different epochs together.
    #[serde(default)]
    pub offset_s: f64,
}

/// One column.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// Column of the source.
    pub from: String,
    /// Its unit, as people write it.
    pub unit: String,
    /// Column of the recording.
    pub to: String,
    /// Multiplies the value after its unit; -1 turns a sign.
    #[serde(default = "one")]
    pub scale: f64,
    /// Value that the source writes where nothing was measured (forces only).
    #[serde(default)]
    pub missing: Option<f64>,
}

fn one() -> f64 {
    1.0
}

impl Mapping {
    /// Reads and checks a mapping file.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
        let mapping: Self = parse_toml(path, &text)?;
        for side in [&mapping.hall, &mapping.force] {
            factor(path, &side.clock.unit, "t_us", &side.clock.from)?;
            for column in &side.columns {
                factor(path, &column.unit, &column.to, &column.to)?;
                if !column.scale.is_finite() || column.scale == 0.0 {
                    let found = format!("scale = {}", column.scale);
                    let advice = "give a number other than zero".to_owned();
                    return Err(Fault::BadValue { found, advice }
                        .at(Place::file(path).column(column.to.as_str())));
                }
            }
        }
        let declared = mapping.covariates();
        for column in &mapping.hall.columns {
            hall_column(&column.to, &declared)
                .map_err(|fault| fault.at(Place::file(path).column(column.to.as_str())))?;
            if column.missing.is_some() {
                let found = "missing".to_owned();
                let advice =
                    "only forces may be missing; a covariate is there in every row or not at all"
                        .to_owned();
                return Err(Fault::BadValue { found, advice }
                    .at(Place::file(path).column(column.to.as_str())));
            }
        }
        if mapping.force.attitude.is_some() {
            let found = "attitude beside the forces".to_owned();
            let advice = "the attitude is the board's: move it to [hall]".to_owned();
            return Err(Fault::BadValue { found, advice }.at(Place::file(path).column("attitude")));
        }
        for column in &mapping.force.columns {
            force_column(&column.to)
                .map_err(|fault| fault.at(Place::file(path).column(column.to.as_str())))?;
        }
        Ok(mapping)
    }

    /// Names of covariates that the format does not know.
    fn covariates(&self) -> Vec<String> {
        let names = self.hall.columns.iter().map(|column| &column.to);
        names
            .filter(|name| hall_column(name, &[]).is_err() && column_unit(name).is_some())
            // A misspelt field is not a covariate.
            .filter(|name| {
                !name.starts_with('s') || !name[1..].starts_with(|c: char| c.is_ascii_digit())
            })
            .cloned()
            .collect()
    }
}

/// Factor from the stated unit to that of the target column.
fn factor(path: &Path, unit: &str, to: &str, key: &str) -> Result<f64, Problem> {
    let bad = |found: String, advice: String| {
        Err(Fault::BadValue { found, advice }.at(Place::file(path).column(key)))
    };
    let names = || UNITS.iter().map(|unit| unit.name);
    let Some(known) = unit_named(unit) else {
        let hint = closest(unit, names())
            .map_or_else(String::new, |name| format!("did you mean {name:?}? "));
        return bad(
            format!("the unit {unit:?}"),
            format!(
                "{hint}known units: {}",
                names().collect::<Vec<_>>().join(", ")
            ),
        );
    };
    if column_unit(to) != Some(known.canonical) {
        return bad(
            format!("the unit {unit:?}"),
            format!(
                "{to} is not in a unit that {unit:?} converts to ({})",
                known.canonical
            ),
        );
    }
    Ok(known.factor)
}

/// A recording that was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// Its folder.
    pub folder: PathBuf,
    /// Rows of the board, rows of the reference, and how many of the latter hold a force.
    pub rows: (u64, u64, u64),
}

/// Writes `sources` (files, or folders where the mapping names the two files) as the campaign
/// `target`, which must not exist yet. All or nothing: a failed import leaves no folder behind.
pub fn import(
    mapping_path: &Path,
    sources: &[PathBuf],
    target: &Path,
    done: impl Fn(&Path),
) -> Result<(Vec<Imported>, Vec<Notice>), Problem> {
    let mapping = Mapping::read(mapping_path)?;
    let unwritable = |error| Fault::Unwritable(error).at(Place::file(target));
    if target.exists() {
        let advice = "choose another folder, or move the old one away: an import never overwrites"
            .to_owned();
        let found = "a folder that exists".to_owned();
        return Err(Fault::BadValue { found, advice }.at(Place::file(target)));
    }
    let parent = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).map_err(unwritable)?;
    let draft = tempfile::Builder::new()
        .prefix(".magpie-import-")
        .tempdir_in(parent)
        .map_err(unwritable)?;
    let mut session = Session::default();
    let mut imported = Vec::new();
    for (i, source) in sources.iter().enumerate() {
        let name = (i + 1).to_string();
        let folder = draft.path().join(&name);
        std::fs::create_dir(&folder).map_err(unwritable)?;
        let rows = import_one(&mapping, mapping_path, source, &folder, &mut session)?;
        imported.push(Imported {
            folder: target.join(name),
            rows,
        });
        done(source);
    }
    // Read it back the way every other command will: what is wrong shows before anything is kept.
    let campaign = Campaign::read(draft.path(), Alignment { delay_us: 0.0 }, |_| ())
        .map_err(|problem| problem.moved(draft.path(), target))?;
    let notices = campaign
        .notices()
        .map(|notice| notice.moved(draft.path(), target))
        .collect();
    std::fs::rename(draft.keep(), target).map_err(unwritable)?;
    Ok((imported, notices))
}

/// Where the recordings lie in the campaign's time.
#[derive(Default)]
struct Session {
    first_us: Option<f64>,
    end_us: f64,
}

fn import_one(
    mapping: &Mapping,
    mapping_path: &Path,
    source: &Path,
    folder: &Path,
    session: &mut Session,
) -> Result<(u64, u64, u64), Problem> {
    let mut hall = Source::open(&mapping.hall, Cells::Number, mapping_path, source)?;
    let origin_us = hall.first_time_us()?;
    let mut force = Source::open(&mapping.force, Cells::MayBeEmpty, mapping_path, source)?;
    let (hall_rows, _, last_us) = hall.write(&folder.join("hall.csv.gz"), origin_us)?;
    let (force_rows, measured, _) = force.write(&folder.join("force.csv.gz"), origin_us)?;
    let start_us = match mapping.one_clock {
        true => origin_us - *session.first_us.get_or_insert(origin_us),
        false => session.end_us,
    };
    session.end_us += last_us;
    let mut description = Description::new(mapping.description.clone(), start_us.round() / 1e6);
    description.covariates = mapping.covariates();
    description.range_gauss = mapping.range_gauss;
    description.gauss_per_lsb = mapping.gauss_per_lsb;
    description.design = mapping.design.clone();
    description.write(folder)?;
    Ok((hall_rows, force_rows, measured))
}

/// One side of the source, and what becomes of its columns.
struct Source {
    table: Table,
    clock: usize,
    clock_factor: f64,
    clock_offset_us: f64,
    picks: Vec<Pick>,
    /// Columns of the quaternion.
    attitude: Option<[usize; 4]>,
}

struct Pick {
    column: usize,
    to: String,
    factor: f64,
    missing: Option<f64>,
}

impl Source {
    fn open(
        side: &Side,
        values: Cells,
        mapping_path: &Path,
        source: &Path,
    ) -> Result<Self, Problem> {
        let path = match &side.file {
            Some(file) => source.join(file),
            None => source.to_path_buf(),
        };
        let mut table = Table::open_file(&path)?;
        let find = |name: &str| {
            table
                .header()
                .iter()
                .position(|column| column == name)
                .ok_or_else(|| {
                    let columns = table.header().iter().map(String::as_str);
                    let hint = closest(name, columns).map_or_else(
                        || format!("the columns are {}", table.header().join(", ")),
                        |near| format!("did the mapping mean {near}?"),
                    );
                    Fault::MissingColumn { advice: hint }.at(table.header_place(name))
                })
        };
        let clock = find(&side.clock.from)?;
        let mut picks = Vec::new();
        for column in &side.columns {
            picks.push(Pick {
                column: find(&column.from)?,
                to: column.to.clone(),
                factor: column.scale * factor(mapping_path, &column.unit, &column.to, &column.to)?,
                missing: column.missing,
            });
        }
        let attitude = match &side.attitude {
            None => None,
            Some(attitude) => {
                let [w, x, y, z] = attitude.columns().map(&find);
                Some([w?, x?, y?, z?])
            }
        };
        let mut cells = vec![Cells::Ignored; table.header().len()];
        for column in attitude.into_iter().flatten() {
            cells[column] = Cells::Number;
        }
        for pick in &picks {
            cells[pick.column] = values;
        }
        cells[clock] = Cells::Number;
        table.rules(clock, cells);
        let clock_factor = factor(mapping_path, &side.clock.unit, "t_us", &side.clock.from)?;
        Ok(Self {
            table,
            clock,
            clock_factor,
            clock_offset_us: side.clock.offset_s * 1e6,
            picks,
            attitude,
        })
    }

    /// Time of the first row; the row comes again.
    fn first_time_us(&mut self) -> Result<f64, Problem> {
        let first = self
            .table
            .peek()?
            .map(|row| row.cells[self.clock] * self.clock_factor + self.clock_offset_us);
        first.ok_or_else(|| Fault::NoRows.at(Place::file(self.table.path())))
    }

    /// Writes all rows; returns how many, how many hold any value, and the last time.
    fn write(&mut self, path: &Path, origin_us: f64) -> Result<(u64, u64, f64), Problem> {
        let failed = |error| Fault::Unwritable(error).at(Place::file(path));
        let file = File::create(path).map_err(failed)?;
        let mut out = GzEncoder::new(BufWriter::new(file), Compression::default());
        let names = self.picks.iter().map(|pick| pick.to.as_str());
        let turns = ANGLES.iter().copied().filter(|_| self.attitude.is_some());
        let header: Vec<&str> = ["t_us"].into_iter().chain(names).chain(turns).collect();
        writeln!(out, "{}", header.join(",")).map_err(failed)?;
        let (mut rows, mut measured, mut last_us, mut attitude) = (0, 0, 0.0, None);
        while let Some(row) = self.table.next_row()? {
            last_us = row.cells[self.clock] * self.clock_factor + self.clock_offset_us - origin_us;
            let mut line = last_us.round().to_string();
            let mut any = false;
            for pick in &self.picks {
                let value = row.cells[pick.column];
                line.push(',');
                if !value.is_nan() && Some(value) != pick.missing {
                    any = true;
                    line.push_str(&rounded(value * pick.factor, IMPORTED_DIGITS).to_string());
                }
            }
            if let Some(columns) = self.attitude {
                let turned = angles(columns.map(|column| row.cells[column]), attitude)
                    .map_err(|fault| fault.at(self.table.cell_place(row.line, columns[0])))?;
                for angle in turned {
                    line.push_str(&format!(",{}", rounded(angle, IMPORTED_DIGITS)));
                }
                attitude = Some(turned);
            }
            writeln!(out, "{line}").map_err(failed)?;
            rows += 1;
            measured += u64::from(any);
        }
        out.finish()
            .and_then(|mut file| file.flush())
            .map_err(failed)?;
        Ok((rows, measured, last_us))
    }
}
