//! Hostile input and interrupted or parallel writers: one sentence of error, bounded memory and time, complete outputs.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;
use std::thread::sleep;
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use tests::data;

use crate::workdir::{WorkDir, text};

/// Folder with a copy of a recording as `bench`, without `hall.csv.gz`.
fn without_hall() -> WorkDir {
    let dir = WorkDir::empty();
    fs::create_dir(dir.path("bench")).unwrap();
    for name in ["recording.toml", "force.csv.gz"] {
        fs::copy(data("clean/1").join(name), dir.path("bench").join(name)).unwrap();
    }
    dir
}

fn write_compressed(path: &Path, pieces: impl IntoIterator<Item = String>) {
    let mut packer = GzEncoder::new(fs::File::create(path).unwrap(), Compression::best());
    for piece in pieces {
        packer.write_all(piece.as_bytes()).unwrap();
    }
    packer.finish().unwrap();
}

/// The one line of error of a command that fails with exit code 1.
fn refusal(dir: &WorkDir, command: &str) -> String {
    let output = dir.run(command);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{command}: {message}");
    assert_eq!(message.lines().count(), 1, "{command}: {message}");
    message
}

/// Names of temporary files and folders.
fn drafts(dir: &WorkDir) -> Vec<String> {
    let names = fs::read_dir(dir.path("")).unwrap().map(|entry| entry.unwrap().file_name());
    names
        .filter_map(|name| name.into_string().ok())
        .filter(|name| name.starts_with(".magpie-"))
        .collect()
}

