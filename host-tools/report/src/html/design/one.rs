//! Evaluation of one design.

use analysis::numbers;
use maud::html;
use model_export::design::axis::{DesignAxis, slope};
use model_export::design::interference::FieldShift;
use model_export::design::material::Material;
use model_export::design::{DesignEvaluation, SensorDesign};
use model_export::physics::ForwardModel;

use crate::html::Section;
use crate::html::design::curves;
use crate::html::plot::Along;
use crate::html::tables::{table, text_table};
use crate::text::design as text;
use crate::text::terminal::TextTable;

/// Points per curve.
const POINTS: u32 = 100;

/// Range and its limits, sensitivity, interference, sources of the material
/// constants.
pub fn sections(
    design: &SensorDesign,
    evaluation: &DesignEvaluation,
    shifts: &[FieldShift],
) -> Vec<Section> {
    let [quantities, limits, interference] = text::tables(evaluation, shifts);
    let interference = Section {
        id: "interference",
        heading: "Interference".to_owned(),
        body: text_table("Field changes not caused by forces", &interference),
    };
    let evaluated = evaluation_section(design, evaluation, &quantities, &limits);
    vec![evaluated, answers(design), interference, sources(design)]
}

fn evaluation_section(
    design: &SensorDesign,
    evaluation: &DesignEvaluation,
    quantities: &TextTable,
    limits: &TextTable,
) -> Section {
    let body = html! {
        @for line in text::describe(design).lines() { p { (line) } }
        p { (text::verdict(design, evaluation)) }
        @for line in text::binding_limits(evaluation).split('\n').filter(|line| !line.is_empty()) { p.note { (line) } }
        (text_table("Each axis", quantities))
        (text_table("Force at each limit of the range", limits))
        p.note { "Not reached: other limits are reached long before. " (text::assumptions(design)) }
    };
    Section { id: "judged", heading: "Design".to_owned(), body }
}

fn answers(design: &SensorDesign) -> Section {
    let model = ForwardModel::nominal(&design.nominal());
    let stroke_mm = design.limits.stroke_mm;
    let steps = || (0..=2 * POINTS).map(|i| stroke_mm * (f64::from(i) / f64::from(POINTS) - 1.0));
    let of = |number: usize, name: &str| {
        let axis = DesignAxis::of(design, number);
        let direction = axis.direction();
        let component = slope(&model, direction, 0.0).iamax();
        let at = |mm: f64| (mm, slope(&model, direction, mm)[component].abs());
        (name.to_owned(), steps().map(at).collect::<Vec<_>>())
    };
    let mut lines = vec![of(0, "lateral"), of(1, "longitudinal")];
    // A round magnet has the same sensitivity in both axes: one curve.
    if alike(&lines[0].1, &lines[1].1) {
        lines.truncate(1);
        lines[0].0 = "both axes".to_owned();
    }
    let all = lines.iter().flat_map(|(_, points)| points);
    let upwards = Along::bars("S, G/mm", all.map(|point| point.1));
    let across = Along::holding("motion, mm", [-stroke_mm, stroke_mm]);
    let body = html! {
        p { "Field change per millimetre of motion, for the most sensitive axis of the sensor." }
        (curves("Sensitivity over the stroke.", (across, upwards), &lines))
    };
    Section { id: "sensitivity", heading: "Sensitivity over the stroke".to_owned(), body }
}

/// True where two curves coincide in the plot.
fn alike(one: &[(f64, f64)], other: &[(f64, f64)]) -> bool {
    let greatest = one.iter().map(|(_, y)| y.abs()).fold(0.0, f64::max);
    let mut pairs = one.iter().zip(other);
    pairs.all(|((_, a), (_, b))| (a - b).abs() < 2e-3 * greatest)
}

/// Constants of the built-in materials; those of a design file have no source here.
fn sources(design: &SensorDesign) -> Section {
    let mut names = [0, 1].map(|axis| design.flexure(axis).material.as_str()).to_vec();
    names.dedup();
    let materials = names.into_iter().filter_map(Material::named);
    let rows = materials.flat_map(|material| {
        material.constants().map(|constant| {
            let value = format!("{} {}", numbers::decimal(constant.value, 3), constant.unit);
            [
                format!("{}: {}", material.name, constant.name),
                value,
                constant.basis.name().to_owned(),
                constant.source.to_owned(),
            ]
        })
    });
    let body = html! {
        p { "The S-N curve is Basquin's: amplitude = coefficient (2 cycles)^exponent, fully reversed, of smooth \
            specimens, half of which fail." }
        (table("Material constants and their sources", &["constant", "value", "", "source"], rows))
    };
    Section { id: "sources", heading: "Materials".to_owned(), body }
}
