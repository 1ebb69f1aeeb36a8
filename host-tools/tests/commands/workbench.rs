//! `magpie workbench`: what its server answers, and whom it refuses.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use analysis::edit_model::parse_formulas;
use analysis::workbench::Workbench;
use model_export::fit::FitOptions;
use model_export::recordings::Recording;
use model_export::recordings::align::Alignment;
use serde_json::{Value, json};
use tests::campaign_copy::CampaignCopy;

use crate::workdir::served::Served;
use crate::workdir::{WorkDir, campaign};

#[test]
fn only_the_printed_address_is_answered() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let Served { host, token, .. } = &served;
    assert!(host.starts_with("127.0.0.1:"), "{host}");
    let own = format!("host: {host}\r\n");
    let page = format!("GET /?token={token}");
    assert_eq!(served.request(&page, &own, "").0, 200);
    let other_token = "0".repeat(token.len());
    for (line, headers) in [
        ("GET /".to_owned(), own.clone()),
        (format!("GET /?token={other_token}"), own.clone()),
        // A page under a name that resolves to this machine.
        (page, "host: example.org\r\n".to_owned()),
        ("POST /model".to_owned(), own.clone()),
        (format!("POST /model?token={token}"), own.clone()),
        ("POST /write".to_owned(), format!("{own}x-token: {other_token}\r\n")),
    ] {
        assert_eq!(served.request(&line, &headers, "{}").0, 403, "{line} {headers}");
    }
}

#[test]
fn models_are_fitted_compared_and_written() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let base = json!({ "effects": [], "formulas": [] });
    let (status, state) = served.ask("model", &base);
    assert_eq!(status, 200, "{state}");
    let error = |state: &Value| state["force"]["excess_n"].as_f64().unwrap();
    assert!(error(&state) > 2.0, "{}", state["force"]);
    let candidates = state["candidates"].as_array().unwrap();
    let is_found = |name: &str| {
        candidates.iter().any(|one| one["name"] == name && one["is_significant"] == true)
    };
    assert!(is_found("hysteresis") && is_found("magnet_temperature"), "{candidates:?}");

    let better = json!({ "effects": ["magnet_temperature", "hysteresis"], "formulas": [], "baseline": base });
    let (_, state) = served.ask("model", &better);
    assert!(error(&state) < 0.2, "{}", state["force"]);
    assert!(state["baseline_force"]["excess_n"].as_f64().unwrap() > 2.0);
    assert_eq!(state["present"].as_array().unwrap().len(), 2);
    assert!(state["view"].as_str().unwrap().contains("id=\"overlay\""));

    let write = |kind: &str, path: &str| {
        let mut request = better.clone();
        request["kind"] = json!(kind);
        request["path"] = json!(path);
        served.ask("write", &request)
    };
    assert_eq!(write("model", "better.toml").0, 200);
    assert_eq!(write("tables", "tables.rs").0, 200);
    assert_eq!(write("report", "report.html").0, 200);
    // What it shows is what the commands show.
    let replayed = dir.json(&format!("replay better.toml {} --json", campaign("friction")));
    assert_eq!(replayed["sensors"].as_array().unwrap().len(), 4);
    assert!(dir.read("tables.rs").contains("static SENSORS"));
    assert!(dir.read("report.html").contains("Measured and modelled over time"));
    std::fs::write(dir.path("mine"), "text").unwrap();
    let (status, answer) = write("report", "mine");
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("not overwritten"), "{answer}");
    assert_eq!(dir.read("mine"), "text");
}

