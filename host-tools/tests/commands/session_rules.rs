//! The table of requests in `firmware/SECURITY.md`.

use std::fmt::Write;

use firmware::protocol::rules::{Authority, RULES, RequestKind, Rule};

use crate::generated_text::assert_generated;

#[test]
fn security_page_lists_the_rules() {
    let mut table =
        "| request | by | armed | calibrating | loaded | doubtful key |\n| --- | --- | --- | --- | --- | --- |\n"
            .to_owned();
    for rule in RULES {
        let Rule { while_armed, while_calibrating, while_loaded, while_doubtful, .. } = rule;
        let may = [while_armed, while_calibrating, while_loaded, while_doubtful]
            .map(|may| if may { "yes" } else { "no" })
            .join(" | ");
        let (name, by) = (name(rule.kind), by(rule.authority));
        writeln!(table, "| {name} | {by} | {may} |").unwrap();
    }
    assert_generated("firmware/SECURITY.md", ["<!-- rules -->\n", "<!-- end of rules -->"], &table);
}

/// Each property of the page has a test: a function, a trial of the emulated chip, or a scenario.
#[test]
fn security_page_names_existing_tests() {
    let root = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut sources = String::new();
    for folder in [
        "firmware/src/protocol",
        "firmware/src/system",
        "firmware/src/tasks",
        "host-tools/device/src/recorder",
        "host-tools/tests",
    ] {
        append_sources(&root.join(folder), &mut sources);
    }
    let page = std::fs::read_to_string(root.join("firmware/SECURITY.md")).unwrap();
    let is_heading = |line: &&str| line.ends_with(" | test |");
    let rows =
        page.split("\n\n").filter(|part| part.lines().next().as_ref().is_some_and(is_heading));
    let mut count = 0;
    for row in rows.flat_map(|table| table.lines().skip(2)) {
        let tests = row.trim_end_matches('|').rsplit('|').next().unwrap();
        let names = tests.split('`').skip(1).step_by(2).filter(|name| !name.ends_with(".rs"));
        let found = names.clone().map(|name| name.rsplit("::").next().unwrap()).map(|name| {
            let is_scenario = root.join(format!("tests/scenarios/{name}.toml")).exists();
            let is_test = sources.contains(&format!("fn {name}("));
            assert!(
                is_scenario || is_test || sources.contains(&format!("(\"{name}\", ")),
                "{name}"
            );
        });
        assert!(found.count() > 0, "{row}");
        count += 1;
    }
    assert!(count > 25, "{count}");
}

fn append_sources(folder: &std::path::Path, sources: &mut String) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            append_sources(&path, sources);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            sources.push_str(&std::fs::read_to_string(path).unwrap());
        }
    }
}

const fn by(authority: Authority) -> &'static str {
    match authority {
        Authority::Anyone => "anybody",
        Authority::KeyHolder => "who answers a challenge",
        Authority::Owner => "owner of the session",
        Authority::OwnerOrPresence => "owner or pressed button, serial line",
    }
}

const fn name(kind: RequestKind) -> &'static str {
    match kind {
        RequestKind::Stop => "stop",
        RequestKind::Read => "version, description, read a parameter",
        RequestKind::ReportMotion => "pose and acceleration of the gripper",
        RequestKind::UploadPart => "part of an upload (its end has a code over all)",
        RequestKind::OpenSession => "open a session without motion (13)",
        RequestKind::Arm => "open a session with motion (5)",
        RequestKind::EndSession => "end the session (12)",
        RequestKind::RenewSession => "keep the session open (16)",
        RequestKind::Command => "command",
        RequestKind::ClearFaults => "clear faults (1)",
        RequestKind::Tare => "tare (2)",
        RequestKind::Measure => "measure motor or screw (8)",
        RequestKind::Save => "save the parameters (3)",
        RequestKind::Reboot => "reboot (4)",
        RequestKind::Upload => "begin or finish an upload (9, 10)",
        RequestKind::WriteParameter => "write a parameter without effect on motion",
        RequestKind::WriteMotionParameter => "write a parameter that affects motion",
        RequestKind::WriteKey => "write or erase the key (14, 15)",
    }
}
