//! Uploads of calibrations, with power cuts, into the service that stores them in flash.

use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use firmware::protocol::authentication::{Key, SessionMac};
use firmware::protocol::messages::{CalibrationChunk, Service, ServiceReply};
use firmware::protocol::session::{op, status};
use firmware::system::nv_storage::calibration::{
    CHUNK_BYTES, CHUNKS_PER_GROUP, CalibrationSlots, MAX_BYTES, SLOT_BYTES, SLOTS, UploadError,
};
use firmware::tasks::calibration::{CalibrationOrigin, CalibrationService};

use super::bytes::Bytes;
use super::can::{cmac, session_key};
use super::check::crc32;
use super::store::memory::{FlashModel, PAGE, WORD, block};
use super::store::{OPERATIONS, cut};

const PAGES: usize = (SLOTS * SLOT_BYTES) as usize / PAGE;
type Flash = FlashModel<PAGES>;

/// Maximum number of steps of a sequence.
const STEPS: u32 = 24;
const NODE: u16 = 5;
const KEY: [u8; 16] = *b"sixteen byte key";
const HEADER_BYTES: usize = 16;
/// Version 3, sensors of 2000 G with 0.125 G in a count.
const FORMAT: u32 = 3 << 28 | 2000 << 16 | 12_500;
/// Marks at the start of a slot: sequence and constant, twice.
const MARKS: [[u8; 4]; 2] = [*b"cal1", *b"cal2"];

/// Results of a sequence.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Uploads that were accepted.
    pub accepted: u32,
    /// Complete uploads that were refused for their code.
    pub wrong_codes: u32,
    /// Uploads with the right code that were refused for their header or checksum.
    pub corrupt: u32,
    /// Power cuts during an upload.
    pub interrupted: u32,
    /// Starts with a valid calibration.
    pub found: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<5> {
        [
            ("accepted", self.accepted),
            ("wrong_codes", self.wrong_codes),
            ("corrupt", self.corrupt),
            ("interrupted", self.interrupted),
            ("found", self.found),
        ]
    }
}

/// Slots with any content, then requests, chunks, power cuts and starts.
pub fn upload(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let mut board = Board::new(&mut bytes);
    board.start();
    for _ in 0..STEPS {
        if bytes.is_empty() {
            break;
        }
        board.step(&mut bytes);
        if board.flash.is_off() {
            board.tally.interrupted += 1;
            board.start();
        }
        board.check_newest();
        assert_eq!(board.flash.rewritten, 0, "a word was written again after a torn write");
    }
    board.start();
    board.tally
}

/// Upload in progress, by the rules of the protocol.
struct Upload {
    length: usize,
    received: Vec<u8>,
}

struct Board {
    flash: Flash,
    service: CalibrationService,
    session: SessionMac,
    session_key: [u8; 16],
    upload: Option<Upload>,
    /// Encoded calibrations one of which must be the newest one; `None`: no calibration.
    possible: Vec<Option<Vec<u8>>>,
    /// A slot has both marks: since then a calibration is always found.
    is_certain: bool,
    tally: Tally,
}

impl Board {
    fn new(bytes: &mut Bytes) -> Self {
        let challenge = 7;
        let mut flash = Flash::new(u64::from_le_bytes(bytes.array()));
        let (possible, is_certain) = fill(&mut flash, bytes);
        Self {
            flash,
            service: service(),
            session: SessionMac::new(&Key(KEY), NODE, challenge),
            session_key: session_key(&KEY, NODE, challenge),
            upload: None,
            possible,
            is_certain,
            tally: Tally::default(),
        }
    }

    /// Restores the power. A torn mark may be read differently at each start.
    fn start(&mut self) {
        self.flash.power_on();
        self.service = service();
        self.upload = None;
        self.check_newest();
        self.check_newest();
    }

