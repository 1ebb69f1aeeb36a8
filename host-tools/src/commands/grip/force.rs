//! A grasp: force, width, current and state over time, and the same grasp with nothing but a bound of the
//! current beside it.

use anyhow::{Result, bail};
use firmware::grip::profile::Profile;
use serde_json::{Value, json};

use super::{Args, Other, Stuff, assumed_json, ends, figures_json};
use crate::drive::course::{Asked, Course, Point, current_limited, grasp};
use crate::drive::gripped::Gripped;
use crate::drive::runs::Case;
use crate::report::{self, grasp as page};
use crate::{progress, show};

/// Seconds for which the force is held.
const HOLD_S: f64 = 0.5;
/// The least force that is a grasp, in N.
const LEAST_N: f64 = 5.0;
/// Where a grasp begins, in mm before the object: beside one that runs up to full speed, and alone.
const FROM_MM: [f64; 2] = [15.0, 2.0];

impl Stuff {
    /// Newtons to the millimetre.
    fn contact_n_per_mm(self) -> f64 {
        match self {
            Self::Rigid => 333.0,
            Self::Medium => 50.0,
            Self::Soft => 5.0,
        }
    }
}

/// Checks that a force is one of a grasp.
pub(super) fn check(set_n: f64) -> Result<()> {
    let most_n = f64::from(Profile::Strong.most_n());
    if !(LEAST_N..=most_n).contains(&set_n) {
        bail!("--force {set_n} is not possible here; give {LEAST_N} to {most_n} N");
    }
    Ok(())
}

pub(super) fn run(args: &Args, case: Case, set_n: f64) -> Result<()> {
    check(set_n)?;
    let asked = asked(args, set_n)?;
    let bar = progress::bar(
        "simulating the grasp",
        1 + usize::from(args.compare.is_some()),
    );
    let own = grasp(case.lead, case.parameters, asked, case.seed);
    bar.inc(1);
    let other = args.compare.map(|Other::CurrentLimit| {
        let beside = Asked {
            from_mm: FROM_MM[0],
            ..asked
        };
        current_limited(case.lead, case.parameters, beside, case.seed)
    });
    bar.finish_and_clear();
    let gripped = Gripped { case, own, other };
    if let Some(path) = &args.output {
        report::write_sections(path, &page::title(&gripped), &page::sections(&gripped))?;
    }
    let page = match args.json {
        true => format!("{}\n", json_of(args, &gripped)),
        false => text(args, &gripped),
    };
    show::page(&page)?;
    Ok(())
}

fn asked(args: &Args, set_n: f64) -> Result<Asked> {
    let contact_n_per_mm = args.object.contact_n_per_mm();
    let asked = Asked {
        from_mm: FROM_MM[1],
        ..Asked::new(contact_n_per_mm, set_n, HOLD_S)
    };
    match asked.is_possible() {
        true => Ok(asked),
        false => bail!(
            "--force {set_n} presses something soft in by {} mm, more than the fingers open; give less",
            show::plain(set_n / contact_n_per_mm, 0)
        ),
    }
}

fn text(args: &Args, gripped: &Gripped) -> String {
    let mut heads = vec!["figure", "", "unit"];
    heads.extend(gripped.other.as_ref().map(|_| "current limit"));
    let mut table = show::table(heads);
    let other = gripped.other.as_ref().map(Gripped::figures);
    for (index, (name, value, unit)) in Gripped::figures(&gripped.own).into_iter().enumerate() {
        let mut row = vec![name.to_owned(), show::plain(value, 2), unit.to_owned()];
        let beside = other.as_ref().and_then(|other| other.get(index));
        row.extend(beside.map(|(_, value, _)| match value.is_finite() {
            true => show::plain(*value, 2),
            false => "-".to_owned(),
        }));
        table.add_row(row);
    }
    show::right_align(&mut table, 1);
    let mut states = show::table(["from, ms", "state"]);
    for (time_s, state) in gripped.states() {
        states.add_row([show::plain(1e3 * time_s, 0), state]);
    }
    let mut page = show::paragraph(&gripped.sentence());
    page += &format!("{table}\n{states}\n");
    page += &ends(args, &gripped.assumed());
    page
}

fn json_of(args: &Args, gripped: &Gripped) -> Value {
    let points = |course: &Course| {
        let json = |point: &Point| {
            json!({
                "time_s": point.time_s,
                "set_n": point.set_n,
                "told_n": point.told_n,
                "true_n": point.true_n,
                "opening_mm": point.opening_mm,
                "current_q_a": point.current_a,
                "state": point.state.map(Gripped::state_name),
            })
        };
        course.points.iter().map(json).collect::<Vec<_>>()
    };
    let beside = gripped.other.as_ref().map(|other| {
        json!({ "figures": figures_json(&Gripped::figures(other)), "points": points(other) })
    });
    json!({
        "simulated": true,
        "screw": format!("{:?}", gripped.case.lead).to_lowercase(),
        "seed": args.seed,
        "scatter": args.scatter,
        "force_n": gripped.own.asked.set_n,
        "contact_n_per_mm": gripped.own.asked.contact_n_per_mm,
        "report": args.output,
        "figures": figures_json(&Gripped::figures(&gripped.own)),
        "points": points(&gripped.own),
        "current_limit": beside,
        "assumed": assumed_json(&gripped.assumed()),
    })
}
