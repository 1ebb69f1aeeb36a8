//! How surely, how soon and how often in vain the device notices a foreign magnet, over several grippers.
//!
//! Simulated grippers (hysteresis, cross coupling, a warming magnet, scatter of manufacture), each with a
//! model fitted by the tool's own commands to three recordings of 100 s; then [`analysis::magnetic_disturbance`] on
//! fresh recordings of each.
//!
//! ```text
//! cargo bench -p host-tools --bench foreign_magnet                 # ten hours
//! cargo bench -p host-tools --bench foreign_magnet -- --hours 1 --grippers 1
//! cargo bench -p host-tools --bench foreign_magnet -- --networks   # and a network for each sensor
//! ```

mod gripper;

use analysis::magnetic_disturbance::counts::DetectionCounts;
use analysis::magnetic_disturbance::evaluate_detection;
use analysis::progress;
use clap::Parser;
use report::html::training::foreign::section;
use report::text::terminal;

/// Counts how surely a foreign magnet is noticed.
#[derive(Parser)]
struct Args {
    /// Hours of simulated time, over all grippers.
    #[arg(long, default_value_t = 10.0)]
    hours: f64,
    /// Grippers, each made differently.
    #[arg(long, default_value_t = 4)]
    grippers: u64,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// Train networks and put them behind the models: the signals sigma and split.
    #[arg(long)]
    networks: bool,
    /// Leave the magnet's temperature out of the models.
    #[arg(long)]
    no_temperature: bool,
    /// Write a page with the operating characteristics.
    #[arg(short, long, value_name = "HTML")]
    output: Option<std::path::PathBuf>,
    /// What cargo passes to every bench.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let args = Args::parse();
    let seeds: Vec<u64> = (args.first..args.first + args.grippers).collect();
    let of = format!("{} grippers, seeds {seeds:?}:", args.grippers);
    println!("{of}");
    let bar = progress::progress_bar("recordings", 0);
    let mut all = DetectionCounts::default();
    for &seed in &seeds {
        let gripper = gripper::Gripper::new(seed, !args.no_temperature, args.networks);
        bar.suspend(|| println!("  gripper {seed}: {}", gripper.words()));
        let hours = args.hours / args.grippers as f64;
        let counted = evaluate_detection(&gripper.device(), &gripper.world, hours, &bar);
        all = all.with(counted.expect("simulated rows can be read"));
    }
    bar.finish_and_clear();
    print!(
        "{}{}",
        terminal::paragraph(&report::text::disturbance::summary(&all)),
        report::text::disturbance::table(&all)
    );
    if let Some(path) = &args.output {
        let title = "magpie: a foreign magnet";
        report::html::write_sections(path, title, &[section(&all, &of)])
            .expect("the page can be written");
    }
    if !all.meets_requirements() {
        std::process::exit(1);
    }
}
