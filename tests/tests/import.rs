//! Import of third-party tables: units, signs, clocks, missing values, error messages.

use std::fs;
use std::path::PathBuf;

use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::description::TimeOrigin;
use model_export::recordings::guess::{Proposal, propose, survey};
use model_export::recordings::import::import;
use model_export::recordings::mapping::Mapping;
use model_export::recordings::{Campaign, DataError};
use tempfile::TempDir;

const MAPPING: &str = r#"
description = "another test bench"
[hall]
clock = { from = "time", unit = "ms" }
columns = [
  { from = "mx", unit = "mT", to = "s0_x_gauss" },
  { from = "my", unit = "mT", to = "s0_y_gauss", scale = -1 },
  { from = "mz", unit = "mT", to = "s0_z_gauss" },
  { from = "height", unit = "m", to = "stage_mm" },
]
[force]
clock = { from = "scale_time", unit = "s" }
columns = [{ from = "mass", unit = "kg", to = "f0_z_n", missing = -1 }]
"#;

/// Rows every 10 ms; the source's clocks start at 5 s.
fn source() -> String {
    let mut text = "time,scale_time,mx,my,mz,height,mass,note\n".to_owned();
    for i in 0..40 {
        let mass = if i % 2 == 0 { "-1".to_owned() } else { format!("0.{i:02}") };
        text += &format!(
            "{},{},1.5,-2.5,0.25,0.012,{mass},ok\n",
            5000 + 10 * i,
            5.0 + 0.01 * f64::from(i)
        );
    }
    text
}

struct ImportFixture {
    folder: TempDir,
}

impl ImportFixture {
    fn import(mapping: &str, source: &str) -> (Self, Result<PathBuf, DataError>) {
        let fixture = Self { folder: TempDir::new().unwrap() };
        let at = |name: &str| fixture.folder.path().join(name);
        fs::write(at("mapping.toml"), mapping).unwrap();
        fs::write(at("source.csv"), source).unwrap();
        let sources = [at("source.csv"), at("source.csv")];
        let result = import(&at("mapping.toml"), &sources, &at("campaign"), |_| ());
        let campaign = at("campaign");
        (fixture, result.map(|_| campaign))
    }
}

fn error_of(mapping: &str, source: &str) -> String {
    let (fixture, result) = ImportFixture::import(mapping, source);
    let remaining: Vec<_> = fs::read_dir(fixture.folder.path()).unwrap().collect();
    assert_eq!(remaining.len(), 2, "a failed import left files");
    let message = result.unwrap_err().to_string();
    message.replace(&fixture.folder.path().display().to_string(), "")
}

