//! Errors in recordings: the message names file, line, column and remedy.

use std::fs;
use std::path::Path;

use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, Recording};
use proptest::prelude::*;
use tempfile::TempDir;
use tests::{RECORDING_TOML, SyntheticCampaign, compress, nominal, write_recording};

const NO_DELAY: Alignment = Alignment { delay_us: 0.0 };

fn valid() -> (String, String) {
    let campaign =
        SyntheticCampaign { model: nominal(), seconds: 0.2, noise: (0.35, 0.15), seed: 1 };
    campaign.tables(1)
}

/// Error message of reading a valid recording after a modification.
fn error_of(modify: impl FnOnce(&Path, String, String)) -> String {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("rec");
    let (hall, force) = valid();
    write_recording(&path, RECORDING_TOML, &hall, &force);
    modify(&path, hall, force);
    let error = Recording::read(&path, NO_DELAY).unwrap_err().to_string();
    error.replace(&path.display().to_string(), "rec")
}

/// Replaces a cell; the header is line 1.
fn with_cell(text: &str, line: usize, column: usize, cell: &str) -> String {
    let edit = |(i, row): (usize, &str)| {
        let mut cells: Vec<&str> = row.split(',').collect();
        if i + 1 == line {
            cells[column] = cell;
        }
        cells.join(",") + "\n"
    };
    text.lines().enumerate().map(edit).collect()
}

fn assert_starts(message: &str, start: &str) {
    assert!(message.starts_with(start), "{message:?} should start with {start:?}");
}

fn assert_contains(message: &str, advice: &str) {
    assert!(message.contains(advice), "{message:?} should contain {advice:?}");
}

#[test]
fn semicolon_separators_are_reported() {
    let message = error_of(|path, hall, _| {
        fs::write(path.join("hall.csv"), hall.replace(',', ";")).unwrap();
        fs::remove_file(path.join("hall.csv.gz")).ok();
    });
    assert!(message.contains("hall.csv, line 1: the columns are separated by ';'"), "{message}");
}

#[test]
fn the_unmodified_recording_is_read() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = valid();
    write_recording(folder.path(), RECORDING_TOML, &hall, &force);
    let recording = Recording::read(folder.path(), NO_DELAY).unwrap();
    // 20 reference rows; the first window begins before the board's first row.
    assert_eq!(recording.time_s.len(), 19);
    assert_eq!(recording.notices, []);
}

#[test]
fn a_missing_file_is_named() {
    for (file, advice) in [
        ("hall.csv", "each may be gzipped"),
        ("force.csv", "each may be gzipped"),
        ("recording.toml", "it needs at least `format = 1`"),
    ] {
        let message = error_of(|path, _, _| fs::remove_file(path.join(file)).unwrap());
        assert_starts(&message, &format!("rec: {file} is missing; "));
        assert_contains(&message, advice);
    }
}

#[test]
fn a_folder_without_recordings_is_reported() {
    let folder = TempDir::new().unwrap();
    let error = Campaign::read(folder.path(), NO_DELAY, |_| ()).unwrap_err().to_string();
    assert_contains(&error, "this campaign has no recordings; a recording is a folder that holds");
    let error = Campaign::read(&folder.path().join("nowhere"), NO_DELAY, |_| ()).unwrap_err();
    assert_contains(&error.to_string(), "check the path");
}

/// A change of a valid recording: its folder, `hall.csv` and `force.csv`.
type Change = fn(&Path, &str, &str);

fn write_hall(folder: &Path, text: &str) {
    fs::write(folder.join("hall.csv"), text).unwrap();
}

fn write_force(folder: &Path, text: &str) {
    fs::write(folder.join("force.csv"), text).unwrap();
}

/// The table with its clock changed.
fn with_clock(table: &str, clock: impl Fn(u64) -> String) -> String {
    let line = |(i, row): (usize, &str)| match row.split_once(',') {
        Some((t, rest)) if i > 0 => format!("{},{rest}\n", clock(t.parse().unwrap())),
        _ => format!("{row}\n"),
    };
    table.lines().enumerate().map(line).collect()
}

