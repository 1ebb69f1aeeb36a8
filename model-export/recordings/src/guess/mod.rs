//! Proposal of a mapping file for third-party tables, from the names and the values of their columns.
//!
//! What a name does not state is derived from the values (the unit of a clock from its step) or assumed. Each such decision
//! is a comment of the proposal and listed, since a wrong unit or axis yields a campaign that is read without an error.

mod names;
mod source;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use crate::columns::{Axis, COVARIATES, hall_column};
use crate::description::parse_toml;
use crate::error::{DataError, ErrorKind, Location};
use crate::guess::names::{Group, Quantity};
pub use crate::guess::source::{MAX_ROWS, SourceColumn, SourceTable};
use crate::guess::source::{axis_of, column_groups, numeric, read_source, table_with};
use crate::mapping::{Mapping, TableMapping};
use crate::mcap;
use crate::units::{find_unit, round_significant};

/// Plausible maximum magnitudes of a field in gauss and of a force in newtons; beyond, the unit is probably another.
const FIELD_G: (f64, f64) = (0.05, 5000.0);
const FORCE_N: (f64, f64) = (0.05, 2000.0);

/// A proposed mapping file.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Content of the file.
    pub text: String,
    /// Columns to import.
    pub columns: Vec<ProposedColumn>,
    /// Decisions that the tables do not determine: what to check.
    pub checks: Vec<Check>,
    /// Columns that are not imported, with the reason.
    pub ignored: Vec<(String, Cow<'static, str>)>,
}

/// A decision that the tables do not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// The columns, tables or files that it is about; none where it is about all of them.
    pub about: Vec<String>,
    /// What was assumed.
    pub text: String,
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = &self.text;
        match self.about.as_slice() {
            [] => f.write_str(text),
            [first, .., last] if self.about.len() > 3 => {
                write!(f, "{first} to {last} ({} columns): {text}", self.about.len())
            }
            names => write!(f, "{}: {text}", names.join(", ")),
        }
    }
}

/// What the sources hold, also where no mapping can be proposed.
#[derive(Debug)]
pub struct Survey {
    /// Tables of the first source.
    pub tables: Vec<SourceTable>,
    /// A mapping, or why none is proposed.
    pub proposal: Result<Proposal, DataError>,
}

/// A column to import.
#[derive(Clone, Debug, PartialEq)]
pub struct ProposedColumn {
    /// Name in the source.
    pub from: String,
    /// Unit of the source.
    pub unit: &'static str,
    /// Name in the recording.
    pub to: String,
    /// Minimum and maximum in the unit of the source, without markers of missing measurements.
    pub range: (f64, f64),
    /// Marker of missing measurements.
    missing: Option<f64>,
    /// Decision that the table does not determine.
    check: Option<String>,
}

/// Proposes a mapping for `sources`, from the columns of the first one: files, or folders of two tables.
///
/// # Errors
/// A source cannot be read, has no field, or has other columns than the first.
pub fn propose(sources: &[PathBuf]) -> Result<Proposal, DataError> {
    stated(sources)?.map_or_else(|| of_tables(&read(sources)?), Ok)
}

/// Reads `sources` and proposes a mapping for them.
///
/// # Errors
/// A source cannot be read.
pub fn survey(sources: &[PathBuf]) -> Result<Survey, DataError> {
    let recordings = read(sources)?;
    let proposal = stated(sources)?.map_or_else(|| of_tables(&recordings), Ok);
    Ok(Survey { tables: recordings.into_iter().next().unwrap_or_default(), proposal })
}

fn read(sources: &[PathBuf]) -> Result<Vec<Vec<SourceTable>>, DataError> {
    let mut recordings: Vec<Vec<SourceTable>> = Vec::new();
    for source in sources {
        let first = recordings.first().map_or(&[][..], Vec::as_slice);
        recordings.push(read_source(source, first)?);
    }
    Ok(recordings)
}