#[test]
fn formulas_are_fitted_and_errors_name_their_place() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("ripple"));
    let with =
        |formula: &str| served.ask("model", &json!({ "effects": [], "formulas": [formula] }));
    let (status, state) = with("own: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)");
    assert_eq!(status, 200, "{state}");
    assert!(state["force"]["excess_n"].as_f64().unwrap() < 0.3, "{}", state["force"]);
    // Another formula of the same name, and the same formula with another range, are other models.
    let wave = "own: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";
    for (range, is_good) in [("p=2..5", true), ("p=50..60", false)] {
        let (status, state) = with(&format!("{wave}; {range}"));
        assert_eq!(status, 200, "{state}");
        assert_eq!(state["present"][0]["formula"], wave);
        let add = state["commands"][1].as_str().unwrap();
        assert!(
            add.contains(&format!("--range {range}"))
                || add.contains(&format!("--range '{range}'")),
            "{add}"
        );
        let excess_n = state["force"]["excess_n"].as_f64().unwrap();
        assert_eq!(excess_n < 0.5, is_good, "{range}: {}", state["force"]);
    }
    for (formula, expected) in [
        ("own: dz_um = a*motor_angel_rad", "did you mean motor_angle_rad"),
        ("own: z = a*opening_mm", "is not a target"),
        ("own: dz_um = a*opening_mm; p=2", "write NAME=FROM..TO"),
    ] {
        let (status, answer) = with(formula);
        assert_eq!(status, 422, "{formula}");
        assert!(answer["error"].as_str().unwrap().contains(expected), "{formula}: {answer}");
    }
    let (status, answer) =
        served.ask("model", &json!({ "effects": ["hysterisis"], "formulas": [] }));
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("hysteresis"), "{answer}");
    // It goes on after errors.
    assert_eq!(served.ask("names", &json!({})).1["targets"][0], "fx_n");
}

#[test]
fn diagnosis_scatter_and_reading_again_are_answered() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let base = json!({ "effects": [], "formulas": [] });
    let request = json!({ "effects": [], "formulas": [], "plans": false });
    let (status, found) = served.ask("diagnose", &request);
    assert_eq!(status, 200, "{found}");
    let steps = found["steps"].as_array().unwrap();
    let is_found = steps.iter().any(|step| step.as_array().unwrap().contains(&json!("hysteresis")));
    assert!(is_found, "{found}");
    let evidence = found["evidence"]["hysteresis"].as_str().unwrap();
    assert!(
        evidence.contains(" N, friction force") && evidence.contains(" %, p 0.0"),
        "{evidence}"
    );
    assert_eq!(found["plan"], Value::Null);

    let scatter = |covariate: &str| {
        let interval = json!({ "recording": "3", "sensor": 1, "axis": 0, "from": 2.0, "to": 4.5 });
        let request = json!({ "choice": base, "covariate": covariate, "interval": interval });
        served.ask("scatter", &request)
    };
    let (status, drawn) = scatter("fx_n");
    assert_eq!(status, 200, "{drawn}");
    // 2.5 s at 100 Hz.
    let plot = drawn["plot"].as_str().unwrap();
    assert!(plot.contains("of which 250 are") || plot.contains("of which 251 are"), "{plot}");
    assert_eq!(scatter("no_such_mm").0, 422);
    assert_eq!(served.ask("reload", &json!({})).0, 200);
    assert_eq!(served.ask("model", &base).0, 200);
}

#[test]
fn plan_of_the_next_recording_is_written() {
    let dir = WorkDir::empty();
    let simulate = "simulate --programme level --effect earth_field --seconds 8 --sensors 1";
    dir.stdout(&format!("{simulate} -o level"));
    let served = Served::start(&dir, "level");
    let write = json!({ "effects": [], "formulas": [], "kind": "plan", "path": "plan.toml" });
    let (status, answer) = served.ask("write", &write);
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("there is no plan yet"), "{answer}");
    let request = json!({ "effects": [], "formulas": [], "plans": true });
    let (status, found) = served.ask("diagnose", &request);
    assert_eq!(status, 200, "{found}");
    assert!(found["plan"].as_str().unwrap().contains("earth_field"), "{found}");
    let (status, answer) = served.ask("write", &write);
    assert_eq!(status, 200, "{answer}");
    let message = answer["message"].as_str().unwrap();
    assert!(message.contains("record --port PATH --plan plan.toml"), "{answer}");
    dir.stdout(&format!("{simulate} -o longer --plan plan.toml"));
}

