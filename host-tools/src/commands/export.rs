//! `magpie export`: writes the device tables as Rust source.

use std::path::PathBuf;

use anyhow::Result;
use firmware::sensors::hall::SENSORS;
use model_export::inverse::build::{DeviceModel, ExportHeader, ModelVariant, build};
use model_export::inverse::codegen::{MARK, source_with_networks, tables_source};
use model_export::inverse::grbf::ErrorMap;
use model_export::inverse::model_selection::SelectedModels;
use model_export::model_file::ModelFile;
use model_export::output::{check_output, write_output};
use serde_json::json;

use device_run::networks::NetworkSet;
use report::text::terminal;

/// Loads per axis of the printed error map.
const MAP_LOADS: usize = 9;

/// Write the firmware's model tables and report their fixed-point error in newtons.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie export model.toml -o my-tables.rs
  cargo magpie export model.toml --network network.safetensors -o my-tables.rs
  MAGPIE_TABLES=my-tables.rs cargo image")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Rust source file to write.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
    /// Recurrent networks to run after the model, written by `magpie train`.
    #[arg(long, value_name = "NETWORK", conflicts_with = "nominal")]
    network: Option<PathBuf>,
    /// Invert the nominal design (the paper's ideal model) instead of the fitted parameters.
    #[arg(long)]
    nominal: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let variant = if args.nominal { ModelVariant::Nominal } else { ModelVariant::Fitted };
    check_output(&args.output, MARK)?;
    let built = build(&args.model, variant)?;
    let networks =
        args.network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
    let source = match &networks {
        None => tables_source(&built),
        Some(networks) => source_with_networks(&built, &networks.packed)?,
    };
    write_output(&args.output, source.as_bytes(), MARK)?;
    for (effect, why) in &built.uncompensated {
        eprintln!("note: {effect} is not compensated: {why}");
    }
    let DeviceModel { model, chosen, header, .. } = built;
    let image: Vec<u32> = (0..SENSORS as u32).collect();
    if header.sensors != image {
        eprintln!(
            "note: the image reads sensors {image:?}, these tables have {:?}: the image reports the others as missing",
            header.sensors
        );
    }
    terminal::print_result(
        args.json,
        || json(&chosen, &header),
        || {
            format_report(&chosen, &header)
                + &worst_map(&model, &chosen, &header)
                + &networks.as_ref().map_or_else(String::new, NetworkSet::description)
                + &format!("Written to {}.\n", args.output.display())
        },
    )
}

/// The selected tables and their inversion error.
pub fn format_report(chosen: &SelectedModels, header: &ExportHeader) -> String {
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
    for (errors, number) in chosen.errors.iter().zip(&header.sensors) {
        for (axis, name) in ["Fx", "Fz"].into_iter().enumerate() {
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
fn worst_map(model: &ModelFile, chosen: &SelectedModels, header: &ExportHeader) -> String {
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

fn json(chosen: &SelectedModels, header: &ExportHeader) -> serde_json::Value {
    let sensors = chosen.errors.iter().zip(&header.sensors).flat_map(|(errors, number)| {
        ["x", "z"].into_iter().enumerate().map(move |(axis, name)| {
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
        "id": chosen.tables.id, "inputs_sha256": header.inputs_sha256,
    })
}
