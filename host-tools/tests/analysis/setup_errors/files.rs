//! Setup errors that the files alone reveal: each, injected into a copy of a clean campaign, must be the first
//! finding under its own identifier.

use model_export::recordings::align::Alignment;
use std::f64::consts::TAU;

use analysis::data_quality::evidence::Evidence;
use analysis::data_quality::{Finding, corrected_copy, scan_files};
use report::text::findings::message;
use tests::campaign_copy::{CampaignCopy, CsvTable};
use tests::data;

use super::{ALL, assert_equal_numbers, assert_message, clean, single};

const NO_DELAY: Alignment = Alignment { delay_us: 0.0 };

fn found(spoilt: &CampaignCopy) -> Vec<Finding> {
    scan_files(&spoilt.path(), NO_DELAY, |_| ()).unwrap()
}

/// Findings of a corrected copy.
fn checked(folder: &std::path::Path) -> anyhow::Result<Vec<Finding>> {
    scan_files(folder, NO_DELAY, |_| ())
}

fn only(spoilt: &CampaignCopy) -> Finding {
    single(found(spoilt))
}

fn column(finding: &Finding) -> &str {
    finding.place.column.as_deref().unwrap_or("")
}

/// Corrects the campaign, which must then have no finding; returns a table of the corrected one.
fn corrected(spoilt: &CampaignCopy, recording: u32, name: &str) -> CsvTable {
    let done =
        corrected_copy::write(&spoilt.path(), &found(spoilt), &spoilt.repaired_path(), checked)
            .unwrap();
    assert!(!done.is_empty());
    let left = scan_files(&spoilt.repaired_path(), NO_DELAY, |_| ()).unwrap();
    assert!(left.is_empty(), "{left:#?}");
    let folder = spoilt.repaired_path().join(recording.to_string());
    let description = std::fs::read_to_string(folder.join("recording.toml")).unwrap();
    assert!(description.contains("(corrected: "), "{description}");
    CsvTable::read(&folder.join(format!("{name}.gz")))
}

#[test]
fn clean_campaigns_have_no_finding() {
    for name in ["clean", "demo", "friction", "ripple"] {
        let findings = scan_files(&data(name), NO_DELAY, |_| ()).unwrap();
        assert!(findings.is_empty(), "{name}: {findings:#?}");
    }
}

#[test]
fn swapped_rows_are_found_and_sorted() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| cells.rows.swap(5000, 5001));
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_backwards", true));
    assert_eq!(finding.place.line, Some(5003));
    assert_message(&finding, &["once", "1 of 12001 rows", "sorting"]);
    assert_eq!(corrected(&spoilt, 2, "hall.csv"), clean(2, "hall.csv"));
}

#[test]
fn clock_reset_is_found_and_not_sorted() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        let start = 6_000_000.0;
        cells.change("t_us", |row, t| match row {
            ..6000 => t.to_string(),
            _ => (t - start).to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.fix.is_none()), ("clock_backwards", true));
    assert_message(&finding, &["split the recording"]);
}

#[test]
fn clock_in_another_unit_is_found() {
    // Milliseconds taken for seconds: the rows of the reference, 10 ms apart, become 10 s apart.
    for (factor, says) in [(1e3, "10 s apart"), (1e-3, "10 us apart")] {
        let spoilt = CampaignCopy::new().change(&[1, 2, 3], "force.csv", |cells| {
            cells.change("t_us", |_, t| (t * factor).to_string());
        });
        let found = found(&spoilt);
        let finding = found.iter().find(|finding| finding.id == "clock_unit").unwrap();
        assert!(!finding.stops && finding.place.file.ends_with("1/force.csv.gz"), "{finding:?}");
        assert_message(finding, &["the clock counted", says, "import again"]);
    }
}

