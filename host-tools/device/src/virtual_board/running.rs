//! Thread of the virtual board, and its line as a source.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use firmware::config::constants::TICK_US;
use firmware::config::limits::DetectionLimits;
use firmware::parameters::Parameters;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;
use model_export::inverse::build::DeviceModel;
use model_export::inverse::calibration::CalibrationDescription;
use model_export::recordings::stream::RawStream;

use crate::pty::Pty;
use crate::serial_port::SerialLine;
use crate::source::Source;
use crate::virtual_board::world::{SensorInput, Unplug};
use device_run::networks::NetworkSet;
use sim::board::{Program, VirtualTimeBoard};

/// Step of virtual time.
const STEP_US: u64 = 5_000;
/// Polling interval of the wall clock.
const LOOK: Duration = Duration::from_millis(1);

/// Virtual board; runs until it is dropped.
pub struct VirtualBoard {
    line: SerialLine,
    /// Path at which other programs access the board.
    pub outside: PathBuf,
    stop: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<()>>>,
}

/// State of the board's thread.
struct Work {
    built: DeviceModel,
    networks: Option<NetworkSet>,
    doing: SensorInput,
    stream: Option<RawStream>,
    unplug: Vec<Unplug>,
    /// The first belongs to this program, which reads everything; the others may have no reader.
    ptys: [Pty; 2],
    stop: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
}

impl VirtualBoard {
    /// Starts a board.
    ///
    /// # Errors
    /// The recording cannot be read, or the system has no pseudo terminals.
    pub fn start(
        built: DeviceModel,
        networks: Option<NetworkSet>,
        doing: SensorInput,
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
        Ok(Self { line, outside, stop, ended, thread: Some(thread::spawn(move || work.run())) })
    }
}

impl Source for VirtualBoard {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        // Checked first, so that data sent before the end are read.
        let ended = self.ended.load(Relaxed);
        self.line.receive(packets)?;
        let is_running = self.thread.as_ref().is_some_and(|thread| !thread.is_finished());
        if !is_running && !ended && !self.stop.load(Relaxed) {
            match self.thread.take().map(JoinHandle::join) {
                Some(Ok(result)) => result?,
                _ => bail!("the virtual board failed"),
            }
        }
        Ok(!(ended && packets.is_empty()))
    }

    fn send(&mut self, message: Message) -> Result<()> {
        self.line.send(message)
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
            // The result is not needed on drop.
            let _ = thread.join();
        }
    }
}

impl Work {
    fn run(mut self) -> Result<()> {
        let networks = self.networks.as_ref().map_or(&[][..], |set| &set.file.networks);
        // As the image's, it exists as long as the program.
        let description = CalibrationDescription::of(&self.built, networks).to_toml().leak();
        let program = Program {
            tables: self.built.chosen.tables.clone(),
            compensations: self.built.compensations.clone(),
            networks: self.networks.take().map(|networks| networks.packed),
            description,
            parameters: Parameters::DEFAULT,
            limits: DetectionLimits::GRIPPER,
        };
        let world = self.doing.world(self.stream.take(), &self.built);
        let mut board = VirtualTimeBoard::start(program, world);
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
            // At the end the readings would stay constant and be reported as frozen.
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

    /// Next disconnection before this time.
    fn due(&mut self, end_us: u64) -> Option<Unplug> {
        let mut due: Vec<_> = self.unplug.iter().enumerate().collect();
        due.retain(|(_, unplug)| 1e6 * unplug.at_s < end_us as f64);
        let (place, _) = due.into_iter().min_by(|a, b| a.1.at_s.total_cmp(&b.1.at_s))?;
        Some(self.unplug.swap_remove(place))
    }

    /// Transfers bytes between the board's line and the pseudo terminals.
    fn exchange(&mut self, board: &VirtualTimeBoard) -> Result<()> {
        // Without a listener the recorded bus traffic would grow.
        board.connections.can.borrow_mut().board_frames.clear();
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

fn unplugged(board: &VirtualTimeBoard, number: usize) {
    for bus in &board.connections.buses {
        let sensors = &mut bus.borrow_mut().sensors;
        let known = sensors.iter_mut().filter(|sensor| sensor.number == number);
        known.for_each(|sensor| sensor.unplugged = true);
    }
}