    fn step(&mut self, bytes: &mut Bytes) {
        let kind = bytes.byte();
        match kind & 7 {
            0 => {
                let length = match kind >> 6 {
                    0 => u32::from(bytes.byte()),
                    1 => MAX_BYTES - 1 + u32::from(kind >> 4 & 3),
                    _ => u32::from_le_bytes(bytes.array()),
                };
                self.begin(length, kind & 8 == 0);
            }
            1 => {
                let number = u16::from(bytes.byte());
                self.send(number, bytes.array());
            }
            2 => {
                let code = u32::from_le_bytes(bytes.array());
                self.finish(code);
            }
            3 => self.flash.cut = cut(bytes, self.flash.operations, OPERATIONS),
            4 => self.start(),
            5 => {
                let page = usize::from(bytes.byte()) % PAGES;
                self.flash.worn[page] = kind & 0xF8 == 0;
            }
            _ => {
                if kind & 8 != 0 {
                    self.flash.cut = cut(bytes, self.flash.operations, 3 * OPERATIONS);
                }
                self.upload_whole(kind, bytes);
            }
        }
    }

    /// An upload as a host sends it, with some chunks lost, repeated or inserted by others.
    fn upload_whole(&mut self, kind: u8, bytes: &mut Bytes) {
        let sent = calibration(bytes);
        self.begin(sent.len() as u32, true);
        while let Some(upload) = &self.upload {
            let at = upload.received.len();
            if at >= sent.len() {
                break;
            }
            let number = at.div_ceil(CHUNK_BYTES) as u16;
            let mut chunk = [0; CHUNK_BYTES];
            let end = sent.len().min(at + CHUNK_BYTES);
            chunk[..end - at].copy_from_slice(&sent[at..end]);
            match bytes.byte() {
                0xFF => return,
                0xFE => self.send(number, bytes.array()),
                0xF8..0xFE => self.send(number + 1 + u16::from(bytes.byte()), chunk),
                0xF0..0xF8 => self.send(number.saturating_sub(1), chunk),
                _ => {}
            }
            self.send(number, chunk);
        }
        // The host computes the code of what it has sent.
        let code = self.code(&sent);
        self.finish(if kind & 0xF0 == 0xF0 { code ^ 1 << (kind & 7) } else { code });
    }

    fn code(&self, sent: &[u8]) -> u32 {
        let code = cmac(&self.session_key, sent.iter().copied());
        u32::from_le_bytes([code[0], code[1], code[2], code[3]])
    }

    fn request(&mut self, op: u8, argument: u32, has_session: bool) -> ServiceReply {
        let session = has_session.then_some(&self.session);
        let request = Service { op, argument };
        let reply = block(self.service.handle_request(&mut self.flash, request, session));
        assert_eq!(reply.op, op);
        reply
    }

    /// Whether an operation of the flash may fail.
    fn may_fail(&self) -> bool {
        self.flash.is_off() || self.flash.worn.contains(&true)
    }

    fn begin(&mut self, length: u32, has_session: bool) {
        let reply = self.request(op::UPLOAD, length, has_session);
        if !has_session {
            assert_eq!(reply.status, status::UNKNOWN);
            return;
        }
        self.upload = None;
        if !(HEADER_BYTES as u32..=MAX_BYTES).contains(&length) {
            assert_eq!(failure(&reply), Some(UploadError::Length as u32));
        } else if failure(&reply).is_none() {
            self.upload = Some(Upload { length: length as usize, received: Vec::new() });
        } else {
            assert_eq!(failure(&reply), Some(UploadError::Flash as u32));
            assert!(self.may_fail());
        }
    }

