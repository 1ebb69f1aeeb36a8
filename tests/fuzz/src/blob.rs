//! Encoded calibrations: any bytes, and mutations of valid ones, decoded as at boot, and estimates with the result.

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::compensation::crosstalk::{
    EarthFieldTable, KNOTS, MotorLeakageTable, NeighbourMagnetTable,
};
use firmware::compensation::flexure::{
    CreepTable, FingertipMassTable, HardStopTable, ViscousLagTable,
};
use firmware::compensation::hysteresis::{HysteresisTable, Slider};
use firmware::compensation::lookup_table::{
    Covariate, CovariateFilter, FieldMap, ForceMap, LookupAxis, LookupTable,
};
use firmware::compensation::thermal::{
    MagnetTemperatureTable, SensorTemperatureTable, ThermalGapTable,
};
use firmware::compensation::{Compensation, FieldEffect, ForceEffect};
use firmware::estimator::{Estimator, Validity};
use firmware::fixed_point::{Field, Force};
use firmware::model::calibration::{
    Calibration, CalibrationMemory, CompensationMemory, LoadableNetwork, MAX_DESCRIPTION_BYTES,
    Networks, POOL_INTEGERS, Payload,
};
use firmware::model::encoding::{Encode, Reader, encode};
use firmware::model::formats::{
    Guard, Head, Input, InputSource, Network, Tables, Target, UnitPair, Weights,
};
use firmware::protocol;
use firmware::sensors::hall::{HallFrame, HallReading};
use firmware::system::nv_storage::calibration::{CalibrationSlots, MAX_BYTES, SLOT_BYTES};
use firmware::tasks::calibration::{
    CalibrationDefect, CalibrationOrigin, LinkedCalibration, Memories, load_calibration,
};

use super::bytes::Bytes;
use super::sensing::auxiliary_inputs;
use super::store::memory::block;
use super::upload::{encoded, is_valid};

/// Maximum number of mutations of a valid calibration.
const MUTATIONS: usize = 8;
/// Ticks for which forces are estimated.
const TICKS: u32 = 6;
/// Values at the ends of the number ranges.
const EXTREMES: [u32; 8] =
    [0, 1, u32::MAX, 0x7FFF_FFFF, 0x8000_0000, 0x7FFF_7FFF, 0x8000_8000, 0x0001_0000];

/// Results of a calibration.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub decoded: u32,
    /// Decoded with compensated effects.
    pub effects: u32,
    /// Decoded with networks.
    pub networks: u32,
    /// Refused for header or checksum.
    pub invalid: u32,
    /// Refused by the decoder, with the right checksum.
    pub undecodable: u32,
    /// Estimates that may be used.
    pub estimates: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<6> {
        [
            ("decoded", self.decoded),
            ("effects", self.effects),
            ("networks", self.networks),
            ("invalid", self.invalid),
            ("undecodable", self.undecodable),
            ("estimates", self.estimates),
        ]
    }
}

/// Valid calibrations that are mutated.
pub struct Seeds<'t> {
    tables: &'t Tables<'t>,
    /// Encoded after the description, with the offsets of their parts.
    encoded: [(Vec<u8>, Vec<usize>); 4],
}

/// Indices of [`Seeds::encoded`].
const LINKED: usize = 0;
const TWO_SENSORS: usize = 1;
const NETWORK: usize = 2;
const ONE_SENSOR: usize = 3;

impl<'t> Seeds<'t> {
    /// The calibration of these tables; of two of its sensors with all effects; of one with a network; and of one with all
    /// effects but the longest, the table over the opening. Short ones, because the time of an execution is proportional to the
    /// number of integers.
    pub fn new(tables: &'t Tables<'t>) -> Self {
        let knots: [[i32; 3]; KNOTS] =
            std::array::from_fn(|at| [40, -30, 20].map(|k| k - at as i32));
        let values: Vec<i32> = (0..12).map(|at| 50 * at - 200).collect();
        let compensations = [0, 1].map(|number| compensation(number, &knots, &values));
        let [mut short, _] = compensations;
        short.field = short.field.map(|effect| {
            effect.filter(|effect| !matches!(effect, FieldEffect::NeighbourMagnet(_)))
        });
        let first = |count: usize| tables.sensors.get(..count).unwrap_or(tables.sensors);
        let with =
            |count, compensations| Tables { sensors: first(count), compensations, ..*tables };
        let encoded = [
            parts(tables, &[]),
            parts(&with(2, &compensations), &[]),
            parts(&with(1, &[]), &[network(0)]),
            parts(&with(1, &[short]), &[]),
        ];
        Self { tables, encoded }
    }

