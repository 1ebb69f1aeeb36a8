//! Files that are made to exhaust a reader: each is read, or refused with a sentence.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use mcap::MAGIC;
use mcap::records::op;
use rusqlite::Connection;
use tempfile::TempDir;

use super::{MAG, MAGNETIC_FIELD, magnetic_field};
use crate::mcap::{Topic, Undecodable, join_topics, read_topics};

/// A record with the length that it states.
fn stating(kind: u8, length: u64, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &length.to_le_bytes(), content].concat()
}

fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    stating(kind, content.len() as u64, content)
}

/// A text after the length that it states.
fn text_stating(length: u32, text: &[u8]) -> Vec<u8> {
    [&length.to_le_bytes()[..], text].concat()
}

fn text(text: &str) -> Vec<u8> {
    text_stating(text.len() as u32, text.as_bytes())
}

fn schema(id: u16, name: &str, encoding: &str, definition: &[u8]) -> Vec<u8> {
    let definition = text_stating(definition.len() as u32, definition);
    record(op::SCHEMA, &[&id.to_le_bytes()[..], &text(name), &text(encoding), &definition].concat())
}

fn channel(id: u16, schema: u16, topic: &str, encoding: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(op::CHANNEL, &[ids, text(topic), text(encoding), text("")].concat())
}

fn message(channel: u16, data: &[u8]) -> Vec<u8> {
    record(op::MESSAGE, &[&channel.to_le_bytes()[..], &[0; 4], &[1; 16], data].concat())
}

/// A chunk with the lengths that it states.
fn chunk_stating(compression: &str, [whole, compressed]: [u64; 2], records: &[u8]) -> Vec<u8> {
    let lengths = [&[0; 16][..], &whole.to_le_bytes(), &[0; 4]].concat();
    let compressed = compressed.to_le_bytes();
    record(op::CHUNK, &[&lengths, &text(compression), &compressed[..], records].concat())
}

fn packed(compression: &str, records: &[u8]) -> Vec<u8> {
    let bytes = match compression {
        "zstd" => zstd::encode_all(records, 19).unwrap(),
        "lz4" => {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
            encoder.write_all(records).unwrap();
            encoder.finish().0
        }
        _ => records.to_vec(),
    };
    chunk_stating(compression, [records.len() as u64, bytes.len() as u64], &bytes)
}

fn file(records: &[Vec<u8>]) -> Vec<u8> {
    let header = record(op::HEADER, &[text("ros2"), text("")].concat());
    let end = [record(op::DATA_END, &[0; 4]), record(op::FOOTER, &[0; 20])].concat();
    [MAGIC, &header, &records.concat(), &end, MAGIC].concat()
}

/// A file with a message of this definition.
fn of_definition(definition: &str, content: &[u8]) -> Vec<u8> {
    let data = [&[0, 1, 0, 0], content].concat();
    file(&[
        schema(1, "a/msg/A", "ros2msg", definition.as_bytes()),
        channel(1, 1, "/a", "cdr"),
        message(1, &data),
    ])
}

fn of_json<T: AsRef<[u8]>>(messages: impl IntoIterator<Item = T>) -> Vec<u8> {
    let messages = messages.into_iter().map(|data| message(1, data.as_ref()));
    file(&[channel(1, 0, "/a", "json")].into_iter().chain(messages).collect::<Vec<_>>())
}

fn sound() -> Vec<Vec<u8>> {
    let (topic, name, encoding, definition, message_encoding) = MAG;
    vec![
        schema(1, name, encoding, definition.as_bytes()),
        channel(1, 1, topic, message_encoding),
        message(1, &magnetic_field(1, 2, [3.0; 3])),
    ]
}

