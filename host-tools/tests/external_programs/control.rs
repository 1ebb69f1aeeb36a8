//! `magpie grasp` and the other commands against a gripper that an earlier host has left: whatever way a command ends, it releases
//! and moves nothing that it has not gripped itself; results have their codes.

use std::io::{BufRead, BufReader, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::images::Variant;
use crate::unix::{Emulation, SLOW, number, path};
use crate::workdir::{WorkDir, text};

/// Force of the earlier host's grip in newtons.
const HELD_N: f64 = 60.0;
/// Largest change of a held force, several times the noise of the sensors, and of the opening.
const TOLERANCE_N: f64 = 3.0;
const TOLERANCE_MM: f64 = 0.1;

/// State of the gripper, as an observer on the bus reads it.
#[derive(Debug)]
struct Observed {
    state: String,
    is_commanded: bool,
    force_n: f64,
    opening_mm: f64,
}

/// A gripper with an object of 40 mm, homed; and hosts on its bus.
struct Cell {
    dir: WorkDir,
    emulation: Emulation,
}

impl Cell {
    fn start() -> Result<Self, Failed> {
        let dir = WorkDir::empty();
        let options = format!("--opening 3 --object-width-mm 40 {SLOW}");
        let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, &options);
        emulation.allow_delays(&dir);
        let cell = Self { dir, emulation };
        cell.grasp("--home --position 50");
        Ok(cell)
    }

    fn line(&self, arguments: &str) -> String {
        format!("grasp --can {} {arguments}", self.emulation.can)
    }

    /// A grasp that must succeed.
    fn grasp(&self, arguments: &str) -> Value {
        self.dir.json(&format!("{} --json", self.line(arguments)))
    }

    /// Status and JSON of a grasp that fails.
    fn failed(&self, arguments: &str) -> (i32, Value) {
        let output = self.dir.run(&format!("{} --json", self.line(arguments)));
        let json = serde_json::from_slice(&output.stdout);
        (output.status.code().unwrap_or(-1), json.unwrap_or(Value::Null))
    }

    fn observe(&self) -> Observed {
        let line = format!("monitor --can {} --seconds 0.9 --json", self.emulation.can);
        let output = String::from_utf8(self.dir.stdout(&line)).unwrap();
        let last: Value = serde_json::from_str(output.lines().last().unwrap()).unwrap();
        Observed {
            state: last["heartbeat"]["state"].as_str().unwrap_or_default().to_owned(),
            is_commanded: last["heartbeat"]["command_alive"] == true,
            force_n: number(&last["grip"]["force_n"]),
            opening_mm: number(&last["grip"]["opening_mm"]),
        }
    }

    /// A host that runs until its state is one of these, on this bus.
    fn host(&self, can: &str, arguments: &str, states: &[&str]) -> Host {
        let line = format!("grasp --can {can} {arguments}");
        let mut child = self
            .dir
            .command(&line)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let is_in =
            |line: &String| states.iter().any(|state| line.contains(&format!("s  {state}")));
        let found = lines.find_map(|line| line.ok().filter(is_in));
        assert!(found.is_some(), "{arguments}: no state {states:?}");
        Host { child, lines: Box::new(lines) }
    }

    /// Leaves the gripper as a host that is killed in one of these states.
    fn abandon(&self, arguments: &str, states: &[&str]) {
        let host = self.host(&self.emulation.can, arguments, states);
        host.signal(Signal::KILL);
        // Until it may be taken over.
        thread::sleep(Duration::from_millis(2500));
    }

    /// Holds an object on behalf of a host that has been killed.
    fn abandon_grip(&self) {
        self.abandon(&format!("--force {HELD_N}"), &["hold active", "hold latched"]);
    }

    /// The object is held as before.
    fn assert_holds(&self, before: &Observed, after: &str) {
        let now = self.observe();
        assert!(now.state.starts_with("hold"), "{after}: {now:?}");
        assert!((now.force_n - before.force_n).abs() < TOLERANCE_N, "{after}: {now:?} {before:?}");
        assert!(
            (now.opening_mm - before.opening_mm).abs() < TOLERANCE_MM,
            "{after}: {now:?} {before:?}"
        );
        assert!(!now.is_commanded, "{after}: {now:?}");
    }
}

/// A running host.
struct Host {
    child: Child,
    lines: Box<dyn Iterator<Item = std::io::Result<String>>>,
}

impl Host {
    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Status and the remaining lines on stderr.
    fn end(mut self) -> (Option<i32>, String) {
        let lines: Vec<String> = self.lines.map_while(Result::ok).collect();
        (self.child.wait().unwrap().code(), lines.join("\n"))
    }
}

