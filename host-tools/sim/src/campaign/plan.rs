//! Plan of a recording: loads, motion, orientation and temperature, step by step. `diagnose --plan` proposes one, `record --plan`
//! carries it out with a person, `simulate --plan` with a simulated gripper.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use anyhow::{Context, Result, bail};
use model_export::input;
use serde::{Deserialize, Serialize};

use crate::motion::{OpeningProfile, Orientation};
use crate::random::smoothstep;

/// Loads of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LoadPattern {
    /// No load.
    #[default]
    None,
    /// Cycles that become smaller, about one in two seconds: friction, stiffness, coupling.
    Cycles,
    /// Cycles of 1.5 to 2.1 Hz at 60 % of the amplitude: delays and damping.
    Fast,
    /// Constant load over the first 60 % of the step, then none: creep.
    Hold,
}

/// Orientation during a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AttitudePattern {
    /// Level and at rest.
    #[default]
    Level,
    /// Turned about all axes and back.
    Turning,
    /// Level, shaken along all axes.
    Shaken,
}

/// One step of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanStep {
    /// Duration in seconds.
    pub seconds: f64,
    /// Loads on every finger.
    #[serde(default)]
    pub load: LoadPattern,
    /// Amplitude of the lateral and the longitudinal load in newtons.
    #[serde(default)]
    pub load_n: [f64; 2],
    /// Limits in mm between which the opening moves; equal where it rests.
    pub opening_mm: [f64; 2],
    /// Change of the temperature during the step, in kelvin.
    #[serde(default)]
    pub temperature_k: f64,
    /// Orientation.
    #[serde(default)]
    pub attitude: AttitudePattern,
}

/// Plan of a recording, or of two: what a model learns from one is validated on another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingPlan {
    /// What it decides, for people.
    #[serde(default)]
    pub decides: Vec<String>,
    /// Number of recordings with the same steps; in every second one the temperature changes the other way.
    #[serde(default = "one")]
    pub recordings: u32,
    /// Whether this one is a second recording, with other frequencies: what repeats exactly validates nothing.
    #[serde(skip)]
    is_second: bool,
    /// Steps in their order.
    #[serde(rename = "step")]
    pub steps: Vec<PlanStep>,
}

fn one() -> u32 {
    1
}

/// Ranges of the values of a plan (those of the time and the number of steps are for a person's patience).
const SECONDS: [f64; 2] = [2.0, 120.0];
const MAX_STEPS: usize = 30;
const MAX_RECORDINGS: u32 = 10;
const MAX_LOAD_N: f64 = 2000.0;
const MAX_OPENING_MM: f64 = 500.0;
const MAX_CHANGE_K: f64 = 60.0;

/// A stroke of the opening in every first and second recording, and the rest after it, in seconds.
const STROKE_S: [f64; 2] = [1.6, 1.9];
const REST_S: f64 = 0.4;
/// Ends of the strokes within their range. Strokes of one length would repeat one relation of opening, speed and current.
const STROKE_ENDS: [f64; 7] = [1.0, 0.25, 0.75, 0.1, 0.6, 0.0, 0.9];
/// Frequency of the motor's holding current in every first and second recording.
const HOLDING_HZ: [f64; 2] = [0.23, 0.37];
/// Frequencies of the loads in every second recording, relative to those in the first.
const SECOND_HZ: f64 = 1.17;
/// Time in which a load begins and ends.
const RAMP_S: f64 = 0.5;
/// Frequencies of the lateral and the longitudinal load.
const CYCLES_HZ: [f64; 2] = [0.43, 0.57];
const FAST_HZ: [f64; 2] = [1.5, 2.1];
/// Amplitude of fast cycles, and of the smallest slow cycle, relative to the load of the step.
const FAST_SHARE: f64 = 0.6;
const LEAST_SHARE: f64 = 0.3;
/// Fraction of a step during which a constant load is held.
const HELD: f64 = 0.6;
/// Phase between the loads of two sensors.
const SENSOR_PHASE_RAD: f64 = 0.7;
/// Largest roll, pitch and yaw while turning.
const TURN_RAD: [f64; 3] = [1.4, 1.0, 2.5];
/// Amplitude in m/s^2 and frequencies while shaken.
const SHAKE_MPS2: f64 = 3.0;
const SHAKE_HZ: [f64; 3] = [1.3, 1.9, 1.6];

