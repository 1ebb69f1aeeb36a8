//! Sensor drivers on a mocked bus: every byte of every transfer, and the propagation of bus errors.

use std::cell::RefCell;
use std::rc::Rc;
use std::task::Poll;

use embassy_futures::poll_once;
use embedded_hal::spi::{ErrorKind as SpiError, Operation, SpiBus};
use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use embedded_hal_mock::eh1::{delay, digital, spi};
use firmware::motor::as5047::{As5047, PipelinedSpi};
use firmware::motor::power_stage::{Encoder, EncoderError};
use firmware::sensors::hall::a31301::A31301;
use firmware::sensors::hall::als31300::Als31300;
use firmware::sensors::hall::{self, HallReading, HallSample, HallSensor, TRANSFER_BYTES};
use firmware::sensors::imu::{Imu, ImuError, ImuReading, Lsm6ds3};

fn bus_errors() -> [ErrorKind; 7] {
    use ErrorKind::{ArbitrationLoss, Bus, NoAcknowledge, Other, Overrun};
    use embedded_hal_async::i2c::NoAcknowledgeSource::{Address, Data, Unknown};
    [
        NoAcknowledge(Address),
        NoAcknowledge(Data),
        NoAcknowledge(Unknown),
        Bus,
        ArbitrationLoss,
        Overrun,
        Other,
    ]
}

/// Polls a driver once: it awaits only the bus, which is always ready.
fn poll<T>(driver: impl Future<Output = T>) -> T {
    match poll_once(driver) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("the driver awaits something besides the bus"),
    }
}

/// Reads a measurement by exactly this transfer.
fn read<P: HallSensor>(address: u8, transfer: Transaction) -> Result<HallSample, ErrorKind> {
    let mut bus = Mock::new(&[transfer]);
    let mut bytes = [0; TRANSFER_BYTES];
    let read = poll(hall::read_registers(&mut bus, address, P::READING, &mut bytes));
    bus.done();
    read.map(|()| P::decode(bytes))
}

#[test]
fn the_a31301_is_read_from_0x1c_at_each_address() {
    assert_eq!(A31301::ADDRESSES, [0x60, 0x63, 0x6C, 0x6F]);
    for address in A31301::ADDRESSES {
        // T = 0x123, X = 0x0102 = 258, Y = -2 with the spare bit 15 clear, Z = 0x3FFF, the maximum.
        let answer = vec![0x01, 0x23, 0x01, 0x02, 0x7F, 0xFE, 0x3F, 0xFF];
        let transfer = Transaction::write_read(address, vec![0x1C], answer);
        let reading = HallReading { field: [258, -2, 16383], temperature: 0x123 };
        assert_eq!(read::<A31301>(address, transfer), Ok(HallSample::New(reading)));
    }
}

#[test]
fn the_als31300_is_read_from_0x28_at_each_address() {
    assert_eq!(Als31300::ADDRESSES, [0x60, 0x61, 0x62, 0x63]);
    for address in Als31300::ADDRESSES {
        // Upper: X = 0x01., Y = 0xFF., Z = 0x80., new (bit 7), temperature 0b011010...; lower: X ..0,
        // Y ..F, Z ..1, temperature ...101100. X = 16 G, Y = -1 G, Z = -2047 G.
        let answer = vec![0x01, 0xFF, 0x80, 0b1001_1010, 0x00, 0x00, 0xF1, 0b0010_1100];
        let transfer = Transaction::write_read(address, vec![0x28], answer);
        // 0b011010_101100 = 1708 is 0 C: 25 K below 25 C are 200 counts of 1/8 K.
        let reading = HallReading { field: [128, -8, -16376], temperature: -200 };
        assert_eq!(read::<Als31300>(address, transfer), Ok(HallSample::New(reading)));
    }
}

#[test]
fn an_als31300_without_new_data_gives_a_stale_sample() {
    let answer = vec![0x01, 0xFF, 0x80, 0b0001_1010, 0x00, 0x00, 0xF1, 0b0010_1100];
    let transfer = Transaction::write_read(0x62, vec![0x28], answer);
    assert_eq!(read::<Als31300>(0x62, transfer), Ok(HallSample::Stale));
}

#[test]
fn bus_errors_of_hall_sensors_are_returned() {
    for error in bus_errors() {
        for address in A31301::ADDRESSES {
            let failing =
                Transaction::write_read(address, vec![0x1C], vec![0; 8]).with_error(error);
            assert_eq!(read::<A31301>(address, failing), Err(error));
        }
        for address in Als31300::ADDRESSES {
            let failing =
                Transaction::write_read(address, vec![0x28], vec![0; 8]).with_error(error);
            assert_eq!(read::<Als31300>(address, failing), Err(error));
        }
    }
}

/// Transfers of a register of the inertial sensor: with bit 7 of the address set it is read.
fn register(address: u8, value: Vec<u8>) -> Vec<spi::Transaction<u8>> {
    // The answer begins with the second byte.
    let sent = [&[0x80 | address][..], &vec![0; value.len()]].concat();
    exchange(sent, [&[0][..], &value].concat())
}

