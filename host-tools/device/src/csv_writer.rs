//! CSV output that is valid whenever the process is killed.
//!
//! The kernel accepts the writes of a process page by page, and each page of a killed process is written
//! completely or not at all. No write and no line therefore crosses a page boundary: the previous line is
//! padded with blanks, which readers of numbers skip, or, if it is in the file already, followed by a comment.
//! After a power failure the file system's guarantees apply.

use std::io::{self, ErrorKind, Write};

/// Smallest page size of supported systems.
pub const PAGE: usize = 4096;

/// Writer of lines.
pub struct PagedWriter<W> {
    out: W,
    /// Written bytes.
    written: u64,
    /// Complete lines that follow in the same page.
    waiting: Vec<u8>,
    /// Last line, which may need padding; empty after a flush.
    last: Vec<u8>,
    /// Length of the longest line so far.
    longest: usize,
}

/// The last line is written by a flush if the page still holds this many of the longest line.
const FREE_LINES: usize = 2;

impl<W: Write> PagedWriter<W> {
    /// Empty table.
    pub fn new(out: W) -> Self {
        Self { out, written: 0, waiting: Vec::with_capacity(PAGE), last: Vec::new(), longest: 0 }
    }

    /// Adds a line, given without its line end.
    ///
    /// # Errors
    /// Writing failed, or the line is longer than a page.
    pub fn line(&mut self, text: &str) -> io::Result<()> {
        if text.len() >= PAGE {
            let why = format!("a line of {} bytes is longer than a page", text.len());
            return Err(io::Error::new(ErrorKind::InvalidInput, why));
        }
        let end = self.end();
        let is_full = end > 0 && end + text.len() + 1 > PAGE;
        if is_full && self.last.is_empty() {
            self.last.push(b'#');
            self.last.truncate(PAGE - end - 1);
        }
        if is_full {
            self.last.resize(PAGE - self.page_used() - 1, b' ');
        }
        if is_full || !self.last.is_empty() {
            self.settle()?;
        }
        self.last.extend_from_slice(text.as_bytes());
        self.longest = self.longest.max(text.len() + 1);
        Ok(())
    }

    /// Writes all lines; the last only if the next one fits in its page too, which is so for most lines.
    ///
    /// # Errors
    /// Writing failed; a partial line may exist beyond [`Self::written`] bytes.
    pub fn flush(&mut self) -> io::Result<()> {
        if !self.last.is_empty() && self.end() + FREE_LINES * self.longest <= PAGE {
            self.settle()?;
        }
        self.write_waiting()
    }

    fn write_waiting(&mut self) -> io::Result<()> {
        self.out.write_all(&self.waiting)?;
        self.written += self.waiting.len() as u64;
        self.waiting.clear();
        self.out.flush()
    }

    /// Writes all lines.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn finish(&mut self) -> io::Result<()> {
        if !self.last.is_empty() {
            self.settle()?;
        }
        self.write_waiting()
    }

    /// Bytes of complete lines in the file.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Underlying writer.
    pub fn out(&mut self) -> &mut W {
        &mut self.out
    }

    /// Terminates the last line.
    fn settle(&mut self) -> io::Result<()> {
        self.waiting.append(&mut self.last);
        self.waiting.push(b'\n');
        if self.page_used() == 0 {
            self.write_waiting()?;
        }
        Ok(())
    }

    /// End of the last line in its page.
    fn end(&self) -> usize {
        let last = if self.last.is_empty() { 0 } else { self.last.len() + 1 };
        (self.page_used() + last) % PAGE
    }

    /// Used bytes of the current page.
    fn page_used(&self) -> usize {
        (self.written as usize + self.waiting.len()) % PAGE
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Records each write separately, as the kernel sees it.
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
        fn writes_end_with_a_line_and_stay_within_a_page(
            lengths in prop::collection::vec((1..PAGE, any::<bool>()), 1..60),
        ) {
            let mut paged = PagedWriter::new(Writes::default());
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
            let read = text.lines().map(str::trim_end);
            let read: Vec<&str> = read.filter(|line| !["", "#"].contains(line)).collect();
            prop_assert_eq!(read, lines);
        }
    }

    #[test]
    fn flush_writes_all_lines_unless_the_page_is_nearly_full() {
        let mut paged = PagedWriter::new(Writes::default());
        for text in ["a", "b", "c"] {
            paged.line(text).unwrap();
        }
        paged.flush().unwrap();
        assert_eq!(paged.out.0.concat(), b"a\nb\nc\n");
        let text = "x".repeat(PAGE / 2);
        paged.line(&text).unwrap();
        paged.flush().unwrap();
        assert_eq!(paged.out.0.concat(), b"a\nb\nc\n");
        paged.finish().unwrap();
        assert_eq!(paged.written(), 6 + text.len() as u64 + 1);
        // The written line cannot be padded.
        paged.line(&text).unwrap();
        paged.finish().unwrap();
        let written = String::from_utf8(paged.out.0.concat()).unwrap();
        let lines: Vec<&str> = written.lines().map(str::trim_end).collect();
        assert_eq!(lines, ["a", "b", "c", &text, "#", &text]);
        assert_eq!(written.rfind(&text), Some(PAGE));
        assert!(paged.line(&"x".repeat(PAGE)).is_err());
    }
}
