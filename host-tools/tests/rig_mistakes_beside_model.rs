//! Mistakes of the rig that only a model shows: columns exchanged or in another unit, clocks that
//! disagree. The model was fitted to the clean campaign.

use std::path::Path;
use std::sync::OnceLock;

use host_tools::compare::Finding;
use host_tools::findings::against::{Beside, against};
use host_tools::findings::{files, fix, merge};
use model_export::effects::{Series, Track};
use model_export::fit::rows::SensorRows;
use model_export::fit::{self, Options};
use model_export::model_file::{ModelFile, Provenance};
use model_export::physics::ForwardModel;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use nalgebra::Vector3;
use tests::data;
use tests::spoilt::{Cells, Spoilt};

const AT_ONCE: Alignment = Alignment { delay_us: 0.0 };
const ALL: [u32; 3] = [1, 2, 3];
const SENSORS: [u32; 4] = [0, 1, 2, 3];

/// The base, fitted to a campaign.
fn fitted(folder: &Path) -> ModelFile {
    let campaign = Campaign::read(folder, AT_ONCE, |_| ()).unwrap();
    let options = Options::default();
    let (fits, _) = fit::campaign::cylinder(&campaign, options, |_| ()).unwrap();
    let provenance = Provenance::of(&campaign, 0.0, options).unwrap();
    ModelFile::of(&campaign, &fits, provenance)
}

/// The base, fitted to `clean` once.
fn model() -> &'static ModelFile {
    static MODEL: OnceLock<ModelFile> = OnceLock::new();
    MODEL.get_or_init(|| fitted(&data("clean")))
}

fn field(model: &ForwardModel, track: &Track) -> Vec<Vector3<f64>> {
    let frames = model.frames();
    let series = Series::of(track, model.stiffness_n_per_mm, &[]);
    let states = series.states.iter();
    states.map(|state| model.field_in(&frames, state)).collect()
}

fn beside_model(folder: &Path, alignment: Alignment) -> Vec<Finding> {
    beside(model(), folder, alignment)
}

fn beside(model: &ModelFile, folder: &Path, alignment: Alignment) -> Vec<Finding> {
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
        .map(|(_, model)| move |track: &Track| field(model, track))
        .collect();
    let pairs = sensors.iter().zip(&predict);
    let beside: Vec<Beside> = pairs
        .map(|((rows, _), predict)| Beside { rows, predict })
        .collect();
    against(&campaign, alignment, &beside)
}

