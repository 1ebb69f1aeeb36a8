//! Mistakes of the rig that the files alone show: each spoilt into a copy of a clean campaign must be
//! told first, and by its own name.

use std::f64::consts::TAU;

use host_tools::compare::Finding;
use host_tools::findings::{files, fix};
use tests::data;
use tests::spoilt::{Cells, Spoilt};

const ALL: [u32; 3] = [1, 2, 3];

fn found(spoilt: &Spoilt) -> Vec<Finding> {
    files::scan(&spoilt.path(), |_| ()).unwrap()
}

/// The only finding.
fn only(spoilt: &Spoilt) -> Finding {
    let mut findings = found(spoilt);
    let kinds: Vec<_> = findings.iter().map(|f| (f.id, f.message.clone())).collect();
    assert_eq!(findings.len(), 1, "{kinds:#?}");
    findings.remove(0)
}

fn says(finding: &Finding, words: &[&str]) {
    for word in words {
        assert!(
            finding.message.contains(word),
            "{:?} should say {word:?}",
            finding.message
        );
    }
}

fn column(finding: &Finding) -> &str {
    finding.place.column.as_deref().unwrap_or("")
}

/// Mends the campaign: it must then have no finding. What stands in a table of the mended one.
fn mended(spoilt: &Spoilt, recording: u32, name: &str) -> Cells {
    let done = fix::write(&spoilt.path(), &found(spoilt), &spoilt.beside()).unwrap();
    assert!(!done.is_empty());
    let left = files::scan(&spoilt.beside(), |_| ()).unwrap();
    assert!(left.is_empty(), "{left:#?}");
    let folder = spoilt.beside().join(recording.to_string());
    let description = std::fs::read_to_string(folder.join("recording.toml")).unwrap();
    assert!(description.contains("(mended: "), "{description}");
    Cells::read(&folder.join(format!("{name}.gz")))
}

fn clean(recording: u32, name: &str) -> Cells {
    let folder = data("clean").join(recording.to_string());
    Cells::read(&folder.join(format!("{name}.gz")))
}

/// The mended table holds the same numbers as the clean one.
fn same_numbers(mended: &Cells, clean: &Cells, column: &str, within: f64) {
    let pairs = mended
        .numbers(column)
        .into_iter()
        .zip(clean.numbers(column));
    assert_eq!(mended.rows.len(), clean.rows.len());
    for (a, b) in pairs {
        assert!((a - b).abs() <= within, "{column}: {a} and {b}");
    }
}

#[test]
fn campaigns_without_a_mistake_have_no_finding() {
    for name in ["clean", "demo", "friction", "ripple"] {
        let findings = files::scan(&data(name), |_| ()).unwrap();
        assert!(findings.is_empty(), "{name}: {findings:#?}");
    }
}

#[test]
fn a_few_rows_out_of_place_are_told_and_put_in_order() {
    let spoilt = Spoilt::new().change(&[2], "hall.csv", |cells| cells.rows.swap(5000, 5001));
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_backwards", true));
    assert_eq!(finding.place.line, Some(5003));
    says(&finding, &["once", "1 of 12001 rows", "sorting"]);
    assert_eq!(mended(&spoilt, 2, "hall.csv"), clean(2, "hall.csv"));
}

#[test]
fn a_clock_that_starts_again_is_told_and_not_sorted() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        let start = 6_000_000.0;
        cells.change("t_us", |row, t| match row {
            ..6000 => t.to_string(),
            _ => (t - start).to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!(
        (finding.id, finding.fix.is_none()),
        ("clock_backwards", true)
    );
    says(&finding, &["split the recording"]);
}

#[test]
fn a_block_that_was_written_twice_is_left_out() {
    let spoilt = Spoilt::new().change(&[3], "force.csv", |cells| {
        let block = cells.rows[400..405].to_vec();
        cells.rows.splice(405..405, block);
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "clock_backwards");
    says(&finding, &["written twice"]);
    assert_eq!(mended(&spoilt, 3, "force.csv"), clean(3, "force.csv"));
}

#[test]
fn rows_written_twice_are_told_and_left_out() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        for row in [9000, 4000, 700] {
            let copy = cells.rows[row].clone();
            cells.rows.insert(row, copy);
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("duplicate_rows", true));
    assert_eq!(finding.place.line, Some(703));
    says(&finding, &["3 rows", "very same cells"]);
    assert_eq!(mended(&spoilt, 1, "hall.csv"), clean(1, "hall.csv"));
}

#[test]
fn rows_of_one_time_that_differ_are_left_to_the_bench() {
    let spoilt = Spoilt::new().change(&[1], "force.csv", |cells| {
        let time = cells.rows[99][0].clone();
        cells.rows[100][0] = time;
    });
    let finding = only(&spoilt);
    assert_eq!(
        (finding.id, finding.fix.is_none()),
        ("duplicate_rows", true)
    );
    says(&finding, &["1 row has", "other cells"]);
}

#[test]
fn a_gap_in_the_clock_is_told_with_its_length() {
    let spoilt = Spoilt::new().change(&[2], "hall.csv", |cells| {
        cells.rows.drain(4000..4250);
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_gap", false));
    says(&finding, &["1 gap", "in recording 2", "251 ms", "from 4 s"]);
}

#[test]
fn a_channel_at_the_end_of_its_range_is_saturated() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        cells.change("s1_y_lsb", |_, counts| {
            (counts + 5550.0).min(15_999.0).to_string()
        });
    });
    let finding = &found(&spoilt)[0];
    assert_eq!((finding.id, column(finding)), ("saturated", "s1_y_lsb"));
    says(finding, &["the end of its range", "in every recording"]);
}

