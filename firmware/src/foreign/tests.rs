use super::*;
use crate::force::Beside;
use crate::units::Field;

/// A spread of one gauss: 128 units of a field.
const SPREAD: i32 = 128 << FAST_BITS;

fn frame(departures: [i32; SENSORS]) -> [Estimate; SENSORS] {
    departures.map(|departure| Estimate {
        validity: Validity::Valid,
        parity: Beside {
            departure: Field(departure),
            spread: SPREAD,
        },
        ..Estimate::MISSING
    })
}

/// Frames without networks; the flag after the last.
fn watch(detector: &mut Detector, departures: [i32; SENSORS], frames: u32) -> bool {
    let mut flag = false;
    for _ in 0..frames {
        flag = detector.watch(&frame(departures), &mut frame(departures));
    }
    flag
}

/// One that has stood long enough at an offset that means nothing.
fn settled() -> Detector {
    let mut detector = Detector::default();
    assert!(!watch(&mut detector, [700, -300, 0, 50], 10_000));
    detector
}

#[test]
fn a_constant_departure_is_no_magnet_however_large() {
    let detector = settled();
    assert_eq!(detector.measures, Measures::default());
}

#[test]
fn a_departure_of_eight_spreads_is_one_once_the_average_has_followed() {
    // Eight and a half spreads at one sensor: the average is at the root of 56, 7.48, after
    // 8 * ln(8.5 / (8.5 - 7.48)) frames, some 17.
    let mut detector = settled();
    let moved = [700 + 8 * 128 + 64, -300, 0, 50];
    assert!(!watch(&mut detector, moved, 14));
    assert!(watch(&mut detector, moved, 6));
    // Below the limit alone and with no second signal it is not.
    let mut detector = settled();
    assert!(!watch(&mut detector, [700 + 7 * 128, -300, 0, 50], 60));
    assert!(detector.signals.parity && !detector.signals.common);
}

#[test]
fn a_smaller_one_that_all_sensors_share_is_one_by_two_signals() {
    let mut detector = settled();
    // Each is 3.5 spreads: both squares are 49.
    let by = 3 * 128 + 64;
    assert!(watch(&mut detector, [700 + by, -300 + by, by, 50 + by], 60));
    assert!(detector.signals.parity && detector.signals.common && !detector.signals.parity_alone);
    // The same in opposite directions is not common.
    let mut detector = settled();
    assert!(!watch(
        &mut detector,
        [700 + by, -300 - by, by, 50 - by],
        60
    ));
}

#[test]
fn a_slow_wander_is_followed() {
    // A gauss in five seconds, for a minute.
    let mut detector = settled();
    for second in 0..60 {
        let at = second * 26;
        assert!(!watch(
            &mut detector,
            [700 + at, -300 + at, at, 50 + at],
            1000
        ));
    }
}

#[test]
fn the_flag_falls_half_a_second_after_the_last_signal_and_marks_every_estimate() {
    let mut detector = settled();
    assert!(watch(&mut detector, [5000, -300, 0, 50], 30));
    let mut estimates = frame([5000, -300, 0, 50]);
    detector.watch(&frame([5000, -300, 0, 50]), &mut estimates);
    assert!(estimates.iter().all(|estimate| estimate.disturbed));
    assert!(watch(&mut detector, [700, -300, 0, 50], 500));
    assert!(!watch(&mut detector, [700, -300, 0, 50], 60));
}

#[test]
fn a_magnet_that_was_there_for_ten_seconds_leaves_nothing_behind_and_one_that_stays_is_forgotten() {
    let (there, gone) = ([9000, 4000, 0, 50], [700, -300, 0, 50]);
    let mut detector = settled();
    assert!(watch(&mut detector, there, 10_000));
    assert!(!watch(&mut detector, gone, 700));
    assert!(watch(&mut detector, there, 59_000));
    assert!(!watch(&mut detector, there, 2_500));
    // It is told when it goes.
    assert!(watch(&mut detector, gone, 50));
}

#[test]
fn a_sensor_that_was_missing_begins_anew_and_cannot_be_common() {
    let mut detector = settled();
    let mut lost = frame([700, -300, 0, 50]);
    lost[2] = Estimate::MISSING;
    detector.watch(&lost, &mut lost.clone());
    assert!(!watch(&mut detector, [700, -300, 9000, 50], 400));
}

#[test]
fn a_network_that_does_not_know_and_disagrees_is_two_signals() {
    let ideal = frame([0; SENSORS]);
    let mut told = ideal;
    told[1].force = [Force(41 << 10), Force(0)];
    told[1].told_sigma = Some([Force(26 << 10), Force(0)]);
    let mut detector = Detector::default();
    for frame in 1..=5 {
        assert_eq!(detector.watch(&ideal, &mut told.clone()), frame == 5);
    }
    assert!(detector.signals.sigma && detector.signals.split);
}

#[test]
fn the_ends_of_every_range_are_survived() {
    let mut detector = Detector::default();
    for departure in [i32::MIN, i32::MAX, 0, i32::MIN] {
        watch(&mut detector, [departure; SENSORS], 300);
    }
    let mut no_spread = frame([9; SENSORS]);
    no_spread[0].parity.spread = 0;
    detector.watch(&no_spread, &mut no_spread.clone());
}
