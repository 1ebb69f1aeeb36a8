//! A design judged.

use maud::html;
use model_export::design::axis::Axis;
use model_export::design::interference::Shift;
use model_export::design::material::Material;
use model_export::design::sensitivity::slope;
use model_export::design::{Design, Judged};
use model_export::physics::ForwardModel;

use super::curves;
use crate::commands::design::{check, words};
use crate::report::Section;
use crate::report::numbers::number;
use crate::report::plot::Along;
use crate::report::tables::table;
use crate::show;

/// Points of a curve.
const POINTS: u32 = 100;

/// What it measures, what ends its range, how it answers, what interferes, where its materials' numbers come
/// from.
pub fn sections(design: &Design, judged: &Judged, shifts: &[Shift]) -> Vec<Section> {
    vec![
        judged_section(design, judged),
        answers(design),
        interference(shifts),
        sources(design),
    ]
}

fn judged_section(design: &Design, judged: &Judged) -> Section {
    let figures = words::figures(judged)
        .into_iter()
        .map(|(name, unit, [x, z])| {
            [name.to_owned(), unit.to_owned(), number(x), number(z)]
                .map(|cell| html! { (cell) })
                .to_vec()
        });
    let limits = words::limits(judged).into_iter().map(|(cause, [x, z])| {
        [cause.name().to_owned(), number(x), number(z)]
            .map(|cell| html! { (cell) })
            .to_vec()
    });
    let body = html! {
        @for line in words::described(design).lines() { p { (line) } }
        p { (check::verdict(design, judged)) }
        @for line in words::binding(judged).split('\n').filter(|line| !line.is_empty()) { p.note { (line) } }
        (table("What each axis measures", &["figure", "unit", "lateral", "longitudinal"], figures))
        (table("Force in newtons at which the range would end", &["by", "lateral", "longitudinal"], limits))
        p.note { "A dash: others come long before. " (words::assumed(design)) }
    };
    Section {
        id: "judged",
        heading: "The design".to_owned(),
        body,
    }
}

fn answers(design: &Design) -> Section {
    let model = ForwardModel::nominal(&design.nominal());
    let stroke_mm = design.limits.stroke_mm;
    let steps = || (0..=2 * POINTS).map(|i| stroke_mm * (f64::from(i) / f64::from(POINTS) - 1.0));
    let of = |number: usize, name: &str| {
        let axis = Axis::of(design, number);
        let direction = axis.direction();
        let component = slope(&model, direction, 0.0).iamax();
        let at = |mm: f64| (mm, slope(&model, direction, mm)[component].abs());
        (name.to_owned(), steps().map(at).collect::<Vec<_>>())
    };
    let mut lines = vec![of(0, "lateral"), of(1, "longitudinal")];
    // Around a magnet that is round both axes answer alike: one curve, not one hidden by another.
    if alike(&lines[0].1, &lines[1].1) {
        lines.truncate(1);
        lines[0].0 = "both axes".to_owned();
    }
    let all = lines.iter().flat_map(|(_, points)| points);
    let upwards = Along::bars("S, G/mm", all.map(|point| point.1));
    let across = Along::holding("motion, mm", [-stroke_mm, stroke_mm]);
    let body = html! {
        p { "Field for a millimetre of motion, of the sensor's axis that answers most." }
        (curves("Sensitivity over the stroke.", (across, upwards), &lines))
    };
    Section {
        id: "sensitivity",
        heading: "Sensitivity over the stroke".to_owned(),
        body,
    }
}

/// Whether no eye parts two curves.
fn alike(one: &[(f64, f64)], other: &[(f64, f64)]) -> bool {
    let greatest = one.iter().map(|(_, y)| y.abs()).fold(0.0, f64::max);
    let mut pairs = one.iter().zip(other);
    pairs.all(|((_, a), (_, b))| (a - b).abs() < 2e-3 * greatest)
}

/// Numbers of the table's materials that the design is of; those of its own file need no source here.
fn sources(design: &Design) -> Section {
    let mut names = [0, 1]
        .map(|axis| design.flexure(axis).material.as_str())
        .to_vec();
    names.dedup();
    let materials = names.into_iter().filter_map(Material::named);
    let rows = materials.flat_map(|material| {
        material.constants().map(|constant| {
            let value = format!("{} {}", show::plain(constant.value, 3), constant.unit);
            vec![
                html! { (material.name) ": " (constant.name) },
                html! { (value) },
                html! { @if constant.assumed { "assumed" } @else { "stated" } },
                html! { (constant.source) },
            ]
        })
    });
    let body = html! {
        p { "The S-N curve is Basquin's: amplitude = coefficient (2 cycles)^exponent, fully reversed, of smooth \
            specimens, half of which fail." }
        (table("Numbers of the materials, and who says so", &["number", "value", "", "source"], rows))
    };
    Section {
        id: "sources",
        heading: "Materials".to_owned(),
        body,
    }
}

fn interference(shifts: &[Shift]) -> Section {
    let rows = shifts.iter().map(|shift| {
        [
            shift.name.to_owned(),
            shift.meaning.to_owned(),
            number(shift.gauss),
            number(shift.resolutions),
            number(shift.newtons),
        ]
        .map(|cell| html! { (cell) })
        .to_vec()
    });
    let body = html! {
        (table("What moves the field beside the forces", &["cause", "stated", "G", "counts", "N"], rows))
    };
    Section {
        id: "interference",
        heading: "Interference".to_owned(),
        body,
    }
}