/// Types `a/T0` to `a/Tn`, each with fields of the next.
fn nested(levels: usize, fields: &str) -> String {
    let types = (0..levels).map(|level| {
        let line = |name: &str| format!("{fields}\n").replace("NEXT", name);
        let content = match level + 1 == levels {
            true => "float64 x\n".to_owned(),
            false => line(&format!("T{}", level + 1)),
        };
        if level == 0 { content } else { format!("====\nMSG: a/T{level}\n{content}") }
    });
    types.collect()
}

fn read_all(path: &Path, undecodable: Undecodable) -> Result<Vec<Topic>, String> {
    let read = read_topics(path, |_| true, undecodable).map_err(|error| error.to_string())?;
    let topics = read.topics;
    for topic in &topics {
        assert!(topic.columns.iter().all(|column| column.values.len() == topic.messages()));
    }
    Ok(topics)
}

/// Reads the file as an import and as a guess do; the first number of the first topic, or the sentence of the import.
fn read(path: &Path) -> Result<f64, String> {
    let guessed = read_all(path, Undecodable::Skip);
    let topics = read_all(path, Undecodable::Refuse);
    assert!(guessed.is_ok() || topics.is_err());
    let topics = topics?;
    let number = topics.first().and_then(|topic| topic.fields().next());
    Ok(number.map_or(f64::NAN, |column| column.values[0]))
}

/// Reads files under this name, each expected to give a number or a part of a sentence.
fn check(name: &str, cases: &[(&str, Vec<u8>, Result<f64, &str>)]) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join(name);
    for (case, bytes, expected) in cases {
        fs::write(&path, bytes).unwrap();
        match (read(&path), expected) {
            (Ok(number), Ok(expected)) => assert_eq!(number, *expected, "{case}"),
            (Err(message), Err(part)) => assert!(message.contains(part), "{case}: {message}"),
            (result, expected) => panic!("{case}: {result:?} where {expected:?} is expected"),
        }
    }
}

