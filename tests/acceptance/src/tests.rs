//! Tests of the command line, the results file and the intervals.

use std::fs;

use clap::{CommandFactory, Parser};

use crate::results::{self, replace_section};
use crate::{Cli, DefaultSeeds, command_line, intervals};

#[test]
fn command_line_definition_is_consistent() {
    Cli::command().debug_assert();
}

#[test]
fn seeds_follow_the_options_and_the_defaults() {
    let defaults = DefaultSeeds { first: 1001, full: 1000, quick: 20 };
    let cases = [
        ("acceptance grasp", 1001..2001),
        ("acceptance grasp --quick", 1001..1021),
        ("acceptance grasp --seeds 3", 1001..1004),
        ("acceptance grasp --quick --seeds 3 --first 7", 7..10),
    ];
    for (line, seeds) in cases {
        let cli = Cli::try_parse_from(line.split(' ')).unwrap();
        assert_eq!(cli.options.seeds(defaults), seeds, "{line}");
    }
    for line in ["acceptance grasp --seeds 0", "acceptance", "acceptance flight"] {
        assert!(Cli::try_parse_from(line.split(' ')).is_err(), "{line}");
    }
}

#[test]
fn recorded_command_has_no_path() {
    for (arguments, command) in [
        ("drive --quick", "cargo acceptance drive --quick"),
        ("drive --results /home/a/r.md --seeds 2", "cargo acceptance drive --seeds 2"),
        ("drive --results=/home/a/r.md", "cargo acceptance drive"),
    ] {
        assert_eq!(command_line(arguments.split(' ').map(str::to_owned)), command);
    }
}

#[test]
fn section_is_replaced_or_appended_and_others_stay() {
    let text = "# Acceptance results\n\nwords\n\n<!-- begin a -->\nold\n<!-- end a -->\n\nmore\n";
    let cases = [
        ("a", text.replace("old", "new")),
        ("b", format!("{text}\n<!-- begin b -->\nnew\n<!-- end b -->\n")),
    ];
    for (marker, expected) in cases {
        assert_eq!(replace_section(text, marker, "new\n\n").unwrap(), expected);
        assert_eq!(replace_section(&expected, marker, "new").unwrap(), expected);
    }
    let created = "# Acceptance results\n\n<!-- begin a -->\nnew\n<!-- end a -->\n";
    assert_eq!(replace_section("", "a", "new").unwrap(), created);
    for broken in ["<!-- begin a -->\n", "<!-- end a -->\n"] {
        assert!(replace_section(broken, "a", "new").is_err(), "{broken}");
    }
}

#[test]
fn results_file_of_another_origin_is_preserved() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("results.md");
    results::write(&path, "a", "new").unwrap();
    results::check(&path).unwrap();
    fs::write(&path, "# Shopping\n").unwrap();
    assert!(results::check(&path).is_err());
    assert!(results::write(&path, "a", "new").is_err());
    assert_eq!(fs::read_to_string(&path).unwrap(), "# Shopping\n");
}

#[test]
fn intervals_match_published_values() {
    let near = |found: [f64; 2], expected: [f64; 2]| {
        let is_near = |(a, b): (&f64, &f64)| (a - b).abs() < 5e-4 || a == b;
        assert!(found.iter().zip(&expected).all(is_near), "{found:?} {expected:?}");
    };
    // R: binom.test(2, 4), binom.test(0, 66), binom.test(26, 27).
    near(intervals::proportion(2, 4), [0.0676, 0.9324]);
    near(intervals::proportion(0, 66), [0.0, 0.0544]);
    near(intervals::proportion(26, 27), [0.8103, 0.9991]);
    // R: poisson.test(0), poisson.test(3).
    near(intervals::poisson(0), [0.0, 3.6889]);
    near(intervals::poisson(3), [0.6187, 8.7673]);
    // Ranks of the median of ten values: 2 and 9; of 1000 values, 983 and 997 for p99.
    let values: Vec<f64> = (1..=1000).map(f64::from).collect();
    near(intervals::quantile(&values[..10], 0.5), [2.0, 9.0]);
    near(intervals::quantile(&values, 0.99), [983.0, 997.0]);
    near(intervals::quantile(&values[..20], 0.99), [19.0, f64::INFINITY]);
}
