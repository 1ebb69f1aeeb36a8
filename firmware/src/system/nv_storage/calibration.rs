//! Calibrations in flash: two slots, of which the newest complete one is loaded at boot. An upload goes to the other slot and
//! counts only once it was verified, so that a power failure at any time leaves the old or the new calibration.
//!
//! A slot begins with two marks, each a sequence number and a constant, then follows the encoded calibration
//! ([`crate::model::calibration`]). As in the store of the parameters ([`super`]), the first mark is written after the
//! calibration was read back, the second after the first was. A slot with one mark counts, but perhaps not at the next boot,
//! if the power failed within the mark: then the other slot is not overwritten. Only while no upload was ever reported as done
//! may two uploads that were both cut within their marks leave none, and the calibration of the image runs.

use embedded_storage_async::nor_flash::NorFlash;
use heapless::Vec;

use crate::checksum::CRC32;
use crate::model::calibration::{HEADER_BYTES, Header, MAX_DESCRIPTION_BYTES};
use crate::protocol::authentication::DataMac;

/// Bytes of a slot: 32 pages.
pub const SLOT_BYTES: u32 = 64 * 1024;
/// Slots.
pub const SLOTS: u32 = 2;
/// Longest calibration with its header.
pub const MAX_BYTES: u32 = SLOT_BYTES - MARKS_BYTES;
/// Bytes of a message of an upload.
pub const CHUNK_BYTES: usize = 6;
/// Chunks between two acknowledgements.
pub const CHUNKS_PER_GROUP: usize = 4;

const MARK_BYTES: usize = 8;
const MARKS_BYTES: u32 = 2 * MARK_BYTES as u32;
const FIRST_MARK: [u8; 4] = *b"cal1";
const SECOND_MARK: [u8; 4] = *b"cal2";
const GROUP_BYTES: usize = CHUNKS_PER_GROUP * CHUNK_BYTES;
/// Bytes read at once.
const BLOCK_BYTES: usize = 256;

/// A valid calibration in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredCalibration {
    /// Slot, from 0.
    pub slot: u32,
    /// Sequence: that of the previous upload plus one.
    pub sequence: u32,
    /// Length of the payload in bytes.
    pub length: u32,
    /// CRC-32 of the payload.
    pub crc: u32,
    /// Whether it certainly counts at the next boot.
    is_finished: bool,
}

/// Why an upload failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum UploadError {
    /// No upload was begun.
    NotBegun = 1,
    /// Longer than a slot, or shorter than a header.
    Length = 2,
    /// The flash could not be erased or written.
    Flash = 3,
    /// The bytes in flash are not a calibration of this format, or differ from their checksum.
    Corrupt = 4,
    /// The bytes are not those that the host has sent: others were inserted.
    Code = 5,
}

/// An upload in progress.
#[derive(Clone, Debug)]
struct Upload {
    slot: u32,
    sequence: u32,
    /// Bytes of the calibration.
    length: u32,
    /// Bytes written to flash.
    written: u32,
    /// Bytes received after those.
    buffer: Vec<u8, GROUP_BYTES>,
    /// Code of all received bytes.
    mac: DataMac,
}

/// The slots.
#[derive(Clone, Debug)]
pub struct CalibrationSlots {
    /// Offset of the first slot in the flash in bytes, aligned to a page.
    start: u32,
    upload: Option<Upload>,
}

impl CalibrationSlots {
    /// The slots from this offset.
    pub const fn new(start: u32) -> Self {
        Self { start, upload: None }
    }

    /// The calibration that counts: the newest valid one.
    pub async fn newest<F: NorFlash>(&self, flash: &mut F) -> Option<StoredCalibration> {
        let [first, second] = self.scan(flash).await;
        match (first, second) {
            (Some(first), Some(second)) if second.sequence > first.sequence => Some(second),
            (first, second) => first.or(second),
        }
    }