#[test]
fn units_signs_clocks_and_missing_values_are_converted() {
    let (_fixture, result) = ImportFixture::import(MAPPING, &source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let first = &campaign.recordings[0];
    // 1.5 mT are 15 G; -2.5 mT inverted are 25 G.
    assert_eq!(first.sensors[&0].field_g[3], [15.0, 25.0, 2.5]);
    assert_eq!(first.covariates["stage_mm"][3], 12.0);
    let force = &first.forces[&(0, Axis::Z)].newtons;
    // Every second row has none.
    assert!(force.iter().all(|n| n.is_finite()) && force.len() <= 20, "{}", force.len());
    let max = force.iter().copied().filter(|n| n.is_finite()).fold(0.0, f64::max);
    // The last row has no window: 0.37 kg is the maximum used.
    assert!((max - 0.37 * 9.80665).abs() < 1e-9, "{max}");
    // Both clocks start with the recording; without a common clock recordings are contiguous.
    assert_eq!(first.time_s[0], 0.01);
    assert_eq!(campaign.recordings[1].description.start_s, 0.39);
}

#[test]
fn a_common_clock_preserves_the_distance_of_recordings() {
    let (_fixture, result) =
        ImportFixture::import(&MAPPING.replace("[hall]", "one_clock = true\n[hall]"), &source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    assert_eq!(campaign.recordings[1].description.start_s, 0.0);
}

#[test]
fn starts_are_measured_stated_or_assumed() {
    for (key, start_s, origin) in [
        ("one_clock = true", 0.0, TimeOrigin::Measured),
        ("starts_s = [0.0, 60.0]", 60.0, TimeOrigin::Stated),
        ("", 0.39, TimeOrigin::Assumed),
    ] {
        let mapping = MAPPING.replace("[hall]", &format!("{key}\n[hall]"));
        let (_fixture, result) = ImportFixture::import(&mapping, &source());
        let campaign =
            Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
        let second = &campaign.recordings[1].description;
        assert_eq!((second.start_s, second.start), (start_s, Some(origin)), "{key}");
        assert_eq!(second.recorded, None);
    }
    let error = error_of(&MAPPING.replace("[hall]", "starts_s = [0.0]\n[hall]"), &source());
    assert!(error.contains("column starts_s: 1 starts for 2 sources"), "{error}");
}

#[test]
fn times_since_1970_give_the_date_of_a_recording() {
    let mapping = MAPPING.replace("unit = \"ms\" }", "unit = \"s\" }");
    let rows = (0..40).map(|i| {
        let time = 1_700_000_000.0 + 0.01 * f64::from(i);
        format!("{time},{time},1.5,-2.5,0.25,0.012,0.1,ok\n")
    });
    let source = "time,scale_time,mx,my,mz,height,mass,note\n".to_owned();
    let (_fixture, result) = ImportFixture::import(&mapping, &(source + &rows.collect::<String>()));
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let recorded = campaign.recordings[0].description.recorded.as_deref();
    assert_eq!(recorded, Some("2023-11-14T22:13:20Z"));
}

#[test]
fn table_without_a_clock_of_a_one_axis_load_cell_is_imported() {
    let mapping = r#"
description = "load cell"
[hall]
clock = { row_s = 5.0 }
columns = [{ from = "signal", unit = "mV", to = "s0_x_v" }, { from = "room", unit = "K", to = "s0_temp_c" }]
[force]
clock = { row_s = 5.0 }
columns = [{ from = "load", unit = "kN", to = "f0_x_n" }]
"#;
    let loads = [2.0, 2.0, 4.0, 8.0, 4.0, 2.0, 6.0];
    let rows = loads.map(|load| format!("{load},{},300.15\n", 0.5 * load)).concat();
    let (_fixture, result) = ImportFixture::import(mapping, &format!("load,signal,room\n{rows}"));
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let first = &campaign.recordings[0];
    // Rows of one time belong together: nothing is interpolated, and none is lost at the ends.
    assert_eq!(first.time_s, [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0]);
    let fields: Vec<f64> = first.sensors[&0].field_g.iter().map(|field| field[0]).collect();
    assert_eq!(fields, [0.001, 0.001, 0.002, 0.004, 0.002, 0.001, 0.003]);
    assert_eq!(first.forces[&(0, Axis::X)].newtons, loads.map(|load| 1000.0 * load));
    assert!((first.sensors[&0].temperature_c[0] - 27.0).abs() < 1e-9);
    assert!(first.description.is_clock_assumed());
    let notices: String = campaign.notices().map(ToString::to_string).collect();
    assert!(notices.contains("the signal is in V"), "{notices}");
    let error = error_of(&mapping.replacen("row_s = 5.0", "unit = \"s\"", 1), "load\n1\n");
    assert!(error.contains("a clock without `from`"), "{error}");
}

#[test]
fn an_error_in_mapping_or_source_is_reported_with_a_remedy() {
    let mapping = |from: &str, to: &str| (MAPPING.replace(from, to), source());
    let cases = [
        (
            mapping("\"kg\"", "\"Kg\""),
            "column f0_z_n: the unit \"Kg\" is not allowed here; did you mean \"kg\"?",
        ),
        (mapping("\"kg\"", "\"mm\""), "f0_z_n is not in a unit that \"mm\" converts to"),
        (mapping("s0_x_gauss", "s0_x_guass"), "s0_x_guass"),
        (
            mapping("\"mass\"", "\"maas\""),
            "source.csv, line 1, column maas: the column is missing from the header; did you mean mass?",
        ),
        (mapping("missing", "mising"), "mapping.toml, line 13: is invalid: unknown field `mising`"),
        (
            (MAPPING.to_owned(), source().replace("5100,5.1,1.5", "5100,5.1,oops")),
            "source.csv, line 12, column mx: \"oops\" is not a number",
        ),
        (
            (
                TURNING.to_owned(),
                turning_source()
                    .replace("\n100,1.5,-2.5,0.25,2,0,0,2", "\n100,1.5,-2.5,0.25,0,0,0,0"),
            ),
            "source.csv, line 12, column qw: the quaternion 0, 0, 0, 0",
        ),
    ];
    for ((mapping, source), expected) in cases {
        let error = error_of(&mapping, &source);
        assert!(error.contains(expected), "{error}");
    }
}

/// A bench with an attitude and without a reference force.
const TURNING: &str = r#"
description = "a magnetometer"
[hall]
clock = { from = "time", unit = "ms" }
columns = [
  { from = "mx", unit = "mT", to = "s0_x_gauss" },
  { from = "my", unit = "mT", to = "s0_y_gauss" },
  { from = "mz", unit = "mT", to = "s0_z_gauss" },
]
attitude = { w = "qw", x = "qx", y = "qy", z = "qz" }
[force]
clock = { from = "time", unit = "ms" }
columns = []
"#;

fn turning_source() -> String {
    let mut text = "time,mx,my,mz,qw,qx,qy,qz\n".to_owned();
    for i in 0..40 {
        text += &format!("{},1.5,-2.5,0.25,2,0,0,2\n", 10 * i);
    }
    text
}

#[test]
fn a_quaternion_is_converted_without_a_force() {
    let (_fixture, result) = ImportFixture::import(TURNING, &turning_source());
    let campaign = Campaign::read(&result.unwrap(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let first = &campaign.recordings[0];
    assert!(first.forces.is_empty());
    assert!((first.covariates["yaw_rad"][3] - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
    assert!(first.covariates["roll_rad"][3].abs() < 1e-6);
}

/// A table of 50 rows: clocks ascend by `step`, other columns oscillate, in whole numbers or not.
fn table(header: &str, step: f64, start: f64, is_whole: bool) -> String {
    let names: Vec<&str> = header.split(',').collect();
    let mut text = format!("{header}\n");
    for row in 0..50 {
        let cell = |(i, name): (usize, &&str)| {
            let lower = name.to_lowercase();
            let wave = (0.3 * f64::from(row) + i as f64).sin();
            if lower.starts_with('t') && !lower.starts_with("temp") {
                format!("{:?}", start + step * f64::from(row))
            } else if is_whole {
                format!("{:.0}", 400.0 + 300.0 * wave)
            } else {
                format!("{:.4}", 40.0 + 30.0 * wave)
            }
        };
        text += &names.iter().enumerate().map(cell).collect::<Vec<_>>().join(",");
        text.push('\n');
    }
    text
}

/// A proposal for this table, whose mapping must be valid and import the table.
fn proposal(content: &str) -> Proposal {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("source.csv"), content).unwrap();
    let proposal = propose(&[at("source.csv")]).unwrap();
    let text = proposal.text.replace("# gauss_per_lsb", "gauss_per_lsb");
    fs::write(at("mapping.toml"), &text).unwrap();
    Mapping::read(&at("mapping.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let imported = import(&at("mapping.toml"), &[at("source.csv")], &at("campaign"), |_| ());
    imported.unwrap_or_else(|error| panic!("{error}\n{text}"));
    proposal
}

#[test]
fn proposal_recognises_columns_of_common_loggers() {
    struct Case {
        header: &'static str,
        step: f64,
        is_whole: bool,
        clock_unit: &'static str,
        /// Name, unit, and name in the recording.
        columns: &'static [(&'static str, &'static str, &'static str)],
    }
    let cases = [
        Case {
            header: "Time (s),Hall1_X (mT),Hall1_Y (mT),Hall1_Z (mT),Hall2_X (mT),Hall2_Y (mT),Hall2_Z (mT),Fx [N],Fy [N],Fz [N]",
            step: 0.001,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("Hall1_X (mT)", "mT", "s0_x_gauss"),
                ("Hall2_Z (mT)", "mT", "s1_z_gauss"),
                ("Fx [N]", "N", "f0_x_n"),
                ("Fz [N]", "N", "f0_z_n"),
            ],
        },
        Case {
            header: "timestamp_ns,mag.x,mag.y,mag.z,wrench.force.x,wrench.force.z",
            step: 1e6,
            is_whole: true,
            clock_unit: "ns",
            columns: &[("mag.x", "lsb", "s0_x_lsb"), ("wrench.force.z", "N", "f0_z_n")],
        },
        Case {
            header: "t,B1x,B1y,B1z,B2x,B2y,B2z,F1,F2",
            step: 2.0,
            is_whole: false,
            clock_unit: "ms",
            columns: &[
                ("B1x", "G", "s0_x_gauss"),
                ("B2y", "G", "s1_y_gauss"),
                ("F1", "N", "f0_z_n"),
                ("F2", "N", "f1_z_n"),
            ],
        },
        Case {
            header: "t_us,left_bx_uT,left_by_uT,left_bz_uT,right_bx_uT,right_by_uT,right_bz_uT,load_kg,gripper_width_mm,motor_iq_A,temperature_degC",
            step: 1000.0,
            is_whole: false,
            clock_unit: "us",
            columns: &[
                ("left_bz_uT", "uT", "s0_z_gauss"),
                ("right_bx_uT", "uT", "s1_x_gauss"),
                ("load_kg", "kg", "f0_z_n"),
                ("gripper_width_mm", "mm", "opening_mm"),
                ("motor_iq_A", "A", "motor_iq_a"),
                ("temperature_degC", "degC", "s1_temp_c"),
            ],
        },
        // A word or a number of its own decides too.
        Case {
            header: "t_ms,R_Bx_G,R_By_G,R_Bz_G,L_Bx_G,L_By_G,L_Bz_G,L grip z (N),R grip z (N)",
            step: 1.0,
            is_whole: false,
            clock_unit: "ms",
            columns: &[
                ("R_Bx_G", "G", "s0_x_gauss"),
                ("L grip z (N)", "N", "f1_z_n"),
                ("R grip z (N)", "N", "f0_z_n"),
            ],
        },
        // Several forces of one finger, and the current of a motor.
        Case {
            header: "t_ms,L_Bx_G,L_By_G,L_Bz_G,R_Bx_G,R_By_G,R_Bz_G,L grip z (N),L pull x (N),R grip z (N),R pull x (N),I motor (mA)",
            step: 1.0,
            is_whole: false,
            clock_unit: "ms",
            columns: &[
                ("L pull x (N)", "N", "f0_x_n"),
                ("R grip z (N)", "N", "f1_z_n"),
                ("R pull x (N)", "N", "f1_x_n"),
                ("I motor (mA)", "mA", "motor_iq_a"),
            ],
        },
        // Names of sensors decide, not the order.
        Case {
            header: "t_s,right_bx_G,right_by_G,right_bz_G,left_bx_G,left_by_G,left_bz_G,left_temp_degC,right_temp_degC,left_fz_N,right_fz_N",
            step: 0.001,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("right_bx_G", "G", "s0_x_gauss"),
                ("left_bx_G", "G", "s1_x_gauss"),
                ("left_temp_degC", "degC", "s1_temp_c"),
                ("left_fz_N", "N", "f1_z_n"),
                ("right_fz_N", "N", "f0_z_n"),
            ],
        },
        Case {
            header: "t_s,b1x_G,b1y_G,b1z_G,motor_temp_C,motor_position_rad,channel_c,f1_z_N",
            step: 0.001,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("motor_temp_C", "degC", "motor_temp_c"),
                ("motor_position_rad", "rad", "motor_angle_rad"),
                ("f1_z_N", "N", "f0_z_n"),
            ],
        },
        // Letters of sensors, which are letters of quantities, too.
        Case {
            header: "t_s,bx_A,by_A,bz_A,bx_B,by_B,bz_B,fx_A,fz_B",
            step: 0.001,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("by_A", "G", "s0_y_gauss"),
                ("bz_B", "G", "s1_z_gauss"),
                ("fx_A", "N", "f0_x_n"),
                ("fz_B", "N", "f1_z_n"),
            ],
        },
        Case {
            header: "t_s,mag_L_x,mag_L_y,mag_L_z,mag_F_x,mag_F_y,mag_F_z,fz_F",
            step: 0.001,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("mag_L_x", "G", "s0_x_gauss"),
                ("mag_F_z", "G", "s1_z_gauss"),
                ("fz_F", "N", "f1_z_n"),
            ],
        },
        // A sensor of force and torque: its mx is a torque.
        Case {
            header: "time_ms,bx_G,by_G,bz_G,Fx,Fz,Mx,My,Mz,roll_deg,stage_um",
            step: 1.0,
            is_whole: false,
            clock_unit: "ms",
            columns: &[
                ("bx_G", "G", "s0_x_gauss"),
                ("Fx", "N", "f0_x_n"),
                ("roll_deg", "deg", "roll_rad"),
                ("stage_um", "um", "covariate_stage_mm"),
            ],
        },
        Case {
            header: "t_s,s1_x_lsb,s1_y_lsb,s1_z_lsb,s3_x_lsb,s3_y_lsb,s3_z_lsb,f1_x_n,f3_x_n",
            step: 0.001,
            is_whole: true,
            clock_unit: "s",
            columns: &[
                ("s1_x_lsb", "lsb", "s0_x_lsb"),
                ("s3_z_lsb", "lsb", "s1_z_lsb"),
                ("f3_x_n", "N", "f1_x_n"),
            ],
        },
        Case {
            header: "t_s,mx_G,my_G,mz_G,ax_g,ay_g,az_g,qw,qx,qy,qz,weight_g",
            step: 0.01,
            is_whole: false,
            clock_unit: "s",
            columns: &[
                ("mx_G", "G", "s0_x_gauss"),
                ("ax_g", "g0", "accel_x_mps2"),
                ("weight_g", "g", "f0_z_n"),
            ],
        },
    ];
    for Case { header, step, is_whole, clock_unit, columns } in cases {
        let proposal = proposal(&table(header, step, 0.0, is_whole));
        let text = &proposal.text;
        let clocks = text.lines().filter(|line| line.starts_with("clock = "));
        let unit = format!("unit = \"{clock_unit}\"");
        assert!(
            clocks.clone().count() == 2 && clocks.clone().all(|line| line.contains(&unit)),
            "{text}"
        );
        for (from, unit, to) in columns {
            let mut proposed = proposal.columns.iter();
            let found = proposed.any(|c| c.from == *from && c.unit == *unit && c.to == *to);
            assert!(found, "{from} as {to} in {unit}\n{text}");
        }
        assert!(!proposal.columns.iter().any(|column| column.from.starts_with('M')), "{text}");
    }
}

