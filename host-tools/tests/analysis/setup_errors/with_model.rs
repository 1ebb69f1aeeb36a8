//! Setup errors that need a model: permuted columns, wrong units, clock offsets. The model is fitted to the clean
//! campaign.

use std::path::Path;

use analysis::data_quality::model_checks::SensorPrediction;
use analysis::data_quality::{Finding, check_against_model, corrected_copy, merge, scan_files};
use model_export::effects::{ExcitationSeries, StateSeries};
use model_export::fit::rows::SensorRows;
use model_export::model_file::ModelFile;
use model_export::physics::ForwardModel;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use nalgebra::Vector3;
use tests::campaign_copy::{CampaignCopy, CsvTable};
use tests::data;

use super::{ALL, assert_equal_numbers, assert_message, clean, single};
use crate::workdir::fitted_model;

const NO_DELAY: Alignment = Alignment { delay_us: 0.0 };
const SENSORS: [u32; 4] = [0, 1, 2, 3];

/// Base model fitted to a campaign.
fn fitted(name: &str) -> ModelFile {
    ModelFile::read(&fitted_model(name)).unwrap()
}

fn field(model: &ForwardModel, track: &ExcitationSeries) -> Vec<Vector3<f64>> {
    let frames = model.frames();
    let series = StateSeries::of(track, model.stiffness_n_per_mm, &[]);
    let states = series.states.iter();
    states.map(|state| model.field_at(&frames, state)).collect()
}

fn findings_with_own_model(folder: &Path, alignment: Alignment) -> Vec<Finding> {
    findings_with(&fitted("clean"), folder, alignment)
}

fn findings_with(model: &ModelFile, folder: &Path, alignment: Alignment) -> Vec<Finding> {
    let campaign = Campaign::read(folder, alignment, |_| ()).unwrap();
    let sensors: Vec<(SensorRows, ForwardModel)> = campaign
        .sensors()
        .into_iter()
        .map(|sensor| {
            let rows = SensorRows::with_recorded_forces(&campaign, sensor).unwrap();
            (rows, model.forward(sensor).unwrap())
        })
        .collect();
    let predict: Vec<_> = sensors
        .iter()
        .map(|(_, model)| move |track: &ExcitationSeries| field(model, track))
        .collect();
    let pairs = sensors.iter().zip(&predict);
    let predictions: Vec<SensorPrediction> =
        pairs.map(|((rows, _), predict)| SensorPrediction { rows, predict }).collect();
    check_against_model(&campaign, alignment, &predictions)
}

/// The only finding of the files and the model checks.
fn only(spoilt: &CampaignCopy) -> Finding {
    let files = scan_files(&spoilt.path(), NO_DELAY, |_| ()).unwrap();
    single(merge(files, findings_with_own_model(&spoilt.path(), NO_DELAY)))
}

/// The corrected copy is checked by the caller.
fn unchecked(_: &Path) -> anyhow::Result<Vec<Finding>> {
    Ok(Vec::new())
}

/// After the correction there is no finding, and the table of the first recording equals the clean one.
fn corrects_to_clean(spoilt: &CampaignCopy, finding: Finding, name: &str) {
    corrected_copy::write(&spoilt.path(), &[finding], &spoilt.repaired_path(), unchecked).unwrap();
    let left = findings_with_own_model(&spoilt.repaired_path(), NO_DELAY);
    assert!(left.is_empty(), "{left:#?}");
    let table = spoilt.repaired_path().join("1").join(format!("{name}.gz"));
    let corrected = CsvTable::read(&table);
    let clean = clean(1, name);
    for column in &clean.header {
        assert_equal_numbers(&corrected, &clean, column, 1e-9);
    }
}

fn negated(cells: &mut CsvTable, column: &str) {
    cells.change(column, |_, value| (-value).to_string());
}

#[test]
fn clean_campaign_has_no_finding() {
    let findings = findings_with_own_model(&data("clean"), NO_DELAY);
    assert!(findings.is_empty(), "{findings:#?}");
}

#[test]
fn missing_effect_is_not_a_setup_error() {
    for name in ["demo", "friction"] {
        let findings = findings_with(&fitted(name), &data(name), NO_DELAY);
        assert!(findings.is_empty(), "{name}: {findings:#?}");
    }
}

