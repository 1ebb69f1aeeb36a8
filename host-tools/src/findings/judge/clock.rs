//! `clock_backwards` and `duplicate_rows`: the readers refuse both.

use model_export::recordings::Place;

use crate::compare::Finding;
use crate::findings::repair::{Change, Fix, Repair};
use crate::findings::scan::TableScan;

use super::Desk;

/// Looks at the order of the rows.
pub fn judge(desk: &mut Desk) {
    for (_, table) in desk.tables() {
        let found = match table.clock.falls {
            0 => copies(table),
            _ => backwards(table),
        };
        desk.findings.extend(found);
    }
}

fn backwards(table: &TableScan) -> Option<Finding> {
    let clock = &table.clock;
    let (line, before, after) = clock.first_fall?;
    let times = match clock.falls {
        1 => "once".to_owned(),
        n => format!("{n} times"),
    };
    let sortable = clock.can_be_sorted();
    let advice = match (sortable, clock.copies) {
        (true, 0) => "sorting them by time mends it: look for a logger that mixes up its buffers",
        (true, _) => {
            "some were written twice: sorting them by time and leaving out the copies mends it; look for a logger that sends a buffer again"
        }
        (false, _) => {
            "that is more than a slip: split the recording here if the clock was set anew, or take out the rows with a wrong time"
        }
    };
    let message = format!(
        "the clock runs backwards {times}, first here from {before} to {after} us, and {} of {} rows are earlier than one before them; {advice}",
        clock.late, clock.rows
    );
    let mut repairs = vec![Change::SortRows];
    if clock.copies > 0 {
        repairs.push(Change::DropCopies);
    }
    Some(Finding {
        id: "clock_backwards",
        place: Place::file(&table.path).line(line).column("t_us"),
        message,
        stops: true,
        fix: sortable.then(|| fix(table, "puts the rows in order of time", repairs)),
    })
}

fn copies(table: &TableScan) -> Option<Finding> {
    let clock = &table.clock;
    let (copies, clashes) = (clock.copies, clock.clashes);
    let rows = |count: u64| match count {
        1 => "1 row has".to_owned(),
        n => format!("{n} rows have"),
    };
    let message = match (copies, clashes) {
        (0, 0) => return None,
        (_, 0) => format!(
            "{} the time of the row before, first here, and the very same cells; leave them out and look for a logger that writes a row twice",
            rows(copies)
        ),
        (0, _) => format!(
            "{} the time of the row before, first here, and other cells; only the bench knows which is right: look for a clock that is too coarse, or for two streams merged",
            rows(clashes)
        ),
        _ => format!(
            "{} the time of the row before, first here: {copies} with the very same cells, {clashes} with others; only the bench knows which of the others are right",
            rows(copies + clashes)
        ),
    };
    Some(Finding {
        id: "duplicate_rows",
        place: Place::file(&table.path)
            .line(clock.first_copy)
            .column("t_us"),
        message,
        stops: true,
        fix: (clashes == 0).then(|| {
            fix(
                table,
                "leaves out the rows that repeat another, cell by cell",
                vec![Change::DropCopies],
            )
        }),
    })
}

fn fix(table: &TableScan, words: &str, changes: Vec<Change>) -> Fix {
    let repair = |change| Repair {
        file: table.path.clone(),
        change,
    };
    Fix {
        words: words.to_owned(),
        repairs: changes.into_iter().map(repair).collect(),
    }
}
