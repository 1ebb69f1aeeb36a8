//! A made-up comparison of realistic size and shape, to be looked at and measured.

use std::f64::consts::PI;

use analysis::data_quality::Finding;
use analysis::data_quality::evidence::{ColumnError, Evidence, RecordingSet};
use analysis::data_quality::fix::{Fix, FixKind};
use model_export::model_file::{CorrelationTable, SensorScale};
use model_export::recordings::Location;
use model_export::recordings::columns::{Axis, SignalUnit};

use analysis::compare::*;
use analysis::parameters::{
    ParameterEstimate, ParameterTable, Prior, Remedy, SensorCorrelation, Unidentified,
};
use analysis::statistics::ErrorStatistics;

/// Seconds of a recording, and rows a second.
const SPAN_S: usize = 30;
const RATE: usize = 100;

/// Noise that is the same on every run.
fn noise(i: usize, salt: usize) -> f64 {
    let mut bits = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (salt as u64).wrapping_mul(0xD1B5_4A32_D192_ED03);
    bits ^= bits >> 29;
    bits = bits.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits ^= bits >> 32;
    (bits >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
}

fn channel(size: f64, error: f64, noisy: f64, salt: usize) -> [Envelope; 2] {
    let rows = SPAN_S * RATE;
    let time: Vec<f64> = (0..rows).map(|i| i as f64 / RATE as f64).collect();
    let phase = salt as f64;
    let truth =
        |t: f64| size * (0.4 * (0.9 * t + phase).sin() + 0.25 * (2.3 * t).cos() * (0.2 * t).sin());
    // Two models of the same recording differ in what they miss.
    let missed = |t: f64| error * (0.7 * t + phase).sin().powi(3);
    let model: Vec<f64> = time.iter().map(|t| truth(*t) - missed(*t)).collect();
    let noisy = |(i, t): (usize, &f64)| truth(*t) + 1.7 * noisy * noise(i, salt);
    let measured: Vec<f64> = time.iter().enumerate().map(noisy).collect();
    [Envelope::of(&time, &measured, rows), Envelope::of(&time, &model, rows)]
}

fn traces(recordings: usize, sensors: u32, error: f64) -> Vec<Trace> {
    let mut traces = Vec::new();
    for recording in 0..recordings {
        for sensor in 0..sensors {
            let salt = recording * 17 + sensor as usize * 5;
            let worse = error * (1.0 + f64::from(sensor));
            traces.push(Trace {
                unit: SignalUnit::Gauss,
                recording: format!("{:02}-grasp-and-walk", recording + 1),
                sensor,
                field: [900.0, 2400.0, 1300.0]
                    .iter()
                    .enumerate()
                    .map(|(axis, size)| channel(*size, worse, 0.35, salt + axis))
                    .collect(),
                force: [60.0, 180.0]
                    .iter()
                    .enumerate()
                    .map(|(axis, size)| channel(*size, 0.12 * worse, 0.15, salt + axis))
                    .collect(),
            });
        }
    }
    traces
}

fn figures(rms: f64, span: f64) -> ErrorStatistics {
    ErrorStatistics {
        rms,
        mean: -0.2 * rms,
        std: 0.98 * rms,
        p95: 2.1 * rms,
        greatest: 4.4 * rms,
        span,
    }
}

fn located(k: usize, sensors: u32) -> Attribution {
    const NAMES: [(&str, &str, &str); 14] = [
        ("opening_mm", "opening", "mm"),
        ("temperature_c", "temperature of the sensor", "°C"),
        ("loading_x", "loading or unloading", ""),
        ("fx_n", "lateral force", "N"),
        ("fz_n", "longitudinal force", "N"),
        ("fx_rate_n_per_s", "rate of the lateral force", "N/s"),
        ("motor_iq_a", "motor current", "A"),
        ("motor_angle_rad", "motor angle", "rad"),
        ("roll_rad", "roll", "rad"),
        ("pitch_rad", "pitch", "rad"),
        ("yaw_rad", "yaw", "rad"),
        ("accel_x_mps2", "acceleration x", "m/s²"),
        ("accel_z_mps2", "acceleration z", "m/s²"),
        ("time_s", "time", "s"),
    ];
    let (covariate, words, unit) = NAMES[k % NAMES.len()];
    let share: f64 = [0.48, 0.21, 0.06].get(k).copied().unwrap_or(0.004);
    let count = if k == 2 { 2 } else { 16 };
    let bins = (0..count).map(|i| {
        let x = i as f64 / (count - 1) as f64;
        let mean = |sensor: u32, axis: usize| {
            let size = 14.0 * share.sqrt() * (1.0 + f64::from(sensor)) / 4.0;
            match (axis, i == 7 && k == 3) {
                (_, true) => f64::NAN,
                (0, _) => size * (1.0 - 2.0 * x).powi(3),
                (1, _) => size * 0.5 * (PI * x).cos(),
                _ => size * 0.3 * (x - 0.5),
            }
        };
        let means = |sensor: u32| [0, 1, 2].map(|axis| mean(sensor, axis));
        let wide = 0.35 + 1.2 * (x - 0.5).abs();
        Bin {
            from: 40.0 * x - 1.0,
            to: 40.0 * x + 1.0,
            centre: 40.0 * x,
            rows: 560,
            rms: 4.0,
            share: 0.06,
            mean: (0..sensors).map(means).collect(),
            band: (0..sensors).map(|s| means(s).map(|mean| (mean - wide, mean + wide))).collect(),
        }
    });
    Attribution {
        error_unit: ErrorUnit::Newton,
        covariate: covariate.into(),
        words: words.into(),
        unit,
        share,
        alone: share + 0.03,
        chosen: k < 3,
        sensors: (0..sensors).collect(),
        bins: bins.collect(),
    }
}

fn histogram(axis: Axis, wide: f64) -> Histogram {
    let edges: Vec<f64> = (0..=40).map(|i| f64::from(i) * 0.4 - 8.0).collect();
    let count = |edges: &[f64]| (9000.0 * (-0.5 * ((edges[0] + 0.2) / wide).powi(2)).exp()) as u64;
    Histogram { axis, counts: edges.windows(2).map(count).collect(), edges }
}

fn map() -> ResidualMap {
    let across: Vec<f64> = vec![0.0, 3.0, 7.0, 12.0, 18.0, 24.0, 31.0, 36.0, 40.0];
    let upwards: Vec<f64> = vec![-60.0, -40.0, -25.0, -12.0, 0.0, 12.0, 25.0, 40.0, 60.0];
    let cell = |row: usize, column: usize| match (row, column) {
        (0, 6..) | (7, 0) => f64::NAN,
        _ => 0.5 * (1.0 + 14.0 * (-(column as f64) / 2.0).exp() + 0.2 * (row as f64 - 3.5).powi(2)),
    };
    ResidualMap {
        error_unit: ErrorUnit::Newton,
        axes: ["opening in mm".to_owned(), "lateral force in N".to_owned()],
        rms: (0..8).map(|row| (0..8).map(|column| cell(row, column)).collect()).collect(),
        across,
        upwards,
        floor: 0.46,
    }
}

/// Recordings of 30 s at 100 rows a second; `error` in gauss.
pub fn comparison(recordings: usize, sensors: u32, error: f64) -> Comparison {
    let axes = (0..sensors).flat_map(|sensor| {
        Axis::ALL.into_iter().enumerate().map(move |(k, axis)| {
            let rms = 0.5 + error * (0.5 + 0.4 * f64::from(sensor)) * [1.0, 0.6, 0.35][k];
            FieldAxisErrors {
                sensor,
                axis,
                error: figures(rms, [900.0, 2400.0, 1300.0][k]),
                floor: NoiseFloor {
                    white: 0.36,
                    quantisation: 0.036,
                    reference: 0.28,
                    slow: (k != 1).then_some(0.11),
                    replicates: None,
                    total: 0.456,
                },
                explainable: (rms * rms - 0.456 * 0.456).sqrt(),
            }
        })
    });
    let forces = (0..sensors).flat_map(|sensor| {
        [Axis::X, Axis::Z].map(|axis| {
            let rms = 0.2 + 0.11 * error * (1.0 + f64::from(sensor));
            ForceAxisErrors {
                sensor,
                axis,
                error: figures(rms, if axis == Axis::X { 60.0 } else { 180.0 }),
                recorded_rms: rms,
                reducible_rms: rms,
                flagged: None,
                tared_rms: Some(0.9 * rms),
                floor: 0.17,
                explainable: (rms * rms - 0.17 * 0.17).sqrt(),
            }
        })
    });
    Comparison {
        model: "model.toml".to_owned(),
        campaign: "recordings/hidden-a".to_owned(),
        validation: Some(Validation::UnseenRecordings),
        axes: axes.collect(),
        forces: forces.collect(),
        located: (0..14).map(|k| located(k, sensors)).collect(),
        map: Some(map()),
        worst: (0..5)
            .map(|k| WorstInterval {
                error_unit: ErrorUnit::Newton,
                recording: format!("{:02}-grasp-and-walk", k % recordings.max(1) + 1),
                from_s: 3.2 + 4.9 * k as f64,
                to_s: 4.6 + 4.9 * k as f64,
                sensor: 3 - (k as u32 % 2),
                rms: 14.3 - 1.7 * k as f64,
                conditions: vec![MeanCondition { label: "opening", mean: 2.1, unit: "mm" }],
            })
            .collect(),
        correlation_s: 0.42,
        parameters: parameters(sensors),
        traces: traces(recordings, sensors, error),
        histograms: vec![
            histogram(Axis::X, 0.5 + 0.3 * error),
            histogram(Axis::Z, 0.5 + 0.4 * error),
        ],
        provenance: Some(ComparisonProvenance {
            fitted_campaign: "hidden-a".to_owned(),
            fitted_recordings: 3,
            fitted_rows: 90_003,
            fitted_by: "magpie 0.1.0".to_owned(),
            effects: vec!["hysteresis".to_owned(), "creep".to_owned()],
            block_s: 2.0,
            seed: 7,
            sensor_scale: SensorScale { gauss_per_lsb: 0.125, range_gauss: 2000.0, assumed: true },
            recordings: (1..=recordings)
                .map(|k| (format!("{k:02}-grasp-and-walk"), "5f1d8c0e".repeat(8)))
                .collect(),
        }),
        ..Comparison::default()
    }
}

/// Gap and stiffness of each sensor, the first not identified, the second far from the design.
fn parameters(sensors: u32) -> ParameterTable {
    let estimate = |sensor: u32, name: &str, value: f64, nominal: f64| ParameterEstimate {
        sensor,
        effect: None,
        name: name.to_owned(),
        value,
        std_error: 0.08,
        unit: "mm".to_owned(),
        identifiable: name != "gap",
        nominal: Some(nominal),
        prior_width: Some(0.1),
        prior: Prior::ManufacturingTolerance,
        deviation: Some((value - nominal) / 0.1_f64.hypot(0.08)),
    };
    ParameterTable {
        estimates: (0..sensors)
            .flat_map(|s| [estimate(s, "gap", 1.52, 1.5), estimate(s, "offset_x", -0.74, 0.0)])
            .collect(),
        correlations: (0..sensors)
            .map(|sensor| SensorCorrelation {
                sensor,
                table: CorrelationTable {
                    names: ["gap", "offset_x"].map(str::to_owned).to_vec(),
                    rows: vec![vec![-0.93]],
                },
            })
            .collect(),
        unidentified: vec![Unidentified {
            sensor: 0,
            shares: [("gap".to_owned(), 1.0)].into(),
            known_within: Some(1.4),
            remedy: Remedy::Load { peak_n: [250.0, 0.0], after_effect: false },
            known_within_then: Some(0.2),
        }],
    }
}

fn recordings_of(count: usize) -> RecordingSet {
    let names = (1..=count).map(|k| format!("{k:02}-grasp-and-walk"));
    RecordingSet { names: names.collect(), is_all: false }
}

/// The section of a page with this id, without its tags.
pub fn section<'p>(page: &'p str, id: &str) -> &'p str {
    let (_, rest) = page.split_once(&format!("<section id=\"{id}\">")).unwrap();
    rest.split_once("</section>").unwrap().0
}

