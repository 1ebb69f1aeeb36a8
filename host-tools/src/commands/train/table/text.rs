//! The table for a terminal.

use crate::foreign::words::sentences;
use crate::show;
use crate::sums::Sums;
use crate::table::length::FOLLOWED;
use crate::table::teach::Plan;
use crate::table::variant::Variant;
use crate::table::{Table, Worth, paper, worth};

/// The paper's order: Fz above Fx.
const FORCES: [(usize, &str); 2] = [(1, "Fz"), (0, "Fx")];

/// The page.
pub fn page(table: &Table, plan: &Plan) -> String {
    let parts = [
        head(table),
        errors(table),
        show::paragraph(&below(table, plan)),
        "\n".to_owned(),
        lengths(table),
        show::paragraph(&verdict(table)),
        foreign(table),
    ];
    parts.concat()
}

fn head(table: &Table) -> String {
    show::paragraph(&format!(
        "Recording {} in newtons, estimate minus reference at every row; nothing was chosen by it. \
         Everything was fitted and trained on recording {} ({:.0} s): the physics on all of it, the \
         networks on its beginning, with the last {:.0} s to tell when to stop. Beside it the paper's \
         Table I: RMSE, mean and standard deviation (which it calls variance).",
        table.recordings.1,
        table.recordings.0.join(", "),
        table.training_s,
        table.stopping_s,
    ))
}

fn errors(table: &Table) -> String {
    let shown = FORCES.map(|(axis, name)| format!("{name}\n{}\n", of_force(table, axis)));
    shown.concat()
}

fn of_force(table: &Table, axis: usize) -> comfy_table::Table {
    let mut shown = show::table([
        "by", "RMSE", "mean", "std", "tared", "fixed", "tared", "noise", "paper",
    ]);
    for judged in &table.judged {
        let figures = &judged.axes[axis];
        let tared =
            |sums: Option<Sums>| sums.map_or_else(|| "-".to_owned(), |s| format!("{:.3}", s.rms()));
        let stated = paper::stated(judged.variant, axis);
        shown.add_row([
            judged.variant.words().to_owned(),
            format!("{:.3}", figures.float.rms()),
            format!("{:+.3}", figures.float.mean()),
            format!("{:.3}", figures.float.std()),
            tared(figures.float_tared),
            format!("{:.3}", figures.fixed.rms()),
            tared(figures.fixed_tared),
            format!("{:.3}", figures.noise_n),
            stated.map_or_else(String::new, |paper| {
                format!(
                    "{:.1} {:+.1} {:.1}",
                    paper.rmse_n, paper.mean_n, paper.std_n
                )
            }),
        ]);
    }
    show::right_align(&mut shown, 1);
    shown
}

fn below(table: &Table, plan: &Plan) -> String {
    let data = match table.simulated {
        true => {
            "These recordings are simulated, the paper's were measured and are not public: its figures are beside, not against, these. "
        }
        false => "The paper's recordings are not public: another gripper, other loads. ",
    };
    let coverage = table
        .of(Variant::Gru3Axis)
        .and_then(|judged| judged.coverage.as_ref())
        .map_or_else(String::new, |found| {
            let [one, two, three] = [0, 1, 2].map(|place| found.words(place));
            format!(
                "Within 1, 2, 3 of the standard deviations that the network of 3 axes tells lie {one}, {two} and {three} of its errors after the tare (a Gaussian: 68.3, 95.4, 99.7 %; intervals of 95 % by blocks of time). "
            )
        });
    format!(
        "Fixed: by the device's code; the columns before are floating point. Tared: less the mean of \
         the estimate over the first unloaded stretch, a second at the most, sensor by sensor, but not \
         what friction may hold at rest by the physics with effects; the device itself tares nothing. Networks had been \
         on at rest before the recording begins. Noise: what white noise of sensor and reference leaves \
         of one reading's estimate; a network can average below the ideal model's. Near zero: rows count \
         1 + {} exp(-(F / 25 N)^2 / 2). {coverage}{data}Seed {}.",
        show::plain(plan.near_zero - 1.0, 2),
        plan.seed(),
    )
}

fn lengths(table: &Table) -> String {
    let mut seconds: Vec<f64> = table.lengths.iter().map(|point| point.seconds).collect();
    seconds.dedup();
    if seconds.len() < 2 {
        return String::new();
    }
    let heads = seconds.iter().map(|seconds| format!("{seconds:.0} s"));
    let mut shown = show::table(std::iter::once("by".to_owned()).chain(heads));
    for variant in FOLLOWED {
        let cell = |seconds: &f64| {
            let mut points = table.lengths.iter();
            points
                .find(|point| point.variant == variant && point.seconds == *seconds)
                .map_or_else(|| "-".to_owned(), |point| format!("{:.3}", point.rmse_n))
        };
        let cells = seconds.iter().map(cell);
        let row: Vec<String> = std::iter::once(variant.words().to_owned())
            .chain(cells)
            .collect();
        if row.iter().skip(1).any(|cell| cell != "-") {
            shown.add_row(row);
        }
    }
    show::right_align(&mut shown, 1);
    format!(
        "RMSE of the device over both forces on recording {}, against the seconds that were learned from\n{shown}\n",
        table.recordings.1
    )
}

/// What the networks are worth.
fn verdict(table: &Table) -> String {
    let physics = match worth(table) {
        None => "The model has no effects: physics with effects is not in the table. `magpie diagnose` names what is missing, `magpie add` adds it.".to_owned(),
        Some(Worth::Floor) => "Physics with effects reaches the noise floor on both forces: a network adds nothing here.".to_owned(),
        Some(Worth::Nothing) => "Physics with effects is above the floor, but a network takes less than 2 % of its error: it adds nothing here.".to_owned(),
        Some(Worth::Share(share)) => format!("Behind physics with effects a network takes {:.0} % more of the error.", 100.0 * share),
        Some(Worth::Harm(share)) => format!("Behind physics with effects a network makes the error {:.0} % larger: leave it out.", 100.0 * share),
    };
    format!("{}{physics}", against(table))
}

/// Whether a foreign magnet is noticed.
fn foreign(table: &Table) -> String {
    table.foreign.as_ref().map_or_else(String::new, |magnet| {
        let words = sentences(&magnet.tally);
        format!(
            "\n{}",
            show::paragraph(&format!("A foreign magnet. {} {words}", magnet.of))
        )
    })
}

/// The network of three axes beside the fitted ideal model and beside two axes, after the tare.
fn against(table: &Table) -> String {
    let gains = |other: Variant| -> Option<[f64; 2]> {
        let (own, other) = (table.of(Variant::Gru3Axis)?, table.of(other)?);
        let [x, z] = [0, 1].map(|axis| {
            let tared = |judged: &crate::table::judge::Judged| judged.axes[axis].fixed_tared;
            Some(100.0 * (tared(own)?.rms() / tared(other)?.rms() - 1.0))
        });
        Some([x?, z?])
    };
    let words = |name: &str, [x, z]: [f64; 2]| format!("{z:+.0} % (Fz) and {x:+.0} % (Fx) {name}");
    let both = (gains(Variant::IdealFitted), gains(Variant::Gru2Axis));
    let (Some(ideal), Some(two)) = both else {
        return String::new();
    };
    format!(
        "After the tare, the network of 3 axes errs by {}, and by {}. ",
        words("against the fitted ideal model", ideal),
        words("against 2 axes", two)
    )
}
