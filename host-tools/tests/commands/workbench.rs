//! `magpie workbench`: what its server answers, and whom it refuses.

use std::io::Write;
use std::net::TcpListener;
use std::time::{Duration, Instant};

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
