//! Text and JSON of an evaluated sensor design, for commands and reports.

use analysis::numbers;
use firmware::config::constants::{self, Constant};
use model_export::design::evaluation::{AxisEvaluation, DesignEvaluation, RangeLimit};
use model_export::design::interference::{self, FieldShift, misalignment};
use model_export::design::material::Material;
use model_export::design::sweep::Candidate;
use model_export::design::{SensorDesign, design_file};
use model_export::recordings::description::MagnetShape;
use serde_json::{Value, json};

use crate::text::terminal::{self, TextTable};
use analysis::numbers::number;

/// Limits within this fraction above the force range are reported too.
pub const NEAR: f64 = 0.1;

/// The evaluation of a design as text, without the assumptions.
pub fn format_report(
    design: &SensorDesign,
    evaluation: &DesignEvaluation,
    shifts: &[FieldShift],
) -> String {
    describe(design)
        + "\n"
        + &tables(evaluation, shifts).map(|table| format!("{table}\n\n")).concat()
        + &verdict(design, evaluation)
        + &binding_limits(evaluation)
}

/// The design: one line per flexure, one for magnet and gap.
pub fn describe(design: &SensorDesign) -> String {
    let mut text = String::new();
    for (axis, name) in ["lateral", "longitudinal"].into_iter().enumerate() {
        let flexure = design.flexure(axis);
        text += &format!(
            "{name}: {} beam of {}, {} x {} x {} mm (length, width, thickness); {:.0} N/mm, {:.0} with its mount\n",
            flexure.support.name(),
            flexure.material,
            numbers::decimal(flexure.length_mm, 3),
            numbers::decimal(flexure.width_mm, 3),
            numbers::decimal(flexure.thickness_mm, 3),
            design.beam_n_per_mm(axis),
            design.stiffness_n_per_mm(axis),
        );
    }
    text + &format!(
        "magnet: {}, {} T, {} mm from the Hall element\n",
        describe_magnet(&design.magnet.shape),
        numbers::decimal(design.magnet.remanence_t, 3),
        numbers::decimal(design.gap_mm, 3)
    )
}

fn describe_magnet(shape: &MagnetShape) -> String {
    let mm = |size: f64| numbers::decimal(size, 3);
    match *shape {
        MagnetShape::Cylinder { diameter_mm, length_mm } => {
            format!("cylinder {} x {} mm", mm(diameter_mm), mm(length_mm))
        }
        MagnetShape::Tube { diameter_mm, hole_mm, length_mm } => format!(
            "tube {} x {} mm with a hole of {} mm",
            mm(diameter_mm),
            mm(length_mm),
            mm(hole_mm)
        ),
        MagnetShape::Cube { side_mm } => format!("cube of {} mm", mm(side_mm)),
        MagnetShape::Sphere { diameter_mm } => format!("sphere of {} mm", mm(diameter_mm)),
    }
}

/// A quantity of both axes: name, unit, values.
type AxisQuantity = (&'static str, &'static str, [f64; 2]);

fn figures(evaluation: &DesignEvaluation) -> Vec<AxisQuantity> {
    let both = |of: fn(&AxisEvaluation) -> f64| evaluation.axes.each_ref().map(of);
    let measured = |of: fn(&AxisEvaluation) -> f64| {
        evaluation
            .axes
            .each_ref()
            .map(|axis| if axis.is_measurable() { of(axis) } else { f64::INFINITY })
    };
    vec![
        ("force range", "N", both(AxisEvaluation::range_n)),
        ("stiffness", "N/mm", both(|axis| axis.stiffness_n_per_mm)),
        ("field gradient at rest", "G/mm", both(|axis| axis.sensitivity.rest_g_per_mm)),
        ("minimum over the stroke", "%", both(|axis| 100.0 * axis.sensitivity.constancy)),
        ("sensitivity", "G/N", both(|axis| axis.g_per_n)),
        ("noise of one reading", "N", measured(|axis| axis.noise_n)),
        ("resolution", "N", measured(|axis| axis.resolution_n)),
        ("stress at full range, of yield", "%", both(|axis| 100.0 * axis.yield_share)),
        ("tilt at full range", "deg", both(|axis| axis.tilt_rad.to_degrees())),
        ("gap reduction", "mm", both(|axis| axis.gap_closure_mm)),
    ]
}