/// Proposes a mapping for the tables of each recording.
fn of_tables(recordings: &[Vec<SourceTable>]) -> Result<Proposal, DataError> {
    let Some((first, others)) = recordings.split_first() else {
        return Ok(Proposal {
            text: String::new(),
            columns: vec![],
            checks: vec![],
            ignored: vec![],
        });
    };
    let hall = table_with(first, Quantity::Field).ok_or_else(|| no_field(first))?;
    let force = table_with(first, Quantity::Force);
    for other in others {
        check_equal_columns(hall, other, force.is_none())?;
    }
    let mut draft = Draft::default();
    for table in first {
        let name = table.path.file_name().unwrap_or_default().to_string_lossy();
        for note in &table.notes {
            draft.check_column(&name, note);
        }
    }
    let sensors = draft.fields(hall);
    if sensors.is_empty() {
        return Err(no_field(first));
    }
    draft.covariates(hall, &sensors);
    let hall_end = draft.columns.len();
    let attitude = draft.attitude(hall);
    match force {
        Some(force) => draft.forces(force, &sensors),
        None => draft.check(
            "no column of a force was recognised: without a reference nothing can be fitted; complete [force]",
        ),
    }
    let force = force.unwrap_or(hall);
    let hall_clock = draft.clock(hall, &["sensor", "hall", "mag", "board", "mcu", "device"])?;
    let force_clock =
        draft.clock(force, &["force", "state", "ref", "scale", "ft", "load", "robot"])?;
    let mut offset_s = clock_offset_s((hall, &hall_clock), (force, &force_clock));
    // Loggers that begin anew with each recording, or whose clocks have another distance in each.
    let of_other = |tables: &Vec<SourceTable>| {
        let hall = table_with(tables, Quantity::Field)?;
        let force = table_with(tables, Quantity::Force).unwrap_or(hall);
        clock_offset_s((hall, &hall_clock), (force, &force_clock))
    };
    let is_other = |other: Option<f64>| match (offset_s, other) {
        (Some(one), Some(other)) => (one - other).abs() > SAME_OFFSET_S,
        (one, other) => one.is_some() || other.is_some(),
    };
    let from_first_row = others.iter().map(of_other).any(is_other);
    if from_first_row {
        offset_s = None;
        draft.check(
            "the two clocks differ by another time in each recording: taken to begin at the same instant, from_first_row = true; \
             `compare` tells the rest of the delay",
        );
    }
    if let Some(offset_s) = offset_s {
        draft.check(format!(
            "the two clocks do not overlap: taken to begin at the same instant, offset_s = {offset_s}; `compare` tells the rest \
             of the delay"
        ));
    }
    draft.unused(&[hall, force], &[&hall_clock, &force_clock], attitude.is_some());
    let one_clock = !from_first_row && runs_on(hall, &hall_clock, others);
    if one_clock {
        draft.check("each file begins after the end of the one before: taken as one running clock");
    }
    if !one_clock && !others.is_empty() {
        draft.check("the clocks begin anew with each file, so the times between the recordings are not known: give starts_s, else no drift over the campaign can be found");
    }
    let (hall_columns, force_columns) = draft.columns.split_at(hall_end);
    let mut text = head(first, &draft, one_clock);
    let is_folder = hall.is_in_folder;
    let of_hall = (&hall_clock, None, from_first_row);
    write_table(&mut text, "hall", hall, is_folder, of_hall, hall_columns);
    if let Some([w, x, y, z]) = attitude {
        let [w, x, y, z] = [w, x, y, z].map(quoted);
        let _ = writeln!(text, "attitude = {{ w = {w}, x = {x}, y = {y}, z = {z} }}");
    }
    let of_force = (&force_clock, offset_s, from_first_row);
    write_table(&mut text, "force", force, is_folder, of_force, force_columns);
    text.push_str(DESIGN);
    for (name, reason) in &draft.ignored {
        let _ = writeln!(text, "# Not imported: {} ({reason})", quoted(name));
    }
    Ok(Proposal { text, columns: draft.columns, checks: draft.checks, ignored: draft.ignored })
}

/// The mapping that the first source states of itself, if it does: nothing is to be checked.
fn stated(sources: &[PathBuf]) -> Result<Option<Proposal>, DataError> {
    let Some(path) = sources.first().filter(|first| mcap::is_bag(first)) else { return Ok(None) };
    let Some(text) = mcap::stated_mapping(path)? else { return Ok(None) };
    let mapping: Mapping = parse_toml(path, &text)?;
    let of_table = |table: &TableMapping| table.columns.clone();
    let all = of_table(&mapping.hall).into_iter().chain(of_table(&mapping.force));
    let columns = all.filter_map(|column| {
        let unit = find_unit(&column.unit)?.name;
        let range = (f64::NAN, f64::NAN);
        Some(ProposedColumn {
            from: column.from,
            unit,
            to: column.to,
            range,
            missing: None,
            check: None,
        })
    });
    let columns = columns.collect();
    Ok(Some(Proposal { text, columns, checks: Vec::new(), ignored: Vec::new() }))
}

