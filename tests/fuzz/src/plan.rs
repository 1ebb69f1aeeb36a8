//! Plans of recordings, read from files, and the loads, strokes and temperatures that they give.

use std::fs;

use sim::campaign::plan::RecordingPlan;

use super::bytes::{Bytes, change};

/// Words of a step, with one that is none.
const LOADS: [&str; 5] = ["none", "cycles", "fast", "hold", "heavy"];
const ATTITUDES: [&str; 4] = ["level", "turning", "shaken", "upright"];
/// Rotor angle at the screw's zero, any.
const ROTOR_RAD: f64 = 0.3;
/// Rounding of sums over the steps.
const ROUNDING: f64 = 1e-9;

/// Results of reading a plan.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub accepted: u32,
    pub refused: u32,
    /// Times at which loads, opening and temperature were compared with the limits of the plan.
    pub compared: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<3> {
        [("accepted", self.accepted), ("refused", self.refused), ("compared", self.compared)]
    }
}

/// A plan as text, and whether it must be accepted.
struct Source {
    text: String,
    is_valid: bool,
}

/// Reads one plan: a valid one is accepted and stays within its own limits; others have an error.
pub fn read(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let kind = bytes.byte();
    let mut source = source(&mut bytes);
    let is_changed = kind & 3 == 0;
    if is_changed {
        for _ in 0..=bytes.byte() % 3 {
            change(&mut source.text, &mut bytes);
        }
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("plan.toml");
    fs::write(&path, &source.text).expect("a temporary file");
    let mut tally = Tally::default();
    match RecordingPlan::read(&path) {
        Ok(plan) => {
            assert!(is_changed || source.is_valid, "accepted:\n{}", source.text);
            tally.accepted = 1;
            fs::write(&path, plan.to_toml().expect("a checked plan")).expect("a temporary file");
            assert_eq!(RecordingPlan::read(&path).expect("its own text"), plan);
            for number in 1..=plan.recordings {
                let recording = plan.recording(number).expect("one of its recordings");
                tally.compared += compare(&recording, &mut bytes);
            }
            assert!(plan.recording(plan.recordings + 1).is_none());
        }
        Err(error) => {
            assert!(is_changed || !source.is_valid, "refused: {error:#}\n{}", source.text);
            assert!(!format!("{error:#}").trim().is_empty());
            tally.refused = 1;
        }
    }
    tally
}

/// Compares a recording with the limits of its steps at some times; returns how many.
fn compare(recording: &RecordingPlan, bytes: &mut Bytes) -> u32 {
    let largest = |of: fn(&sim::campaign::plan::PlanStep) -> f64| {
        recording.steps.iter().map(of).fold(0.0, f64::max)
    };
    let [x_n, z_n] = [largest(|step| step.load_n[0]), largest(|step| step.load_n[1])];
    let highest_mm = largest(|step| step.opening_mm[0].max(step.opening_mm[1]));
    let lowest_mm = recording
        .steps
        .iter()
        .map(|step| step.opening_mm[0].min(step.opening_mm[1]))
        .fold(f64::INFINITY, f64::min);
    let change_k: f64 = recording.steps.iter().map(|step| step.temperature_k.abs()).sum();
    let profile = recording.opening(ROTOR_RAD);
    const TIMES: u32 = 4;
    for _ in 0..TIMES {
        // After the end too.
        let time_s = recording.seconds() * f64::from(bytes.word()) / 60_000.0;
        let [x, z] = recording.load_n(usize::from(bytes.byte() & 3), time_s);
        assert!(x.abs() <= x_n + ROUNDING && z.abs() <= z_n + ROUNDING, "{x} N, {z} N");
        let opening_mm = profile.at(time_s).opening_mm;
        let within = lowest_mm - ROUNDING..=highest_mm + ROUNDING;
        assert!(within.contains(&opening_mm), "{opening_mm} mm, {within:?}");
        let warming_k = recording.warming_k(time_s);
        assert!(warming_k.abs() <= change_k + ROUNDING, "{warming_k} K");
        let orientation = recording.orientation(time_s);
        assert!(orientation.specific_force.iter().all(|value| value.is_finite()));
    }
    TIMES
}

/// A plan that is valid in most cases.
fn source(bytes: &mut Bytes) -> Source {
    let head = bytes.byte();
    let (recordings, steps) = (u32::from(head & 15) % 12, usize::from(head >> 4 & 3));
    let mut is_valid = (1..=10).contains(&recordings) && steps > 0;
    let mut text = format!("recordings = {recordings}\n");
    for _ in 0..steps {
        let words = bytes.byte();
        // One of eight is no word of a plan.
        let word = |choice: u8, words: usize| {
            if choice == 7 { words - 1 } else { usize::from(choice) % (words - 1) }
        };
        let load = word(words & 7, LOADS.len());
        let attitude = word(words >> 3 & 7, ATTITUDES.len());
        // Within the ranges but for the last values.
        let seconds = 2.0 + f64::from(bytes.byte()) * 119.0 / 255.0;
        let load_n = [bytes.byte(), bytes.byte()].map(|byte| f64::from(byte) * 2010.0 / 255.0);
        let opening_mm = [bytes.byte(), bytes.byte()].map(|byte| f64::from(byte) * 502.0 / 255.0);
        let temperature_k = f64::from(bytes.byte()) * 121.0 / 255.0 - 60.0;
        let load_n = if load == 0 && words >> 6 < 3 { [0.0; 2] } else { load_n };
        is_valid &= load + 1 < LOADS.len() && attitude + 1 < ATTITUDES.len();
        is_valid &= seconds <= 120.0 && temperature_k <= 60.0;
        is_valid &= load_n.iter().all(|load| *load <= 2000.0);
        is_valid &= opening_mm.iter().all(|opening| *opening <= 500.0);
        is_valid &= load > 0 || load_n == [0.0; 2];
        text += &format!(
            "[[step]]\nseconds = {seconds:?}\nload = {:?}\nload_n = {load_n:?}\nopening_mm = {opening_mm:?}\n\
             temperature_k = {temperature_k:?}\nattitude = {:?}\n",
            LOADS[load], ATTITUDES[attitude]
        );
    }
    Source { text, is_valid }
}