impl RecordingPlan {
    /// One recording of these steps.
    pub fn new(steps: Vec<PlanStep>) -> Self {
        Self { decides: Vec::new(), recordings: 1, is_second: false, steps }
    }

    /// So many recordings of these steps.
    pub fn repeated(self, recordings: u32) -> Self {
        Self { recordings, ..self }
    }

    /// The recording with this number, from 1; `None` where the plan has fewer.
    pub fn recording(&self, number: u32) -> Option<Self> {
        if !(1..=self.recordings).contains(&number) {
            return None;
        }
        let mut one = Self { recordings: 1, ..self.clone() };
        if number.is_multiple_of(2) {
            one.is_second = true;
            for step in &mut one.steps {
                // Zero stays positive.
                step.temperature_k = 0.0 - step.temperature_k;
            }
        }
        Some(one)
    }

    /// Reads and checks a plan.
    ///
    /// # Errors
    /// No file, no plan, or a value that no recording can have.
    pub fn read(path: &Path) -> Result<Self> {
        let text = input::read_text(path)?;
        let plan: Self = toml::from_str(&text)
            .with_context(|| format!("{}: not a plan of a recording", path.display()))?;
        plan.check().with_context(|| format!("{}: not a plan of a recording", path.display()))?;
        Ok(plan)
    }

    /// Checks that a recording can have its values.
    ///
    /// # Errors
    /// One is out of range.
    pub fn check(&self) -> Result<()> {
        if self.steps.is_empty() || self.steps.len() > MAX_STEPS {
            bail!("{} steps; give 1 to {MAX_STEPS} tables [[step]]", self.steps.len());
        }
        if !(1..=MAX_RECORDINGS).contains(&self.recordings) {
            bail!("recordings = {}; give 1 to {MAX_RECORDINGS}", self.recordings);
        }
        for (number, step) in (1..).zip(&self.steps) {
            let within = |name: &str, value: f64, [low, high]: [f64; 2]| {
                if (low..=high).contains(&value) {
                    return Ok(());
                }
                bail!("step {number}: {name} = {value:?}; give {low} to {high}")
            };
            within("seconds", step.seconds, SECONDS)?;
            within("temperature_k", step.temperature_k, [-MAX_CHANGE_K, MAX_CHANGE_K])?;
            for value in step.load_n {
                within("load_n", value, [0.0, MAX_LOAD_N])?;
            }
            for value in step.opening_mm {
                within("opening_mm", value, [0.0, MAX_OPENING_MM])?;
            }
            if step.load == LoadPattern::None && step.load_n != [0.0; 2] {
                bail!(
                    "step {number}: load_n without a load; add load = \"cycles\", \"fast\" or \"hold\""
                );
            }
        }
        Ok(())
    }

