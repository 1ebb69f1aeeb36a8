//! Text of notes: one sentence for each.

use std::ffi::OsString;
use std::path::PathBuf;

use analysis::notes::{Note, UncompensatedEffect};
use model_export::inverse::device_support::DeviceSupport;
use model_export::recordings::recording::recording_name;

use crate::text::comparison::conclusion::missing_forces;
use crate::text::findings;

/// The note as a sentence, without a full stop.
pub fn text(note: &Note) -> String {
    match note {
        Note::Recording(notice) => notice.to_string(),
        Note::SetupError(finding) => {
            let fix = if finding.fix.is_some() {
                " (`cargo magpie fit CAMPAIGN --fix NEW` fits a corrected copy)"
            } else {
                ""
            };
            format!("{}: {}{fix}", finding.place, findings::message(finding))
        }
        Note::OtherDelay { model, fitted_ms, delay_ms } => format!(
            "{} was fitted with a delay of {fitted_ms} ms; these recordings are read with {delay_ms} ms, as given",
            model.display()
        ),
        Note::OtherDesign { recording } => format!(
            "{}: [design] differs from the model's: is it the same gripper? A fit uses that of the recordings",
            recording.display()
        ),
        Note::OtherRecordings { campaign } => format!(
            "the model was fitted to {campaign}, to none of these recordings: only its base and its effects are used, fitted again; the errors \
             are not those of the file, which `compare` and `replay` show"
        ),
        Note::OtherGripper { floors } => format!(
            "the model's prediction is off by a constant on most channels, {floors:.0} times the noise: was this model fitted to another gripper? Run `cargo magpie fit` on these recordings"
        ),
        Note::NotReplayed { sensor } => format!(
            "sensor {sensor} of the model was not replayed: these recordings lack its field or its forces"
        ),
        Note::NoValidEstimate { sensor } => format!(
            "no estimate of sensor {sensor} is valid: its field is saturated, or outside of what its model can give; the errors are without this sensor: check its columns, and bias, gap and remanence in the model"
        ),
        Note::NotRecorded { sensor } => format!(
            "sensor {sensor} of the model has no field or no forces in these recordings and is ignored"
        ),
        Note::NotInModel { sensor } => {
            format!("sensor {sensor} of the recordings is not in the model and is ignored")
        }
        Note::NoNetwork { sensor } => format!(
            "sensor {sensor} of the model gets no network: these recordings lack its field or its forces"
        ),
        Note::Uncompensated(effect) => uncompensated(effect),
        Note::NotCompensable(error) => error.to_string(),
        Note::NoForces(why) => format!("no force error: {}", missing_forces(why)),
        Note::MissingInputs { estimates, effects } => format!(
            "{estimates} estimates lack the compensation of an effect, because its input column was not recorded; effects of the model: {}",
            effects.join(", ")
        ),
        Note::EffectWithoutColumn { effect, column } => format!(
            "these recordings have no column {column}: they are predicted without the model's effect {effect}, and its error is in what follows"
        ),
        Note::ConstantCovariate { column, effect, record } => {
            let advice = record.map_or_else(String::new, |record| format!(". Record: {record}"));
            format!(
                "{column} is constant in these recordings: {effect} is not identifiable{advice}"
            )
        }
        Note::IdealModelNotHeldOut { recording } => format!(
            "the model was fitted to recording {recording} too: the ideal model's error there is not held out"
        ),
    }
}

/// All notes as sentences. Notices of several recordings that differ only in their numbers are one, with those of the first.
pub fn texts(notes: &[Note]) -> Vec<String> {
    let mut groups: Vec<(&Note, Option<NoticeKind>, Vec<String>)> = Vec::new();
    for note in notes {
        let (kind, recording) = notice_kind(note).unzip();
        let is_other = |known: &[String]| !known.iter().any(|one| Some(one) == recording.as_ref());
        let same = groups
            .iter_mut()
            .find(|(_, other, known)| kind.is_some() && *other == kind && is_other(known));
        match same {
            Some((_, _, recordings)) => recordings.extend(recording),
            None => groups.push((note, kind, recording.into_iter().collect())),
        }
    }
    let sentence = |(note, _, recordings): (&Note, _, Vec<String>)| {
        let which = match recordings.as_slice() {
            [] | [_] => return text(note),
            names if names.len() > LISTED => format!("{} recordings", names.len()),
            names => format!("recordings {}", names.join(", ")),
        };
        format!("{} ({which}; the numbers are those of the first)", text(note))
    };
    groups.into_iter().map(sentence).collect()
}

