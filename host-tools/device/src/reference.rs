//! Reference force sensor recorded next to the gripper, and the pose that a host forwards to it: lines of numbers from a
//! serial port, a socket or standard input.

use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::str::FromStr;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use device_run::channel_map::euler_counts;
use firmware::protocol::messages::{HostAcceleration, HostAttitude, Message};
use model_export::input::{self, MAX_MAGNITUDE, MAX_ROW_BYTES, MAX_TIME_US, plausible_range};
use model_export::recordings::columns::{Axis, ForceColumn, force_column};
use model_export::recordings::units::{UNITS, Unit, column_unit, find_unit};
use serde::Deserialize;

/// Rate of a serial port without one.
const BAUD_RATE: u32 = 115_200;
/// Time-out of one read of a serial port.
const WAIT: Duration = Duration::from_millis(200);
/// Lines that cannot be read before the reading fails: the first of a stream is often cut off.
const MAX_BAD_LINES: u64 = 10;

/// Rows that wait for the recording, a second of the fastest reference: beyond it the source waits, and memory stays bounded.
pub const MAX_WAITING_ROWS: usize = 10_000;

/// Where the lines come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReferenceSource {
    /// Standard input.
    Stdin,
    /// A TCP socket, as `host:port`.
    Socket(String),
    /// A serial port and its rate in bits per second.
    Serial(String, u32),
}

impl FromStr for ReferenceSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let problem = || format!("{text:?}: give -, tcp:HOST:PORT or PORT[@BAUD]");
        if text == "-" {
            return Ok(Self::Stdin);
        }
        if let Some(address) = text.strip_prefix("tcp:") {
            return match address.rsplit_once(':') {
                Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => {
                    Ok(Self::Socket(address.to_owned()))
                }
                _ => Err(problem()),
            };
        }
        match text.split_once('@') {
            None if !text.is_empty() => Ok(Self::Serial(text.to_owned(), BAUD_RATE)),
            Some((path, baud)) if !path.is_empty() => {
                Ok(Self::Serial(path.to_owned(), baud.parse().map_err(|_| problem())?))
            }
            _ => Err(problem()),
        }
    }
}

impl ReferenceSource {
    /// As an option of a command, which [`FromStr`] reads.
    pub fn option(&self) -> String {
        match self {
            Self::Stdin => "-".to_owned(),
            Self::Socket(address) => format!("tcp:{address}"),
            Self::Serial(path, baud) => format!("{path}@{baud}"),
        }
    }
}

impl fmt::Display for ReferenceSource {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Stdin => f.write_str("standard input"),
            Self::Socket(address) => f.write_str(address),
            Self::Serial(path, baud) => write!(f, "{path} at {baud} baud"),
        }
    }
}

/// Columns of the lines, counted from 1.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceMapping {
    /// Separator of the columns [default: blanks, commas and semicolons].
    #[serde(default)]
    pub separator: Option<char>,
    /// Clock of the reference; without it, the times at which the lines arrive are used.
    #[serde(default)]
    pub clock: Option<ClockColumn>,
    /// Forces and pose.
    pub columns: Vec<ColumnMapping>,
}

/// Clock of the reference.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockColumn {
    /// Column, from 1.
    pub column: usize,
    /// Unit: s, ms, us or ns.
    pub unit: String,
}

/// Columns of the pose: roll, pitch, yaw as in `hall.csv`; acceleration without gravity in gripper axes.
pub const POSE_COLUMNS: [&str; 6] = [
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "linear_accel_x_mps2",
    "linear_accel_y_mps2",
    "linear_accel_z_mps2",
];

/// One force, or one quantity of the pose.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColumnMapping {
    /// Column, from 1.
    pub column: usize,
    /// Unit of the reference, as in import mappings.
    pub unit: String,
    /// Column of `force.csv`, for example `f0_x_n`, or one of [`POSE_COLUMNS`].
    pub to: String,
    /// Factor in addition to that of the unit; -1 inverts the sign.
    #[serde(default = "one")]
    pub scale: f64,
}

fn one() -> f64 {
    1.0
}

/// One line.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceRow {
    /// Time of its arrival in seconds since the start of reception.
    pub at_s: f64,
    /// Time on the reference's own clock in seconds, if it has one.
    pub clock_s: Option<f64>,
    /// Forces in newtons, in the order of the mapping.
    pub force_n: Vec<f64>,
    /// Pose of the gripper, as far as it is mapped.
    pub pose: HostPose,
}