    async fn scan<F: NorFlash>(&self, flash: &mut F) -> [Option<StoredCalibration>; 2] {
        [self.stored(flash, 0).await, self.stored(flash, 1).await]
    }

    async fn stored<F: NorFlash>(&self, flash: &mut F, slot: u32) -> Option<StoredCalibration> {
        let first = self.mark(flash, slot, 0).await;
        let second = self.mark(flash, slot, 1).await;
        let is_finished = second.is_some_and(|(_, mark)| mark == SECOND_MARK);
        let (sequence, _) = match (first, second) {
            (_, Some(mark)) if is_finished => mark,
            (Some(mark), _) if mark.1 == FIRST_MARK => mark,
            _ => return None,
        };
        let header = self.verify(flash, slot).await?;
        let Header { length, crc } = header;
        Some(StoredCalibration { slot, sequence, length, crc, is_finished })
    }

    /// Whether a slot was completed, but its calibration is no longer valid: damaged, or of another format.
    pub async fn has_invalid<F: NorFlash>(&self, flash: &mut F) -> bool {
        for slot in 0..SLOTS {
            let mark = self.mark(flash, slot, 1).await;
            let is_complete = mark.is_some_and(|(_, constant)| constant == SECOND_MARK);
            if is_complete && self.stored(flash, slot).await.is_none() {
                return true;
            }
        }
        false
    }

    /// Sequence and constant of a mark; `None` if it is unreadable.
    async fn mark<F: NorFlash>(
        &self,
        flash: &mut F,
        slot: u32,
        number: u32,
    ) -> Option<(u32, [u8; 4])> {
        let mut mark = [0; MARK_BYTES];
        let at = self.address(slot).saturating_add(number * MARK_BYTES as u32);
        flash.read(at, &mut mark).await.ok()?;
        let [s0, s1, s2, s3, constant @ ..] = mark;
        Some((u32::from_le_bytes([s0, s1, s2, s3]), constant))
    }

    /// The header of a slot whose payload agrees with it.
    async fn verify<F: NorFlash>(&self, flash: &mut F, slot: u32) -> Option<Header> {
        let mut bytes = [0; HEADER_BYTES];
        let mut at = self.address(slot).saturating_add(MARKS_BYTES);
        flash.read(at, &mut bytes).await.ok()?;
        let header = Header::from_bytes(&bytes)?;
        let mut left = header.length;
        if left > MAX_BYTES - HEADER_BYTES as u32 {
            return None;
        }
        at = at.saturating_add(HEADER_BYTES as u32);
        let mut digest = CRC32.digest();
        let mut block = [0; BLOCK_BYTES];
        while left > 0 {
            let part = block.get_mut(..left.min(BLOCK_BYTES as u32) as usize)?;
            flash.read(at, part).await.ok()?;
            digest.update(part);
            at = at.saturating_add(part.len() as u32);
            left = left.saturating_sub(part.len() as u32);
        }
        (digest.finalize() == header.crc).then_some(header)
    }

    /// Reads bytes of a payload; `None` beyond its end.
    pub async fn read<F: NorFlash>(
        &self,
        flash: &mut F,
        stored: &StoredCalibration,
        offset: u32,
        bytes: &mut [u8],
    ) -> Option<()> {
        if offset.checked_add(bytes.len() as u32)? > stored.length {
            return None;
        }
        let payload = self.address(stored.slot).saturating_add(MARKS_BYTES + HEADER_BYTES as u32);
        flash.read(payload.saturating_add(offset), bytes).await.ok()
    }

    /// Length of the description of a stored calibration.
    pub async fn description_bytes<F: NorFlash>(
        &self,
        flash: &mut F,
        stored: &StoredCalibration,
    ) -> Option<u16> {
        let mut length = [0; 2];
        self.read(flash, stored, 0, &mut length).await?;
        let length = u16::from_le_bytes(length);
        (usize::from(length) <= MAX_DESCRIPTION_BYTES).then_some(length)
    }

