//! Text and JSON of fitted parameters.

use std::collections::BTreeMap;

use analysis::numbers;
use analysis::parameters::{ParameterEstimate, ParameterTable, Prior, Remedy, Unidentified};
use serde_json::{Value, json};

use crate::text::terminal::{self, SENSORS_ACROSS, TextTable};

/// A parameter further from the design, in standard deviations, is marked: the gripper or the design file may be wrong.
const OUTLIER: f64 = 3.0;
/// Correlations above this are named: their parameters are only known together.
const STRONG: f64 = 0.9;
/// Named parameters and pairs.
const NAMED: usize = 3;

/// What the numbers of the table are.
pub const TERMS: &str = "± one standard error (blocks of time; where the data do not decide, the prior). Prior width: \
    of the base the tolerance, an assumed scatter between grippers of one design; of an effect ten typical magnitudes. ?: standard \
    error above half the prior width, the prior decides. !: over 3 standard deviations (tolerance and standard error in quadrature) \
    from the design, check it.";

/// `1.542±0.031`, with the marks of [`TERMS`].
pub fn value(one: &ParameterEstimate) -> String {
    let scale = match one.prior {
        Prior::ManufacturingTolerance => one.prior_width.unwrap_or(f64::INFINITY),
        Prior::Regularisation => one.value.abs(),
    };
    numbers::with_error(one.value, one.std_error, scale)
        + match (one.identifiable, is_outlier(one)) {
            (false, _) => "?",
            (true, true) => "!",
            (true, false) => "",
        }
}

fn is_outlier(one: &ParameterEstimate) -> bool {
    let is_of_design = one.prior == Prior::ManufacturingTolerance;
    is_of_design && one.deviation.is_some_and(|deviation| deviation.abs() > OUTLIER)
}

/// Parameters of these sensors side by side.
pub fn overview(table: &ParameterTable, sensors: &[u32]) -> TextTable {
    let heads = ["parameter", "design", "prior width"].map(String::from).into_iter();
    let heads: Vec<String> =
        heads.chain(sensors.iter().map(|sensor| format!("sensor {sensor}"))).collect();
    let of = |sensor: u32| table.estimates.iter().filter(move |one| one.sensor == sensor);
    let first = sensors.first().into_iter().flat_map(|sensor| of(*sensor));
    let rows = first.map(|row| {
        let is_same = |one: &&ParameterEstimate| one.name == row.name && one.effect == row.effect;
        let same = || sensors.iter().map(|sensor| of(*sensor).find(is_same));
        let values = same().map(|one| one.map(value));
        // Of the sensors together, where they agree.
        let number = |read: fn(&ParameterEstimate) -> Option<f64>| {
            let of_all = read(row).filter(|_| same().flatten().all(|one| read(one) == read(row)));
            numbers::decimal_or_dash(of_all.unwrap_or(f64::NAN), 3)
        };
        let labels = [
            format!("{} {}", row.full_name(), row.unit),
            number(|one| one.nominal),
            number(|one| one.prior_width),
        ];
        labels.into_iter().chain(values.map(Option::unwrap_or_default)).collect::<Vec<_>>()
    });
    TextTable::new(&heads.iter().map(String::as_str).collect::<Vec<_>>(), 1, rows)
}

/// Tables, the furthest from the design, the strongest correlations, and what is not identified.
pub fn format_report(table: &ParameterTable) -> String {
    if table.estimates.is_empty() {
        return String::new();
    }
    let mut text = format!("Fitted parameters\n{}", terminal::paragraph(TERMS));
    for sensors in table.sensors().chunks(SENSORS_ACROSS) {
        text += &format!("{}\n", overview(table, sensors));
    }
    for sentence in sentences(table) {
        text += &terminal::paragraph(&sentence);
    }
    if !table.unidentified.is_empty() {
        text += &terminal::paragraph(UNIDENTIFIED);
    }
    for (remedy, combinations) in by_remedy(table) {
        text += &terminal::paragraph(&format!("To identify them: {remedy}."));
        for (sensor, combinations) in combinations {
            let line = format!("  sensor {sensor}: {}", combinations.join("; "));
            text += &terminal::paragraph(&line);
        }
    }
    text
}