/// The nominal design as a comment.
const DESIGN: &str = "
# The nominal design of the sensor, if you know it; without it, fit with `--base polynomial`.
# [design]
# gap_mm = 2.0                    # from the magnet's face to the Hall element, unloaded
# stiffness_x_n_per_mm = 100.0    # lateral (grasping)
# stiffness_z_n_per_mm = 100.0    # longitudinal
# force_range_n = 250.0           # largest force of each axis, either sign; the tables of the device cover it
# magnet = { shape = \"cylinder\", diameter_mm = 4.0, length_mm = 3.0, remanence_t = 1.3, axis = \"y\" }

";

fn no_field(tables: &[SourceTable]) -> DataError {
    let in_gauss = |column: &SourceColumn| {
        column.stated.axis.is_none()
            && column.stated.unit.is_some_and(|unit| unit.canonical == "gauss")
    };
    let names = |is_listed: &dyn Fn(&SourceColumn) -> bool| {
        let columns = tables.iter().flat_map(|table| &table.columns);
        let listed = columns.filter(|column| is_listed(column)).map(|column| column.name.as_str());
        listed.collect::<Vec<_>>().join(", ")
    };
    let without_axis = names(&in_gauss);
    let (found, advice, names) = if without_axis.is_empty() {
        let advice = "call its columns bx, by, bz with a number or a letter for each sensor";
        ("a table without a magnetic field", advice, names(&|_| true))
    } else {
        let advice = "put x, y or z into their names, such as bx_mT";
        ("a magnetic field without its axis", advice, without_axis)
    };
    let advice =
        format!("{advice}, or write the mapping yourself (`cargo magpie import --help`): {names}");
    let path = tables.first().map_or(Path::new(""), |table| &table.path);
    ErrorKind::bad_value(found, advice).at(Location::file(path).line(1))
}

/// The checks as one; none without one.
fn joined(checks: Vec<String>) -> Option<String> {
    (!checks.is_empty()).then(|| checks.join("; "))
}

/// Checks that a source has the columns of the first one.
fn check_equal_columns(
    hall: &SourceTable,
    other: &[SourceTable],
    no_force: bool,
) -> Result<(), DataError> {
    let names = |table: &SourceTable| {
        table.columns.iter().map(|column| column.name.clone()).collect::<Vec<_>>()
    };
    if other.iter().any(|table| names(table) == names(hall)) {
        return Ok(());
    }
    let path = other.first().map_or(Path::new(""), |table| &table.path);
    let advice = if no_force && table_with(other, Quantity::Force).is_some() {
        "where field and force of a recording are in two files, put both into a folder and give the folders".to_owned()
    } else {
        format!(
            "give files with the columns of {} only, and others in another campaign",
            hall.path.display()
        )
    };
    Err(ErrorKind::bad_value("a table with other columns", advice).at(Location::file(path)))
}

/// What to add to the clock of the forces, in seconds, where the two clocks do not overlap: they have different origins.
fn clock_offset_s(
    (hall, hall_clock): (&SourceTable, &ClockColumn),
    (force, force_clock): (&SourceTable, &ClockColumn),
) -> Option<f64> {
    let span_s = |table: &SourceTable, clock: &ClockColumn| {
        let column = table.columns.iter().find(|column| column.name == clock.name)?;
        let factor = 1e-6 * find_unit(clock.unit)?.factor;
        Some((column.first * factor, column.last * factor))
    };
    let (hall_s, force_s) = (span_s(hall, hall_clock)?, span_s(force, force_clock)?);
    let do_overlap = hall_s.0 <= force_s.1 && force_s.0 <= hall_s.1;
    (!do_overlap).then(|| ((hall_s.0 - force_s.0) * 1e6).round() / 1e6)
}

/// True if the clock of every further source begins after the end of the one before.
fn runs_on(hall: &SourceTable, clock: &ClockColumn, others: &[Vec<SourceTable>]) -> bool {
    let column = |tables: &'_ [SourceTable]| {
        let columns = tables.iter().flat_map(|table| &table.columns);
        columns
            .clone()
            .find(|column| column.name == clock.name)
            .map(|column| (column.first, column.last))
    };
    let mut spans = vec![column(std::slice::from_ref(hall))];
    spans.extend(others.iter().map(|tables| column(tables)));
    let follows = |pair: &[Option<(f64, f64)>]| matches!(pair, [Some((_, end)), Some((start, _))] if start > end);
    spans.len() > 1 && spans.windows(2).all(follows)
}

