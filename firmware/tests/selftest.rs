//! Kernels on the core of the chip: runs the self-test image in QEMU and compares it with the portable kernels on the host.
//!
//! Skipped with a message if QEMU or the image is missing; `SELFTEST=required` makes that a failure.

#[allow(dead_code)] // Parts are used only on the chip.
#[path = "../examples/selftest/vectors.rs"]
mod vectors;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::SystemTime;

use firmware::model::formats::{CentrePair, EXP_ENTRIES, GruState, Weights};
use firmware::model::kernel::{grbf, gru};

/// Maximum instructions of one call.
const BUDGETS: [(&str, u32); 18] = [
    ("gru_3_8", 980),
    ("gru_3_16", 2680),
    ("gru_12_32", 8950),
    ("gru_12_32_16", 9250),
    ("grbf_25", 320),
    ("grbf_50", 585),
    ("grbf_100", 1110),
    // 40 us, once for each command, and 0.25 ms for each session.
    ("message_code", 3950),
    ("session_keys", 25_000),
    // The motor control has branches: the maximum observed, at 1.6 cycles each by the timings of ARM.
    ("motor_inner", 640),
    ("motor_outer", 820),
    ("motor_millisecond", 14_900),
    ("grip_tick", 2420),
    ("grip_mean", 2050),
    ("grip_idle", 1050),
    // All tasks of a millisecond with networks of two layers of 16 units for four sensors: mean, maximum, and mean during a
    // flood of 21,000 frames a second.
    ("loops_mean", 30_000),
    ("loops_tick", 35_000),
    ("loops_flood", 32_000),
];

/// Count, condition, and maximum load of the core in percent including motor and grip.
const LOADS: [(&str, &str, f64); 2] =
    [("loops_mean", "on average", 46.0), ("loops_flood", "in a flood of frames", 49.0)];

/// Cycles per instruction by the published timings of ARM: 1.60 for the tasks, 1.63 for motor and grip.
const CYCLES: f64 = 1.61;
/// Cycles per millisecond.
const CYCLES_MS: f64 = 160e3;

/// Digest of all results; changes only with the definition of the kernels.
const DIGEST: u64 = 0xcfbf_4016_8ac7_b15a;

/// The portable kernels alone.
struct Portable;

impl vectors::Machine for Portable {
    fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
        &mut self,
        weights: &Weights<INPUTS, HIDDEN, SENSORS>,
        state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
    ) {
        gru::portable::step(weights, state);
    }

    fn sum(&mut self, exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
        grbf::portable(exp, pairs, at)
    }
}

fn main() -> ExitCode {
    let other = |word: &String| !word.starts_with('-') && !"selftest".contains(word.as_str());
    if std::env::args().skip(1).any(|word| word == "--list" || other(&word)) {
        return ExitCode::SUCCESS;
    }
    match selftest() {
        Ok(report) => {
            println!("selftest: {report}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            println!("selftest FAILED: {error}");
            ExitCode::FAILURE
        }
    }
}

fn selftest() -> Result<String, String> {
    let digest = vectors::run(&mut Portable);
    if digest != DIGEST {
        return Err(format!("the kernels have changed: digest {digest:016x}, was {DIGEST:016x}"));
    }
    match printed() {
        Ok(printed) => check(&printed?),
        Err(missing) if std::env::var_os("SELFTEST").is_some_and(|word| word == "required") => {
            Err(missing)
        }
        Err(missing) => Ok(format!(
            "SKIPPED, kernels not run: {missing}. `.ci/selftest` builds the image and runs it (Debian: \
             apt-get install qemu-system-arm)"
        )),
    }
}

/// Output of the image in QEMU. The outer error is a missing prerequisite, the inner one a failure.
fn printed() -> Result<Result<String, String>, String> {
    let image = image()?;
    // One instruction takes 64 ns of the emulated clock, by which the image counts them.
    let arguments = "-M netduinoplus2 -nographic -monitor none -serial none -icount shift=6 \
                     -semihosting-config enable=on,target=native -kernel";
    let run = Command::new("qemu-system-arm")
        .args(arguments.split_whitespace())
        .arg(&image)
        .stdin(std::process::Stdio::null())
        .output()
        .map_err(|error| format!("qemu-system-arm does not start ({error})"))?;
    let out = String::from_utf8_lossy(&run.stdout).into_owned();
    let errors = String::from_utf8_lossy(&run.stderr);
    Ok(if run.status.success() { Ok(out) } else { Err(format!("{}\n{out}{errors}", run.status)) })
}

/// The newest image, if it is not older than its sources.
fn image() -> Result<PathBuf, String> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("");
    let candidates = ["", "debian"]
        .map(|folder| target.join(folder).join("thumbv7em-none-eabihf/image/examples/selftest"));
    let built = candidates.into_iter().filter_map(|path| Some((modified(&path)?, path)));
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

fn check(printed: &str) -> Result<String, String> {
    let line = printed.lines().next().unwrap_or("");
    if !line.ends_with(&format!(" 0 bits differ, digest {DIGEST:016x}")) {
        return Err(format!("kernels and portable definition differ: {line}"));
    }
    let mut report = line.to_owned();
    for (name, budget) in BUDGETS {
        let count = count(printed, name)?;
        if count > budget {
            return Err(format!("{name} takes {count} instructions, its budget is {budget}"));
        }
        // Far fewer indicate another kernel or a wrong count.
        if count < budget - budget / 7 {
            return Err(format!("{name} takes {count} instructions: lower its budget of {budget}"));
        }
        report += &format!("\n{name} {count} instructions, at most {budget}");
    }
    Ok(report + &load(printed)?)
}

fn count(printed: &str, name: &str) -> Result<u32, String> {
    let counts = |line: &str| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok();
    let count = printed.lines().find_map(counts);
    count.ok_or_else(|| format!("no count of {name} in:\n{printed}"))
}

/// Load of the core by instructions.
fn load(printed: &str) -> Result<String, String> {
    let count = |name| count(printed, name);
    // The grip task is counted idle in the tasks, and active here.
    let grip = count("grip_mean")?.saturating_sub(count("grip_idle")?);
    let both = count("motor_millisecond")?.saturating_add(grip);
    let mut report = String::new();
    for (tasks, condition, limit) in LOADS {
        let instructions = both.saturating_add(count(tasks)?);
        let share = 100.0 * CYCLES * f64::from(instructions) / CYCLES_MS;
        if share > limit {
            return Err(format!("{share:.1} % of the core {condition}, limit {limit} %"));
        }
        report += &format!("\n{share:.1} % of the core {condition}, limit {limit} %");
    }
    Ok(report
        + &format!(
            ": motor, grip and all tasks at {CYCLES} cycles per instruction, without drivers, interrupts and flash \
             wait states"
        ))
}