#[test]
fn proposal_takes_quaternions_by_any_name_and_lists_what_it_leaves_out() {
    for names in [
        "qw,qx,qy,qz",
        "orientation.w,orientation.x,orientation.y,orientation.z",
        "quat_w,quat_x,quat_y,quat_z",
    ] {
        let header = format!("t_s,bx_G,by_G,bz_G,fz_N,{names},hall_9,b2x_G");
        let proposal = proposal(&table(&header, 0.001, 0.0, false));
        let scalar = names.split(',').next().unwrap();
        assert!(
            proposal.text.contains(&format!("attitude = {{ w = \"{scalar}\"")),
            "{}",
            proposal.text
        );
        let ignored: Vec<&str> = proposal.ignored.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(ignored, ["b2x_G", "hall_9"]);
    }
}

#[test]
fn lines_of_comment_and_a_constant_whole_number_are_understood() {
    let lines = table("t_s,bx,by,bz,fz", 0.01, 0.0, false);
    let mut rows = lines.lines();
    let header = rows.next().unwrap();
    let constant = rows.map(|row| {
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[2] = "1200";
        cells.join(",") + "\n"
    });
    let constant: String = constant.collect();
    let text = format!("# logger 1.2\n# 2026-11-01\n{header}\n# tare\n{constant}");
    let proposal = proposal(&text);
    let units = proposal.columns.iter().take(3).map(|column| column.unit);
    assert_eq!(units.collect::<Vec<_>>(), ["G"; 3]);
    assert!(!proposal.text.contains("raw counts"), "{}", proposal.text);
}