/// Pose of the gripper as a host knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HostPose {
    pub roll_pitch_rad: Option<[f64; 2]>,
    pub yaw_rad: Option<f64>,
    /// Acceleration without gravity in m/s^2, gripper axes.
    pub linear_accel_mps2: Option<[f64; 3]>,
}

impl HostPose {
    fn of(values: [Option<f64>; POSE_COLUMNS.len()]) -> Self {
        let [roll, pitch, yaw_rad, x, y, z] = values;
        Self {
            roll_pitch_rad: roll.zip(pitch).map(|(roll, pitch)| [roll, pitch]),
            yaw_rad,
            linear_accel_mps2: x.zip(y).zip(z).map(|((x, y), z)| [x, y, z]),
        }
    }

    /// Messages to the gripper for a pose measured this long ago; empty without a pose.
    pub fn messages(&self, age: Duration) -> Vec<Message> {
        let age = u8::try_from(age.as_millis()).unwrap_or(u8::MAX);
        let attitude = self.yaw_rad.map(|yaw_rad| {
            let [roll, pitch] = self.roll_pitch_rad.unwrap_or_default().map(euler_counts);
            let yaw = euler_counts(yaw_rad);
            let yaw_only = self.roll_pitch_rad.is_none();
            Message::HostAttitude(HostAttitude { roll, pitch, yaw, age, yaw_only })
        });
        let acceleration = self.linear_accel_mps2.map(|mps2| {
            // The cast saturates.
            let [x, y, z] = mps2.map(|mps2| (PER_MPS2 * mps2).round() as i16);
            Message::HostAcceleration(HostAcceleration { x, y, z, age })
        });
        attitude.into_iter().chain(acceleration).collect()
    }
}

/// Counts of a host's acceleration per m/s^2.
const PER_MPS2: f64 = match HostAcceleration::LAYOUT.signals {
    [x, ..] => x.counts_per_unit() as f64,
    _ => panic!("the layout needs an acceleration"),
};

impl ReferenceMapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// The file cannot be read, or a column, unit or factor is invalid.
    pub fn read(path: &Path) -> Result<Self> {
        let place = || path.display().to_string();
        let text = input::read_text(path)?;
        let mapping: Self = toml::from_str(&text).with_context(place)?;
        mapping.check().with_context(place)?;
        Ok(mapping)
    }

    fn check(&self) -> Result<()> {
        if self.columns.is_empty() {
            bail!(
                "there are no [[columns]]: map at least one, for example column = 1, unit = \"N\", to = \"f0_x_n\""
            );
        }
        for (place, column) in self.columns.iter().enumerate() {
            let to = &column.to;
            if !column.is_pose() {
                force_column(to).map_err(|error| anyhow::anyhow!("{to}: {error}"))?;
            }
            if to == "t_us" || self.columns[..place].iter().any(|other| other.to == *to) {
                bail!("{to}: map each column once; the clock belongs to [clock]");
            }
            unit(&column.unit, column.canonical_unit()).with_context(|| to.clone())?;
            if !column.scale.is_finite() || column.scale == 0.0 {
                bail!("{to}: scale = {}: give a number other than zero", column.scale);
            }
            let (min, max) = plausible_range("scale");
            if !(min..=max).contains(&column.scale.abs()) {
                bail!("{to}: scale = {:e}: give a factor of {min:e} to {max:e}", column.scale);
            }
        }
        let is_mapped = POSE_COLUMNS.map(|name| self.columns.iter().any(|c| c.to == name));
        let [roll, pitch, yaw, x, y, z] = is_mapped;
        // The board uses neither roll and pitch nor an acceleration without the yaw.
        if roll != pitch || x != y || y != z || ((roll || x) && !yaw) {
            bail!(
                "the pose is incomplete: map yaw_rad, and roll_rad with pitch_rad or neither, and linear_accel_x_mps2, _y_ and _z_ or none"
            );
        }
        if let Some(clock) = &self.clock {
            unit(&clock.unit, "us").context("clock")?;
        }
        let clock = self.clock.iter().map(|clock| clock.column);
        if clock.chain(self.columns.iter().map(|column| column.column)).any(|column| column == 0) {
            bail!("columns are counted from 1");
        }
        Ok(())
    }

    /// Columns of `force.csv`, in the order of [`ReferenceRow::force_n`].
    pub fn force_columns(&self) -> Vec<String> {
        let forces = self.columns.iter().filter(|column| !column.is_pose());
        forces.map(|column| column.to.clone()).collect()
    }

    /// Sensors and axes of these columns.
    pub fn forces(&self) -> Vec<(u32, Axis)> {
        let columns = self.columns.iter().filter_map(|column| force_column(&column.to).ok());
        columns
            .filter_map(|column| match column {
                ForceColumn::Force { sensor, axis } => Some((sensor, axis)),
                ForceColumn::Time => None,
            })
            .collect()
    }

    /// Whether the source gives an attitude or an acceleration.
    pub fn has_pose(&self) -> bool {
        self.columns.iter().any(ColumnMapping::is_pose)
    }

    /// Values of a line that arrived at `at_s`.
    ///
    /// # Errors
    /// A column is missing or not a finite number.
    pub fn parse(&self, line: &str, at_s: f64) -> Result<ReferenceRow> {
        let cells: Vec<&str> = match self.separator {
            Some(separator) => line.split(separator).map(str::trim).collect(),
            None => line
                .split(|c: char| c.is_whitespace() || c == ',' || c == ';')
                .filter(|cell| !cell.is_empty())
                .collect(),
        };
        let number = |column: usize, max: f64| {
            let cell = cells.get(column - 1).copied();
            let cell = cell.with_context(|| format!("column {column} is missing in {line:?}"))?;
            let value = cell.parse().ok().filter(|value: &f64| value.is_finite());
            let value =
                value.with_context(|| format!("column {column} is not a number: {cell:?}"))?;
            if value.abs() > max {
                bail!("column {column} is implausible: {value:e}, the limit is ±{max:e}");
            }
            Ok(value)
        };
        let clock_s = match &self.clock {
            None => None,
            Some(clock) => {
                let factor = unit(&clock.unit, "us")?.factor;
                Some(1e-6 * number(clock.column, MAX_TIME_US / factor)? * factor)
            }
        };
        let (mut force_n, mut pose) = (Vec::new(), [None; POSE_COLUMNS.len()]);
        for column in &self.columns {
            let unit = unit(&column.unit, column.canonical_unit())?;
            let value = number(column.column, MAX_MAGNITUDE)? * unit.factor * column.scale;
            match pose.iter_mut().zip(POSE_COLUMNS).find(|(_, name)| column.to == *name) {
                Some((place, _)) => *place = Some(value),
                None => force_n.push(value),
            }
        }
        Ok(ReferenceRow { at_s, clock_s, force_n, pose: HostPose::of(pose) })
    }
}