#[test]
fn tables_of_an_effect_that_no_board_compensates_are_refused() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("demo"));
    let effects = ["neighbour_magnet", "screw_backlash"];
    let request =
        json!({ "effects": effects, "formulas": [], "kind": "tables", "path": "tables.rs" });
    let (status, answer) = served.ask("write", &request);
    assert_eq!(status, 422);
    let error = answer["error"].as_str().unwrap();
    assert!(error.contains("never compensates screw_backlash"), "{answer}");
    assert!(!dir.path("tables.rs").exists());
}

#[test]
fn setup_errors_are_named() {
    let spoilt = CampaignCopy::new().change(&[1, 2, 3], "force.csv", |table| {
        table.exchange("f0_x_n", "f0_z_n");
    });
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &spoilt.path().display().to_string());
    let (status, answer) = served.ask("model", &json!({ "effects": [], "formulas": [] }));
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("swapped"), "{answer}");
}

#[test]
fn removed_campaign_is_an_error_and_not_the_end() {
    let dir = WorkDir::empty();
    dir.stdout("simulate -o bench --seconds 5 --sensors 1");
    let served = Served::start(&dir, "bench");
    assert_eq!(served.ask("model", &json!({ "effects": [], "formulas": [] })).0, 200);
    std::fs::rename(dir.path("bench"), dir.path("away")).unwrap();
    let hysteresis = json!({ "effects": ["hysteresis"], "formulas": [] });
    let (status, answer) = served.ask("model", &hysteresis);
    assert_eq!(status, 422);
    assert!(answer["error"].as_str().unwrap().contains("bench"), "{answer}");
    std::fs::rename(dir.path("away"), dir.path("bench")).unwrap();
    assert_eq!(served.ask("model", &hysteresis).0, 200);
    let message = dir.failure("workbench nowhere");
    assert!(message.contains("nowhere"), "{message}");
}