    /// One calibration: decoded, encoded again, and used.
    pub fn decode(&self, bytes: &[u8]) -> Tally {
        let mut bytes = Bytes::new(bytes);
        let mut tally = Tally::default();
        let kind = bytes.byte();
        let (image, is_encoded) = self.image(kind, &mut bytes);
        let mut flash = Slot(image);
        // Either mark is enough; the second one is written last.
        let is_complete = flash.0[12..16] == *b"cal2";
        let is_marked = is_complete || flash.0[4..8] == *b"cal1";
        let length = u32::from_le_bytes([24, 25, 26, 27].map(|at| flash.byte(at))) as usize;
        let own = flash.0.get(16..).and_then(|own| own.get(..length.checked_add(16)?));
        // The checksum that was just computed is not computed again.
        let is_valid =
            own.is_some_and(|own| own.len() <= MAX_BYTES as usize && (is_encoded || is_valid(own)));

        let mut pool = vec![0; POOL_INTEGERS];
        let mut compensations = CompensationMemory::EMPTY;
        let mut memory = Box::new(CalibrationMemory::EMPTY);
        let linked = LinkedCalibration::<2, 8, 1> {
            payload: Payload { tables: self.tables, networks: &[] },
            description: "linked",
        };
        let memories = Memories {
            calibration: &mut memory,
            compensations: &mut compensations,
            pool: &mut pool,
        };
        let slots = CalibrationSlots::new(0);
        let (calibration, origin, defect) =
            block(load_calibration(&slots, &mut flash, memories, &linked));
        match (origin, defect) {
            (CalibrationOrigin::Stored(stored), None) => {
                assert!(is_marked && is_valid);
                assert_eq!(stored.length as usize, length);
                tally.decoded = 1;
                tally.effects = u32::from(!calibration.tables.compensations.is_empty());
                tally.networks = u32::from(networks(&calibration).is_some_and(|n| !n.is_empty()));
                check_encoding(&calibration, &flash.0[32..]);
            }
            (CalibrationOrigin::Linked(_), Some(CalibrationDefect::Undecodable)) => {
                assert!(is_marked && is_valid);
                tally.undecodable = 1;
                assert_eq!(calibration.tables.check, self.tables.check);
            }
            (CalibrationOrigin::Linked(_), defect) => {
                assert!(!is_valid || !is_marked);
                assert_eq!(defect.is_some(), is_complete && !is_valid);
                tally.invalid = 1;
                assert_eq!(calibration.tables.check, self.tables.check);
            }
            other => panic!("a stored calibration with a defect: {other:?}"),
        }
        tally.estimates = estimates(&calibration, &mut bytes);
        tally
    }