impl ColumnMapping {
    fn is_pose(&self) -> bool {
        POSE_COLUMNS.contains(&self.to.as_str())
    }

    fn canonical_unit(&self) -> &'static str {
        column_unit(&self.to).unwrap_or("n")
    }
}

/// The unit with this symbol, if it converts to `canonical`.
fn unit(name: &str, canonical: &str) -> Result<Unit> {
    let unit = find_unit(name).filter(|unit| unit.canonical == canonical);
    unit.with_context(|| {
        let choices = UNITS.iter().filter(|unit| unit.canonical == canonical);
        let choices: Vec<&str> = choices.map(|unit| unit.name).collect();
        format!("the unit {name:?}: accepted are {}", choices.join(", "))
    })
}

/// Places the reference on the board's clock, to the delays of both transports.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReferenceClock {
    /// Least difference of arrival and board time in seconds.
    board_s: Option<f64>,
    /// Difference of arrival and reference time in seconds, of the first row with a clock.
    reference_s: Option<f64>,
}

impl ReferenceClock {
    /// A row of the board arrived at `at_s`.
    pub fn board(&mut self, at_s: f64, time_us: u64) {
        let late_s = at_s - 1e-6 * time_us as f64;
        self.board_s = Some(self.board_s.map_or(late_s, |least_s| least_s.min(late_s)));
    }

    /// Board time in microseconds of a row of the reference that arrived at `at_s`, with its own clock if it has one; `None`
    /// before the first row of the board.
    pub fn board_us(&mut self, at_s: f64, clock_s: Option<f64>) -> Option<f64> {
        let board_s = self.board_s?;
        let at_s = match clock_s {
            None => at_s,
            Some(clock_s) => clock_s + *self.reference_s.get_or_insert(at_s - clock_s),
        };
        Some(1e6 * (at_s - board_s))
    }
}

/// Lines in their own thread, until the stream ends or fails.
pub struct ReferenceReader {
    /// Rows in the order of their arrival; the last may be an error.
    pub rows: Receiver<Result<ReferenceRow>>,
}