#[test]
fn a_channel_cut_off_below_its_range_is_told_from_its_pile_of_equal_values() {
    let spoilt = Spoilt::new().change(&[3], "hall.csv", |cells| {
        cells.change("s2_x_lsb", |_, counts| counts.min(300.0).to_string());
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, column(&finding)), ("saturated", "s2_x_lsb"));
    says(&finding, &["cut off", "in recording 3", "300"]);
}

#[test]
fn a_channel_that_never_changes_stops_everything_only_if_it_never_does() {
    let stuck = |recordings: &[u32]| {
        Spoilt::new().change(recordings, "hall.csv", |cells| {
            cells.change("s0_x_lsb", |_, _| "17".to_owned());
        })
    };
    let everywhere = only(&stuck(&ALL));
    assert_eq!((everywhere.id, everywhere.stops), ("stuck_channel", true));
    let once = only(&stuck(&[2]));
    assert_eq!((once.id, once.stops), ("stuck_channel", false));
    says(&once, &["s0_x_lsb", "in recording 2", "17"]);
}

#[test]
fn a_channel_that_freezes_for_a_second_is_told_with_its_times() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        cells.change("s3_z_lsb", |row, counts| match row {
            3000..4000 => "123".to_owned(),
            _ => counts.to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("stuck_channel", false));
    says(&finding, &["s3_z_lsb", "from 3 to 4 s", "1000 rows"]);
}

#[test]
fn a_sensor_that_lost_its_supply_is_stuck_and_not_saturated() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        for column in ["s3_x_lsb", "s3_y_lsb", "s3_z_lsb"] {
            cells.change(column, |row, counts| match row {
                8000.. => "0".to_owned(),
                _ => counts.to_string(),
            });
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "stuck_channel");
    says(
        &finding,
        &["s3_x_lsb, s3_y_lsb and s3_z_lsb", "from 8 to 12 s"],
    );
}

#[test]
fn lost_bits_and_lost_digits_are_coarse_steps() {
    let counts = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        cells.change("s0_z_lsb", |_, counts| {
            (8.0 * (counts / 8.0).round()).to_string()
        });
    });
    let finding = only(&counts);
    assert_eq!((finding.id, column(&finding)), ("coarse_steps", "s0_z_lsb"));
    says(&finding, &["8 counts"]);
    let newtons = Spoilt::new().change(&ALL, "force.csv", |cells| {
        cells.change("f1_x_n", |_, newtons| newtons.round().to_string());
    });
    let finding = only(&newtons);
    assert_eq!((finding.id, column(&finding)), ("coarse_steps", "f1_x_n"));
}

