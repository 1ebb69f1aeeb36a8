//! Every bad input that a user will really have gets one clear sentence: file, line, column, what
//! to do.

use std::fs;
use std::path::Path;

use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, Recording};
use proptest::prelude::*;
use tempfile::TempDir;
use tests::{Bench, RECORDING_TOML, nominal, pack, write_recording};

const AT_ONCE: Alignment = Alignment { delay_us: 0.0 };

fn good() -> (String, String) {
    let bench = Bench {
        model: nominal(),
        seconds: 0.2,
        noise: (0.35, 0.15),
        seed: 1,
    };
    bench.tables(1)
}

/// Writes a good recording, spoils it, and returns what reading it says.
fn said(spoil: impl FnOnce(&Path, String, String)) -> String {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("rec");
    let (hall, force) = good();
    write_recording(&path, RECORDING_TOML, &hall, &force);
    spoil(&path, hall, force);
    let error = Recording::read(&path, AT_ONCE).unwrap_err().to_string();
    error.replace(&path.display().to_string(), "rec")
}

/// Replaces cell `column` of line `line` (the header is line 1).
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

fn starts(sentence: &str, start: &str) {
    assert!(
        sentence.starts_with(start),
        "{sentence:?} should start with {start:?}"
    );
}

fn advises(sentence: &str, advice: &str) {
    assert!(
        sentence.contains(advice),
        "{sentence:?} should say {advice:?}"
    );
}

#[test]
fn columns_between_semicolons_are_called_so() {
    let said = said(|path, hall, _| {
        fs::write(path.join("hall.csv"), hall.replace(',', ";")).unwrap();
        fs::remove_file(path.join("hall.csv.gz")).ok();
    });
    assert!(
        said.contains("hall.csv, line 1: the columns are separated by ';'"),
        "{said}"
    );
}

#[test]
fn the_recording_before_it_is_spoilt_reads_well() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = good();
    write_recording(folder.path(), RECORDING_TOML, &hall, &force);
    let recording = Recording::read(folder.path(), AT_ONCE).unwrap();
    // 20 reference rows; the first window begins before the board's first row.
    assert_eq!(recording.time_s.len(), 19);
    assert_eq!(recording.notices, []);
}

#[test]
fn a_missing_file_is_named_with_what_a_recording_holds() {
    for (file, advice) in [
        ("hall.csv", "each may be gzipped"),
        ("force.csv", "each may be gzipped"),
        ("recording.toml", "it needs at least `format = 1`"),
    ] {
        let sentence = said(|path, _, _| fs::remove_file(path.join(file)).unwrap());
        starts(&sentence, &format!("rec: {file} is missing; "));
        advises(&sentence, advice);
    }
}

#[test]
fn a_folder_without_recordings_says_what_a_recording_is() {
    let folder = TempDir::new().unwrap();
    let error = Campaign::read(folder.path(), AT_ONCE, |_| ())
        .unwrap_err()
        .to_string();
    advises(
        &error,
        "this campaign has no recordings; a recording is a folder that holds",
    );
    let error = Campaign::read(&folder.path().join("nowhere"), AT_ONCE, |_| ()).unwrap_err();
    advises(&error.to_string(), "check the path");
}

#[test]
fn a_missing_column_is_named() {
    let sentence = said(|path, hall, _| {
        let without_y = hall.lines().map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            [cells[0], cells[1], cells[3]].join(",") + "\n"
        });
        fs::write(path.join("hall.csv"), without_y.collect::<String>()).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 1, column s0_y_lsb: the column is missing",
    );
    advises(&sentence, "sensor 0 needs all three axes");
    let sentence = said(|path, _, force| {
        fs::write(path.join("force.csv"), force.replace("t_us,", "time_us,")).unwrap();
    });
    starts(
        &sentence,
        "rec/force.csv, line 1, column t_us: the column is missing from the header; every table starts",
    );
}