impl ReferenceReader {
    /// Opens the source; times count from `begun`.
    ///
    /// # Errors
    /// The source cannot be opened.
    pub fn start(
        source: &ReferenceSource,
        mapping: ReferenceMapping,
        begun: Instant,
    ) -> Result<Self> {
        let name = source.to_string();
        let stream: Box<dyn Read + Send> = match source {
            ReferenceSource::Stdin => Box::new(std::io::stdin()),
            ReferenceSource::Socket(address) => {
                Box::new(TcpStream::connect(address).with_context(|| name.clone())?)
            }
            ReferenceSource::Serial(path, baud) => {
                let port = serialport::new(path, *baud).timeout(WAIT).open();
                Box::new(BlockingPort(port.with_context(|| name.clone())?))
            }
        };
        let (sender, rows) = sync_channel(MAX_WAITING_ROWS);
        // Ends with its stream, or when nobody listens.
        thread::spawn(move || listen(stream, &name, &mapping, begun, &sender));
        Ok(Self { rows })
    }
}

/// A port whose reads wait until there are bytes.
struct BlockingPort(Box<dyn serialport::SerialPort>);

impl Read for BlockingPort {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        loop {
            match self.0.read(bytes) {
                Err(error) if error.kind() == std::io::ErrorKind::TimedOut => {}
                result => return result,
            }
        }
    }
}

