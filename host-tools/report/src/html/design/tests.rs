use model_export::design::interference::InterferenceSources;
use model_export::design::sampling::SamplingMethod;
use model_export::design::sweep::{DesignSpace, pareto_front, shifts, sweep};
use model_export::design::{DesignEvaluation, SensorDesign};

use super::*;
use crate::html::page_of;

fn around() -> InterferenceSources {
    InterferenceSources::assumed(1, 4)
}

#[test]
fn design_page_shows_the_range_and_its_limit() {
    let design = SensorDesign::magpie();
    let shifts = shifts(&design, 250.0, &around());
    let page = page_of("design", &of_one(&design, &DesignEvaluation::of(&design), &shifts));
    for words in ["Lateral: 250 N, limited by", "17-4PH", "Earth", "<svg", "ASTM A564", "Shigley"] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn sweep_page_shows_designs_and_the_pareto_front() {
    let candidates = sweep(&SensorDesign::magpie(), &DesignSpace::default(), 64, &around(), || {});
    let front = pareto_front(&candidates);
    let page = page_of("sweep", &of_sweep(&candidates, &front, SamplingMethod::Sobol));
    assert!(page.matches("<circle").count() > 64);
    assert!(page.contains("Designs that no other beats") && page.contains("fatigue"));
}
