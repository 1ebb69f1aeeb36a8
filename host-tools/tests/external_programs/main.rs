//! `magpie dev emulate` as a user meets it: other programs talk to the emulated board over its serial line and CAN bus. Where
//! this machine has no compiler for the chip every test is listed as ignored; `EMULATION=required` makes that a failure.

#[cfg(unix)]
mod control;
#[cfg(unix)]
#[allow(dead_code)] // The models behind them are another test's.
#[path = "../emulation/images.rs"]
mod images;
#[cfg(unix)]
#[path = "../workdir/mod.rs"]
mod workdir;

#[cfg(unix)]
fn main() -> std::process::ExitCode {
    unix::main()
}

#[cfg(not(unix))]
fn main() {}

#[cfg(unix)]
mod unix {
    use std::io::{BufRead, BufReader, Write};
    use std::net::TcpStream;
    use std::num::NonZeroUsize;
    use std::process::{ExitCode, Stdio};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    use firmware::config::constants;
    use firmware::grip::commands::{CommandRefusal, RefusalReason, mode};
    use firmware::grip::states::{PowerState, TaskState, state_code};
    use firmware::protocol::messages::{Heartbeat, Message};
    use firmware::protocol::{DEFAULT_NODE, PROTOCOL_VERSION, frame_id};
    use firmware::system::faults::Fault;
    use libtest_mimic::{Arguments, Failed, Trial};
    use rustix::process::Signal;
    use serde_json::Value;

    use crate::control;
    use crate::images::{self, Variant};
    use crate::workdir::running::Running;
    use crate::workdir::served::Served;
    use crate::workdir::tutorial::{Step, folder, link_data, steps};
    use crate::workdir::{WorkDir, campaign, text};

    type Test = fn() -> Result<(), Failed>;

    pub fn main() -> ExitCode {
        let mut arguments = Arguments::from_args();
        // Most of them wait for the clock half of the time.
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        arguments.test_threads = arguments.test_threads.or(Some(2 * cores));
        let absent = if arguments.list { None } else { images::get(Variant::Default).err() };
        if let Some(reason) = absent.as_ref().filter(|_| std::env::var_os("EMULATION").is_some()) {
            println!("no image for the emulated chip: {reason}");
            return ExitCode::FAILURE;
        }
        // The longest first: they wait for the clock while others compute.
        let trials: [(&str, Test); 16] = [
            ("no_exit_releases_a_foreign_grip", control::no_exit_releases_a_foreign_grip),
            (
                "no_exit_moves_fingers_of_an_earlier_host",
                control::no_exit_moves_fingers_of_an_earlier_host,
            ),
            ("results_have_codes", control::results_have_codes),
            (
                "first_home_on_the_default_image_names_the_cure",
                control::first_home_on_the_default_image_names_the_cure,
            ),
            ("a_grip_that_fails_has_its_reason", control::a_grip_that_fails_has_its_reason),
            ("motor_and_screw_are_identified", identification),
            ("the_tutorial_flashes_and_drives", tutorial),
            ("grip_homes_and_holds_a_force_over_the_can_bus", grip),
            ("the_workbench_uploads_a_calibration", workbench),
            ("record_receives_every_tick_on_the_serial_line", record),
            ("only_hosts_with_the_key_change_a_protected_gripper", keys),
            ("clients_together_send_what_the_bus_carries", flood),
            ("a_stranger_ends_no_grasp", stranger),
            ("a_profile_has_load_deadlines_and_stack", profile),
            ("settings_survive_in_a_flash_file", flash_file),
            ("an_image_that_is_none_is_refused", refused),
        ];
        if let Some(reason) = &absent {
            tests::not_run::note(trials.map(|(name, _)| name), reason);
        }
        let trial = |(name, test)| Trial::test(name, test).with_ignored_flag(absent.is_some());
        let trials = trials.map(trial).into();
        libtest_mimic::run(&arguments, trials).exit_code()
    }

    pub fn path(variant: Variant) -> Result<String, Failed> {
        Ok(images::get(variant)?.path.display().to_string())
    }

    /// An emulation that runs, with serial line and CAN bus as other programs name them.
    pub struct Emulation {
        running: Running,
        pub serial: String,
        pub can: String,
    }

