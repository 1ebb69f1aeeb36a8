//! A judged design in tables, sentences and JSON.

use firmware::params::{self, Constant};
use model_export::design::interference::{self, Shift, misalignment};
use model_export::design::judge::{Judged, JudgedAxis};
use model_export::design::limits::Cause;
use model_export::design::material::Material;
use model_export::design::{Design, assumed};
use model_export::recordings::description::Shape;
use serde_json::{Value, json};

use crate::report::numbers::number;
use crate::show;

/// A limit this close above the end of a range binds as well.
pub const NEAR: f64 = 0.1;

/// The design in one sentence for each flexure, and one for magnet and gap.
pub fn described(design: &Design) -> String {
    let mut text = String::new();
    for (axis, name) in ["lateral", "longitudinal"].into_iter().enumerate() {
        let flexure = design.flexure(axis);
        text += &format!(
            "{name}: {} beam of {}, {} x {} x {} mm (length, width, thickness); {:.0} N/mm alone, {:.0} with its mount\n",
            flexure.support.name(),
            flexure.material,
            show::plain(flexure.length_mm, 3),
            show::plain(flexure.width_mm, 3),
            show::plain(flexure.thickness_mm, 3),
            design.beam_n_per_mm(axis),
            design.stiffness_n_per_mm(axis),
        );
    }
    text + &format!(
        "magnet: {}, {} T, {} mm from the Hall element\n",
        magnet(&design.magnet.shape),
        show::plain(design.magnet.remanence_t, 3),
        show::plain(design.gap_mm, 3)
    )
}

/// A magnet's shape in words.
pub fn magnet(shape: &Shape) -> String {
    let mm = |size: f64| show::plain(size, 3);
    match *shape {
        Shape::Cylinder {
            diameter_mm,
            length_mm,
        } => format!("cylinder {} x {} mm", mm(diameter_mm), mm(length_mm)),
        Shape::Tube {
            diameter_mm,
            hole_mm,
            length_mm,
        } => format!(
            "tube {} x {} mm with a hole of {} mm",
            mm(diameter_mm),
            mm(length_mm),
            mm(hole_mm)
        ),
        Shape::Cube { side_mm } => format!("cube of {} mm", mm(side_mm)),
        Shape::Sphere { diameter_mm } => format!("sphere of {} mm", mm(diameter_mm)),
    }
}

/// A figure of both axes: name, unit, the two numbers.
pub type Figure = (&'static str, &'static str, [f64; 2]);

/// Figures of a judged design.
pub fn figures(judged: &Judged) -> Vec<Figure> {
    let both = |of: fn(&JudgedAxis) -> f64| judged.axes.each_ref().map(of);
    vec![
        ("force range", "N", both(JudgedAxis::range_n)),
        ("stiffness", "N/mm", both(|axis| axis.stiffness_n_per_mm)),
        (
            "sensitivity at rest",
            "G/mm",
            both(|axis| axis.sensitivity.rest_g_per_mm),
        ),
        (
            "least of it over the stroke",
            "%",
            both(|axis| 100.0 * axis.sensitivity.constancy),
        ),
        ("field for a newton", "G/N", both(|axis| axis.g_per_n)),
        ("noise of one reading", "N", both(|axis| axis.noise_n)),
        ("one count", "N", both(|axis| axis.resolution_n)),
        (
            "stress at full range, of yield",
            "%",
            both(|axis| 100.0 * axis.yield_share),
        ),
        (
            "lean at full range",
            "deg",
            both(|axis| axis.lean_rad.to_degrees()),
        ),
        ("gap closes by", "mm", both(|axis| axis.nearer_mm)),
    ]
}

/// Force at which each cause ends the range of both axes, in N.
pub fn limits(judged: &Judged) -> Vec<(Cause, [f64; 2])> {
    let of = |i: usize| judged.axes.each_ref().map(|axis| axis.limits.force_n[i]);
    let causes = Cause::ALL.into_iter().enumerate();
    causes.map(|(i, cause)| (cause, of(i))).collect()
}

/// All of it as tables.
pub fn tables(judged: &Judged, shifts: &[Shift]) -> String {
    let mut of_axes = show::table(["", "unit", "lateral", "longitudinal"]);
    for (name, unit, [x, z]) in figures(judged) {
        of_axes.add_row([name.to_owned(), unit.to_owned(), number(x), number(z)]);
    }
    let mut ends = show::table(["range ended by", "unit", "lateral", "longitudinal"]);
    for (cause, [x, z]) in limits(judged) {
        let [x, z] = [x, z].map(|force_n| match force_n.is_finite() {
            true => number(force_n),
            false => "later".to_owned(),
        });
        ends.add_row([cause.name().to_owned(), "N".to_owned(), x, z]);
    }
    let mut interfering = show::table(["interference", "stated", "G", "counts", "N"]);
    for shift in shifts {
        interfering.add_row([
            shift.name.to_owned(),
            shift.meaning.to_owned(),
            number(shift.gauss),
            number(shift.resolutions),
            number(shift.newtons),
        ]);
    }
    for table in [&mut of_axes, &mut ends, &mut interfering] {
        show::right_align(table, 2);
    }
    format!("{of_axes}\n\n{ends}\n\n{interfering}\n\n")
}

