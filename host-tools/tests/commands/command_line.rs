//! The command line: exit codes, output formats, error messages, reproducibility.

use std::collections::BTreeSet;
use std::fs;

use device::control::result_code::ResultCode;
use serde_json::Value;
use tests::campaign_copy::CampaignCopy;
use tests::{data, real_data};

use crate::generated_text::assert_generated;
use crate::workdir::{WorkDir, campaign, text};

#[test]
fn fit_json_has_axes_and_parameters() {
    let json = WorkDir::empty().json(&["fit", &campaign("clean"), "--json"]);
    let axes = json["axes"].as_array().unwrap();
    assert_eq!(axes.len(), 12);
    assert_eq!((&axes[4]["sensor"], &axes[4]["axis"]), (&1.into(), &"y".into()));
    assert!(
        axes.iter().all(|axis| axis["held_out_rms_g"].as_f64() > Some(0.0)
            && axis["floor_g"].as_f64() > Some(0.0))
    );
    let parameters = json["parameters"].as_array().unwrap();
    assert_eq!(parameters.len(), 4 * 14);
    let stiffness =
        parameters.iter().find(|p| p["name"] == "stiffness_x" && p["sensor"] == 0).unwrap();
    assert_eq!(stiffness["unit"], "N/mm");
    assert_eq!(stiffness["identifiable"], true);
    assert!((stiffness["value"].as_f64().unwrap() - 501.1).abs() < 1.5, "{stiffness}");
    assert!(stiffness["std_error"].as_f64().unwrap() < 1.0);
}

#[test]
fn equal_seeds_give_identical_models() {
    let dir = WorkDir::empty();
    let models = ["a.toml", "b.toml"].map(|model| {
        let report = text(&dir.stdout(&["fit", &campaign("clean"), "-o", model]));
        assert!(report.contains("At the noise floor"), "{report}");
        for line in report.lines() {
            assert!(line.chars().count() <= 100, "{line}");
        }
        dir.read(model)
    });
    assert_eq!(models[0], models[1]);
}

#[test]
fn error_is_one_line_on_stderr_with_exit_code_1() {
    let output = WorkDir::empty().run("fit no-such-campaign --json");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(output.stdout, b"");
    let message = text(&output.stderr);
    assert!(message.starts_with("magpie: no-such-campaign: cannot be read: "), "{message}");
    assert_eq!(message.lines().count(), 1);
}

#[test]
fn help_of_every_command_has_an_example() {
    let dir = WorkDir::empty();
    let parser = host_tools::commands::parser();
    let mut commands: Vec<(String, &clap::Command)> = vec![(String::new(), &parser)];
    let mut tested = 0;
    while let Some((path, command)) = commands.pop() {
        for inner in command.get_subcommands() {
            commands.push((format!("{path}{} ", inner.get_name()), inner));
        }
        if command.has_subcommands() {
            continue;
        }
        let help = text(&dir.stdout(&format!("{path}--help")));
        let has_example =
            help.contains("Example") && help.contains(&format!("  cargo magpie {path}"));
        assert!(has_example, "{help}");
        tested += 1;
    }
    assert!(tested >= 28, "{tested} commands");
}

#[test]
fn help_lists_every_visible_command() {
    let parser = host_tools::commands::parser();
    let help = text(&WorkDir::empty().stdout("--help"));
    let lines: Vec<&str> = help.lines().filter_map(|line| line.strip_prefix("  ")).collect();
    let mut listed: Vec<&str> =
        lines.iter().filter_map(|line| line.split_whitespace().next()).collect();
    let mut visible: Vec<&str> = parser
        .get_subcommands()
        .filter(|command| !command.is_hide_set())
        .map(clap::Command::get_name)
        .collect();
    listed.sort_unstable();
    visible.sort_unstable();
    assert_eq!(listed, visible);
}

#[test]
fn former_names_answer_with_the_new_place() {
    let dir = WorkDir::empty();
    let answer = |line: &str| text(&dir.run(line).stderr);
    assert!(answer("tare").starts_with("note: `magpie tare` is now `magpie board tare`\n"));
    assert!(answer("fault-campaign").contains("cargo acceptance fault-campaign"));
    let dbc = dir.run("dbc");
    assert_eq!(dbc.stdout, dir.run("dev dbc").stdout);
}

