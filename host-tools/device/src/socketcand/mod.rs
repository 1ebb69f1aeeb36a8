//! A CAN bus over TCP by the protocol of `socketcand`: elements of ASCII text such as `< send 123 2 11 22 >`
//! (<https://github.com/linux-can/socketcand>, `doc/protocol.md`).
//!
//! - here: elements, in both directions.
//! - [`server`]: server side.
//! - [`client`]: client of a gripper on such a bus.

pub mod client;
pub mod server;

use std::fmt;

use embedded_can::{Frame as _, StandardId};
use firmware::protocol::can::CanFrame;

/// Maximum length of an element; a frame has some sixty characters.
const LONGEST: usize = 256;

/// Protocol element.
#[derive(Clone, Debug, PartialEq)]
pub enum Element {
    /// Greeting of the server.
    Hi,
    /// Selection of a bus.
    Open(String),
    /// Request for all frames.
    RawMode,
    /// Connection check and its reply.
    Echo,
    /// Acknowledgement.
    Ok,
    /// Frame from a client.
    Send(CanFrame),
    /// Frame on the bus, with the server's time in microseconds.
    Frame(CanFrame, u64),
    /// Error message.
    Error(String),
}

impl fmt::Display for Element {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hi => f.write_str("< hi >"),
            Self::Open(bus) => write!(f, "< open {bus} >"),
            Self::RawMode => f.write_str("< rawmode >"),
            Self::Echo => f.write_str("< echo >"),
            Self::Ok => f.write_str("< ok >"),
            Self::Send(frame) => {
                write!(f, "< send {:03X} {}", frame.identifier(), frame.dlc())?;
                frame.data().iter().try_for_each(|byte| write!(f, " {byte:02X}"))?;
                f.write_str(" >")
            }
            Self::Frame(frame, time_us) => {
                let (seconds, us) = (time_us / 1_000_000, time_us % 1_000_000);
                write!(f, "< frame {:03X} {seconds}.{us:06} ", frame.identifier())?;
                // Without spaces, as in the original implementation.
                frame.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))?;
                f.write_str(" >")
            }
            Self::Error(reason) => write!(f, "< error {reason} >"),
        }
    }
}

impl Element {
    /// Parses the text between `<` and `>`; the error is the message to the client.
    fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let (name, rest) = (words.next().unwrap_or_default(), words);
        match name {
            "hi" => Ok(Self::Hi),
            "open" => rest
                .last()
                .map(|bus| Self::Open(bus.to_owned()))
                .ok_or_else(|| "open which bus?".to_owned()),
            "rawmode" => Ok(Self::RawMode),
            "echo" => Ok(Self::Echo),
            "ok" => Ok(Self::Ok),
            "error" => Ok(Self::Error(rest.collect::<Vec<_>>().join(" "))),
            "send" => send(&rest.collect::<Vec<_>>()),
            "frame" => frame(&rest.collect::<Vec<_>>()),
            "sendrtr" | "rtr" => Err("remote frames are not supported".to_owned()),
            _ => Err(format!(
                "unknown command {name:?}; this server supports open, rawmode, send and echo"
            )),
        }
    }
}

/// Arguments of `send`: identifier, number of bytes, bytes.
fn send(words: &[&str]) -> Result<Element, String> {
    let [id, length, bytes @ ..] = words else {
        return Err(
            "syntax error: write < send ID LENGTH BYTE... >, as < send 123 2 11 22 >".to_owned()
        );
    };
    let length: usize =
        length.parse().map_err(|_| format!("syntax error: {length:?} is no number of bytes"))?;
    if length > 8 || length != bytes.len() {
        return Err(format!(
            "syntax error: length {length} with {} bytes; a frame has 0 to 8",
            bytes.len()
        ));
    }
    let bytes: Option<Vec<u8>> =
        bytes.iter().map(|byte| u8::from_str_radix(byte, 16).ok()).collect();
    let bytes = bytes.ok_or_else(|| "syntax error: bytes are two hexadecimal digits".to_owned())?;
    can_frame(id, &bytes).map(Element::Send)
}

