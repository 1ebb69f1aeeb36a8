//! Bytes of the sensors, to forces: decoding, the watch, the models with the effects that they undo, the
//! networks, the detector of foreign magnets, and the messages that come of it.

use firmware::compensation::auxiliary_inputs::{Attitude, AuxiliaryInputs, MotorInputs};
use firmware::compensation::covariates::Covariates;
use firmware::config::limits::DetectionLimits;
use firmware::estimator::gru::GruBank;
use firmware::estimator::{Estimate, Estimator, Validity};
use firmware::model::formats::{COORDINATE_LIMIT, Network, SLOPE_BITS, SensorTable, Tables};
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, PacketDecoder, Tick, encode};
use firmware::protocol::{self, messages};
use firmware::sensors::hall::liveness::{LivenessMonitor, MonitoredReading, SensorCondition};
use firmware::sensors::hall::{HallFrame, HallReading, HallSample, SENSORS, a31301, als31300};
use firmware::sensors::imu;

use super::bytes::Bytes;

/// Most ticks of a story.
const TICKS: u32 = 24;
/// Ticks at rest after which no memory of the start is left: the detector needs 256, and each network
/// its own.
const REST: u32 = 512;

/// What a story came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub ticks: u32,
    /// Estimates that may be used.
    pub valid: u32,
    /// Estimates that may not, though there was a reading.
    pub doubtful: u32,
    /// Estimates that a network made.
    pub reported: u32,
    /// Ticks with a foreign magnet.
    pub disturbed: u32,
}

/// Everything between the sensors' buses and the buses to the host.
#[derive(Clone)]
pub struct Chain<'a, const INPUTS: usize, const HIDDEN: usize, const TOLD: usize, const N: usize> {
    tables: &'a Tables<'a>,
    estimator: Estimator<'a, GruBank<'a, INPUTS, HIDDEN, TOLD, N>>,
    watches: [LivenessMonitor; SENSORS],
    /// Steps after a reset in which the networks say nothing.
    warm_up: u32,
    inputs: AuxiliaryInputs,
    /// Fields in the middle of what the tables know, and the greatest forces that they can give.
    middle: [[i16; 3]; SENSORS],
    most: [[i64; 2]; SENSORS],
    latest: [HallReading; SENSORS],
    time_us: u32,
}

