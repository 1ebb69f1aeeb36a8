//! The board in virtual time with a flooded CAN bus and random bytes on the serial line.

use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use analysis::progress;
use anyhow::{Context, Result};
use embedded_can::{Frame, StandardId};
use firmware::config::limits::DetectionLimits;
use firmware::parameters::Parameters;
use firmware::protocol::can::CanFrame;
use firmware::protocol::{DEFAULT_NODE, frame_id};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
const MINUTES: [f64; 2] = [60.0, 1.0];
/// Identifier of no message; its frames are the shortest possible.
const FOREIGN_ID: u16 = frame_id(DEFAULT_NODE, 0x1F);
/// Frames kept waiting, so that the bus is never idle.
const MAX_WAITING: usize = 50;
/// Random bytes per millisecond, the full rate of the line.
const BYTES_PER_MS: usize = 100;

/// Run the board under full load of CAN bus and serial line, and count missed ticks.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance bus-load --minutes 5")]
pub struct Args {
    /// Virtual minutes per seed [default: 60; quick: 1].
    #[arg(long, value_name = "M")]
    minutes: Option<f64>,
}

/// Runs one board per seed.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let minutes = args.minutes.unwrap_or(MINUTES[usize::from(options.quick)]);
    let model = fitted_model()?;
    let runs: Vec<[u64; 7]> =
        seeds.clone().map(|seed| run(&model, seed, minutes)).collect::<Result<_>>()?;
    let is_met = runs.iter().all(|[_, _, _, missed, ..]| *missed == 0);
    Ok(Section {
        id: "bus-load",
        title: "Bus load",
        extent: format!("{}, {minutes} virtual minutes each", seeds_text(&seeds)),
        conditions: "Foreign CAN frames without a pause and random bytes at the full rate of the serial line. Specified: \
                     no missed tick."
            .to_owned(),
        tables: markdown_table(
            [
                "seed",
                "foreign frames",
                "random bytes",
                "ticks missed",
                "transfers failed",
                "packets rejected",
                "events dropped",
                "computing time, s",
            ],
            seeds.zip(runs).map(|(seed, counts)| {
                let [frames, bytes, seconds, counts @ ..] = counts;
                let [missed, failed, rejected, dropped] = counts;
                [seed, frames, bytes, missed, failed, rejected, dropped, seconds]
                    .map(|count| count.to_string())
            }),
        ),
        is_met: Some(is_met),
    })
}

fn fitted_model() -> Result<DeviceModel> {
    let folder = tempfile::tempdir()?;
    let model = folder.path().join("model.toml");
    let campaign = concat!(env!("CARGO_MANIFEST_DIR"), "/../data/clean");
    magpie::run(&["fit".as_ref(), campaign.as_ref(), "-o".as_ref(), model.as_os_str()], None)?;
    Ok(build(&model, ModelVariant::Fitted)?)
}

/// Frames, bytes, computing time in seconds; ticks missed, transfers failed, packets rejected, events dropped.
fn run(built: &DeviceModel, seed: u64, minutes: f64) -> Result<[u64; 7]> {
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        description: "",
        parameters: Parameters::DEFAULT,
        limits: DetectionLimits::GRIPPER,
    };
    let load_n = |t: f64| 60.0 * (1.0 - (0.7 * t).cos()) / 2.0;
    let world = PressedWorld::new(&built.model, seed, move |t| {
        [load_n(t), load_n(t), -load_n(t), -load_n(t)].map(|n| [n, 0.3 * n])
    });
    let mut board = VirtualTimeBoard::start(program, Box::new(world));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let frame = StandardId::new(FOREIGN_ID).and_then(|id| CanFrame::new(id, &[]));
    let frame = frame.context("an identifier of 11 bits")?;
    let start = Instant::now();
    let (mut frames, mut bytes) = (0, 0);
    let milliseconds = (60_000.0 * minutes) as u64;
    let bar = progress::progress_bar("milliseconds", milliseconds as usize);
    for ms in 1..=milliseconds {
        while board.connections.can.borrow().waiting() < MAX_WAITING {
            board.connections.can.borrow_mut().put(frame);
            frames += 1;
        }
        for _ in 0..BYTES_PER_MS {
            board.connections.line.borrow_mut().put(rng.next_u32() as u8);
            bytes += 1;
        }
        board.run_until(1000 * ms);
        board.connections.can.borrow_mut().board_frames.clear();
        board.connections.line.borrow_mut().sent.clear();
        board.events.borrow_mut().clear();
        bar.inc(1);
    }
    let counts = &board.exchange.counts;
    Ok([
        frames,
        bytes,
        start.elapsed().as_secs(),
        u64::from(counts.ticks_missed.load(Relaxed)),
        u64::from(counts.transfers_failed.load(Relaxed)),
        u64::from(counts.packets_broken.load(Relaxed)),
        u64::from(board.exchange.events.dropped()),
    ])
}