/// Arguments of `frame`: identifier, time, bytes with or without spaces.
fn frame(words: &[&str]) -> Result<Element, String> {
    let malformed = || format!("syntax error in a frame: {}", words.join(" "));
    let [id, time, bytes @ ..] = words else {
        return Err(malformed());
    };
    let time_us = time.split_once('.').and_then(|(seconds, us)| {
        let (seconds, us): (u64, u64) = (seconds.parse().ok()?, us.parse().ok()?);
        seconds.checked_mul(1_000_000)?.checked_add(us)
    });
    let digits = bytes.concat();
    let pairs = digits.as_bytes().chunks(2).map(|pair| {
        let pair = std::str::from_utf8(pair).ok().filter(|pair| pair.len() == 2)?;
        u8::from_str_radix(pair, 16).ok()
    });
    let bytes: Option<Vec<u8>> = pairs.collect();
    let (time_us, bytes) = time_us.zip(bytes).ok_or_else(malformed)?;
    Ok(Element::Frame(can_frame(id, &bytes)?, time_us))
}

fn can_frame(id: &str, bytes: &[u8]) -> Result<CanFrame, String> {
    let number = u16::from_str_radix(id, 16).ok().and_then(StandardId::new);
    let standard = number.filter(|_| id.len() <= 3);
    let standard = standard.ok_or_else(|| {
        format!("identifier {id} is not standard: three hexadecimal digits up to 7FF")
    })?;
    CanFrame::new(standard, bytes).ok_or_else(|| "a frame has 0 to 8 bytes".to_owned())
}

/// Incremental parser.
#[derive(Default)]
pub struct Elements {
    /// Text of the current element without `<`; `None` between elements.
    text: Option<Vec<u8>>,
}

impl Elements {
    /// Adds a byte; returns a completed element or its error.
    pub fn take(&mut self, byte: u8) -> Option<Result<Element, String>> {
        match (byte, &mut self.text) {
            (b'<', text) => {
                *text = Some(Vec::new());
                None
            }
            (b'>', text) => {
                let text = text.take()?;
                Some(Element::parse(&String::from_utf8_lossy(&text)))
            }
            (_, Some(text)) if text.len() < LONGEST => {
                text.push(byte);
                None
            }
            (_, text) => {
                text.take().map(|_| Err(format!("an element has at most {LONGEST} characters")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn elements(text: &str) -> Vec<Result<Element, String>> {
        let mut elements = Elements::default();
        text.bytes().filter_map(|byte| elements.take(byte)).collect()
    }

    fn can(id: u16, bytes: &[u8]) -> CanFrame {
        CanFrame::new(StandardId::new(id).unwrap(), bytes).unwrap()
    }

    #[test]
    fn elements_round_trip() {
        let all = [
            Element::Hi,
            Element::Open("can0".to_owned()),
            Element::RawMode,
            Element::Echo,
            Element::Ok,
            Element::Send(can(0x203, &[0x11, 0, 0xFF])),
            Element::Send(can(0x7FF, &[])),
            Element::Frame(can(0x123, &[1, 2, 3, 4, 5, 6, 7, 8]), 23_424_242),
            Element::Frame(can(0, &[]), 5),
            Element::Error("no such bus".to_owned()),
        ];
        for element in all {
            let text = element.to_string();
            assert_eq!(elements(&text), [Ok(element)], "{text}");
        }
    }

    #[test]
    fn examples_of_the_protocol_parse() {
        let found = elements(
            "< open can0 >< rawmode > < send 123 4 11 22 33 44 >\n< frame 123 23.424242 11 22 33 44 >",
        );
        let frame = can(0x123, &[0x11, 0x22, 0x33, 0x44]);
        let expected = [
            Ok(Element::Open("can0".to_owned())),
            Ok(Element::RawMode),
            Ok(Element::Send(frame)),
            Ok(Element::Frame(frame, 23_424_242)),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn malformed_elements_do_not_affect_the_next() {
        let long = format!("<{}", "x".repeat(2 * LONGEST));
        for wrong in [
            "< send 123 >",
            "< send 123 9 1 2 3 4 5 6 7 8 9 >",
            "< send 123 2 11 >",
            "< send 800 0 >",
            "< send 1AAAAAAA 0 >",
            "< send 123 1 GG >",
            "< frame 123 x 11 >",
            "< frame 123 1.5 111 >",
            "< sendrtr 123 0 >",
            "< subscribe 0 0 123 >",
            "<>",
            &long,
        ] {
            let found = elements(&format!("{wrong}< echo >"));
            assert!(matches!(&found[..], [Err(_), Ok(Element::Echo)]), "{wrong}: {found:?}");
        }
    }
}
