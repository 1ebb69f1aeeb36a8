//! Sensors that are mounted turned: each orientation is found, and the forces are those of the nominal mounting.

use firmware::compensation::CompensationState;
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::estimator::{Validity, estimate};
use firmware::sensors::hall::HallReading;
use model_export::fit::campaign::{self, FitSetup};
use model_export::fit::{FitError, FitOptions};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::model_file::{ModelFile, Provenance};
use model_export::physics::{SensorMounting, SensorOrientation};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;
use tempfile::TempDir;
use tests::data;

/// Two sensors of `clean`, with the forces at their places.
fn two_sensors() -> Campaign {
    let alignment = Alignment { delay_us: 0.0 };
    let mut campaign = Campaign::read(&data("clean"), alignment, |_| ()).unwrap();
    for recording in &mut campaign.recordings {
        recording.sensors.retain(|sensor, _| [0, 2].contains(sensor));
    }
    campaign
}

/// The fields of a sensor as it measures them in this mounting.
fn mount(campaign: &mut Campaign, sensor: u32, mounting: SensorMounting) {
    let sign = if mounting.is_reversed { -1.0 } else { 1.0 };
    for recording in &mut campaign.recordings {
        for field in &mut recording.sensors.get_mut(&sensor).unwrap().field_g {
            *field = mounting.orientation.to_sensor(sign * Vector3::from(*field)).into();
        }
    }
}

fn turned(orientation: SensorOrientation) -> SensorMounting {
    SensorMounting { orientation, is_reversed: false }
}

fn fitted(campaign: &Campaign) -> DeviceModel {
    let options = FitOptions::default();
    let (fits, _) = campaign::cylinder(campaign, options, |_| ()).unwrap();
    let provenance = Provenance::of(campaign, 0.0, options).unwrap();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    ModelFile::of(campaign, &fits, provenance).write(&path).unwrap();
    build(&path, ModelVariant::Fitted).unwrap()
}

/// RMS over both forces of the error of the device's code at a sensor, in newtons.
fn force_error_n(campaign: &Campaign, built: &DeviceModel, sensor: u32) -> f64 {
    let tables = built.chosen.tables.tables(&[]);
    let (mut squares, mut rows) = (0.0, 0.0);
    for recording in &campaign.recordings {
        let [x, z] = [Axis::X, Axis::Z].map(|axis| &recording.forces[&(sensor, axis)].newtons);
        for ((field_g, x), z) in recording.sensors[&sensor].field_g.iter().zip(x).zip(z) {
            let field =
                field_g.map(|g| (g / built.model.sensor_scale.gauss_per_lsb).round() as i16);
            let reading = Some(HallReading { field, temperature: 0 });
            let (inputs, mut state) = (AuxiliaryInputs::default(), CompensationState::default());
            let found = estimate(&tables, sensor as usize, reading, &inputs, &mut state);
            if found.validity == Validity::Valid {
                let [fx, fz] = found.force.map(|force| force.newtons());
                squares += (fx - x).powi(2) + (fz - z).powi(2);
                rows += 1.0;
            }
        }
    }
    let all: usize = campaign.recordings.iter().map(|recording| recording.time_s.len()).sum();
    assert!(rows > 0.9 * all as f64, "{rows} of {all} rows");
    (squares / (2.0 * rows)).sqrt()
}

#[test]
fn all_orientations_are_found_with_the_same_force_error() {
    let nominal = two_sensors();
    let built = fitted(&nominal);
    let expected_n = [0, 2].map(|sensor| force_error_n(&nominal, &built, sensor));
    assert!(expected_n.iter().all(|error_n| *error_n < 0.5), "{expected_n:?}");
    let all: Vec<SensorOrientation> = SensorOrientation::all().collect();
    for (place, &first) in all.iter().enumerate() {
        let second = all[(place + 7) % all.len()];
        let mut campaign = nominal.clone();
        mount(&mut campaign, 0, turned(first));
        mount(&mut campaign, 2, turned(second));
        let built = fitted(&campaign);
        for ((sensor, orientation), expected_n) in
            [(0, first), (2, second)].into_iter().zip(expected_n)
        {
            assert_eq!(built.model.mounting(sensor), Some(turned(orientation)));
            let ratio = force_error_n(&campaign, &built, sensor) / expected_n;
            assert!((ratio - 1.0).abs() < 0.02, "{orientation} of sensor {sensor}: {ratio}");
        }
    }
}

