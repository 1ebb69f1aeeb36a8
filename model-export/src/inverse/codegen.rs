//! Tables and networks as Rust source. The same input gives the same bytes.

use crate::gru::network::{Network, OUTPUTS};
use crate::gru::pack::PackedNetwork;
use crate::inverse::build::{DeviceModel, ExportHeader};
use crate::inverse::calibration::CalibrationDescription;
use crate::inverse::compensation::OwnedCompensation;
use crate::inverse::model_selection::SelectedModels;
use crate::inverse::quantise::TableSet;
use crate::model_file::TABLES_MARK;
use firmware::model::formats::{CentrePair, SensorTable};
use std::fmt::{Display, Write};

/// Source that declares `TABLES`, an empty `NETWORKS`, and their `DESCRIPTION`.
pub fn tables_source(built: &DeviceModel) -> String {
    tables(built) + NO_NETWORKS + &description(built, &[])
}

/// Source that declares `TABLES`, `NETWORKS` as `trained` and packed for the device, and their `DESCRIPTION`.
pub fn source_with_networks(
    built: &DeviceModel,
    trained: &[Network],
    networks: &[Box<dyn PackedNetwork>],
) -> Result<String, MixedSizes> {
    Ok(tables(built) + &networks_source(networks)? + &description(built, trained))
}

fn description(built: &DeviceModel, networks: &[Network]) -> String {
    let text = CalibrationDescription::of(built, networks).to_toml();
    format!(
        "\n/// Origin of tables and networks, as TOML.\n#[rustfmt::skip]\npub static DESCRIPTION: &str = {text:?};\n"
    )
}

fn tables(built: &DeviceModel) -> String {
    let (chosen, header) = (&built.chosen, &built.header);
    let tables = &chosen.tables;
    let mut text = comment(chosen, header);
    if !built.compensations.is_empty() {
        text +=
            "\n// Numbers as they are printed by the exporter: long lines, and no digit grouped.\n";
        text += "#[rustfmt::skip]\nuse crate::compensation::{*, crosstalk::*, flexure::*, hysteresis::*, lookup_table::*, thermal::*};\n";
    }
    text += "\nuse crate::model::axis_map::AxisMap;\nuse crate::model::formats::*;\n\n";
    text += "/// The ideal model of every sensor.\n";
    text += "pub static TABLES: Tables<'static> = Tables {\n";
    let views: Vec<_> = built.compensations.iter().map(|own| own.view()).collect();
    text += &format!(
        "    id: 0x{:04x},\n    exp: &EXP,\n    sensors: &SENSORS,\n    compensations: &{},\n    check: 0x{:08x},\n}};\n\n",
        tables.id,
        if built.compensations.is_empty() { "[]" } else { "COMPENSATIONS" },
        tables.tables(&views).check,
    );
    text += &format!("static EXP: [u32; EXP_ENTRIES] = [\n{}];\n\n", exponential(tables));
    text += &format!("static SENSORS: [SensorTable; {}] = [\n", tables.sensors.len());
    for (table, number) in tables.sensors.iter().zip(&header.sensors) {
        text += &sensor(table, *number);
    }
    text += "];\n";
    if !built.compensations.is_empty() {
        text += &compensations(&built.compensations);
    }
    text
}

/// Compensations by the debug form of their structs, which is valid Rust except for slices.
fn compensations(list: &[OwnedCompensation]) -> String {
    let mut text =
        format!("\n#[rustfmt::skip]\nstatic COMPENSATIONS: [Compensation; {}] = [\n", list.len());
    for compensation in list {
        let view = compensation.view();
        let field = view.field.map(|effect| literal(&effect, "FieldEffect"));
        let force = view.force.map(|effect| literal(&effect, "ForceEffect"));
        text += &format!(
            "    Compensation {{ number: {}, filters: {}, field: [{}], force: [{}] }},\n",
            view.number,
            with_covariates(format!("{:?}", view.filters)),
            field.join(", "),
            force.join(", ")
        );
    }
    text + "];\n"
}

/// `Some(Kind::Variant(Table { .. }))` or `None`, with a reference before every slice.
fn literal(effect: &impl std::fmt::Debug, kind: &str) -> String {
    with_covariates(format!("{effect:?}"))
        .replacen("Some(", &format!("Some({kind}::"), 1)
        .replace("knots: [[", "knots: &[[")
        .replace("values: [", "values: &[")
}

fn with_covariates(text: String) -> String {
    text.replace("covariate: ", "covariate: Covariate::")
}