#[test]
fn duplicated_block_is_removed() {
    let spoilt = CampaignCopy::new().change(&[3], "force.csv", |cells| {
        let block = cells.rows[400..405].to_vec();
        cells.rows.splice(405..405, block);
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "clock_backwards");
    assert_message(&finding, &["duplicates"]);
    assert_eq!(corrected(&spoilt, 3, "force.csv"), clean(3, "force.csv"));
}

#[test]
fn duplicate_rows_are_found_and_removed() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        for row in [9000, 4000, 700] {
            let copy = cells.rows[row].clone();
            cells.rows.insert(row, copy);
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("duplicate_rows", true));
    assert_eq!(finding.place.line, Some(703));
    assert_message(&finding, &["3 rows", "identical cells"]);
    assert_eq!(corrected(&spoilt, 1, "hall.csv"), clean(1, "hall.csv"));
}

#[test]
fn conflicting_rows_have_no_fix() {
    let spoilt = CampaignCopy::new().change(&[1], "force.csv", |cells| {
        let time = cells.rows[99][0].clone();
        cells.rows[100][0] = time;
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.fix.is_none()), ("duplicate_rows", true));
    assert_message(&finding, &["1 row has", "different cells"]);
}

#[test]
fn clock_gap_is_reported_with_its_length() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| {
        cells.rows.drain(4000..4250);
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_gap", false));
    assert_message(&finding, &["1 gap", "in recording 2", "251 ms", "from 4 s"]);
}

#[test]
fn channel_at_its_range_is_saturated() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        cells.change("s1_y_lsb", |_, counts| (counts + 5550.0).min(15_999.0).to_string());
    });
    let finding = &found(&spoilt)[0];
    assert_eq!((finding.id, column(finding)), ("saturated", "s1_y_lsb"));
    assert_message(finding, &["the end of its range", "in every recording"]);
}

#[test]
fn channel_clipped_below_its_range_is_saturated() {
    let spoilt = CampaignCopy::new().change(&[3], "hall.csv", |cells| {
        cells.change("s2_x_lsb", |_, counts| counts.min(300.0).to_string());
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, column(&finding)), ("saturated", "s2_x_lsb"));
    assert_message(&finding, &["clipped", "in recording 3", "300"]);
}

#[test]
fn constant_channel_is_fatal_only_in_every_recording() {
    let stuck = |recordings: &[u32]| {
        CampaignCopy::new().change(recordings, "hall.csv", |cells| {
            cells.change("s0_x_lsb", |_, _| "17".to_owned());
        })
    };
    let everywhere = only(&stuck(&ALL));
    assert_eq!((everywhere.id, everywhere.stops), ("stuck_channel", true));
    let once = only(&stuck(&[2]));
    assert_eq!((once.id, once.stops), ("stuck_channel", false));
    assert_message(&once, &["s0_x_lsb", "in recording 2", "17"]);
}

#[test]
fn frozen_channel_is_reported_with_its_times() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        cells.change("s3_z_lsb", |row, counts| match row {
            3000..4000 => "123".to_owned(),
            _ => counts.to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("stuck_channel", false));
    assert_message(&finding, &["s3_z_lsb", "from 3 to 4 s", "1000 rows"]);
}

#[test]
fn unpowered_sensor_is_stuck_and_not_saturated() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        for column in ["s3_x_lsb", "s3_y_lsb", "s3_z_lsb"] {
            cells.change(column, |row, counts| match row {
                8000.. => "0".to_owned(),
                _ => counts.to_string(),
            });
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "stuck_channel");
    assert_message(&finding, &["s3_x_lsb, s3_y_lsb and s3_z_lsb", "from 8 to 12 s"]);
}

#[test]
fn lost_bits_and_digits_are_coarse_steps() {
    let counts = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        cells.change("s0_z_lsb", |_, counts| (8.0 * (counts / 8.0).round()).to_string());
    });
    let finding = only(&counts);
    assert_eq!((finding.id, column(&finding)), ("coarse_steps", "s0_z_lsb"));
    assert_message(&finding, &["8 counts"]);
    let newtons = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
        cells.change("f1_x_n", |_, newtons| newtons.round().to_string());
    });
    let finding = only(&newtons);
    assert_eq!((finding.id, column(&finding)), ("coarse_steps", "f1_x_n"));
    // A ramp of 6 K, as of a gripper that warms up, in steps of its sensor and in coarser ones.
    let rounded = |step_k: f64| {
        CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
            let rows = cells.rows.len() as f64;
            cells.change("s2_temp_c", |row, _| {
                let celsius = 25.0 + 6.0 * row as f64 / rows;
                ((celsius / step_k).round() * step_k).to_string()
            });
        })
    };
    let finding = only(&rounded(0.25));
    assert_eq!((finding.id, column(&finding)), ("coarse_steps", "s2_temp_c"));
    let native = found(&rounded(0.125));
    assert!(native.is_empty(), "{native:#?}");
}