#[test]
fn samples_that_are_held_are_repeated_and_nothing_else() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        let fields: Vec<usize> = (1..17).collect();
        for row in 0..cells.rows.len() {
            for &cell in &fields {
                cells.rows[row][cell] = cells.rows[row - row % 4][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("repeated_samples", false));
    says(&finding, &["75 %", "about 250 times a second"]);
}

#[test]
fn single_rows_far_away_are_outliers() {
    let spoilt = Spoilt::new().change(&[2], "hall.csv", |cells| {
        cells.change("s1_x_lsb", |row, counts| match row {
            2500 => (counts + 400.0).to_string(),
            7700 => (counts - 200.0).to_string(),
            _ => counts.to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, column(&finding)), ("outlier", "s1_x_lsb"));
    assert_eq!(finding.place.line, Some(2502));
    says(&finding, &["2 values stand", "in recording 2"]);
}

fn with_line(recordings: &[u32], name: &str, columns: &[&str], hz: f64, amplitude: f64) -> Spoilt {
    Spoilt::new().change(recordings, name, |cells| {
        let times = cells.numbers("t_us");
        for column in columns {
            let whole = column.ends_with("_lsb");
            cells.change(column, |row, value| {
                let hum = amplitude * (TAU * hz * 1e-6 * times[row]).sin();
                match whole {
                    true => (value + hum).round().to_string(),
                    false => format!("{:.3}", value + hum),
                }
            });
        }
    })
}

#[test]
fn mains_is_named_with_its_amplitude_and_every_channel() {
    let spoilt = with_line(&ALL, "hall.csv", &["s0_x_lsb", "s2_y_lsb"], 50.0, 4.0);
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("spectral_line", false));
    says(
        &finding,
        &[
            "s0_x_lsb and s2_y_lsb",
            "in every recording",
            "mains of 50 Hz",
        ],
    );
    assert!(
        finding.message.contains("0.5 G")
            || finding.message.contains("0.49")
            || finding.message.contains("0.50"),
        "{}",
        finding.message
    );
}

#[test]
fn mains_folded_into_the_forces_is_named() {
    let finding = only(&with_line(&[1], "force.csv", &["f0_z_n"], 60.0, 0.3));
    assert_eq!((finding.id, column(&finding)), ("spectral_line", "f0_z_n"));
    says(&finding, &["at 40 Hz", "mains of 60 Hz", "in recording 1"]);
}

#[test]
fn mains_at_half_the_row_rate_is_named() {
    let finding = only(&with_line(&[2], "force.csv", &["f3_x_n"], 49.98, 0.4));
    assert_eq!((finding.id, column(&finding)), ("spectral_line", "f3_x_n"));
    says(&finding, &["mains of 50 Hz", "in recording 2"]);
}

#[test]
fn a_single_sensor_that_is_held_is_named() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        for row in 0..cells.rows.len() {
            for cell in [5, 6, 7] {
                cells.rows[row][cell] = cells.rows[row - row % 10][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "repeated_samples");
    says(&finding, &["90 %", "of s1 in", "about 99.9 times a second"]);
}

#[test]
fn all_channels_that_freeze_together_are_one_finding() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        for row in 5000..6000 {
            for cell in 1..17 {
                cells.rows[row][cell] = cells.rows[5000][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "stuck_channel");
    says(&finding, &["from 5 to 6 s", "7 more"]);
}

#[test]
fn a_line_of_no_known_source_names_what_folds() {
    let finding = only(&with_line(&ALL, "hall.csv", &["s1_z_lsb"], 137.3, 3.0));
    assert_eq!(finding.id, "spectral_line");
    says(&finding, &["137 Hz", "PWM", "synchronise"]);
}

#[test]
fn covariates_in_other_units_are_told_and_converted() {
    type Spoil = fn(f64) -> f64;
    let kinds: [(&str, &str, Spoil, usize, f64); 5] = [
        ("roll_rad", "degrees", f64::to_degrees, 5, 1e-6),
        ("accel_x_mps2", "in g", |a| a / 9.806_65, 6, 1e-5),
        ("s0_temp_c", "kelvin", |t| t + 273.15, 2, 1e-9),
        ("opening_mm", "in m,", |mm| mm * 1e-3, 7, 1e-9),
        ("motor_iq_a", "in mA", |a| a * 1e3, 1, 1e-9),
    ];
    for (name, unit, spoil, decimals, within) in kinds {
        let columns: Vec<&str> = match name {
            "accel_x_mps2" => vec![name, "accel_y_mps2", "accel_z_mps2"],
            _ => vec![name],
        };
        let spoilt = Spoilt::new().change(&[1, 3], "hall.csv", |cells| {
            for column in &columns {
                cells.change(column, |_, value| format!("{:.decimals$}", spoil(value)));
            }
        });
        let finding = only(&spoilt);
        assert_eq!((finding.id, column(&finding)), ("wrong_unit", name));
        says(&finding, &[unit, "in recordings 1 and 3"]);
        let (mended, clean) = (mended(&spoilt, 3, "hall.csv"), clean(3, "hall.csv"));
        same_numbers(&mended, &clean, name, within);
    }
}

#[test]
fn a_covariate_that_never_moved_names_what_cannot_be_judged() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        cells.change("opening_mm", |_, _| "5.0".to_owned());
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("constant_covariate", false));
    assert_eq!(column(&finding), "opening_mm");
    says(&finding, &["neighbour_magnet", "screw_backlash"]);
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        cells.change("opening_mm", |_, _| "5.0".to_owned());
    });
    assert!(found(&spoilt).is_empty());
}

#[test]
fn a_campaign_is_never_written_over_another() {
    let spoilt = Spoilt::new().change(&[2], "hall.csv", |cells| cells.rows.swap(5000, 5001));
    let findings = found(&spoilt);
    let refused = fix::write(&spoilt.path(), &findings, &spoilt.recording(1)).unwrap_err();
    assert!(refused.to_string().contains("not overwritten"), "{refused}");
    let nothing = fix::write(&spoilt.path(), &[], &spoilt.beside()).unwrap_err();
    assert!(nothing.to_string().contains("nothing"), "{nothing}");
    assert!(!spoilt.beside().exists());
}