    fn send(&mut self, number: u16, chunk: [u8; CHUNK_BYTES]) {
        let chunk = CalibrationChunk::new(number, chunk);
        assert_eq!(CalibrationChunk::from_bytes(chunk.to_bytes()), Ok(chunk));
        let reply = block(self.service.receive(&mut self.flash, &chunk));
        let Some(upload) = &mut self.upload else {
            assert_eq!(reply.as_ref().and_then(failure), Some(UploadError::NotBegun as u32));
            return;
        };
        let next = upload.received.len().div_ceil(CHUNK_BYTES);
        if usize::from(number) != next {
            assert_eq!(reply.map(|reply| (reply.status, reply.detail)), Some((0, next as u32)));
            return;
        }
        let used = CHUNK_BYTES.min(upload.length - upload.received.len());
        upload.received.extend_from_slice(&chunk.bytes()[..used]);
        let is_complete = upload.received.len() == upload.length;
        let is_group = upload.received.len().is_multiple_of(CHUNKS_PER_GROUP * CHUNK_BYTES);
        match reply {
            Some(reply) if failure(&reply).is_some() => {
                assert_eq!(failure(&reply), Some(UploadError::Flash as u32));
                assert!(self.may_fail());
                self.upload = None;
            }
            Some(reply) => {
                assert!(is_complete || is_group);
                assert_eq!(reply.detail as usize, upload.received.len().div_ceil(CHUNK_BYTES));
            }
            None => assert!(!is_complete && !is_group),
        }
    }

    fn finish(&mut self, code: u32) {
        let was_off = self.flash.is_off();
        let before = self.newest();
        let reply = self.request(op::FINISH_UPLOAD, code, true);
        let Some(upload) = self.upload.take() else {
            assert_eq!(failure(&reply), Some(UploadError::NotBegun as u32));
            return;
        };
        let has_code = code == self.code(&upload.received);
        let is_valid = upload.received.len() == upload.length && is_valid(&upload.received);
        match failure(&reply) {
            None => {
                assert!(has_code && is_valid && !was_off, "{upload:?}", upload = upload.received);
                self.tally.accepted += 1;
                self.is_certain = true;
                self.possible = vec![Some(upload.received)];
                assert_eq!(self.newest(), self.possible[0]);
            }
            Some(error) if !has_code => {
                assert_eq!(error, UploadError::Code as u32);
                self.tally.wrong_codes += u32::from(upload.received.len() == upload.length);
            }
            Some(error) if !is_valid => {
                assert_eq!(error, UploadError::Corrupt as u32);
                self.tally.corrupt += 1;
            }
            Some(_) => {
                assert!(self.flash.is_off(), "a valid upload was refused");
                // Cut while its marks were written.
                if !was_off {
                    self.possible.push(Some(upload.received));
                    // The next upload may overwrite the other slot, if this one's mark is read then.
                    if !self.is_certain {
                        self.possible.push(None);
                    }
                }
                return;
            }
        }
        if failure(&reply).is_some() && !self.flash.is_off() && self.possible.len() == 1 {
            assert_eq!(self.newest(), before);
        }
    }

    /// The newest calibration with its header.
    fn newest(&mut self) -> Option<Vec<u8>> {
        let slots = CalibrationSlots::new(0);
        let stored = block(slots.newest(&mut self.flash))?;
        let mut whole = vec![0; HEADER_BYTES + stored.length as usize];
        let start = stored.slot * SLOT_BYTES + 2 * WORD as u32;
        block(self.flash.read(start, &mut whole)).expect("a valid calibration can be read");
        assert!(is_valid(&whole), "accepted with a wrong header or checksum");
        assert_eq!(crc32(&whole[HEADER_BYTES..]), stored.crc);
        Some(whole)
    }

    fn check_newest(&mut self) {
        let newest = self.newest();
        assert!(self.possible.contains(&newest), "another calibration than was uploaded");
        self.tally.found += u32::from(newest.is_some());
    }
}

fn service() -> CalibrationService {
    CalibrationService {
        slots: CalibrationSlots::new(0),
        origin: CalibrationOrigin::Linked("linked"),
        defect: None,
    }
}

/// The error of a reply; `None` if the request was served.
fn failure(reply: &ServiceReply) -> Option<u32> {
    match reply.status {
        status::DONE => None,
        status::FAILED => Some(reply.detail),
        other => panic!("status {other}"),
    }
}

