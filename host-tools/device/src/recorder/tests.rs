use firmware::compensation::covariates::{AttitudeSample, Covariates};
use firmware::sensors::hall::HallReading;
use model_export::recordings::Recording;
use model_export::recordings::align::Alignment;
use model_export::recordings::stream::{RawRow, RawStream};
use std::fs;

use tempfile::TempDir;

use super::*;

fn description() -> RecordingDescription {
    let mut description = RecordingDescription::new("test", 0.0);
    description.gauss_per_lsb = Some(0.125);
    description
}

fn recorder(folder: &Path) -> Recorder {
    Recorder::new(&folder.join("1"), description(), 1000, None).unwrap()
}

/// Row at a time in ms with answers from these sensors.
fn row(ms: u64, sensors: &[usize]) -> SensorRow {
    let reading = |sensor: usize| HallReading {
        field: [ms as i16, -(sensor as i16), 16383],
        temperature: -3,
    };
    let mut readings = [None; SENSORS];
    for &sensor in sensors {
        readings[sensor] = Some(reading(sensor));
    }
    let opening_um = Some(40_000 + ms as i32);
    let covariates = Covariates { opening_um, ..Covariates::default() };
    SensorRow { time_us: 1_000_000 + 1000 * ms, readings, force_n: [None; SENSORS], covariates }
}

fn read(folder: &Path) -> Vec<RawRow> {
    let folder = folder.join("1");
    let (description, notices) = RecordingDescription::read(&folder).unwrap();
    assert!(notices.is_empty());
    let mut stream = RawStream::open(&folder, &description, Alignment { delay_us: 0.0 }).unwrap();
    let mut rows = Vec::new();
    while let Some(row) = stream.next_row().unwrap() {
        rows.push(row);
    }
    rows
}

#[test]
fn recording_is_valid_at_every_time_up_to_the_last_second() {
    let folder = TempDir::new().unwrap();
    let mut recorder = recorder(folder.path());
    for ms in 0..2500 {
        recorder.take(row(ms, &[0, 1, 2, 3])).unwrap();
        if ms < LOOK_US / 1000 {
            assert!(!folder.path().join("1").exists());
        } else if ms % 37 == 0 {
            let rows = read(folder.path());
            let last_s = rows[rows.len() - 1].time_s;
            assert!(ms as f64 * 1e-3 - last_s < 1.0, "{last_s} s at {ms} ms");
            assert!(
                rows.iter().zip(0..).all(|(row, i)| (1e3 * row.time_s).round() == f64::from(i))
            );
            Recording::read(&folder.path().join("1"), Alignment { delay_us: 0.0 }).unwrap();
        }
    }
    let tally = recorder.finish().unwrap();
    assert_eq!((tally.rows, tally.lost, tally.left_out), (2500, 0, 0));
    assert_eq!(read(folder.path()).len(), 2500);
}

#[test]
fn counts_and_degrees_are_recorded_and_forces_are_empty() {
    let folder = TempDir::new().unwrap();
    let mut recorder = recorder(folder.path());
    for ms in 0..300 {
        recorder.take(row(ms, &[1, 3])).unwrap();
    }
    let tally = recorder.finish().unwrap();
    assert_eq!(tally.sensors, [1, 3]);
    let rows = read(folder.path());
    // 25 degrees less three eighths.
    let expected = [0.125 * 299.0, -0.375, 0.125 * 16383.0, 24.625, 40.299];
    assert_eq!(rows[299].hall[4..], expected);
    assert!(rows.iter().flat_map(|row| &row.forces).all(|force| force.is_nan()));
    let recording = Recording::read(&folder.path().join("1"), Alignment { delay_us: 0.0 });
    assert!(recording.unwrap().forces.is_empty());
}

#[test]
fn lost_rows_are_gaps_and_incomplete_rows_are_counted() {
    let folder = TempDir::new().unwrap();
    let mut recorder = recorder(folder.path());
    for ms in (0..1000).filter(|ms| !(500..510).contains(ms) && *ms != 700) {
        let sensors: &[usize] = if ms == 600 { &[0] } else { &[0, 2] };
        recorder.take(row(ms, sensors)).unwrap();
    }
    let tally = recorder.finish().unwrap();
    assert_eq!((tally.rows, tally.lost, tally.gaps, tally.left_out), (988, 11, 2, 1));
    assert_eq!(tally.longest_us, (11_000, 499_000));
    assert_eq!(tally.silent, [0, 0, 1, 0]);
    assert_eq!(tally.span_us, 999_000);
    let times = read(folder.path()).iter().map(|row| row.time_s).collect::<Vec<_>>();
    let steps = times.windows(2).map(|pair| ((pair[1] - pair[0]) * 1e3).round());
    assert_eq!(steps.filter(|step| *step != 1.0).collect::<Vec<_>>(), [11.0, 2.0, 2.0]);
}

