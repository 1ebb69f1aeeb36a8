//! A table of text that is whole whenever its writer is killed.
//!
//! The kernel takes what a process writes page by page, and a process that is killed has each page written
//! as a whole or not at all. So no write goes over a page's end, and no line either: the line before is
//! filled up with blanks, which readers of numbers skip. What a power cut leaves is the file system's.

use std::io::{self, ErrorKind, Write};

/// The smallest page of any system.
pub const PAGE: usize = 4096;

/// The table.
pub struct Paged<W> {
    out: W,
    /// Bytes that were written.
    written: u64,
    /// Whole lines that follow in the same page.
    waiting: Vec<u8>,
    /// The last line, which may have to be filled up; empty before the first.
    last: Vec<u8>,
}

impl<W: Write> Paged<W> {
    /// An empty one.
    pub fn new(out: W) -> Self {
        Self {
            out,
            written: 0,
            waiting: Vec::with_capacity(PAGE),
            last: Vec::new(),
        }
    }

    /// Adds a line, given without its end.
    ///
    /// # Errors
    /// The writer's, or the line is longer than a page.
    pub fn line(&mut self, text: &str) -> io::Result<()> {
        if text.len() >= PAGE {
            let why = format!("a line of {} bytes is longer than a page", text.len());
            return Err(io::Error::new(ErrorKind::InvalidInput, why));
        }
        if !self.last.is_empty() {
            let end = (self.page_used() + self.last.len() + 1) % PAGE;
            if end > 0 && end + text.len() + 1 > PAGE {
                self.last.resize(self.last.len() + PAGE - end, b' ');
            }
            self.settle()?;
        }
        self.last.extend_from_slice(text.as_bytes());
        Ok(())
    }

    /// Writes every line but the last.
    ///
    /// # Errors
    /// The writer's; it may hold part of a line then, beyond [`Paged::written`] bytes.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.write_all(&self.waiting)?;
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        self.out.flush()
    }

    /// Writes every line.
    ///
    /// # Errors
    /// As [`Paged::flush`].
    pub fn finish(&mut self) -> io::Result<()> {
        if !self.last.is_empty() {
            self.settle()?;
        }
        self.flush()
    }

    /// Bytes that are whole lines in the writer.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Where it writes.
    pub fn out(&mut self) -> &mut W {
        &mut self.out
    }

    /// The last line has its end.
    fn settle(&mut self) -> io::Result<()> {
        self.waiting.append(&mut self.last);
        self.waiting.push(b'\n');
        if self.page_used() == 0 {
            self.flush()?;
        }
        Ok(())
    }

    /// Bytes of the page that is being filled.
    fn page_used(&self) -> usize {
        (self.written as usize + self.waiting.len()) % PAGE
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Every write by itself, as the kernel sees it.
    #[derive(Default)]
    struct Writes(Vec<Vec<u8>>);

    impl Write for Writes {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.push(bytes.to_vec());
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn line(length: usize, number: usize) -> String {
        let digits = number.to_string();
        digits.repeat(length.div_ceil(digits.len()))[..length].to_owned()
    }

    proptest! {
        #[test]
        fn whatever_is_written_ends_with_a_line_and_stays_within_a_page(
            lengths in prop::collection::vec((1..PAGE, any::<bool>()), 1..60),
        ) {
            let mut paged = Paged::new(Writes::default());
            let lines: Vec<String> = lengths
                .iter()
                .enumerate()
                .map(|(number, (length, _))| line(*length, number))
                .collect();
            for (text, (_, flush)) in lines.iter().zip(&lengths) {
                paged.line(text).unwrap();
                if *flush {
                    paged.flush().unwrap();
                }
            }
            paged.finish().unwrap();
            let mut place = 0;
            let mut all = Vec::new();
            for write in paged.out.0.iter().filter(|write| !write.is_empty()) {
                prop_assert_eq!(write.last(), Some(&b'\n'));
                prop_assert_eq!(place / PAGE, (place + write.len() - 1) / PAGE);
                place += write.len();
                all.extend_from_slice(write);
            }
            prop_assert_eq!(paged.written, place as u64);
            let text = String::from_utf8(all).unwrap();
            let read: Vec<&str> = text.lines().map(str::trim_end).collect();
            prop_assert_eq!(read, lines);
        }
    }

    #[test]
    fn all_lines_but_the_last_are_written_by_a_flush() {
        let mut paged = Paged::new(Writes::default());
        for text in ["a", "b", "c"] {
            paged.line(text).unwrap();
        }
        paged.flush().unwrap();
        assert_eq!(paged.out.0.concat(), b"a\nb\n");
        paged.finish().unwrap();
        assert_eq!(paged.out.0.concat(), b"a\nb\nc\n");
        assert!(paged.line(&"x".repeat(PAGE)).is_err());
    }
}
