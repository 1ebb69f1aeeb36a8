//! Between screw and nut there is play: the opening lags behind the motor.

use super::memory::stop;
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// A play below this cannot be told from none; it keeps the operator defined, in mm.
const LEAST_MM: f64 = 1e-3;

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "screw_backlash",
    stage: Stage::Opening,
    physics: "The nut has a little room on its screw. When the motor turns back, the fingers stay until \
              that room is used up, so the opening that the motor's angle tells is wrong by half the play, \
              in a direction that depends on where it came from. The field only feels it through what \
              depends on the opening: the neighbour's magnet. Add that first.",
    equation: "opening = play operator of the measured opening",
    regressors: "d(neighbour field)/d(opening) times the direction of travel",
    needs: &["opening_mm"],
    shows_against: &["opening_mm"],
    parameters: &[
        Parameter::coefficient("play", "mm", 0.1),
        Parameter::beginning("begin", "", 0.5),
    ],
    size: Size {
        words: "play",
        unit: "mm",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.1,
        plausible: (0.0, 0.5),
        possible: (0.0, 5.0),
    },
    record: "Close and open slowly around a small opening, where the neighbour is felt most, reversing \
              often.",
    confused_with: &[("neighbour_magnet", "where the gripper never reverses")],
    undone: Undone::Never(
        "the device sees the motor's angle, and so small a play is below its noise; zero it by homing from one side",
    ),
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let Some((&play_mm, beginnings)) = values.split_first() else {
        return;
    };
    let half = 0.5 * play_mm;
    let begin = beginnings.get(track.recording).copied().unwrap_or(0.0);
    let slider = stop(&series.opening_mm, half.abs().max(LEAST_MM), begin);
    for (opening, slider) in series.opening_mm.iter_mut().zip(slider) {
        *opening -= half * slider;
    }
}