/// Which constraints bind, and what would move them.
pub fn binding(judged: &Judged) -> String {
    let mut text = String::new();
    for (axis, name) in judged.axes.iter().zip(["Lateral", "Longitudinal"]) {
        let near = axis.limits.near(NEAR);
        let Some(((range_n, first), others)) = near.split_first() else {
            continue;
        };
        text += &show::paragraph(&format!(
            "{name}: {} N, ended by {}; what helps: {}.",
            number(*range_n),
            first.name(),
            first.remedy()
        ));
        for (force_n, cause) in others {
            text += &show::paragraph(&format!(
                "  Close behind at {} N: {}; {}.",
                number(*force_n),
                cause.name(),
                cause.remedy()
            ));
        }
        if axis.beyond_von_karman() {
            text += &show::paragraph(
                "  The beam leans by more than 0.15 rad: its equations are off by more than 2 % there.",
            );
        }
    }
    text
}

/// The constants that nobody has stated, with the materials of the design.
pub fn assumed(design: &Design) -> String {
    let mut constants: Vec<(String, Constant)> = Vec::new();
    let named = |constant: Constant| (constant.name.to_owned(), constant);
    constants.extend(
        [params::SENSOR_NOISE]
            .into_iter()
            .chain(assumed::ALL)
            .map(named),
    );
    for axis in [0, 1] {
        let name = &design.flexure(axis).material;
        if axis == 1 && *name == design.flexure(0).material {
            continue;
        }
        let of = Material::named(name).map(Material::constants);
        let named = |constant: Constant| (format!("{name}, {}", constant.name), constant);
        constants.extend(of.into_iter().flatten().map(named));
    }
    // How a magnet is mounted is the design's own to say.
    let mounted = [
        misalignment::OFFSET,
        misalignment::GAP,
        misalignment::TILT,
        misalignment::REMANENCE,
    ];
    let around = interference::ASSUMED.into_iter();
    constants.extend(around.filter(|one| !mounted.contains(one)).map(named));
    let words: Vec<String> = constants
        .iter()
        .filter(|(_, constant)| constant.assumed)
        .map(|(name, constant)| {
            let value = match constant.value.abs() {
                size if size >= 1e6 => format!("{:e}", constant.value),
                _ => show::plain(constant.value, 4),
            };
            format!("{name} {value} {}", constant.unit)
                .trim_end()
                .to_owned()
        })
        .collect();
    let made = design.tolerances;
    show::paragraph(&format!(
        "Made within {} mm of place, {} mm of gap, {} degrees of tilt and {} % of remanence, two standard deviations. \
         Assumed unless the design says otherwise: {}.",
        show::plain(made.offset_mm, 3),
        show::plain(made.gap_mm, 3),
        show::plain(made.tilt_deg, 2),
        show::plain(100.0 * made.remanence, 2),
        words.join(", ")
    ))
}

/// A judged design.
pub fn report_json(design: &Design, judged: &Judged, shifts: &[Shift]) -> Value {
    let axis = |number: usize| {
        let axis = &judged.axes[number];
        let (range_n, cause) = axis.limits.binding();
        let limits = Cause::ALL.into_iter().zip(axis.limits.force_n);
        let limits: serde_json::Map<String, Value> = limits
            .map(|(cause, force_n)| (cause.name().replace(' ', "_"), json!(finite(force_n))))
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
            "noise_n": finite(axis.noise_n),
            "resolution_n": finite(axis.resolution_n),
            "yield_share": axis.yield_share,
            "lean_rad": axis.lean_rad,
            "nearer_mm": axis.nearer_mm,
        })
    };
    json!({
        "design": design,
        "rest_g": judged.rest_g,
        "asked_n": design.force_range_n,
        "reaches": judged.reaches(design.force_range_n),
        "lateral": axis(0),
        "longitudinal": axis(1),
        "interference": shifts_json(shifts),
    })
}

/// What interferes.
pub fn shifts_json(shifts: &[Shift]) -> Vec<Value> {
    let one = |shift: &Shift| {
        json!({
            "name": shift.name,
            "meaning": shift.meaning,
            "gauss": shift.gauss,
            "resolutions": shift.resolutions,
            "newtons": finite(shift.newtons),
        })
    };
    shifts.iter().map(one).collect()
}

/// JSON knows no infinity.
pub fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}
