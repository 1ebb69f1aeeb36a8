//! A sensor that is no magnetometer: its errors have its unit.

use std::f64::consts::TAU;
use std::fmt::Write;
use std::fs;

use crate::workdir::{WorkDir, text};

/// Rows of a recording, 20 ms apart.
const ROWS: u32 = 1500;

/// Two recordings of a load cell in volts, whose signal also follows a lever that the model does not have.
fn load_cell(dir: &WorkDir) {
    for recording in [1_u32, 2] {
        let folder = dir.path("campaign").join(recording.to_string());
        fs::create_dir_all(&folder).unwrap();
        let mut hall = "t_us,s0_x_v,s0_y_v,s0_z_v,lever_mm\n".to_owned();
        let mut force = "t_us,f0_z_n\n".to_owned();
        // Numbers of Knuth's generator, in place of noise.
        let mut state = u64::from(recording);
        for row in 0..ROWS {
            let mut noise = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
            };
            let time = f64::from(row) / 50.0;
            let load = 40.0 * (TAU * time * (0.3 + 0.1 * f64::from(recording))).sin();
            let lever = 5.0 * (TAU * time / 7.0).cos();
            let mut signal = || 2e-5 * load + 1e-4 * lever + 1e-5 * noise();
            let [x, y, z] = [signal(), signal(), signal()];
            let at = 1_000_000 + 20_000 * row;
            writeln!(hall, "{at},{x:.8},{y:.8},{z:.8},{lever:.4}").unwrap();
            writeln!(force, "{at},{load:.4}").unwrap();
        }
        fs::write(folder.join("hall.csv"), hall).unwrap();
        fs::write(folder.join("force.csv"), force).unwrap();
        let start_s = 100 * recording;
        let description = format!(
            "format = 1\ndescription = \"load cell\"\nstart_s = {start_s}\ncovariates = [\"lever_mm\"]\n"
        );
        fs::write(folder.join("recording.toml"), description).unwrap();
    }
}

#[test]
fn errors_of_a_load_cell_have_its_unit() {
    let dir = WorkDir::empty();
    load_cell(&dir);
    let fit = text(&dir.stdout("fit campaign --base polynomial --degree 1 -o model.toml"));
    assert!(fit.contains("floor V") && fit.contains("channels: 0.000"), "{fit}");
    let compared = text(&dir.stdout("compare model.toml campaign -o report.html"));
    assert!(compared.contains("rms / V") && compared.contains("times the floor"), "{compared}");
    let diagnosed = text(&dir.stdout("diagnose model.toml campaign"));
    assert!(diagnosed.contains("lever_mm"), "{diagnosed}");
    for output in [fit, compared, diagnosed] {
        let gauss: Vec<&str> = output
            .lines()
            .filter(|line| {
                line.split(' ').any(|word| {
                    ["G", "mG", "gauss"].contains(&word.trim_end_matches(['.', ',', ';', ':']))
                })
            })
            .collect();
        assert!(gauss.is_empty(), "{gauss:?}");
    }
    for command in [
        "fit campaign --base polynomial --degree 1 -o again.toml --json",
        "compare model.toml campaign --json",
        "diagnose model.toml campaign --json",
    ] {
        assert_eq!(dir.json(command)["signal_unit"], "V", "{command}");
    }
}