#[test]
fn records_with_wrong_lengths_are_refused_or_skipped() {
    let with = |record: Vec<u8>| file(&[sound(), vec![record]].concat());
    let attachment = [&[0; 16][..], &text("a"), &text("b"), &(1_u64 << 60).to_le_bytes()].concat();
    let four_gib = |before: &[u8]| [before, &text_stating(u32::MAX, b"abc")].concat();
    let names = [text("a"), text("b")].concat();
    let long_metadata = {
        let pair = [text("units"), text(&"x".repeat(1 << 17))].concat();
        let ids = [2, 0, 0, 0];
        record(op::CHANNEL, &[&ids[..], &names, &text_stating(pair.len() as u32, &pair)].concat())
    };
    let in_chunk = |compression: &str, inner: Vec<u8>| with(packed(compression, &inner));
    let damaged = Err("`mcap recover`");
    let of_chunk = |compression: &str, lengths, records: &[u8]| {
        with(chunk_stating(compression, lengths, records))
    };
    let mut wrong_checksum = packed("", &sound().concat());
    wrong_checksum[9 + 24] = 1;
    check(
        "a.mcap",
        &[
            ("sound", file(&sound()), Ok(3.0)),
            ("in a chunk", file(&[packed("", &sound().concat())]), Ok(3.0)),
            ("compressed by zstd", file(&[packed("zstd", &sound().concat())]), Ok(3.0)),
            ("compressed by lz4", file(&[packed("lz4", &sound().concat())]), Ok(3.0)),
            ("attachment of 2^60 bytes", with(record(op::ATTACHMENT, &attachment)), Ok(3.0)),
            (
                "attachment in a chunk",
                in_chunk("zstd", record(op::ATTACHMENT, &attachment)),
                Ok(3.0),
            ),
            ("metadata that is cut", with(record(op::METADATA, &[255; 4])), Ok(3.0)),
            ("record of 2^60 bytes", with(stating(op::ATTACHMENT, 1 << 60, b"a")), damaged),
            ("record of 2^64 bytes", with(stating(op::MESSAGE, u64::MAX, b"a")), damaged),
            ("schema name of 4 GiB", with(record(op::SCHEMA, &four_gib(&[2, 0]))), damaged),
            (
                "schema encoding of 4 GiB",
                with(record(op::SCHEMA, &four_gib(&[&[2, 0][..], &text("a")].concat()))),
                damaged,
            ),
            (
                "schema of 4 GiB",
                with(record(op::SCHEMA, &four_gib(&[&[2, 0][..], &names].concat()))),
                damaged,
            ),
            ("topic of 4 GiB", with(record(op::CHANNEL, &four_gib(&[2, 0, 0, 0]))), damaged),
            (
                "metadata of 4 GiB",
                with(record(op::CHANNEL, &four_gib(&[&[2, 0, 0, 0][..], &names].concat()))),
                damaged,
            ),
            ("long metadata", with(long_metadata), Err("longer than 65536 bytes")),
            ("message without a time", with(record(op::MESSAGE, &[1, 0])), damaged),
            ("message of an unknown channel", with(message(9, b"")), damaged),
            ("channel of an unknown schema", with(channel(2, 9, "/b", "cdr")), damaged),
            ("channel that changes", with(channel(1, 1, "/b", "cdr")), damaged),
            ("schema that changes", with(schema(1, "a", "ros2msg", b"")), damaged),
            (
                "record beyond its chunk",
                in_chunk("", stating(op::MESSAGE, 100, b"a")),
                Err("exceeds its chunk"),
            ),
            (
                "record beyond its packed chunk",
                in_chunk("lz4", stating(op::ATTACHMENT, 1 << 60, b"a")),
                Err("exceeds its chunk"),
            ),
            ("header beyond its chunk", in_chunk("", vec![op::MESSAGE, 1]), damaged),
            ("chunk without content", with(record(op::CHUNK, &[0; 8])), damaged),
            (
                "chunk of 2^40 bytes",
                of_chunk("zstd", [1 << 40, 4], b"abcd"),
                Err("longer than 256 MiB"),
            ),
            ("chunk beyond its record", of_chunk("", [4, u64::MAX], b"abcd"), damaged),
            ("chunk that is no zstd", of_chunk("zstd", [4, 4], b"abcd"), damaged),
            ("chunk that is no lz4", of_chunk("lz4", [4, 4], b"abcd"), damaged),
            (
                "chunk of an unknown compression",
                of_chunk("brotli", [4, 4], b"abcd"),
                Err("\"brotli\""),
            ),
            ("chunk with a wrong checksum", with(wrong_checksum), Err("checksum")),
            ("nothing", Vec::new(), damaged),
            ("marks alone", [MAGIC, MAGIC].concat(), damaged),
        ],
    );
}

#[test]
fn compressed_bags_are_limited_by_their_ratio() {
    let ratio = Err("more than 100 times as long");
    let padding = record(op::ATTACHMENT, &vec![0; 8 << 20]);
    let bombs = |compression: &str, count: usize| {
        let chunk = packed(compression, &[sound().concat(), padding.clone()].concat());
        file(&vec![chunk; count])
    };
    let many_chunks = bombs("zstd", 4);
    assert!(many_chunks.len() < 20_000, "{}", many_chunks.len());
    let one = packed("zstd", &record(op::ATTACHMENT, &vec![0; 100 << 20]));
    check(
        "a.mcap",
        &[
            ("free", bombs("zstd", 1), Ok(3.0)),
            ("one chunk", file(&[one]), ratio),
            ("many chunks", many_chunks, ratio),
        ],
    );
}