#[test]
fn held_out_replay_error_is_below_one_newton() {
    let dir = WorkDir::empty();
    let two = dir.path("two");
    for name in ["1", "2"] {
        std::fs::create_dir_all(two.join(name)).unwrap();
        for file in ["recording.toml", "hall.csv.gz", "force.csv.gz"] {
            std::fs::copy(data("clean").join(name).join(file), two.join(name).join(file)).unwrap();
        }
    }
    dir.stdout("fit two -o model.toml");
    let json = dir.json(&["replay", "model.toml", &campaign("clean/3"), "--json"]);
    assert_eq!((&json["rows"], &json["recordings"][0]["held_out"]), (&12_001.into(), &true.into()));
    for sensor in json["sensors"].as_array().unwrap() {
        let value = |key: &str| sensor[key].as_f64().unwrap();
        // White noise alone: 0.35 G through 1.17 and 0.73 G/N, and 0.15 N of the reference.
        let (min, max) = if sensor["axis"] == "x" { (0.25, 0.6) } else { (0.40, 0.9) };
        assert!((min..=max).contains(&value("tared_rmse_n")), "{sensor}");
        assert!(value("fixed_minus_float_rms_n") <= 0.1 && value("mean_n").abs() < 0.2, "{sensor}");
        // On clean data the model error is small compared with white noise.
        let ratio = value("tared_rmse_n") / value("noise_n");
        assert!((0.97..1.08).contains(&ratio), "{sensor}");
        let total = value("mean_n").hypot(value("std_n"));
        assert!((total - value("rmse_n")).abs() < 1e-9, "{sensor}");
    }
    // The paper's ideal model (nominal design) has errors of newtons.
    let nominal = json["nominal"].as_array().unwrap();
    assert!(nominal.iter().all(|sensor| sensor["rmse_n"].as_f64() > Some(2.0)));
}

#[test]
fn invalid_model_parameter_is_rejected_by_name() {
    let dir = WorkDir::with_model("clean");
    let good = dir.read("model.toml");
    let gap = good.split("[sensor.parameters.gap]\nvalue = ").nth(1).unwrap();
    let gap = gap.lines().next().unwrap();
    for (from, to, words) in [
        (gap, "-1.5", "column gap of sensor 0: -1.5 is not allowed here"),
        (gap, "1e9", "does not determine the forces"),
        (
            "gauss_per_lsb = 0.125",
            "gauss_per_lsb = 0.0",
            "column sensor_scale.gauss_per_lsb: 0.0 is not allowed here",
        ),
        ("number = 1", "number = 0", "duplicate number"),
        ("half_window_ms", "half_windows_ms", "unknown field `half_windows_ms`"),
        ("half_window_ms", "half_windows_ms", "did you mean `half_window_ms`?"),
        ("[sensor.parameters.gap]", "[sensor.parameters.gapp]", "did you mean gap?"),
        ("[sensor.correlation]", "[sensor.correlation]\nkind = 1", "unknown field `kind`"),
        ("format = 1", "format = 2\nnew_key = 3", "this tool reads format = 1"),
    ] {
        std::fs::write(dir.path("model.toml"), good.replacen(from, to, 1)).unwrap();
        let output = dir.run("dev export model.toml -o tables.rs");
        assert_eq!(output.status.code(), Some(1));
        let message = text(&output.stderr);
        assert!(message.contains(words), "{to}: {message}");
    }
}

#[test]
fn delay_is_that_of_the_model_unless_another_is_given() {
    let dir = WorkDir::empty();
    let clean = campaign("clean");
    dir.stdout(&format!("fit {clean} --delay-ms 2 -o model.toml"));
    for (line, is_noted) in [
        (format!("compare model.toml {clean}"), false),
        (format!("replay model.toml {clean}"), false),
        (format!("add model.toml {clean} tip_slope -o better.toml"), false),
        (format!("replay model.toml {clean} --delay-ms 2"), false),
        (format!("replay model.toml {clean} --delay-ms 0"), true),
        (format!("compare model.toml {clean} --delay-ms 0"), true),
        (format!("add model.toml {clean} tip_slope --delay-ms 0"), true),
        (format!("dev export model.toml --mcap {clean}/1 --delay-ms 0 -o bags"), true),
    ] {
        let output = dir.run(&line);
        let printed = text(&output.stderr);
        assert!(output.status.success(), "{line}: {printed}");
        let note = "note: model.toml was fitted with a delay of 2 ms; these recordings are read with 0 ms, as given\n";
        assert_eq!(printed.contains(note), is_noted, "{line}: {printed}");
        assert_eq!(printed.contains("delay of"), is_noted, "{line}: {printed}");
    }
    assert!(dir.read("better.toml").contains("delay_ms = 2.0\n"));
}