/// What the list of combinations shows.
pub const UNIDENTIFIED: &str = "Not identified, the prior decides (weights in prior widths; in parentheses the standard error from the \
    data alone, in prior widths, and the one with the named recording, where it is computed):";

/// A recording, and of each sensor the combinations that it would identify.
pub type Remedied = (String, Vec<(u32, Vec<String>)>);

/// What is not identified, by the recording that would.
pub fn by_remedy(table: &ParameterTable) -> Vec<Remedied> {
    let mut found: Vec<Remedied> = Vec::new();
    for one in &table.unidentified {
        let remedy = one.remedy.to_string();
        let place = found.iter().position(|(known, _)| *known == remedy);
        let place = place.unwrap_or_else(|| {
            found.push((remedy, Vec::new()));
            found.len() - 1
        });
        let sensors = &mut found[place].1;
        match sensors.last_mut().filter(|(sensor, _)| *sensor == one.sensor) {
            Some((_, combinations)) => combinations.push(combination(one)),
            None => sensors.push((one.sensor, vec![combination(one)])),
        }
    }
    found
}

fn combination(one: &Unidentified) -> String {
    let mut shares: Vec<_> = one.shares.iter().collect();
    shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    let shares: Vec<String> = match shares.as_slice() {
        [(name, _)] => vec![(*name).clone()],
        shares => shares.iter().map(|(name, share)| format!("{share:+.2} {name}")).collect(),
    };
    let within = match one.known_within {
        Some(within) if within < 100.0 => format!("{within:.1}"),
        // Of a parameter of an effect alone no error from the data alone is known.
        None if matches!(one.remedy, Remedy::Effect(..) | Remedy::Formula(_)) => {
            return shares.join(" ");
        }
        _ => "unbounded".to_owned(),
    };
    let then = one.known_within_then.map_or_else(String::new, |then| format!(", then {then:.2}"));
    format!("{} ({within}{then})", shares.join(" "))
}

/// The parameters furthest from the design, and the strongest correlations.
pub fn sentences(table: &ParameterTable) -> Vec<String> {
    let of_design = table.estimates.iter().filter(|one| one.prior == Prior::ManufacturingTolerance);
    let furthest: Vec<(f64, String)> = of_design
        .filter_map(|one| {
            let deviation = one.deviation?;
            let text = format!(
                "sensor {} {} {} {}, {} by design ({deviation:+.1})",
                one.sensor,
                one.name,
                value(one),
                one.unit,
                numbers::decimal(one.nominal?, 3),
            );
            Some((deviation.abs(), text))
        })
        .collect();
    // Of each pair the sensor with the strongest correlation.
    let mut strongest: BTreeMap<(&str, &str), (f64, String)> = BTreeMap::new();
    for of in &table.correlations {
        for (i, name) in of.table.names.iter().enumerate() {
            for (j, other) in of.table.names.iter().enumerate().take(i) {
                let (r, pair) = (of.table.between(i, j), (other.as_str(), name.as_str()));
                let known = strongest.get(&pair).map_or(STRONG, |(size, _)| *size);
                if r.abs() > known {
                    let text = format!("{other} with {name} {r:+.2} (sensor {})", of.sensor);
                    strongest.insert(pair, (r.abs(), text));
                }
            }
        }
    }
    let list = |words: &str, mut all: Vec<(f64, String)>| {
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let named: Vec<&str> = all.iter().take(NAMED).map(|(_, text)| text.as_str()).collect();
        (!named.is_empty()).then(|| format!("{words}: {}.", named.join("; ")))
    };
    let furthest = list(
        "Furthest from the design (in standard deviations of tolerance and error together)",
        furthest,
    );
    let strongest = list(
        &format!("Strongest of the correlations above {STRONG}"),
        strongest.into_values().collect(),
    );
    furthest.into_iter().chain(strongest).collect()
}

/// Adds `parameters`, `correlations` and `unidentified` to the object of a result.
pub fn add_json(object: &mut Value, table: &ParameterTable) {
    object["parameters"] = json!(table.estimates);
    object["correlations"] = json!(table.correlations);
    object["unidentified"] = json!(table.unidentified);
}
