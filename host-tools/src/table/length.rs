//! How the held-out error falls with the seconds that are learned from: what physics buys.

use anyhow::Result;
use model_export::gru::unfit::Unfit;

use super::data::Data;
use super::judge::{Judged, judge};
use super::refit::{Refitted, refit};
use super::teach::{Lessons, Plan};
use super::variant::Variant;

/// Seconds that are learned from, in turn; those that the campaign has not are left out.
const SECONDS: [f64; 6] = [5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
/// Closer than this to all there is, a length is all there is.
const NEARLY_ALL: f64 = 0.9;
/// The ways whose error is followed.
pub const FOLLOWED: [Variant; 5] = [
    Variant::IdealFitted,
    Variant::Gru3Axis,
    Variant::Gru3AxisIdeal,
    Variant::Physics,
    Variant::PhysicsGru,
];

/// One way after so many seconds.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Seconds, of which networks keep a fifth to tell when to stop.
    pub seconds: f64,
    /// The way.
    pub variant: Variant,
    /// Root mean square error of the device over both forces, in newtons.
    pub rmse_n: f64,
    /// The same after the tare.
    pub tared_rmse_n: Option<f64>,
}

impl Point {
    fn of(seconds: f64, judged: &Judged) -> Self {
        Self {
            seconds,
            variant: judged.variant,
            rmse_n: judged.rmse_n(),
            tared_rmse_n: judged.tared_rmse_n(),
        }
    }
}

/// Lengths below all that there is, where they are wanted.
pub fn shorter(data: &Data) -> Vec<f64> {
    let all = data.training_s();
    let short = SECONDS
        .into_iter()
        .filter(|s| data.curve && *s < NEARLY_ALL * all);
    short.collect()
}

/// Seconds of every training that the table takes.
pub fn trainings(data: &Data) -> Vec<f64> {
    let networks = |ways: &[Variant]| {
        let with_effects = !data.effects.is_empty();
        let ways = ways.iter().filter(|way| way.topology(1).is_some());
        ways.filter(|way| with_effects || **way != Variant::PhysicsGru)
            .count()
    };
    let mut all = vec![data.training_s(); networks(&Variant::ALL)];
    for seconds in shorter(data) {
        all.extend(std::iter::repeat_n(seconds, networks(&FOLLOWED)));
    }
    all
}

/// Fits, trains and judges on ever more seconds; all of them are in the table already.
pub fn compute(data: &Data, plan: &Plan, table: &[Judged]) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for seconds in shorter(data) {
        // A few seconds may be too few for a fit: then there is no point, and no pretence of one.
        let Ok(refitted) = refit(data, seconds) else {
            continue;
        };
        points.extend(after(data, plan, &refitted, seconds)?);
    }
    let whole = table.iter().filter(|way| FOLLOWED.contains(&way.variant));
    points.extend(whole.map(|judged| Point::of(data.training_s(), judged)));
    Ok(points)
}

fn after(data: &Data, plan: &Plan, refitted: &Refitted, seconds: f64) -> Result<Vec<Point>> {
    let lessons = Lessons::of(data, refitted, seconds)?;
    let mut points = Vec::new();
    for variant in FOLLOWED {
        if let Some(built) = refitted.behind(variant.behind()) {
            let taught = match plan.teach(variant, &lessons, built, seconds) {
                // One that the device cannot hold leaves a gap.
                Err(error) if error.is::<Unfit>() => continue,
                taught => taught?,
            };
            let judged = judge(data, variant, built, taught.as_ref())?;
            points.push(Point::of(seconds, &judged));
        }
    }
    Ok(points)
}