#[test]
fn swapped_arguments_report_the_expected_order() {
    let message = WorkDir::empty().failure(&["replay", &campaign("clean/3"), "model.toml"]);
    assert!(message.contains("the order is MODEL CAMPAIGN"), "{message}");
}

/// A number of the force error in a result.
fn force(json: &Value, key: &str) -> f64 {
    json["force"][key].as_f64().unwrap_or_else(|| panic!("{json}"))
}

/// The first sensor of `clean`: a fit of four proves nothing more, and takes four times as long.
fn one_sensor() -> CampaignCopy {
    CampaignCopy::new()
        .change(&[1, 2, 3], "hall.csv", |table| {
            for sensor in 1..4 {
                for column in ["x_lsb", "y_lsb", "z_lsb", "temp_c"] {
                    table.remove(&format!("s{sensor}_{column}"));
                }
            }
        })
        .change(&[1, 2, 3], "force.csv", |table| {
            for sensor in 1..4 {
                table.remove(&format!("f{sensor}_x_n"));
                table.remove(&format!("f{sensor}_z_n"));
            }
        })
}

#[test]
fn polynomial_of_two_forces_gives_newtons_and_tables() {
    let (dir, copy) = (WorkDir::empty(), one_sensor());
    let clean = copy.path().display().to_string();
    let polynomial = ["--base", "polynomial", "--degree", "3", "-o", "model.toml", "--json"];
    let fit = dir.json(&[&["fit", &clean], &polynomial[..]].concat());
    // The bench has no effect but noise.
    let rms_n = force(&fit, "rms_n");
    assert!(rms_n > 0.0 && rms_n < 1.1 * force(&fit, "noise_n"), "{fit}");
    let comparison = dir.json(&["compare", "model.toml", &clean, "--json"]);
    assert_eq!(force(&comparison, "rms_n"), rms_n);
    let add = ["add", "model.toml", &clean, "sensor_temperature", "-o", "better.toml"];
    let added = text(&dir.stdout(&add));
    assert!(added.contains("sensor_temperature runs on the device: yes."), "{added}");
    let replay = dir.json(&["replay", "better.toml", &clean, "--json"]);
    assert!(force(&replay, "rms_n") < 1.1 * force(&replay, "noise_n"), "{replay}");
    assert_eq!(
        (replay["sensors"].as_array().unwrap().len(), &replay["nominal"]),
        (2, &Value::Null)
    );
    dir.stdout("dev export better.toml -o tables.rs");
    assert!(dir.read("tables.rs").contains("SensorTemperature"));
    let message = dir.failure("dev export better.toml --nominal -o nominal.rs");
    assert!(message.contains("a polynomial of the forces has no nominal design"), "{message}");
}

#[test]
fn force_that_was_not_recorded_is_assumed_to_be_zero() {
    let lateral = one_sensor().change(&[1, 2, 3], "force.csv", |table| table.remove("f0_z_n"));
    let (dir, lateral) = (WorkDir::empty(), lateral.path().display().to_string());
    for base in ["cylinder", "polynomial"] {
        let fit = ["fit", &lateral, "--base", base, "-o", "model.toml"];
        let output = dir.run(&fit[..]);
        let notes = text(&output.stderr);
        assert!(notes.contains("f0_z_n was not recorded: for sensor 0 the force"), "{notes}");
        assert!(text(&output.stdout).contains("Force error (held out"), "{notes}");
        let replay = dir.json(&["replay", "model.toml", &lateral, "--json"]);
        let sensors = replay["sensors"].as_array().unwrap();
        assert_eq!((sensors.len(), &sensors[0]["axis"]), (1, &"x".into()), "{replay}");
        let comparison = dir.json(&["compare", "model.toml", &lateral, "--json"]);
        assert_eq!(comparison["forces"].as_array().unwrap().len(), 1);
        dir.stdout(&["dev", "export", "model.toml", "-o", &format!("{base}.rs")]);
        let model = dir.read("model.toml");
        match base {
            "cylinder" => assert!(model.contains("assumed_zero = [\"z\"]"), "{model}"),
            _ => assert!(model.contains("forces = [\"f0_x_n\"]"), "{model}"),
        }
    }
}