#[test]
fn compressed_table_with_an_endless_row_is_refused() {
    let dir = without_hall();
    let header = ["t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned()];
    let row = std::iter::repeat_n("1".repeat(1 << 20), 64);
    write_compressed(&dir.path("bench/hall.csv.gz"), header.into_iter().chain(row));
    for command in ["fit bench", "fit bench --json"] {
        let message = refusal(&dir, command);
        assert!(
            message.contains("hall.csv.gz, line 2: the row is longer than 65536 bytes"),
            "{message}"
        );
    }
}

#[test]
fn table_with_an_implausible_compression_is_refused() {
    let dir = without_hall();
    let header = ["t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned()];
    let rows = (0..3000).map(|i| format!("{i}000,{}1,0,0\n", "0".repeat(16_000)));
    let path = dir.path("bench/hall.csv.gz");
    write_compressed(&path, header.into_iter().chain(rows));
    assert!(fs::metadata(&path).unwrap().len() < 200_000);
    let message = refusal(&dir, "fit bench");
    assert!(message.contains("more than 100 times as long as its compressed file"), "{message}");
}

#[test]
fn header_of_too_many_columns_is_refused() {
    let dir = without_hall();
    let columns: Vec<String> = (0..1025).map(|i| format!("s{i}_x_lsb")).collect();
    fs::write(dir.path("bench/hall.csv"), columns.join(",") + "\n").unwrap();
    let message = refusal(&dir, "fit bench");
    assert!(message.contains("hall.csv, line 1: there are 1025 columns"), "{message}");
}

#[cfg(unix)]
#[test]
fn devices_and_pipes_are_refused_as_files() {
    let dir = without_hall();
    let pipe = dir.path("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    let link = |target: &Path, name: &str| {
        let _ = fs::remove_file(dir.path(name));
        std::os::unix::fs::symlink(target, dir.path(name)).unwrap();
    };
    for (target, found) in [(Path::new("/dev/zero"), "a device"), (&pipe, "a named pipe")] {
        link(target, "link");
        link(target, "bench/hall.csv");
        for command in [
            "fit bench",
            "import link bench -o imported",
            "import bench/recording.toml link -o imported",
            "design check link",
            "simulate -o made --design link",
            "dev export link -o tables.rs",
            "replay link bench",
            "dev emulate link",
            "record --virtual --start-s 0 --reference - --reference-map link -o made",
            "board key write link --port line",
        ] {
            let message = refusal(&dir, command);
            let is_mapping_error = command.contains("bench/recording.toml");
            let expected = format!("this is {found}, not a regular file");
            assert!(is_mapping_error || message.contains(&expected), "{command}: {message}");
        }
    }
}

/// A full disk by a limit on the size of files.
#[cfg(unix)]
#[test]
fn key_on_a_full_disk_leaves_no_file() {
    let dir = WorkDir::empty();
    let magpie = dir.command("board key new key.txt");
    let limited = std::process::Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\""])
        .arg(magpie.get_program())
        .args(magpie.get_args())
        .current_dir(dir.path(""))
        .output()
        .unwrap();
    let message = text(&limited.stderr);
    assert_eq!(limited.status.code(), Some(1), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(!dir.path("key.txt").exists() && drafts(&dir).is_empty(), "{message}");
    dir.stdout("board key new key.txt");
    assert_eq!(dir.read("key.txt").trim().len(), 32);
    assert!(refusal(&dir, "board key new key.txt").contains("not overwritten"));
}

#[test]
fn parallel_writers_leave_one_campaign_with_its_truth() {
    let dir = WorkDir::empty();
    let run = |seed: &str| {
        let line = format!("simulate -o one --seconds 3 --recordings 1 --seed {seed}");
        dir.command(&line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let outputs = [run("1"), run("2")].map(|process| process.wait_with_output().unwrap());
    let winner = outputs.iter().position(|output| output.status.success()).unwrap();
    let message = text(&outputs[1 - winner].stderr);
    assert!(message.contains("not overwritten"), "{message}");
    assert!(dir.read("one-truth.toml").contains(&format!("\nseed = {}\n", winner + 1)));
    let seed = winner + 1;
    dir.stdout(&format!("simulate -o again --seconds 3 --recordings 1 --seed {seed}"));
    for name in ["hall.csv.gz", "force.csv.gz"] {
        let bytes = |campaign: &str| fs::read(dir.path(campaign).join("1").join(name)).unwrap();
        assert!(bytes("one") == bytes("again"));
    }
    assert!(drafts(&dir).is_empty());
}

/// Waits for a temporary folder with a recording, whose writer holds the lock; it is none of the known ones.
#[cfg(unix)]
fn new_draft(dir: &WorkDir, known: &[String]) -> String {
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(20) {
        let mut new = drafts(dir).into_iter().filter(|name| !known.contains(name));
        if let Some(name) = new.find(|name| dir.path(name).join("1").exists()) {
            return name;
        }
        sleep(Duration::from_millis(5));
    }
    panic!("no temporary folder");
}

#[cfg(unix)]
#[test]
fn drafts_of_killed_writers_are_deleted_and_of_live_ones_kept() {
    let dir = WorkDir::empty();
    let start = |name: &str| {
        let line = format!("simulate -o {name} --seconds 3600 --recordings 1");
        dir.command(&line).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut killed = start("killed");
    let of_killed = new_draft(&dir, &[]);
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(drafts(&dir), [of_killed.as_str()]);
    let mut live = start("live");
    let of_live = new_draft(&dir, &[of_killed]);
    assert_eq!(drafts(&dir), [of_live.as_str()]);
    dir.stdout("simulate -o other --seconds 3 --recordings 1");
    let kept = drafts(&dir);
    live.kill().unwrap();
    live.wait().unwrap();
    assert_eq!(kept, [of_live]);
    dir.stdout("design optimize --range 100 --count 16 -o design.toml");
    assert!(drafts(&dir).is_empty());
}

#[test]
fn implausible_numbers_are_refused_by_every_command() {
    let dir = WorkDir::empty();
    let options = [
        ("record --virtual -o made", "--start-s"),
        ("record --virtual -o made", "--seconds"),
        ("record --virtual -o made", "--press"),
        ("monitor --virtual", "--seconds"),
        ("monitor --virtual", "--unplug"),
        ("fit bench", "--delay-ms"),
        ("train model.toml bench", "--rate"),
        ("train model.toml bench", "--zero-weight"),
        ("simulate -o made", "--seconds"),
        ("simulate -o made", "--scatter"),
        ("simulate -o made", "--load"),
        ("simulate -o made", "--warmer"),
        ("simulate -o made", "--field-noise"),
        ("simulate -o made", "--reference-noise"),
        ("simulate -o made --random-effects 1", "--strength"),
        ("simulate -o made", "--effect"),
        ("design optimize", "--range"),
        ("design optimize --range 100", "--stroke"),
        ("design optimize --range 100", "--life"),
        ("design optimize --range 100", "--safety"),
        ("design sweep", "--size"),
        ("grasp", "--force"),
        ("grasp", "--position"),
        ("grasp", "--speed"),
        ("grasp", "--foot"),
        ("grasp --force 50", "--scatter"),
        ("grasp --foot 150", "--lasts"),
        ("grasp --position 20", "--from"),
        ("dev emulate", "--seconds"),
        ("dev emulate", "--opening"),
        ("dev emulate", "--object-width-mm"),
        ("dev emulate", "--speed"),
    ];
    for (command, option) in options {
        // Below a positive quantity's range, or where zero is possible above it.
        for number in ["nan", "inf", "-inf", "1e308", "-1e308"] {
            let number = match option {
                "--press" => format!("{number},0"),
                "--unplug" => format!("0@{number}"),
                "--size" => format!("gap={number}"),
                "--effect" => format!("creep={number}"),
                _ => number.to_owned(),
            };
            let output = dir.run(&format!("{command} {option}={number}"));
            let message = text(&output.stderr);
            let code = output.status.code();
            assert!(matches!(code, Some(1 | 2)), "{command} {option}={number}: {message}");
            // Named by the option, and not, for example, by a file that is missing here.
            assert!(message.contains(option) || message.contains("creep"), "{message}");
        }
    }
    for command in [
        "record --virtual -o made --seconds 1e-320",
        "train model.toml bench --rate 1e-320",
        "simulate -o made --seconds 1e-320",
        "design optimize --range 1e-320",
        "design optimize --range 100 --stroke 1e-320",
        "design optimize --range 100 --safety 1e-320",
        "design sweep --size gap=1e-320",
        "grasp --force 1e-320",
        "grasp --speed 1e-320",
        "dev emulate --speed 1e-320",
    ] {
        let output = dir.run(command);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{command}");
    }
    assert!(!dir.path("made").exists());
}

const DESIGN: &str = "\
gap_mm = 1.5
force_range_n = 250.0
stiffness_x_n_per_mm = 500.0
[magnet]
shape = \"cylinder\"
diameter_mm = 3.0
length_mm = 2.0
remanence_t = 1.2
axis = \"y\"
[flexure_x]
support = \"clamped-free\"
material = \"own\"
length_mm = 30.0
width_mm = 15.0
thickness_mm = 5.0
[flexure_z]
support = \"clamped-free\"
material = \"17-4PH\"
length_mm = 30.0
width_mm = 15.0
thickness_mm = 5.0
[sensor]
range_gauss = 2000.0
gauss_per_lsb = 0.125
noise_gauss = 0.35
package_mm = 0.4
[limits]
stroke_mm = 0.5
life_cycles = 1e7
safety = 1.5
[tolerances]
offset_mm = 0.1
gap_mm = 0.1
tilt_deg = 2.0
remanence = 0.05
[material.own]
modulus_gpa = 196.0
yield_mpa = 1170.0
fatigue_coefficient_mpa = 1500.0
fatigue_exponent = -0.09
";

#[test]
fn implausible_numbers_of_a_design_are_refused_by_key() {
    let dir = WorkDir::empty();
    fs::write(dir.path("design.toml"), DESIGN).unwrap();
    dir.stdout("design check design.toml");
    let lines: Vec<&str> = DESIGN.lines().collect();
    for (place, line) in lines.iter().enumerate() {
        let Some((key, value)) = line.split_once(" = ") else { continue };
        if value.starts_with('"') {
            continue;
        }
        for number in ["nan", "inf", "-1e308", "1e308", "1e-320"] {
            let mut changed = lines.clone();
            let edited = format!("{key} = {number}");
            changed[place] = &edited;
            fs::write(dir.path("design.toml"), changed.join("\n")).unwrap();
            let message = refusal(&dir, "design check design.toml");
            let name = key.strip_suffix("_mm").unwrap_or(key);
            assert!(message.contains("design.toml, ") && message.contains(name), "{message}");
        }
    }
}
