//! MCAP files, the format of ROS 2 bags and of Foxglove, and bags in SQLite: their topics as tables with one row per message, and
//! the writer of recordings.
//!
//! A column is a number of a message: the topic, a point and the path of the field, `/hall/s0.magnetic_field.x` or
//! `/joint_states.position[0]`. Each topic also has the columns `log_time` and `publish_time`; these and the times in
//! messages (`header.stamp`) are in nanoseconds.

mod decode;
mod limits;
mod recording;
mod records;
mod sqlite;
mod writer;

use std::collections::BTreeMap;
use std::collections::hash_map::{Entry, HashMap};
use std::path::{Path, PathBuf};

use crate::csv_table::GAP_STEPS;
use crate::description::JoinedChannel;
use crate::error::{DataError, ErrorKind, Location, Notice, closest_match};
use crate::input::MAX_COLUMNS;
use crate::units::round_significant;
use decode::Decoder;
use limits::{Contents, Deadline, check_topics, check_values, max_values, total_bytes};
pub use recording::{EstimatedForce, RecordingMcap, RecordingTopics, StateTopic, TopicColumns};
use records::McapMessages;
use sqlite::SqliteMessages;
use writer::{MAPPING_KEY, UNITS_KEY};
pub use writer::{MESSAGE_ENCODING, McapWriter, NumberTopic, SCHEMA_ENCODING, TopicSink};

/// Column of the time at which the recorder received a message.
const LOG_TIME: &str = "log_time";
/// Column of the time at which a message was sent.
const PUBLISH_TIME: &str = "publish_time";
/// Column of the time at which the values of a ROS message were measured.
const HEADER_STAMP: &str = "header.stamp";

/// Messages of one topic.
#[derive(Clone, Debug, Default)]
pub struct Topic {
    /// Name.
    pub name: String,
    /// Name of the message type, such as `sensor_msgs/msg/MagneticField`; empty without a schema.
    pub schema: String,
    /// Metadata of the channel.
    pub metadata: BTreeMap<String, String>,
    /// Numbers by message.
    pub columns: Vec<TopicColumn>,
}

/// One number of all messages of a topic.
#[derive(Clone, Debug)]
pub struct TopicColumn {
    /// Path of the field.
    pub path: String,
    /// Values; NaN in messages without it.
    pub values: Vec<f64>,
}

impl Topic {
    /// Number of messages.
    pub fn messages(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    /// Values of a field.
    pub fn values(&self, path: &str) -> Option<&[f64]> {
        let column = self.columns.iter().find(|column| column.path == path)?;
        Some(&column.values)
    }

    /// Fields without times.
    pub fn fields(&self) -> impl Iterator<Item = &TopicColumn> {
        let is_time =
            |path: &str| [LOG_TIME, PUBLISH_TIME].contains(&path) || path.ends_with("stamp");
        self.columns.iter().filter(move |column| !is_time(&column.path))
    }

    /// Name of a column.
    pub fn column_name(&self, path: &str) -> String {
        format!("{}.{path}", self.name)
    }

    /// Unit of a field of a message type with a convention (REP 103), or as the channel states it.
    pub fn unit(&self, path: &str) -> Option<String> {
        if path == LOG_TIME || path == PUBLISH_TIME || path == HEADER_STAMP {
            return Some("ns".to_owned());
        }
        if let Some(units) = self.metadata.get(UNITS_KEY) {
            let mut pairs = units.split(',').filter_map(|pair| pair.split_once('='));
            return pairs.find(|(name, _)| *name == path).map(|(_, unit)| unit.to_owned());
        }
        let last = self.schema.rsplit(['/', '.']).next().unwrap_or_default();
        let unit = match last {
            "MagneticField" if path.starts_with("magnetic_field.") => "T",
            "WrenchStamped" | "Wrench" if path.contains("force.") => "N",
            "Temperature" if path == "temperature" => "degC",
            "Imu" if path.starts_with("linear_acceleration.") => "m/s2",
            _ => return None,
        };
        Some(unit.to_owned())
    }
}

/// A topic whose messages are being read.
struct TopicReader {
    topic: Topic,
    /// Index of each column.
    places: HashMap<String, usize>,
}

impl TopicReader {
    fn new(channel: &mcap::Channel<'_>) -> Self {
        let schema = channel.schema.as_ref();
        let topic = Topic {
            name: channel.topic.clone(),
            schema: schema.map_or_else(String::new, |schema| schema.name.clone()),
            metadata: channel.metadata.clone(),
            columns: Vec::new(),
        };
        Self { topic, places: HashMap::new() }
    }

