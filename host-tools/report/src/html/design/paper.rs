//! Figures and statements of the paper on fields, sensitivity and materials.

use maud::{Markup, html};
use model_export::design::paper::{Curve, MATERIALS, PaperResults, Verdict};

use crate::html::design::sweep::points;
use crate::html::design::{clouds, curves};
use crate::html::plot::Along;
use crate::html::{Section, palette};

/// Statements, then each figure.
pub fn sections(paper: &PaperResults) -> Vec<Section> {
    vec![
        claims(paper),
        section(
            "shapes",
            "Four shapes",
            "Field of four magnets in a box of 2.5 mm, the tube with a hole of \
            1 mm, 1.5 mm from the element and moved along x.",
            ("motion, mm", "Bx, G"),
            &paper.shapes,
        ),
        section(
            "motion",
            "Sensitivity over the motion",
            "S = dBx/dx of cylinders 2 mm long at a gap of 1.5 mm.",
            ("motion, mm", "S, G/mm"),
            &paper.motion,
        ),
        section(
            "length",
            "Sensitivity over the length",
            "Greatest S over a motion of 3 mm, at a gap of 1.5 mm.",
            ("length of the magnet, mm", "greatest S, G/mm"),
            &paper.length,
        ),
        section(
            "diameter",
            "Sensitivity over the diameter",
            "Greatest S over a motion of 3 mm, at a gap of 1.5 mm, over the magnet's diameter.",
            ("diameter of the magnet, mm", "greatest S, G/mm"),
            &paper.diameter,
        ),
        section(
            "gap",
            "Sensitivity over the gap",
            "Greatest S over a motion of 3 mm, of cylinders 2 mm long.",
            ("gap, mm", "greatest S, G/mm"),
            &paper.gap,
        ),
        neighbour(paper),
        materials(paper),
    ]
}

fn claims(paper: &PaperResults) -> Section {
    let body = html! {
        p { "Each statement of the paper on magnets, sensitivity and materials, computed with the exact fields and \
            the beams of this tool." }
        @for claim in &paper.claims {
            p { (mark(claim.verdict)) ": " (claim.says) " (" (claim.place) "). " span.note { "Computed: " (claim.found) "." } }
        }
    };
    Section { id: "statements", heading: "Statements of the paper".to_owned(), body }
}

fn mark(verdict: Verdict) -> Markup {
    html! { strong { (verdict.name()) } }
}

fn section(
    id: &'static str,
    heading: &str,
    words: &str,
    (across, upwards): (&str, &str),
    lines: &[Curve],
) -> Section {
    let body = html! { p { (words) } (drawn(words, (across, upwards), lines)) };
    Section { id, heading: heading.to_owned(), body }
}

fn drawn(says: &str, (across, upwards): (&str, &str), lines: &[Curve]) -> Markup {
    let (lines, all) = named(lines);
    let across = Along::holding(across, all.iter().map(|point| point.0));
    let upwards = Along::holding(upwards, all.iter().map(|point| point.1));
    curves(says, (across, upwards), &lines)
}

type Named = Vec<(String, Vec<(f64, f64)>)>;

fn named(lines: &[Curve]) -> (Named, Vec<(f64, f64)>) {
    let pairs = |curve: &Curve| curve.points.iter().map(|[x, y]| (*x, *y)).collect::<Vec<_>>();
    let lines: Named = lines.iter().map(|curve| (curve.name.clone(), pairs(curve))).collect();
    let all = lines.iter().flat_map(|(_, points)| points).copied().collect();
    (lines, all)
}

fn neighbour(paper: &PaperResults) -> Section {
    let (lines, all) = named(&paper.neighbour);
    let across = Along::holding("distance of the centres, mm", all.iter().map(|point| point.0));
    let upwards = Along::powers("field, G", all.iter().map(|point| point.1));
    let says =
        "Field of the opposite finger's magnet at the element, over the distance of the two.";
    let body = html! {
        p { (says) " Three resolutions of 0.1 G are 0.3 G." }
        (curves(says, (across, upwards), &lines))
    };
    Section { id: "neighbour", heading: "The opposite magnet".to_owned(), body }
}

fn materials(paper: &PaperResults) -> Section {
    let roles = [palette::SECOND, palette::FIRST];
    let all = MATERIALS.into_iter().zip(&paper.designs).zip(roles);
    // Metal first, plastic above it.
    let all = all.rev().map(|((name, designs), role)| {
        (role, name.to_owned(), points(designs.iter(), |one| one.g_per_n))
    });
    let body = html! {
        p { (paper.designs[0].len()) " designs of each material: beams of 10 to 60 mm, 5 to 20 mm wide and 1 to 8 mm thick, \
            magnets of 1 to 8 mm, gaps of 1 to 4 mm; stroke 0.5 mm, 10⁷ cycles, safety 1.5." }
        (clouds("Sensitivity over the force range, of a metal and of a plastic.", ("force range, N", "sensitivity, G/N"),
            &all.collect::<Vec<_>>()))
    };
    Section { id: "materials", heading: "Materials".to_owned(), body }
}