fn exchange(sent: Vec<u8>, received: Vec<u8>) -> Vec<spi::Transaction<u8>> {
    use spi::Transaction;
    vec![
        Transaction::transaction_start(),
        Transaction::transfer_in_place(sent, received),
        Transaction::transaction_end(),
    ]
}

/// Transfers of a setting that is read back as this value.
fn setting(address: u8, value: u8, read_back: u8) -> Vec<spi::Transaction<u8>> {
    let mut transfers = exchange(vec![address, value], vec![0; 2]);
    transfers.extend(register(address, vec![read_back]));
    transfers
}

/// Starts an LSM6DS3TR-C by exactly these transfers and this number of waits for its power-up.
fn start(transfers: &[Vec<spi::Transaction<u8>>], waits: usize) -> Result<(), ImuError<SpiError>> {
    let mut bus = spi::Mock::new(&transfers.concat());
    let mut delay = delay::CheckedDelay::new(&vec![delay::Transaction::async_delay_ms(15); waits]);
    let started = poll(Lsm6ds3::new(bus.clone()).start(&mut delay));
    bus.done();
    delay.done();
    started
}

#[test]
fn the_lsm6ds3_is_configured_and_the_settings_read_back() {
    // Block update and auto-increment (CTRL3_C); 833 Hz and +-4 g (CTRL1_XL), +-2000 degrees per second (CTRL2_G).
    let identity = register(0x0F, vec![0x6A]);
    let [block, acceleration, rate] =
        [(0x12, 0x44), (0x10, 0x78), (0x11, 0x7C)].map(|(at, value)| setting(at, value, value));
    let absent = register(0x0F, vec![0xFF]);
    let settings = [block.clone(), acceleration, rate];
    let transfers = [&[identity.clone()][..], &settings].concat();
    assert_eq!(start(&transfers, 0), Ok(()));
    // Powered up during the first two attempts.
    assert_eq!(start(&[&[absent.clone(), absent][..], &transfers].concat(), 2), Ok(()));
    // A setting that is not accepted.
    let refused = setting(0x10, 0x78, 0x70);
    assert_eq!(start(&[identity, block, refused], 0), Err(ImuError::NotConfigured(0x10)));
}

#[test]
fn another_identity_is_returned_without_a_write() {
    // The LSM6DS3 without TR-C, an LSM6DSO, an undriven bus.
    for found in [0x69, 0x6C, 0xFF] {
        let identity = register(0x0F, vec![found]);
        let transfers = [identity.clone(), identity.clone(), identity];
        assert_eq!(start(&transfers, 2), Err(ImuError::UnexpectedDevice(found)));
    }
}

#[test]
fn the_lsm6ds3_is_read_from_0x22() {
    let answer = vec![
        0x00, 0x80, 0xFF, 0x7F, 0x01, 0x00, // -32768, 32767 and 1 count of 70 mdps
        0x00, 0x80, 0xFF, 0x7F, 0x05, 0x20, // -32768, 32767 and 8197 counts of 0.122 mg
    ];
    // 0.122e-3 * 9806.65 mm/s^2 are 1.1964113: by 32768 39204.0, by 32767 39202.8, by 8197 9807.0.
    let expected =
        ImuReading { rate: [-2_293_760, 2_293_690, 70], acceleration: [-39_204, 39_203, 9_807] };
    let mut bus = spi::Mock::new(&register(0x22, answer));
    assert_eq!(poll(Lsm6ds3::new(bus.clone()).read()), Ok(expected));
    bus.done();
}

#[test]
fn a_silent_lsm6ds3_is_an_error() {
    for level in [0x00, 0xFF] {
        let mut bus = spi::Mock::new(&register(0x22, vec![level; 12]));
        let read = poll(Lsm6ds3::new(bus.clone()).read());
        assert_eq!(read, Err(ImuError::UnexpectedDevice(level)));
        bus.done();
    }
}

/// An SPI device without answers whose transactions fail from one on.
struct FailingDevice {
    remaining: usize,
    error: SpiError,
}

impl embedded_hal_async::spi::ErrorType for FailingDevice {
    type Error = SpiError;
}

impl embedded_hal_async::spi::SpiDevice for FailingDevice {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), SpiError> {
        self.remaining = self.remaining.checked_sub(1).ok_or(self.error)?;
        for operation in operations {
            if let Operation::TransferInPlace(bytes) = operation {
                bytes.fill(0x6A);
            }
        }
        Ok(())
    }
}

#[test]
fn bus_errors_of_the_lsm6ds3_are_returned() {
    use SpiError::{ChipSelectFault, FrameFormat, ModeFault, Other, Overrun};
    for error in [ChipSelectFault, FrameFormat, ModeFault, Other, Overrun] {
        // The identity; then the first setting and its read-back.
        for remaining in 0..3 {
            let device = FailingDevice { remaining, error };
            let started = poll(Lsm6ds3::new(device).start(&mut delay::NoopDelay));
            assert_eq!(started, Err(ImuError::Bus(error)), "{remaining}");
        }
        let device = FailingDevice { remaining: 0, error };
        assert_eq!(poll(Lsm6ds3::new(device).read()), Err(ImuError::Bus(error)));
    }
}