#[test]
fn real_lattice_measurements_are_imported_and_fitted() {
    let Some(source) = real_data("eflesh_normal") else {
        return;
    };
    let dir = WorkDir::empty();
    let mapping = data("eflesh_normal.mapping.toml").display().to_string();
    let runs =
        ["run1.csv", "run2.csv", "run3.csv"].map(|run| source.join(run).display().to_string());
    let [a, b, c] = &runs;
    let imported = dir.json(&["import", &mapping, a, b, c, "-o", "eflesh", "--json"]);
    for recording in imported["recordings"].as_array().unwrap() {
        assert_eq!(
            (&recording["hall_rows"], &recording["measured_rows"]),
            (&3600.into(), &1860.into())
        );
    }
    let fit = dir.json("fit eflesh --base polynomial --degree 5 --json");
    // Those of the three recordings are one.
    let notices: Vec<&str> =
        fit["notices"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    let gaps = notices.iter().filter(|notice| notice.contains("gaps in the clock"));
    assert_eq!(gaps.clone().count(), 2, "{notices:?}");
    assert!(
        gaps.clone()
            .all(|notice| notice
                .ends_with("(recordings 1, 2, 3; the numbers are those of the first)")),
        "{notices:?}"
    );
    assert_eq!(fit["axes"].as_array().unwrap().len(), 15);
    // Residual of a polynomial of the force over all fifteen channels: 71 ± 3 uT.
    let microtesla = 100.0 * fit["held_out_rms_g"].as_f64().unwrap();
    assert!((68.0..=74.0).contains(&microtesla), "{microtesla} uT");
    // Of 34 N; the lattice has hysteresis and drift.
    let rms_n = force(&fit, "rms_n");
    assert!((1.0..=2.5).contains(&rms_n), "{rms_n} N");
    let message = dir.failure(&["import", &mapping, a, "-o", "eflesh"]);
    assert!(message.contains("it is not overwritten"), "{message}");
    let message = dir.failure(&["import", &mapping, a, "-o", "eflesh", "--force"]);
    assert!(message.contains("eflesh is to be a folder: leave --force out"), "{message}");
}

#[test]
fn files_of_other_inputs_are_kept_without_force() {
    let dir = WorkDir::with_model("clean");
    let [clean, demo] = ["clean", "demo"].map(campaign);
    let kept = |line: &str| {
        let path = line.rsplit(' ').next().unwrap();
        let before = fs::read(dir.path(path)).unwrap();
        let message = dir.failure(line);
        let why = match line.contains("dbc") {
            true => "has another content",
            false => "is not an earlier result of the same inputs",
        };
        assert!(message.ends_with(&format!(
            "magpie: {path}: the output path exists and {why}; it is not overwritten: choose another path, or give --force\n"
        )), "{message}");
        assert_eq!(fs::read(dir.path(path)).unwrap(), before, "{line}");
    };
    dir.stdout(&format!("fit {clean} -o model.toml"));
    kept(&format!("fit {demo} -o model.toml"));
    kept(&format!("compare model.toml {clean} -o model.toml"));
    dir.stdout(&format!("compare model.toml {clean} -o report.html"));
    kept(&format!("compare model.toml {demo} -o report.html"));
    kept("design sweep --count 100 -o report.html");
    dir.stdout("dev export model.toml -o tables.rs");
    dir.stdout("dev export model.toml -o tables.rs");
    dir.stdout(&format!("fit {demo} -o demo.toml"));
    kept("dev export demo.toml -o tables.rs");
    dir.stdout("dev export demo.toml --force -o tables.rs");
    dir.stdout("dev dbc -o gripper.dbc");
    dir.stdout("dev dbc -o gripper.dbc");
    kept("dev dbc --node 17 -o gripper.dbc");
    dir.stdout("design optimize --range 150 --count 100 -o design.toml");
    kept("design optimize --range 200 --count 100 -o design.toml");
    // An edit extends the model that it reads; a fit would lose its effects.
    dir.stdout(&format!("add model.toml {clean} tip_slope -o model.toml"));
    kept(&format!("fit {clean} -o model.toml"));
    kept(&format!("add demo.toml {demo} tip_slope -o model.toml"));
    dir.stdout(&format!("remove model.toml {clean} tip_slope -o model.toml"));
    dir.stdout(&format!("fit {demo} --force -o model.toml"));
    assert_eq!(dir.read("model.toml"), dir.read("demo.toml"));
}

#[test]
fn completions_and_manual_pages_cover_every_command() {
    let dir = WorkDir::empty();
    let parser = host_tools::commands::parser();
    let names: Vec<&str> = parser.get_subcommands().map(clap::Command::get_name).collect();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = text(&dir.stdout(&["dev", "completions", shell]));
        let missing: Vec<&&str> = names.iter().filter(|name| !script.contains(**name)).collect();
        assert!(missing.is_empty(), "{shell}: {missing:?}");
    }
    let script = dir.stdout("dev completions bash");
    std::fs::write(dir.path("magpie.bash"), script).unwrap();
    let ask = "source magpie.bash; COMP_WORDS=(magpie diagno); COMP_CWORD=1; _magpie magpie diagno magpie; echo ${COMPREPLY[@]}";
    let mut bash = std::process::Command::new("bash");
    let answer = bash.args(["-c", ask]).current_dir(dir.0.path()).output().unwrap();
    assert_eq!(text(&answer.stdout).trim(), "diagnose", "{}", text(&answer.stderr));
    dir.stdout("dev man pages");
    for name in names {
        let page = dir.read(&format!("pages/magpie-{name}.1"));
        assert!(page.contains(&format!("magpie\\-{}", name.replace('-', "\\-"))), "{page}");
    }
}