    /// Marks, header, and a payload of the kind; whether header and checksum are those of the payload.
    fn image(&self, kind: u8, bytes: &mut Bytes) -> (Vec<u8>, bool) {
        let mut image = [&[1, 0, 0, 0][..], b"cal1", &[1, 0, 0, 0], b"cal2"].concat();
        // Either mark may be missing. With the second one the start verifies the checksum twice.
        match kind >> 5 {
            0..6 => image[8..16].fill(0xFF),
            6 => image[..8].fill(0xFF),
            _ => {}
        }
        let count = usize::from(bytes.byte());
        let payload = match kind & 7 {
            // Any bytes after header and checksum, or also in their place.
            0 => bytes.some(count).to_vec(),
            1 => {
                let some = bytes.some(count);
                image.extend_from_slice(some);
                image.resize(image.len().max(64), 0xFF);
                return (image, false);
            }
            choice => {
                let seed = match (choice, kind >> 3 & 3) {
                    (2, 0) => LINKED,
                    (2, 1) => TWO_SENSORS,
                    (2 | 3, _) => NETWORK,
                    _ => ONE_SENSOR,
                };
                let (valid, parts) = &self.encoded[seed];
                let mut valid = valid.clone();
                for _ in 0..count % MUTATIONS {
                    mutate(&mut valid, parts, bytes);
                }
                let length = match bytes.byte() {
                    0xFF => bytes.word(),
                    short => u16::from(short & 7),
                };
                let mut payload = length.to_le_bytes().to_vec();
                payload.resize(2 + usize::from(length).min(MAX_DESCRIPTION_BYTES + 8), b'#');
                payload.append(&mut valid);
                payload
            }
        };
        image.extend(encoded(&payload));
        let is_changed = kind >> 3 == 31;
        if is_changed {
            let at = usize::from(bytes.word()) % image.len();
            image[at] ^= bytes.byte();
        }
        (image, !is_changed)
    }
}

/// Changes one place of an encoded calibration, in one of its parts.
fn mutate(valid: &mut Vec<u8>, parts: &[usize], bytes: &mut Bytes) {
    let (kind, part) = (bytes.byte(), bytes.byte());
    let start = parts[usize::from(part) % parts.len()];
    let at = start + usize::from(bytes.word()) % 0x1000;
    if at >= valid.len() {
        return;
    }
    let mut set = |new: &[u8]| {
        for (place, new) in valid[at..].iter_mut().zip(new) {
            *place = *new;
        }
    };
    match kind & 7 {
        0 => set(&bytes.array::<4>()),
        1 | 2 => set(&EXTREMES[usize::from(kind >> 3) % EXTREMES.len()].to_le_bytes()),
        3 => set(&EXTREMES[usize::from(kind >> 3) % EXTREMES.len()].to_le_bytes()[..2]),
        4 => set(&[bytes.byte()]),
        5 => valid[at] ^= 1 << (kind >> 5),
        6 => valid.truncate(at),
        _ => {
            valid.insert(at, bytes.byte());
        }
    }
}

/// Tables and networks as bytes, with the offsets of their parts: tables, exponential, sensors, compensations, single
/// effects, networks.
fn parts(tables: &Tables, networks: &[LoadableNetwork]) -> (Vec<u8>, Vec<usize>) {
    let bytes = bytes_of(&Payload { tables, networks });
    let mut parts = vec![0];
    let mut at = 2 + 4 * tables.exp.len();
    for sensor in tables.sensors {
        parts.push(at);
        at += bytes_of(sensor).len();
        // Behind the pairs of centres.
        parts.push(at - 130);
    }
    at += 4;
    for compensation in tables.compensations {
        parts.push(at);
        let mut effect = at + 5;
        for field in &compensation.field {
            parts.push(effect);
            effect += bytes_of(field).len();
        }
        for force in &compensation.force {
            parts.push(effect);
            effect += bytes_of(force).len();
        }
        at += bytes_of(compensation).len();
    }
    parts.push(at);
    for network in networks {
        parts.push(at + 8);
        at += bytes_of(network).len();
    }
    (bytes, parts)
}

fn bytes_of(value: &impl Encode) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 << 14);
    encode(value, &mut |part| bytes.extend_from_slice(part));
    bytes
}

fn networks<'c>(calibration: &Calibration<'c, 2, 8, 1>) -> Option<&'c [LoadableNetwork]> {
    match calibration.networks {
        Networks::Loaded(networks) => Some(networks),
        Networks::Linked(_) => None,
    }
}

