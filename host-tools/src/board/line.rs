//! A simulated serial line at 1 Mbaud.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use firmware::clock::pause;

use super::time::VirtualClock;

/// A byte with its start and stop bit.
pub const BYTE_US: u64 = 10;
/// Bytes that the board keeps.
const KEPT: usize = 256;

/// Both directions.
#[derive(Default)]
pub struct Line {
    /// What the board has sent.
    pub sent: Vec<u8>,
    received: VecDeque<u8>,
    overrun: bool,
    waker: Option<Waker>,
}

impl Line {
    /// A byte arrives at the board.
    pub fn put(&mut self, byte: u8) {
        match self.received.len() < KEPT {
            true => self.received.push_back(byte),
            false => self.overrun = true,
        }
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
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
            if std::mem::take(&mut line.overrun) {
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