/// Recordings that a note lists.
const LISTED: usize = 8;

/// Campaign, file name, column, and message without its numbers.
type NoticeKind = (PathBuf, OsString, Option<String>, String);

/// What a notice has in common with those of other recordings, and its recording.
fn notice_kind(note: &Note) -> Option<(NoticeKind, String)> {
    let Note::Recording(notice) = note else { return None };
    let place = &notice.location;
    let file = place.file.file_name()?.to_owned();
    place.line?;
    let folder = place.file.parent()?;
    // The digits of a name are not a number: sensors of other recordings may be others.
    let is_number = |word: &&str| !word.contains(|c: char| c.is_alphabetic() || c == '_');
    let words = notice.message.split(' ').filter(|word| !is_number(word));
    let kind = (folder.parent()?.to_owned(), file, place.column.clone(), words.collect());
    Some((kind, recording_name(folder)))
}

pub fn device_support(support: &DeviceSupport) -> String {
    format!("{} runs on the device: {support}.", support.effect)
}

/// An effect without compensation, and the reason.
pub fn uncompensated(effect: &UncompensatedEffect) -> String {
    format!("{} is not compensated: {}", effect.effect, effect.reason)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use model_export::inverse::compensation::NotCompensable;
    use model_export::recordings::{Location, Notice};

    #[test]
    fn note_that_carries_an_error_states_it() {
        let (effect, why) = ("creep".to_owned(), "the error".to_owned());
        let note = Note::NotCompensable(NotCompensable { effect, sensor: 2, why });
        let expected = "creep of sensor 2 cannot be compensated on the device: the error";
        assert_eq!(text(&note), expected);
    }

    #[test]
    fn equal_notices_of_several_recordings_are_one() {
        let notice = |recording: &str, file: &str, message: &str| {
            let location = Location::file(&Path::new("bench").join(recording).join(file)).line(7);
            Note::Recording(Notice { location, message: message.to_owned() })
        };
        let notes = [
            notice("1", "hall.csv", "19 gaps of 1.5 ms"),
            notice("1", "force.csv", "19 gaps of 1.5 ms"),
            notice("2", "hall.csv", "20 gaps of 33 ms"),
            notice("2", "hall.csv", "2 rows are saturated"),
            notice("2", "hall.csv", "21 gaps of 34 ms"),
            notice("1", "hall.csv", "s0 is dark"),
            notice("2", "hall.csv", "s1 is dark"),
        ];
        let expected = [
            "bench/1/hall.csv, line 7: 19 gaps of 1.5 ms (recordings 1, 2; the numbers are those of the first)",
            "bench/1/force.csv, line 7: 19 gaps of 1.5 ms",
            "bench/2/hall.csv, line 7: 2 rows are saturated",
            "bench/2/hall.csv, line 7: 21 gaps of 34 ms",
            "bench/1/hall.csv, line 7: s0 is dark",
            "bench/2/hall.csv, line 7: s1 is dark",
        ];
        assert_eq!(texts(&notes), expected);
    }

    #[test]
    fn constant_covariate_of_a_formula_has_no_advice() {
        let note = |record| Note::ConstantCovariate {
            column: "opening_mm".to_owned(),
            effect: "own".to_owned(),
            record,
        };
        let sentence = "opening_mm is constant in these recordings: own is not identifiable";
        assert_eq!(text(&note(None)), sentence);
        assert_eq!(text(&note(Some("Move it."))), format!("{sentence}. Record: Move it."));
    }
}
