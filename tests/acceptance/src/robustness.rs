//! Commands of `magpie` with mutated files, killed while they write, and where files must not grow.

use std::fs;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use analysis::progress;
use anyhow::{Context, Result, bail, ensure};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::Value;

#[path = "../../fuzz/src/bag_files.rs"]
mod bag_files;
#[allow(dead_code)]
#[path = "../../fuzz/src/bytes.rs"]
mod bytes;

use crate::magpie::SUBCOMMAND;
use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options};
use bytes::Bytes;

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
/// Full and quick: mutated inputs, kills, and limits of a file's size.
const INPUTS: [u64; 2] = [10_000, 200];
const KILLS: [u64; 2] = [400, 40];
const LIMITS: [u64; 2] = [200, 20];
/// Address space of a command in KiB, and its time.
const MEMORY_KIB: u64 = 2 * 1024 * 1024;
const PATIENCE: Duration = Duration::from_secs(60);
/// Bytes that a repeated line of a mutated file has at most.
const MAX_REPEATED: usize = 8 << 20;
/// Largest absolute value of a plausible result.
const PLAUSIBLE: f64 = 1e30;

/// Give mutated files to the commands that read files, kill the commands that write some, and limit the size of their files.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance robustness --inputs 100 --seeds 3")]
pub struct Args {
    /// Mutated inputs per seed [default: 10000; quick: 200].
    #[arg(long, value_name = "N")]
    inputs: Option<u64>,
    /// Only this kind of runs, such as "mutated db3 files".
    #[arg(long, value_name = "KIND")]
    only: Option<String>,
}

/// Runs all seeds.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let extent = usize::from(options.quick);
    let inputs = args.inputs.unwrap_or(INPUTS[extent]);
    let valid = tempfile::tempdir()?;
    prepare(valid.path())?;
    let mut rows = Vec::new();
    let mut is_met = true;
    for seed in seeds.clone() {
        for (kind, count, run) in [
            ("mutated inputs", inputs, mutate as Case),
            ("mutated MCAP files", inputs, mutate_mcap),
            ("mutated db3 files", inputs, mutate_database),
            ("killed while writing", KILLS[extent], kill as Case),
            ("limited file size", LIMITS[extent], limit as Case),
        ] {
            if args.only.as_deref().is_some_and(|only| only != kind) {
                continue;
            }
            let bar = progress::progress_bar(kind, count as usize);
            let findings: Vec<Option<String>> = (0..count)
                .into_par_iter()
                .map(|number| {
                    let mut rng = ChaCha8Rng::seed_from_u64(seed << 32 | number);
                    let dir = tempfile::tempdir()?;
                    copy(valid.path(), dir.path())?;
                    let finding = run(dir.path(), &mut rng);
                    bar.inc(1);
                    finding
                })
                .collect::<Result<_>>()?;
            bar.finish_and_clear();
            let findings: Vec<String> = findings.into_iter().flatten().collect();
            for finding in &findings {
                eprintln!("{kind}: {finding}");
            }
            is_met &= findings.is_empty();
            rows.push([
                seed.to_string(),
                kind.to_owned(),
                count.to_string(),
                findings.len().to_string(),
            ]);
        }
    }
    Ok(Section {
        id: "robustness",
        title: "Robustness of the commands",
        extent: format!("{}, {inputs} mutated inputs each", seeds_text(&seeds)),
        conditions: "One file of a campaign, a model, a network, a mapping, a table or a design is mutated, and a command that \
                     reads it runs. Bags are mutated at random or in their structure (records and chunks, pages and cells), and \
                     imported or guessed. Defects: a panic or a signal, more than 2 GB of address space or 60 s, status 0 with \
                     an output that is no finite result. Commands that write are killed at a random time, or the size of \
                     their files is limited at random. Defects: a file that the next command cannot read, the previous file \
                     lost, status 0 without the whole file, files of the killed one after the next start. Specified: none."
            .to_owned(),
        tables: markdown_table(["seed", "kind", "runs", "defects"], rows),
        is_met: Some(is_met),
    })
}

/// Runs a case in a folder of its own; a defect in words.
type Case = fn(&Path, &mut ChaCha8Rng) -> Result<Option<String>>;