/// A decoded calibration is encoded to its bytes, after the description in the payload, or to others that are decoded to the
/// same one.
fn check_encoding(calibration: &Calibration<2, 8, 1>, payload: &[u8]) {
    let networks = networks(calibration).expect("a decoded calibration is in memory");
    let bytes = bytes_of(&Payload { tables: &calibration.tables, networks });
    let description = usize::from(u16::from_le_bytes([payload[0], payload[1]]));
    if payload[2 + description..].starts_with(&bytes) {
        return;
    }
    let mut pool = vec![0; POOL_INTEGERS];
    let mut compensations = CompensationMemory::EMPTY;
    let mut memory = Box::new(CalibrationMemory::EMPTY);
    let mut left = &bytes[..];
    let mut source = |to: &mut [u8]| {
        let (next, rest) = left.split_at_checked(to.len())?;
        to.copy_from_slice(next);
        left = rest;
        Some(())
    };
    let read = memory.read(&mut Reader::new(&mut source, &mut pool), &mut compensations);
    assert_eq!(read, Some(()));
    let again = memory.calibration::<2, 8, 1>();
    let Networks::Loaded(again_networks) = again.networks else { panic!("not in memory") };
    assert_eq!(again_networks, networks);
    assert_eq!(again.tables.sensors, calibration.tables.sensors);
    let again = bytes_of(&Payload { tables: &again.tables, networks: again_networks });
    assert!(again == bytes, "another encoding of the same calibration");
}

/// Estimates forces; returns the number that may be used.
fn estimates(calibration: &Calibration<2, 8, 1>, bytes: &mut Bytes) -> u32 {
    let tables = calibration.tables;
    let mut estimator = Estimator::new(&tables, calibration.bank());
    let (mut usable, mut time_us) = (0, u32::MAX - 2000);
    for _ in 0..TICKS {
        let kind = bytes.byte();
        let inputs = match kind & 3 {
            0 => AuxiliaryInputs::default(),
            _ => auxiliary_inputs(bytes),
        };
        let readings = std::array::from_fn(|number| {
            let middle = tables.sensor(number).map_or([0; 3], |table| {
                table.scale.map(|axis| (axis.offset >> 4).clamp(-15_000, 15_000) as i16)
            });
            let field = match kind & 12 {
                0 => middle,
                4 => middle.map(|axis| axis + i16::from(bytes.byte() as i8)),
                8 => [(); 3].map(|()| bytes.word() as i16),
                _ => return None,
            };
            Some(HallReading { field, temperature: i16::from(bytes.byte() as i8) })
        });
        time_us = time_us.wrapping_add(1000);
        let frame = HallFrame { time_us, readings };
        for estimate in estimator.update(&frame, &inputs) {
            usable +=
                u32::from(matches!(estimate.validity, Validity::Valid | Validity::MissingInputs));
            let _ = protocol::force_message(&estimate, 0).to_bytes();
        }
    }
    usable
}

/// A small network for one sensor, without warm-up.
fn network(sensor: usize) -> LoadableNetwork {
    let sensor = sensor as u8;
    let input = |source| Input { source, offset: 100, gain: 3000 };
    let pair = |at: usize| [at as i16 * 37 - 90, 70 - at as i16 * 11];
    Network {
        sensors: [sensor],
        target: if sensor & 1 == 0 { Target::Rest } else { Target::Force },
        inputs: [
            [
                input(InputSource::Field { sensor, axis: 0 }),
                input(InputSource::Field { sensor, axis: 2 }),
            ],
            [input(InputSource::Ideal { sensor, axis: 1 }), input(InputSource::None)],
        ],
        force: [5000, 6000],
        warm_up: 0,
        guards: [Guard {
            residual: [Field(-100), Field(100)],
            force: [300, 400],
            deviation: [Force(2000); 2],
        }],
        weights: Weights {
            first: std::array::from_fn(|unit| UnitPair {
                bias: [[1000, -2000, 3000 * unit as i32]; 2],
                input: [[[pair(unit); 3]; 2]; 2],
                state_bias: [500, -700],
                state: [[[pair(unit + 1); 3]; 2]; 8],
            }),
            second: std::array::from_fn(|unit| UnitPair {
                bias: [[-1000, 2000, 1000 * unit as i32]; 2],
                input: [[[pair(unit); 3]; 2]; 8],
                state_bias: [300, 900],
                state: [[[pair(unit + 2); 3]; 2]; 8],
            }),
            heads: [Head { bias: [1 << 20; 4], weights: [[pair(3); 4]; 8] }],
        },
        check: 0,
    }
    .checked()
}

