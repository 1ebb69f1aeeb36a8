use std::time::Instant;

use super::*;
use crate::html::fixture::{assert_no_invalid_number, comparison, full, section};
use analysis::compare::{Envelope, Trace};
use analysis::data_quality::evidence::Evidence;
use model_export::output::Overwrite;

#[test]
fn sections_are_in_order() {
    let page = page(&full(3));
    let places: Vec<_> = [
        "<h1>",
        "<dd>recordings/hidden-a",
        "class=\"verdict\"",
        "Evaluation: the model was not fitted",
        "id=\"findings\"",
        "id=\"scale\"",
        "id=\"errors\"",
        "id=\"overlay\"",
        "id=\"histograms\"",
        "id=\"located\"",
        "id=\"map\"",
        "id=\"worst\"",
        "id=\"parameters\"",
        "id=\"origin\"",
    ]
    .iter()
    .map(|part| page.find(part).unwrap_or_else(|| panic!("{part} is missing")))
    .collect();
    assert!(places.is_sorted(), "{places:?}");
}

#[test]
fn sections_of_results_have_plots() {
    let page = page(&full(1));
    for id in ["scale", "errors", "histograms", "located", "map", "parameters"] {
        assert!(section(&page, id).contains("role=\"img\""), "{id}");
    }
    assert!(!page.contains("could not be drawn"));
}

#[test]
fn user_names_are_escaped() {
    let evil = "<b>&\"'</script><!--";
    let mut comparison = full(1);
    comparison.model = evil.to_owned();
    comparison.campaign = evil.to_owned();
    comparison.located[0].words = evil.into();
    if let Evidence::ColumnErrors { columns, .. } = &mut comparison.findings[0].evidence {
        columns[0].0 = evil.to_owned();
    }
    comparison.traces[0].recording = evil.to_owned();
    comparison.worst[0].recording = evil.to_owned();
    comparison.worst[0].sensor = 0;
    if let Some(provenance) = &mut comparison.provenance {
        provenance.fitted_by = evil.to_owned();
    }
    if let Some(map) = &mut comparison.map {
        map.axes[0] = evil.to_owned();
    }
    let page = page(&comparison);
    assert!(!page.contains("<b>"));
    // The comment of the mark is the only one.
    assert_eq!(page.matches("<!--").count(), 1);
    assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
    assert!(page.matches("&lt;b&gt;").count() > 8);
}