#[test]
fn clock_of_microseconds_since_power_on_is_not_one_since_1970() {
    let proposal = proposal(&table("time,bx_G,by_G,bz_G,fz_N", 1000.0, 1.2e9, false));
    assert!(proposal.text.contains("from = \"time\", unit = \"us\""), "{}", proposal.text);
}

#[test]
fn proposal_names_what_it_assumes() {
    let proposal = proposal(&table("time,bx,by,bz,force", 1.0, 1.7e12, true));
    let checks = proposal.checks.iter().map(|check| format!("{check}\n")).collect::<String>();
    for expected in [
        "bx, by, bz: whole numbers without a unit: taken as raw counts",
        "give gauss_per_lsb",
        "force: no unit: taken as newtons; no axis: taken as longitudinal (z)",
        "time: no unit: taken as ms, which makes 1000 rows per second",
    ] {
        assert!(checks.contains(expected), "{expected}\n{checks}");
        assert!(proposal.text.contains(expected), "{expected}\n{}", proposal.text);
    }
    assert!(proposal.text.contains("to = \"s0_x_lsb\" },  # "));
}

#[test]
fn proposal_finds_markers_of_missing_forces_and_a_running_clock() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, start: f64| {
        let mut text = "t_s,bx_G,by_G,bz_G,weight_g\n".to_owned();
        for row in 0..40 {
            let weight = if row % 2 == 0 { "-1".to_owned() } else { format!("{row}.5") };
            text += &format!("{},{row}.5,2.5,3.5,{weight}\n", start + 0.01 * f64::from(row));
        }
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let proposal = propose(&[write("1.csv", 100.0), write("2.csv", 200.0)]).unwrap();
    assert!(proposal.text.contains("one_clock = true"), "{}", proposal.text);
    assert!(proposal.text.contains("missing = -1.0"), "{}", proposal.text);
    let weight = proposal.columns.iter().find(|column| column.from == "weight_g").unwrap();
    assert_eq!(weight.range, (1.5, 39.5));
    let apart = propose(&[write("3.csv", 0.0), write("4.csv", 0.0)]).unwrap();
    assert!(apart.text.contains("one_clock = false"), "{}", apart.text);
}