/// Asserts that no number without a value was written or drawn.
pub fn assert_no_invalid_number(page: &str) {
    for word in ["NaN", "inf,", "inf ", "\"inf", "-2147483648", "2147483647"] {
        let at = page.find(word).map(|at| &page[at.saturating_sub(80)..at + 20]);
        assert_eq!(at, None, "{word}");
    }
}

/// Everything at once: two models and two mistakes of the rig.
pub fn full(recordings: usize) -> Comparison {
    let place = Location {
        file: "recordings/hidden-a/02-grasp-and-walk/force.csv".into(),
        line: Some(1412),
        column: Some("f2_x_n".to_owned()),
    };
    Comparison {
        findings: vec![
            Finding {
                id: "force_flipped",
                place: place.clone(),
                evidence: Evidence::ColumnErrors {
                    columns: vec![("f2_x_n".to_owned(), ColumnError::OtherSign)],
                    recordings: recordings_of(1),
                    before_g: 65.9,
                    after_g: 0.16,
                    alternatives: Vec::new(),
                    is_unit: false,
                },
                stops: true,
                fix: Some(Fix { kind: FixKind::NegateColumns, repairs: Vec::new() }),
            },
            Finding {
                id: "clock_gap",
                place,
                evidence: Evidence::ClockGaps {
                    gaps: 1,
                    recordings: recordings_of(1),
                    lost: 0.013,
                    from_s: 14.1,
                    longest_ms: 1204.0,
                    period_ms: 1.0,
                },
                stops: false,
                fix: None,
            },
        ],
        other: Some(Box::new(Comparison {
            model: "with-neighbour.toml".to_owned(),
            ..comparison(recordings, 4, 0.35)
        })),
        ..comparison(recordings, 4, 4.0)
    }
}