impl<'a, const INPUTS: usize, const HIDDEN: usize, const TOLD: usize, const N: usize>
    Chain<'a, INPUTS, HIDDEN, TOLD, N>
{
    /// After a reset.
    pub fn new(tables: &'a Tables<'a>, networks: &'a [Network<INPUTS, HIDDEN, TOLD>; N]) -> Self {
        let sensors: [Option<&SensorTable>; SENSORS] =
            std::array::from_fn(|number| tables.sensor(number));
        let warm_up = networks.iter().map(|network| network.warm_up);
        let middle = |table: &SensorTable| table.scale.map(|axis| (axis.offset >> 4) as i16);
        Self {
            tables,
            estimator: Estimator::new(tables, GruBank::new(networks)),
            watches: [LivenessMonitor::new(&DetectionLimits::GRIPPER); SENSORS],
            warm_up: u32::from(warm_up.max().unwrap_or(0)),
            inputs: AuxiliaryInputs::default(),
            middle: sensors.map(|table| table.map_or([0; 3], middle)),
            most: sensors.map(|table| table.map_or([0; 2], greatest)),
            latest: [HallReading::default(); SENSORS],
            time_us: u32::MAX - 1_000_000,
        }
    }

    /// After a rest, when every memory has settled.
    pub fn rested(mut self) -> Self {
        for tick in 0..REST + self.warm_up {
            let still =
                |number: usize| Some(HallSample::New(self.near(number, [tick as u8 & 3; 3], 0)));
            self.tick(std::array::from_fn(still));
        }
        self
    }

    /// A story of some ticks.
    pub fn sense(mut self, bytes: &[u8]) -> Tally {
        let mut bytes = Bytes::new(bytes);
        let (mut tally, mut last) = (Tally::default(), None);
        while !bytes.is_empty() && tally.ticks < TICKS {
            let kind = bytes.byte();
            if kind & 1 != 0 {
                self.inputs = auxiliary_inputs(&mut bytes);
            }
            let samples = std::array::from_fn(|number| self.sample(number, &mut bytes));
            // The same again and again, or once.
            for _ in 0..=(kind >> 1) & 7 {
                let (frame, estimates) = self.tick(samples);
                tally.count(&estimates);
                last = Some((frame, estimates));
            }
        }
        if let Some((frame, estimates)) = last {
            ticked_rightly(&frame, &estimates);
        }
        tally
    }

    /// What one sensor gives: bytes of either part, nothing, or fields that a finger really brings.
    fn sample(&mut self, number: usize, bytes: &mut Bytes) -> Option<HallSample> {
        let kind = bytes.byte();
        let sample = match kind & 7 {
            0 => None,
            1 => Some(HallSample::Stale),
            2 => {
                let reading = a31301::decode(bytes.array());
                assert_eq!(a31301::decode(a31301::encode(reading)), reading);
                Some(HallSample::New(reading))
            }
            3 => Some(als31300::decode(bytes.array())),
            4 => Some(HallSample::New(self.latest[number])),
            _ => Some(HallSample::New(self.near(number, bytes.array(), kind >> 3))),
        };
        if let Some(HallSample::New(reading)) = sample {
            let (least, greatest) = a31301::FIELD_LIMITS;
            assert!(reading.field.iter().all(|axis| (least..=greatest).contains(axis)));
            assert!((-2048..=2047).contains(&reading.temperature));
            self.latest[number] = reading;
        }
        sample
    }

    /// A field some way from the middle of what the tables know.
    fn near(&self, number: usize, steps: [u8; 3], size: u8) -> HallReading {
        let (least, greatest) = a31301::FIELD_LIMITS;
        let mut steps = steps.into_iter();
        let field = self.middle[number].map(|middle| {
            let step = i16::from(steps.next().unwrap_or(0) as i8) << (size % 7);
            middle.saturating_add(step).clamp(least, greatest)
        });
        HallReading { field, temperature: i16::from(size) }
    }

    /// One tick, as the image runs it.
    fn tick(&mut self, samples: [Option<HallSample>; SENSORS]) -> (HallFrame, [Estimate; SENSORS]) {
        self.time_us = self.time_us.wrapping_add(1000);
        let mut samples = samples.into_iter();
        let readings = self.watches.each_mut().map(|watch| {
            let sample = samples.next().flatten();
            let watched = watch.update(sample);
            watched_rightly(sample, &watched);
            watched.reading
        });
        let frame = HallFrame { time_us: self.time_us, readings };
        let estimates = self.estimator.update(&frame, &self.inputs);
        for (number, estimate) in estimates.iter().enumerate() {
            self.estimated_rightly(number, frame.readings[number], estimate);
            told_rightly(estimate);
            reported_rightly(estimate);
        }
        let [first, others @ ..] = &estimates;
        assert!(others.iter().all(|other| other.disturbed == first.disturbed));
        (frame, estimates)
    }

    fn estimated_rightly(&self, number: usize, reading: Option<HallReading>, estimate: &Estimate) {
        let (Some(reading), Some(table)) = (reading, self.tables.sensor(number)) else {
            let missing = Estimate { disturbed: estimate.disturbed, ..Estimate::MISSING };
            assert_eq!(*estimate, missing);
            return;
        };
        let limit = table.limit_counts.unsigned_abs();
        let full = reading.field.iter().any(|axis| axis.unsigned_abs() >= limit);
        assert_eq!(estimate.validity == Validity::Saturated, full);
        assert_ne!(estimate.validity, Validity::Missing);
        for (shown, most) in estimate.uncompensated.iter().zip(self.most[number]) {
            assert!(i64::from(shown.0).abs() <= most, "{shown:?} of {most}");
        }
        if self.tables.compensation(number).is_none() {
            assert!(estimate.sigma.is_some() || estimate.force == estimate.uncompensated);
            assert!(!estimate.missing_inputs);
        }
    }
}

/// The greatest forces that a table can give, in 1/1024 N: every term of its sums at its greatest, whatever the
/// others are.
fn greatest(table: &SensorTable) -> [i64; 2] {
    let limit = i64::from(COORDINATE_LIMIT);
    std::array::from_fn(|axis| {
        let slopes = table.linear.slope[axis].iter().map(|slope| i64::from(*slope).abs());
        let linear = i64::from(table.linear.bias[axis]).abs()
            + ((slopes.sum::<i64>() * limit) >> SLOPE_BITS);
        let pairs = table.pairs.iter().take(usize::from(table.used_pairs));
        let weights =
            pairs.flat_map(|pair| pair.weight[axis]).map(|weight| i64::from(weight).abs());
        // An exponential is one at the most, which is 2^15; two units for rounding.
        linear + ((weights.sum::<i64>() << 15) >> table.shift[axis]) + 2
    })
}