#[test]
fn a_column_without_a_unit_or_misspelt_is_told_its_name() {
    let sentence = said(|path, hall, _| {
        fs::write(path.join("hall.csv"), hall.replace("s0_x_lsb", "s0_x")).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 1, column s0_x: the column has no unit; write s0_x_lsb",
    );
    let sentence = said(|path, _, force| {
        fs::write(path.join("force.csv"), force.replace("f0_z_n", "f0_zn")).unwrap();
    });
    starts(
        &sentence,
        "rec/force.csv, line 1, column f0_zn: this column is not known; did you mean f0_z_n?",
    );
}

#[test]
fn a_clock_that_runs_backwards_is_named_with_its_line() {
    let sentence = said(|path, hall, _| {
        fs::write(path.join("hall.csv"), with_cell(&hall, 50, 0, "1000")).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 50, column t_us: the clock runs backwards, from 47000 to 1000; ",
    );
    advises(&sentence, "sort the rows");
}

#[test]
fn a_gap_in_the_clock_is_noticed_and_its_rows_are_left_out() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = good();
    let without: Vec<&str> = hall
        .lines()
        .enumerate()
        .filter(|(i, _)| !(80..110).contains(i))
        .map(|(_, row)| row)
        .collect();
    write_recording(folder.path(), RECORDING_TOML, &without.join("\n"), &force);
    let recording = Recording::read(folder.path(), AT_ONCE).unwrap();
    let notice = recording.notices[0].to_string();
    advises(
        &notice,
        "hall.csv, line 81, column t_us: 1 gap in the clock",
    );
    advises(&notice, "31.0 ms where rows are 1.0 ms apart");
    // Windows around 80, 90, 100 and 110 ms lean on the gap from 78 to 109 ms.
    assert_eq!(recording.time_s.len(), 15);
    assert!(!recording.time_s.iter().any(|t| (0.075..0.115).contains(t)));
}

#[test]
fn a_duplicated_row_is_named_with_its_line() {
    let sentence = said(|path, hall, _| {
        let mut rows: Vec<&str> = hall.lines().collect();
        rows.insert(30, rows[29]);
        fs::write(path.join("hall.csv"), rows.join("\n")).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 31, column t_us: the row repeats the one before it; remove it",
    );
    let sentence = said(|path, _, force| {
        fs::write(path.join("force.csv"), with_cell(&force, 5, 0, "20000")).unwrap();
    });
    starts(
        &sentence,
        "rec/force.csv, line 5, column t_us: two rows have the same time",
    );
}

#[test]
fn nan_or_text_in_a_number_is_named_with_line_and_column() {
    for (cell, says) in [
        ("NaN", "\"NaN\" is not finite"),
        ("inf", "\"inf\" is not finite"),
        ("12,5", "the row has 5 cells where the header has 4"),
        ("--", "\"--\" is not a number"),
        ("", "the cell is empty"),
        ("20000", "20000 does not fit the sensor's 15 bit word"),
        ("100.5", "100.5 does not fit the sensor's 15 bit word"),
    ] {
        let sentence = said(|path, hall, _| {
            fs::write(path.join("hall.csv"), with_cell(&hall, 20, 2, cell)).unwrap();
        });
        starts(&sentence, "rec/hall.csv, line 20");
        advises(&sentence, says);
        if !says.contains("cells") {
            advises(&sentence, "column s0_y_lsb");
        }
    }
}

#[test]
fn a_force_that_was_not_measured_is_no_fault() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = good();
    write_recording(
        folder.path(),
        RECORDING_TOML,
        &hall,
        &with_cell(&force, 7, 1, ""),
    );
    let recording = Recording::read(folder.path(), AT_ONCE).unwrap();
    let missing = |track: &model_export::recordings::recording::ForceTrack| {
        track.newtons.iter().filter(|n| n.is_nan()).count()
    };
    let counts: Vec<usize> = recording.forces.values().map(missing).collect();
    assert_eq!(counts, [1, 0]);
}

#[test]
fn a_truncated_gzip_is_named() {
    let sentence = said(|path, _, _| {
        pack(path, "hall.csv");
        let packed = path.join("hall.csv.gz");
        let bytes = fs::read(&packed).unwrap();
        fs::write(&packed, &bytes[..bytes.len() / 2]).unwrap();
    });
    starts(&sentence, "rec/hall.csv.gz, line ");
    advises(&sentence, "the gzip stream ends too early or is damaged");
    advises(&sentence, "copy the file again");
}

#[test]
fn a_gzip_that_is_none_is_named() {
    let sentence = said(|path, _, _| {
        fs::rename(path.join("hall.csv"), path.join("hall.csv.gz")).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv.gz: this is not a gzip file; if it is plain text, take the .gz off its name",
    );
}

#[test]
fn a_packed_file_with_a_plain_name_is_no_text() {
    let sentence = said(|path, _, _| {
        pack(path, "hall.csv");
        fs::rename(path.join("hall.csv.gz"), path.join("hall.csv")).unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 1: this is no text; if it is packed, its name must end in .csv.gz",
    );
}

#[test]
fn a_clock_in_seconds_is_told_its_unit() {
    let sentence = said(|path, hall, _| {
        let seconds = |(i, row): (usize, &str)| match row.split_once(',') {
            Some((t, rest)) if i > 0 => format!("{},{rest}\n", t.parse::<f64>().unwrap() * 1e-6),
            _ => format!("{row}\n"),
        };
        fs::write(
            path.join("hall.csv"),
            hall.lines().enumerate().map(seconds).collect::<String>(),
        )
        .unwrap();
    });
    starts(
        &sentence,
        "rec/hall.csv, line 2, column t_us: rows are 0.001 us apart; is t_us really in microseconds?",
    );
}

#[test]
fn clocks_without_overlap_are_told_with_their_spans() {
    let sentence = said(|path, _, force| {
        let shift = |(i, row): (usize, &str)| match row.split_once(',') {
            Some((t, rest)) if i > 0 => {
                format!("{},{rest}\n", t.parse::<u64>().unwrap() + 9_000_000)
            }
            _ => format!("{row}\n"),
        };
        fs::write(
            path.join("force.csv"),
            force.lines().enumerate().map(shift).collect::<String>(),
        )
        .unwrap();
    });
    starts(
        &sentence,
        "rec/force.csv, column t_us: the two clocks do not overlap: the board has 0.000 to 0.199 s, the reference 9.000 to 9.190 s",
    );
}

#[test]
fn a_wrong_key_in_the_description_is_named_with_its_line() {
    for (from, to, says) in [
        (
            "start_s = 0.0",
            "start_s = \"now\"",
            "rec/recording.toml, line 3: cannot be understood",
        ),
        (
            "format = 1",
            "format = 2",
            "column format: 2 is not possible here; this tool reads format = 1",
        ),
        (
            "gauss_per_lsb = 0.125\n",
            "",
            "column gauss_per_lsb: the key is missing",
        ),
        (
            "gap_mm = 1.5",
            "gap_mm = -1.5",
            "column design.gap_mm: -1.5 is not possible here",
        ),
        (
            "\"cylinder\"",
            "\"banana\"",
            "line 7: cannot be understood: unknown variant `banana`",
        ),
    ] {
        let sentence = said(|path, _, _| {
            let text = RECORDING_TOML.replace(from, to);
            fs::write(path.join("recording.toml"), text).unwrap();
        });
        advises(&sentence, says);
    }
}

#[test]
fn a_saturated_sensor_is_noticed_and_its_rows_are_left_out() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = good();
    write_recording(
        folder.path(),
        RECORDING_TOML,
        &with_cell(&hall, 102, 2, "15999"),
        &force,
    );
    let recording = Recording::read(folder.path(), AT_ONCE).unwrap();
    advises(
        &recording.notices[0].to_string(),
        "line 102, column s0_y_lsb: saturated in 1 rows",
    );
    let spoilt = recording.sensors[&0]
        .field_g
        .iter()
        .filter(|field| field[1].is_nan())
        .count();
    assert_eq!(spoilt, 1);
}

#[test]
fn recordings_of_two_grippers_are_not_one_campaign() {
    let folder = TempDir::new().unwrap();
    let (hall, force) = good();
    write_recording(&folder.path().join("1"), RECORDING_TOML, &hall, &force);
    let other = RECORDING_TOML.replace("gap_mm = 1.5", "gap_mm = 1.6");
    write_recording(&folder.path().join("2"), &other, &hall, &force);
    let error = Campaign::read(folder.path(), AT_ONCE, |_| ())
        .unwrap_err()
        .to_string();
    advises(
        &error,
        "recordings of one campaign come from one gripper, but this one has another [design]",
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn garbage_is_refused_or_read_but_never_panics(
        bytes in proptest::collection::vec(any::<u8>(), 0..400),
        file in 0..3_usize,
        packed in any::<bool>(),
    ) {
        let folder = TempDir::new().unwrap();
        let (hall, force) = good();
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
        let name = ["hall.csv", "force.csv", "recording.toml"][file];
        fs::write(folder.path().join(name), &bytes).unwrap();
        if packed && file < 2 {
            pack(folder.path(), name);
        }
        if let Err(problem) = Recording::read(folder.path(), AT_ONCE) {
            prop_assert!(problem.to_string().contains(';'), "no advice in: {problem}");
        }
    }

    #[test]
    fn a_recording_with_a_few_damaged_bytes_is_refused_or_read_but_never_panics(
        damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        file in 0..2_usize,
        packed in any::<bool>(),
    ) {
        let folder = TempDir::new().unwrap();
        let (hall, force) = good();
        write_recording(folder.path(), RECORDING_TOML, &hall, &force);
        let mut name = ["hall.csv", "force.csv"][file].to_owned();
        if packed {
            pack(folder.path(), &name);
            name += ".gz";
        }
        let path = folder.path().join(&name);
        let mut bytes = fs::read(&path).unwrap();
        for (index, byte) in damage {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        fs::write(&path, bytes).unwrap();
        if let Err(problem) = Recording::read(folder.path(), AT_ONCE) {
            prop_assert!(problem.to_string().contains(&name) || problem.to_string().contains("clock"), "no place in: {problem}");
        }
    }
}