    /// Adds the row of a message; fails with what is beyond a limit, or the reason why it cannot be decoded.
    fn read(
        &mut self,
        decoder: &Decoder,
        message: &mcap::Message<'_>,
        contents: &mut Contents,
    ) -> Result<(), ErrorKind> {
        let row = self.topic.messages();
        let (mut next, mut failure) = (0, None);
        let mut add = |path: &str, value: f64| {
            if failure.is_none() {
                failure = self.push(path, row, &mut next, value, contents).err();
            }
        };
        add(LOG_TIME, message.log_time as f64);
        add(PUBLISH_TIME, message.publish_time as f64);
        let decoded = decoder.numbers(&message.data, &mut add);
        decoded.map_err(|reason| ErrorKind::Undecodable { reason })?;
        failure.map_or(Ok(()), Err)?;
        contents.add_values(self.topic.columns.len())
    }

    fn push(
        &mut self,
        path: &str,
        row: usize,
        next: &mut usize,
        value: f64,
        contents: &mut Contents,
    ) -> Result<(), ErrorKind> {
        let columns = &mut self.topic.columns;
        // Consecutive messages have the same fields in the same order.
        let index = match columns.get(*next) {
            Some(column) if column.path == path => *next,
            _ => match self.places.get(path) {
                Some(index) => *index,
                None => {
                    contents.add_column(path, columns.len(), row)?;
                    columns.push(TopicColumn { path: path.to_owned(), values: Vec::new() });
                    self.places.insert(path.to_owned(), columns.len() - 1);
                    columns.len() - 1
                }
            },
        };
        *next = index + 1;
        let values = &mut columns[index].values;
        values.resize(row, f64::NAN);
        values.push(value);
        Ok(())
    }

    fn finish(mut self) -> Topic {
        let rows = self.topic.messages();
        self.topic.columns.iter_mut().for_each(|column| column.values.resize(rows, f64::NAN));
        self.topic
    }
}

/// Whether a path is a bag: a file of messages, or the folder of a ROS 2 bag, which may have lost its metadata.
pub(crate) fn is_bag(path: &Path) -> bool {
    is_messages(path)
        || (path.is_dir()
            && (path.join("metadata.yaml").is_file()
                || folder(path).is_ok_and(|it| !it.is_empty())))
}

fn is_messages(path: &Path) -> bool {
    is_named(path, "mcap") || is_named(path, "db3")
}

/// The files of messages in a folder.
fn folder(path: &Path) -> std::io::Result<Vec<PathBuf>> {
    let entries: std::io::Result<Vec<PathBuf>> =
        std::fs::read_dir(path)?.map(|entry| entry.map(|entry| entry.path())).collect();
    Ok(entries?.into_iter().filter(|file| is_messages(file)).collect())
}

/// Whether a file has this extension.
fn is_named(path: &Path, name: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(name))
}

/// The files of a bag in their order.
fn files(path: &Path) -> Result<Vec<PathBuf>, DataError> {
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(path));
    let mut files = folder(path).map_err(unreadable)?;
    let refuse = |what, advice| Err(ErrorKind::bad_value(what, advice).at(Location::file(path)));
    if files.is_empty() {
        let advice = "give a folder with .mcap or .db3 files; compressed ones are decompressed with `zstd -d`";
        return refuse("a bag without files of messages", advice);
    }
    if files.iter().any(|file| is_named(file, "mcap") != is_named(&files[0], "mcap")) {
        return refuse("a folder with .mcap and .db3 files", "give one of these files");
    }
    // Parts of a bag are numbered: bag_9.mcap comes before bag_10.mcap.
    files.sort_by_key(|file| (file.as_os_str().len(), file.clone()));
    Ok(files)
}