#[test]
fn definitions_without_end_are_refused() {
    let four_gib = &u32::MAX.to_le_bytes()[..];
    let value = 5.0_f64.to_le_bytes();
    let loops = "a/B b\n===\nMSG: a/B\na/C c\n===\nMSG: a/C\na/B b\n";
    let empty = "float64 x\na/E[] e\n===\nMSG: a/E\n";
    let lengths = |length: &[u8]| [&value[..], length].concat();
    let too_early = Err("too early");
    let invalid = Err("is no field");
    let constants: String = (0..20_000).map(|i| format!("uint8 C{i}=1\n")).collect();
    let enumeration =
        format!("float64 x\n{}===\nMSG: a/E\n{constants}", "a/E[100] e\n".repeat(100));
    check(
        "a.mcap",
        &[
            (
                "mutual recursion",
                of_definition(loops, &[0; 64]),
                Err("a/B contains itself (a/A > a/B > a/C > a/B)"),
            ),
            ("recursion", of_definition("A a", &[0; 64]), Err("a/A contains itself")),
            ("recursion in an array", of_definition("A[] a", &[0; 64]), Err("contains itself")),
            (
                "recursion in an empty array",
                of_definition("a/msg/A[<=3] a\n", &[0; 4]),
                Err("contains itself"),
            ),
            ("32 levels", of_definition(&nested(32, "NEXT a"), &value), Ok(5.0)),
            ("33 levels", of_definition(&nested(33, "NEXT a"), &value), Err("more than 32 levels")),
            (
                "30,000 levels",
                of_definition(&nested(30_000, "NEXT a"), &value),
                Err("more than 32 levels"),
            ),
            ("2^31 values", of_definition(&nested(32, "NEXT a\nNEXT b"), &[0; 64]), too_early),
            ("3^31 values", of_definition(&nested(32, "NEXT[3] a"), &[0; 64]), too_early),
            ("array of empty", of_definition(empty, &lengths(four_gib)), too_early),
            ("short array of empty", of_definition(empty, &lengths(&[2, 0, 0, 0, 1, 1])), Ok(5.0)),
            (
                "array of text",
                of_definition("float64 x\nstring[] s", &lengths(four_gib)),
                too_early,
            ),
            (
                "array of numbers",
                of_definition("float64 x\nuint8[] s", &lengths(four_gib)),
                too_early,
            ),
            ("text", of_definition("float64 x\nstring s", &lengths(four_gib)), too_early),
            ("array of 2^63", of_definition("float64[9223372036854775807] x", &value), too_early),
            (
                "array of 2^63 messages",
                of_definition("E[9223372036854775807] x\n===\nMSG: a/E\nbool b", &value),
                too_early,
            ),
            ("array of none", of_definition("E[0] e\n===\nMSG: a/E\nfloat64 x", &value), invalid),
            (
                "array of more than a word",
                of_definition("float64[99999999999999999999] x", &value),
                invalid,
            ),
            (
                "long array left out",
                of_definition("float64[100] a\nfloat64 x", &[[0; 800].as_slice(), &value].concat()),
                Ok(5.0),
            ),
            (
                "lone quotation mark",
                of_definition("float64 x\nstring s \"\n", &lengths(&[0; 4])),
                Ok(5.0),
            ),
            (
                "constants",
                of_definition(
                    "float64 x\nE e\n===\nMSG: a/E\nint8 ONE=1\nint8 TWO = 2\n",
                    &lengths(&[2]),
                ),
                Ok(5.0),
            ),
            ("line without a name", of_definition("float64", &value), invalid),
            ("open bracket", of_definition("float64[ x", &value), invalid),
            (
                "long name of a field",
                of_definition(&format!("float64 {}", "a".repeat(2000)), &value),
                invalid,
            ),
            ("many uses of a long enumeration", of_definition(&enumeration, &[0; 20_000]), Ok(0.0)),
            ("unknown type", of_definition("b/B x", &value), Err("type b/B is missing")),
            ("wide text", of_definition("wstring x", &value), Err("wstring")),
            ("message without content", of_definition("float64 x", b""), too_early),
            (
                "long definition",
                of_definition(&"float64 x\n".repeat(200_000), &value),
                Err("longer than 1024 kB"),
            ),
            (
                "twice the same name",
                of_definition("float64 x\nfloat64 x", &[value, value].concat()),
                Ok(5.0),
            ),
        ],
    );
}