    /// As a file.
    ///
    /// # Errors
    /// The values cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).context("cannot write the plan as TOML")
    }

    /// Duration of one recording in seconds.
    pub fn seconds(&self) -> f64 {
        self.steps.iter().fold(0.0, |sum, step| sum + step.seconds)
    }

    /// The step at a time, and the time since its start; the last step also after its end.
    fn step_at(&self, time_s: f64) -> Option<(&PlanStep, f64)> {
        let mut found = None;
        let mut start_s = 0.0;
        for step in &self.steps {
            found = Some((step, time_s - start_s));
            start_s += step.seconds;
            if time_s < start_s {
                break;
            }
        }
        found
    }

    /// Lateral and longitudinal load on a sensor in newtons.
    pub fn load_n(&self, sensor: usize, time_s: f64) -> [f64; 2] {
        let Some((step, since_s)) = self.step_at(time_s) else { return [0.0; 2] };
        let share = (since_s / step.seconds).clamp(0.0, 1.0);
        let phase = SENSOR_PHASE_RAD * sensor as f64;
        let ramp = |until_s: f64| {
            smoothstep(since_s, 0.0, RAMP_S)
                * (1.0 - smoothstep(since_s, until_s - RAMP_S, until_s))
        };
        std::array::from_fn(|axis| {
            let faster = if self.is_second { SECOND_HZ } else { 1.0 };
            let wave = |hz: f64| libm::sin(TAU * faster * hz * since_s + phase + axis as f64);
            let relative = match step.load {
                LoadPattern::None => 0.0,
                LoadPattern::Cycles => {
                    let smaller = 1.0 - (1.0 - LEAST_SHARE) * share;
                    ramp(step.seconds) * smaller * wave(CYCLES_HZ[axis])
                }
                LoadPattern::Fast => ramp(step.seconds) * FAST_SHARE * wave(FAST_HZ[axis]),
                LoadPattern::Hold => ramp(HELD * step.seconds),
            };
            step.load_n[axis] * relative
        })
    }

    /// Change of the temperature since the start of the first recording, in kelvin.
    pub fn warming_k(&self, time_s: f64) -> f64 {
        let mut start_s = 0.0;
        // A second recording ends at the temperature at which the first one began.
        let whole: f64 = self.steps.iter().map(|step| step.temperature_k).sum();
        let mut sum = if self.is_second { -whole } else { 0.0 };
        for step in &self.steps {
            sum += step.temperature_k * smoothstep(time_s, start_s, start_s + step.seconds);
            start_s += step.seconds;
        }
        sum
    }

    /// Orientation and specific force.
    pub fn orientation(&self, time_s: f64) -> Orientation {
        let (mut angles_rad, mut acceleration) = ([0.0; 3], [0.0; 3]);
        let Some((step, since_s)) = self.step_at(time_s) else {
            return Orientation::new(angles_rad, acceleration.into());
        };
        let share = (since_s / step.seconds).clamp(0.0, 1.0);
        match step.attitude {
            AttitudePattern::Turning => {
                // All are zero at both ends, where the next step begins.
                let turns = [1.0, 2.0, 0.5];
                angles_rad =
                    std::array::from_fn(|i| TURN_RAD[i] * libm::sin(TAU * turns[i] * share));
            }
            AttitudePattern::Shaken => {
                let window = libm::sin(PI * share);
                acceleration =
                    SHAKE_HZ.map(|hz| SHAKE_MPS2 * window * libm::sin(TAU * hz * since_s));
            }
            AttitudePattern::Level => {}
        }
        Orientation::new(angles_rad, acceleration.into())
    }

    /// Opening and motor; `rotor_rad` is the rotor's angle at the screw's zero.
    pub fn opening(&self, rotor_rad: f64) -> OpeningProfile {
        let mut at_mm = self.steps.first().map_or(0.0, |step| step.opening_mm[0]);
        let mut profile = OpeningProfile::resting(at_mm, rotor_rad);
        let mut start_s = 0.0;
        let kind = usize::from(self.is_second);
        let mut ends = STROKE_ENDS.into_iter().cycle();
        for step in &self.steps {
            let end_s = start_s + step.seconds;
            let [from_mm, to_mm] = step.opening_mm;
            let mut time_s = start_s;
            while time_s + STROKE_S[kind] <= end_s {
                let next_mm = from_mm + ends.next().unwrap_or_default() * (to_mm - from_mm);
                if next_mm != at_mm {
                    profile.add_stroke(time_s, STROKE_S[kind], next_mm, HOLDING_HZ[kind]);
                    at_mm = next_mm;
                }
                time_s += STROKE_S[kind] + REST_S;
            }
            start_s = end_s;
        }
        profile
    }
}