/// Difference of the distance of two clocks from recording to recording within which it is the same, in seconds.
const SAME_OFFSET_S: f64 = 0.01;

/// A clock column with its unit.
struct ClockColumn {
    name: String,
    unit: &'static str,
    check: Option<String>,
}

/// Columns and checks so far.
#[derive(Default)]
struct Draft {
    columns: Vec<ProposedColumn>,
    checks: Vec<Check>,
    ignored: Vec<(String, Cow<'static, str>)>,
}

impl Draft {
    fn check(&mut self, text: impl Into<String>) {
        self.checks.push(Check { about: Vec::new(), text: text.into() });
    }

    fn check_column(&mut self, name: &str, text: &str) {
        let mut known = self.checks.iter_mut();
        match known.find(|check| check.text == text && !check.about.is_empty()) {
            Some(Check { about, .. }) if about.iter().any(|own| own == name) => {}
            Some(Check { about, .. }) => about.push(name.to_owned()),
            None => {
                self.checks.push(Check { about: vec![name.to_owned()], text: text.to_owned() });
            }
        }
    }

    fn is_used(&self, name: &str) -> bool {
        self.columns.iter().any(|column| column.from == name)
    }

    /// Adds a column; `check` is what its name or values do not determine.
    fn add(
        &mut self,
        column: &SourceColumn,
        unit: &'static str,
        to: String,
        check: Option<String>,
    ) {
        let missing = to.starts_with('f').then(|| column.missing()).flatten();
        let mut checks: Vec<String> = check.into_iter().collect();
        if let Some(marker) = missing {
            checks.push(format!("{marker} is taken as the code of missing values"));
        }
        let magnitude = column.magnitude() * find_unit(unit).map_or(1.0, |unit| unit.factor);
        let plausible = match find_unit(unit).map(|unit| unit.canonical) {
            Some("gauss") => Some((FIELD_G, "G")),
            Some("n") => Some((FORCE_N, "N")),
            _ => None,
        };
        if let Some(((min, max), symbol)) = plausible
            && !(min..=max).contains(&magnitude)
        {
            checks.push(format!(
                "at most {} {symbol}, which is unusual: is it in {unit}?",
                short(magnitude)
            ));
        }
        let check = joined(checks);
        if let Some(check) = &check {
            self.check_column(&column.name, check);
        }
        let from = column.name.clone();
        self.columns.push(ProposedColumn { from, unit, to, range: column.range(), missing, check });
    }

    /// Adds the fields; returns the groups of the sensors in their order.
    fn fields(&mut self, table: &SourceTable) -> Vec<Group> {
        let fields = || numeric(table, Quantity::Field).filter(|column| axis_of(column).is_some());
        let has = |group: &Group, axis: Axis| {
            fields().any(|column| column.stated.group == *group && axis_of(column) == Some(axis))
        };
        let (mut complete, mut partial): (Vec<&Group>, Vec<&Group>) = column_groups(fields())
            .into_iter()
            .partition(|group| Axis::ALL.into_iter().all(|axis| has(group, axis)));
        if complete.is_empty() && !partial.is_empty() {
            std::mem::swap(&mut complete, &mut partial);
            self.check("a sensor has not all of x, y and z: its field can be fitted with --base polynomial only");
        }
        let mut without_unit = fields().filter(|column| column.stated.unit.is_none());
        let are_whole = without_unit.all(|column| column.is_whole);
        for column in fields().filter(|column| partial.contains(&&column.stated.group)) {
            self.ignored.push((column.name.clone(), "its sensor has not all of x, y and z".into()));
        }
        for (sensor, group) in complete.iter().enumerate() {
            for column in fields().filter(|column| column.stated.group == **group) {
                let Some(axis) = axis_of(column) else { continue };
                let to = |unit: &str| format!("s{sensor}_{}_{unit}", axis.letter());
                if self.has(&to("lsb")) || self.has(&to("gauss")) {
                    self.ignored.push((
                        column.name.clone(),
                        "a second field of this sensor and axis".into(),
                    ));
                    continue;
                }
                match column.stated.unit {
                    Some(unit) if unit.canonical == "lsb" => {
                        self.add(column, "lsb", to("lsb"), None);
                    }
                    Some(unit) => self.add(column, unit.name, to("gauss"), None),
                    None if are_whole => {
                        let check = "whole numbers without a unit: taken as raw counts";
                        self.add(column, "lsb", to("lsb"), Some(check.to_owned()));
                    }
                    None => {
                        let check = "no unit: taken as gauss".to_owned();
                        self.add(column, "G", to("gauss"), Some(check));
                    }
                }
            }
        }
        if self.columns.iter().any(|column| column.unit == "lsb") {
            self.check("raw counts: give gauss_per_lsb, the scale from the sensor's data sheet");
        }
        self.check(
            "axes and signs: x lateral (grasping) and z longitudinal in the plane of motion, y across the gap; a force and the \
             motion that it causes have one sign; exchange the columns of the forces, or set scale = -1, where yours are otherwise; leave \
             those of the field in the axes of the sensor, whose orientation a fit finds",
        );
        if let Some(axis) = strongest_axis(&fields().collect::<Vec<_>>())
            && axis != Axis::Y
        {
            self.check(format!(
                "the field is strongest on {0}: if the magnet is magnetised across the gap, your {0} is the y of this project: \
                 name the forces accordingly",
                axis.letter()
            ));
        }
        complete.into_iter().cloned().collect()
    }