    /// Begins an upload of `length` bytes, whose code `mac` computes; an earlier one in progress is lost. Erases one page, which
    /// takes 25 ms.
    ///
    /// # Errors
    /// Invalid length, or the flash cannot be erased.
    pub async fn begin<F: NorFlash>(
        &mut self,
        flash: &mut F,
        length: u32,
        mac: DataMac,
    ) -> Result<(), UploadError> {
        self.upload = None;
        if !(HEADER_BYTES as u32..=MAX_BYTES).contains(&length) {
            return Err(UploadError::Length);
        }
        let slots = self.scan(flash).await;
        let newest = slots.iter().flatten().max_by_key(|stored| stored.sequence);
        let kept = slots
            .iter()
            .flatten()
            .filter(|stored| stored.is_finished)
            .max_by_key(|stored| stored.sequence)
            .or(newest);
        let slot = kept.map_or(0, |kept| 1 - kept.slot.min(1));
        // Cannot overflow within the life of the flash.
        let sequence = newest.map_or(1, |newest| newest.sequence.wrapping_add(1));
        let from = self.address(slot);
        let erased = flash.erase(from, from.saturating_add(F::ERASE_SIZE as u32)).await;
        erased.map_err(|_| UploadError::Flash)?;
        self.upload = Some(Upload { slot, sequence, length, written: 0, buffer: Vec::new(), mac });
        Ok(())
    }

    /// Number of the next chunk; 0 without an upload.
    pub fn next_chunk(&self) -> u32 {
        self.upload.as_ref().map_or(0, |upload| {
            let received = upload.written.saturating_add(upload.buffer.len() as u32);
            received.div_ceil(CHUNK_BYTES as u32)
        })
    }

    /// Receives a chunk; the last one may be padded. Returns the number of the next one if it must be acknowledged: after
    /// each group, after the last one, and after any that is not the next, which is ignored.
    ///
    /// # Errors
    /// No upload, or the flash cannot be erased or written: the upload is lost.
    pub async fn receive<F: NorFlash>(
        &mut self,
        flash: &mut F,
        number: u32,
        bytes: [u8; CHUNK_BYTES],
    ) -> Result<Option<u32>, UploadError> {
        let next = self.next_chunk();
        let start = self.start;
        let Some(upload) = &mut self.upload else {
            return Err(UploadError::NotBegun);
        };
        if number != next {
            return Ok(Some(next));
        }
        let left =
            upload.length.saturating_sub(upload.written).saturating_sub(upload.buffer.len() as u32);
        let used = bytes.get(..left.min(CHUNK_BYTES as u32) as usize).unwrap_or_default();
        // The buffer is emptied when it is full.
        let _ = upload.buffer.extend_from_slice(used);
        upload.mac.update(used);
        let is_last = left <= CHUNK_BYTES as u32;
        if upload.buffer.is_full() || is_last {
            let at = start.saturating_add(upload.slot.saturating_mul(SLOT_BYTES));
            if write(flash, at, upload).await.is_none() {
                self.upload = None;
                return Err(UploadError::Flash);
            }
            return Ok(Some(self.next_chunk()));
        }
        Ok(None)
    }