    /// Half of real time: this machine may be busy with other tests, and keep a program waiting for longer than the
    /// timeout of its commands (see [`Emulation::allow_delays`]).
    pub const SLOW: &str = "--speed 0.5 --json";

    impl Emulation {
        pub fn start(dir: &WorkDir, image: &str, options: &str) -> Self {
            let mut running = Running::start(dir, &format!("dev emulate {image} {options}"));
            let mut message = BufReader::new(running.0.stderr.take().unwrap());
            let mut of = |option: &str| {
                let mut line = String::new();
                while !line.contains(option) {
                    line.clear();
                    assert!(message.read_line(&mut line).unwrap() > 0, "no line with {option}");
                }
                line.trim().rsplit(' ').next().unwrap().to_owned()
            };
            let [serial, can] = [of("--port"), of("--can")];
            // Nothing may wait for a reader of the rest.
            std::thread::spawn(move || std::io::copy(&mut message, &mut std::io::stderr()));
            Self { running, serial, can }
        }

        /// Sets the longest timeout of commands that the gripper has: at half speed, a second.
        pub fn allow_delays(&self, dir: &WorkDir) {
            dir.json(&format!("board parameter command_timeout 500 --port {} --json", self.serial));
        }

        /// Ends it with Ctrl-C; what it measured.
        pub fn end(mut self) -> Value {
            self.running.signal(Signal::INT);
            let measured = self.running.objects().next().unwrap();
            assert!(self.running.0.wait().unwrap().success());
            assert_eq!(measured["ended_by"], "interrupt");
            measured
        }
    }

    pub fn number(value: &Value) -> f64 {
        value.as_f64().unwrap_or(f64::NAN)
    }

    fn is_clean(measured: &Value) {
        for list in ["violations", "resets", "faults"] {
            assert_eq!(measured[list], Value::Array(Vec::new()), "{list}");
        }
    }