/// Whether header and checksum of an encoded calibration are those of its payload.
pub(super) fn is_valid(bytes: &[u8]) -> bool {
    let Some((header, payload)) = bytes.split_at_checked(HEADER_BYTES) else { return false };
    let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|byte| header[at + byte]));
    header[..4] == *b"MGPC"
        && number(4) == FORMAT
        && number(8) as usize == payload.len()
        && number(12) == crc32(payload)
}

/// An encoded calibration with any payload; one in four has a defect.
fn calibration(bytes: &mut Bytes) -> Vec<u8> {
    let (kind, value) = (bytes.byte(), bytes.byte());
    let length = match kind & 15 {
        // Over the end of a page, and exactly to it.
        0 => PAGE + usize::from(value),
        1 => PAGE - 2 * WORD - HEADER_BYTES,
        _ => usize::from(value),
    };
    let payload: Vec<u8> =
        (0..length).map(|at| value.wrapping_mul(3).wrapping_add(at as u8)).collect();
    let mut all = encoded(&payload);
    if kind >> 6 == 3 {
        let at = usize::from(bytes.word()) % all.len();
        match kind >> 4 & 3 {
            0 => all[at] ^= bytes.byte() | 1,
            1 => all[at % HEADER_BYTES] ^= bytes.byte() | 1,
            2 => all.push(value),
            _ => all.truncate(at.max(HEADER_BYTES)),
        }
    }
    all
}

/// Header and payload.
pub(super) fn encoded(payload: &[u8]) -> Vec<u8> {
    let mut all = b"MGPC".to_vec();
    for number in [FORMAT, payload.len() as u32, crc32(payload)] {
        all.extend_from_slice(&number.to_le_bytes());
    }
    all.extend_from_slice(payload);
    all
}

/// Writes any content into the slots; returns the calibrations one of which must count, and whether one has both marks.
fn fill(flash: &mut Flash, bytes: &mut Bytes) -> (Vec<Option<Vec<u8>>>, bool) {
    // Sequence, whether it has its second mark, calibration.
    let mut valid: Vec<(u8, bool, Vec<u8>)> = Vec::new();
    let mut last = None;
    for slot in 0..SLOTS as usize {
        let kind = bytes.byte();
        if kind & 3 == 0 {
            continue;
        }
        // Two slots never have the same sequence.
        let sequence = bytes.byte();
        let sequence = if last == Some(sequence) { sequence ^ 1 } else { sequence };
        last = Some(sequence);
        let content = calibration(bytes);
        let has_mark = [kind & 4 == 0, kind & 8 == 0];
        let mut image = vec![0xFF; 2 * WORD];
        for (number, constant) in MARKS.into_iter().enumerate() {
            if has_mark[number] {
                image[number * WORD] = sequence;
                image[number * WORD + 1..][..3].fill(0);
                image[number * WORD + 4..][..4].copy_from_slice(&constant);
            }
        }
        image.extend_from_slice(&content);
        image.resize(image.len().next_multiple_of(WORD), 0xFF);
        for (number, word) in image.chunks(WORD).enumerate() {
            let at = slot * SLOT_BYTES as usize + number * WORD;
            if word.iter().any(|byte| *byte != 0xFF) {
                block(flash.write(at as u32, word)).expect("the power is on");
            }
        }
        // What follows the payload is not part of the calibration.
        let length = content.get(8..12).map_or(0, |field| {
            u32::from_le_bytes([field[0], field[1], field[2], field[3]]) as usize
        });
        let own = image[2 * WORD..].get(..HEADER_BYTES.saturating_add(length));
        if let Some(own) = own.filter(|own| has_mark.contains(&true) && is_valid(own)) {
            valid.push((sequence, has_mark[1], own.to_vec()));
        }
    }
    valid.sort();
    valid.reverse();
    // A calibration without its second mark may be overwritten in favour of an older one.
    let certain = valid.iter().position(|(_, is_finished, _)| *is_finished);
    let count = certain.map_or(valid.len(), |at| at + 1);
    let possible: Vec<_> = valid.into_iter().take(count).map(|(.., own)| Some(own)).collect();
    (if possible.is_empty() { vec![None] } else { possible }, certain.is_some())
}