    /// Adds temperatures, accelerations, motor and pose, and other lengths and angles.
    fn covariates(&mut self, table: &SourceTable, sensors: &[Group]) {
        let temperatures: Vec<_> =
            numeric(table, Quantity::Temperature).filter(|column| !column.is_constant()).collect();
        for column in &temperatures {
            let unit = column.stated.unit.is_none().then(|| "no unit: taken as degC".to_owned());
            let group = &column.stated.group;
            if let Some(sensor) = sensors.iter().position(|own| own == group) {
                self.add(column, "degC", format!("s{sensor}_temp_c"), unit);
            } else if temperatures.len() == 1 && *group == (Vec::new(), None) {
                let check = match sensors {
                    [_] => unit,
                    _ => Some("one temperature: taken as that of every sensor, in degC".to_owned()),
                };
                for sensor in 0..sensors.len() {
                    let check = check.clone().filter(|_| sensor == 0);
                    self.add(column, "degC", format!("s{sensor}_temp_c"), check);
                }
            } else {
                let check = "no sensor of this name: map it to sN_temp_c where it is the temperature of a sensor";
                self.named(column, "degC", Some(check.to_owned()));
            }
        }
        for column in numeric(table, Quantity::Acceleration) {
            let unit = column.stated.unit.map(|unit| unit.name);
            // Gravity is 9.8 m/s2.
            let guessed = if column.magnitude() < 4.0 { "g0" } else { "m/s2" };
            let check = unit.is_none().then(|| format!("no unit: taken as {guessed}"));
            match column.stated.axis {
                Some(axis @ ('x' | 'y' | 'z')) if !self.has(&format!("accel_{axis}_mps2")) => {
                    self.add(column, unit.unwrap_or(guessed), format!("accel_{axis}_mps2"), check);
                }
                _ => self
                    .ignored
                    .push((column.name.clone(), "a second or unclear acceleration".into())),
            }
        }
        let has_word = |column: &SourceColumn, words: &[&str]| {
            column.stated.words.iter().any(|word| words.contains(&word.as_str()))
        };
        let standard: [(Quantity, &str, &[&str], &str); 6] = [
            (Quantity::Length, "mm", &["opening", "aperture", "width"], "opening_mm"),
            (Quantity::Current, "A", &["iq", "motor"], "motor_iq_a"),
            (Quantity::Angle, "rad", &["motor", "rotor"], "motor_angle_rad"),
            (Quantity::Angle, "rad", &["roll"], "roll_rad"),
            (Quantity::Angle, "rad", &["pitch"], "pitch_rad"),
            (Quantity::Angle, "rad", &["yaw"], "yaw_rad"),
        ];
        for (quantity, default, words, to) in standard {
            let Some(column) = numeric(table, quantity).find(|column| has_word(column, words))
            else {
                continue;
            };
            let mut checks = Vec::new();
            if to == "opening_mm" && !has_word(column, &["opening"]) {
                checks.push("taken as the opening between the fingertips".to_owned());
            }
            if to == "motor_iq_a" && !has_word(column, &["iq"]) {
                checks.push("taken as the current in phase with the torque".to_owned());
            }
            if column.stated.unit.is_none() {
                checks.push(format!("no unit: taken as {default}"));
            }
            self.add(
                column,
                column.stated.unit.map_or(default, |unit| unit.name),
                to.to_owned(),
                joined(checks),
            );
        }
        for column in &table.columns {
            let is_other = matches!(
                column.quantity,
                Quantity::Length | Quantity::Current | Quantity::Angle | Quantity::Other
            );
            if is_other
                && column.is_numeric()
                && !column.is_constant()
                && !self.is_used(&column.name)
            {
                match column.stated.unit {
                    Some(unit) => {
                        let check = (column.quantity == Quantity::Length).then(|| {
                            "a covariate of its own, for formulas: map the opening between the fingertips to opening_mm".to_owned()
                        });
                        self.named(column, unit.name, check);
                    }
                    None => self.ignored.push((column.name.clone(), "no unit".into())),
                }
            }
        }
    }