/// Force limit of both axes by cause, in N.
fn limits(evaluation: &DesignEvaluation) -> Vec<(RangeLimit, [f64; 2])> {
    let of = |i: usize| evaluation.axes.each_ref().map(|axis| axis.limits.force_n[i]);
    let causes = RangeLimit::ALL.into_iter().enumerate();
    causes.map(|(i, cause)| (cause, of(i))).collect()
}

/// Tables of quantities, force limits and interference.
pub fn tables(evaluation: &DesignEvaluation, shifts: &[FieldShift]) -> [TextTable; 3] {
    let quantities = figures(evaluation).into_iter();
    let quantities = quantities
        .map(|(name, unit, [x, z])| [name.to_owned(), unit.to_owned(), number(x), number(z)]);
    let limits = limits(evaluation).into_iter().map(|(cause, limits_n)| {
        let [x, z] = limits_n.map(|force_n| {
            if force_n.is_finite() { number(force_n) } else { "not reached".to_owned() }
        });
        [cause.name().to_owned(), "N".to_owned(), x, z]
    });
    let interference = shifts.iter().map(|shift| {
        [
            shift.name.to_owned(),
            shift.meaning.to_owned(),
            number(shift.gauss),
            number(shift.resolutions),
            number(shift.newtons),
        ]
    });
    [
        TextTable::new(&["", "unit", "lateral", "longitudinal"], 2, quantities),
        TextTable::new(&["range limited by", "unit", "lateral", "longitudinal"], 2, limits),
        TextTable::new(&["interference", "condition", "G", "counts", "N"], 2, interference),
    ]
}

/// The binding constraints and their remedies.
pub fn binding_limits(evaluation: &DesignEvaluation) -> String {
    let mut text = String::new();
    for (axis, name) in evaluation.axes.iter().zip(["Lateral", "Longitudinal"]) {
        let near = axis.limits.near(NEAR);
        let Some(((range_n, first), others)) = near.split_first() else {
            continue;
        };
        text += &terminal::paragraph(&format!(
            "{name}: {} N, limited by {}; remedy: {}.",
            number(*range_n),
            first.name(),
            first.remedy()
        ));
        for (force_n, cause) in others {
            text += &terminal::paragraph(&format!(
                "  Next limit at {} N: {}; {}.",
                number(*force_n),
                cause.name(),
                cause.remedy()
            ));
        }
        if axis.exceeds_beam_model() {
            text += &terminal::paragraph(
                "  Beam tilt above 0.15 rad: the error of the beam equations exceeds 2 %.",
            );
        }
    }
    text
}

/// The assumed constants, including the materials of the design.
pub fn assumptions(design: &SensorDesign) -> String {
    let mut constants: Vec<(String, Constant)> = Vec::new();
    let named = |constant: Constant| (constant.name.to_owned(), constant);
    constants.extend([constants::SENSOR_NOISE].into_iter().chain(design_file::ALL).map(named));
    for axis in [0, 1] {
        let name = &design.flexure(axis).material;
        if axis == 1 && *name == design.flexure(0).material {
            continue;
        }
        let of = Material::named(name).map(Material::constants);
        let named = |constant: Constant| (format!("{name}, {}", constant.name), constant);
        constants.extend(of.into_iter().flatten().map(named));
    }
    // The design gives the mounting tolerances of the magnet.
    let mounted =
        [misalignment::OFFSET, misalignment::GAP, misalignment::TILT, misalignment::REMANENCE];
    let interference = interference::ASSUMED.into_iter();
    constants.extend(interference.filter(|one| !mounted.contains(one)).map(named));
    let texts: Vec<String> = constants
        .iter()
        .filter(|(_, constant)| constant.is_assumed())
        .map(|(name, constant)| {
            let value = match constant.value.abs() {
                size if size >= 1e6 => format!("{:e}", constant.value),
                _ => numbers::decimal(constant.value, 4),
            };
            format!("{name} {value} {}", constant.unit).trim_end().to_owned()
        })
        .collect();
    let made = design.tolerances;
    terminal::paragraph(&format!(
        "Tolerances (two standard deviations): {} mm offset, {} mm gap, {} degrees tilt, {} % remanence. Assumed unless \
         the design specifies them: {}.",
        numbers::decimal(made.offset_mm, 3),
        numbers::decimal(made.gap_mm, 3),
        numbers::decimal(made.tilt_deg, 2),
        numbers::decimal(100.0 * made.remanence, 2),
        texts.join(", ")
    ))
}

