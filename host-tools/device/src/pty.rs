//! Pseudo terminal: a serial line between two programs.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use rustix::fs::{Mode, OFlags, open};
use rustix::io::{ioctl_fionbio, ioctl_fionread};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use crate::source::is_pending;

/// A reader that takes nothing for this time has stopped reading.
const STALLED: Duration = Duration::from_secs(1);
/// Interval of attempts.
const RETRY: Duration = Duration::from_millis(1);

/// Own end; other programs open the other by its path.
pub struct Pty {
    master: File,
    /// Kept open so that the line survives the disconnection of readers.
    slave: OwnedFd,
    /// Path of the other end.
    pub path: PathBuf,
    /// Unread bytes at the other end after the last attempt to write.
    unread: u64,
    /// When fewer were last found than before: a reader exists.
    read: Option<Instant>,
}

impl Pty {
    /// New pseudo terminal in raw mode.
    ///
    /// # Errors
    /// The system has no more pseudo terminals, or none at all.
    pub fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = open(path.as_c_str(), flags, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        ioctl_fionbio(&master, true)?;
        Ok(Self {
            master: File::from(master),
            slave,
            path: PathBuf::from(path.to_string_lossy().into_owned()),
            unread: 0,
            read: None,
        })
    }

    /// Offers bytes to a reader; returns the number accepted.
    ///
    /// # Errors
    /// Error of the system.
    pub fn offer(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let unread = ioctl_fionread(&self.slave)?;
        if unread < self.unread {
            self.read = Some(Instant::now());
        }
        let count = taken(self.master.write(bytes))?;
        self.unread = ioctl_fionread(&self.slave)?;
        Ok(count)
    }

    /// Drops the oldest unread bytes, as on a line without a receiver.
    pub fn forget(&mut self) {
        // On failure the bytes are read later.
        let _ = tcflush(&self.slave, QueueSelector::IFlush);
        (self.unread, self.read) = (0, None);
    }

    /// Sends bytes; waits briefly for a late reader, and drops the oldest bytes without
    /// a reader.
    ///
    /// # Errors
    /// Error of the system.
    pub fn send_latest(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut given = 0;
        while let Some(rest) = bytes.get(given..).filter(|rest| !rest.is_empty()) {
            match self.offer(rest)? {
                0 if self.read.is_some_and(|read| read.elapsed() < STALLED) => {
                    thread::sleep(RETRY);
                }
                0 => {
                    self.forget();
                    self.offer(rest)?;
                    return Ok(());
                }
                count => given += count,
            }
        }
        Ok(())
    }

    /// Reads bytes from the other end; returns their number.
    ///
    /// # Errors
    /// Error of the system.
    pub fn take(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        taken(self.master.read(bytes))
    }
}

/// No data is not an error.
fn taken(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if is_pending(&error) => Ok(0),
        result => result,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn all_bytes_pass_unchanged_both_ways() {
        let mut pty = Pty::open().unwrap();
        let mut other = File::options().read(true).write(true).open(&pty.path).unwrap();
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(pty.offer(&all).unwrap(), all.len());
        let mut read = vec![0; all.len()];
        other.read_exact(&mut read).unwrap();
        assert_eq!(read, all);
        other.write_all(&all).unwrap();
        let mut back = Vec::new();
        while back.len() < all.len() {
            let mut bytes = [0; 64];
            let count = pty.take(&mut bytes).unwrap();
            back.extend_from_slice(&bytes[..count]);
        }
        assert_eq!(back, all);
    }

    #[test]
    fn without_a_reader_the_oldest_bytes_are_dropped() {
        let mut pty = Pty::open().unwrap();
        let mut written = 0;
        loop {
            match pty.offer(&[1; 1000]).unwrap() {
                0 => break,
                count => written += count,
            }
            assert!(written < 1 << 24, "it takes without end");
        }
        // The kernel frees space asynchronously.
        while pty.offer(&[2]).unwrap() == 0 {
            pty.forget();
            std::thread::yield_now();
        }
        let mut other = File::open(&pty.path).unwrap();
        let mut old = 0;
        let mut byte = [0];
        while byte != [2] {
            other.read_exact(&mut byte).unwrap();
            old += 1;
        }
        assert!(old <= written, "nothing was dropped of {written} bytes");
    }

    #[test]
    fn late_reader_loses_nothing() {
        const COUNT: usize = 1 << 20;
        let mut pty = Pty::open().unwrap();
        let mut other = File::open(&pty.path).unwrap();
        let (begin, begun) = mpsc::channel();
        let reader = thread::spawn(move || {
            let mut read = Vec::new();
            let mut bytes = [0; 4096];
            while read.len() < COUNT {
                let length = other.read(&mut bytes).unwrap();
                read.extend_from_slice(&bytes[..length]);
                // The first bytes show that it reads.
                let _ = begin.send(());
                if read.len() % 100 == 0 {
                    thread::sleep(STALLED / 50);
                }
            }
            read
        });
        let sent: Vec<u8> = (0..COUNT).map(|place| (place % 251) as u8).collect();
        for bytes in sent.chunks(1000) {
            pty.send_latest(bytes).unwrap();
            if pty.read.is_none() {
                begun.recv().unwrap();
            }
        }
        assert!(reader.join().unwrap() == sent);
    }
}