/// Files of a small campaign, with everything that commands read.
fn prepare(dir: &Path) -> Result<()> {
    let run = |line: &str| -> Result<()> {
        let ended = execute(dir, line, None, None)?;
        ensure!(ended.status.success(), "magpie {line}: {}", ended.error);
        Ok(())
    };
    run("simulate -o c --recordings 3 --seconds 4 --sensors 1 --effect hysteresis")?;
    for number in 1..=2 {
        for name in ["hall.csv", "force.csv"] {
            let packed = dir.join(format!("c/{number}/{name}.gz"));
            let mut text = Vec::new();
            flate2::read::GzDecoder::new(fs::File::open(&packed)?).read_to_end(&mut text)?;
            fs::write(dir.join(format!("c/{number}/{name}")), text)?;
            fs::remove_file(packed)?;
        }
    }
    run("fit c -o plain.toml")?;
    run("add plain.toml c hysteresis -o model.toml")?;
    run("train model.toml c -o network.toml --epochs 1")?;
    run("design optimize --range 250 -o design.toml")?;
    fs::write(dir.join("mapping.toml"), MAPPING)?;
    fs::write(dir.join("bag.toml"), bag_files::MAPPING)?;
    let rows = (0..500).map(|row| {
        let (time_s, weight_g) = (0.01 * f64::from(row), 10.0 * f64::from(row % 50));
        format!("{time_s},{},12.5,{},{weight_g}\n", 100 + row % 7, 3 * (row % 50))
    });
    fs::write(
        dir.join("table.csv"),
        "t,bx,by,bz,weight_g\n".to_owned() + &rows.collect::<String>(),
    )?;
    run("import mapping.toml table.csv table.csv -o imported")?;
    // Unchanged, as no byte says what to change.
    for (name, file) in
        [("a.mcap", bag_files::mcap_file as BagFile), ("a.db3", bag_files::database_file)]
    {
        fs::write(dir.join(name), file(&mut Bytes::new(&[])))?;
        run(&format!("import bag.toml {name} -o imported-{name}"))?;
    }
    Ok(())
}

/// Writes a bag with changes that bytes choose.
type BagFile = fn(&mut Bytes) -> Vec<u8>;

fn mutate_mcap(dir: &Path, rng: &mut ChaCha8Rng) -> Result<Option<String>> {
    mutate_bag(dir, "a.mcap", bag_files::mcap_file, rng)
}

fn mutate_database(dir: &Path, rng: &mut ChaCha8Rng) -> Result<Option<String>> {
    mutate_bag(dir, "a.db3", bag_files::database_file, rng)
}

/// A bag that is changed in its structure, at random, or both.
fn mutate_bag(
    dir: &Path,
    name: &str,
    file: BagFile,
    rng: &mut ChaCha8Rng,
) -> Result<Option<String>> {
    let story: Vec<u8> = match rng.random_range(0..4) {
        0 => Vec::new(),
        _ => (0..64).map(|_| rng.random()).collect(),
    };
    let mut content = file(&mut Bytes::new(&story));
    if story.is_empty() || rng.random_range(0..4) == 0 {
        content = mutated(&content, rng);
    }
    fs::write(dir.join(name), content)?;
    let line = match rng.random_range(0..3) {
        0 => format!("import --guess {name} -o g.toml --json"),
        _ => format!("import bag.toml {name} -o i --json"),
    };
    let defect = read_mutated(dir, &line)?.map(|defect| format!("{line}: {defect}"));
    if defect.is_some() {
        let kept = std::env::temp_dir().join(format!("defect-{}-{name}", rng.random::<u64>()));
        fs::copy(dir.join(name), &kept)?;
        eprintln!("the bag of this defect is {}", kept.display());
    }
    Ok(defect)
}

const MAPPING: &str = r#"description = "a table"
[hall]
clock = { from = "t", unit = "s" }
columns = [
  { from = "bx", unit = "uT", to = "s0_x_gauss" },
  { from = "by", unit = "uT", to = "s0_y_gauss" },
  { from = "bz", unit = "uT", to = "s0_z_gauss" },
]
[force]
clock = { from = "t", unit = "s" }
columns = [{ from = "weight_g", unit = "g", to = "f0_z_n", scale = -1 }]
"#;

