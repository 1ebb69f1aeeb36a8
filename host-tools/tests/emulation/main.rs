//! The image in an emulated chip. Where this machine has no compiler for the chip every test is listed as ignored, and the
//! end of `cargo test` says how to get one; `EMULATION=required` makes that a failure. `EMULATION=acceptance` runs for longer.

mod boards;
mod boot;
mod bringup;
mod buses;
mod calibration;
mod covariates;
#[path = "../scenarios/evaluate.rs"]
mod evaluate;
mod faults;
#[allow(dead_code)] // So are detectors that are switched off.
#[path = "../scenarios/file.rs"]
mod file;
#[allow(dead_code)] // The path is another test's.
mod images;
mod motion;
mod replay;
#[allow(dead_code)] // The other layer is another test's.
#[path = "../scenarios/rig.rs"]
mod rig;
mod scenarios;
mod silicon;
mod stops;
mod storage;
mod supervision;
mod uploads;
#[path = "../workdir/mod.rs"]
mod workdir;

use std::process::ExitCode;

use images::Variant;
use libtest_mimic::{Arguments, Trial};

/// How thorough the tests are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// For every change.
    Usual,
    /// Before a release.
    Acceptance,
}

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let word = std::env::var("EMULATION").unwrap_or_default();
    let effort = if word == "acceptance" { Effort::Acceptance } else { Effort::Usual };
    let absent = if arguments.list { None } else { images::get(Variant::Default).err() };
    if let Some(reason) = absent.as_ref().filter(|_| !word.is_empty()) {
        println!("no image for the emulated chip: {reason}");
        return ExitCode::FAILURE;
    }
    // The compiler has one thread for most of an image: the others are built while tests of the first ones run.
    if absent.is_none() && !arguments.list && arguments.filter.is_none() {
        std::thread::spawn(|| {
            for variant in [Variant::Nominal, Variant::Clean].into_iter().chain(Variant::ALL) {
                let _ = images::get(variant);
            }
        });
    }
    // The longest ones first; they run the image that is already there.
    let mut trials: Vec<Trial> = calibration::trials(effort);
    trials.extend(buses::trials(effort));
    trials.extend(stops::trials(effort));
    trials.extend(storage::trials());
    trials.extend(supervision::trials());
    trials.extend(faults::trials());
    trials.extend(silicon::trials());
    trials.extend(bringup::trials(effort));
    trials.extend(scenarios::trials());
    trials.extend(motion::trials(effort));
    trials.extend(covariates::trials());
    trials.extend(uploads::trials(effort));
    trials.extend(boot::trials(effort));
    trials.extend(replay::trials(effort));
    if let Some(reason) = &absent {
        tests::not_run::note(trials.iter().map(Trial::name), reason);
    }
    let trials =
        trials.into_iter().map(|trial| trial.with_ignored_flag(absent.is_some())).collect();
    libtest_mimic::run(&arguments, trials).exit_code()
}
