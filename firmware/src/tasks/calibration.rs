//! Loads the calibration at boot, and serves uploads of new ones.

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::NorFlash;

use crate::model::calibration::{
    Calibration, CalibrationMemory, CompensationMemory, Networks, Payload,
};
use crate::model::encoding::Reader;
use crate::protocol::authentication::SessionMac;
use crate::protocol::messages::{CalibrationChunk, Service, ServiceReply};
use crate::protocol::session::{op, service_reply, status};
use crate::system::nv_storage::calibration::{CalibrationSlots, StoredCalibration};

/// Calibration of the image: used as long as none is stored.
pub struct LinkedCalibration<'m, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// Tables and networks.
    pub payload: Payload<'m, INPUTS, HIDDEN, HEADS>,
    /// Description of their origin.
    pub description: &'static str,
}

/// Where the running calibration comes from.
#[derive(Clone, Copy, Debug)]
pub enum CalibrationOrigin {
    /// From the image, with its description.
    Linked(&'static str),
    /// From a slot in flash.
    Stored(StoredCalibration),
}

/// Why a stored calibration is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CalibrationDefect {
    /// Damaged in flash, or of another format.
    Invalid = 1,
    /// Larger than this image has memory for, or with values that no model has.
    Undecodable = 2,
}

/// Memory that a calibration is decoded into.
pub struct Memories<'m> {
    /// Tables and networks.
    pub calibration: &'m mut CalibrationMemory<'m>,
    /// Effects.
    pub compensations: &'m mut CompensationMemory<'m>,
    /// Lookup tables.
    pub pool: &'m mut [i32],
}

/// Loads the newest valid calibration in flash, or else the linked one. The defect is that of a newer one that is not used.
pub async fn load_calibration<
    'm,
    F: NorFlash,
    const INPUTS: usize,
    const HIDDEN: usize,
    const HEADS: usize,
>(
    slots: &CalibrationSlots,
    flash: &mut F,
    memory: Memories<'m>,
    linked: &LinkedCalibration<'m, INPUTS, HIDDEN, HEADS>,
) -> (Calibration<'m, INPUTS, HIDDEN, HEADS>, CalibrationOrigin, Option<CalibrationDefect>) {
    let Memories { calibration, compensations, pool } = memory;
    let Payload { tables, networks } = &linked.payload;
    let stored = slots.newest(flash).await;
    let invalid = slots.has_invalid(flash).await.then_some(CalibrationDefect::Invalid);
    let is_read = match &stored {
        Some(stored) => match slots.description_bytes(flash, stored).await {
            Some(length) => {
                let mut at = u32::from(length).saturating_add(size_of::<u16>() as u32);
                // Reads of flash are ready at once; the decoder is not asynchronous.
                let mut source = |bytes: &mut [u8]| {
                    block_on(slots.read(flash, stored, at, bytes))?;
                    at = at.saturating_add(bytes.len() as u32);
                    Some(())
                };
                calibration.read(&mut Reader::new(&mut source, pool), compensations)
            }
            None => None,
        },
        None => calibration.copy(&linked.payload, compensations),
    };
    let linked_origin = CalibrationOrigin::Linked(linked.description);
    let (origin, defect) = match (is_read, stored) {
        (Some(()), Some(stored)) => (CalibrationOrigin::Stored(stored), invalid),
        (None, Some(_)) => (linked_origin, Some(CalibrationDefect::Undecodable)),
        (_, None) => (linked_origin, invalid),
    };
    let running = match is_read {
        Some(()) => calibration.calibration(),
        None => Calibration { tables: **tables, networks: Networks::Linked(networks) },
    };
    (running, origin, defect)
}

/// Serves the description of the running calibration and uploads.
pub struct CalibrationService {
    /// Calibrations in flash.
    pub slots: CalibrationSlots,
    /// Origin of the running one.
    pub origin: CalibrationOrigin,
    /// Why a newer one does not run.
    pub defect: Option<CalibrationDefect>,
}

impl CalibrationService {
    /// Executes a service request; an upload gets its code from the session that begins it.
    pub async fn handle_request<F: NorFlash>(
        &mut self,
        flash: &mut F,
        request: Service,
        session: Option<&SessionMac>,
    ) -> ServiceReply {
        let result = match (request.op, session) {
            (op::DESCRIPTION, _) => {
                let detail = self.description(flash, request.argument).await;
                let status = if detail.is_some() { status::DONE } else { status::FAILED };
                return ServiceReply {
                    extra: request.argument as u16,
                    ..service_reply(request, status, detail.unwrap_or(0))
                };
            }
            (op::UPLOAD, Some(mac)) => {
                self.slots.begin(flash, request.argument, mac.digest()).await.map(|()| 0)
            }
            (op::FINISH_UPLOAD, _) => {
                self.slots.finish(flash, request.argument).await.map(|stored| stored.sequence)
            }
            _ => return service_reply(request, status::UNKNOWN, 0),
        };
        match result {
            Ok(detail) => service_reply(request, status::DONE, detail),
            Err(error) => service_reply(request, status::FAILED, error as u32),
        }
    }

    /// Receives a chunk; returns the reply, if any.
    pub async fn receive<F: NorFlash>(
        &mut self,
        flash: &mut F,
        chunk: &CalibrationChunk,
    ) -> Option<ServiceReply> {
        let request = Service { op: op::UPLOAD, argument: 0 };
        match self.slots.receive(flash, chunk.number.into(), chunk.bytes()).await {
            Ok(next) => Some(service_reply(request, status::DONE, next?)),
            Err(error) => Some(service_reply(request, status::FAILED, error as u32)),
        }
    }

    /// Four bytes of the description, or its length and origin ([`op::DESCRIPTION`]).
    async fn description<F: NorFlash>(&self, flash: &mut F, argument: u32) -> Option<u32> {
        let length = match &self.origin {
            CalibrationOrigin::Linked(text) => text.len() as u32,
            CalibrationOrigin::Stored(stored) => {
                self.slots.description_bytes(flash, stored).await?.into()
            }
        };
        let Some(place) = argument.checked_sub(1) else {
            let origin = match &self.origin {
                CalibrationOrigin::Linked(_) => 0,
                CalibrationOrigin::Stored(stored) => stored.slot.saturating_add(1),
            };
            return Some(length & 0xFFFF | origin << 16);
        };
        let from = place.saturating_mul(4);
        let count = length.checked_sub(from).filter(|left| *left > 0)?.min(4);
        let mut bytes = [0; 4];
        let used = bytes.get_mut(..count as usize)?;
        match &self.origin {
            CalibrationOrigin::Linked(text) => {
                let from = from as usize;
                used.copy_from_slice(text.as_bytes().get(from..from.checked_add(used.len())?)?);
            }
            CalibrationOrigin::Stored(stored) => {
                let from = from.saturating_add(size_of::<u16>() as u32);
                self.slots.read(flash, stored, from, used).await?;
            }
        }
        Some(u32::from_le_bytes(bytes))
    }
}

impl CalibrationChunk {
    /// A chunk of these bytes.
    pub fn new(number: u16, [b0, b1, b2, b3, b4, b5]: [u8; 6]) -> Self {
        let low = u32::from_le_bytes([b0, b1, b2, b3]);
        Self { number, low, high: u16::from_le_bytes([b4, b5]) }
    }

    /// Its bytes.
    pub fn bytes(&self) -> [u8; 6] {
        let ([b0, b1, b2, b3], [b4, b5]) = (self.low.to_le_bytes(), self.high.to_le_bytes());
        [b0, b1, b2, b3, b4, b5]
    }
}