pub fn to_json(
    design: &SensorDesign,
    evaluation: &DesignEvaluation,
    shifts: &[FieldShift],
) -> Value {
    let axis = |number: usize| {
        let axis = &evaluation.axes[number];
        let (range_n, cause) = axis.limits.binding();
        let limits = RangeLimit::ALL.into_iter().zip(axis.limits.force_n);
        let limits: serde_json::Map<String, Value> = limits
            .map(|(cause, force_n)| (cause.name().replace(' ', "_"), json!(force_n)))
            .collect();
        json!({
            "range_n": range_n,
            "ended_by": cause.name(),
            "limits_n": limits,
            "stiffness_n_per_mm": axis.stiffness_n_per_mm,
            "beam_n_per_mm": axis.beam_n_per_mm,
            "sensitivity_g_per_mm": axis.sensitivity.rest_g_per_mm,
            "constancy": axis.sensitivity.constancy,
            "g_per_n": axis.g_per_n,
            "noise_n": axis.noise_n,
            "resolution_n": axis.resolution_n,
            "yield_share": axis.yield_share,
            "lean_rad": axis.tilt_rad,
            "nearer_mm": axis.gap_closure_mm,
        })
    };
    json!({
        "design": design,
        "rest_g": evaluation.rest_g,
        "asked_n": design.force_range_n,
        "reaches": evaluation.covers_range(design.force_range_n),
        "lateral": axis(0),
        "longitudinal": axis(1),
        "interference": shifts,
    })
}

/// Whether the design reaches the required force range.
pub fn verdict(design: &SensorDesign, evaluation: &DesignEvaluation) -> String {
    let required = number(design.force_range_n);
    let names = ["lateral", "longitudinal"];
    let axes = || evaluation.axes.iter().zip(names);
    let ranges: Vec<String> =
        axes().map(|(axis, name)| format!("{name} {} N", number(axis.range_n()))).collect();
    let unmeasured: Vec<&str> =
        axes().filter(|(axis, _)| !axis.is_measurable()).map(|(_, name)| name).collect();
    let range = number(evaluation.range_n());
    let sentence = if !unmeasured.is_empty() {
        format!(
            "Cannot be assessed: the {} force changes the field by less than its noise, so the sensor does not measure it; choose \
             another axis of the magnet. The beams bear {}.",
            unmeasured.join(" and the "),
            ranges.join(", "),
        )
    } else if evaluation.covers_range(design.force_range_n) {
        format!(
            "Force range at least {range} N on each axis ({}); required {required} N.",
            ranges.join(", ")
        )
    } else {
        format!("Insufficient force range: {} ({required} N required).", ranges.join(", "))
    };
    terminal::paragraph(&sentence)
}

/// Headers of [`candidate_row`].
pub const CANDIDATE_HEADS: [&str; 8] = [
    "range, N",
    "G/N",
    "interference, N",
    "limited by",
    "material",
    "beam, mm",
    "magnet, mm",
    "gap, mm",
];

/// A candidate as a table row; beam: length, width, thickness; magnet: diameter and length.
pub fn candidate_row(candidate: &Candidate) -> [String; 8] {
    let beam = &candidate.design.flexure_x;
    let mm = |size: f64| numbers::decimal(size, 1);
    let magnet = match candidate.design.magnet.shape {
        MagnetShape::Cylinder { diameter_mm, length_mm } => {
            format!("{} x {}", mm(diameter_mm), mm(length_mm))
        }
        other => describe_magnet(&other),
    };
    [
        number(candidate.range_n),
        number(candidate.g_per_n),
        number(candidate.interference_n),
        candidate.cause.name().to_owned(),
        beam.material.clone(),
        format!("{:.0} x {:.0} x {}", beam.length_mm, beam.width_mm, mm(beam.thickness_mm)),
        magnet,
        numbers::decimal(candidate.design.gap_mm, 2),
    ]
}

/// Number of designs limited by each cause.
pub fn causes(candidates: &[Candidate]) -> Vec<(RangeLimit, usize)> {
    let count = |cause| candidates.iter().filter(|one| one.cause == cause).count();
    RangeLimit::ALL.map(|cause| (cause, count(cause))).to_vec()
}