impl PlanStep {
    /// Quantities that vary, by their names in the coverage of a recording, with the width of their range in N, mm, K, rad and
    /// m/s^2.
    pub fn ranges(&self) -> Vec<(&'static str, f64)> {
        let peak_to_peak = match self.load {
            LoadPattern::None => 0.0,
            LoadPattern::Cycles => 2.0,
            LoadPattern::Fast => 2.0 * FAST_SHARE,
            LoadPattern::Hold => 1.0,
        };
        let [x_n, z_n] = self.load_n.map(|newtons| newtons * peak_to_peak);
        let [from_mm, to_mm] = self.opening_mm;
        let mut ranges = vec![
            ("lateral force", x_n),
            ("longitudinal force", z_n),
            ("opening", (to_mm - from_mm).abs()),
            ("temperature", self.temperature_k.abs()),
        ];
        match self.attitude {
            AttitudePattern::Level => {}
            AttitudePattern::Turning => {
                let [roll, pitch, yaw] = TURN_RAD;
                // The yaw turns to one side and back.
                let widths = [2.0 * roll, 2.0 * pitch, yaw];
                ranges.extend(["roll", "pitch", "yaw"].into_iter().zip(widths));
            }
            AttitudePattern::Shaken => {
                let along = ["acceleration along x", "acceleration along z"];
                ranges.extend(along.map(|quantity| (quantity, 2.0 * SHAKE_MPS2)));
            }
        }
        ranges.retain(|(_, width)| *width > 0.0);
        ranges
    }

