//! Text and JSON of exported tables.

use model_export::inverse::build::ExportHeader;
use model_export::inverse::grbf::ErrorMap;
use model_export::inverse::model_selection::SelectedModels;
use model_export::inverse::static_model::{ForceRegion, StaticModel};
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
    let sensors = header.sensors.iter().zip(&chosen.forward);
    for (errors, (number, forward)) in chosen.errors().into_iter().zip(sensors) {
        for axis in forward.region().inputs() {
            let name = FORCES[axis].0;
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
         Error in N over the box of {}:\n{table}\n",
        match header.effects.as_slice() {
            [] => String::new(),
            effects => format!("Effects of the model: {}.\n", effects.join(", ")),
        },
        header.variant,
        centres(chosen),
        shape.gamma,
        shape.ridge,
        boxes(chosen, header),
    )
}

/// Largest number of centres of a sensor.
fn centres(chosen: &SelectedModels) -> usize {
    chosen.models.iter().map(|model| model.centres.len()).max().unwrap_or(0)
}

/// Loads of the tables: of a design those of all sensors, else those that each sensor was fitted to.
fn boxes(chosen: &SelectedModels, header: &ExportHeader) -> String {
    let regions: Vec<ForceRegion> = chosen.forward.iter().map(StaticModel::region).collect();
    if let Some(first) = regions.first()
        && *first == ForceRegion::symmetric(first.half_n[0])
    {
        return format!("±{:.0} N", first.half_n[0]);
    }
    let mut texts: Vec<(String, Vec<String>)> = Vec::new();
    for (region, number) in regions.iter().zip(&header.sensors) {
        let range = |axis: usize| {
            let (centre, half) = (region.centre_n[axis], region.half_n[axis]);
            format!("{} {:.2} to {:.2} N", FORCES[axis].0, centre - half, centre + half)
        };
        let text = region.inputs().map(range).collect::<Vec<_>>().join(", ");
        match texts.iter_mut().find(|(known, _)| *known == text) {
            Some((_, numbers)) => numbers.push(number.to_string()),
            None => texts.push((text, vec![number.to_string()])),
        }
    }
    let of_sensors = texts.iter().map(|(text, numbers)| {
        format!(
            "{text} (sensor{} {})",
            if numbers.len() > 1 { "s" } else { "" },
            numbers.join(", ")
        )
    });
    of_sensors.collect::<Vec<_>>().join("; ")
}

/// Error map of the sensor with the maximum error, of those with two forces.
pub fn worst_map(model: &ModelFile, chosen: &SelectedModels, header: &ExportHeader) -> String {
    let scale = model.sensor_scale.gauss_per_lsb;
    let planes = chosen.forward.iter().enumerate();
    let planes = planes.filter(|(_, forward)| forward.region().single().is_none());
    let maps = planes.map(|(i, forward)| {
        let inverse = |field: &_| chosen.tables.force(i, field, scale);
        (i, ErrorMap::of(forward, forward.region(), MAP_LOADS, inverse))
    });
    let Some((sensor, map)) = maps.max_by(|a, b| a.1.worst_n().total_cmp(&b.1.worst_n())) else {
        return String::new();
    };
    let [lateral, longitudinal] = &map.loads_n;
    let loads = lateral.iter().map(|load| format!("{load:.0}"));
    let mut table = terminal::table(["Fz \\ Fx N".to_owned()].into_iter().chain(loads));
    for (load, errors) in longitudinal.iter().zip(&map.errors_n).rev() {
        let cells = errors.iter().map(|error| format!("{error:.2}"));
        table.add_row([format!("{load:.0}")].into_iter().chain(cells).collect::<Vec<_>>());
    }
    terminal::right_align(&mut table, 0);
    format!(
        "Error map of sensor {} (maximum error) in N, fixed point:\n{table}\n",
        header.sensors[sensor]
    )
}

pub fn to_json(chosen: &SelectedModels, header: &ExportHeader) -> Value {
    let sensors = header.sensors.iter().zip(&chosen.forward);
    let sensors = chosen.errors().into_iter().zip(sensors);
    let sensors = sensors.flat_map(|(errors, (number, forward))| {
        let inputs = forward.region().inputs().map(|axis| (axis, FORCES[axis].1));
        inputs.map(move |(axis, name)| {
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
        "centres": centres(chosen),
        "gamma": chosen.shape.gamma, "ridge": chosen.shape.ridge,
        "valid_from": header.valid_from,
        "id": chosen.tables.id, "inputs_sha256": header.inputs_sha256,
    })
}