#[test]
fn clocks_with_another_distance_in_each_recording_count_from_the_first_row() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let recording = |name: &str, start: f64| {
        fs::create_dir(at(name)).unwrap();
        fs::write(at(name).join("a.csv"), table("t_s,fx_N,fz_N", 0.01, start, false)).unwrap();
        fs::write(at(name).join("b.csv"), table("t_s,bx_G,by_G,bz_G", 0.001, 0.0, false)).unwrap();
        at(name)
    };
    let sources = [recording("1", 1.7e9), recording("2", 1.700_000_6e9)];
    let proposal = propose(&sources).unwrap();
    assert_eq!(proposal.text.matches("from_first_row = true }").count(), 2, "{}", proposal.text);
    assert!(proposal.text.contains("one_clock = false"), "{}", proposal.text);
    fs::write(at("mapping.toml"), &proposal.text).unwrap();
    import(&at("mapping.toml"), &sources, &at("campaign"), |_| ()).unwrap();
    let campaign = Campaign::read(&at("campaign"), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    for recording in &campaign.recordings {
        assert!(recording.time_s[0] < 0.02, "{}", recording.time_s[0]);
    }
    // One clock through all of them would not say when they began.
    let both = proposal.text.replace("one_clock = false", "one_clock = true");
    fs::write(at("mapping.toml"), both).unwrap();
    let error = import(&at("mapping.toml"), &sources, &at("other"), |_| ()).unwrap_err();
    assert!(error.to_string().contains("set one_clock = false"), "{error}");
    // Of the same distance: an offset.
    let same = [recording("3", 1.7e9), recording("4", 1.7e9)];
    assert!(propose(&same).unwrap().text.contains("offset_s = -1700000000.0"));
}