fn listen(
    stream: Box<dyn Read + Send>,
    name: &str,
    mapping: &ReferenceMapping,
    begun: Instant,
    sender: &SyncSender<Result<ReferenceRow>>,
) {
    let mut lines = BufReader::new(stream);
    let (mut line, mut number, mut bad) = (Vec::new(), 0_u64, 0);
    loop {
        line.clear();
        let mut limited = lines.by_ref().take(MAX_ROW_BYTES + 1);
        match limited.read_until(b'\n', &mut line) {
            Ok(0) => return,
            Ok(length) if length as u64 > MAX_ROW_BYTES => {
                let error = anyhow::anyhow!(
                    "{name}: line {}: the line is longer than {MAX_ROW_BYTES} bytes, the limit; check the rate of the port and that lines end with a line break",
                    number + 1
                );
                let _ = sender.send(Err(error));
                return;
            }
            Ok(_) => {}
            Err(error) => {
                let _ = sender.send(Err(error).with_context(|| name.to_owned()));
                return;
            }
        }
        number += 1;
        let at_s = begun.elapsed().as_secs_f64();
        let text = String::from_utf8_lossy(&line);
        if text.trim().is_empty() {
            continue;
        }
        let row = match mapping.parse(text.trim(), at_s) {
            Ok(row) => Ok(row),
            Err(_) if bad < MAX_BAD_LINES => {
                bad += 1;
                continue;
            }
            Err(error) => Err(error.context(format!("{name}: line {number}"))),
        };
        let is_last = row.is_err();
        if sender.send(row).is_err() || is_last {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mapping(text: &str) -> Result<ReferenceMapping> {
        let mapping: ReferenceMapping = toml::from_str(text)?;
        mapping.check()?;
        Ok(mapping)
    }

    #[test]
    fn sources_are_parsed() {
        let serial = |path: &str, baud| ReferenceSource::Serial(path.to_owned(), baud);
        for (text, source) in [
            ("-", ReferenceSource::Stdin),
            ("tcp:10.0.0.2:49152", ReferenceSource::Socket("10.0.0.2:49152".to_owned())),
            ("/dev/ttyUSB1", serial("/dev/ttyUSB1", 115_200)),
            ("/dev/ttyUSB1@921600", serial("/dev/ttyUSB1", 921_600)),
        ] {
            assert_eq!(source.option().parse(), Ok(source.clone()));
            assert_eq!(text.parse(), Ok(source));
        }
        for wrong in ["", "tcp:host", "tcp::80", "tcp:host:99999", "/dev/ttyUSB1@fast", "@9600"] {
            assert!(wrong.parse::<ReferenceSource>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn line_gives_clock_and_forces_in_newtons() {
        let mapping = mapping(
            "clock = { column = 1, unit = \"ms\" }\n\
             columns = [{ column = 3, unit = \"N\", to = \"f0_x_n\", scale = -1 },\n\
                        { column = 2, unit = \"kg\", to = \"f0_z_n\" }]",
        )
        .unwrap();
        let row = mapping.parse("1500, 2.0; -12.5", 0.25).unwrap();
        assert_eq!((row.at_s, row.clock_s), (0.25, Some(1.5)));
        assert!((row.force_n[0] - 12.5).abs() < 1e-12 && (row.force_n[1] - 19.6133).abs() < 1e-9);
        for (line, what) in [
            ("1500, 2.0", "column 3 is missing"),
            ("1500, 2.0, x", "column 3 is not a number: \"x\""),
            ("1500, nan, 1", "column 2 is not a number: \"nan\""),
        ] {
            assert!(mapping.parse(line, 0.0).unwrap_err().to_string().contains(what), "{line}");
        }
    }

    #[test]
    fn line_of_a_source_is_limited_to_its_length() {
        let mapping =
            || mapping("columns = [{ column = 1, unit = \"N\", to = \"f0_x_n\" }]").unwrap();
        let last = |length: usize| {
            let (sender, rows) = sync_channel(MAX_WAITING_ROWS);
            let line = format!("1\n2{}\n3\n", " ".repeat(length - 2));
            listen(
                Box::new(std::io::Cursor::new(line)),
                "source",
                &mapping(),
                Instant::now(),
                &sender,
            );
            drop(sender);
            rows.iter().last().unwrap()
        };
        assert_eq!(last(MAX_ROW_BYTES as usize).unwrap().force_n, [3.0]);
        let message = last(MAX_ROW_BYTES as usize + 1).unwrap_err().to_string();
        assert!(message.starts_with("source: line 2: the line is longer than 65536"), "{message}");
        let mapping = mapping();
        for (cell, is_valid) in [("1e12", true), ("-1.1e12", false), ("1e308", false)] {
            assert_eq!(mapping.parse(cell, 0.0).is_ok(), is_valid, "{cell}");
        }
    }

    #[test]
    fn pose_of_a_line_becomes_messages_with_its_age() {
        let columns = |names: &[&str]| {
            let column = |(i, name): (usize, &&str)| {
                let unit = if name.ends_with("_rad") { "deg" } else { "m/s2" };
                format!("{{ column = {}, unit = \"{unit}\", to = \"{name}\" }}", i + 1)
            };
            let columns: Vec<String> = names.iter().enumerate().map(column).collect();
            mapping(&format!("columns = [{}]", columns.join(", ")))
        };
        let pose = columns(&POSE_COLUMNS).unwrap();
        assert!(pose.has_pose() && pose.force_columns().is_empty() && pose.forces().is_empty());
        let row = pose.parse("90 -45 270 1 -2 100", 0.0).unwrap();
        let expected = [
            Message::HostAttitude(HostAttitude {
                roll: 15_708,
                pitch: -7854,
                yaw: -15_708,
                age: 7,
                yaw_only: false,
            }),
            Message::HostAcceleration(HostAcceleration { x: 500, y: -1000, z: i16::MAX, age: 7 }),
        ];
        assert_eq!(row.pose.messages(Duration::from_millis(7)), expected);
        let yaw = columns(&["yaw_rad"]).unwrap().parse("1", 0.0).unwrap();
        let messages = yaw.pose.messages(Duration::from_secs(1));
        let expected =
            HostAttitude { yaw: 175, age: u8::MAX, yaw_only: true, ..HostAttitude::default() };
        assert_eq!(messages, [Message::HostAttitude(expected)]);
        for names in [
            &["roll_rad", "pitch_rad"][..],
            &["yaw_rad", "linear_accel_x_mps2"],
            &POSE_COLUMNS[3..],
        ] {
            assert!(columns(names).unwrap_err().to_string().contains("incomplete"), "{names:?}");
        }
    }

    #[test]
    fn invalid_mappings_are_refused() {
        let column = |text: &str| format!("columns = [{{ {text} }}]");
        for (text, what) in [
            ("columns = []".to_owned(), "no [[columns]]"),
            (column("column = 0, unit = \"N\", to = \"f0_x_n\""), "counted from 1"),
            (column("column = 1, unit = \"V\", to = \"f0_x_n\""), "the unit \"V\""),
            (column("column = 1, unit = \"N\", to = \"fx\""), "fx"),
            (column("column = 1, unit = \"N\", to = \"t_us\""), "[clock]"),
            (column("column = 1, unit = \"N\", to = \"f0_x_n\", scale = 0"), "scale = 0"),
            (column("column = 1, unit = \"N\", to = \"f0_x_n\", scale = 1e-320"), "give a factor"),
            (column("column = 1, unit = \"N\", to = \"f0_x_n\", gain = 2"), "unknown field"),
        ] {
            let error = format!("{:#}", mapping(&text).unwrap_err());
            assert!(error.contains(what), "{text}: {error}");
        }
    }
}
