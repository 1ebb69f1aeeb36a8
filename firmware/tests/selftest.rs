//! The kernels on the chip's core: the self-test's image in QEMU, beside the same vectors here.
//!
//! Where QEMU or the image is absent, one line says so, and how to get them; `SELFTEST=required` makes
//! that a failure.

#[allow(dead_code)] // Some of it only the chip needs.
#[path = "../examples/selftest/vectors.rs"]
mod vectors;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::SystemTime;

use firmware::model::network::{State, Weights};
use firmware::model::table::{CentrePair, EXP_ENTRIES};
use firmware::model::{grbf, gru};

/// Most instructions of one call.
const BUDGETS: [(&str, u32); 16] = [
    ("gru_3_8", 850),
    ("gru_3_16", 2440),
    ("gru_12_32", 8500),
    ("gru_12_32_16", 8850),
    ("grbf_25", 320),
    ("grbf_50", 585),
    ("grbf_100", 1110),
    // The motor's control is compiled and branches: the most that was met, 1.6 cycles each by ARM's timings.
    ("motor_inner", 720),
    ("motor_outer", 880),
    ("motor_millisecond", 17_200),
    ("grip_tick", 2800),
    ("grip_mean", 2350),
    ("grip_idle", 1460),
    // Loops of a millisecond with networks of two layers of 16 units for four sensors: on the average, at the most,
    // and in a flood of 21,000 frames a second.
    ("loops_mean", 32_500),
    ("loops_tick", 37_000),
    ("loops_flood", 35_500),
];

/// Which loops, when, and the greatest share of the core in percent that they, the motor and a grasp may take.
const LOADS: [(&str, &str, f64); 2] = [
    ("loops_mean", "on the average", 57.0),
    ("loops_flood", "in a flood of frames", 70.0),
];

/// Cycles of an instruction: what ARM's published timings give, 1.60 for the loops, 1.63 for motor and grasp. The core
/// has so many in a millisecond.
const CYCLES: f64 = 1.61;
const CYCLES_MS: f64 = 160e3;

/// Of every bit of every step: changes only with the definition.
const DIGEST: u64 = 0xcfbf_4016_8ac7_b15a;

/// The definition alone.
struct Portable;

impl vectors::Machine for Portable {
    fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
        &mut self,
        weights: &Weights<INPUTS, HIDDEN, SENSORS>,
        state: &mut State<INPUTS, HIDDEN, SENSORS>,
    ) {
        gru::portable::step(weights, state);
    }

    fn sum(&mut self, exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
        grbf::portable(exp, pairs, at)
    }
}

fn main() -> ExitCode {
    let other = |word: &String| !word.starts_with('-') && !"selftest".contains(word.as_str());
    if std::env::args()
        .skip(1)
        .any(|word| word == "--list" || other(&word))
    {
        return ExitCode::SUCCESS;
    }
    match selftest() {
        Ok(told) => {
            println!("selftest: {told}");
            ExitCode::SUCCESS
        }
        Err(wrong) => {
            println!("selftest FAILED: {wrong}");
            ExitCode::FAILURE
        }
    }
}

fn selftest() -> Result<String, String> {
    let digest = vectors::run(&mut Portable);
    if digest != DIGEST {
        return Err(format!(
            "the definition changed: digest {digest:016x}, was {DIGEST:016x}"
        ));
    }
    match printed() {
        Ok(printed) => judge(&printed?),
        Err(absent) if std::env::var_os("SELFTEST").is_some_and(|word| word == "required") => {
            Err(absent)
        }
        Err(absent) => Ok(format!(
            "SKIPPED, kernels not run: {absent}. `.ci/selftest` builds the image and runs it (Debian: \
             apt-get install qemu-system-arm)"
        )),
    }
}