#[test]
fn an_invalid_table_is_reported_with_its_place() {
    let cases: [(Change, &str, &str); 14] = [
        (
            |path, hall, _| {
                write_hall(path, &hall.replacen("s0_y_lsb", "s0_y_gauss", 1));
            },
            "rec/hall.csv, line 1, column s0_y_lsb: the column is missing",
            "sensor 0 needs all its axes in one unit",
        ),
        (
            |path, _, force| write_force(path, &force.replace("t_us,", "time_us,")),
            "rec/force.csv, line 1, column t_us: the column is missing from the header; every table needs",
            "",
        ),
        (
            |path, hall, _| write_hall(path, &hall.replace("s0_x_lsb", "s0_x")),
            "rec/hall.csv, line 1, column s0_x: the column has no unit; write s0_x_lsb",
            "",
        ),
        (
            |path, _, force| write_force(path, &force.replace("f0_z_n", "f0_zn")),
            "rec/force.csv, line 1, column f0_zn: unknown column; did you mean f0_z_n?",
            "",
        ),
        (
            |path, hall, _| write_hall(path, &with_cell(hall, 50, 0, "1000")),
            "rec/hall.csv, line 50, column t_us: the clock runs backwards, from 47000 to 1000; ",
            "sort the rows",
        ),
        (
            |path, hall, _| {
                let mut rows: Vec<&str> = hall.lines().collect();
                rows.insert(30, rows[29]);
                write_hall(path, &rows.join("\n"));
            },
            "rec/hall.csv, line 31, column t_us: the row is a duplicate of the previous one; remove it",
            "",
        ),
        (
            |path, _, force| write_force(path, &with_cell(force, 5, 0, "20000")),
            "rec/force.csv, line 5, column t_us: two rows have the same time",
            "",
        ),
        (
            |path, _, _| fs::rename(path.join("hall.csv"), path.join("hall.csv.gz")).unwrap(),
            "rec/hall.csv.gz: this is not a gzip file; if it is plain text, remove .gz from its name",
            "",
        ),
        (
            |path, _, _| {
                compress(path, "hall.csv");
                fs::rename(path.join("hall.csv.gz"), path.join("hall.csv")).unwrap();
            },
            "rec/hall.csv, line 1: this is not a text file; if it is compressed, its name must end in .csv.gz",
            "",
        ),
        (
            |path, hall, _| {
                write_hall(path, &with_clock(hall, |us| (us as f64 * 1e-6).to_string()));
            },
            "rec/hall.csv, line 2, column t_us: rows are 0.001 us apart; t_us must be in microseconds",
            "",
        ),
        (
            |path, _, force| {
                write_force(path, &with_clock(force, |us| (us + 9_000_000).to_string()));
            },
            "rec/force.csv, column t_us: the two clocks do not overlap: the board has 0.000 to 0.199 s, the reference 9.000 to 9.190 s",
            "",
        ),
        (
            |path, hall, _| write_hall(path, &with_clock(hall, |us| in_packets(us, 100))),
            "rec/hall.csv, column t_us: the board's rows come in packets, 0.100 ms apart and then 7.300 ms",
            "row_s in a mapping",
        ),
        (
            |path, hall, _| write_hall(path, &with_clock(hall, |us| in_packets(us, 2))),
            "rec/hall.csv, line 2, column t_us: the board's rows come in packets, 0.002 ms apart and then 7.986 ms",
            "row_s in a mapping",
        ),
        (
            |path, hall, _| write_hall(path, &with_clock(hall, |us| in_packets(us, 0))),
            "rec/hall.csv, line 3, column t_us: two rows have the same time, 0, and different values",
            "row_s in a mapping",
        ),
    ];
    for (change, start, part) in cases {
        let message = error_of(|path, hall, force| change(path, &hall, &force));
        assert_starts(&message, start);
        assert_contains(&message, part);
    }
}

