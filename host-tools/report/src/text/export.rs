//! Text and JSON of exported tables.

use model_export::inverse::build::ExportHeader;
use model_export::inverse::grbf::ErrorMap;
use model_export::inverse::model_selection::SelectedModels;
use model_export::model_file::ModelFile;
use serde_json::{Value, json};

use crate::text::{FORCES, terminal};

/// Loads per axis of the printed error map.
const MAP_LOADS: usize = 9;

/// The selected tables and their inversion error.
pub fn format_tables(chosen: &SelectedModels, header: &ExportHeader) -> String {
    let shape = chosen.shape;
    let mut table = terminal::table([
        "sensor",
        "force",
        "inverse rms",
        "worst",
        "fixed - float rms",
        "worst",
        "linear rms",
        "worst",
    ]);
    for (errors, number) in chosen.errors().into_iter().zip(&header.sensors) {
        for (axis, (name, _)) in FORCES.into_iter().enumerate() {
            let cells =
                [errors.model, errors.fixed, errors.linear].into_iter().flat_map(|(rms, worst)| {
                    [format!("{:.3}", rms[axis]), format!("{:.3}", worst[axis])]
                });
            let row: Vec<String> =
                [number.to_string(), name.to_owned()].into_iter().chain(cells).collect();
            table.add_row(row);
        }
    }
    terminal::right_align(&mut table, 2);
    format!(
        "{}Ideal model of the {}: {} centres and a linear part for each sensor\n\
         (width gamma {:.3}, ridge {:.0e}, selected by held-out error in the device's arithmetic).\n\
         Error in N over the box of ±{:.0} N:\n{table}\n",
        match header.effects.as_slice() {
            [] => String::new(),
            effects => format!("Effects of the model: {}.\n", effects.join(", ")),
        },
        header.variant,
        shape.centres_across * shape.centres_across,
        shape.gamma,
        shape.ridge,
        chosen.models.first().map_or(0.0, |model| model.design.force_n[0]),
    )
}

/// Error map of the sensor with the maximum error.
pub fn worst_map(model: &ModelFile, chosen: &SelectedModels, header: &ExportHeader) -> String {
    let scale = model.sensor_scale.gauss_per_lsb;
    let maps = chosen.forward.iter().enumerate().map(|(i, forward)| {
        let force_n = chosen.models[i].design.force_n;
        (i, ErrorMap::of(forward, force_n, MAP_LOADS, |field| chosen.tables.force(i, field, scale)))
    });
    let Some((sensor, map)) = maps.max_by(|a, b| a.1.worst_n().total_cmp(&b.1.worst_n())) else {
        return String::new();
    };
    let loads = map.loads_n.iter().map(|load| format!("{load:.0}"));
    let mut table = terminal::table(["Fz \\ Fx N".to_owned()].into_iter().chain(loads));
    for (load, errors) in map.loads_n.iter().zip(&map.errors_n).rev() {
        let cells = errors.iter().map(|error| format!("{error:.2}"));
        table.add_row([format!("{load:.0}")].into_iter().chain(cells).collect::<Vec<_>>());
    }
    terminal::right_align(&mut table, 0);
    format!(
        "Error map of sensor {} (maximum error) in N, fixed point:\n{table}\n",
        header.sensors[sensor]
    )
}

/// The object of `--json`.
pub fn to_json(chosen: &SelectedModels, header: &ExportHeader) -> Value {
    let sensors = chosen.errors().into_iter().zip(&header.sensors).flat_map(|(errors, number)| {
        FORCES.into_iter().enumerate().map(move |(axis, (_, name))| {
            json!({
                "sensor": number, "axis": name,
                "inverse_rms_n": errors.model.0[axis], "inverse_worst_n": errors.model.1[axis],
                "fixed_minus_float_rms_n": errors.fixed.0[axis], "fixed_minus_float_worst_n": errors.fixed.1[axis],
                "linear_rms_n": errors.linear.0[axis], "linear_worst_n": errors.linear.1[axis],
            })
        })
    });
    json!({
        "sensors": sensors.collect::<Vec<_>>(),
        "centres": chosen.shape.centres_across * chosen.shape.centres_across,
        "gamma": chosen.shape.gamma, "ridge": chosen.shape.ridge,
        "valid_from": header.valid_from,
        "id": chosen.tables.id, "inputs_sha256": header.inputs_sha256,
    })
}