/// Bus of the rotor sensor: a mock, and the frame that is under way.
struct RotorBus {
    bus: spi::Mock<u16>,
    started: Rc<RefCell<Vec<u16>>>,
    received: Option<u16>,
}

impl embedded_hal::spi::ErrorType for RotorBus {
    type Error = SpiError;
}

impl SpiBus<u16> for RotorBus {
    fn read(&mut self, words: &mut [u16]) -> Result<(), SpiError> {
        SpiBus::read(&mut self.bus, words)
    }
    fn write(&mut self, words: &[u16]) -> Result<(), SpiError> {
        SpiBus::write(&mut self.bus, words)
    }
    fn transfer(&mut self, read: &mut [u16], write: &[u16]) -> Result<(), SpiError> {
        SpiBus::transfer(&mut self.bus, read, write)
    }
    fn transfer_in_place(&mut self, words: &mut [u16]) -> Result<(), SpiError> {
        SpiBus::transfer_in_place(&mut self.bus, words)
    }
    fn flush(&mut self) -> Result<(), SpiError> {
        SpiBus::flush(&mut self.bus)
    }
}

impl PipelinedSpi for RotorBus {
    fn start_frame(&mut self, word: u16) {
        self.started.borrow_mut().push(word);
    }

    fn take_received(&mut self) -> Option<u16> {
        self.received.take()
    }
}

/// Starts an AS5047P whose answers to the frames of successive attempts are these.
fn start_rotor_sensor(attempts: &[[u16; 2]]) -> Result<(), EncoderError> {
    // The error register is read; its content is in the answer to the next command, which is no operation.
    let frame = |command, answer| {
        [
            spi::Transaction::transfer_in_place(vec![command], vec![answer]),
            spi::Transaction::flush(),
        ]
    };
    let pair = |&[first, second]: &[u16; 2]| [frame(0x4001, first), frame(0xC000, second)].concat();
    let bus = spi::Mock::new(&attempts.iter().flat_map(pair).collect::<Vec<_>>());
    // Each frame is enclosed by the chip select, with more than 350 ns before each edge to low and each frame.
    let edges = [digital::State::Low, digital::State::High].repeat(2 * attempts.len());
    let edges: Vec<_> = edges.into_iter().map(digital::Transaction::set).collect();
    let select = digital::Mock::new(&edges);
    let waits = |attempt| {
        let mut waits = vec![delay::Transaction::blocking_delay_ns(1350); 4];
        if attempt > 0 {
            waits.insert(0, delay::Transaction::blocking_delay_ms(10));
        }
        waits
    };
    let mut delay =
        delay::CheckedDelay::new(&(0..attempts.len()).flat_map(waits).collect::<Vec<_>>());
    let (mut used_bus, mut used_select) = (bus.clone(), select.clone());
    let bus = RotorBus { bus, started: Rc::default(), received: None };
    let started = As5047::new(bus, select).start(&mut delay);
    used_bus.done();
    used_select.done();
    delay.done();
    started
}

#[test]
fn the_as5047p_starts_when_its_error_register_is_clear() {
    // The answer to the command before the first is not evaluated.
    assert_eq!(start_rotor_sensor(&[[0xFFFF, 0]]), Ok(()));
    // A framing error with its flag, cleared by the read; a broken parity; not yet powered.
    assert_eq!(start_rotor_sensor(&[[0, 0x4001], [0, 0]]), Ok(()));
    assert_eq!(start_rotor_sensor(&[[0, 0x0001], [0, 0]]), Ok(()));
    assert_eq!(start_rotor_sensor(&[[0xFFFF; 2], [0xFFFF; 2], [0, 0]]), Ok(()));
}

#[test]
fn the_as5047p_start_returns_the_last_error() {
    let silent = [0xFFFF; 2];
    let expected = [(0xFFFF, EncoderError::Silent), (0x0001, EncoderError::Checksum)];
    for (last, error) in expected.into_iter().chain([(0x8001, EncoderError::ErrorFlag)]) {
        assert_eq!(start_rotor_sensor(&[silent, silent, [0, last]]), Err(error));
    }
}

#[test]
fn the_angle_is_requested_in_one_period_and_read_in_the_next() {
    // The select line rises when the answer is read and falls before the next frame.
    let edges = [digital::State::High, digital::State::Low].map(digital::Transaction::set);
    for (received, expected) in [
        (Some(0x0003), Ok(3)),
        (Some(0x0001), Err(EncoderError::Checksum)),
        (None, Err(EncoderError::Silent)),
    ] {
        let mut select = digital::Mock::new(&edges);
        let (mut mock, started) = (spi::Mock::new(&[]), Rc::default());
        let bus = RotorBus { bus: mock.clone(), started: Rc::clone(&started), received };
        let mut sensor = As5047::new(bus, select.clone());
        assert_eq!(sensor.angle(), expected);
        sensor.select().unwrap();
        sensor.start_frame();
        select.done();
        mock.done();
        assert_eq!(*started.borrow(), [0xFFFF]);
    }
}