/// Files, and the commands that read them.
const READERS: [(&str, &[&str]); 8] = [
    ("c/1/hall.csv", CAMPAIGN),
    ("c/2/force.csv", CAMPAIGN),
    ("c/3/hall.csv.gz", CAMPAIGN),
    ("c/1/recording.toml", CAMPAIGN),
    (
        "model.toml",
        &[
            "compare model.toml c --json",
            "dev export model.toml -o t.rs --json",
            "replay model.toml c --json",
            "remove model.toml c hysteresis -o r.toml --json",
        ],
    ),
    (
        "network.toml",
        &[
            "replay model.toml c --network network.toml --json",
            "dev export model.toml --network network.toml -o t.rs --json",
        ],
    ),
    (
        "design.toml",
        &[
            "design check design.toml --json",
            "simulate --design design.toml --seconds 2 -o s --json",
        ],
    ),
    ("table.csv", IMPORT),
];
const CAMPAIGN: &[&str] = &[
    "fit c -o f.toml --json",
    "compare model.toml c --json",
    "diagnose plain.toml c --json",
    "replay model.toml c --json",
    "add plain.toml c creep -o a.toml --json",
];
const IMPORT: &[&str] = &["import mapping.toml table.csv -o i --json"];

/// Commands that write, and the file or folder with the command that reads it.
const WRITERS: [(&str, &str, &str); 6] = [
    ("fit c -o old.toml", "old.toml", "dev export old.toml -o x.rs"),
    ("add plain.toml c creep -o old.toml", "old.toml", "dev export old.toml -o x.rs"),
    ("dev export model.toml -o old.rs", "old.rs", ""),
    ("compare model.toml c -o old.html", "old.html", ""),
    ("simulate -o s --recordings 3 --seconds 4 --sensors 1", "s", "fit s -o x.toml"),
    ("import mapping.toml table.csv table.csv -o i", "i", "compare model.toml i"),
];

fn mutate(dir: &Path, rng: &mut ChaCha8Rng) -> Result<Option<String>> {
    let choice = rng.random_range(0..=READERS.len());
    let (file, commands) = READERS.get(choice).copied().unwrap_or(("mapping.toml", IMPORT));
    let path = dir.join(file);
    let before = fs::read(&path)?;
    fs::write(&path, mutated(&before, rng))?;
    let line = commands[rng.random_range(0..commands.len())];
    let defect = read_mutated(dir, line)?;
    Ok(defect.map(|defect| format!("{line}, {file} mutated: {defect}")))
}

/// Runs a command that reads a mutated file.
fn read_mutated(dir: &Path, line: &str) -> Result<Option<String>> {
    let ended = execute(dir, line, None, None)?;
    Ok(ended.defect().or_else(|| {
        let is_result = || {
            let result: Value = serde_json::from_str(&ended.output).ok()?;
            (result.is_object() && is_plausible(&result)).then_some(())
        };
        (ended.status.success() && is_result().is_none())
            .then(|| "status 0 with nonsense".to_owned())
    }))
}

/// Whether all numbers are finite and none is absurd.
fn is_plausible(value: &Value) -> bool {
    match value {
        Value::Number(number) => number.as_f64().is_some_and(|number| number.abs() < PLAUSIBLE),
        Value::Array(values) => values.iter().all(is_plausible),
        Value::Object(values) => values.values().all(is_plausible),
        _ => true,
    }
}

/// Cells, keys and values that break readers.
const TOKENS: [&str; 16] = [
    "NaN",
    "inf",
    "-1e308",
    "1e-320",
    "",
    "99999999999999999999",
    "-1",
    "\"",
    "[[",
    "\u{FFFD}",
    "0x10",
    "1_000",
    "=",
    ",,",
    "true",
    "-0",
];

