//! The field of the cylinder compared with MagpyLib's: the same numbers, and how many times faster on one
//! core, both timed in this run. Needs python3 with magpylib (`pip install magpylib`).
//!
//! Exits with an error where the fields differ by 1e-9 relative or the ratio is under 8.

use std::process::{Command, ExitCode};
use std::time::Instant;

use model_export::physics::Cylinder;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const POINTS: usize = 100_000;
const ROUNDS: usize = 5;
const LEAST_RATIO: f64 = 8.0;
const LARGEST_DIFFERENCE: f64 = 1e-9;

fn main() -> ExitCode {
    // `cargo test --benches` runs this too: there it only has to build.
    if !std::env::args().any(|argument| argument == "--bench") {
        return ExitCode::SUCCESS;
    }
    match compare() {
        Ok((ratio, difference)) => {
            println!(
                "the field is {ratio:.2} times MagpyLib on one core; largest relative difference {difference:.1e}"
            );
            if ratio >= LEAST_RATIO && difference <= LARGEST_DIFFERENCE {
                ExitCode::SUCCESS
            } else {
                eprintln!("wanted: ratio >= {LEAST_RATIO}, difference <= {LARGEST_DIFFERENCE:e}");
                ExitCode::FAILURE
            }
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn compare() -> Result<(f64, f64), String> {
    let magnet = Cylinder { diameter_mm: 3.0, length_mm: 2.0 };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let points: Vec<Vector3<f64>> = (0..POINTS)
        .map(|_| {
            let mut across = || rng.random_range(-1.0..1.0);
            Vector3::new(across(), across(), rng.random_range(2.0..4.0))
        })
        .collect();
    let (mut ours_s, mut ours) = (f64::INFINITY, Vec::new());
    for _ in 0..ROUNDS {
        let start = Instant::now();
        ours = magnet.unit_fields(&points);
        ours_s = ours_s.min(start.elapsed().as_secs_f64());
    }
    let (theirs_s, theirs) = magpylib(&magnet, &points)?;
    let differences = ours.iter().zip(&theirs).map(|(a, b)| (a - b).norm() / b.norm());
    Ok((theirs_s / ours_s, differences.fold(0.0, f64::max)))
}

fn magpylib(
    magnet: &Cylinder,
    points: &[Vector3<f64>],
) -> Result<(f64, Vec<Vector3<f64>>), String> {
    let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
    let (input, output) = (folder.path().join("points"), folder.path().join("fields"));
    let rows = points.iter().flat_map(|p| [magnet.diameter_mm, magnet.length_mm, p.x, p.y, p.z]);
    let bytes: Vec<u8> = rows.flat_map(f64::to_le_bytes).collect();
    std::fs::write(&input, bytes).map_err(|e| e.to_string())?;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/magpylib_field.py");
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let run = Command::new(&python)
        .arg(script)
        .args([&input, &output])
        // One core for both.
        .envs(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"].map(|key| (key, "1")))
        .output()
        .map_err(|error| format!("{python} cannot be run: {error}"))?;
    if !run.status.success() {
        let said = String::from_utf8_lossy(&run.stderr);
        return Err(format!("MagpyLib did not run (pip install magpylib): {said}"));
    }
    let seconds = String::from_utf8_lossy(&run.stdout);
    let seconds: f64 = seconds.trim().parse().map_err(|_| format!("not a time: {seconds}"))?;
    let bytes = std::fs::read(&output).map_err(|e| e.to_string())?;
    let numbers: Vec<f64> =
        bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    Ok((seconds, numbers.as_chunks::<3>().0.iter().map(|b| Vector3::from(*b)).collect()))
}
