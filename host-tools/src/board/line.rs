//! A simulated serial line: the emulated chip's port is at one end of it, or the firmware's loops in virtual time by [`Out`]
//! and [`Into`], which stand for a port of their own.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use firmware::clock::pause;
use firmware::wire::serial::BAUD;
use sim_board::Time;
use sim_board::devices::SerialLine;

use super::time::VirtualClock;

/// A byte with its start and stop bit.
pub const BYTE_US: u64 = 10 * 1_000_000 / BAUD as u64;
/// Bytes that the port in virtual time keeps until they are read.
const KEPT: usize = 512;

/// Both directions.
#[derive(Default)]
pub struct Line {
    /// What the board has sent.
    pub sent: Vec<u8>,
    /// When each of the zeros in it had passed, which end packets; of an emulated port only.
    pub ended: Vec<Time>,
    received: VecDeque<u8>,
    waker: Option<Waker>,
}

impl Line {
    /// A byte for the board.
    pub fn put(&mut self, byte: u8) {
        self.received.push_back(byte);
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}

impl SerialLine for Line {
    fn receive(&mut self, time: Time, byte: u8) {
        if byte == 0 {
            self.ended.push(time);
        }
        self.sent.push(byte);
    }

    fn next_byte(&self) -> Time {
        match self.received.is_empty() {
            true => Time::NEVER,
            false => Time::ZERO,
        }
    }

    fn transmit(&mut self, _: Time) -> Option<u8> {
        self.received.pop_front()
    }

    fn baud_rate(&self) -> u32 {
        BAUD
    }
}

/// The board's way out.
pub struct Out {
    /// The line.
    pub line: Rc<RefCell<Line>>,
    /// Time.
    pub clock: VirtualClock,
}

impl ErrorType for Out {
    type Error = Infallible;
}

impl Write for Out {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        pause(&self.clock, BYTE_US * bytes.len() as u64).await;
        self.line.borrow_mut().sent.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The board's way in.
pub struct Into(pub Rc<RefCell<Line>>);

impl ErrorType for Into {
    type Error = ErrorKind;
}

impl Read for Into {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|context| {
            let mut line = self.0.borrow_mut();
            if line.received.len() > KEPT {
                line.received.clear();
                return Poll::Ready(Err(ErrorKind::Other));
            }
            if line.received.is_empty() {
                line.waker = Some(context.waker().clone());
                return Poll::Pending;
            }
            let count = bytes.len().min(line.received.len());
            for (byte, received) in bytes.iter_mut().zip(line.received.drain(..count)) {
                *byte = received;
            }
            Poll::Ready(Ok(count))
        })
        .await
    }
}