/// Some changes of a file: bits, cells, lines, its end.
fn mutated(before: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = before.to_vec();
    for _ in 0..rng.random_range(1..4) {
        let at = rng.random_range(0..bytes.len().max(1)).min(bytes.len());
        let end_of = |from: usize, byte: u8| {
            bytes[from..]
                .iter()
                .position(|found| *found == byte)
                .map_or(bytes.len(), |to| from + to)
        };
        match rng.random_range(0..9) {
            0 if !bytes.is_empty() => {
                bytes[at.min(before.len() - 1)] ^= 1 << rng.random_range(0..8)
            }
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end_of(at, b'\n'))),
            3 => {
                let line = bytes[at..end_of(at, b'\n')].to_vec();
                // A bag has long lines.
                let count = rng.random_range(1..1000).min(1 + MAX_REPEATED / line.len().max(1));
                bytes.splice(at..at, line.repeat(count));
            }
            4 => {
                let token = TOKENS[rng.random_range(0..TOKENS.len())];
                let to = end_of(at, if rng.random() { b',' } else { b'\n' });
                bytes.splice(at..to, token.bytes());
            }
            5 => {
                let noise: Vec<u8> = (0..rng.random_range(1..64)).map(|_| rng.random()).collect();
                bytes.splice(at..at, noise);
            }
            // A digit changes a number's size.
            6 => {
                let digit = bytes[at..].iter().position(u8::is_ascii_digit);
                if let Some(digit) = digit {
                    let digits = vec![b'9'; rng.random_range(1..30)];
                    bytes.splice(at + digit..=at + digit, digits);
                }
            }
            7 if rng.random_range(0..10) == 0 => bytes.clear(),
            _ => {
                let to = rng.random_range(at..=bytes.len());
                let block = bytes[at..to].to_vec();
                let place = rng.random_range(0..=bytes.len());
                bytes.splice(place..place, block);
            }
        }
    }
    bytes
}

/// A writer over an earlier result is killed; the earlier or the whole new result is there, and the next one leaves nothing.
fn kill(dir: &Path, rng: &mut ChaCha8Rng) -> Result<Option<String>> {
    let (writer, file, reader) = WRITERS[rng.random_range(0..WRITERS.len())];
    let before = earlier(dir, file)?;
    // Somewhere in the time that the whole command takes, or in its end.
    let begun = Instant::now();
    let measured = tempfile::tempdir()?;
    copy(dir, measured.path())?;
    let whole = execute(measured.path(), writer, None, None)?;
    ensure!(whole.status.success(), "magpie {writer}: {}", whole.error);
    let took = begun.elapsed();
    let share = if rng.random() { rng.random_range(0.0..1.0) } else { rng.random_range(0.8..1.0) };
    let ended = execute(dir, writer, Some(took.mul_f64(share)), None)?;
    let mut defect = ended.defect().filter(|_| ended.status.signal() != Some(SIGKILL));
    defect = defect.or(broken(dir, (file, reader), before.as_deref(), ended.status.success())?);
    if defect.is_none() {
        // The next start deletes what the killed one has left.
        let target = dir.join(file);
        if target.is_dir() {
            fs::remove_dir_all(&target)?;
            // Only the whole campaign comes with it.
            fs::remove_file(dir.join(TRUTH)).ok();
        }
        let next = execute(dir, writer, None, None)?;
        defect = next.defect().or_else(|| {
            (!next.status.success()).then(|| format!("the next one fails: {}", next.error))
        });
        let expected = names(measured.path())?;
        defect = defect.or_else(|| leftover(dir, &expected));
    }
    Ok(defect.map(|defect| format!("{writer} killed: {defect}")))
}

const SIGKILL: i32 = 9;
/// The truth of a simulated campaign, next to its folder.
const TRUTH: &str = "s-truth.toml";

/// A writer whose files may not grow beyond a limit: it fails with a sentence, or writes the whole result.
fn limit(dir: &Path, rng: &mut ChaCha8Rng) -> Result<Option<String>> {
    let (writer, file, reader) = WRITERS[rng.random_range(0..WRITERS.len())];
    let before = earlier(dir, file)?;
    // Messages are files too, and need one.
    let limit_kib = 1000.0_f64.powf(rng.random_range(0.0..1.0)) as u64;
    let ended = execute(dir, writer, None, Some(limit_kib))?;
    let defect = ended
        .defect()
        .or(broken(dir, (file, reader), before.as_deref(), ended.status.success())?)
        .or_else(|| {
            let is_silent = !ended.status.success() && ended.error.is_empty();
            is_silent.then(|| "it fails without a message".to_owned())
        });
    Ok(defect.map(|defect| format!("{writer} with files of at most {limit_kib} KiB: {defect}")))
}