#[test]
fn tables_with_semicolons_or_tabs_are_read_like_those_with_commas() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let text = table("t_s,bx_mT,by_mT,bz_mT,fx_N,fz_N", 0.001, 0.0, false);
    fs::write(at("comma.csv"), &text).unwrap();
    fs::write(at("semicolon.csv"), text.replace(',', ";").replace('.', ",")).unwrap();
    fs::write(at("tab.csv"), text.replace(',', "\t")).unwrap();
    let read = |name: &str| {
        let source = at(&format!("{name}.csv"));
        let proposal = propose(std::slice::from_ref(&source)).unwrap();
        fs::write(at("mapping.toml"), &proposal.text).unwrap();
        import(&at("mapping.toml"), &[source], &at(name), |_| ()).unwrap();
        Campaign::read(&at(name), Alignment { delay_us: 0.0 }, |_| ()).unwrap().recordings.remove(0)
    };
    let comma = read("comma");
    for name in ["semicolon", "tab"] {
        let other = read(name);
        assert_eq!(other.sensors[&0].field_g, comma.sensors[&0].field_g, "{name}");
        assert_eq!(other.forces[&(0, Axis::Z)].newtons, comma.forces[&(0, Axis::Z)].newtons);
    }
}

#[test]
fn rows_without_a_time_or_a_force_belong_to_the_other_table_of_their_file() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut text = "t_ms,bx_G,by_G,bz_G,load_t_ms,fz_N\n".to_owned();
    for row in 0..600 {
        let force = if row % 10 == 0 { format!("{row}.25,{row}") } else { ",".to_owned() };
        text += &format!("{row},1.5,{row},2.5,{force}\n");
    }
    fs::write(at("log.csv"), text).unwrap();
    let of_clock = |clock: &str| {
        let mapping = format!(
            "description = \"\"\n[hall]\nclock = {{ from = \"t_ms\", unit = \"ms\" }}\ncolumns = [{}]\n\
             [force]\nclock = {{ from = {clock:?}, unit = \"ms\" }}\n\
             columns = [{{ from = \"fz_N\", unit = \"N\", to = \"f0_z_n\" }}]\n",
            ["x", "y", "z"]
                .map(|axis| format!(
                    "{{ from = \"b{axis}_G\", unit = \"G\", to = \"s0_{axis}_gauss\" }}"
                ))
                .join(", ")
        );
        fs::write(at("mapping.toml"), mapping).unwrap();
        let target = at(clock);
        import(&at("mapping.toml"), &[at("log.csv")], &target, |_| ()).unwrap();
        let campaign = Campaign::read(&target, Alignment { delay_us: 0.0 }, |_| ()).unwrap();
        let recording = &campaign.recordings[0];
        (recording.time_s.clone(), recording.forces[&(0, Axis::Z)].newtons.clone())
    };
    let (own_s, own_n) = of_clock("load_t_ms");
    let (board_s, board_n) = of_clock("t_ms");
    assert_eq!(own_n, board_n);
    assert!((55..=60).contains(&own_n.len()), "{}", own_n.len());
    assert!(own_s.iter().zip(&board_s).all(|(own, board)| (own - board - 0.000_25).abs() < 1e-9));
}

