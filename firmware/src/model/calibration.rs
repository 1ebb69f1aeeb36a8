//! Calibration: tables and networks that the device runs.
//!
//! An encoded calibration is 16 bytes of header and a payload; all numbers are little-endian:
//!
//! | bytes | content |
//! | --- | --- |
//! | 0..4 | [`MAGIC`] |
//! | 4..8 | [`FORMAT`] |
//! | 8..12 | length of the payload |
//! | 12..16 | CRC-32 of the payload |
//! | payload | length of the description (16 bits), description (UTF-8), tables and networks ([`Payload`]) |
//!
//! At boot the payload is decoded into [`CalibrationMemory`]: reads from SRAM take no wait states, and the flash can be
//! erased for the next calibration while the device runs. Linked tables and networks are copied there, too, except for lookup
//! tables; if they do not fit, the device runs them from flash.

use core::any::Any;

use crate::compensation::Compensation;
use crate::config::constants;
use crate::estimator::gru::CalibratedBank;
use crate::model::encoding::{Decode, Encode, Reader, Window, visit};
use crate::model::formats::{EXP_ENTRIES, Network, SensorTable, Tables};
use crate::model::integrity::Scrub;
use crate::sensors::hall::SENSORS;

/// First bytes of an encoded calibration.
pub const MAGIC: [u8; 4] = *b"MGPC";
/// Version of the encoding, and scale and range of the sensors for which the tables are; a device refuses others.
pub const FORMAT: u32 = format(constants::SENSOR_SCALE.value, constants::SENSOR_RANGE.value);
/// Version of the encoding. Raised where the fields or the number of an existing table change, together with the literal
/// of `tests/fuzz/src/upload.rs`; a new table with a new number leaves it.
const VERSION: u32 = 3;

/// Format of a calibration for sensors of this scale and range: version in bits 28 to 31, gauss of the range in bits 16 to 27,
/// tens of microgauss of a count in bits 0 to 15. Values beyond are saturated.
pub const fn format(gauss_per_lsb: f64, range_gauss: f64) -> u32 {
    let scale = (gauss_per_lsb * 1e5 + 0.5) as u16;
    let range = (range_gauss + 0.5) as u32;
    let range = if range < 0xFFF { range } else { 0xFFF };
    (VERSION << 28) | (range << 16) | scale as u32
}
/// Bytes before the payload.
pub const HEADER_BYTES: usize = 16;
/// Maximum length of a description in bytes.
pub const MAX_DESCRIPTION_BYTES: usize = 2048;
/// Integers in lookup tables and in tables over the opening, of all sensors.
pub const POOL_INTEGERS: usize = 4608;

/// Size of the networks that can be loaded, one for each sensor: pairs of inputs, pairs of units, sensors. Others are linked.
const LOADABLE: [u8; 3] = [2, 8, 1];
/// A network that can be loaded.
pub type LoadableNetwork = Network<2, 8, 1>;

/// Header of an encoded calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Bytes of the payload.
    pub length: u32,
    /// Its CRC-32.
    pub crc: u32,
}

impl Header {
    /// Encodes the header with a format, see [`format`](fn@format).
    pub fn to_bytes(self, format: u32) -> [u8; HEADER_BYTES] {
        let [a, b, c, d] = MAGIC;
        let numbers = [u32::from_le_bytes([a, b, c, d]), format, self.length, self.crc];
        let mut bytes = [0; HEADER_BYTES];
        for (to, from) in bytes.iter_mut().zip(numbers.map(u32::to_le_bytes).as_flattened()) {
            *to = *from;
        }
        bytes
    }

    /// Decodes a header; `None` if it is of another format.
    pub fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let (numbers, _) = bytes.as_chunks::<4>();
        let [magic, format, length, crc] = numbers else { return None };
        let is_known = *magic == MAGIC && u32::from_le_bytes(*format) == FORMAT;
        is_known
            .then(|| Self { length: u32::from_le_bytes(*length), crc: u32::from_le_bytes(*crc) })
    }
}

/// Tables and networks in the order of their encoding.
pub struct Payload<'v, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// Ideal model and compensation.
    pub tables: &'v Tables<'v>,
    /// Networks of one size.
    pub networks: &'v [Network<INPUTS, HIDDEN, HEADS>],
}

/// The tables with their checksum, pairs of inputs and of units, heads, then the networks with their checksums.
impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> Encode
    for Payload<'_, INPUTS, HIDDEN, HEADS>
{
    const WORDS: usize = 0;

    fn visit(&self, window: &mut Window) {
        visit(self.tables, window);
        visit(&self.tables.check, window);
        for number in [INPUTS, HIDDEN, HEADS, self.networks.len()] {
            visit(&(number as u8), window);
        }
        for network in self.networks {
            visit(network, window);
            visit(&network.check, window);
        }
    }
}

