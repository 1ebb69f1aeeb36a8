//! The board's thread, and its line as a source.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use firmware::limits::Limits;
use firmware::parameters::Parameters;
use firmware::params::TICK_US;
use firmware::wire::messages::Message;
use firmware::wire::serial::Packet;
use model_export::inverse::build::Built;
use model_export::recordings::raw::RawStream;

use super::Unplug;
use super::world::Doing;
use crate::board::{Board, Program};
use crate::live::pty::Pty;
use crate::live::serial_port::SerialLine;
use crate::live::source::Source;
use crate::networks::Networks;

/// The board goes on by this much at once.
const STEP_US: u64 = 5_000;
/// How often it looks at the wall's clock.
const LOOK: Duration = Duration::from_millis(1);

/// A board that runs until it is dropped.
pub struct VirtualBoard {
    line: SerialLine,
    /// Where other programs read the same bytes and write to the board.
    pub outside: PathBuf,
    stop: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<()>>>,
}

/// What the board's thread needs.
struct Work {
    built: Built,
    networks: Option<Networks>,
    doing: Doing,
    stream: Option<RawStream>,
    unplug: Vec<Unplug>,
    /// The first is that of this program, which reads everything; the others may have no reader.
    ptys: [Pty; 2],
    stop: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
}

impl VirtualBoard {
    /// Switches a board on.
    ///
    /// # Errors
    /// The recording cannot be read, or the system has no pseudo terminals.
    pub fn start(
        built: Built,
        networks: Option<Networks>,
        doing: Doing,
        unplug: Vec<Unplug>,
    ) -> Result<Self> {
        let open =
            || Pty::open().context("the system gives no pseudo terminal for the virtual board");
        let ptys = [open()?, open()?];
        let [inside, outside] = ptys.each_ref().map(|pty| pty.path.clone());
        let stream = doing.stream()?;
        let line = SerialLine::open(&inside.to_string_lossy())?;
        let [stop, ended] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let work = Work {
            built,
            networks,
            doing,
            stream,
            unplug,
            ptys,
            stop: stop.clone(),
            ended: ended.clone(),
        };
        Ok(Self {
            line,
            outside,
            stop,
            ended,
            thread: Some(thread::spawn(move || work.run())),
        })
    }
}

impl Source for VirtualBoard {
    fn hear(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        // Asked first: what was sent before the end is still read.
        let ended = self.ended.load(Relaxed);
        self.line.hear(packets)?;
        let is_running = self
            .thread
            .as_ref()
            .is_some_and(|thread| !thread.is_finished());
        if !is_running && !ended && !self.stop.load(Relaxed) {
            match self.thread.take().map(JoinHandle::join) {
                Some(Ok(result)) => result?,
                _ => bail!("the virtual board broke off"),
            }
        }
        Ok(!(ended && packets.is_empty()))
    }

    fn say(&mut self, message: Message) -> Result<()> {
        self.line.say(message)
    }

    fn broken(&self) -> u32 {
        self.line.broken()
    }

    fn name(&self) -> String {
        format!("virtual board, {}", self.outside.display())
    }
}

impl Drop for VirtualBoard {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            // Whoever drops it does not ask how it ended.
            let _ = thread.join();
        }
    }
}

impl Work {
    fn run(mut self) -> Result<()> {
        let program = Program {
            tables: self.built.chosen.tables.clone(),
            compensations: self.built.compensations.clone(),
            networks: self.networks.take(),
            parameters: Parameters::DEFAULT,
            limits: Limits::GRIPPER,
        };
        let world = self.doing.world(self.stream.take(), &self.built);
        let mut board = Board::start(program, world);
        let begun = Instant::now();
        let mut time_us = 0;
        while !self.stop.load(Relaxed) {
            if time_us >= begun.elapsed().as_micros() as u64 {
                thread::sleep(LOOK);
                continue;
            }
            let end_us = time_us + STEP_US;
            while let Some(unplug) = self.due(end_us) {
                board.run_until((1e6 * unplug.at_s) as u64);
                unplugged(&board, unplug.sensor);
            }
            // What the sensors feel stays as it is at the end, and would soon be found frozen.
            while time_us < end_us && !board.connections.now.borrow().ended() {
                time_us += TICK_US;
                board.run_until(time_us);
            }
            self.exchange(&board)?;
            if board.connections.now.borrow().ended() {
                self.ended.store(true, Relaxed);
                while !self.stop.load(Relaxed) {
                    thread::sleep(LOOK);
                }
            }
        }
        Ok(())
    }

    /// The next connector that comes off before this time.
    fn due(&mut self, end_us: u64) -> Option<Unplug> {
        let mut due: Vec<_> = self.unplug.iter().enumerate().collect();
        due.retain(|(_, unplug)| 1e6 * unplug.at_s < end_us as f64);
        let (place, _) = due
            .into_iter()
            .min_by(|a, b| a.1.at_s.total_cmp(&b.1.at_s))?;
        Some(self.unplug.swap_remove(place))
    }

    /// Carries bytes between the board's line and the pseudo terminals.
    fn exchange(&mut self, board: &Board) -> Result<()> {
        // Nobody looks at the bus, and its memory would grow.
        board.connections.can.borrow_mut().heard.clear();
        board.events.borrow_mut().clear();
        let mut line = board.connections.line.borrow_mut();
        let sent = std::mem::take(&mut line.sent);
        let [inside, outside] = &mut self.ptys;
        let mut given = 0;
        while given < sent.len() && !self.stop.load(Relaxed) {
            given += inside.offer(&sent[given..])?;
            if given < sent.len() {
                thread::sleep(LOOK);
            }
        }
        outside.send_latest(&sent)?;
        for pty in [inside, outside] {
            let mut bytes = [0; 128];
            let count = pty.take(&mut bytes)?;
            bytes.iter().take(count).for_each(|byte| line.put(*byte));
        }
        Ok(())
    }
}

fn unplugged(board: &Board, number: usize) {
    for bus in &board.connections.buses {
        let sensors = &mut bus.borrow_mut().sensors;
        let known = sensors.iter_mut().filter(|sensor| sensor.number == number);
        known.for_each(|sensor| sensor.unplugged = true);
    }
}