fn comment(chosen: &SelectedModels, header: &ExportHeader) -> String {
    let recorded = if header.recorded.is_empty() {
        "not stated in recording.toml".to_owned()
    } else {
        header.recorded.join(", ")
    };
    let state = header.valid_from.iter().map(|state| format!("// state     {state}\n"));
    let state: String = state.collect();
    let mut text = format!(
        "{TABLES_MARK} Do not edit: fit again and export again.\n\
         //\n\
         // model     {}, campaign {}, SHA-256 of its file {}\n\
         // effects   {}\n\
         // recorded  {recorded}\n\
         {state}\
         // shape     {} x {} centres, gamma {:.4}, ridge {:.0e}\n\
         //\n\
         // Over the design box, in newtons, root mean square / greatest, for Fx and Fz:\n",
        header.variant,
        header.campaign,
        header.inputs_sha256,
        if header.effects.is_empty() { "none".to_owned() } else { header.effects.join(", ") },
        chosen.shape.centres_across,
        chosen.shape.centres_across,
        chosen.shape.gamma,
        chosen.shape.ridge,
    );
    for (errors, number) in chosen.errors().into_iter().zip(&header.sensors) {
        let both = |(rms, max): ([f64; 2], [f64; 2])| {
            format!("{:.3} / {:.3}, {:.3} / {:.3}", rms[0], max[0], rms[1], max[1])
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "// sensor {number}: inverse {}; fixed point against floating point {}",
            both(errors.model),
            both(errors.fixed)
        );
    }
    text
}

fn exponential(tables: &TableSet) -> String {
    let rows = tables.exp.chunks(8).map(|row| {
        let entries: Vec<String> = row.iter().map(|entry| format!("0x{entry:08x}")).collect();
        format!("    {},\n", entries.join(", "))
    });
    rows.collect()
}

fn sensor(table: &SensorTable, number: u32) -> String {
    let scale = table
        .scale
        .map(|axis| format!("AxisScale {{ offset: {}, gain: {} }}", axis.offset, axis.gain));
    let used = usize::from(table.used_pairs).min(table.pairs.len());
    let pairs: String = table.pairs[..used].iter().map(pair).collect();
    format!(
        "    // Sensor {number}.\n    SensorTable {{\n        number: {number},\n        axes: AxisMap(0o{:03o}),\n        scale: [\n            {},\n        ],\n        \
         limit_counts: {},\n        linear: Linear {{\n            bias: {},\n            slope: [{}, {}],\n        }},\n        \
         pairs: padded([\n{pairs}        ]),\n        used_pairs: {},\n        shift: {},\n        \
         parity: Parity {{\n            axis: {},\n            // Powers from the highest down, as `parity.rs` reads them.\n            \
         terms: {},\n            sigma: {},\n        }},\n    }},\n",
        table.axes.0,
        scale.join(",\n            "),
        table.limit_counts,
        list(&table.linear.bias),
        list(&table.linear.slope[0]),
        list(&table.linear.slope[1]),
        table.used_pairs,
        list(&table.shift),
        table.parity.axis,
        list(&table.parity.terms),
        table.parity.sigma,
    )
}

fn pair(pair: &CentrePair) -> String {
    format!(
        "            CentrePair {{ xy: [{}, {}], z: {}, weight: [{}, {}] }},\n",
        list(&pair.xy[0]),
        list(&pair.xy[1]),
        list(&pair.z),
        list(&pair.weight[0]),
        list(&pair.weight[1])
    )
}

fn list<T: Display>(items: &[T]) -> String {
    let items: Vec<String> = items.iter().map(ToString::to_string).collect();
    format!("[{}]", items.join(", "))
}

/// Empty table, with an arbitrary size.
pub(crate) const NO_NETWORKS: &str = "\n/// No recurrent networks.\n\
    pub static NETWORKS: [Network<1, 4, 1>; 0] = [];\n\
    \n/// Calibration with networks of this size.\n\
    pub type TablesCalibration<'m> = crate::model::calibration::Calibration<'m, 1, 4, 1>;\n";

/// Networks of different sizes, which one static cannot contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "networks of different sizes cannot share the device's table: train them with the same inputs and units"
)]
pub struct MixedSizes;

/// Source of a static with `networks`, to append to a file of tables. Its type names the size, so that an image
/// links the kernel of that size only, by statically known calls, and none without networks.
pub(crate) fn networks_source(networks: &[Box<dyn PackedNetwork>]) -> Result<String, MixedSizes> {
    let Some(first) = networks.first() else {
        return Ok(NO_NETWORKS.to_owned());
    };
    let mut text = "\nuse crate::fixed_point::{Field, Force};\n\n".to_owned();
    let [inputs, hidden, sensors] = first.size();
    if networks.iter().any(|network| network.size() != first.size()) {
        return Err(MixedSizes);
    }
    text += &format!(
        "/// Recurrent networks: {} inputs, two layers of {} units, {} outputs.\n",
        2 * inputs,
        2 * hidden,
        OUTPUTS * sensors,
    );
    text += "#[rustfmt::skip]\n";
    text += &format!(
        "pub static NETWORKS: [Network<{inputs}, {hidden}, {sensors}>; {}] = [\n",
        networks.len()
    );
    for network in networks {
        text += &network.source();
        text += ",\n";
    }
    text += &format!(
        "];\n\n/// Calibration with networks of this size.\n\
         pub type TablesCalibration<'m> = crate::model::calibration::Calibration<'m, {inputs}, {hidden}, {sensors}>;\n"
    );
    Ok(text)
}
