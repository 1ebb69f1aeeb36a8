//! The table of requests in `firmware/SECURITY.md`.

use std::fmt::Write;

use firmware::protocol::rules::{Authority, RULES, RequestKind, Rule};

/// `UPDATE_README=1 cargo test -p host-tools --test commands session_rules` rewrites the table.
#[test]
fn security_page_lists_the_rules() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware/SECURITY.md");
    let page = std::fs::read_to_string(path).unwrap();
    let (before, rest) = page.split_once("<!-- rules -->\n").unwrap();
    let (_, after) = rest.split_once("<!-- end of rules -->").unwrap();
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
    let expected = format!("{before}<!-- rules -->\n{table}<!-- end of rules -->{after}");
    if std::env::var_os("UPDATE_README").is_some() {
        std::fs::write(path, &expected).unwrap();
    }
    assert!(
        page == expected || std::env::var_os("UPDATE_README").is_some(),
        "run this test with UPDATE_README=1"
    );
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