/// The only finding, of the files or beside the model.
fn only(spoilt: &Spoilt) -> Finding {
    let files = files::scan(&spoilt.path(), |_| ()).unwrap();
    let mut findings = merge(files, beside_model(&spoilt.path(), AT_ONCE));
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

/// Mended, there is no finding, and the table of the first recording is the clean one.
fn mends_to_clean(spoilt: &Spoilt, finding: Finding, name: &str) {
    fix::write(&spoilt.path(), &[finding], &spoilt.beside()).unwrap();
    let left = beside_model(&spoilt.beside(), AT_ONCE);
    assert!(left.is_empty(), "{left:#?}");
    let packed = format!("{name}.gz");
    let mended = Cells::read(&spoilt.beside().join("1").join(&packed));
    let clean = Cells::read(&data("clean").join("1").join(&packed));
    assert_eq!(mended.rows.len(), clean.rows.len());
    for column in &clean.header {
        let pairs = mended
            .numbers(column)
            .into_iter()
            .zip(clean.numbers(column));
        for (a, b) in pairs {
            assert!((a - b).abs() < 1e-9, "{column}: {a} and {b}");
        }
    }
}

fn negated(cells: &mut Cells, column: &str) {
    cells.change(column, |_, value| (-value).to_string());
}

#[test]
fn a_sound_campaign_has_no_finding() {
    let findings = beside_model(&data("clean"), AT_ONCE);
    assert!(findings.is_empty(), "{findings:#?}");
}

#[test]
fn an_effect_that_the_model_lacks_is_no_mistake_of_the_rig() {
    for name in ["demo", "friction"] {
        let findings = beside(&fitted(&data(name)), &data(name), AT_ONCE);
        assert!(findings.is_empty(), "{name}: {findings:#?}");
    }
}

#[test]
fn a_flipped_axis_is_named_and_mended() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| negated(cells, "s2_y_lsb"));
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("axis_flipped", true));
    assert_eq!(finding.place.column.as_deref(), Some("s2_y_lsb"));
    says(&finding, &["s2_y_lsb has the other sign", "throughout"]);
    mends_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn permuted_axes_of_every_sensor_are_one_finding() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        for sensor in SENSORS {
            cells.exchange(&format!("s{sensor}_x_lsb"), &format!("s{sensor}_y_lsb"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("axis_permuted", true));
    says(&finding, &["s0_x_lsb belongs where s0_y_lsb stands"]);
    mends_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn a_sensor_turned_by_a_quarter_in_one_recording_is_named_there() {
    let spoilt = Spoilt::new().change(&[1], "hall.csv", |cells| {
        cells.exchange("s1_x_lsb", "s1_z_lsb");
        negated(cells, "s1_z_lsb");
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "axis_permuted");
    says(&finding, &["in recording 1", "s1_z_lsb"]);
    mends_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn a_flipped_force_is_named_by_the_forces_or_tied_with_the_axis() {
    let spoilt = Spoilt::new().change(&ALL, "force.csv", |cells| negated(cells, "f1_x_n"));
    let finding = only(&spoilt);
    assert!(finding.stops);
    says(&finding, &["f1_x_n has the other sign"]);
    match finding.fix {
        Some(_) => {
            assert_eq!(finding.id, "force_flipped");
            mends_to_clean(&spoilt, finding, "force.csv");
        }
        None => says(
            &finding,
            &["s1_x_lsb has the other sign", "only the bench can tell"],
        ),
    }
}

#[test]
fn forces_of_the_two_axes_exchanged_are_named_and_mended() {
    let spoilt = Spoilt::new().change(&ALL, "force.csv", |cells| {
        for place in SENSORS {
            cells.exchange(&format!("f{place}_x_n"), &format!("f{place}_z_n"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "force_swapped");
    says(&finding, &["f0_x_n belongs where f0_z_n stands"]);
    mends_to_clean(&spoilt, finding, "force.csv");
}

#[test]
fn forces_of_two_places_exchanged_are_one_finding_and_mended() {
    let spoilt = Spoilt::new().change(&ALL, "force.csv", |cells| {
        for axis in ["x", "z"] {
            cells.exchange(&format!("f0_{axis}_n"), &format!("f3_{axis}_n"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "force_swapped");
    says(
        &finding,
        &[
            "f0_x_n belongs where f3_x_n stands",
            "f3_z_n belongs where f0_z_n",
        ],
    );
    mends_to_clean(&spoilt, finding, "force.csv");
}

#[test]
fn two_sensors_with_exchanged_plugs_are_one_finding_and_mended() {
    let spoilt = Spoilt::new().change(&[1, 2], "hall.csv", |cells| {
        for axis in ["x", "y", "z"] {
            cells.exchange(&format!("s0_{axis}_lsb"), &format!("s1_{axis}_lsb"));
        }
    });
    let finding = only(&spoilt);
    assert_eq!(finding.id, "axis_permuted");
    says(
        &finding,
        &[
            "s0_x_lsb belongs where s1_x_lsb stands",
            "in recordings 1 and 2",
        ],
    );
    mends_to_clean(&spoilt, finding, "hall.csv");
}

#[test]
fn samples_that_are_held_are_told_before_the_lag_that_they_make() {
    let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
        for row in 0..cells.rows.len() {
            for cell in 1..17 {
                cells.rows[row][cell] = cells.rows[row - row % 10][cell].clone();
            }
        }
    });
    let files = files::scan(&spoilt.path(), |_| ()).unwrap();
    let all = merge(files, beside_model(&spoilt.path(), AT_ONCE));
    let kinds: Vec<_> = all.iter().map(|finding| finding.id).collect();
    assert_eq!(kinds, ["repeated_samples", "clock_skew"]);
}

#[test]
fn a_field_in_another_unit_is_named_and_mended() {
    for (unit, factor) in [("mT", 0.1), ("uT", 100.0), ("mG", 1000.0)] {
        let spoilt = Spoilt::new().change(&ALL, "hall.csv", |cells| {
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
            // 2000 G of range would leave nothing of a field in other units.
            let path = spoilt.recording(recording).join("recording.toml");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(path, text.replace("range_gauss = 2000.0\n", "")).unwrap();
        }
        let finding = only(&spoilt);
        assert_eq!((finding.id, finding.stops), ("wrong_unit", true));
        says(
            &finding,
            &[&format!("are in {unit}, not in gauss"), "throughout"],
        );
        fix::write(&spoilt.path(), &[finding], &spoilt.beside()).unwrap();
        let left = beside_model(&spoilt.beside(), AT_ONCE);
        assert!(left.is_empty(), "{left:#?}");
    }
}

#[test]
fn a_force_in_another_unit_is_named_and_mended() {
    for (unit, newtons) in [
        ("kgf", 9.806_65),
        ("mN", 1e-3),
        ("kN", 1e3),
        ("gf", 9.806_65e-3),
    ] {
        let spoilt = Spoilt::new().change(&ALL, "force.csv", |cells| {
            for column in cells.header.clone() {
                if column != "t_us" {
                    cells.change(&column, |_, force| format!("{:.7}", force / newtons));
                }
            }
        });
        let finding = only(&spoilt);
        assert_eq!((finding.id, finding.stops), ("wrong_unit", true));
        says(
            &finding,
            &[&format!("are in {unit}, not in newtons"), "throughout"],
        );
        fix::write(&spoilt.path(), &[finding], &spoilt.beside()).unwrap();
        let left = beside_model(&spoilt.beside(), AT_ONCE);
        assert!(left.is_empty(), "{left:#?}");
    }
}

#[test]
fn a_gain_without_a_name_is_told_and_not_mended() {
    let spoilt = Spoilt::new().change(&ALL, "force.csv", |cells| {
        cells.change("f2_z_n", |_, force| format!("{:.4}", force / 20.0));
    });
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.fix.is_none()), ("wrong_unit", true));
    says(&finding, &["f2_z_n is 0.05 times the force"]);
}

fn late(recordings: &[u32], us: f64) -> Spoilt {
    Spoilt::new().change(recordings, "force.csv", |cells| {
        cells.change("t_us", |_, t| (t - us + 50_000.0).to_string());
    })
}

#[test]
fn clocks_that_disagree_are_told_with_the_delay_that_cures_it() {
    // Moved by 50 ms too, so that no time is negative: the shift is what lies between.
    let spoilt = late(&ALL, 50_000.0 + 8_000.0);
    let finding = only(&spoilt);
    assert_eq!((finding.id, finding.stops), ("clock_skew", false));
    says(
        &finding,
        &[
            "8.0 ms after the force in every recording",
            "--delay-ms 8.0",
        ],
    );
    let cured = beside_model(&spoilt.path(), Alignment { delay_us: 8_000.0 });
    assert!(cured.is_empty(), "{cured:#?}");
}

#[test]
fn a_clock_that_disagrees_in_one_recording_is_told_for_that_one() {
    let finding = only(&late(&[2], 50_000.0 - 20_000.0));
    assert_eq!(finding.id, "clock_skew");
    says(
        &finding,
        &[
            "20.0 ms before the force in recording 2",
            "would harm the others",
        ],
    );
}
