//! Parts of documents that are generated from the program.

use std::fmt::Write as _;
use std::path::Path;

use firmware::board::selected::table::{FUNCTIONS, RANGES, REQUIREMENTS, VALUES};

/// Compares what is between two marks of a document of this repository with what it must be; with UPDATE_README, writes it.
pub fn assert_generated(document: &str, [begin, end]: [&str; 2], text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document);
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = page.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    let expected = format!("{before}{begin}{text}{end}{after}");
    if std::env::var_os("UPDATE_README").is_some() {
        std::fs::write(&path, &expected).unwrap();
        return;
    }
    assert!(
        page == expected,
        "{document}: run `UPDATE_README=1 cargo test -p host-tools --test commands`"
    );
}

#[test]
fn bring_up_page_lists_the_steps() {
    let table = device::bringup::document();
    assert_generated("firmware/BRING-UP.md", ["<!-- steps -->\n", "<!-- end of steps -->"], &table);
}

#[test]
fn board_page_lists_pins_values_and_requirements() {
    let rule = |columns| format!("{}|\n", "| --- ".repeat(columns));
    let mut text = format!("| function | pins | level | basis | source |\n{}", rule(5));
    for row in FUNCTIONS {
        let pins: Vec<_> = row.pins.iter().map(|(signal, pin)| format!("{signal} {pin}")).collect();
        let (pins, level) = (pins.join(", "), row.level);
        let (basis, source) = (row.basis.name(), row.source);
        let _ = writeln!(
            text,
            "| {} | {}: {} | {level} | {basis} | {source} |",
            row.name,
            row.peripheral,
            pins.trim()
        );
    }
    let _ = write!(text, "\n| value | | basis | source |\n{}", rule(4));
    for row in VALUES {
        let basis = row.basis.name();
        let _ = writeln!(
            text,
            "| {} | {} {} | {basis} | {} |",
            row.name, row.value, row.unit, row.source
        );
    }
    let _ = write!(text, "\n| range at the bring-up | | basis | source |\n{}", rule(4));
    for row in RANGES {
        let ([min, max], basis) = (row.limits, row.basis.name());
        let unit = row.unit;
        let _ =
            writeln!(text, "| {} | {min} to {max} {unit} | {basis} | {} |", row.name, row.source);
    }
    let _ = write!(text, "\n| place | the board must provide | basis | source |\n{}", rule(4));
    for row in REQUIREMENTS {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} |",
            row.place,
            row.text,
            row.basis.name(),
            row.source
        );
    }
    assert_generated("firmware/BOARD.md", ["<!-- board -->\n", "<!-- end of board -->"], &text);
}