#[test]
fn values_and_names_are_limited() {
    let wide = |count: usize| {
        let fields: Vec<String> = (0..count).map(|i| format!("\"f{i}\":{i}")).collect();
        format!("{{{}}}", fields.join(","))
    };
    let array = |levels: usize| format!("{}{}", "[".repeat(levels), "]".repeat(levels));
    let each_new = (0..1100).map(|i| format!("{{\"f{i}\": 1}}"));
    let sparse = std::iter::once(wide(1000)).chain(std::iter::repeat_n("{}".to_owned(), 40_000));
    let topics = |count: u16| {
        let topic =
            |id| [channel(id, 0, &format!("/t{id}"), "json"), message(id, b"{\"x\":7}")].concat();
        file(&(0..count).map(topic).collect::<Vec<_>>())
    };
    let shared = |channels: u16| {
        let definition = format!("float64 x\n{}", "# comment\n".repeat(100_000));
        let schema = schema(1, "a/A", "ros2msg", definition.as_bytes());
        let of = |id| {
            [
                channel(id, 1, &format!("/t{id}"), "cdr"),
                message(id, &[[0, 1, 0, 0, 0, 0, 0, 0], [0; 8]].concat()[..12]),
            ]
            .concat()
        };
        file(&std::iter::once(schema).chain((1..=channels).map(of)).collect::<Vec<_>>())
    };
    let columns = Err("there are 1025 columns, and the limit is 1024");
    check(
        "a.mcap",
        &[
            ("1000 fields", of_json([wide(1000)]), Ok(0.0)),
            ("1100 fields", of_json([wide(1100)]), columns),
            ("a new field in each message", of_json(each_new), columns),
            ("empty values", of_json(sparse), Err("values with the empty ones")),
            ("long name", of_json([format!("{{\"{}\": 1}}", "a".repeat(2000))]), Err("1024 bytes")),
            (
                "long message",
                of_json([format!("[{}1]", "1,".repeat(1 << 20))]),
                Err("longer than 1024 kB"),
            ),
            ("deep arrays", of_json([array(100_000)]), Err("recursion limit")),
            ("definition of 16 topics", shared(16), Ok(0.0)),
            ("definition of 17 topics", shared(17), Err("the message definitions of its topics")),
            ("1024 topics", topics(1024), Ok(7.0)),
            ("1025 topics", topics(1025), Err("more than 1024 topics")),
            ("65,000 topics", topics(65_000), Err("more than 1024 topics")),
        ],
    );
}

#[test]
fn joined_table_is_limited() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, of_json(["{\"x\": 1}"])).unwrap();
    let column = |path: &str, rows: usize| super::TopicColumn {
        path: path.to_owned(),
        values: vec![1.0; rows],
    };
    let rows = vec![column("log_time", 200_000), column("v", 200_000)];
    let fields: Vec<_> =
        (0..500).map(|i| column(&format!("f{i}"), 1)).chain([column("log_time", 1)]).collect();
    let topics = [("/a", rows), ("/b", fields)].map(|(name, columns)| Topic {
        name: name.to_owned(),
        columns,
        ..Topic::default()
    });
    let names: Vec<String> = (0..500).map(|i| format!("/b.f{i}")).collect();
    let columns: Vec<_> = names.iter().map(|name| (name.as_str(), None)).collect();
    let join = super::Join::EveryRow;
    let message =
        join_topics(&path, &topics, "/a.log_time", &columns, join).unwrap_err().to_string();
    assert!(message.contains("values with the empty ones"), "{message}");
}

/// Tables of `rosbag2_storage_sqlite3`.
const TOPICS: &str = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL);";
const MESSAGES: &str = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);";
const DEFINITIONS: &str = "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT);";
/// A query without end.
const ENDLESS: &str = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)";