#[test]
fn forces_of_a_reference_are_shown_next_to_the_estimates() {
    let dir = WorkDir::empty();
    let map = "columns = [{ column = 1, unit = \"N\", to = \"f0_x_n\" }, { column = 2, unit = \"kN\", to = \"f2_z_n\" }]";
    std::fs::write(dir.path("map.toml"), map).unwrap();
    let reference = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = reference.local_addr().unwrap().port();
    let writer = std::thread::spawn(move || {
        let mut stream = reference.accept().unwrap().0;
        // Until the server ends.
        while stream.write_all(b"12.5 -0.25\n").is_ok() {
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    let options = format!("--virtual --reference tcp:127.0.0.1:{port} --reference-map map.toml");
    let served = Served::start(&dir, &format!("{} {options}", campaign("demo")));
    let begun = Instant::now();
    let shown = loop {
        let (status, live) = served.ask("live", &json!({}));
        assert_eq!(status, 200, "{live}");
        if !live["reference"]["forces"].as_array().unwrap().is_empty() {
            break live["reference"].clone();
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "{live}");
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(
        shown,
        json!({ "error": null, "forces": [
            { "sensor": 0, "axis": "x", "newtons": 12.5 }, { "sensor": 2, "axis": "z", "newtons": -250.0 },
        ] })
    );
    drop(served);
    writer.join().unwrap();
}

/// Reads until the server closes the connection, or for a minute.
fn rest(mut stream: &TcpStream) -> String {
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        // Closed with unread bytes.
        Err(error) if error.kind() == ErrorKind::ConnectionReset => {}
        result => drop(result.expect("the connection is still open after a minute")),
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn descriptors(served: &Served) -> usize {
    std::fs::read_dir(format!("/proc/{}/fd", served.id())).unwrap().count()
}

#[test]
fn half_open_connections_keep_nobody_out() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let before = descriptors(&served);
    let open = |number: usize| {
        let mut stream = TcpStream::connect(&served.host).unwrap();
        // Refused connections may be closed already.
        let _ = stream.write_all(&b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\nx"[..number % 35]);
        stream
    };
    let mut streams: Vec<TcpStream> = (0..300).map(open).collect();
    assert!(descriptors(&served) <= before + 70, "{} descriptors", descriptors(&served));
    // One of those that wait goes on, too slowly.
    let slow = streams[299].try_clone().unwrap();
    std::thread::spawn(move || {
        while (&slow).write_all(b"x").is_ok() {
            std::thread::sleep(Duration::from_millis(500));
        }
    });
    // A new one for each that is closed.
    let has_ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (has_ended, open) = (&has_ended, &open);
        let stranger = scope.spawn(move || {
            let mut opened = 0;
            while !has_ended.load(Relaxed) {
                for stream in &mut streams {
                    // A connection is opened slowly where many wait.
                    if has_ended.load(Relaxed) {
                        break;
                    }
                    stream.set_nonblocking(true).unwrap();
                    let read = stream.read(&mut [0; 256]);
                    if !read.is_err_and(|error| error.kind() == ErrorKind::WouldBlock) {
                        *stream = open(opened);
                        opened += 1;
                    }
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            opened
        });
        let page = format!("GET /?token={}", served.token);
        for _ in 0..20 {
            assert_eq!(served.status(&page), Some(200));
            std::thread::sleep(Duration::from_millis(50));
        }
        has_ended.store(true, Relaxed);
        assert!(stranger.join().unwrap() > 20);
    });
    // What is left runs into the time-out.
    let begun = Instant::now();
    while descriptors(&served) > before + 6 {
        assert!(begun.elapsed() < Duration::from_secs(60), "{} descriptors", descriptors(&served));
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn endless_requests_are_ended() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let own = format!("host: {}\r\nx-token: {}\r\n", served.host, served.token);
    let json = "content-type: application/json\r\n";
    let chunks =
        "10000\r\n".to_owned() + &"x".repeat(0x10000) + "\r\n10000\r\n" + &"x".repeat(0x10000);
    for (request, expected) in [
        (format!("POST /names HTTP/1.1\r\n{own}{json}content-length: 10\r\n\r\n{{"), "408"),
        (
            format!(
                "POST /names HTTP/1.1\r\n{own}{json}transfer-encoding: chunked\r\n\r\n1\r\n{{\r\n"
            ),
            "408",
        ),
        (
            format!(
                "POST /names HTTP/1.1\r\n{own}{json}transfer-encoding: chunked\r\n\r\n{chunks}"
            ),
            "413",
        ),
        (
            format!(
                "POST /names HTTP/1.1\r\n{own}{json}content-length: 99999999999\r\n\r\n{chunks}"
            ),
            "413",
        ),
        // A body that nobody reads.
        (format!("POST /names HTTP/1.1\r\n{json}content-length: 10\r\n\r\n{{"), "403"),
        (format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(20_000)), "431"),
        (format!("GET /{} HTTP/1.1\r\n\r\n", "x".repeat(1 << 20)), "431"),
    ] {
        let stream = TcpStream::connect(&served.host).unwrap();
        // Who is refused early cannot write all of it.
        let _ = (&stream).write_all(request.as_bytes());
        let said = rest(&stream);
        let status = said.split(' ').nth(1).unwrap_or("closed");
        // What was sent and not read may end the connection before the answer is read.
        let is_long = request.len() > 100_000;
        assert!(status == expected || is_long && said.is_empty(), "{:.80}: {said:.200}", request);
    }
    assert_eq!(served.ask("names", &json!({})).0, 200);
}

#[test]
fn scripts_have_the_number_of_the_page() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &campaign("friction"));
    let numbers = [(); 2].map(|()| {
        let stream = TcpStream::connect(&served.host).unwrap();
        let Served { host, token, .. } = &served;
        let request =
            format!("GET /?token={token} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
        (&stream).write_all(request.as_bytes()).unwrap();
        let said = rest(&stream);
        let (head, page) = said.split_once("\r\n\r\n").unwrap();
        let policy = head.lines().find_map(|line| line.strip_prefix("content-security-policy: "));
        let parts: Vec<&str> = policy.unwrap().split("; ").collect();
        for part in [
            "default-src 'none'",
            "base-uri 'none'",
            "frame-ancestors 'none'",
            "form-action 'none'",
        ] {
            assert!(parts.contains(&part), "{head}");
        }
        let number = parts.iter().find_map(|part| part.strip_prefix("script-src 'nonce-")).unwrap();
        let number = number.strip_suffix('\'').unwrap().to_owned();
        assert!(number.len() >= 22, "{number}");
        let scripts = page
            .split("<script")
            .skip(1)
            .filter(|script| !script.starts_with(" type=\"text/plain\""));
        assert!(scripts.clone().count() > 0);
        assert!(
            scripts.into_iter().all(|script| script.starts_with(&format!(" nonce=\"{number}\""))),
            "{page}"
        );
        number
    });
    assert_ne!(numbers[0], numbers[1]);
}

/// A request of the page whose answer is not waited for.
fn begin(served: &Served, path: &str, body: &Value) -> TcpStream {
    let (stream, body) = (TcpStream::connect(&served.host).unwrap(), body.to_string());
    let Served { host, token, .. } = served;
    let request = format!(
        "POST /{path} HTTP/1.1\r\nhost: {host}\r\nx-token: {token}\r\ncontent-type: application/json\r\n\
         content-length: {}\r\nconnection: close\r\n\r\n{body}",
        body.len()
    );
    (&stream).write_all(request.as_bytes()).unwrap();
    stream
}

#[test]
fn a_long_computation_is_cancelled_and_blocks_nobody() {
    let dir = WorkDir::empty();
    // Its diagnosis takes half a minute.
    let effects = "--effect hysteresis --effect magnet_temperature --effect screw_backlash";
    dir.stdout(&format!("simulate {effects} --seconds 60 --sensors 2 -o long"));
    let served = Served::start(&dir, "long");
    let base = json!({ "effects": [], "formulas": [] });
    let within = |begun: Instant, what: &str| {
        assert!(begun.elapsed() < Duration::from_secs(20), "{what}: {:?}", begun.elapsed());
    };
    let cancel = || {
        let begun = Instant::now();
        while served.ask("cancel", &json!({})).1["cancelled"] != true {
            within(begun, "nothing is computed");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let status = |stream: &TcpStream| rest(stream).split(' ').nth(1).unwrap().to_owned();
    // Before the base was fitted.
    let first = begin(&served, "model", &base);
    cancel();
    let begun = Instant::now();
    assert_eq!(status(&first), "409");
    within(begun, "fit");
    assert_eq!(served.ask("model", &base).0, 200);
    let plan = json!({ "effects": [], "formulas": [], "plans": true });
    let long = begin(&served, "diagnose", &plan);
    std::thread::sleep(Duration::from_millis(500));
    // Others are served meanwhile, and two computations at once are answered clearly.
    let begun = Instant::now();
    assert_eq!(served.ask("names", &json!({})).0, 200);
    assert_eq!(served.ask("model", &base).0, 200);
    assert_eq!(served.status(&format!("GET /?token={}", served.token)), Some(200));
    let (code, answer) = served.ask("model", &json!({ "effects": ["hysteresis"], "formulas": [] }));
    assert_eq!(code, 409, "{answer}");
    assert!(answer["error"].as_str().unwrap().contains("wait until it is done, or cancel it"));
    within(begun, "others");
    cancel();
    assert_eq!(status(&long), "409");
    within(begun, "diagnosis");
    assert_eq!(served.ask("cancel", &json!({})).1["cancelled"], false);
    // Of a client that is gone.
    drop(begin(&served, "diagnose", &plan));
    let begun = Instant::now();
    while served.ask("model", &json!({ "effects": ["hysteresis"], "formulas": [] })).0 == 409 {
        within(begun, "the computation of a client that is gone");
    }
}

#[test]
fn models_that_nobody_uses_are_dropped() {
    let dir = WorkDir::empty();
    dir.stdout("simulate -o bench --seconds 3 --recordings 2 --sensors 1");
    let alignment = Alignment { delay_us: 0.0 };
    let bench = Workbench::open(&dir.path("bench"), alignment, FitOptions::default());
    let bench = bench.unwrap().unwrap();
    let terms = |number: usize| {
        parse_formulas(&[format!("own: dz_um = a*fx_n/{}", number + 1)], &[], &[]).unwrap()
    };
    let is_kept = |number: usize| bench.fitted(&terms(number), &[]).is_some();
    for number in 0..40 {
        bench.fit_model(&terms(number), &[]).unwrap();
        // It is compared with all others.
        assert!(is_kept(0), "{number}");
    }
    assert_eq!(
        (1..40).filter(|number| is_kept(*number)).collect::<Vec<_>>(),
        (9..40).collect::<Vec<_>>()
    );
}

#[test]
fn recording_ends_with_the_workbench() {
    let dir = WorkDir::empty();
    let served = Served::start(&dir, &format!("{} --virtual", campaign("demo")));
    for seconds in [json!(0), json!(-5), json!(0.5), json!(1e9), json!(null)] {
        let request = json!({ "output": "never", "plan": null, "seconds": seconds });
        let (status, answer) = served.ask("record", &request);
        assert_eq!(status, 422, "{seconds}: {answer}");
        let error = answer["error"].as_str().unwrap();
        assert!(error.contains("1 to 36000 seconds"), "{error}");
    }
    assert!(!dir.path("never").exists());
    let children = || -> Vec<u32> {
        let id = served.id();
        let tasks = std::fs::read_dir(format!("/proc/{id}/task")).unwrap();
        let of = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("children"));
        let all: String = tasks.map(|task| of(task.unwrap()).unwrap_or_default()).collect();
        all.split_whitespace().map(|child| child.parse().unwrap()).collect()
    };
    let runs = |process: u32| {
        let state = std::fs::read_to_string(format!("/proc/{process}/stat"));
        state.is_ok_and(|state| !state.rsplit(") ").next().unwrap().starts_with('Z'))
    };
    let until = |what: &str, is_so: &dyn Fn() -> bool| {
        let begun = Instant::now();
        while !is_so() {
            assert!(begun.elapsed() < Duration::from_secs(60), "{what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    let record = |output: &str| {
        let request = json!({ "output": output, "plan": null, "seconds": 3600 });
        let (status, answer) = served.ask("record", &request);
        assert_eq!(status, 200, "{answer}");
        let table = dir.path(&format!("{output}/hall.csv"));
        until("no rows", &|| table.metadata().is_ok_and(|of| of.len() > 20_000));
    };
    record("first");
    assert_eq!(served.ask("end-recording", &json!({})).0, 200);
    until("it does not end", &|| served.ask("live", &json!({})).1["recording"]["goes_on"] == false);
    // Its number may be that of another process by now.
    let (status, answer) = served.ask("end-recording", &json!({}));
    assert_eq!((status, answer["error"].as_str()), (422, Some("the recording has ended")));
    record("second");
    let children = children();
    assert_eq!(children.len(), 1);
    served.kill();
    until("the recording survives", &|| children.iter().all(|child| !runs(*child)));
    for name in ["first", "second"] {
        let recording = Recording::read(&dir.path(name), Alignment { delay_us: 0.0 });
        assert!(recording.unwrap().span_s() > 0.1, "{name}");
    }
}
