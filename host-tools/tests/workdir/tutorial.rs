//! Tutorials as tests: files of their `toml` blocks, commands of their `console` blocks, and the lines that these print.

#![allow(dead_code)] // No test program needs all of it.

use std::path::{Path, PathBuf};

use crate::workdir::WorkDir;

/// One step of a tutorial.
pub enum Step<'a> {
    /// A block `toml NAME`: a file.
    File { name: &'a str, content: String },
    /// A command of a block `console`, or, if it goes on while the next ones run, of a block `console background`.
    Command {
        command: String,
        /// Arguments of `cargo magpie`; `None` for another program.
        arguments: Option<Vec<String>>,
        /// Lines below the command, without `...`: parts of what it prints.
        expected: Vec<&'a str>,
        is_background: bool,
    },
}

/// Folder of the tutorials.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tutorials")
}

/// Makes the project's data available: tutorials are read in its folder.
pub fn link_data(dir: &WorkDir) {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    std::os::unix::fs::symlink(project.join("tests"), dir.path("tests")).unwrap();
}

/// Words of a text: tables differ in their spaces.
pub fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Steps of a tutorial in order.
pub fn steps(tutorial: &str) -> Vec<Step<'_>> {
    let mut steps = Vec::new();
    for (info, lines) in blocks(tutorial) {
        if let Some(name) = info.strip_prefix("toml ") {
            steps.push(Step::File { name, content: lines.join("\n") });
        }
        if info == "console" || info == "console background" {
            add_commands(&mut steps, &lines, info != "console");
        }
    }
    steps
}

/// Blocks of code: what follows the opening fence, and the lines.
fn blocks(tutorial: &str) -> Vec<(&str, Vec<&str>)> {
    let mut blocks: Vec<(&str, Vec<&str>)> = Vec::new();
    let mut is_open = false;
    for line in tutorial.lines() {
        match line.strip_prefix("```") {
            Some(info) => {
                if !is_open {
                    blocks.push((info, Vec::new()));
                }
                is_open = !is_open;
            }
            None if is_open => blocks.last_mut().unwrap().1.push(line),
            None => {}
        }
    }
    blocks
}

fn add_commands<'a>(steps: &mut Vec<Step<'a>>, lines: &[&'a str], is_background: bool) {
    let mut is_continued = false;
    for line in lines {
        if let Some(typed) = line.strip_prefix("$ ") {
            steps.push(Step::Command {
                command: typed.to_owned(),
                arguments: None,
                expected: Vec::new(),
                is_background,
            });
        } else if let Some(Step::Command { command, expected, .. }) = steps.last_mut() {
            match is_continued {
                true => *command = format!("{} {}", command.trim_end_matches('\\'), line.trim()),
                false if *line != "..." => expected.push(line),
                false => {}
            }
        }
        is_continued = line.ends_with('\\');
    }
    for step in steps {
        if let Step::Command { command, arguments, .. } = step {
            let typed = command.split(" # ").next().unwrap_or_default();
            let typed = typed.strip_prefix("cargo magpie ");
            *arguments = typed.map(|typed| shell_words::split(typed).unwrap());
        }
    }
}