/// How to treat messages that cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Undecodable {
    /// An error.
    Refuse,
    /// The topic is left out.
    Skip,
}

/// Messages of a file.
type Messages<'a> = Box<dyn Iterator<Item = Result<mcap::Message<'static>, DataError>> + 'a>;

/// Messages of a file; that it was cut off is added to `notices`.
fn messages<'a>(
    file: &'a Path,
    deadline: Deadline,
    notices: &'a mut Vec<Notice>,
) -> Result<Messages<'a>, DataError> {
    Ok(match is_named(file, "db3") {
        true => Box::new(SqliteMessages::open(file, deadline)?),
        false => Box::new(McapMessages::open(file, notices)?),
    })
}

/// Total length of the files of a bag in bytes.
fn bag_bytes(path: &Path) -> Result<u64, DataError> {
    Ok(total_bytes(files(path)?.iter().map(PathBuf::as_path)))
}

/// Topics of a bag.
#[derive(Debug)]
pub struct BagTopics {
    /// Topics with messages.
    pub topics: Vec<Topic>,
    /// Files that were cut off.
    pub notices: Vec<Notice>,
}

/// Reads the wanted topics of a bag. MCAP files that were cut off are read up to their last whole chunk.
///
/// # Errors
/// The bag cannot be read, is damaged, or is beyond a limit; a wanted message cannot be decoded.
pub fn read_topics(
    path: &Path,
    is_wanted: impl Fn(&str) -> bool,
    undecodable: Undecodable,
) -> Result<BagTopics, DataError> {
    let bytes = bag_bytes(path)?;
    let (mut contents, deadline) = (Contents::new(bytes), Deadline::new(bytes));
    // `None` for a topic that is left out.
    let mut topics: Vec<Option<TopicReader>> = Vec::new();
    let mut numbers: HashMap<String, usize> = HashMap::new();
    let mut notices = Vec::new();
    for file in files(path)? {
        // Decoder and topic by channel.
        let mut channels: HashMap<u16, Option<(Decoder, usize)>> = HashMap::new();
        for message in messages(&file, deadline, &mut notices)? {
            let message = message?;
            let channel = &message.channel;
            let at_file = |kind: ErrorKind| kind.at(Location::file(&file));
            let at_topic =
                |kind: ErrorKind| kind.at(Location::file(&file).column(channel.topic.as_str()));
            deadline.check().map_err(at_file)?;
            let known = match channels.entry(channel.id) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(vacant) => {
                    // Messages in JSON do without.
                    let definition =
                        channel.schema.as_ref().filter(|_| channel.message_encoding != "json");
                    if let Some(schema) = definition.filter(|_| is_wanted(&channel.topic)) {
                        contents.add_definition(schema.data.len()).map_err(at_file)?;
                    }
                    let decoder = is_wanted(&channel.topic).then(|| Decoder::new(channel));
                    vacant.insert(match decoder {
                        None => None,
                        Some(Ok(decoder)) => {
                            let index =
                                *numbers.entry(channel.topic.clone()).or_insert_with(|| {
                                    topics.push(Some(TopicReader::new(channel)));
                                    topics.len() - 1
                                });
                            check_topics(topics.len()).map_err(at_file)?;
                            Some((decoder, index))
                        }
                        Some(Err(_)) if undecodable == Undecodable::Skip => None,
                        Some(Err(reason)) => {
                            return Err(at_topic(ErrorKind::Undecodable { reason }));
                        }
                    })
                }
            };
            let Some((decoder, index)) = known else {
                continue;
            };
            let Some(topic) = &mut topics[*index] else {
                continue;
            };
            match topic.read(decoder, &message, &mut contents) {
                Err(ErrorKind::TooManyBagValues { max }) => {
                    return Err(at_file(ErrorKind::TooManyBagValues { max }));
                }
                Err(_) if undecodable == Undecodable::Skip => topics[*index] = None,
                result => result.map_err(at_topic)?,
            }
        }
    }
    let topics = topics.into_iter().flatten().map(TopicReader::finish).collect();
    Ok(BagTopics { topics, notices })
}