#[test]
fn folders_of_two_tables_are_mapped_by_their_columns() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.csv"), table("t_s,fx_N,fz_N", 0.01, 0.0, false)).unwrap();
    fs::write(at("b.csv"), table("t_s,bx_G,by_G,bz_G", 0.001, 0.0, false)).unwrap();
    let proposal = propose(&[folder.path().to_path_buf()]).unwrap();
    assert!(proposal.text.contains("[hall]\nfile = \"b.csv\""), "{}", proposal.text);
    assert!(proposal.text.contains("[force]\nfile = \"a.csv\""), "{}", proposal.text);
    // As two sources they would be two recordings.
    let error = propose(&[at("b.csv"), at("a.csv")]).unwrap_err().to_string();
    assert!(error.contains("put both into a folder"), "{error}");
}

#[test]
fn text_among_numbers_is_refused_with_its_line_and_column() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("source.csv");
    let good = table("t_s,bx_G,by_G,bz_G,fx_N,fz_N,status", 0.01, 0.0, false);
    let changed = |line: usize, column: usize| {
        let mut rows: Vec<Vec<&str>> = good.lines().map(|row| row.split(',').collect()).collect();
        rows[line - 1][column] = "n/a";
        let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        fs::write(&path, rows.join("\n") + "\n").unwrap();
        propose(std::slice::from_ref(&path))
    };
    for (column, name) in [(2, "by_G"), (4, "fx_N")] {
        let error = changed(17, column).unwrap_err().to_string();
        let place = format!(
            "source.csv, line 17, column {name}: \"n/a\" is not a number; correct it or remove"
        );
        assert!(error.contains(&place), "{error}");
    }
    // A column that is not imported.
    let proposal = changed(17, 6).unwrap();
    assert!(
        proposal.ignored.contains(&("status".to_owned(), "text in line 17".into())),
        "{:?}",
        proposal.ignored
    );
}