/// The time of arrival of a row in a packet of eight.
fn in_packets(us: u64, step_us: u64) -> String {
    let row = us / 1000;
    (8000 * (row / 8) + step_us * (row % 8)).to_string()
}

#[test]
fn rows_at_a_clock_gap_are_excluded_with_a_notice() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = valid();
    let without: Vec<&str> = hall
        .lines()
        .enumerate()
        .filter(|(i, _)| !(80..110).contains(i))
        .map(|(_, row)| row)
        .collect();
    write_recording(folder.path(), RECORDING_TOML, &without.join("\n"), &force);
    let recording = Recording::read(folder.path(), NO_DELAY).unwrap();
    let notice = recording.notices[0].to_string();
    assert_contains(&notice, "hall.csv, line 81, column t_us: 1 gap in the clock");
    assert_contains(&notice, "31.0 ms at a period of 1.0 ms");
    // Windows around 80, 90, 100 and 110 ms overlap the gap from 78 to 109 ms.
    assert_eq!(recording.time_s.len(), 15);
    assert!(!recording.time_s.iter().any(|t| (0.075..0.115).contains(t)));
}

#[test]
fn an_invalid_number_is_reported_with_line_and_column() {
    for (cell, expected) in [
        ("NaN", "\"NaN\" is not finite"),
        ("inf", "\"inf\" is not finite"),
        ("12,5", "the row has 5 cells where the header has 4"),
        ("--", "\"--\" is not a number"),
        ("", "the cell is empty"),
        ("20000", "20000 is not a whole number within the sensor's 15 bit range"),
        ("100.5", "100.5 is not a whole number within the sensor's 15 bit range"),
    ] {
        let message = error_of(|path, hall, _| {
            fs::write(path.join("hall.csv"), with_cell(&hall, 20, 2, cell)).unwrap();
        });
        assert_starts(&message, "rec/hall.csv, line 20");
        assert_contains(&message, expected);
        if !expected.contains("cells") {
            assert_contains(&message, "column s0_y_lsb");
        }
    }
}

#[test]
fn an_implausible_force_or_time_is_reported() {
    for (line, column, cell, expected) in [
        (8, 1, "-1e12", None),
        (8, 1, "-1.1e12", Some("line 8, column f0_x_n: -1100000000000.0 is implausible")),
        (8, 1, "1e308", Some("line 8, column f0_x_n: 1e308 is implausible")),
        (21, 0, "9007199254740992", None),
        (
            21,
            0,
            "9007199254740994",
            Some("line 21, column t_us: 9007199254740994.0 is implausible"),
        ),
    ] {
        let folder = TempDir::new().unwrap();
        let (hall, force) = valid();
        let force = with_cell(&force, line, column, cell);
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
        let message = Recording::read(folder.path(), NO_DELAY).err().map(|e| e.to_string());
        assert_eq!(message.is_some(), expected.is_some(), "{cell}: {message:?}");
        assert_contains(&message.unwrap_or_default(), expected.unwrap_or_default());
    }
}

#[test]
fn a_reference_slower_than_its_window_allows_is_reported() {
    // 500 columns by 33,000 rows of the board between two rows of the reference.
    let names: Vec<String> =
        (0..500).map(|i| format!("s{}_{}_lsb", i / 3, ["x", "y", "z"][i % 3])).collect();
    let names = &names[..498];
    let zeros = ",0".repeat(names.len());
    let hall: String = (0..33_000).map(|i| format!("{}{zeros}\n", 25 * i)).collect();
    let message = error_of(|path, _, _| {
        write_hall(path, &format!("t_us,{}\n{hall}", names.join(",")));
        write_force(path, "t_us,f0_x_n\n450000,0\n1350000,0\n");
    });
    assert_contains(&message, "a row of the reference spans more than 16000000 values");
}

