//! Foreign tables turned into a campaign by a mapping file.
//!
//! A mapping says which column of the source becomes which column of a recording, and in what unit
//! it is; nothing is filtered or resampled. See [`Mapping`] for the keys.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::align::Alignment;
use super::attitude::{ANGLES, angles};
use super::campaign::Campaign;
use super::description::Description;
use super::mapping::{Mapping, Side, factor};
use super::problem::{Fault, Notice, Place, Problem, closest};
use super::table::{Cells, Table};
use crate::quantity::rounded;

/// Digits that are kept: enough for any sensor, and no 0.30000000000000004.
const IMPORTED_DIGITS: usize = 9;

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
