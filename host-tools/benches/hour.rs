//! An hour of the board in virtual time, with a flooded CAN bus and garbage on the serial line: ticks that
//! were missed, and how long it took. `cargo bench -p host-tools --bench hour [-- --minutes M]`

use std::path::Path;
use std::process::Command;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use embedded_can::{Frame, StandardId};
use firmware::config::limits::DetectionLimits;
use firmware::config::parameters::Parameters;
use firmware::protocol::can::CanFrame;
use firmware::protocol::{DEFAULT_NODE, frame_id};
use model_export::inverse::build::{ModelVariant, build};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};

const SEED: u64 = 1;
/// No message has this number; its frames are the shortest there are.
const STRANGE: u16 = frame_id(DEFAULT_NODE, 0x1F);
/// Frames that wait at most: the bus is never idle.
const WAITING: usize = 50;
/// Random bytes in a millisecond, the line's full rate.
const GARBAGE: usize = 100;

fn main() {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--minutes");
    let minutes: f64 = arguments.nth(1).map_or(60.0, |m| m.parse().expect("a number"));
    let folder = tempfile::tempdir().expect("a folder");
    let model = folder.path().join("model.toml");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/clean");
    let fit = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(["fit".as_ref(), data.as_os_str(), "-o".as_ref(), model.as_os_str()])
        .output()
        .expect("magpie runs");
    assert!(fit.status.success());
    let built = build(&model, ModelVariant::Fitted).expect("a model");
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        parameters: Parameters::DEFAULT,
        limits: DetectionLimits::GRIPPER,
    };
    let slow = |t: f64| 60.0 * (1.0 - (0.7 * t).cos()) / 2.0;
    let world = PressedWorld::new(&built.model, SEED, move |t| {
        [slow(t), slow(t), -slow(t), -slow(t)].map(|n| [n, 0.3 * n])
    });
    let mut board = VirtualTimeBoard::start(program, Box::new(world));
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let strange = StandardId::new(STRANGE).and_then(|id| CanFrame::new(id, &[]));
    let strange = strange.expect("a frame");
    let start = Instant::now();
    let (mut frames, mut bytes) = (0_u64, 0_u64);
    for ms in 1..=(60_000.0 * minutes) as u64 {
        while board.connections.can.borrow().waiting() < WAITING {
            board.connections.can.borrow_mut().put(strange);
            frames += 1;
        }
        for _ in 0..GARBAGE {
            board.connections.line.borrow_mut().put(rng.next_u32() as u8);
            bytes += 1;
        }
        board.run_until(1000 * ms);
        board.connections.can.borrow_mut().board_frames.clear();
        board.connections.line.borrow_mut().sent.clear();
        board.events.borrow_mut().clear();
    }
    let counts = &board.exchange.counts;
    let spent_s = start.elapsed().as_secs_f64();
    println!(
        "{minutes} min of the board (seed {SEED}) in {spent_s:.1} s, {:.0} times real time",
        60.0 * minutes / spent_s
    );
    println!("{frames} strange frames, {bytes} bytes of garbage");
    println!(
        "ticks missed {}, transfers failed {}, packets not understood {}, events dropped {}",
        counts.ticks_missed.load(Relaxed),
        counts.transfers_failed.load(Relaxed),
        counts.packets_broken.load(Relaxed),
        board.exchange.events.dropped()
    );
}