#[test]
fn a_clock_in_another_unit_is_reported() {
    for step in ["1", "4000000000"] {
        let message = error_of(|path, _, _| {
            let rows = (1..5).map(|row| format!("{},0,0,0\n", row * step.parse::<u64>().unwrap()));
            write_hall(
                path,
                &format!("t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n{}", rows.collect::<String>()),
            );
        });
        let expected = format!("rows are {step}.000 us apart; t_us must be in microseconds");
        assert_contains(&message, &expected);
    }
}

#[test]
fn an_empty_force_cell_is_a_missing_value() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = valid();
    write_recording(folder.path(), RECORDING_TOML, &hall, &with_cell(&force, 7, 1, ""));
    let recording = Recording::read(folder.path(), NO_DELAY).unwrap();
    let missing = |track: &model_export::recordings::recording::ForceSeries| {
        track.newtons.iter().filter(|n| n.is_nan()).count()
    };
    let counts: Vec<usize> = recording.forces.values().map(missing).collect();
    assert_eq!(counts, [1, 0]);
}

#[test]
fn a_truncated_gzip_file_is_reported() {
    let message = error_of(|path, _, _| {
        compress(path, "hall.csv");
        let compressed = path.join("hall.csv.gz");
        let bytes = fs::read(&compressed).unwrap();
        fs::write(&compressed, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert_starts(&message, "rec/hall.csv.gz, line ");
    assert_contains(&message, "the gzip stream ends too early or is damaged");
    assert_contains(&message, "copy the file again");
}

#[test]
fn a_wrong_key_of_the_description_is_reported_with_its_line() {
    for (from, to, expected) in [
        ("start_s = 0.0", "start_s = \"now\"", "rec/recording.toml, line 3: is invalid"),
        (
            "format = 1",
            "format = 2",
            "column format: 2 is not allowed here; this tool reads format = 1",
        ),
        ("gauss_per_lsb = 0.125\n", "", "column gauss_per_lsb: the key is missing"),
        ("start_s = 0.0", "start_s = nan", "column start_s: NaN is not allowed here"),
        (
            "start_s = 0.0",
            "start_s = -1.1e10",
            "column start_s: -11000000000.0 is not allowed here",
        ),
        ("gap_mm = 1.5", "gap_mm = -1.5", "column design.gap_mm: -1.5 is not allowed here"),
        ("gap_mm = 1.5", "gap_mm = 1e-320", "column design.gap_mm: 1e-320 is not allowed here"),
        (
            "gauss_per_lsb = 0.125",
            "gauss_per_lsb = 1e308",
            "column gauss_per_lsb: 1e308 is not allowed here; give 1e-9 to 1e6",
        ),
        ("\"cylinder\"", "\"banana\"", "line 7: is invalid: unknown variant `banana`"),
    ] {
        let message = error_of(|path, _, _| {
            let text = RECORDING_TOML.replace(from, to);
            fs::write(path.join("recording.toml"), text).unwrap();
        });
        assert_contains(&message, expected);
    }
}

#[test]
fn saturated_rows_are_excluded_with_a_notice() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = valid();
    write_recording(folder.path(), RECORDING_TOML, &with_cell(&hall, 102, 2, "15999"), &force);
    let recording = Recording::read(folder.path(), NO_DELAY).unwrap();
    assert_contains(
        &recording.notices[0].to_string(),
        "line 102, column s0_y_lsb: saturated in 1 rows",
    );
    let excluded = recording.sensors[&0].field_g.iter().filter(|field| field[1].is_nan()).count();
    assert_eq!(excluded, 1);
}

#[test]
fn misspelt_keys_are_ignored_with_a_notice() {
    let notices_with = |line: &str| {
        let folder = TempDir::new().unwrap();
        let (hall, force) = valid();
        write_recording(folder.path(), &format!("{RECORDING_TOML}{line}\n"), &hall, &force);
        let recording = Recording::read(folder.path(), NO_DELAY).unwrap();
        recording.notices.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let [misspelt] = &notices_with("force_range = 20.0")[..] else { panic!("one notice") };
    assert_contains(
        misspelt,
        "column force_range: unknown key, ignored; did you mean force_range_n?",
    );
    // Some effects have keys of their own.
    assert_eq!(notices_with("beam_length_mm = 30.0"), [""; 0]);
}

#[test]
fn recordings_of_two_designs_are_refused() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = valid();
    write_recording(&folder.path().join("1"), RECORDING_TOML, &hall, &force);
    let other = RECORDING_TOML.replace("gap_mm = 1.5", "gap_mm = 1.6");
    write_recording(&folder.path().join("2"), &other, &hall, &force);
    let error = Campaign::read(folder.path(), NO_DELAY, |_| ()).unwrap_err().to_string();
    assert_contains(
        &error,
        "all recordings of a campaign must be of one gripper: this one has one [design]",
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn random_bytes_never_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..400),
        file in 0..3_usize,
        is_compressed in any::<bool>(),
    ) {
        let folder = TempDir::new().unwrap();
        let (hall, force) = valid();
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
        let name = ["hall.csv", "force.csv", "recording.toml"][file];
        fs::write(folder.path().join(name), &bytes).unwrap();
        if is_compressed && file < 2 {
            compress(folder.path(), name);
        }
        if let Err(problem) = Recording::read(folder.path(), NO_DELAY) {
            prop_assert!(problem.to_string().contains(';'), "no advice in: {problem}");
        }
    }

    #[test]
    fn damaged_bytes_never_panic(
        damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        file in 0..2_usize,
        is_compressed in any::<bool>(),
    ) {
        let folder = TempDir::new().unwrap();
        let (hall, force) = valid();
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
        let mut name = ["hall.csv", "force.csv"][file].to_owned();
        if is_compressed {
            compress(folder.path(), &name);
            name += ".gz";
        }
        let path = folder.path().join(&name);
        let mut bytes = fs::read(&path).unwrap();
        for (index, byte) in damage {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        fs::write(&path, bytes).unwrap();
        if let Err(problem) = Recording::read(folder.path(), NO_DELAY) {
            prop_assert!(problem.to_string().contains(&name) || problem.to_string().contains("clock"), "no place in: {problem}");
        }
    }
}

#[test]
fn cut_last_line_is_left_out_with_a_notice() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("rec");
    let (hall, force) = valid();
    write_recording(&path, RECORDING_TOML, &hall, &force);
    let read = |hall: &str| {
        fs::remove_file(path.join("hall.csv.gz")).ok();
        fs::write(path.join("hall.csv"), hall).unwrap();
        Recording::read(&path, NO_DELAY)
    };
    let whole = read(&hall).unwrap();
    let lines = hall.lines().count();
    let last = hall.trim_end().rfind('\n').unwrap() + 1;
    let last_comma = hall.rfind(',').unwrap();
    for end in [last + 1, last + 3, (last + last_comma) / 2, last_comma, last_comma + 1] {
        let recording = read(&hall[..end]).unwrap();
        assert_eq!(recording.rows_read.0, whole.rows_read.0 - 1, "{end}");
        let [notice] = &recording.notices[..] else { panic!("{:?}", recording.notices) };
        let notice = notice.to_string();
        assert!(notice.contains(&format!("line {lines}: the last line was cut off")), "{notice}");
    }
    // A whole line without its end is read.
    let recording = read(hall.trim_end()).unwrap();
    assert_eq!((recording.rows_read, recording.notices.len()), (whole.rows_read, 0));
    // Other short lines are errors, also where the file is cut elsewhere.
    let ended = format!("{}\n", &hall[..last_comma]);
    let followed = format!("{}\n{}", &hall[..last_comma], &hall[last..last_comma]);
    let not_a_number = format!("{}x,", &hall[..last]);
    for (text, line) in [(ended, lines), (followed, lines), (not_a_number, lines)] {
        let message = read(&text).unwrap_err().to_string();
        assert_contains(&message, &format!("line {line}"));
    }
}