#[test]
fn readme_lists_all_commands() {
    let mut table = String::from("| command | purpose |\n| --- | --- |\n");
    for command in host_tools::commands::parser().get_subcommands() {
        if !command.is_hide_set() {
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            table += &format!("| `cargo magpie {}` | {about} |\n", command.get_name());
        }
    }
    assert_generated("host-tools/README.md", ["do not edit -->\n", "<!-- end of commands"], &table);
}

#[test]
fn operation_page_and_help_list_all_results() {
    let help = text(&WorkDir::empty().stdout(&["grasp", "--help"]));
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut table = String::from("| status | code | meaning |\n| --- | --- | --- |\n");
    let mut statuses = BTreeSet::new();
    for code in ResultCode::ALL {
        let (status, name, meaning) = (code.status(), code.name(), code.meaning());
        table += &format!("| {status} | `{name}` | {meaning} |\n");
        assert!(help.contains(&format!("{status} {name}: {meaning}")), "{name}: {help}");
        // 2 is that of wrong arguments, 101 that of a panic.
        assert!(statuses.insert(status) && ![2, 101].contains(&status), "{name}");
    }
    let marks = ["<!-- results -->\n", "<!-- end of results"];
    assert_generated("host-tools/OPERATION.md", marks, &table);
}

#[test]
fn forces_of_a_sensor_without_field_are_noted() {
    let spoilt = CampaignCopy::new().change(&[1, 2, 3], "force.csv", |table| {
        for axis in ["x", "z"] {
            let column = table.index(&format!("f3_{axis}_n"));
            table.header[column] = format!("f7_{axis}_n");
        }
    });
    let fit = WorkDir::empty().run(&["fit", &spoilt.path().display().to_string()]);
    let notes = text(&fit.stderr);
    assert!(fit.status.success(), "{notes}");
    assert!(notes.contains("forces of sensor 7 were recorded, but no field s7"), "{notes}");
    assert!(!notes.contains("sensor 2 were"), "{notes}");
}