    /// Verifies the received calibration, whose code must be this one, and activates it for the next boot.
    ///
    /// # Errors
    /// Incomplete, corrupt or of somebody else: the previous calibration stays.
    pub async fn finish<F: NorFlash>(
        &mut self,
        flash: &mut F,
        code: u32,
    ) -> Result<StoredCalibration, UploadError> {
        let upload = self.upload.take().ok_or(UploadError::NotBegun)?;
        if upload.mac.clone().finish() != code {
            return Err(UploadError::Code);
        }
        let header = self.verify(flash, upload.slot).await.ok_or(UploadError::Corrupt)?;
        let is_complete = upload.written == upload.length
            && header.length.saturating_add(HEADER_BYTES as u32) == upload.length;
        if !is_complete {
            return Err(UploadError::Corrupt);
        }
        for (number, constant) in [FIRST_MARK, SECOND_MARK].into_iter().enumerate() {
            let mut mark = [0; MARK_BYTES];
            let fields = [upload.sequence.to_le_bytes(), constant];
            mark.copy_from_slice(fields.as_flattened());
            let at = self.address(upload.slot).saturating_add((number * MARK_BYTES) as u32);
            flash.write(at, &mark).await.map_err(|_| UploadError::Flash)?;
            let read = self.mark(flash, upload.slot, number as u32).await;
            if read != Some((upload.sequence, constant)) {
                return Err(UploadError::Flash);
            }
        }
        Ok(StoredCalibration {
            slot: upload.slot,
            sequence: upload.sequence,
            length: header.length,
            crc: header.crc,
            is_finished: true,
        })
    }

    fn address(&self, slot: u32) -> u32 {
        self.start.saturating_add(slot.saturating_mul(SLOT_BYTES))
    }
}