#[test]
fn repeated_samples_are_the_only_finding() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        let fields: Vec<usize> = (1..17).collect();
        for row in 0..cells.rows.len() {
            for &cell in &fields {
                cells.rows[row][cell] = cells.rows[row - row % 4][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("repeated_samples", false));
    assert_message(&finding, &["75 %", "about 250 times a second"]);
}

#[test]
fn single_deviating_rows_are_outliers() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| {
        cells.change("s1_x_lsb", |row, counts| match row {
            2500 => (counts + 400.0).to_string(),
            7700 => (counts - 200.0).to_string(),
            _ => counts.to_string(),
        });
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, column(&finding)), ("outlier", "s1_x_lsb"));
    assert_eq!(finding.place.line, Some(2502));
    assert_message(&finding, &["2 values deviate", "in recording 2"]);
}

fn with_line(
    recordings: &[u32],
    name: &str,
    columns: &[&str],
    hz: f64,
    amplitude: f64,
) -> CampaignCopy {
    CampaignCopy::new().change(recordings, name, |cells| {
        let times = cells.numbers("t_us");
        for column in columns {
            let whole = column.ends_with("_lsb");
            cells.change(column, |row, value| {
                let hum = amplitude * (TAU * hz * 1e-6 * times[row]).sin();
                if whole {
                    (value + hum).round().to_string()
                } else {
                    format!("{:.3}", value + hum)
                }
            });
        }
    })
}

#[test]
fn mains_line_lists_amplitude_and_channels() {
    let spoilt = with_line(&ALL, "hall.csv", &["s0_x_lsb", "s2_y_lsb"], 50.0, 4.0);
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("spectral_line", false));
    assert_message(&finding, &["s0_x_lsb and s2_y_lsb", "in every recording", "mains of 50 Hz"]);
    let message = message(&finding);
    assert!(["0.5 G", "0.49", "0.50"].iter().any(|text| message.contains(text)), "{message}");
}

#[test]
fn aliased_mains_in_the_forces_is_identified() {
    let finding = only(&with_line(&[1], "force.csv", &["f0_z_n"], 60.0, 0.3));
    assert_eq!((finding.id, column(&finding)), ("spectral_line", "f0_z_n"));
    assert_message(&finding, &["at 40 Hz", "mains of 60 Hz", "in recording 1"]);
}

#[test]
fn mains_at_the_nyquist_frequency_is_identified() {
    let finding = only(&with_line(&[2], "force.csv", &["f3_x_n"], 49.98, 0.4));
    assert_eq!((finding.id, column(&finding)), ("spectral_line", "f3_x_n"));
    assert_message(&finding, &["mains of 50 Hz", "in recording 2"]);
}

#[test]
fn repeated_samples_of_one_sensor_name_it() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        for row in 0..cells.rows.len() {
            for cell in [5, 6, 7] {
                cells.rows[row][cell] = cells.rows[row - row % 10][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "repeated_samples");
    assert_message(&finding, &["90 %", "of s1 in", "about 99.9 times a second"]);
}

#[test]
fn channels_that_freeze_together_are_one_finding() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        for row in 5000..6000 {
            for cell in 1..17 {
                cells.rows[row][cell] = cells.rows[5000][cell].clone();
            }
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "stuck_channel");
    assert_message(&finding, &["from 5 to 6 s", "7 more"]);
}

#[test]
fn line_of_unknown_source_mentions_aliasing() {
    let finding = only(&with_line(&ALL, "hall.csv", &["s1_z_lsb"], 137.3, 3.0));
    assert_eq!(finding.id, "spectral_line");
    assert_message(&finding, &["137 Hz", "PWM", "synchronise"]);
}