/// A bus over TCP whose connection can be cut.
struct Wire {
    can: String,
    streams: std::sync::mpsc::Receiver<[TcpStream; 2]>,
}

impl Wire {
    fn to(can: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (sender, streams) = std::sync::mpsc::channel();
        let can = can.to_owned();
        thread::spawn(move || {
            let (client, _) = listener.accept().unwrap();
            let server = TcpStream::connect(can).unwrap();
            for (from, to) in [(&client, &server), (&server, &client)] {
                let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                thread::spawn(move || std::io::copy(&mut from, &mut to));
            }
            sender.send([client, server]).unwrap();
        });
        Self { can: address, streams }
    }

    fn cut(&self) {
        for stream in self.streams.recv().unwrap() {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

/// What commands do themselves during a grip of an earlier host: status of the refusals, 0 for those that only observe or write
/// what does not move.
const BESIDE_A_GRIP: [(&str, i32); 15] = [
    ("grasp {bus} --position 60", 15),
    ("grasp {bus} --position 30 --speed 5", 15),
    ("grasp {bus} --foot", 15),
    ("grasp {bus} --foot --contact line", 15),
    ("grasp {bus} --home --position 60 --clear-faults", 15),
    ("grasp {bus} --release 20", 15),
    ("board tare {bus}", 1),
    ("board tare {bus} --unloaded", 1),
    ("board identify motor {bus}", 1),
    ("board identify screw {bus}", 1),
    ("board parameter lead 1 {bus}", 1),
    ("board parameter raw 0 {bus}", 0),
    ("board {bus}", 0),
    ("monitor {bus} --seconds 1", 0),
    ("record {bus} --seconds 1 -o recording", 0),
];

/// Each way out of each command during a grip of an earlier host.
pub fn no_exit_releases_a_foreign_grip() -> Result<(), Failed> {
    let cell = Cell::start()?;
    cell.abandon_grip();
    let before = cell.observe();
    assert!((before.force_n - HELD_N).abs() < TOLERANCE_N, "{before:?}");
    for (command, status) in BESIDE_A_GRIP {
        let line = command.replace("{bus}", &format!("--can {}", cell.emulation.can));
        let output = cell.dir.run(&line);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{line}: {message}");
        cell.assert_holds(&before, &line);
    }
    // The command takes the grip over; however it ends, it was not its own.
    let line = format!("--force {HELD_N}");
    let holds = ["hold active", "hold latched"];
    for (signal, status) in [
        (Signal::INT, Some(0)),
        (Signal::TERM, Some(0)),
        (Signal::HUP, None),
        (Signal::QUIT, None),
        (Signal::KILL, None),
    ] {
        if [Signal::HUP, Signal::QUIT].contains(&signal) && is_ignored(signal) {
            println!(
                "not sent: {signal:?}, which the caller made this program and its children ignore"
            );
            continue;
        }
        let host = cell.host(&cell.emulation.can, &line, &holds);
        // Its own command is in effect.
        thread::sleep(Duration::from_secs(2));
        host.signal(signal);
        let (ended, lines) = host.end();
        assert_eq!(ended, status, "{signal:?}: {lines}");
        thread::sleep(Duration::from_millis(2500));
        cell.assert_holds(&before, &format!("{signal:?}"));
    }
    let output = cell.grasp(&format!("{line} --seconds 1"));
    assert_eq!(output["left_gripped"], true, "{output}");
    cell.assert_holds(&before, "--seconds");
    let wire = Wire::to(&cell.emulation.can);
    let host = cell.host(&wire.can, &line, &holds);
    wire.cut();
    let (ended, lines) = host.end();
    assert_eq!(ended, Some(18), "{lines}");
    assert!(lines.contains("connection lost"), "{lines}");
    thread::sleep(Duration::from_millis(2500));
    cell.assert_holds(&before, "a broken line");
    cell.end_of_reader(&before, &line);
    // A stop is no release either.
    cell.grasp("--stop");
    let stopped = cell.observe();
    assert!((stopped.force_n - before.force_n).abs() < TOLERANCE_N, "{stopped:?}");
    cell.grasp("--release 60 --clear-faults");
    let opened = cell.observe();
    assert!(opened.force_n < 5.0 && opened.opening_mm > 45.0, "{opened:?}");
    Ok(())
}

/// Whether this program ignores a signal: SIGHUP after `nohup`, SIGQUIT in the background of a script.
fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored
        .and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok())
        .is_some_and(|bits| bits >> (signal.as_raw() - 1) & 1 == 1)
}

impl Cell {
    /// A reader that closes its end, and one that reads nothing while the pipe is full.
    fn end_of_reader(&self, before: &Observed, arguments: &str) {
        for closes in [true, false] {
            let (reader, mut writer) = std::io::pipe().unwrap();
            if !closes {
                fill(&mut writer);
            }
            let reader = (!closes).then_some(reader);
            let mut child = self
                .dir
                .command(&self.line(arguments))
                .stdin(Stdio::null())
                .stdout(writer.try_clone().unwrap())
                .stderr(writer)
                .spawn()
                .unwrap();
            let begun = Instant::now();
            while !self.observe().is_commanded {
                assert!(begun.elapsed() < Duration::from_secs(30), "no session");
            }
            let alive = self.observe();
            assert!(alive.is_commanded, "{closes}: {alive:?}");
            assert!((alive.force_n - before.force_n).abs() < TOLERANCE_N, "{closes}: {alive:?}");
            let pid = Pid::from_child(&child);
            kill_process(pid, Signal::INT).unwrap();
            if !closes {
                // The session ends; the process waits for its output.
                while self.observe().is_commanded {
                    assert!(begun.elapsed() < Duration::from_secs(60), "the session goes on");
                }
                thread::sleep(Duration::from_secs(1));
                kill_process(pid, Signal::INT).unwrap();
            }
            let status = child.wait().unwrap();
            assert_eq!(status.code(), Some(if closes { 0 } else { 130 }), "{status}");
            drop(reader);
            thread::sleep(Duration::from_millis(2500));
            self.assert_holds(before, &format!("a reader that closes: {closes}"));
        }
    }
}

fn fill(writer: &mut std::io::PipeWriter) {
    use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
    let flags = fcntl_getfl(&*writer).unwrap();
    fcntl_setfl(&*writer, flags | OFlags::NONBLOCK).unwrap();
    while writer.write(&[b'\n'; 4096]).is_ok() {}
    while writer.write(b"\n").is_ok() {}
    fcntl_setfl(&*writer, flags).unwrap();
}

/// What an earlier host has left at rest stays at rest, unless the command moves it on purpose.
pub fn no_exit_moves_fingers_of_an_earlier_host() -> Result<(), Failed> {
    let cell = Cell::start()?;
    for (arguments, states, after) in [
        ("--position 60 --seconds 60", ["idle"], "idle"),
        // 4.5 mm/s: far from the object.
        ("--force 20", ["approach"], "timeout hold"),
    ] {
        cell.grasp("--position 70");
        cell.abandon(arguments, &states);
        let before = cell.observe();
        assert_eq!(before.state, after);
        for command in [
            "grasp {bus} --foot",
            "grasp {bus} --release 20",
            "board tare {bus}",
            "board identify motor {bus}",
            "board parameter lead 1 {bus}",
            "monitor {bus} --seconds 0.5",
        ] {
            let line = command.replace("{bus}", &format!("--can {}", cell.emulation.can));
            cell.dir.run(&line);
            let now = cell.observe();
            let moved_mm = (now.opening_mm - before.opening_mm).abs();
            assert!(moved_mm < TOLERANCE_MM, "{after}, {line}: {now:?} {before:?}");
            // A stop of the earlier motion is acknowledged; nothing else changes.
            assert!(["idle", after].contains(&now.state.as_str()), "{after}, {line}: {now:?}");
        }
        // The timeout of an earlier host is none of this one.
        let moved = cell.grasp("--position 65");
        assert_eq!(moved["result"]["code"], "reached", "{moved}");
    }
    Ok(())
}

/// Codes and statuses of results.
pub fn results_have_codes() -> Result<(), Failed> {
    let cell = Cell::start()?;
    let (status, contact) = cell.failed("--position 30");
    assert_eq!((status, &contact["result"]["code"]), (14, &"contact".into()), "{contact}");
    let opening_mm = number(&contact["result"]["opening_mm"]);
    assert!((opening_mm - 40.0).abs() < 1.0, "{contact}");
    cell.grasp("--position 50");
    let (status, refused) = cell.failed("--foot");
    assert_eq!((status, &refused["result"]["code"]), (15, &"refused".into()), "{refused}");
    let message = refused["error"].as_str().unwrap();
    assert!(message.contains("at most 1 mm") && message.contains("40 ± 1 mm"), "{message}");
    // Held without a host, until the release; events as they come.
    let output = cell.dir.stdout(&cell.line("--force 40 --keep --json-lines"));
    let lines: Vec<Value> =
        String::from_utf8(output)?.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    let count = |event: &str| lines.iter().filter(|line| line["event"] == event).count();
    let counts = ["state", "point", "result"].map(count);
    assert!(counts[0] >= 3 && counts[1] > 5 && counts[2] == 1, "{counts:?}");
    let last = lines.last().unwrap();
    assert_eq!((&last["event"], &last["code"]), (&"result".into(), &"reached".into()), "{last}");
    let held = cell.observe();
    assert!(held.state.starts_with("hold") && !held.is_commanded, "{held:?}");
    assert!((held.force_n - 40.0).abs() < TOLERANCE_N, "{held:?}");
    cell.grasp("--release 50");
    // A reader that has closed its end ends the output, not the hold.
    let (reader, writer) = std::io::pipe()?;
    drop(reader);
    let status = cell
        .dir
        .command(&cell.line("--force 40 --seconds 1"))
        .stdin(Stdio::null())
        .stdout(writer.try_clone()?)
        .stderr(writer)
        .status()?;
    assert_eq!(status.code(), Some(0));
    cell.grasp("--position 50");
    // Ctrl-C in the approach.
    let host = cell.host(&cell.emulation.can, "--force 10", &["approach"]);
    host.signal(Signal::INT);
    let (ended, lines) = host.end();
    assert_eq!(ended, Some(130), "{lines}");
    // A connection that is lost in the hold; the state is that of the last message.
    let wire = Wire::to(&cell.emulation.can);
    let line = format!("grasp --can {} --force 40 --json", wire.can);
    let child = cell.dir.command(&line).stdout(Stdio::piped()).spawn().unwrap();
    while !cell.observe().state.starts_with("hold") {}
    thread::sleep(Duration::from_secs(1));
    wire.cut();
    let output = child.wait_with_output().unwrap();
    let lost: Value = serde_json::from_slice(&output.stdout)?;
    assert_eq!(output.status.code(), Some(18), "{lost}");
    assert_eq!(
        (&lost["result"]["code"], &lost["reached"]),
        (&"connection_lost".into(), &true.into())
    );
    assert!((number(&lost["result"]["force_n"]) - 40.0).abs() < TOLERANCE_N, "{lost}");
    for command in ["monitor", "record -o cut"] {
        let wire = Wire::to(&cell.emulation.can);
        let line = format!("{command} --can {} --seconds 60", wire.can);
        let child =
            cell.dir.command(&line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        thread::sleep(Duration::from_secs(4));
        wire.cut();
        let output = child.wait_with_output()?;
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(18), "{command}: {message}");
        assert!(message.contains("connection lost"), "{command}: {message}");
    }
    Ok(())
}

/// Cause and cure are the last that is printed, and end the next attempt at once, too.
pub fn first_home_on_the_default_image_names_the_cure() -> Result<(), Failed> {
    let dir = WorkDir::empty();
    let emulation =
        Emulation::start(&dir, &path(Variant::Default)?, &format!("--opening 10 {SLOW}"));
    emulation.allow_delays(&dir);
    let cell = Cell { dir, emulation };
    let output = cell.dir.run(&cell.line("--home --position 60"));
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(16), "{message}");
    let last = message.lines().last().unwrap();
    assert!(last.contains("cargo magpie upload MODEL --nominal"), "{message}");
    assert_eq!(message.matches("homing failed: stroke wrong").count(), 1, "{message}");
    let begun = Instant::now();
    let (status, refused) = cell.failed("--home --position 60");
    assert_eq!(status, 15, "{refused}");
    let words = refused["error"].as_str().unwrap();
    assert_eq!(words.matches("a fault is active").count(), 1, "{words}");
    assert!(words.contains("stroke wrong"), "{words}");
    // Known at once: far from the timeout of 10 s.
    assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
    Ok(())
}

/// A soft object; one that is wider or narrower than expected; one that is taken away.
pub fn a_grip_that_fails_has_its_reason() -> Result<(), Failed> {
    let dir = WorkDir::empty();
    let options =
        format!("--opening 3 --object-width-mm 40 --object soft --remove-object 55 {SLOW}");
    let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, &options);
    emulation.allow_delays(&dir);
    let cell = Cell { dir, emulation };
    let result = |arguments: &str, status: i32, code: &str| {
        let (ended, json) = cell.failed(arguments);
        assert_eq!((ended, &json["result"]["code"]), (status, &code.into()), "{arguments}: {json}");
        json["result"].clone()
    };
    let soft = result("--home --force 300", 13, "too_soft");
    let [force_n, opening_mm] = ["force_n", "opening_mm"].map(|name| number(&soft[name]));
    assert!((5.0..299.0).contains(&force_n) && opening_mm < 40.0, "{soft}");
    // Above its window, below it.
    result("--force 10 --width 30:4", 19, "wrong_width");
    cell.grasp("--position 60");
    result("--force 10 --width 50:4", 10, "no_object");
    result("--force 15 --profile fragile --speed 5", 11, "object_lost");
    Ok(())
}