/// An earlier result under the name of the new one, where it is a file.
fn earlier(dir: &Path, file: &str) -> Result<Option<Vec<u8>>> {
    let from = match Path::new(file).extension().and_then(|extension| extension.to_str()) {
        Some("toml") => "plain.toml",
        // Of the program's own; another file is not overwritten.
        Some("rs") => {
            let made = execute(dir, &format!("dev export plain.toml -o {file}"), None, None)?;
            ensure!(made.status.success(), "{}", made.error);
            file
        }
        Some("html") => {
            let made = execute(dir, &format!("compare plain.toml c -o {file}"), None, None)?;
            ensure!(made.status.success(), "{}", made.error);
            file
        }
        _ => return Ok(None),
    };
    let before = fs::read(dir.join(from))?;
    fs::write(dir.join(file), &before)?;
    Ok(Some(before))
}

/// Whether the earlier result is lost without a whole new one, or the new one cannot be read.
fn broken(
    dir: &Path,
    (file, reader): (&str, &str),
    before: Option<&[u8]>,
    has_succeeded: bool,
) -> Result<Option<String>> {
    let path = dir.join(file);
    if !path.exists() {
        let is_lost = before.is_some() || has_succeeded;
        return Ok(is_lost.then(|| format!("{file} is missing")));
    }
    if let Some(before) = before {
        let now = fs::read(&path)?;
        if now == before {
            return Ok(None);
        }
        if now.len() < before.len() / 4 {
            return Ok(Some(format!("{file} has {} bytes, before {}", now.len(), before.len())));
        }
    }
    if reader.is_empty() {
        return Ok(None);
    }
    let read = execute(dir, reader, None, None)?;
    let fails = !read.status.success();
    Ok(fails.then(|| format!("{file} cannot be read: {}", read.error)))
}

fn names(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(dir)?.map(|entry| Ok(entry?.file_name().into()));
    entries.collect()
}

/// A file that a complete run would not have left.
fn leftover(dir: &Path, expected: &[PathBuf]) -> Option<String> {
    let found = names(dir).ok()?;
    let made = [Path::new("x.rs"), Path::new("x.toml")];
    let other =
        found.iter().find(|name| !expected.contains(name) && !made.contains(&name.as_path()))?;
    Some(format!("{} is left", other.display()))
}

/// End of a command.
struct Ended {
    status: ExitStatus,
    output: String,
    error: String,
    is_late: bool,
}

impl Ended {
    fn defect(&self) -> Option<String> {
        let first = |text: &str| text.chars().take(300).collect::<String>();
        if self.is_late {
            return Some(format!("not done within {} s", PATIENCE.as_secs()));
        }
        if self.error.contains("panicked at") {
            return Some(first(&self.error));
        }
        let signal = self.status.signal()?;
        Some(format!("signal {signal}: {}", first(&self.error)))
    }
}

/// Runs a command in a folder with bounded memory; it is killed after some time, and its files are limited in KiB.
fn execute(
    dir: &Path,
    line: &str,
    kill_after: Option<Duration>,
    limit_kib: Option<u64>,
) -> Result<Ended> {
    let (output, error) = (dir.join(".stdout"), dir.join(".stderr"));
    // A write beyond the limit fails instead of ending the process.
    let size = limit_kib.map_or_else(String::new, |kib| format!("trap '' XFSZ; ulimit -f {kib}; "));
    let script = format!("{size}ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\"");
    let mut child = Command::new("bash")
        .args(["-c", &script])
        .arg(std::env::current_exe()?)
        .arg(SUBCOMMAND)
        .args(line.split(' '))
        .current_dir(dir)
        .env("RAYON_NUM_THREADS", "1")
        .stdin(Stdio::null())
        .stdout(fs::File::create(&output)?)
        .stderr(fs::File::create(&error)?)
        .spawn()
        .context("starting bash")?;
    let begun = Instant::now();
    let patience = kill_after.unwrap_or(PATIENCE);
    let (status, is_killed) = loop {
        if let Some(status) = child.try_wait()? {
            break (status, false);
        }
        if begun.elapsed() >= patience {
            child.kill()?;
            break (child.wait()?, true);
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let text =
        |path: &Path| fs::read(path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    let ended = Ended {
        status,
        output: text(&output)?,
        error: text(&error)?,
        is_late: is_killed && kill_after.is_none(),
    };
    fs::remove_file(output)?;
    fs::remove_file(error)?;
    Ok(ended)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            fs::create_dir(&target)?;
            copy(&entry.path(), &target)?;
        } else if fs::copy(entry.path(), &target)? == 0 && entry.metadata()?.len() > 0 {
            bail!("{} was not copied", entry.path().display());
        }
    }
    Ok(())
}
