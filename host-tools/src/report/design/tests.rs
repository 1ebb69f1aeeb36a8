use model_export::design::interference::Surroundings;
use model_export::design::paper::Paper;
use model_export::design::points::Sample;
use model_export::design::sweep::{Space, front, shifts, sweep};
use model_export::design::{Design, Judged};

use super::*;
use crate::report::page_of;

fn around() -> Surroundings {
    Surroundings::assumed(1, 4)
}

#[test]
fn the_page_of_a_design_shows_its_range_and_what_ends_it() {
    let design = Design::magpie();
    let shifts = shifts(&design, 250.0, &around());
    let page = page_of("design", &of_one(&design, &Judged::of(&design), &shifts));
    for words in [
        "Lateral: 250 N, ended by stroke",
        "17-4PH",
        "Earth",
        "<svg",
        "ASTM A564",
        "Shigley",
    ] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn the_page_of_a_sweep_draws_its_designs_and_lists_the_best() {
    let candidates = sweep(&Design::magpie(), &Space::default(), 64, &around(), || {});
    let front = front(&candidates);
    let page = page_of("sweep", &of_sweep(&candidates, &front, Sample::Sobol));
    assert!(page.matches("<circle").count() > 64);
    assert!(page.contains("Designs that no other beats") && page.contains("fatigue"));
}

#[test]
fn the_paper_s_page_marks_every_statement_and_draws_every_figure() {
    let paper = Paper::of(32, &around(), || {});
    let page = page_of("paper", &of_paper(&paper));
    let marked = ["reproduced", "not reproduced", "impossible as stated"];
    let marked = marked.map(|verdict| page.matches(&format!("<strong>{verdict}</strong>")).count());
    assert_eq!(marked.iter().sum::<usize>(), paper.claims.len());
    assert_eq!(page.matches("<figure>").count(), 7);
}