#[test]
fn survey_has_the_values_of_a_table_for_which_no_mapping_is_proposed() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("source.csv");
    let rows = (0..1000).map(|i| format!("{i},{}\n", if i == 700 { -5 } else { i % 10 }));
    fs::write(&path, format!("run,ch0\n{}", rows.collect::<String>())).unwrap();
    let survey = survey(&[path]).unwrap();
    assert!(survey.proposal.is_err());
    let [run, ch0] = survey.tables[0].columns.as_slice() else { panic!("two columns") };
    assert_eq!((run.name.as_str(), ch0.range()), ("run", (-5.0, 9.0)));
    // 1000 values in stretches of 8: each has its extremes.
    let (run, ch0) = (&run.trace.stretches, &ch0.trace.stretches);
    assert_eq!((run.len(), run[0], run[124]), (125, (0.0, 7.0), (992.0, 999.0)));
    assert_eq!((ch0[0], ch0[87], ch0[88]), ((0.0, 7.0), (-5.0, 9.0), (0.0, 9.0)));
}

#[test]
fn table_without_a_field_or_clock_is_refused() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("source.csv");
    for (content, expected) in [
        ("run,load,deflection\n1,2,3\n2,3,4\n", "a table without a magnetic field"),
        ("bx_G,by_G,bz_G\n1,2,3\n1,2,3\n", "no column increases in every row"),
        ("t_s,hall_1,hall_2\n1,2,3\n2,3,4\n", "a table without a magnetic field"),
        ("t_s,HallLeft_Bn_mT\n1,2\n2,3\n", "without its axis is not allowed here; put x, y or z"),
        // The third of January, or the first of March?
        ("time,bx_G,by_G,bz_G\n01/03/2026 00:00:00,1,2,3\n", "the times in time are text"),
        // A sensor of two axes.
        ("bx_G;by_G\n1;2\n", "no column increases in every row"),
        ("t_s,bx_G,by_G,bz_G\n", "there are no rows"),
    ] {
        fs::write(&path, content).unwrap();
        let error = propose(std::slice::from_ref(&path)).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}