/// The mapping with which `import` reads a file of this project; `None` for files of others.
///
/// # Errors
/// The file cannot be read, or is damaged before its first message.
pub(crate) fn stated_mapping(path: &Path) -> Result<Option<String>, DataError> {
    let Some(file) = files(path)?.into_iter().next() else {
        return Ok(None);
    };
    // The writer of this project begins with a message of the topic that states it.
    let deadline = Deadline::new(bag_bytes(path)?);
    let first = messages(&file, deadline, &mut Vec::new())?.next().transpose()?;
    Ok(first.and_then(|message| message.channel.metadata.get(MAPPING_KEY).cloned()))
}

/// Best clock that all of these topics have: the time of the measurement where it is stated.
pub(crate) fn common_clock(topics: &[Topic]) -> &'static str {
    let is_stamped = |topic: &Topic| topic.values(HEADER_STAMP).is_some();
    if topics.iter().all(is_stamped) { HEADER_STAMP } else { LOG_TIME }
}

/// What a row of a table needs of the topics besides that of its clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Join {
    /// In every row the value at its time, interpolated between two messages that are not more than [`GAP_STEPS`] periods of their
    /// topic apart: for a board's readings and covariates.
    EveryRow,
    /// The same for topics as fast as the rows; each message of a slower one in the row nearest in time, and no value in the others:
    /// for a reference that is interpolated later.
    Once,
}

/// A table of joined topics.
#[derive(Debug)]
pub struct JoinedTopics {
    /// CSV text.
    pub text: Vec<u8>,
    /// Topics as fast as the rows with a clock of their own, with the columns of the text.
    pub joined: Vec<JoinedChannel>,
}

/// Largest ratio of its period to that of the rows at which a topic of [`Join::Once`] is interpolated.
const AS_FAST: f64 = 1.5;