/// All effects, in two halves.
fn compensation<'a>(number: u8, knots: &'a [[i32; 3]], values: &'a [i32]) -> Compensation<'a> {
    let side = |covariate, knots| Some(LookupAxis { covariate, from: -100, step: 50, knots });
    let over_force = LookupTable { sides: [side(Covariate::Force(0), 12), None, None], values };
    let over_three = LookupTable {
        sides: [
            side(Covariate::Opening, 2),
            side(Covariate::Lagged(0), 3),
            side(Covariate::Rate(1), 2),
        ],
        values,
    };
    let filter = |covariate| Some(CovariateFilter { covariate, gain: 1 << 26 });
    let rows = [[20, -30, 40], [5, 6, -7], [-80, 9, 10]];
    let slider = Slider { reach: 900, share: 20_000 };
    let fields = [
        FieldEffect::SensorTemperature(SensorTemperatureTable { offset: [3, -4, 5], gain: 1000 }),
        FieldEffect::MotorLeakage(MotorLeakageTable { per_ma: rows }),
        FieldEffect::EarthField(EarthFieldTable { world: [40, 50, -60], element: rows }),
        FieldEffect::NeighbourMagnet(NeighbourMagnetTable { knots }),
        FieldEffect::Map(FieldMap { table: over_force, along: [20_000, -400, 300], matrix: rows }),
        FieldEffect::MagnetTemperature(MagnetTemperatureTable {
            without: [100, 200, -300],
            per_count: 4000,
        }),
        FieldEffect::ThermalGap(ThermalGapTable {
            at: [7, 8, 9],
            rest: [100, -90, 80],
            bend: rows,
        }),
    ];
    let forces = [
        ForceEffect::ViscousLag(ViscousLagTable { lead: [9000, 8000], rate: 3000 }),
        ForceEffect::Creep(CreepTable { share: [[3000, 2000]; 2], rate: [1 << 15, 1 << 12] }),
        ForceEffect::HardStop(HardStopTable { knee: [90_000; 2], beyond: [[30_000, 40_000]; 2] }),
        ForceEffect::Hysteresis(HysteresisTable { sliders: [[slider; 3]; 2] }),
        ForceEffect::FingertipMass(FingertipMassTable { mass: 40_000 }),
        ForceEffect::Map(ForceMap { table: over_three, along: [70_000, -90_000] }),
    ];
    let half = usize::from(number & 1);
    Compensation {
        number,
        filters: [filter(Covariate::Temperature), filter(Covariate::Force(1)), None, None],
        field: std::array::from_fn(|at| fields.get(at + 3 * half).copied()),
        force: std::array::from_fn(|at| forces.get(at + 2 * half).copied()),
    }
}

/// The first slot with these bytes; all others are erased.
struct Slot(Vec<u8>);

impl Slot {
    fn byte(&self, at: usize) -> u8 {
        self.0.get(at).copied().unwrap_or(0xFF)
    }
}

/// Error of an operation that the start does not need, or beyond the end.
#[derive(Debug)]
struct Refused;

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl ErrorType for Slot {
    type Error = Refused;
}

impl ReadNorFlash for Slot {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        let start = offset as usize;
        // Most reads are of a single integer within the image.
        if let Some(own) = self.0.get(start..start + bytes.len()) {
            bytes.copy_from_slice(own);
            return Ok(());
        }
        if start + bytes.len() > self.capacity() {
            return Err(Refused);
        }
        let own = self.0.get(start..).unwrap_or_default();
        let (known, erased) = bytes.split_at_mut(own.len().min(bytes.len()));
        known.copy_from_slice(&own[..known.len()]);
        erased.fill(0xFF);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SLOT_BYTES as usize
    }
}

impl NorFlash for Slot {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = 2048;

    async fn erase(&mut self, _: u32, _: u32) -> Result<(), Refused> {
        Err(Refused)
    }

    async fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Refused> {
        Err(Refused)
    }
}