/// What the image prints in QEMU. An error outside is what is absent, inside what failed.
fn printed() -> Result<Result<String, String>, String> {
    let image = image()?;
    // One instruction is 64 ns of the emulated clock, by which the image counts them.
    let arguments = "-M netduinoplus2 -nographic -monitor none -serial none -icount shift=6 \
                     -semihosting-config enable=on,target=native -kernel";
    let run = Command::new("qemu-system-arm")
        .args(arguments.split_whitespace())
        .arg(&image)
        .stdin(std::process::Stdio::null())
        .output()
        .map_err(|error| format!("qemu-system-arm does not start ({error})"))?;
    let out = String::from_utf8_lossy(&run.stdout).into_owned();
    let wrong = String::from_utf8_lossy(&run.stderr);
    Ok(match run.status.success() {
        true => Ok(out),
        false => Err(format!("{}\n{out}{wrong}", run.status)),
    })
}

/// The newest image, if it is not older than what it is made of.
fn image() -> Result<PathBuf, String> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("");
    let places = ["", "debian"].map(|folder| {
        target
            .join(folder)
            .join("thumbv7em-none-eabihf/image/examples/selftest")
    });
    let built = places
        .into_iter()
        .filter_map(|place| Some((modified(&place)?, place)));
    let (built, image) = built.max().ok_or("there is no image of the self-test")?;
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let newest = ["src", "examples/selftest"].map(|folder| newest(&package.join(folder)));
    match newest.into_iter().flatten().max() {
        Some(changed) if changed > built => Err("the image is older than its sources".to_owned()),
        _ => Ok(image),
    }
}

fn modified(path: &Path) -> Option<SystemTime> {
    path.metadata().ok()?.modified().ok()
}

fn newest(folder: &Path) -> Option<SystemTime> {
    let entries = std::fs::read_dir(folder).ok()?.flatten();
    let times = entries.filter_map(|entry| match entry.path() {
        path if path.is_dir() => newest(&path),
        path => modified(&path),
    });
    times.max()
}

fn judge(printed: &str) -> Result<String, String> {
    let line = printed.lines().next().unwrap_or("");
    if !line.ends_with(&format!(" 0 bits differ, digest {DIGEST:016x}")) {
        return Err(format!("kernels and definition differ: {line}"));
    }
    let mut told = line.to_owned();
    for (name, budget) in BUDGETS {
        let count = count(printed, name)?;
        if count > budget {
            return Err(format!(
                "{name} takes {count} instructions, its budget is {budget}"
            ));
        }
        // Far less would be another kernel, or a count that is wrong.
        if count < budget - budget / 7 {
            return Err(format!(
                "{name} takes {count} instructions: lower its budget of {budget}"
            ));
        }
        told += &format!("\n{name} {count} instructions, at most {budget}");
    }
    Ok(told + &load(printed)?)
}

fn count(printed: &str, name: &str) -> Result<u32, String> {
    let counts = |line: &str| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok();
    let count = printed.lines().find_map(counts);
    count.ok_or_else(|| format!("no count of {name} in:\n{printed}"))
}

/// Shares of the core, as far as instructions tell.
fn load(printed: &str) -> Result<String, String> {
    let count = |name| count(printed, name);
    // The loops' own grasp does nothing.
    let grip = count("grip_mean")?.saturating_sub(count("grip_idle")?);
    let both = count("motor_millisecond")?.saturating_add(grip);
    let mut told = String::new();
    for (loops, when, most) in LOADS {
        let instructions = both.saturating_add(count(loops)?);
        let share = 100.0 * CYCLES * f64::from(instructions) / CYCLES_MS;
        if share > most {
            return Err(format!(
                "{share:.1} % of the core {when}, at most {most} % are there for it"
            ));
        }
        told += &format!("\n{share:.1} % of the core {when}, at most {most} %");
    }
    Ok(told
        + &format!(
            ": motor, a grasp and all loops at {CYCLES} cycles to an instruction; drivers, interrupts and the flash's \
             waits not in it"
        ))
}