/// Mounting of sensor 2 that the recordings give, with its notice.
fn found(campaign: &Campaign) -> Result<(SensorMounting, String), FitError> {
    let setup = FitSetup::cylinder(campaign)?;
    let nominal = campaign.design().unwrap().magnet.remanence_t;
    let (rows, base) =
        setup.rows.iter().zip(&setup.bases).find(|(rows, _)| rows.sensor == 2).unwrap();
    let parameters = base.parameters();
    let remanence = parameters.iter().find(|parameter| parameter.name == "remanence").unwrap();
    let mounting = SensorMounting {
        orientation: rows.orientation,
        is_reversed: remanence.start * nominal < 0.0,
    };
    let notices: Vec<String> = setup.notices.iter().map(ToString::to_string).collect();
    Ok((mounting, notices.join("\n")))
}

#[test]
fn reversed_magnets_are_found_unless_one_column_explains_them() {
    let nominal = two_sensors();
    let mut refused = 0;
    for orientation in SensorOrientation::all() {
        let mounting = SensorMounting { orientation, is_reversed: true };
        let mut campaign = nominal.clone();
        mount(&mut campaign, 2, mounting);
        match found(&campaign) {
            Ok((as_found, notice)) => {
                assert_eq!(as_found, mounting);
                assert!(notice.contains("the poles of its magnet exchanged"), "{notice}");
            }
            Err(error) => {
                assert!(mounting.equals_column_error(), "{mounting}: {error}");
                let error = error.to_string();
                assert!(error.contains("give remanence_t the other sign"), "{mounting}: {error}");
                refused += 1;
            }
        }
    }
    assert_eq!(refused, 6);
}

#[test]
fn both_force_columns_negated_are_a_turned_sensor_with_a_notice() {
    let mut campaign = two_sensors();
    for recording in &mut campaign.recordings {
        for axis in [Axis::X, Axis::Z] {
            let force = recording.forces.get_mut(&(2, axis)).unwrap();
            force.newtons.iter_mut().for_each(|newtons| *newtons = -*newtons);
        }
    }
    let (mounting, notice) = found(&campaign).unwrap();
    assert_eq!(mounting, "-x+y-z".parse().unwrap());
    assert!(notice.contains("with the other sign of both f2_x_n and f2_z_n"), "{notice}");
}

#[test]
fn forces_that_move_together_leave_the_orientation_open() {
    let mut campaign = two_sensors();
    for recording in &mut campaign.recordings {
        let z = recording.forces[&(2, Axis::Z)].clone();
        // Both forces in proportion; the field is that of one of them.
        let x = recording.forces.get_mut(&(2, Axis::X)).unwrap();
        x.newtons = z.newtons.iter().map(|newtons| 0.5 * newtons).collect();
    }
    let (mounting, notice) = found(&campaign).unwrap();
    assert_eq!(mounting, SensorMounting::default());
    assert!(notice.contains("f2_x_n does not move by itself in any recording"), "{notice}");
    mount(&mut campaign, 2, turned("+y-x+z".parse().unwrap()));
    let error = found(&campaign).unwrap_err().to_string();
    assert!(
        error.contains("column f2_x_n") && error.contains("does not move by itself"),
        "{error}"
    );
    assert!(error.contains("record this force while the other one rests"), "{error}");
}

#[test]
fn a_recording_with_another_orientation_is_an_error() {
    let mut campaign = two_sensors();
    let mut other = campaign.clone();
    mount(&mut other, 2, turned("+y-x+z".parse().unwrap()));
    campaign.recordings[1] = other.recordings.remove(1);
    let error = found(&campaign).unwrap_err();
    let place = error.place().unwrap().to_string();
    assert!(place.contains("2/hall.csv") && error.to_string().contains("permuted"), "{error}");
}
