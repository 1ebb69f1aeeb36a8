//! The table as one JSON object.

use crate::coverage::Coverage;
use serde_json::{Value, json};

use crate::table::judge::Judged;
use crate::table::magnet::Magnet;
use crate::table::teach::Plan;
use crate::table::variant::Variant;
use crate::table::{Table, Worth, paper, worth};

const AXES: [&str; 2] = ["x", "z"];

/// The object of `--json`.
pub fn object(table: &Table, plan: &Plan) -> Value {
    let rows = table.judged.iter().flat_map(rows);
    let coverage = table
        .of(Variant::Gru3Axis)
        .and_then(|judged| judged.coverage.as_ref())
        .map(Coverage::json);
    let lengths = table.lengths.iter().map(|point| {
        json!({
            "variant": point.variant.id(), "seconds": point.seconds,
            "rmse_n": point.rmse_n, "tared_rmse_n": point.tared_rmse_n,
        })
    });
    let networks = table.trained.iter().map(|trained| {
        let epochs: Vec<u32> = trained.found.iter().map(|best| best.epoch).collect();
        json!({ "variant": trained.variant.id(), "epochs": epochs, "sha256": trained.sha256 })
    });
    json!({
        "rows": rows.collect::<Vec<_>>(),
        "coverage": coverage,
        "noise_n": table.noise_n().map(|[x, z]| json!({ "x": x, "z": z })),
        "network_on_physics": worth(table).map(verdict),
        "data_efficiency": lengths.collect::<Vec<_>>(),
        "networks": networks.collect::<Vec<_>>(),
        "foreign_magnet": table.foreign.as_ref().map(Magnet::json),
        "recordings": table.recordings.0, "held_out": table.recordings.1,
        "training_s": table.training_s, "stopping_s": table.stopping_s,
        "effects": table.effects, "simulated": table.simulated,
        "near_zero": plan.near_zero, "seed": plan.seed(), "epochs": plan.most_epochs(),
        "notes": table.notes,
    })
}

fn rows(judged: &Judged) -> Vec<Value> {
    let row = |(axis, name): (usize, &str)| {
        let figures = &judged.axes[axis];
        let stated = paper::stated(judged.variant, axis);
        json!({
            "variant": judged.variant.id(), "axis": name, "rows": figures.fixed.rows(),
            "rmse_n": figures.float.rms(), "mean_n": figures.float.mean(),
            "std_n": figures.float.std(),
            "tared_rmse_n": figures.float_tared.map(|sums| sums.rms()),
            "fixed_rmse_n": figures.fixed.rms(), "fixed_mean_n": figures.fixed.mean(),
            "fixed_std_n": figures.fixed.std(),
            "fixed_tared_rmse_n": figures.fixed_tared.map(|sums| sums.rms()),
            "noise_n": figures.noise_n, "invalid": judged.invalid,
            "paper": stated.map(|paper| json!({
                "rmse_n": paper.rmse_n, "mean_n": paper.mean_n, "std_n": paper.std_n,
            })),
        })
    };
    AXES.into_iter().enumerate().map(row).collect()
}

fn verdict(worth: Worth) -> Value {
    match worth {
        Worth::Floor => json!({ "adds": "nothing", "why": "the physics is at the floor" }),
        Worth::Nothing => json!({ "adds": "nothing", "why": "less than 2 % of the error" }),
        Worth::Share(share) => json!({ "adds": "accuracy", "share": share }),
        Worth::Harm(share) => json!({ "adds": "error", "share": share }),
    }
}