    fn has(&self, to: &str) -> bool {
        self.columns.iter().any(|column| column.to == to)
    }

    /// Adds a covariate under its own name.
    fn named(&mut self, column: &SourceColumn, unit: &'static str, check: Option<String>) {
        let Some(found) = find_unit(unit) else { return };
        let mut to = column.stated.words.join("_");
        let is_plain = to.starts_with(|c: char| c.is_ascii_lowercase()) && to.is_ascii();
        // A sensor's name with a number is not that of a covariate.
        if !is_plain || to.starts_with(['s', 'f']) {
            to = format!("covariate_{}", if to.is_ascii() { to.as_str() } else { "of_source" });
        }
        to = format!("{to}_{}", found.canonical);
        let is_valid = hall_column(&to, std::slice::from_ref(&to)).is_ok()
            && !COVARIATES.contains(&to.as_str());
        if is_valid && !self.has(&to) {
            self.add(column, unit, to, check);
        } else {
            self.ignored.push((column.name.clone(), "its name is not unique".into()));
        }
    }

    /// Columns of an attitude as a quaternion, scalar part first.
    fn attitude<'a>(&mut self, table: &'a SourceTable) -> Option<[&'a str; 4]> {
        let part = |axis: char| {
            let mut columns = numeric(table, Quantity::Attitude);
            columns
                .find(|column| column.stated.axis == Some(axis))
                .map(|column| column.name.as_str())
        };
        let parts = [part('w')?, part('x')?, part('y')?, part('z')?];
        self.check("attitude: the quaternion is taken as body to world");
        Some(parts)
    }

    /// Adds the forces: on the sensor of the same name or number, else in their order.
    fn forces(&mut self, table: &SourceTable, sensors: &[Group]) {
        let forces: Vec<_> = numeric(table, Quantity::Force).collect();
        let groups = column_groups(forces.iter().copied());
        let places: Vec<Option<usize>> =
            groups.iter().map(|group| sensor_of(group, sensors)).collect();
        // Several forces of one sensor have different axes.
        let mut owners = BTreeMap::new();
        let is_taken_twice = forces.iter().any(|column| {
            let own = &column.stated.group;
            let place = groups.iter().position(|group| *group == own).and_then(|i| places[i]);
            owners.insert((place, column.stated.axis), own).is_some_and(|other| other != own)
        });
        let is_only = groups.len() == 1 && sensors.len() == 1;
        let is_named = !is_taken_twice && places.iter().all(Option::is_some);
        if !is_named && !is_only {
            let count =
                |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
            self.check(format!(
                "{} for {}, assigned in their order: f0 is the force on sensor 0, and so on; correct the numbers",
                count(groups.len(), "force sensor"),
                count(sensors.len(), "field sensor"),
            ));
        }
        for column in forces {
            let group = groups.iter().position(|group| **group == column.stated.group).unwrap_or(0);
            let index = if is_named { places[group].unwrap_or(group) } else { group };
            let mut checks = Vec::new();
            if column.stated.unit.is_none() {
                checks.push("no unit: taken as newtons".to_owned());
            }
            let axis = match column.stated.axis {
                Some('x') => 'x',
                Some('y') => {
                    self.ignored.push((
                        column.name.clone(),
                        "the force across the gap is not estimated".into(),
                    ));
                    continue;
                }
                Some(_) => 'z',
                None => {
                    checks.push("no axis: taken as longitudinal (z)".to_owned());
                    'z'
                }
            };
            let to = format!("f{index}_{axis}_n");
            if self.has(&to) {
                self.ignored
                    .push((column.name.clone(), "a second force of this sensor and axis".into()));
                continue;
            }
            let unit = column.stated.unit.map_or("N", |unit| unit.name);
            self.add(column, unit, to, joined(checks));
        }
    }