/// A database of these statements.
fn database(statements: &[&str]) -> Vec<u8> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.db3");
    Connection::open(&path).unwrap().execute_batch(&statements.concat()).unwrap();
    fs::read(path).unwrap()
}

/// Statements with a topic, its definition and a message.
fn rows() -> String {
    let hex: String =
        magnetic_field(1, 2, [3.0; 3]).iter().map(|byte| format!("{byte:02x}")).collect();
    format!(
        "INSERT INTO topics VALUES (1, '/m', 'sensor_msgs/msg/MagneticField', 'cdr');
         INSERT INTO message_definitions VALUES (1, 'sensor_msgs/msg/MagneticField', 'ros2msg', '{MAGNETIC_FIELD}', '');
         INSERT INTO messages VALUES (1, 1, 5, x'{hex}');"
    )
}

#[test]
fn only_plain_tables_of_a_database_are_read() {
    let rows = rows();
    let view = |name: &str, query: &str| format!("CREATE VIEW {name} AS {query};");
    let endless_topics = view(
        "topics",
        &format!(
            "{ENDLESS} SELECT i AS id, 'a' AS name, 'b' AS type, 'cdr' AS serialization_format FROM n"
        ),
    );
    let endless_messages = view(
        "messages",
        &format!(
            "{ENDLESS} SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n"
        ),
    );
    let endless_definitions = view(
        "message_definitions",
        &format!(
            "{ENDLESS} SELECT i AS topic_type, i AS encoding, i AS encoded_message_definition FROM n"
        ),
    );
    let computed = MESSAGES.replace(
        "data BLOB NOT NULL",
        "raw BLOB, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000))",
    );
    let hidden = "a view";
    let stated = "PRAGMA writable_schema = 1; UPDATE sqlite_schema SET type = 'table', rootpage = 2 WHERE name = 'messages';";
    // A default takes the place of what the rows of before do not have.
    let long_names = format!(
        "DROP TABLE topics; CREATE TABLE topics(id INTEGER PRIMARY KEY); {ENDLESS} INSERT INTO topics SELECT i FROM n LIMIT 1000;
         ALTER TABLE topics ADD COLUMN name TEXT DEFAULT '{0}'; ALTER TABLE topics ADD COLUMN type TEXT DEFAULT '{0}';
         ALTER TABLE topics ADD COLUMN serialization_format TEXT DEFAULT 'cdr';",
        "a".repeat(100_000)
    );
    let many = |count: u32| {
        let topics = format!(
            "{ENDLESS} INSERT INTO topics SELECT i, '/t' || i, 'std_msgs/msg/Float64', 'cdr' FROM n LIMIT {count};"
        );
        database(&[
            TOPICS,
            MESSAGES,
            &topics,
            "INSERT INTO messages VALUES (1, 1, 5, x'000100000000000000001c40');",
        ])
    };
    let message = |value: &str| {
        database(&[
            TOPICS,
            MESSAGES,
            DEFINITIONS,
            &rows,
            &format!("INSERT INTO messages VALUES (2, 1, 5, {value});"),
        ])
    };
    let definition = |text: &str| {
        let change =
            format!("UPDATE message_definitions SET encoded_message_definition = '{text}';");
        database(&[TOPICS, MESSAGES, DEFINITIONS, &rows, &change])
    };
    let as_row = |table: &str, count: usize| {
        format!("INSERT INTO {table} VALUES ({});", vec!["1"; count].join(","))
    };
    check(
        "a.db3",
        &[
            ("sound", database(&[TOPICS, MESSAGES, DEFINITIONS, &rows]), Ok(3.0)),
            (
                "negative numbers",
                database(&[
                    TOPICS,
                    MESSAGES,
                    DEFINITIONS,
                    &rows,
                    "UPDATE messages SET id = -9223372036854775808;",
                ]),
                Ok(3.0),
            ),
            ("topics as a view", database(&[&endless_topics, MESSAGES]), Err(hidden)),
            (
                "messages as a view",
                database(&[TOPICS, &endless_messages, &as_row("topics", 4)]),
                Err(hidden),
            ),
            (
                "definitions as a view",
                database(&[TOPICS, MESSAGES, &endless_definitions]),
                Err(hidden),
            ),
            (
                "a view in capitals",
                database(&[TOPICS, &endless_messages.replace("VIEW messages", "VIEW MESSAGES")]),
                Err(hidden),
            ),
            (
                "a view that is stated to be a table",
                database(&[TOPICS, &endless_messages, stated]),
                Err("`ros2 bag reindex`"),
            ),
            (
                "shared texts",
                database(&[TOPICS, MESSAGES, &long_names]),
                Err("longer than the file"),
            ),
            (
                "a virtual table",
                database(&[
                    "CREATE VIRTUAL TABLE topics USING fts5(id, name, type, serialization_format);",
                    MESSAGES,
                ]),
                Err("no ordinary table"),
            ),
            ("computed messages", database(&[TOPICS, &computed]), Err("computed columns")),
            (
                "without row numbers",
                database(&[TOPICS, &MESSAGES.replace(");", ") WITHOUT ROWID;")]),
                Err("no ordinary table"),
            ),
            ("no tables", database(&["CREATE TABLE a(b);"]), Err("`ros2 bag reindex`")),
            ("a message as text", message("'abc'"), Err("no blob")),
            ("a message as a number", message("5"), Err("no blob")),
            ("a message without content", message("x''"), Err("shorter than its header")),
            ("a recursive definition", definition("MagneticField m"), Err("contains itself")),
            ("an invalid definition", definition("float64"), Err("is no field")),
            ("1024 topics", many(1024), Ok(7.0)),
            ("1025 topics", many(1025), Err("more than 1024 topics")),
            ("65,000 topics", many(65_000), Err("more than 1024 topics")),
            (
                "a torn file",
                database(&[TOPICS, MESSAGES, DEFINITIONS, &rows])[..9000].to_vec(),
                Err("`ros2 bag reindex`"),
            ),
            ("nothing", Vec::new(), Err("`ros2 bag reindex`")),
        ],
    );
}