#[test]
fn covariates_in_wrong_units_are_converted() {
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
        let spoilt = CampaignCopy::new().change(&[1, 3], "hall.csv", |cells| {
            for column in &columns {
                cells.change(column, |_, value| format!("{:.decimals$}", spoil(value)));
            }
        });
        let finding = only(&spoilt);
        assert_eq!((finding.id, column(&finding)), ("wrong_unit", name));
        assert_message(&finding, &[unit, "in recordings 1 and 3"]);
        let (corrected, clean) = (corrected(&spoilt, 3, "hall.csv"), clean(3, "hall.csv"));
        assert_equal_numbers(&corrected, &clean, name, within);
    }
}

#[test]
fn constant_covariate_lists_untestable_effects() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        cells.change("opening_mm", |_, _| "5.0".to_owned());
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("constant_covariate", false));
    assert_eq!(column(&finding), "opening_mm");
    assert_message(&finding, &["neighbour_magnet", "screw_backlash"]);
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        cells.change("opening_mm", |_, _| "5.0".to_owned());
    });
    assert!(found(&spoilt).is_empty());
}

#[test]
fn fix_never_overwrites_a_campaign() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| cells.rows.swap(5000, 5001));
    let findings = found(&spoilt);
    let refused = corrected_copy::write(&spoilt.path(), &findings, &spoilt.recording(1), checked)
        .unwrap_err();
    assert!(refused.to_string().contains("not overwritten"), "{refused}");
    let nothing =
        corrected_copy::write(&spoilt.path(), &[], &spoilt.repaired_path(), checked).unwrap_err();
    assert!(nothing.to_string().contains("nothing is written"), "{nothing}");
    assert!(!spoilt.repaired_path().exists());
}

#[test]
fn single_channel_in_another_unit_is_converted() {
    for (factor, column) in [(1000.0, "s1_z_lsb"), (0.01, "s3_y_lsb"), (100.0, "s0_x_lsb")] {
        let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
            cells.change(column, |_, value| format!("{:.3}", value * factor));
            let i = cells.index(column);
            cells.header[i] = column.replace("_lsb", "_gauss");
        });
        // Counts in a column of gauss differ by the scale as well.
        for recording in ALL {
            let path = spoilt.recording(recording).join("recording.toml");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(
                path,
                text.replace("range_gauss = 2000.0\n", "")
                    .replace("gauss_per_lsb = 0.125", "gauss_per_lsb = 1.0"),
            )
            .unwrap();
        }
        let finding = only(&spoilt);
        assert_eq!((finding.id, finding.stops), ("wrong_unit", true), "{column}");
        assert_message(
            &finding,
            &[
                &column.replace("_lsb", "_gauss"),
                &format!("by a factor of {factor}"),
                "every recording",
            ],
        );
        let corrected = corrected(&spoilt, 2, "hall.csv");
        let expected = clean(2, "hall.csv").numbers(column);
        let found = corrected.numbers(&column.replace("_lsb", "_gauss"));
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 0.06), "{column}");
    }
}

#[test]
fn copy_that_still_has_the_error_is_not_written() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| cells.rows.swap(5000, 5001));
    let findings = found(&spoilt);
    let left = corrected_copy::write(&spoilt.path(), &findings, &spoilt.repaired_path(), |_| {
        Ok(findings.clone())
    });
    let left = left.unwrap_err().to_string();
    assert!(
        left.contains("would still have clock_backwards") && left.contains("nothing is written"),
        "{left}"
    );
    assert!(!spoilt.repaired_path().exists());
}

#[test]
fn sensor_without_temperature_is_named() {
    let spoilt = CampaignCopy::new().change(&[2, 3], "hall.csv", |cells| {
        let i = cells.index("s2_temp_c");
        cells.header.remove(i);
        cells.rows.iter_mut().for_each(|row| {
            row.remove(i);
        });
    });
    let finding = only(&spoilt);
    assert_eq!(
        (finding.id, finding.stops, column(&finding)),
        ("missing_temperature", false, "s2_temp_c")
    );
    assert_message(&finding, &["s2_temp_c is missing in recordings 2 and 3", "at sensor 2"]);
}

