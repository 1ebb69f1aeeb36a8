//! What is told of a grasp: the figures, the states, and what it rests on.

use firmware::grip::states::{Power, Task};
use firmware::params::{self, Constant};

use super::course::Course;
use super::grasp::NOISE_N;
use super::runs::Case;
use super::told;

/// What a grasp rests on beside the drive.
const RESTS_ON: [Constant; 3] = [
    params::CONTACT_STIFFNESS,
    params::STOPPING_TIME,
    params::FORCE_BANDWIDTH,
];

/// A grasp by the firmware, and perhaps another way beside it.
#[derive(Clone, Debug, PartialEq)]
pub struct Gripped {
    /// The drive.
    pub case: Case,
    /// By the firmware's law.
    pub own: Course,
    /// By nothing but a bound of the current.
    pub other: Option<Course>,
}

impl Gripped {
    /// Figures of a course: name, value, unit. What is no number did not happen.
    pub fn figures(course: &Course) -> Vec<(&'static str, f64, &'static str)> {
        let ms = |seconds: Option<f64>| 1e3 * seconds.unwrap_or(f64::NAN);
        let set_n = course.asked.set_n;
        vec![
            ("force asked for", set_n, "N"),
            ("greatest force", course.peak_n(), "N"),
            (
                "beyond what is asked for",
                (course.peak_n() - set_n).max(0.0),
                "N",
            ),
            ("contact to 95 % of it", ms(course.rise_s()), "ms"),
            ("contact to the hold", ms(course.hold_s()), "ms"),
            ("force at the end", course.end_n(), "N"),
            ("its error, root mean square", course.error_n(), "N"),
            ("current at the end", course.current_a(), "A"),
        ]
    }

    /// What the firmware does, in words: "hold latched".
    pub fn state_name((power, task): (Power, Task)) -> String {
        let name = match power {
            Power::Enabled => format!("{task:?}"),
            power => format!("{power:?}"),
        };
        let mut words = String::new();
        for letter in name.chars() {
            if letter.is_uppercase() && !words.is_empty() {
                words.push(' ');
            }
            words.extend(letter.to_lowercase());
        }
        words
    }

    /// States of the firmware's own grasp, each with the seconds since the contact at which it began.
    pub fn states(&self) -> Vec<(f64, String)> {
        let states = self.own.states().into_iter();
        states
            .map(|(time_s, power, task)| (time_s, Self::state_name((power, task))))
            .collect()
    }

    /// The grasp in a sentence.
    pub fn sentence(&self) -> String {
        let (lead, asked) = (self.case.lead, &self.own.asked);
        format!(
            "Screw {lead:?} grips with {} N something that gives way by a millimetre for {} N, flexures \
             included; seed {}. The firmware's own grasp and motor control on a simulated gripper; each finger's \
             force is sensed with {NOISE_N} N of noise, a millisecond late.",
            asked.set_n, asked.contact_n_per_mm, self.case.seed
        )
    }

    /// The assumed constants that it rests on.
    pub fn assumed(&self) -> Vec<Constant> {
        told::assumed(self.case.lead, &RESTS_ON)
    }
}
