//! Single instructions, and short sequences, by the table `tests/instructions.txt`.

use crate::core::tests::{C, DATA, Machine, N, PROGRAM, Q, SRAM, STACK, V, Z};

/// Everything that an instruction may change.
#[derive(Debug, PartialEq)]
struct MachineState {
    /// r0 to r14 and the PC.
    r: Vec<u32>,
    s: Vec<u32>,
    flags: u32,
    sram: Vec<u8>,
}

impl MachineState {
    fn of(machine: &Machine) -> Self {
        let state = &machine.core.state;
        let r = (0..16).map(|number| machine.r(number)).collect();
        Self { r, s: state.s.to_vec(), flags: machine.flags(), sram: machine.bus.sram.clone() }
    }

    /// Sets what a column names.
    fn set(&mut self, column: &str) {
        for field in column.split_whitespace() {
            let (name, text) = field.split_once('=').expect("name=value");
            let index = || name[1..].parse::<usize>().expect("a register's number");
            match name.as_bytes()[0] {
                b'f' => self.flags = flags(text),
                b'p' => self.r[15] = value(text),
                b'r' => self.r[index()] = value(text),
                b's' => self.s[index()] = value(text),
                _ => {
                    let start = (value(name.trim_matches(['[', ']'])) - SRAM) as usize;
                    self.sram[start..start + 4].copy_from_slice(&value(text).to_le_bytes());
                }
            }
        }
    }
}

fn flags(text: &str) -> u32 {
    let bit = |letter| match letter {
        'N' => N,
        'Z' => Z,
        'C' => C,
        'V' => V,
        'Q' => Q,
        _ => 0,
    };
    text.chars().map(bit).sum()
}

fn value(text: &str) -> u32 {
    let (base, text) = match text.split_at(1) {
        ("@", rest) => (DATA, rest),
        ("^", rest) => (STACK, rest),
        (">", rest) => (PROGRAM, rest),
        _ => (0, text),
    };
    let parsed = i64::from_str_radix(text, 16).expect("a hexadecimal number");
    base.wrapping_add(parsed as u32)
}

/// Runs a row; what is not as it says.
fn run(row: &str) -> Option<String> {
    let [mnemonics, halfwords, before, after] =
        row.split('|').map(str::trim).collect::<Vec<_>>()[..]
    else {
        panic!("four columns: {row}")
    };
    let halfwords: Vec<u16> = halfwords.split(' ').map(|halfword| value(halfword) as u16).collect();
    let mut machine = Machine::with_float(&halfwords);
    let mut expected = MachineState::of(&machine);
    expected.set(before);
    machine.core.state.r[..15].copy_from_slice(&expected.r[..15]);
    machine.core.state.s.copy_from_slice(&expected.s);
    machine.core.state.apsr = expected.flags;
    machine.bus.sram.clone_from(&expected.sram);
    expected.r[15] = PROGRAM + 2 * halfwords.len() as u32;
    expected.set(after);
    machine.step(mnemonics.split("; ").count());
    let found = MachineState::of(&machine);
    if found == expected {
        return None;
    }
    let memory = if found.sram == expected.sram { "as it says" } else { "different" };
    Some(format!("{row}\n  {:x?} {:#x}, memory {memory}", found.r, found.flags))
}

#[test]
fn instructions_change_what_the_manual_states() {
    let is_row = |line: &&str| !line.is_empty() && !line.starts_with('#');
    let text = include_str!("../../../tests/instructions.txt");
    // Sections are divided by empty lines; the first is the description.
    for section in text.split("\n\n").skip(1) {
        assert!(section.lines().any(|line| is_row(&line)), "no rows: {section}");
    }
    let wrong: Vec<_> = text.lines().filter(is_row).filter_map(run).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