    /// What a person does.
    pub fn instruction(&self) -> String {
        let [x, z] = self.load_n;
        let mut parts = vec![match self.load {
            LoadPattern::None => "do not load the fingers".to_owned(),
            LoadPattern::Cycles => format!(
                "load each finger to and fro, about two seconds a cycle, first up to {x:.0} N lateral and {z:.0} N longitudinal, then less and less"
            ),
            LoadPattern::Fast => format!(
                "load each finger to and fro, two cycles a second, up to {:.0} N lateral and {:.0} N longitudinal",
                FAST_SHARE * x,
                FAST_SHARE * z
            ),
            LoadPattern::Hold => format!(
                "hold {x:.0} N lateral and {z:.0} N longitudinal for {:.0} s, then release",
                HELD * self.seconds
            ),
        }];
        let [from, to] = self.opening_mm;
        if from == to {
            parts.push(format!("keep the opening at {from:.0} mm"));
        } else {
            parts.push(format!(
                "open and close between {from:.0} and {to:.0} mm in strokes of different lengths"
            ));
        }
        match self.temperature_k {
            0.0 => {}
            change if change > 0.0 => parts.push(format!("warm by {change:.0} K")),
            change => parts.push(format!("cool by {:.0} K", -change)),
        }
        match self.attitude {
            AttitudePattern::Level => {}
            AttitudePattern::Turning => parts.push("turn the gripper about all axes".to_owned()),
            AttitudePattern::Shaken => parts.push("shake the gripper along all axes".to_owned()),
        }
        parts.join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: PlanStep = PlanStep {
        seconds: 10.0,
        load: LoadPattern::Hold,
        load_n: [100.0, 50.0],
        opening_mm: [10.0, 30.0],
        temperature_k: 4.0,
        attitude: AttitudePattern::Turning,
    };

    fn read(text: &str) -> Result<RecordingPlan> {
        let folder = tempfile::TempDir::new()?;
        let path = folder.path().join("plan.toml");
        std::fs::write(&path, text)?;
        RecordingPlan::read(&path)
    }

    #[test]
    fn file_is_read_as_written() {
        let mut plan = RecordingPlan::new(vec![STEP, PlanStep { load: LoadPattern::Fast, ..STEP }]);
        (plan.recordings, plan.decides) = (2, vec!["thermal_gap".to_owned()]);
        assert_eq!(read(&plan.to_toml().unwrap()).unwrap(), plan);
    }

    #[test]
    fn invalid_plans_are_refused_with_the_reason() {
        let step = "[[step]]\nseconds = 5\nopening_mm = [10, 10]\n";
        for (text, reason) in [
            (String::new(), "missing field `step`"),
            ("step = []".to_owned(), "0 steps"),
            (step.replace("5", "nan"), "seconds = NaN; give 2 to 120"),
            (step.replace("5", "1"), "seconds = 1.0; give 2 to 120"),
            (format!("{step}temperature_k = -80"), "step 1: temperature_k = -80.0; give -60 to 60"),
            (format!("{step}load_n = [5, 5]"), "load_n without a load"),
            (format!("{step}load = \"heavy\""), "unknown variant `heavy`"),
            (format!("{step}weight = 1"), "unknown field `weight`"),
            (format!("recordings = 0\n{step}"), "recordings = 0; give 1 to 10"),
        ] {
            let error = format!("{:#}", read(&text).unwrap_err());
            assert!(error.contains(reason) && error.contains("plan.toml"), "{text}: {error}");
        }
        assert_eq!(read(step).unwrap().steps[0].load, LoadPattern::None);
    }

    #[test]
    fn constant_load_is_held_and_released() {
        let plan = RecordingPlan::new(vec![STEP]);
        assert_eq!(plan.load_n(0, 0.0), [0.0; 2]);
        assert_eq!(plan.load_n(0, 3.0), [100.0, 50.0]);
        // Held for 6 s of 10.
        assert_eq!(plan.load_n(0, 6.5), [0.0; 2]);
    }

    #[test]
    fn second_recording_cools_what_the_first_warmed() {
        let mut plan = RecordingPlan::new(vec![STEP, PlanStep { temperature_k: 3.0, ..STEP }]);
        plan.recordings = 2;
        let [first, second] = [1, 2].map(|number| plan.recording(number).unwrap());
        assert_eq!([0.0, 10.0, 20.0].map(|time_s| first.warming_k(time_s)), [0.0, 4.0, 7.0]);
        assert_eq!([0.0, 10.0, 20.0].map(|time_s| second.warming_k(time_s)), [7.0, 3.0, 0.0]);
        assert_eq!(plan.recording(3), None);
        // Neither loads nor openings repeat.
        assert_ne!(first.load_n(0, 2.0), [0.0; 2]);
        let fast =
            |plan: &RecordingPlan| PlanStep { load: LoadPattern::Fast, ..plan.steps[0].clone() };
        let load = |plan: &RecordingPlan| {
            RecordingPlan { steps: vec![fast(plan)], ..plan.clone() }.load_n(0, 2.0)
        };
        assert_ne!(load(&first), load(&second));
        let opening = |plan: &RecordingPlan| plan.opening(0.0).at(3.0);
        assert_ne!(opening(&first), opening(&second));
    }

    #[test]
    fn excitation_reaches_the_ranges_of_its_steps_and_no_more() {
        for load in [LoadPattern::None, LoadPattern::Cycles, LoadPattern::Fast, LoadPattern::Hold] {
            for attitude in
                [AttitudePattern::Level, AttitudePattern::Turning, AttitudePattern::Shaken]
            {
                let load_n = if load == LoadPattern::None { [0.0; 2] } else { STEP.load_n };
                let step = PlanStep { load, load_n, attitude, ..STEP };
                let plan = RecordingPlan::new(vec![step.clone()]);
                let opening = plan.opening(0.0);
                let times = (0..=1000).map(|row| 0.01 * f64::from(row));
                let rows = times.map(|time_s| {
                    let orientation = plan.orientation(time_s);
                    let [roll, pitch, yaw] = orientation.angles_rad;
                    let force = orientation.specific_force;
                    let [x_n, z_n] = plan.load_n(1, time_s);
                    let opening_mm = opening.at(time_s).opening_mm;
                    [
                        x_n,
                        z_n,
                        opening_mm,
                        plan.warming_k(time_s),
                        roll,
                        pitch,
                        yaw,
                        force.x,
                        force.z,
                    ]
                });
                let rows: Vec<[f64; 9]> = rows.collect();
                let names = [
                    "lateral force",
                    "longitudinal force",
                    "opening",
                    "temperature",
                    "roll",
                    "pitch",
                    "yaw",
                    "acceleration along x",
                    "acceleration along z",
                ];
                for (place, name) in names.into_iter().enumerate() {
                    let column = || rows.iter().map(|row| row[place]);
                    let width =
                        column().fold(f64::MIN, f64::max) - column().fold(f64::MAX, f64::min);
                    let range = step.ranges().into_iter().find(|(own, _)| *own == name);
                    match range {
                        Some((_, range)) => {
                            let share = width / range;
                            assert!((0.85..=1.001).contains(&share), "{name} {step:?}: {share}");
                        }
                        // Gravity turns with the gripper.
                        None if attitude == AttitudePattern::Turning => {}
                        None => assert!(width < 1e-9, "{name} {step:?}: {width}"),
                    }
                }
            }
        }
    }
}