/// A table of topics as CSV text: a row for each message of the clock's topic, in the order of their times, with the columns
/// `clock` and `columns`, each with half a turn in its unit where it is an angle.
///
/// # Errors
/// A column is not in the bag, or its topic is without the clock.
pub fn join_topics(
    path: &Path,
    topics: &[Topic],
    clock: &str,
    columns: &[(&str, Option<f64>)],
    join: Join,
) -> Result<JoinedTopics, DataError> {
    let (clock_topic, clock_path) = find(path, topics, clock)?;
    let clock_ns = clock_topic.values(clock_path).unwrap_or_default();
    let at_file = |kind: ErrorKind| kind.at(Location::file(path));
    if columns.len() > MAX_COLUMNS {
        return Err(at_file(ErrorKind::TooManyColumns { found: columns.len(), max: MAX_COLUMNS }));
    }
    let max = max_values(bag_bytes(path)?);
    check_values(clock_ns.len(), columns.len(), max).map_err(at_file)?;
    let order = ascending(clock_ns);
    let row_ns: Vec<f64> = order.iter().map(|row| clock_ns[*row]).collect();
    let mut names = vec![clock];
    let mut joined = vec![row_ns.clone()];
    let mut channels: Vec<JoinedChannel> = Vec::new();
    for (column, half_turn) in columns.iter().filter(|(column, _)| *column != clock) {
        let (topic, field) = find(path, topics, column)?;
        let values = topic.values(field).unwrap_or_default();
        names.push(column);
        if std::ptr::eq(topic, clock_topic) {
            joined.push(order.iter().map(|row| values[*row]).collect());
            continue;
        }
        let Some(time_ns) = topic.values(clock_path) else {
            let advice = format!(
                "{} has no {clock_path}: take {} as the clock, which every topic has",
                topic.name,
                clock_topic.column_name(LOG_TIME)
            );
            return Err(ErrorKind::MissingColumn { advice }
                .at(Location::file(path).column(topic.column_name(clock_path))));
        };
        let own_order = ascending(time_ns);
        let sorted = |of: &[f64]| own_order.iter().map(|row| of[*row]).collect::<Vec<f64>>();
        let (time_ns, values) = (sorted(time_ns), sorted(values));
        let is_slow = median_step(&time_ns) > AS_FAST * median_step(&row_ns);
        joined.push(match join {
            Join::Once if is_slow => once(&row_ns, &time_ns, &values),
            Join::EveryRow | Join::Once => {
                interpolated(&row_ns, &time_ns, &values, half_turn.unwrap_or(f64::INFINITY))
            }
        });
        match channels.iter_mut().find(|channel| channel.source == topic.name) {
            Some(channel) => channel.columns.push((*column).to_owned()),
            None if is_slow => {}
            None => {
                channels.extend(JoinedChannel::of(&topic.name, column, &row_ns, &time_ns, join))
            }
        }
    }
    let mut out = csv::Writer::from_writer(Vec::new());
    let unwritable = |error: csv::Error| {
        ErrorKind::Unwritable(std::io::Error::other(error)).at(Location::file(path))
    };
    out.write_record(&names).map_err(unwritable)?;
    for row in 0..row_ns.len() {
        let cells = joined.iter().map(|values| match values[row] {
            value if value.is_nan() => String::new(),
            value => value.to_string(),
        });
        out.write_record(cells).map_err(unwritable)?;
    }
    let text = out
        .into_inner()
        .map_err(|error| ErrorKind::Unwritable(error.into_error()).at(Location::file(path)))?;
    Ok(JoinedTopics { text, joined: channels })
}

impl JoinedChannel {
    /// The topic whose messages have these times, joined with rows; `None` where all have the time of a row.
    fn of(topic: &str, column: &str, row_ns: &[f64], time_ns: &[f64], join: Join) -> Option<Self> {
        let shift_ns = |time: &f64| row_ns.get(nearest_index(row_ns, *time)).map(|row| time - row);
        let mut shifts: Vec<f64> = time_ns.iter().filter_map(shift_ns).collect();
        shifts.sort_by(f64::total_cmp);
        let last = shifts.len().checked_sub(1)? as f64;
        let at = |share: f64| 1e-6 * shifts[(share * last).round() as usize];
        let shift_ms = [at(0.5), at(0.05), at(0.95)];
        if shifts.iter().all(|shift| *shift == 0.0) {
            return None;
        }
        let shares: Vec<f64> =
            row_ns.iter().filter_map(|row| share_of_next(time_ns, *row)).collect();
        Some(Self {
            source: topic.to_owned(),
            shift_ms,
            columns: vec![column.to_owned()],
            noise_factor: round_significant(noise_factor(&shares, join == Join::EveryRow), 4),
        })
    }
}

/// Share of the later of the two values between which a row is interpolated.
fn share_of_next(times: &[f64], row: f64) -> Option<f64> {
    let after = times.partition_point(|own| *own < row);
    let (next, last) = (times.get(after)?, times.get(after.checked_sub(1)?)?);
    Some((row - last) / (next - last))
}