pub(super) fn auxiliary_inputs(bytes: &mut Bytes) -> AuxiliaryInputs {
    let known = bytes.byte();
    let number = |bytes: &mut Bytes| i32::from_le_bytes(bytes.array());
    AuxiliaryInputs {
        opening_um: (known & 1 != 0).then(|| number(bytes)),
        motor: (known & 2 != 0).then(|| MotorInputs {
            iq_ma: number(bytes),
            electrical: [(); 2].map(|()| i32::from(bytes.word() as i16)),
            angle_urad: number(bytes),
        }),
        acceleration: (known & 4 != 0).then(|| {
            let motion = imu::decode(bytes.array());
            // 4 g and 2294 degrees per second, the parts' ends.
            assert!(motion.acceleration.iter().all(|axis| axis.abs() <= 39_204));
            assert!(motion.rate.iter().all(|axis| axis.abs() <= 2_293_760));
            motion.acceleration
        }),
        attitude: (known & 8 != 0).then(|| Attitude {
            to_world: [(); 3].map(|()| [(); 3].map(|()| i32::from(bytes.word() as i16))),
        }),
    }
}

/// A reading is used only where one came, and only as it came.
fn watched_rightly(sample: Option<HallSample>, watched: &MonitoredReading) {
    match (sample, watched.reading) {
        (Some(HallSample::New(came)), Some(used)) => assert_eq!(came, used),
        (Some(HallSample::New(_)), None) => assert_eq!(watched.condition, SensorCondition::Frozen),
        (_, used) => assert_eq!(used, None),
    }
    assert_eq!(watched.condition == SensorCondition::Live, watched.reading.is_some());
}

/// A network tells both of its standard deviations, or none, and of no sensor that is missing.
fn told_rightly(estimate: &Estimate) {
    match (estimate.sigma, estimate.network_sigma) {
        (None, None) => {}
        (Some(sigma), Some(reported)) => {
            assert_ne!(estimate.validity, Validity::Missing);
            let grown = sigma.iter().zip(&reported).all(|(sigma, reported)| sigma >= reported);
            assert!(grown && reported.iter().all(|sigma| sigma.0 >= 0));
        }
        other => panic!("half a standard deviation: {other:?}"),
    }
}

/// The message says of the force what the estimate says, to half a unit or the end of its range.
fn reported_rightly(estimate: &Estimate) {
    let message = protocol::force_message(estimate, 0);
    assert_eq!(messages::Force::from_bytes(message.to_bytes()), Ok(message));
    for (sent, force) in [message.fx, message.fz].into_iter().zip(estimate.force) {
        // 20 units of 0.05 N in a newton of 1024.
        let exact = f64::from(force.0) * 20.0 / 1024.0;
        let held = exact.clamp(i16::MIN.into(), i16::MAX.into());
        assert!((f64::from(sent) - held).abs() <= 0.5, "{sent} {exact}");
    }
    assert_eq!(message.valid, estimate.validity.is_in_range());
    assert_eq!(message.missing_inputs, estimate.missing_inputs);
    assert_eq!(message.saturated, estimate.validity == Validity::Saturated);
    assert_eq!(message.stale, estimate.validity == Validity::Missing);
    assert_eq!(message.disturbed, estimate.disturbed);
}

/// The packet of a tick fits, and is understood as it was.
fn ticked_rightly(frame: &HallFrame, estimates: &[Estimate; SENSORS]) {
    let packet = Packet::Tick(Tick::of(frame, estimates, Covariates::default()));
    let mut buffer = [0; MAX_PACKET_BYTES];
    let line = encode(&packet, &mut buffer).expect("every packet fits");
    let mut receiver = PacketDecoder::default();
    let back = line.iter().find_map(|byte| receiver.push(*byte));
    assert_eq!(back, Some(packet));
}

impl Tally {
    /// The counters with their names.
    #[allow(dead_code)] // A test has its own minimum for each of its chains.
    pub fn counts(&self) -> super::counters::Counts<5> {
        [
            ("ticks", self.ticks),
            ("valid", self.valid),
            ("doubtful", self.doubtful),
            ("reported", self.reported),
            ("disturbed", self.disturbed),
        ]
    }

    fn count(&mut self, estimates: &[Estimate; SENSORS]) {
        self.ticks += 1;
        self.disturbed += u32::from(estimates[0].disturbed);
        for estimate in estimates {
            self.reported += u32::from(estimate.sigma.is_some());
            match estimate.validity {
                Validity::Valid | Validity::MissingInputs => self.valid += 1,
                Validity::Saturated | Validity::OutsideModel => self.doubtful += 1,
                Validity::Missing => {}
            }
        }
    }
}