    fn profile() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let image = path(Variant::Clean)?;
        let measured = dir.json(&format!("dev emulate {image} --seconds 3 --speed max --json"));
        assert_eq!(measured["ended_by"], "seconds");
        assert!((number(&measured["virtual_s"]) - 3.0).abs() < 0.002, "{measured}");
        assert!(number(&measured["share_of_real_time"]) > 0.0);
        let profile = &measured["profile"];
        assert_eq!(profile["clock_hz"], 160_000_000);
        let idle = number(&profile["idle"]);
        let levels = profile["by_level"].as_array().unwrap();
        let load: f64 = levels.iter().map(|level| number(&level["load"])).sum();
        assert!((idle + load - 1.0).abs() < 0.02 && (0.3..0.9).contains(&idle), "{idle} {load}");
        let adc =
            profile["exceptions"].as_array().unwrap().iter().find(|load| load["name"] == "ADC1_2");
        let adc = adc.unwrap();
        assert!((number(&adc["entries_per_s"]) - 20_000.0).abs() < 200.0, "{adc}");
        assert!(number(&adc["longest_us"]) > 1.0 && number(&adc["latency_us"]) < 10.0, "{adc}");
        let stack = &profile["stack"];
        assert!(
            stack["used"].as_u64() > Some(1000)
                && stack["used"].as_u64() < stack["available"].as_u64()
        );
        let functions = profile["functions"].as_array().unwrap();
        let hottest = number(&functions[0]["load"]);
        assert!(functions.len() > 10 && (0.01..0.5).contains(&hottest), "{hottest}");
        let deadlines = &measured["deadlines"];
        let ticks = deadlines["ticks"].as_u64().unwrap();
        assert!((2980..=3000).contains(&ticks), "{deadlines}");
        assert_eq!((&deadlines["missed"], &deadlines["late"]), (&0.into(), &0.into()));
        assert!((100.0..1000.0).contains(&number(&deadlines["longest_us"])), "{deadlines}");
        let bins = deadlines["bins"].as_array().unwrap();
        let binned: u64 = bins.iter().map(|bin| bin["ticks"].as_u64().unwrap()).sum();
        assert_eq!(binned, ticks);
        is_clean(&measured);
        Ok(())
    }

    fn flood() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let emulation = Emulation::start(&dir, &path(Variant::Default)?, "--json");
        let client = || -> std::io::Result<TcpStream> {
            let mut stream = TcpStream::connect(&emulation.can)?;
            stream.write_all(b"< open can0 >< rawmode >")?;
            Ok(stream)
        };
        let (observer, flood, urgent) = (client()?, [client()?, client()?], client()?);
        for mut stream in flood {
            let frames = "< send 7F0 8 1 2 3 4 5 6 7 8 >".repeat(100);
            // Until the emulation ends.
            std::thread::spawn(move || while stream.write_all(frames.as_bytes()).is_ok() {});
        }
        let (mut time_us, mut bits, mut forged) = ([None, None], 0.0, 0);
        for element in BufReader::new(observer).split(b'>') {
            let element = String::from_utf8(element?)?;
            let words: Vec<&str> = element.split_whitespace().collect();
            let [_, "frame", id, at_s, data] = words[..] else { continue };
            let at_us = 1e6 * at_s.parse::<f64>()?;
            // From the end of the first frame; without stuffing.
            if time_us[0].is_some() {
                bits += 47.0 + 4.0 * data.len() as f64;
            }
            time_us = [time_us[0].or(Some(at_us)), Some(at_us)];
            forged += u32::from(id == "7F0");
            if forged == 2000 {
                (&urgent).write_all(b"< send 001 1 0 >")?;
            }
            if forged >= 2000 && id == "001" {
                break;
            }
            assert!(forged < 4000, "a frame of the highest priority waits behind {forged}");
        }
        let passed_us = time_us[1].unwrap_or(0.0) - time_us[0].unwrap_or(0.0);
        // A bit takes a microsecond; those that are stuffed are not counted.
        assert!((0.6..=1.0).contains(&(bits / passed_us)), "{bits} bits in {passed_us} us");
        let measured = emulation.end();
        assert_eq!(measured["dropped_frames"], 0, "{measured}");
        Ok(())
    }

    fn stranger() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let options = format!("--opening 3 --object-width-mm 40 {SLOW}");
        let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, &options);
        emulation.allow_delays(&dir);
        let mut stranger = TcpStream::connect(&emulation.can)?;
        stranger.write_all(b"< open can0 >")?;
        // Messages of the gripper's number: heartbeats of another version and of a fault, and, once it holds, between all of the
        // gripper's own, those of other states and refusals of the command.
        let [holds, refuses] = [false; 2].map(|is| Arc::new(AtomicBool::new(is)));
        let (is_held, is_refused) = (holds.clone(), refuses.clone());
        std::thread::spawn(move || {
            let own = PROTOCOL_VERSION.0;
            let beat = |protocol_major, state: u8| {
                Message::Heartbeat(Heartbeat { protocol_major, state, ..Heartbeat::default() })
            };
            let of_task = |task| state_code(PowerState::Enabled, task);
            let refusal = CommandRefusal {
                mode: mode::GRIP,
                reason: RefusalReason::Gripping,
                state: of_task(TaskState::HoldActive),
            };
            let forged = [
                beat(own + 1, PowerState::Safe as u8),
                beat(own, PowerState::Fault as u8),
                beat(own, of_task(TaskState::NoObject)),
                beat(own, of_task(TaskState::Lost)),
                Message::ServiceReply(refusal.reply()),
            ];
            for (number, message) in forged.into_iter().enumerate().cycle() {
                let holds = is_held.load(Ordering::Relaxed);
                let refuses = is_refused.load(Ordering::Relaxed);
                let is_refusal = matches!(message, Message::ServiceReply(_));
                if (refuses && !is_refusal) || (number > 1 && !holds) {
                    continue;
                }
                // A refusal comes before the fingers have closed.
                let [count, pause_ms] = match (holds, refuses) {
                    (_, true) => [1, 20],
                    (true, _) => [2, 70],
                    (false, _) => [1, 700],
                };
                let bytes = message.to_bytes().map(|byte| format!("{byte:02X} "));
                let id = frame_id(DEFAULT_NODE, message.number());
                let frame = format!("< send {id:03X} 8 {}>", bytes.concat());
                if stranger.write_all(frame.repeat(count).as_bytes()).is_err() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(pause_ms as u64));
            }
        });
        let line =
            format!("grasp --can {} --home --force 60 --seconds 4 --json-lines", emulation.can);
        let mut grasp = dir.command(&line).stdout(Stdio::piped()).spawn()?;
        let (mut result, mut held) = (Value::Null, 0);
        for line in BufReader::new(grasp.stdout.take().unwrap()).lines() {
            result = serde_json::from_str(&line?)?;
            held += u32::from(result["state"] == "hold active" && result["event"] == "point");
            holds.store(held > 0, Ordering::Relaxed);
        }
        assert!(held > 5 && result["code"] == "reached", "{held}: {result}");
        assert!(grasp.wait()?.success());
        // What does not hold yet is ended by a refusal.
        refuses.store(true, Ordering::Relaxed);
        let line = format!("grasp --can {} --force 60 --seconds 4 --json", emulation.can);
        let output = dir.run(&line);
        let outcome: Value = serde_json::from_slice(&output.stdout)?;
        assert_eq!(outcome["result"]["code"], "refused", "{outcome}");
        emulation.end();
        Ok(())
    }

    fn grip() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let options = format!("--opening 3 --object-width-mm 40 {SLOW}");
        let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, &options);
        emulation.allow_delays(&dir);
        let unhomed = dir.failure(&format!("grasp --can {} --force 80", emulation.can));
        assert!(unhomed.contains("give --home"), "{unhomed}");
        let line = format!("grasp --can {} --home --force 80 --seconds 2 --json", emulation.can);
        let gripped = dir.json(&line);
        assert_eq!((&gripped["reached"], &gripped["disabled"]), (&true.into(), &true.into()));
        let states: Vec<_> =
            gripped["states"].as_array().unwrap().iter().map(|state| &state["state"]).collect();
        for state in ["armed", "homing", "idle", "hold active"] {
            assert!(states.iter().any(|found| *found == state), "{state}: {states:?}");
        }
        let points = gripped["points"].as_array().unwrap();
        // State and figures come in messages of their own: what is held is the middle of it.
        let held: Vec<_> = points.iter().filter(|point| point["state"] == "hold active").collect();
        let held = held[held.len() / 2];
        assert!((number(&held["force_n"]) - 80.0).abs() < 4.0, "{held}");
        assert!((number(&held["opening_mm"]) - 40.0).abs() < 1.0, "{held}");
        let line = format!("grasp --port {} --position 60 --json", emulation.serial);
        let moved = dir.json(&line);
        assert_eq!(moved["reached"], true, "{moved}");
        let line = format!("grasp --port {} --release 75 --json", emulation.serial);
        let opened = dir.json(&line);
        assert_eq!(opened["reached"], true, "{opened}");
        let last = opened["points"].as_array().unwrap().last().unwrap();
        assert!(number(&last["opening_mm"]) > 70.0, "{last}");
        let stopped = dir.json(&format!("grasp --can {} --stop --json", emulation.can));
        assert_eq!(stopped["stopped"], true, "{stopped}");
        is_clean(&emulation.end());
        Ok(())
    }

    fn tutorial() -> Result<(), Failed> {
        let tutorial = std::fs::read_to_string(folder().join("flash-and-drive.md"))?;
        let dir = WorkDir::empty();
        link_data(&dir);
        let image = path(Variant::Default)?;
        let (mut emulation, mut others) = (None, Vec::new());
        let mut commands = 0;
        for step in steps(&tutorial) {
            let Step::Command { command, arguments, is_background, .. } = step else {
                continue;
            };
            commands += 1;
            let Some(arguments) = arguments else {
                assert_eq!(command, "cargo image");
                continue;
            };
            if arguments[..2] == ["dev", "emulate"] {
                let line = arguments[2..].join(" ").replace("29536", "0");
                let started = Emulation::start(&dir, &image, &format!("{line} {SLOW}"));
                started.allow_delays(&dir);
                emulation = Some(started);
                continue;
            }
            let can = emulation.as_ref().map_or("", |emulation| &emulation.can);
            let arguments: Vec<String> =
                arguments.iter().map(|word| word.replace("127.0.0.1:29536", can)).collect();
            if is_background {
                others.push(Running::start(&dir, &arguments.join(" ")));
            } else {
                let output = dir.run(&arguments);
                assert!(output.status.success(), "{command}: {}", text(&output.stderr));
            }
        }
        assert!(commands >= 8, "{commands}");
        drop(others);
        let mut measured = emulation.expect("an emulation").end();
        // The upload ends with a reboot.
        let resets = measured["resets"].take();
        let causes: Vec<_> =
            resets.as_array().unwrap().iter().map(|reset| &reset["cause"]).collect();
        assert_eq!(causes, ["software"]);
        measured["resets"] = Value::Array(Vec::new());
        // To a board at half speed its chunks come twice as fast; it drops some, which are repeated.
        if let Some(faults) = measured["faults"].as_array_mut() {
            faults.retain(|fault| fault["code"] != Fault::Flooded as u16);
        }
        is_clean(&measured);
        Ok(())
    }

    fn record() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let emulation = Emulation::start(&dir, &path(Variant::Default)?, "--json");
        let line = format!("record --port {} -o campaign/1 --seconds 3 --json", emulation.serial);
        let recorded = dir.json(&line);
        // Less than three seconds where this machine is slower than the chip.
        assert!(recorded["rows"].as_u64() > Some(200), "{recorded}");
        assert_eq!(recorded["lost_rows"], 0, "{recorded}");
        assert_eq!(recorded["sensors"], serde_json::json!([0, 1, 2, 3]));
        is_clean(&emulation.end());
        Ok(())
    }

    fn workbench() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, "--json");
        let before = dir.json(&format!("board --port {} --json", emulation.serial));
        let line = format!("{} --port {}", campaign("friction"), emulation.serial);
        let served = Served::start(&dir, &line);
        let live = || served.ask("live", &serde_json::json!({})).1;
        let recorded = serde_json::json!({ "output": "planned-1", "plan": null, "seconds": 1.0 });
        assert_eq!(served.ask("record", &recorded).0, 200);
        while live()["recording"]["goes_on"] == true {
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        assert!(dir.path("planned-1").exists(), "{}", live());
        let request = serde_json::json!({
            "effects": ["magnet_temperature", "hysteresis"], "formulas": [], "kind": "board", "path": "",
        });
        // The page asks for the forces meanwhile.
        let ended = AtomicBool::new(false);
        let (status, answer) = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !ended.load(Ordering::Relaxed) {
                    // The page stops asking after an end.
                    assert!(live()["ended"].is_null(), "{}", live());
                }
            });
            let answer = served.ask("write", &request);
            ended.store(true, Ordering::Relaxed);
            answer
        });
        assert_eq!(status, 200, "{answer}");
        assert!(answer["message"].as_str().unwrap().contains("runs on the gripper"), "{answer}");
        // The gripper is watched again.
        while live()["state"]["ticks_hz"].as_u64() <= Some(0) {
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        drop(served);
        let after = dir.json(&format!("board --port {} --json", emulation.serial));
        let effects = serde_json::json!(["magnet_temperature", "hysteresis"]);
        assert_ne!(before["calibration"]["effects"], effects, "{before}");
        assert_eq!(after["calibration"]["effects"], effects, "{after}");
        drop(emulation);
        Ok(())
    }

    fn identification() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let image = path(Variant::Nominal)?;
        let emulation =
            Emulation::start(&dir, &image, &format!("--opening 3 --object-width-mm 40 {SLOW}"));
        emulation.allow_delays(&dir);
        let port = format!("--port {}", emulation.serial);
        // The object is between the fingers once they are open.
        dir.json(&format!("grasp {port} --home --position 50 --json"));
        let found = dir.json(&format!("board identify motor {port} --save --json"));
        let value = |name: &str| {
            let rows = found["motor"].as_array().unwrap();
            number(&rows.iter().find(|row| row["name"] == name).unwrap()["value"])
        };
        let resistance_ohm = constants::PHASE_RESISTANCE.value;
        assert!((value("phase resistance") / resistance_ohm - 1.0).abs() < 0.05, "{found}");
        assert_eq!(value("pole pairs"), constants::POLE_PAIRS.value, "{found}");
        let found = dir.json(&format!("board identify screw --can {} --json", emulation.can));
        assert_eq!((&found["screw"], &found["saved"]), (&"self-locking".into(), &false.into()));
        let board = dir.json(&format!("board {port} --json"));
        assert_eq!(
            (&board["motor"], &board["screw"]),
            (&"measured".into(), &"self-locking".into())
        );
        let line = format!("board parameter command_timeout 200 {port} --save --json");
        assert_eq!(dir.json(&line)["parameters"][0]["value"], 200);
        let all = dir.json(&format!("board parameter --can {} --json", emulation.can));
        assert!(all["parameters"].as_array().unwrap().len() > 20, "{all}");
        let message = dir.failure(&format!("board parameter command_timeout 9999 {port}"));
        assert!(message.contains("20 to 500"), "{message}");
        // A latched stop is shown, and prevents a measurement.
        dir.json(&format!("grasp {port} --stop --json"));
        let board = dir.json(&format!("board {port} --json"));
        assert_eq!((&board["state"], &board["stopped"]), (&"safe".into(), &true.into()));
        for (line, reason) in [
            (format!("board identify motor {port}"), "a stop is latched"),
            (format!("grasp {port} --release"), "a stop is latched"),
        ] {
            let message = dir.failure(&line);
            assert!(message.contains(reason), "{line}: {message}");
        }
        is_clean(&emulation.end());
        let emulation = Emulation::start(&dir, &image, &format!("--opening 50 {SLOW}"));
        emulation.allow_delays(&dir);
        let message = dir.failure(&format!("board identify screw --port {}", emulation.serial));
        assert!(message.contains("nothing was gripped"), "{message}");
        is_clean(&emulation.end());
        Ok(())
    }

    fn keys() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let emulation = Emulation::start(&dir, &path(Variant::Nominal)?, "--json");
        let port = format!("--port {}", emulation.serial);
        dir.json("board key new key.txt --json");
        dir.json("board key new other.txt --json");
        assert_eq!(dir.json(&format!("board {port} --json"))["unprotected"], true);
        dir.json(&format!("board key write key.txt {port} --json"));
        assert_eq!(dir.json(&format!("board {port} --json"))["unprotected"], false);
        for (line, reason) in [
            (format!("board tare {port}"), "another key"),
            (format!("board tare {port} --key other.txt"), "another key"),
            (format!("grasp {port} --release"), "another key"),
            (format!("board key erase {port}"), "the gripper has a key"),
            (format!("board key write other.txt {port} --key other.txt"), "another key"),
            (
                format!("board key erase --can {} --key key.txt", emulation.can),
                "never sent over a bus",
            ),
        ] {
            let message = dir.failure(&line);
            assert!(message.contains(reason), "{line}: {message}");
        }
        dir.json(&format!("board tare {port} --key key.txt --json"));
        dir.json(&format!("grasp {port} --stop --json"));
        dir.json(&format!("board key write other.txt {port} --key key.txt --json"));
        dir.json(&format!("board key erase {port} --key other.txt --json"));
        assert_eq!(dir.json(&format!("board {port} --json"))["unprotected"], true);
        let mut measured = emulation.end();
        // On a slow machine the requests that it refuses come often enough, in its time, to be reported.
        if let Some(faults) = measured["faults"].as_array_mut() {
            faults.retain(|fault| fault["code"] != Fault::StrangeFrames as u16);
        }
        is_clean(&measured);
        Ok(())
    }

    fn flash_file() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let image = path(Variant::Default)?;
        let line = |options: &str, emulation: &Emulation| {
            dir.json(&format!(
                "board parameter command_timeout {options} --port {} --json",
                emulation.serial
            ))
        };
        let emulation = Emulation::start(&dir, &image, "--flash board.flash --json");
        line("300 --save", &emulation);
        is_clean(&emulation.end());
        let emulation = Emulation::start(&dir, &image, "--flash board.flash --json");
        assert_eq!(line("", &emulation)["parameters"][0]["value"], 300);
        is_clean(&emulation.end());
        std::fs::write(dir.path("notes.txt"), "not a flash memory")?;
        let message = dir.failure(&format!("dev emulate {image} --flash notes.txt --seconds 1"));
        assert!(message.contains("notes.txt"), "{message}");
        assert_eq!(dir.read("notes.txt"), "not a flash memory");
        Ok(())
    }

    fn refused() -> Result<(), Failed> {
        let dir = WorkDir::empty();
        let message = dir.failure("dev emulate");
        assert!(message.contains("cargo image"), "{message}");
        std::fs::write(dir.0.path().join("text.elf"), "no image")?;
        let message = dir.failure("dev emulate text.elf");
        assert!(message.contains("not an ELF file"), "{message}");
        if cfg!(target_os = "linux") {
            let image = path(Variant::Default)?;
            let message = dir.failure(&format!("dev emulate {image} --can nowhere0"));
            assert!(message.contains("there is no such CAN bus"), "{message}");
        }
        Ok(())
    }
}