#[test]
fn parameters_have_errors_designs_correlations_and_a_remedy() {
    let page = page(&comparison(1, 2, 1.0));
    let shown = section(&page, "parameters");
    for part in [
        // 0.02 and 0.74 over the root of 0.1² + 0.08².
        "<td>1.520\u{b1}0.080?</td><td>1.50</td><td>0.100</td><td>+0.16</td><td>0.800</td>",
        "<td>-0.740\u{b1}0.080!</td><td>0</td><td>0.100</td><td>-5.78</td><td>0.800</td>",
        "offset_x -0.740\u{b1}0.080! mm, 0 by design (-5.8)",
        "the correlations above 0.9: gap with offset_x -0.93 (sensor 0).",
        "To identify them: one more recording with a lateral load to \u{b1}250 N.",
        "gap (1.4, then 0.20)",
        "aria-label=\"Correlations of the 2 parameters of sensor 1.\"",
        "\u{2212}93",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
}

#[test]
fn page_fetches_nothing() {
    let page = page(&full(3));
    for address in ["http", "src=", "@import", "url(http"] {
        assert!(!page.contains(address), "{address}");
    }
    assert!(page.starts_with("<!-- report of magpie -->\n<!DOCTYPE html><html lang=\"en\">"));
}

#[test]
fn page_is_fast_and_small_with_a_hundred_recordings() {
    let comparison = full(3);
    let start = Instant::now();
    page(&comparison);
    let spent = start.elapsed();
    // Tests of other crates may run at the same time.
    assert!(spent.as_secs_f64() < 2.0, "{spent:?}");
    let text = page(&full(100));
    assert!(text.len() < 5_000_000, "{}", text.len());
    assert!(text.contains("100-grasp-and-walk"));
}

#[test]
fn invalid_numbers_are_not_drawn() {
    let mut broken = full(1);
    let hole = f64::NAN;
    broken.axes[0].error.rms = hole;
    broken.axes[1].floor.total = 0.0;
    broken.forces[0].error.span = 0.0;
    broken.located[0].bins[0].centre = f64::INFINITY;
    broken.located[1].bins.clear();
    broken.histograms[0].edges.fill(hole);
    if let Some(map) = &mut broken.map {
        map.rms[2].fill(f64::INFINITY);
    }
    for [measured, modelled] in &mut broken.traces[0].field {
        measured.low.fill(hole);
        measured.high.fill(hole);
        modelled.low[5] = f64::INFINITY;
    }
    // Packed codes may spell anything.
    let text = page(&broken).replace(include_str!("page.js"), "");
    let (before, packed) = text.split_once("<script id=\"traces\"").unwrap();
    let (packed, after) = packed.split_once("</script>").unwrap();
    assert!(!packed.contains("null"));
    assert_no_invalid_number(&format!("{before}{after}"));
}

#[test]
fn empty_comparison_names_what_is_missing() {
    let text = page(&Comparison::default());
    assert!(text.contains("Setup errors: none found."));
    assert!(text.contains("Inconclusive: the noise of these recordings is unknown"));
    assert!(text.contains("No traces."));
    assert!(!text.contains("<svg viewBox"));
}

#[test]
fn fatal_setup_error_replaces_the_results() {
    let stopped = Comparison { findings: full(1).findings, ..Comparison::default() };
    let text = page(&stopped);
    assert!(text.contains("Prevents the comparison. "));
    assert!(text.contains("force.csv, line 1412, column f2_x_n"));
    assert!(text.contains("f2_x_n has the other sign"));
    assert!(text.contains("negates the columns"));
    assert!(text.contains("No results: fix the setup errors first."));
    assert!(!text.contains("<section id=\"errors\""));
}

#[test]
fn explained_share_is_in_the_caption() {
    let text = page(&comparison(1, 4, 4.0));
    assert!(text.contains("<strong>opening</strong>: 48\u{a0}% of the residual"));
    let rest = text.find("<summary>The other 11 covariates</summary>").unwrap();
    assert!(text.find("<strong>roll</strong>").unwrap() > rest);
    assert!(text.contains("<option value=\"3\" selected>s3, largest error"));
}

#[test]
fn second_model_is_compared_with_the_first() {
    let alone = page(&comparison(1, 4, 4.0));
    let two = page(&full(1));
    assert!(!alone.contains("B: "));
    assert!(two.contains("RMS of B: with-neighbour.toml"));
    assert!(two.contains("s0 x <span class=\"model\">B</span>"));
    // The script gets its curve.
    assert!(two.contains("\"role\":2"));
    assert!(!alone.contains("\"role\":2"));
}

#[test]
fn rows_of_both_models_are_next_to_each_other() {
    let page = page(&full(1));
    let errors = section(&page, "errors");
    let places = ["s0 Fx", "s0 Fz", "s1 Fx"].map(|name| {
        ["A", "B"].map(|letter| {
            let head = format!("<th scope=\"row\">{name} <span class=\"model\">{letter}</span>");
            errors.find(&head).unwrap_or_else(|| panic!("{head} is missing"))
        })
    });
    assert!(places.as_flattened().is_sorted(), "{places:?}");
}

#[test]
fn forces_of_the_baseline_alone_have_a_table() {
    let mut two = full(1);
    two.forces.clear();
    let page = page(&two);
    let errors = section(&page, "errors");
    assert!(errors.contains("s0 Fx <span class=\"model\">B</span>"));
    assert!(!errors.contains("s0 Fx <span class=\"model\">A</span>"));
}

#[test]
fn additional_section_follows_the_summary() {
    let section = Section {
        id: "diagnosis",
        heading: "What is <missing>".to_owned(),
        body: html! { p { "An effect." } },
    };
    let text = page_with(&comparison(1, 1, 1.0), &[section]);
    let place = |part: &str| text.find(part).unwrap_or_else(|| panic!("{part}"));
    let at = place(
        "<section id=\"diagnosis\"><h2>What is &lt;missing&gt;</h2><p>An effect.</p></section>",
    );
    assert!(place("id=\"scale\"") < at && at < place("id=\"errors\""));
    assert!(text.contains("<a href=\"#diagnosis\">What is &lt;missing&gt;</a>"));
}

#[test]
fn only_reports_of_the_same_inputs_are_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let small = Comparison::default();
    let report = |inputs: &[&str]| {
        let inputs = inputs.iter().map(|input| (*input).to_owned()).collect();
        write(&Output::check(&path, MARK, inputs, Overwrite::NEVER)?, &small, &[])
    };
    report(&["a"]).unwrap();
    report(&["a", "b"]).unwrap();
    assert!(report(&["a"]).unwrap_err().to_string().contains("not overwritten"));
    std::fs::write(&path, "<!DOCTYPE html><p>mine</p>").unwrap();
    assert!(report(&["a", "b"]).is_err());
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "<!DOCTYPE html><p>mine</p>");
}

#[test]
fn traces_of_one_and_no_rows_are_drawn() {
    let one = Envelope::of(&[1.0], &[2.0], 10);
    let row = [one.clone(), one];
    let mut comparison = comparison(1, 1, 1.0);
    comparison.traces = vec![
        Trace { field: vec![row; 3], ..comparison.traces[0].clone() },
        Trace {
            field: vec![Default::default(); 3],
            force: Vec::new(),
            ..comparison.traces[0].clone()
        },
    ];
    let text = page(&comparison);
    assert!(text.contains("field y, in G"));
    assert!(!text.contains("could not be drawn"));
}
