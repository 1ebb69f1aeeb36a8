//! How surely, how soon and how often in vain the device notices a foreign magnet.
//!
//! Simulated grippers (hysteresis, cross coupling, a warming magnet, scatter of manufacture), each with a
//! model fitted by the tool's own commands to three recordings of 100 s. Then fresh recordings go through
//! the device's code twice, with the same noise: as they are, which counts false alarms, and with magnets
//! that pass at random distances, directions and speeds, which counts those that move a force by more than
//! 20 N and are noticed within 20 ms of that. No file is written on the way, so that ten hours take
//! minutes.
//!
//! ```text
//! cargo bench -p host-tools --bench foreign_magnet                 # ten hours
//! cargo bench -p host-tools --bench foreign_magnet -- --hours 1 --grippers 1
//! cargo bench -p host-tools --bench foreign_magnet -- --networks   # and a network for each sensor
//! ```

mod gripper;
mod passage;
mod tally;
mod world;

use clap::Parser;
use rayon::prelude::*;

use tally::Tally;

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
    /// Write the operating characteristics as a plot.
    #[arg(long, value_name = "SVG")]
    plot: Option<std::path::PathBuf>,
    /// What cargo passes to every bench.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let args = Args::parse();
    let each = (args.hours * 3600.0 / world::SECONDS / args.grippers as f64).ceil() as u32;
    let seeds: Vec<u64> = (args.first..args.first + args.grippers).collect();
    println!(
        "{} grippers, seeds {seeds:?}, {each} recordings of {} s each",
        args.grippers,
        world::SECONDS
    );
    let bar = host_tools::progress::bar("recordings", each as usize * seeds.len());
    let mut all = Tally::default();
    for &seed in &seeds {
        let gripper = gripper::Gripper::new(seed, !args.no_temperature, args.networks);
        bar.suspend(|| println!("  gripper {seed}: {}", gripper.words()));
        let of_gripper = (0..each).into_par_iter().map(|number| {
            let tally = world::run(&gripper, number);
            bar.inc(1);
            tally
        });
        all = all.with(of_gripper.reduce(Tally::default, Tally::with));
    }
    bar.finish_and_clear();
    print!("{}", all.text());
    if let Some(path) = &args.plot {
        std::fs::write(path, all.plot()).expect("the plot can be written");
    }
    if !all.reached() {
        std::process::exit(1);
    }
}