/// Networks of a calibration.
#[derive(Clone, Copy, Debug)]
pub enum Networks<'m, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// In the image's flash.
    Linked(&'m [Network<INPUTS, HIDDEN, HEADS>]),
    /// In memory.
    Loaded(&'m [LoadableNetwork]),
}

impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>
    Networks<'_, INPUTS, HIDDEN, HEADS>
{
    /// The networks for the check of their memory.
    pub fn scrubbed(&self) -> [Option<&dyn Scrub>; SENSORS] {
        fn all<T: Scrub>(networks: &[T]) -> [Option<&dyn Scrub>; SENSORS] {
            let mut networks = networks.iter();
            [(); SENSORS].map(|()| networks.next().map(|network| network as &dyn Scrub))
        }
        match self {
            Self::Linked(networks) => all(networks),
            Self::Loaded(networks) => all(networks),
        }
    }
}

/// Tables and networks that the device runs.
#[derive(Clone, Copy, Debug)]
pub struct Calibration<'m, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> {
    /// Ideal model and compensation.
    pub tables: Tables<'m>,
    /// Recurrent networks.
    pub networks: Networks<'m, INPUTS, HIDDEN, HEADS>,
}

impl<'m, const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>
    Calibration<'m, INPUTS, HIDDEN, HEADS>
{
    /// The networks after a reset.
    pub const fn bank(&self) -> CalibratedBank<'m, INPUTS, HIDDEN, HEADS> {
        CalibratedBank::new(self.networks)
    }
}

/// Memory for a calibration: some 30 KB, all zero when empty, so that a static takes no flash.
pub struct CalibrationMemory<'p> {
    id: u16,
    check: u32,
    exp: [u32; EXP_ENTRIES],
    sensors: [SensorTable; SENSORS],
    used_sensors: usize,
    compensations: Option<&'p [Compensation<'p>]>,
    networks: [LoadableNetwork; SENSORS],
    used_networks: usize,
}

/// Memory for the compensation of a calibration.
pub struct CompensationMemory<'p> {
    compensations: [Compensation<'p>; SENSORS],
}

impl CompensationMemory<'_> {
    /// Memory without a compensation.
    pub const EMPTY: Self = Self { compensations: Decode::ZERO };
}

impl<'p> CalibrationMemory<'p> {
    /// Memory without a calibration.
    pub const EMPTY: Self = Self {
        id: 0,
        check: 0,
        exp: Decode::ZERO,
        sensors: Decode::ZERO,
        used_sensors: 0,
        compensations: None,
        networks: Decode::ZERO,
        used_networks: 0,
    };

    /// Copies tables and networks into the memory, without lookup tables; `None` if they do not fit.
    pub fn copy<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>(
        &mut self,
        payload: &Payload<'p, INPUTS, HIDDEN, HEADS>,
        compensations: &'p mut CompensationMemory<'p>,
    ) -> Option<()> {
        let Payload { tables, networks } = payload;
        (self.id, self.check) = (tables.id, tables.check);
        self.exp = *tables.exp;
        self.used_sensors = copy_items(&mut self.sensors, tables.sensors)?;
        let count = copy_items(&mut compensations.compensations, tables.compensations)?;
        self.compensations = compensations.compensations.get(..count);
        self.used_networks = networks.len();
        let places = self.networks.get_mut(..self.used_networks)?;
        for (place, network) in places.iter_mut().zip(*networks) {
            // A clone would pass over the stack, which is smaller than a network.
            *place = *(network as &dyn Any).downcast_ref()?;
        }
        Some(())
    }

    /// Decodes the payload of a calibration after its description; `None` if it does not fit, or is none.
    pub fn read(
        &mut self,
        reader: &mut Reader<'_, 'p>,
        compensations: &'p mut CompensationMemory<'p>,
    ) -> Option<()> {
        self.id.read(reader)?;
        self.exp.read(reader)?;
        self.used_sensors = read_items(&mut self.sensors, reader)?;
        let count = read_items(&mut compensations.compensations, reader)?;
        self.compensations = compensations.compensations.get(..count);
        self.check.read(reader)?;
        let [inputs, hidden, heads, count] = reader.bytes()?;
        if count > 0 && [inputs, hidden, heads] != LOADABLE {
            return None;
        }
        self.used_networks = usize::from(count);
        for network in self.networks.get_mut(..self.used_networks)? {
            network.read(reader)?;
            network.check.read(reader)?;
        }
        Some(())
    }

    /// The calibration after [`Self::copy`] or [`Self::read`].
    pub fn calibration<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>(
        &self,
    ) -> Calibration<'_, INPUTS, HIDDEN, HEADS> {
        Calibration {
            tables: Tables {
                id: self.id,
                exp: &self.exp,
                sensors: self.sensors.get(..self.used_sensors).unwrap_or_default(),
                compensations: self.compensations.unwrap_or_default(),
                check: self.check,
            },
            networks: Networks::Loaded(self.networks.get(..self.used_networks).unwrap_or_default()),
        }
    }
}

/// Copies items to the beginning of `to`; returns their number.
fn copy_items<T: Copy>(to: &mut [T], items: &[T]) -> Option<usize> {
    to.get_mut(..items.len())?.copy_from_slice(items);
    Some(items.len())
}

/// A number of items, then the items; returns their number.
fn read_items<'p, T: Decode<'p>>(items: &mut [T], reader: &mut Reader<'_, 'p>) -> Option<usize> {
    let count = reader.value::<u32>()? as usize;
    items.get_mut(..count)?.iter_mut().try_for_each(|item| item.read(reader))?;
    Some(count)
}