/// Noise of a row relative to what third differences of interpolated values show (see [`WhiteNoise`]): interpolation correlates
/// neighbours. Where rows are averaged later, the noise of a row that counts is that of the samples.
///
/// [`WhiteNoise`]: crate::noise::WhiteNoise
fn noise_factor(shares: &[f64], is_averaged: bool) -> f64 {
    const DIFFERENCES: [f64; 4] = [1.0, -3.0, 3.0, -1.0];
    let of_rows = DIFFERENCES.iter().map(|weight| weight * weight).sum::<f64>();
    let shown = |share: &f64| {
        let at = |i: usize| DIFFERENCES.get(i).copied().unwrap_or(0.0);
        let before = |i: usize| i.checked_sub(1).map_or(0.0, at);
        (0..=4).map(|i| ((1.0 - share) * at(i) + share * before(i)).powi(2)).sum::<f64>()
    };
    let count = shares.len().max(1) as f64;
    let shown = shares.iter().map(shown).sum::<f64>() / count;
    let kept = shares.iter().map(|b| b * b + (1.0 - b) * (1.0 - b)).sum::<f64>() / count;
    let of_row = if is_averaged { 1.0 } else { kept };
    if shown > 0.0 { (of_row * of_rows / shown).sqrt() } else { 1.0 }
}

/// Topic and field of a column.
fn find<'a, 'c>(
    path: &Path,
    topics: &'a [Topic],
    column: &'c str,
) -> Result<(&'a Topic, &'c str), DataError> {
    let of = |topic: &'a Topic| {
        let field = column.strip_prefix(&topic.name)?.strip_prefix('.')?;
        topic.values(field).map(|_| (topic, field))
    };
    topics.iter().find_map(of).ok_or_else(|| {
        let names: Vec<String> = topics
            .iter()
            .flat_map(|topic| topic.columns.iter().map(|column| topic.column_name(&column.path)))
            .collect();
        let advice = match closest_match(column, names.iter().map(String::as_str)) {
            Some(near) => format!("did you mean {near}?"),
            None if names.is_empty() => "no message of its topic is in this file; `cargo magpie import --guess` lists what is".to_owned(),
            None => format!("the columns are {}", names.join(", ")),
        };
        ErrorKind::MissingColumn { advice }.at(Location::file(path).column(column))
    })
}

/// Indices in the order of the values.
fn ascending(values: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    order
}

/// Index of the time nearest to `time`, with `sorted` not empty.
fn nearest_index(sorted: &[f64], time: f64) -> usize {
    let after = sorted.partition_point(|own| *own < time);
    let distance = |index: usize| sorted.get(index).map_or(f64::INFINITY, |own| (own - time).abs());
    match after.checked_sub(1) {
        Some(before) if distance(before) <= distance(after) => before,
        _ => after.min(sorted.len().saturating_sub(1)),
    }
}

/// Median difference of ascending times; infinite with fewer than two.
fn median_step(times: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The value at the time of each row, interpolated linearly; none in a gap of the topic. Before the first message and after the last
/// it is theirs, up to a gap; between values that are more than `half_turn` apart the nearer one.
fn interpolated(rows: &[f64], times: &[f64], values: &[f64], half_turn: f64) -> Vec<f64> {
    let reach = GAP_STEPS * median_step(times);
    let nearest = |time: f64| {
        let index = nearest_index(times, time);
        let is_near = times.get(index).is_some_and(|own| (own - time).abs() <= reach);
        if is_near { values[index] } else { f64::NAN }
    };
    let value = |time: &f64| {
        let after = times.partition_point(|own| own < time);
        let Some(before) = after.checked_sub(1) else { return nearest(*time) };
        let (Some(next), last) = (times.get(after), times[before]) else { return nearest(*time) };
        let (from, to) = (values[before], values[after]);
        let is_step = (to - from).abs() > half_turn || from.is_nan() || to.is_nan();
        if is_step || next - last > reach || *next == *time {
            return nearest(*time);
        }
        from + (to - from) * (time - last) / (next - last)
    };
    rows.iter().map(value).collect()
}

/// Each value in the row nearest in time.
fn once(rows: &[f64], times: &[f64], values: &[f64]) -> Vec<f64> {
    let mut joined = vec![f64::NAN; rows.len()];
    for (time, value) in times.iter().zip(values) {
        if let Some(cell) = joined.get_mut(nearest_index(rows, *time)) {
            *cell = *value;
        }
    }
    joined
}

#[cfg(test)]
mod tests;