    /// The clock of a table; `words` are preferred where there are several.
    fn clock(&mut self, table: &SourceTable, words: &[&str]) -> Result<ClockColumn, DataError> {
        let ascending =
            || table.columns.iter().filter(|column| column.is_numeric() && column.is_ascending);
        let named = || ascending().filter(|column| column.quantity == Quantity::Time);
        let preferred = named()
            .find(|column| column.stated.words.iter().any(|word| words.contains(&word.as_str())));
        let Some(column) = preferred
            .or_else(|| named().next())
            .or_else(|| ascending().find(|column| column.quantity == Quantity::Unknown))
        else {
            let mut texts = table.columns.iter().filter(|column| !column.is_numeric());
            let advice = match texts.find(|column| column.quantity == Quantity::Time) {
                Some(dates) => format!(
                    "the times in {} are text; write them as numbers, such as seconds since the first row",
                    dates.name
                ),
                None => "no column increases in every row, as a clock does: add one, or sort the rows by time and remove \
                         duplicates"
                    .to_owned(),
            };
            return Err(ErrorKind::MissingColumn { advice }
                .at(Location::file(&table.path).line(1).column("clock")));
        };
        let mut steps = column.steps.clone();
        steps.sort_by(f64::total_cmp);
        let step = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let stated = column.stated.unit.filter(|unit| unit.canonical == "us").map(|unit| unit.name);
        let unit = stated.unwrap_or_else(|| unit_of_clock(column.first, step));
        let rate_hz = find_unit(unit).map_or(f64::NAN, |unit| 1e6 / (step * unit.factor));
        let mut checks = Vec::new();
        if stated.is_none() {
            let rate = match column.steps.as_slice() {
                [] => String::new(),
                _ => format!(", which makes {} rows per second", short(rate_hz)),
            };
            checks.push(format!("no unit: taken as {unit}{rate}"));
        }
        if column.quantity != Quantity::Time {
            checks.push("taken as the clock, since it increases in every row".to_owned());
        }
        let check = joined(checks);
        if let Some(check) = &check {
            self.check_column(&column.name, check);
        }
        Ok(ClockColumn { name: column.name.clone(), unit, check })
    }

    /// Lists the columns that are not imported for another reason.
    fn unused(&mut self, tables: &[&SourceTable], clocks: &[&ClockColumn], has_attitude: bool) {
        for column in tables.iter().flat_map(|table| &table.columns) {
            let is_listed = self.ignored.iter().any(|(name, _)| *name == column.name)
                || clocks.iter().any(|clock| clock.name == column.name)
                || self.is_used(&column.name);
            if is_listed || (has_attitude && column.quantity == Quantity::Attitude) {
                continue;
            }
            let reason = match column.quantity {
                _ if !column.is_numeric() => column.text_reason(),
                Quantity::Unsupported => "a torque or an angular rate".into(),
                Quantity::Time => "another clock".into(),
                _ if column.is_constant() => "constant".into(),
                _ => "not recognised".into(),
            };
            self.ignored.push((column.name.clone(), reason));
        }
    }
}

/// Index of the sensor whose name is that of a force: the whole name, the number, or a word that no other sensor has.
fn sensor_of(force: &Group, sensors: &[Group]) -> Option<usize> {
    let only = |is_own: &dyn Fn(&Group) -> bool| {
        let mut found = (0..sensors.len()).filter(|&place| is_own(&sensors[place]));
        found.next().filter(|_| found.next().is_none())
    };
    let shares_word = |sensor: &Group| sensor.0.iter().any(|word| force.0.contains(word));
    only(&|sensor| sensor == force)
        .or_else(|| only(&|sensor| sensor.1.is_some() && sensor.1 == force.1))
        .or_else(|| only(&|sensor| sensor.1 == force.1 && shares_word(sensor)))
}

/// The axis with the strongest field at every sensor, if there is one.
fn strongest_axis(fields: &[&SourceColumn]) -> Option<Axis> {
    let of_sensor = |group: &Group| {
        let own = fields.iter().filter(|column| column.stated.group == *group);
        let mean = |column: &SourceColumn| 0.5 * (column.min + column.max).abs();
        own.max_by(|a, b| mean(a).total_cmp(&mean(b))).and_then(|column| axis_of(column))
    };
    let mut axes = column_groups(fields.iter().copied()).into_iter().map(of_sensor);
    let first = axes.next()??;
    axes.all(|axis| axis == Some(first)).then_some(first)
}