#[test]
fn header_of_the_reference_is_written_before_its_first_row() {
    let folder = TempDir::new().unwrap();
    let target = folder.path().join("1");
    let columns = vec!["f0_x_n".to_owned()];
    let mut recorder = Recorder::new(&target, description(), 1000, Some(columns)).unwrap();
    let table = || fs::read_to_string(target.join("force.csv")).unwrap();
    for ms in 0..=LOOK_US / 1000 {
        recorder.take(row(ms, &[0])).unwrap();
    }
    assert_eq!(table(), "t_us,f0_x_n\n");
    // One row in two seconds is not kept back until the next.
    recorder.take_reference(1e6 + 150_000.0, &[0.5]).unwrap();
    recorder.flush().unwrap();
    assert_eq!(table(), "t_us,f0_x_n\n150000,0.5000\n");
}

#[test]
fn existing_folders_and_silent_sensors_are_errors() {
    let folder = TempDir::new().unwrap();
    let taken = folder.path().join("taken");
    fs::create_dir(&taken).unwrap();
    assert!(Recorder::new(&taken, description(), 1000, None).is_ok());
    fs::write(taken.join("note"), "mine").unwrap();
    let Err(error) = Recorder::new(&taken, description(), 1000, None) else {
        panic!("it was overwritten");
    };
    assert!(error.to_string().contains("not overwritten"));
    let mut recorder = recorder(folder.path());
    for ms in 0..10 {
        recorder.take(row(ms, &[])).unwrap();
    }
    assert!(recorder.finish().unwrap_err().to_string().contains("no sensor gave a reading"));
    assert!(!folder.path().join("1").exists());
}

#[test]
fn late_covariate_omits_its_rows_and_not_its_column() {
    let folder = TempDir::new().unwrap();
    let mut recorder = recorder(folder.path());
    for ms in 0..1000 {
        let mut row = row(ms, &[0, 1, 2, 3]);
        if (10..20).contains(&ms) {
            row.covariates.opening_um = None;
        }
        recorder.take(row).unwrap();
    }
    let tally = recorder.finish().unwrap();
    assert_eq!((tally.covariates, tally.without_covariates), (vec!["opening_mm"], 10));
    assert_eq!((tally.rows, tally.left_out), (990, 10));
}

#[test]
fn pose_of_the_host_is_recorded_though_it_came_late() {
    let attitude = AttitudeSample { age_ms: 0, euler: [0; 3] };
    // Of the first 201 rows, a busy machine gave the pose to 50.
    for (has_pose, columns, rows) in
        [(true, vec!["roll_rad", "pitch_rad", "yaw_rad"], 849), (false, vec![], 1000)]
    {
        let folder = TempDir::new().unwrap();
        let mut recorder = recorder(folder.path()).with_pose(has_pose);
        for ms in 0..1000 {
            let mut row = row(ms, &[0, 1, 2, 3]);
            let is_late = (50..201).contains(&ms);
            row.covariates =
                Covariates { attitude: (!is_late).then_some(attitude), ..Covariates::default() };
            recorder.take(row).unwrap();
        }
        let tally = recorder.finish().unwrap();
        assert_eq!((tally.covariates, tally.rows), (columns, rows));
    }
}

#[test]
fn covariates_are_recorded_while_the_board_has_them() {
    let folder = TempDir::new().unwrap();
    let mut recorder = recorder(folder.path());
    for ms in 0..1000 {
        let mut row = row(ms, &[0, 1, 2, 3]);
        if ms >= 900 {
            row.covariates.opening_um = None;
        }
        recorder.take(row).unwrap();
    }
    let tally = recorder.finish().unwrap();
    assert_eq!((tally.covariates, tally.without_covariates), (vec!["opening_mm"], 100));
    assert_eq!((tally.rows, tally.left_out), (900, 100));
    let rows = read(folder.path());
    // Four sensors of four columns, then the opening.
    assert_eq!(rows[123].hall.len(), 17);
    assert!((rows[123].hall[16] - 40.123).abs() < 1e-9);
}

#[test]
fn reference_rows_follow_the_board_clock() {
    let folder = TempDir::new().unwrap();
    let columns = vec!["f0_x_n".to_owned()];
    let target = folder.path().join("1");
    let mut recorder = Recorder::new(&target, description(), 1000, Some(columns)).unwrap();
    for ms in 0..1000 {
        recorder.take(row(ms, &[0])).unwrap();
        if ms % 10 == 0 {
            // The first row of the board is at 1 s. One before it, and a repeated one, are left out.
            let board_us = 1e6 + 1e3 * ms as f64 - 300_000.0;
            recorder.take_reference(board_us, &[0.5 * ms as f64]).unwrap();
            recorder.take_reference(board_us, &[7.0]).unwrap();
        }
    }
    let tally = recorder.finish().unwrap();
    assert_eq!(tally.reference_rows, 70);
    let table = std::fs::read_to_string(target.join("force.csv")).unwrap();
    let mut lines = table.lines().map(str::trim_end);
    assert_eq!(lines.next(), Some("t_us,f0_x_n"));
    assert_eq!(lines.next(), Some("0,150.0000"));
    assert_eq!(lines.next_back(), Some("690000,495.0000"));
}
