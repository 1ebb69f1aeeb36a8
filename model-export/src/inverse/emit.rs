//! The tables as Rust source. The same tables and header give the same bytes.

use std::fmt::{Display, Write};

use firmware::compensate::{OnField, OnForce};
use firmware::model::table::{CentrePair, SensorTable};

use super::build::{Built, Header};
use super::compensation::OwnedCompensation;
use super::quantise::TableSet;
use super::search::Chosen;
use crate::gru::{self, pack::Packed};

/// How every file of tables begins.
pub const MARK: &str = "// Written by `magpie export`.";

/// The source of a file that declares `TABLES`, and `NETWORKS` without any.
pub fn source(built: &Built) -> String {
    tables(built) + gru::emit::NO_NETWORKS
}

/// The same with recurrent networks.
pub fn source_with(
    built: &Built,
    networks: &[Box<dyn Packed>],
) -> Result<String, gru::emit::SeveralSizes> {
    Ok(tables(built) + &gru::emit::source(networks)?)
}

fn tables(built: &Built) -> String {
    let (chosen, header) = (&built.chosen, &built.header);
    let tables = &chosen.tables;
    let mut text = comment(chosen, header);
    if !built.compensations.is_empty() {
        text +=
            "\n// Numbers as they are printed by the exporter: long lines, and no digit grouped.\n";
        text += "#[rustfmt::skip]\nuse crate::compensate::{*, map::*};\n";
    }
    text += "\nuse crate::model::parity::Parity;\nuse crate::model::table::*;\n\n";
    text += "/// The ideal model of every sensor.\n";
    text += "pub static TABLES: Tables<'static> = Tables {\n";
    let views: Vec<_> = built.compensations.iter().map(|own| own.view()).collect();
    text += &format!(
        "    id: 0x{:04x},\n    exp: &EXP,\n    sensors: &SENSORS,\n    compensations: &{},\n    check: 0x{:08x},\n}};\n\n",
        tables.id,
        if built.compensations.is_empty() {
            "[]"
        } else {
            "COMPENSATIONS"
        },
        tables.tables(&views).check,
    );
    text += &format!(
        "static EXP: [u32; EXP_ENTRIES] = [\n{}];\n\n",
        exponential(tables)
    );
    text += &format!(
        "static SENSORS: [SensorTable; {}] = [\n",
        tables.sensors.len()
    );
    for (table, number) in tables.sensors.iter().zip(&header.sensors) {
        text += &sensor(table, *number);
    }
    text += "];\n";
    if !built.compensations.is_empty() {
        text += &compensations(&built.compensations);
    }
    text
}

/// The compensations as the debug form of their structs, which is Rust's own notation but for slices.
fn compensations(list: &[OwnedCompensation]) -> String {
    let mut text = format!(
        "\n#[rustfmt::skip]\nstatic COMPENSATIONS: [Compensation; {}] = [\n",
        list.len()
    );
    for compensation in list {
        let view = compensation.view();
        let field = view
            .field
            .map(|effect| literal(&effect, "OnField", effect.as_ref().map(on_field)));
        let force = view
            .force
            .map(|effect| literal(&effect, "OnForce", effect.as_ref().map(on_force)));
        text += &format!(
            "    Compensation {{ number: {}, field: [{}], force: [{}] }},\n",
            view.number,
            field.join(", "),
            force.join(", ")
        );
    }
    text + "];\n"
}

/// `Some(Kind::Variant(module::Table { .. }))`, with a reference before every slice.
fn literal(effect: &impl std::fmt::Debug, kind: &str, module: Option<&str>) -> String {
    let Some(module) = module else {
        return "None".to_owned();
    };
    format!("{effect:?}")
        .replacen("Some(", &format!("Some({kind}::"), 1)
        .replace("covariate: ", "covariate: Covariate::")
        .replace("Table {", &format!("{module}::Table {{"))
        .replace("Slider {", "hysteresis::Slider {")
        .replace("knots: [[", "knots: &[[")
        .replace("values: [", "values: &[")
}

fn on_field(effect: &OnField) -> &'static str {
    match effect {
        OnField::SensorTemperature(_) => "sensor_temperature",
        OnField::MotorLeakage(_) => "motor_leakage",
        OnField::EarthField(_) => "earth_field",
        OnField::NeighbourMagnet(_) => "neighbour_magnet",
        OnField::Map(_) => "map",
        OnField::MagnetTemperature(_) => "magnet_temperature",
        OnField::ThermalGap(_) => "thermal_gap",
    }
}

fn on_force(effect: &OnForce) -> &'static str {
    match effect {
        OnForce::ViscousLag(_) => "viscous_lag",
        OnForce::Creep(_) => "creep",
        OnForce::HardStop(_) => "hard_stop",
        OnForce::Hysteresis(_) => "hysteresis",
        OnForce::FingertipMass(_) => "fingertip_mass",
        OnForce::Map(_) => "map",
    }
}

fn comment(chosen: &Chosen, header: &Header) -> String {
    let recorded = match header.recorded.is_empty() {
        true => "not stated in recording.toml".to_owned(),
        false => header.recorded.join(", "),
    };
    let mut text = format!(
        "{MARK} Do not edit: fit again and export again.\n\
         //\n\
         // inputs    {} (SHA-256 of the model file)\n\
         // model     {}, campaign {}\n\
         // effects   {}\n\
         // recorded  {recorded}\n\
         // shape     {} x {} centres, gamma {:.4}, ridge {:.0e}\n\
         //\n\
         // Over the design box, in newtons, root mean square / greatest, for Fx and Fz:\n",
        header.inputs_sha256,
        header.variant,
        header.campaign,
        if header.effects.is_empty() {
            "none beside the base".to_owned()
        } else {
            header.effects.join(", ")
        },
        chosen.shape.centres_across,
        chosen.shape.centres_across,
        chosen.shape.gamma,
        chosen.shape.ridge,
    );
    for (errors, number) in chosen.errors.iter().zip(&header.sensors) {
        let both = |(rms, worst): ([f64; 2], [f64; 2])| {
            format!(
                "{:.3} / {:.3}, {:.3} / {:.3}",
                rms[0], worst[0], rms[1], worst[1]
            )
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
    let scale = table.scale.map(|axis| {
        format!(
            "AxisScale {{ offset: {}, gain: {} }}",
            axis.offset, axis.gain
        )
    });
    let used = usize::from(table.used_pairs).min(table.pairs.len());
    let pairs: String = table.pairs[..used].iter().map(pair).collect();
    format!(
        "    // Sensor {number}.\n    SensorTable {{\n        number: {number},\n        scale: [\n            {},\n        ],\n        \
         limit_counts: {},\n        linear: Linear {{\n            bias: {},\n            slope: [{}, {}],\n        }},\n        \
         pairs: padded([\n{pairs}        ]),\n        used_pairs: {},\n        shift: {},\n        \
         parity: Parity {{\n            axis: {},\n            // Powers from the highest down, as `parity.rs` reads them.\n            \
         terms: {},\n            spread: {},\n        }},\n    }},\n",
        scale.join(",\n            "),
        table.limit_counts,
        list(&table.linear.bias),
        list(&table.linear.slope[0]),
        list(&table.linear.slope[1]),
        table.used_pairs,
        list(&table.shift),
        table.parity.axis,
        list(&table.parity.terms),
        table.parity.spread,
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