#[test]
fn clock_offset_of_each_recording_is_found_and_applied() {
    let offsets_us = [-200_000.0, 300_000.0, -500_000.0];
    let mut spoilt = CampaignCopy::new();
    for (recording, offset_us) in (1..).zip(offsets_us) {
        spoilt = spoilt.change(&[recording], "force.csv", |cells| {
            cells.change("t_us", |_, t| (t - offset_us).to_string());
        });
    }
    let finding = only(&spoilt);
    let Evidence::ClockOffsets { offsets, delay_ms, .. } = &finding.evidence else {
        panic!("{finding:?}")
    };
    // No effect explains so much: nothing else is evaluated before.
    assert_eq!((finding.id, finding.stops, *delay_ms), ("clock_offset", true, None));
    for (offset, expected_us) in offsets.iter().zip(offsets_us) {
        assert!((offset.offset_ms - 1e-3 * expected_us).abs() < 1.0, "{offset:?}");
        assert!(offset.offset_error_ms < 0.5 && offset.rate_ppm == 0.0, "{offset:?}");
    }
    assert_message(&finding, &["ms in recording 2", "--fix NEW applies them"]);
    let times = corrected(&spoilt, 2, "force.csv").numbers("t_us");
    let expected = clean(2, "force.csv").numbers("t_us");
    assert!(times.iter().zip(&expected).all(|(own, of)| (own - of).abs() < 1000.0));
}

#[test]
fn clock_that_runs_fast_is_found_in_ppm_and_corrected() {
    let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
        cells.change("t_us", |_, t| (t * 1.002).to_string());
    });
    let finding = only(&spoilt);
    let Evidence::ClockOffsets { offsets, delay_ms: None, .. } = &finding.evidence else {
        panic!("{finding:?}")
    };
    // A clock of 1.002 is corrected by 1/1.002 - 1.
    for offset in offsets {
        let (rate, error) = (offset.rate_ppm, offset.rate_error_ppm);
        assert!((rate + 1996.0).abs() < 100.0 && error < 100.0, "{offset:?}");
    }
    assert_message(&finding, &["ppm"]);
    let times = corrected(&spoilt, 1, "force.csv").numbers("t_us");
    let expected = clean(1, "force.csv").numbers("t_us");
    assert!(times.iter().zip(&expected).all(|(own, of)| (own - of).abs() < 1500.0));
}

#[test]
fn counts_that_wrapped_are_found_and_restored() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| {
        cells.change("s1_x_lsb", |_, counts| {
            let wrapped = if counts < -200.0 { counts + 65_536.0 } else { counts };
            wrapped.to_string()
        });
    });
    let finding = &found(&spoilt)[0];
    assert_eq!((finding.id, finding.stops, column(finding)), ("wrapped", true, "s1_x_lsb"));
    assert_message(finding, &["wrapped by 65536 counts", "no saturation", "in recording 2"]);
    let restored = corrected(&spoilt, 2, "hall.csv").numbers("s1_x_lsb");
    assert_eq!(restored, clean(2, "hall.csv").numbers("s1_x_lsb"));
}

/// Spikes of about a power of two of counts: the values next to them are where they were.
#[test]
fn spikes_do_not_wrap() {
    let spoilt = CampaignCopy::new().change(&[2], "hall.csv", |cells| {
        let heights = [2073.0, 1990.0, 2048.0, 2010.0];
        cells.change("s1_y_lsb", |row, counts| {
            let spike = if row % 997 == 500 { heights[row / 997 % 4] } else { 0.0 };
            (counts - spike).to_string()
        });
    });
    let ids: Vec<&str> = found(&spoilt).iter().map(|finding| finding.id).collect();
    assert!(!ids.contains(&"wrapped") && ids.contains(&"outlier"), "{ids:?}");
}

#[test]
fn clipped_reference_stops_and_a_scale_at_rest_does_not() {
    for (limit, stops) in [(20.0, true), (0.0, false)] {
        let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
            cells.change("f0_x_n", |_, newtons| newtons.min(limit).to_string());
        });
        let finding = found(&spoilt).into_iter().find(|finding| finding.id == "saturated").unwrap();
        assert_eq!((finding.stops, column(&finding)), (stops, "f0_x_n"));
    }
}
