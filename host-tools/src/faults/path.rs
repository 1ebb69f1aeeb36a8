//! Which state may be seen a millisecond after which: a step of a table, or two in one tick.

use firmware::grip::states::{Power, TASK_CODE, Task};
use firmware::grip::table::{POWER, TASK};

/// States that may follow each other within a tick beside the first.
const STEPS: u32 = 2;

fn power_of(code: u8) -> Option<Power> {
    Power::ALL
        .iter()
        .copied()
        .find(|power| *power as u8 == code)
}

fn task_of(code: u8) -> Option<Task> {
    let task = code.checked_sub(TASK_CODE)?;
    Task::ALL.iter().copied().find(|state| *state as u8 == task)
}

/// The states to which the tables lead in one step, as the heartbeat's numbers.
fn next(code: u8) -> Vec<u8> {
    let (power, task) = match task_of(code) {
        Some(task) => (Power::Enabled, Some(task)),
        None => match power_of(code) {
            Some(power) => (power, None),
            None => return Vec::new(),
        },
    };
    let powers = POWER.iter().filter(|(from, ..)| *from == power);
    let mut codes: Vec<u8> = powers
        .flat_map(|(.., to)| match to {
            // What it begins with hangs on the opening and on what is gripped.
            Power::Enabled => vec![
                TASK_CODE + Task::Unhomed as u8,
                TASK_CODE + Task::GripFailed as u8,
                TASK_CODE + Task::Idle as u8,
            ],
            to => vec![*to as u8],
        })
        .collect();
    let tasks = TASK.iter().filter(|(from, ..)| Some(*from) == task);
    codes.extend(tasks.map(|(.., to)| TASK_CODE + *to as u8));
    codes
}

/// Whether one state may be seen a tick after another, both as the heartbeat's numbers.
pub fn may_follow(from: u8, to: u8) -> bool {
    let mut reached = vec![from];
    for _ in 0..STEPS {
        if reached.contains(&to) {
            return true;
        }
        reached = reached.iter().flat_map(|code| next(*code)).collect();
    }
    reached.contains(&to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::grip::states::code;

    #[test]
    fn what_no_table_lists_may_not_follow() {
        let task = |task| code(Power::Enabled, task);
        assert!(may_follow(task(Task::Approach), task(Task::Force)));
        assert!(may_follow(task(Task::Idle), task(Task::Idle)));
        assert!(may_follow(task(Task::Approach), Power::QuickStop as u8));
        assert!(may_follow(Power::Armed as u8, task(Task::Idle)));
        assert!(!may_follow(Power::Fault as u8, task(Task::Idle)));
        assert!(!may_follow(Power::Safe as u8, task(Task::Idle)));
        assert!(!may_follow(task(Task::Foot), task(Task::Force)));
        assert!(!may_follow(task(Task::Idle), task(Task::HoldActive)));
    }
}