/// Files in a folder, in order.
fn names(folder: &Path) -> Vec<PathBuf> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| PathBuf::from(entry.unwrap().file_name()))
        .collect();
    names.sort();
    names
}

#[test]
fn database_is_read_without_a_file_beside_it() {
    let folder = TempDir::new().unwrap();
    // The address of a file has signs of its own.
    let path = folder.path().join("50% of #1?.db3");
    let writer = Connection::open(&path).unwrap();
    writer.pragma_update(None, "journal_mode", "wal").unwrap();
    writer.execute_batch(&[TOPICS, MESSAGES, DEFINITIONS, &rows()].concat()).unwrap();
    let wal = folder.path().join("50% of #1?.db3-wal");
    let unfinished = fs::read(&wal).unwrap();
    drop(writer);
    assert_eq!(fs::read(&path).unwrap()[18..20], [2, 2], "in WAL mode");
    assert_eq!(read(&path), Ok(3.0));
    assert_eq!(names(folder.path()), [Path::new("50% of #1?.db3")]);
    // A folder that cannot be written is no other case: nothing is written.
    fs::write(&wal, b"").unwrap();
    assert_eq!(read(&path), Ok(3.0));
    for end in ["-wal", "-journal"] {
        fs::remove_file(&wal).ok();
        let other = format!("50% of #1?.db3{end}");
        fs::write(folder.path().join(&other), &unfinished).unwrap();
        let message = read(&path).unwrap_err();
        assert!(message.contains(&other) && message.contains("VACUUM`"), "{message}");
        assert_eq!(names(folder.path()).len(), 2);
        fs::remove_file(folder.path().join(other)).unwrap();
    }
}
