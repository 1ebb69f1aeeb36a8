//! Sensor drivers on a mocked bus: every byte of every transfer, and the propagation of bus errors.

use std::task::Poll;

use embassy_futures::poll_once;
use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use firmware::sensors::hall::a31301::A31301;
use firmware::sensors::hall::als31300::Als31300;
use firmware::sensors::hall::{self, HallReading, HallSample, HallSensor, TRANSFER_BYTES};
use firmware::sensors::imu::{Imu, ImuError, ImuReading, Lsm6ds3};

/// 7-bit addresses of the inertial sensor selected by its strap SA0 (datasheet).
const IMU_ADDRESSES: [u8; 2] = [0x6A, 0x6B];

/// All kinds of bus errors.
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

/// Transfers of the configuration of an LSM6DS3TR-C: identity; block update and auto-increment (CTRL3_C); 833 Hz and
/// +-4 g (CTRL1_XL); 833 Hz and +-2000 degrees per second (CTRL2_G).
fn configuration(address: u8) -> [Transaction; 4] {
    [
        Transaction::write_read(address, vec![0x0F], vec![0x6A]),
        Transaction::write(address, vec![0x12, 0x44]),
        Transaction::write(address, vec![0x10, 0x78]),
        Transaction::write(address, vec![0x11, 0x7C]),
    ]
}

fn start(address: u8, transfers: &[Transaction]) -> Result<(), ImuError<ErrorKind>> {
    let mut bus = Mock::new(transfers);
    let started = poll(Lsm6ds3::new(bus.clone(), address).start());
    bus.done();
    started
}

fn measure(address: u8, transfer: Transaction) -> Result<ImuReading, ImuError<ErrorKind>> {
    let mut bus = Mock::new(&[transfer]);
    let reading = poll(Lsm6ds3::new(bus.clone(), address).read());
    bus.done();
    reading
}

#[test]
fn the_lsm6ds3_is_configured_at_each_address() {
    for address in IMU_ADDRESSES {
        assert_eq!(start(address, &configuration(address)), Ok(()));
    }
}

#[test]
fn the_lsm6ds3_is_read_from_0x22() {
    for address in IMU_ADDRESSES {
        let answer = vec![
            0x00, 0x80, 0xFF, 0x7F, 0x01, 0x00, // -32768, 32767 and 1 count of 70 mdps
            0x00, 0x80, 0xFF, 0x7F, 0x05, 0x20, // -32768, 32767 and 8197 counts of 0.122 mg
        ];
        let transfer = Transaction::write_read(address, vec![0x22], answer);
        // 0.122e-3 * 9806.65 mm/s^2 are 1.1964113: by 32768 39204.0, by 32767 39202.8, by 8197 9807.0.
        let expected = ImuReading {
            turn: [-2_293_760, 2_293_690, 70],
            acceleration: [-39_204, 39_203, 9_807],
        };
        assert_eq!(measure(address, transfer), Ok(expected));
    }
}

#[test]
fn another_identity_is_returned_without_a_write() {
    // The LSM6DS3 without TR-C, an LSM6DSO, an undriven bus.
    for found in [0x69, 0x6C, 0xFF] {
        for address in IMU_ADDRESSES {
            let identity = Transaction::write_read(address, vec![0x0F], vec![found]);
            assert_eq!(start(address, &[identity]), Err(ImuError::UnexpectedDevice(found)));
        }
    }
}

#[test]
fn a_bus_error_aborts_the_configuration() {
    for (error, address) in bus_errors().into_iter().zip(IMU_ADDRESSES.into_iter().cycle()) {
        for last in 0..configuration(address).len() {
            let mut transfers = configuration(address)[..=last].to_vec();
            let failing = transfers.pop().unwrap().with_error(error);
            transfers.push(failing);
            assert_eq!(start(address, &transfers), Err(ImuError::Bus(error)), "{last}");
        }
    }
}

#[test]
fn bus_errors_of_the_lsm6ds3_are_returned() {
    for error in bus_errors() {
        for address in IMU_ADDRESSES {
            let failing =
                Transaction::write_read(address, vec![0x22], vec![0; 12]).with_error(error);
            assert_eq!(measure(address, failing), Err(ImuError::Bus(error)));
        }
    }
}