/// Unit of a clock without one: times since 1970 have a known magnitude; else rows are 0.2 ms to 0.2 s apart.
fn unit_of_clock(first: f64, step: f64) -> &'static str {
    const UNITS: [&str; 4] = ["s", "ms", "us", "ns"];
    /// Seconds since 1970 in the year 2001.
    const EPOCH_S: f64 = 1e9;
    const LONGEST_STEP_S: f64 = 0.2;
    /// A clock since 1970 may have rows this close together.
    const SHORTEST_STEP_S: f64 = 5e-6;
    let is_plausible = |per_s: f64| {
        first >= EPOCH_S * per_s
            && (SHORTEST_STEP_S * per_s..=LONGEST_STEP_S * per_s).contains(&step)
    };
    let mut of_magnitude = UNITS.into_iter().rev().zip([1e9, 1e6, 1e3, 1.0]);
    if let Some((unit, _)) = of_magnitude.find(|(_, per_s)| is_plausible(*per_s)) {
        return unit;
    }
    let mut of_step = UNITS.into_iter().zip([1.0, 1e3, 1e6, 1e9]);
    of_step.find(|(_, per_s)| step <= LONGEST_STEP_S * per_s).map_or("ns", |(unit, _)| unit)
}

fn short(value: f64) -> String {
    round_significant(value, 4).to_string()
}

/// A TOML string, also safe in a comment.
fn quoted(text: impl AsRef<str>) -> String {
    toml::Value::String(text.as_ref().replace(|c: char| c.is_control(), " ")).to_string()
}

fn head(first: &[SourceTable], draft: &Draft, one_clock: bool) -> String {
    let mut text = "# Proposed by `cargo magpie import --guess` from ".to_owned();
    let names = first.iter().map(|table| {
        let name = table.path.file_name().unwrap_or_default().to_string_lossy();
        let limit = if table.rows == MAX_ROWS { "the first " } else { "" };
        format!("{} ({limit}{} rows)", quoted(name), table.rows)
    });
    text.push_str(&names.collect::<Vec<_>>().join(" and "));
    text.push_str(".\n# Please check:\n");
    for check in &draft.checks {
        let _ = writeln!(text, "#   {}", check.to_string().replace(|c: char| c.is_control(), " "));
    }
    let _ = writeln!(text, "\ndescription = \"\"\none_clock = {one_clock}");
    if !one_clock {
        text.push_str(
            "# starts_s = [0.0, 60.0, 120.0]  # start of each source, in seconds since the first\n",
        );
    }
    let is_raw = draft.columns.iter().any(|column| column.unit == "lsb");
    if is_raw {
        text.push_str("# gauss_per_lsb = 0.125        # scale of the raw counts, from the data sheet: required\n");
    }
    text.push_str("# range_gauss = 2000.0         # full scale of the sensor: samples there are left out as saturated\n");
    text
}

fn write_table(
    text: &mut String,
    key: &str,
    table: &SourceTable,
    is_folder: bool,
    (clock, offset_s, from_first_row): (&ClockColumn, Option<f64>, bool),
    columns: &[ProposedColumn],
) {
    let _ = writeln!(text, "\n[{key}]");
    if is_folder {
        let name = table.path.file_name().unwrap_or_default().to_string_lossy();
        let _ = writeln!(text, "file = {}", quoted(name));
    }
    let check =
        clock.check.as_ref().map_or_else(String::new, |check| format!("  # check: {check}"));
    let _ = writeln!(
        text,
        "clock = {{ from = {}, unit = \"{}\"{}{} }}{check}",
        quoted(&clock.name),
        clock.unit,
        offset_s.map_or_else(String::new, |offset_s| format!(", offset_s = {offset_s:?}")),
        if from_first_row { ", from_first_row = true" } else { "" },
    );
    text.push_str("columns = [\n");
    for column in columns {
        let missing =
            column.missing.map_or_else(String::new, |marker| format!(", missing = {marker:?}"));
        let (min, max) = column.range;
        let check =
            column.check.as_ref().map_or_else(String::new, |check| format!("; check: {check}"));
        let _ = writeln!(
            text,
            "  {{ from = {}, unit = \"{}\", to = \"{}\"{missing} }},  # {} to {}{check}",
            quoted(&column.from),
            column.unit,
            column.to,
            short(min),
            short(max),
        );
    }
    text.push_str("]\n");
}