/// Writes the buffer behind what is written; erases each page that it reaches.
async fn write<F: NorFlash>(flash: &mut F, slot: u32, upload: &mut Upload) -> Option<()> {
    let (words, rest) = upload.buffer.as_chunks::<MARK_BYTES>();
    let mut last = [0xFF; MARK_BYTES];
    for (to, from) in last.iter_mut().zip(rest) {
        *to = *from;
    }
    let last = (!rest.is_empty()).then_some(last);
    let mut offset = MARKS_BYTES.saturating_add(upload.written);
    for word in words.iter().chain(&last) {
        if offset.is_multiple_of(F::ERASE_SIZE as u32) {
            let page = slot.saturating_add(offset);
            flash.erase(page, page.saturating_add(F::ERASE_SIZE as u32)).await.ok()?;
        }
        flash.write(slot.saturating_add(offset), word).await.ok()?;
        offset = offset.saturating_add(MARK_BYTES as u32);
    }
    upload.written = upload.written.saturating_add(upload.buffer.len() as u32);
    upload.buffer.clear();
    Some(())
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use embedded_storage_async::nor_flash::ReadNorFlash;

    use super::super::flash_model::{Cut, FlashModel, PAGE, Torn, block};
    use super::*;
    use crate::model::calibration::{FORMAT, format};
    use crate::protocol::authentication::{Key, SessionMac};

    fn mac() -> DataMac {
        SessionMac::new(&Key::NONE, 1, 2).digest()
    }

    fn code(bytes: &[u8]) -> u32 {
        let mut mac = mac();
        mac.update(bytes);
        mac.finish()
    }

    const PAGES: usize = (SLOTS * SLOT_BYTES) as usize / PAGE;
    type Memory = FlashModel<{ PAGES + 1 }>;

    /// A calibration with this payload.
    fn encoded(payload: &[u8]) -> Vec<u8> {
        encoded_as(FORMAT, payload)
    }

    fn encoded_as(format: u32, payload: &[u8]) -> Vec<u8> {
        let (length, crc) = (payload.len() as u32, CRC32.checksum(payload));
        [&Header { length, crc }.to_bytes(format)[..], payload].concat()
    }

    /// A calibration of this length with a payload of one byte's value.
    fn calibration(byte: u8, length: usize) -> Vec<u8> {
        encoded(&std::vec![byte; length - HEADER_BYTES])
    }

    /// Uploads as a host does, which repeats nothing.
    fn upload(flash: &mut Memory, bytes: &[u8]) -> Result<StoredCalibration, UploadError> {
        let mut slots = CalibrationSlots::new(0);
        block(slots.begin(flash, bytes.len() as u32, mac()))?;
        for (number, chunk) in (0..).zip(bytes.chunks(CHUNK_BYTES)) {
            let mut padded = [0; CHUNK_BYTES];
            padded[..chunk.len()].copy_from_slice(chunk);
            block(slots.receive(flash, number, padded))?;
        }
        block(slots.finish(flash, code(bytes)))
    }

    fn newest(flash: &mut Memory) -> Option<u32> {
        let slots = CalibrationSlots::new(0);
        let stored = block(slots.newest(flash))?;
        let mut bytes = [0; 8];
        block(slots.read(flash, &stored, 0, &mut bytes)).expect("a valid calibration is read");
        assert!(bytes.iter().all(|byte| *byte == bytes[0]));
        Some(bytes[0].into())
    }

    #[test]
    fn uploads_alternate_between_the_slots() {
        let mut flash = Memory::new(1);
        assert_eq!(newest(&mut flash), None);
        // What is behind the slots, as the image is before them.
        block(flash.write((PAGES * PAGE) as u32, &[0xA5; PAGE])).unwrap();
        for number in 1..=200 {
            let length = [100, 5000, MAX_BYTES as usize, 30][usize::from(number % 4)];
            let stored = upload(&mut flash, &calibration(number, length)).unwrap();
            assert_eq!((stored.slot, stored.sequence), (1 - u32::from(number % 2), number.into()));
            assert_eq!(newest(&mut flash), Some(number.into()));
        }
        let [slots @ .., behind] = &flash.erasures;
        assert!(slots.iter().all(|erasures| *erasures <= 100) && *behind == 0, "{slots:?}");
        let mut bytes = [0; PAGE];
        block(flash.read((PAGES * PAGE) as u32, &mut bytes)).unwrap();
        assert_eq!(bytes, [0xA5; PAGE]);
    }

    #[test]
    fn calibration_for_other_sensors_is_refused() {
        let mut flash = Memory::new(1);
        for (gauss_per_lsb, range_gauss, is_valid) in [
            (0.125, 2000.0, true),
            (0.1, 2000.0, false),
            (0.125, 1000.0, false),
            (0.25, 4000.0, false),
        ] {
            let bytes = encoded_as(format(gauss_per_lsb, range_gauss), &[7; 100]);
            let result = upload(&mut flash, &bytes);
            assert_eq!(result.is_ok(), is_valid, "{gauss_per_lsb} G, {range_gauss} G");
        }
    }

    #[test]
    fn either_mark_is_sufficient_for_a_valid_calibration() {
        for (damaged, expected) in [
            (&[][..], Some((1, true))),
            // Of the first mark, of the second, of both.
            (&[4], Some((1, true))),
            (&[12], Some((1, false))),
            (&[4, 12], None),
        ] {
            let mut flash = Memory::new(1);
            upload(&mut flash, &calibration(1, 500)).unwrap();
            damaged.iter().for_each(|byte| flash.flip(*byte, 0));
            let stored = block(CalibrationSlots::new(0).newest(&mut flash));
            let found = stored.map(|stored| (stored.sequence, stored.is_finished));
            assert_eq!(found, expected, "{damaged:?}");
        }
    }

    #[test]
    fn payload_is_read_up_to_its_end() {
        let mut flash = Memory::new(1);
        let slots = CalibrationSlots::new(0);
        let payload: Vec<u8> = (1..=16).collect();
        let stored = upload(&mut flash, &encoded(&payload)).unwrap();
        for (offset, count, expected) in
            [(0, 16, Some(1)), (8, 8, Some(9)), (8, 7, Some(9)), (8, 9, None), (16, 1, None)]
        {
            let mut bytes = std::vec![0; count];
            let found = block(slots.read(&mut flash, &stored, offset, &mut bytes));
            assert_eq!(found.map(|()| bytes[0]), expected, "{offset} {count}");
        }
    }

    #[test]
    fn description_has_at_most_2048_bytes() {
        for (length, expected) in
            [(0_u16, Some(0)), (257, Some(257)), (2048, Some(2048)), (2049, None)]
        {
            let mut flash = Memory::new(1);
            let payload = [&length.to_le_bytes()[..], &[0; 40]].concat();
            let stored = upload(&mut flash, &encoded(&payload)).unwrap();
            let found = block(CalibrationSlots::new(0).description_bytes(&mut flash, &stored));
            assert_eq!(found, expected, "{length}");
        }
    }

    #[test]
    fn calibration_beyond_the_end_of_its_slot_is_invalid() {
        // Its last word is the first one of the other slot, and its checksum is right.
        for (length, expected) in [(MAX_BYTES, Some(1)), (MAX_BYTES + 8, None)] {
            let mut flash = Memory::new(1);
            let marks = [&[1, 0, 0, 0][..], &FIRST_MARK, &[1, 0, 0, 0], &SECOND_MARK].concat();
            let image = [marks, calibration(1, length as usize)].concat();
            for (at, word) in (0..).step_by(MARK_BYTES).zip(image.chunks(MARK_BYTES)) {
                block(flash.write(at, word)).unwrap();
            }
            assert_eq!(newest(&mut flash), expected, "{length}");
        }
    }

    #[test]
    fn an_invalid_upload_leaves_the_previous_calibration() {
        let mut flash = Memory::new(1);
        upload(&mut flash, &calibration(1, 500)).unwrap();
        let mut corrupt = calibration(2, 500);
        corrupt[300] ^= 1;
        assert_eq!(upload(&mut flash, &corrupt), Err(UploadError::Corrupt));
        let mut another_format = calibration(2, 500);
        another_format[4] += 1;
        assert_eq!(upload(&mut flash, &another_format), Err(UploadError::Corrupt));
        let mut longer = calibration(2, 500);
        longer.push(0);
        assert_eq!(upload(&mut flash, &longer), Err(UploadError::Corrupt));
        // Behind it are two marks of eight bytes.
        assert_eq!(MAX_BYTES, 65_520);
        let too_long = std::vec![0; MAX_BYTES as usize + 1];
        assert_eq!(upload(&mut flash, &too_long), Err(UploadError::Length));
        let mut slots = CalibrationSlots::new(0);
        assert_eq!(block(slots.finish(&mut flash, 0)), Err(UploadError::NotBegun));
        assert_eq!(block(slots.receive(&mut flash, 0, [0; 6])), Err(UploadError::NotBegun));
        assert_eq!(newest(&mut flash), Some(1));
    }

    #[test]
    fn a_chunk_of_somebody_else_is_detected() {
        let mut flash = Memory::new(1);
        upload(&mut flash, &calibration(1, 500)).unwrap();
        let (sent, forged) = (calibration(2, 500), calibration(3, 500));
        let mut slots = CalibrationSlots::new(0);
        block(slots.begin(&mut flash, 500, mac())).unwrap();
        for (number, chunk) in (0..).zip(forged.chunks(CHUNK_BYTES)) {
            let mut padded = [0; CHUNK_BYTES];
            padded[..chunk.len()].copy_from_slice(chunk);
            block(slots.receive(&mut flash, number, padded)).unwrap();
        }
        assert_eq!(block(slots.finish(&mut flash, code(&sent))), Err(UploadError::Code));
        assert_eq!(newest(&mut flash), Some(1));
    }

    #[test]
    fn a_damaged_calibration_is_reported_and_the_previous_one_counts() {
        let mut flash = Memory::new(1);
        let invalid = |flash: &mut Memory| block(CalibrationSlots::new(0).has_invalid(flash));
        assert!(!invalid(&mut flash));
        upload(&mut flash, &calibration(1, 500)).unwrap();
        upload(&mut flash, &calibration(2, 500)).unwrap();
        assert_eq!((invalid(&mut flash), newest(&mut flash)), (false, Some(2)));
        flash.flip(SLOT_BYTES as usize + 400, 3);
        assert_eq!((invalid(&mut flash), newest(&mut flash)), (true, Some(1)));
        // The next upload overwrites it.
        upload(&mut flash, &calibration(3, 500)).unwrap();
        assert_eq!((invalid(&mut flash), newest(&mut flash)), (false, Some(3)));
    }

    #[test]
    fn lost_and_repeated_chunks_are_asked_for_again() {
        let mut flash = Memory::new(1);
        let bytes = calibration(7, 100);
        let mut slots = CalibrationSlots::new(0);
        block(slots.begin(&mut flash, 100, mac())).unwrap();
        let chunk = |number: usize| {
            let mut padded = [0; CHUNK_BYTES];
            let chunk = &bytes[6 * number..(6 * number + 6).min(100)];
            padded[..chunk.len()].copy_from_slice(chunk);
            padded
        };
        let mut send =
            |number: usize| block(slots.receive(&mut flash, number as u32, chunk(number)));
        assert_eq!([0, 1, 2].map(&mut send), [Ok(None); 3]);
        assert_eq!([4, 1].map(&mut send), [Ok(Some(3)); 2]);
        assert_eq!([3, 4].map(&mut send), [Ok(Some(4)), Ok(None)]);
        let acknowledged = [Ok(None), Ok(None), Ok(Some(8))];
        assert_eq!([5, 6, 7].map(&mut send), acknowledged);
        (8..16).for_each(|number| assert!(send(number).is_ok()));
        // Four bytes are left.
        assert_eq!(send(16), Ok(Some(17)));
        let stored = block(slots.finish(&mut flash, code(&bytes)));
        assert_eq!(stored.map(|stored| stored.length), Ok(84));
    }

    /// After a power cut in any operation of an upload the old or the new calibration counts, and keeps counting over a
    /// second cut in the next upload.
    #[test]
    fn a_power_cut_leaves_the_old_or_the_new_calibration() {
        let [old, new, next] =
            [(1, 2500), (2, 2300), (3, 2100)].map(|(byte, length)| calibration(byte, length));
        let mut flash = Memory::new(5);
        upload(&mut flash, &calibration(9, 3000)).unwrap();
        upload(&mut flash, &old).unwrap();
        let begun = flash.operations;
        let mut full = flash.clone();
        upload(&mut full, &new).unwrap();
        let count = full.operations - begun;
        assert!(count > 200, "{count}");
        let cuts = [
            Cut::Before,
            Cut::After,
            Cut::Half(false),
            Cut::Half(true),
            Cut::Torn(Torn::Erased),
            Cut::Torn(Torn::Intended),
            Cut::Torn(Torn::Mixed(0x8000_0000_0100_0010)),
            Cut::Torn(Torn::Unreadable),
            Cut::Torn(Torn::Varying),
        ];
        let mut seen = [0; 2];
        for operation in 0..count {
            for cut in cuts {
                let mut flash = flash.clone();
                flash.cut = Some((begun + operation, cut));
                let _ = upload(&mut flash, &new);
                assert!(flash.is_off());
                flash.power_on();
                // A torn mark may read differently at each boot.
                for _ in 0..4 {
                    let found = newest(&mut flash).expect("a calibration counts");
                    seen[found as usize - 1] += 1;
                }
                // A second cut at the beginning, in the middle, at the end of the next upload.
                for again in [0, 150, 264] {
                    let mut flash = flash.clone();
                    flash.cut = Some((flash.operations + again, Cut::Torn(Torn::Varying)));
                    let _ = upload(&mut flash, &next);
                    flash.power_on();
                    assert!((0..4).all(|_| newest(&mut flash).is_some()));
                }
                upload(&mut flash, &next).unwrap();
                assert_eq!(newest(&mut flash), Some(3));
            }
        }
        assert!(seen[0] > 10 * count && seen[1] > 10, "{seen:?}");
    }
}