#[test]
fn flipped_axis_is_corrected() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| negated(cells, "s2_y_lsb"));
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("axis_flipped", true));
    assert_eq!(finding.place.column.as_deref(), Some("s2_y_lsb"));
    assert_message(&finding, &["s2_y_lsb has the other sign", "throughout"]);
    corrects_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn permuted_axes_of_all_sensors_are_one_finding() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        for sensor in SENSORS {
            cells.exchange(&format!("s{sensor}_x_lsb"), &format!("s{sensor}_y_lsb"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("axis_permuted", true));
    assert_message(&finding, &["s0_x_lsb is recorded as s0_y_lsb"]);
    corrects_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn sensor_rotated_in_one_recording_is_corrected() {
    let spoilt = CampaignCopy::new().change(&[1], "hall.csv", |cells| {
        cells.exchange("s1_x_lsb", "s1_z_lsb");
        negated(cells, "s1_z_lsb");
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "axis_permuted");
    assert_message(&finding, &["in recording 1", "s1_z_lsb"]);
    corrects_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn flipped_force_is_found_or_equivalent_to_the_axis() {
    let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| negated(cells, "f1_x_n"));
    let finding = only(&spoilt);
    assert!(finding.stops);
    assert_message(&finding, &["f1_x_n has the other sign"]);
    match finding.fix {
        Some(_) => {
            assert_eq!(finding.id, "force_flipped");
            corrects_to_clean(&spoilt, finding, "force.csv");
        }
        None => {
            assert_message(&finding, &["s1_x_lsb has the other sign", "the data cannot decide"])
        }
    }
}

#[test]
fn exchanged_force_axes_are_corrected() {
    let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
        for place in SENSORS {
            cells.exchange(&format!("f{place}_x_n"), &format!("f{place}_z_n"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "force_swapped");
    assert_message(&finding, &["f0_x_n is recorded as f0_z_n"]);
    corrects_to_clean(&spoilt, finding, "force.csv");
}

#[test]
fn exchanged_force_places_are_one_finding() {
    let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
        for axis in ["x", "z"] {
            cells.exchange(&format!("f0_{axis}_n"), &format!("f3_{axis}_n"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "force_swapped");
    assert_message(&finding, &["f0_x_n is recorded as f3_x_n", "f3_z_n is recorded as f0_z_n"]);
    corrects_to_clean(&spoilt, finding, "force.csv");
}

#[test]
fn exchanged_sensors_are_one_finding() {
    let spoilt = CampaignCopy::new().change(&[1, 2], "hall.csv", |cells| {
        for axis in ["x", "y", "z"] {
            cells.exchange(&format!("s0_{axis}_lsb"), &format!("s1_{axis}_lsb"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "axis_permuted");
    assert_message(&finding, &["s0_x_lsb is recorded as s1_x_lsb", "in recordings 1 and 2"]);
    corrects_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn repeated_samples_precede_the_lag_they_cause() {
    let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
        for row in 0..cells.rows.len() {
            for cell in 1..17 {
                cells.rows[row][cell] = cells.rows[row - row % 10][cell].clone();
            }
        }
    });
    let files = scan_files(&spoilt.path(), NO_DELAY, |_| ()).unwrap();
    let all = merge(files, findings_with_own_model(&spoilt.path(), NO_DELAY));
    let kinds: Vec<_> = all.iter().map(|finding| finding.id).collect();
    assert_eq!(kinds, ["repeated_samples", "clock_skew"]);
}

#[test]
fn field_in_wrong_unit_is_corrected() {
    for (unit, factor) in [("mT", 0.1), ("uT", 100.0), ("mG", 1000.0)] {
        let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
            for sensor in SENSORS {
                for axis in ["x", "y", "z"] {
                    let column = format!("s{sensor}_{axis}_lsb");
                    cells.change(&column, |_, counts| (0.125 * counts * factor).to_string());
                    let i = cells.index(&column);
                    cells.header[i] = format!("s{sensor}_{axis}_gauss");
                }
            }
        });
        for recording in ALL {
            // A range of 2000 G would mark every row as saturated.
            let path = spoilt.recording(recording).join("recording.toml");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(path, text.replace("range_gauss = 2000.0\n", "")).unwrap();
        }
        let finding = only(&spoilt);
        assert_eq!((finding.id, finding.stops), ("wrong_unit", true));
        assert_message(&finding, &[&format!("are in {unit}, not in gauss"), "throughout"]);
        corrected_copy::write(&spoilt.path(), &[finding], &spoilt.repaired_path(), unchecked)
            .unwrap();
        let left = findings_with_own_model(&spoilt.repaired_path(), NO_DELAY);
        assert!(left.is_empty(), "{left:#?}");
    }
}

#[test]
fn single_channel_in_another_unit_is_named() {
    for wrong in ["x", "y", "z"] {
        for (factor, said) in [(10.0, "10 times the model's field"), (0.1, "in mT, not in gauss")] {
            let spoilt = CampaignCopy::new().change(&ALL, "hall.csv", |cells| {
                for axis in ["x", "y", "z"] {
                    let column = format!("s0_{axis}_lsb");
                    let scale = if axis == wrong { 0.125 * factor } else { 0.125 };
                    cells.change(&column, |_, counts| (counts * scale).to_string());
                    let i = cells.index(&column);
                    cells.header[i] = format!("s0_{axis}_gauss");
                }
            });
            for recording in ALL {
                // Ten times the field along y exceeds the range.
                let path = spoilt.recording(recording).join("recording.toml");
                let text = std::fs::read_to_string(&path).unwrap();
                std::fs::write(&path, text.replace("range_gauss = 2000.0\n", "")).unwrap();
            }
            let finding = only(&spoilt);
            assert_eq!((finding.id, finding.stops), ("wrong_unit", true), "{wrong} {factor}");
            assert_message(&finding, &[&format!("s0_{wrong}_gauss is {said}"), "throughout"]);
        }
    }
}

#[test]
fn force_in_wrong_unit_is_corrected() {
    for (unit, newtons) in [("kgf", 9.806_65), ("mN", 1e-3), ("kN", 1e3), ("gf", 9.806_65e-3)] {
        let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
            for column in cells.header.clone() {
                if column != "t_us" {
                    cells.change(&column, |_, force| format!("{:.7}", force / newtons));
                }
            }
        });
        let finding = only(&spoilt);
        assert_eq!((finding.id, finding.stops), ("wrong_unit", true));
        assert_message(&finding, &[&format!("are in {unit}, not in newtons"), "throughout"]);
        corrected_copy::write(&spoilt.path(), &[finding], &spoilt.repaired_path(), unchecked)
            .unwrap();
        let left = findings_with_own_model(&spoilt.repaired_path(), NO_DELAY);
        assert!(left.is_empty(), "{left:#?}");
    }
}

#[test]
fn unknown_gain_has_no_fix() {
    let spoilt = CampaignCopy::new().change(&ALL, "force.csv", |cells| {
        cells.change("f2_z_n", |_, force| format!("{:.4}", force / 20.0));
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.fix.is_none()), ("wrong_unit", true));
    assert_message(&finding, &["f2_z_n is 0.05 times the force"]);
}

fn late(recordings: &[u32], us: f64) -> CampaignCopy {
    CampaignCopy::new().change(recordings, "force.csv", |cells| {
        cells.change("t_us", |_, t| (t - us + 50_000.0).to_string());
    })
}

#[test]
fn clock_offset_is_reported_with_its_correction() {
    // Shifted by 50 ms to keep all times positive; the offset is the rest.
    let spoilt = late(&ALL, 50_000.0 + 8_000.0);
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_skew", false));
    assert_message(&finding, &["8.0 ms behind the force in every recording", "--delay-ms 8.0"]);
    let cured = findings_with_own_model(&spoilt.path(), Alignment { delay_us: 8_000.0 });
    assert!(cured.is_empty(), "{cured:#?}");
}

#[test]
fn clock_offset_of_one_recording_names_it() {
    let finding = only(&late(&[2], 50_000.0 - 20_000.0));
    // The loads show it without the model, which would have absorbed a part of it.
    assert_eq!(finding.id, "clock_offset");
    assert_message(&finding, &["-20.0±", "ms in recording 2", "--fix NEW applies"]);
}
