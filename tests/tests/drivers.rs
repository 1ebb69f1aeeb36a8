//! The sensors' drivers on a bus that knows every byte: what is written, what is read, in which
//! transfer, and that every way in which a transfer breaks off arrives as what it is.

use std::task::Poll;

use embassy_futures::poll_once;
use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use firmware::hall::a31301::A31301;
use firmware::hall::als31300::Als31300;
use firmware::hall::{self, Part, Reading, Sample, TRANSFER_BYTES};
use firmware::imu::lsm6ds3::{self, Lsm6ds3};
use firmware::imu::{Imu, Motion, Trouble};

/// 7-bit addresses of the inertial sensor by its strap SA0, from its datasheet.
const IMU_ADDRESSES: [u8; 2] = [0x6A, 0x6B];

/// Every way in which a transfer can break off.
fn breaks() -> [ErrorKind; 7] {
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

/// A driver waits for nothing but the bus, and this bus never waits.
fn at_once<T>(driver: impl Future<Output = T>) -> T {
    match poll_once(driver) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("the driver waits for something that is not the bus"),
    }
}

/// Reads a part once over a bus on which this transfer happens and no other.
fn read<P: Part>(address: u8, transfer: Transaction) -> Result<Sample, ErrorKind> {
    let mut bus = Mock::new(&[transfer]);
    let mut bytes = [0; TRANSFER_BYTES];
    let read = at_once(hall::read(&mut bus, address, P::READING, &mut bytes));
    bus.done();
    read.map(|()| P::decode(bytes))
}

#[test]
fn an_a31301_is_asked_for_0x1c_and_answers_eight_bytes_at_each_of_its_addresses() {
    assert_eq!(A31301::ADDRESSES, [0x60, 0x63, 0x6C, 0x6F]);
    for address in A31301::ADDRESSES {
        // T = 0x123, X = 0x0102 = 258, Y = -2 with the unknown bit 15 clear, Z = 0x3FFF, the greatest.
        let answer = vec![0x01, 0x23, 0x01, 0x02, 0x7F, 0xFE, 0x3F, 0xFF];
        let transfer = Transaction::write_read(address, vec![0x1C], answer);
        let reading = Reading {
            field: [258, -2, 16383],
            temperature: 0x123,
        };
        assert_eq!(read::<A31301>(address, transfer), Ok(Sample::New(reading)));
    }
}

#[test]
fn an_als31300_is_asked_for_0x28_and_answers_eight_bytes_at_each_of_its_addresses() {
    assert_eq!(Als31300::ADDRESSES, [0x60, 0x61, 0x62, 0x63]);
    for address in Als31300::ADDRESSES {
        // Upper: X = 0x01., Y = 0xFF., Z = 0x80., new (bit 7), temperature 0b011010...; lower: X ..0,
        // Y ..F, Z ..1, temperature ...101100. X = 16 G, Y = -1 G, Z = -2047 G.
        let answer = vec![0x01, 0xFF, 0x80, 0b1001_1010, 0x00, 0x00, 0xF1, 0b0010_1100];
        let transfer = Transaction::write_read(address, vec![0x28], answer);
        // 0b011010_101100 = 1708 is 0 C: 25 K below 25 C are 200 counts of 1/8 K.
        let reading = Reading {
            field: [128, -8, -16376],
            temperature: -200,
        };
        assert_eq!(
            read::<Als31300>(address, transfer),
            Ok(Sample::New(reading))
        );
    }
}

#[test]
fn an_als31300_that_has_nothing_new_says_so_over_the_bus() {
    let answer = vec![0x01, 0xFF, 0x80, 0b0001_1010, 0x00, 0x00, 0xF1, 0b0010_1100];
    let transfer = Transaction::write_read(0x62, vec![0x28], answer);
    assert_eq!(read::<Als31300>(0x62, transfer), Ok(Sample::Old));
}

#[test]
fn every_break_of_a_hall_sensor_s_transfer_arrives_as_what_it_is_and_nothing_is_sent_after_it() {
    for error in breaks() {
        for address in A31301::ADDRESSES {
            let broken = Transaction::write_read(address, vec![0x1C], vec![0; 8]).with_error(error);
            assert_eq!(read::<A31301>(address, broken), Err(error));
        }
        for address in Als31300::ADDRESSES {
            let broken = Transaction::write_read(address, vec![0x28], vec![0; 8]).with_error(error);
            assert_eq!(read::<Als31300>(address, broken), Err(error));
        }
    }
}

/// Every transfer that wakes an LSM6DS3TR-C up: who it is; whole samples, and an address that moves on
/// (CTRL3_C); 833 Hz and +-4 g (CTRL1_XL); 833 Hz and +-2000 degrees per second (CTRL2_G).
fn waking(address: u8) -> [Transaction; 4] {
    [
        Transaction::write_read(address, vec![0x0F], vec![0x6A]),
        Transaction::write(address, vec![0x12, 0x44]),
        Transaction::write(address, vec![0x10, 0x78]),
        Transaction::write(address, vec![0x11, 0x7C]),
    ]
}

fn start(address: u8, transfers: &[Transaction]) -> Result<(), Trouble<ErrorKind>> {
    let mut bus = Mock::new(transfers);
    let started = at_once(Lsm6ds3::new(bus.clone(), address).start());
    bus.done();
    started
}

fn motion(address: u8, transfer: Transaction) -> Result<Motion, Trouble<ErrorKind>> {
    let mut bus = Mock::new(&[transfer]);
    let motion = at_once(Lsm6ds3::new(bus.clone(), address).read());
    bus.done();
    motion
}

#[test]
fn an_lsm6ds3tr_c_is_woken_up_by_these_four_transfers_at_each_of_its_addresses() {
    assert_eq!(lsm6ds3::ADDRESS, IMU_ADDRESSES[0]);
    for address in IMU_ADDRESSES {
        assert_eq!(start(address, &waking(address)), Ok(()));
    }
}

#[test]
fn an_lsm6ds3tr_c_is_asked_for_0x22_and_answers_turn_then_acceleration() {
    for address in IMU_ADDRESSES {
        let answer = vec![
            0x00, 0x80, 0xFF, 0x7F, 0x01, 0x00, // -32768, 32767 and 1 count of 70 mdps
            0x00, 0x80, 0xFF, 0x7F, 0x05, 0x20, // -32768, 32767 and 8197 counts of 0.122 mg
        ];
        let transfer = Transaction::write_read(address, vec![0x22], answer);
        // 0.122e-3 * 9806.65 mm/s^2 are 1.1964113: by 32768 39204.0, by 32767 39202.8, by 8197 9807.0.
        let expected = Motion {
            turn: [-2_293_760, 2_293_690, 70],
            acceleration: [-39_204, 39_203, 9_807],
        };
        assert_eq!(motion(address, transfer), Ok(expected));
    }
}

#[test]
fn a_stranger_at_the_inertial_sensor_s_address_is_named_and_nothing_is_written_to_it() {
    // The LSM6DS3 without TR-C, an LSM6DSO, and a bus that nobody drives.
    for found in [0x69, 0x6C, 0xFF] {
        for address in IMU_ADDRESSES {
            let asked = Transaction::write_read(address, vec![0x0F], vec![found]);
            assert_eq!(start(address, &[asked]), Err(Trouble::Stranger(found)));
        }
    }
}

#[test]
fn a_transfer_that_breaks_off_ends_the_waking_up_there_and_says_why() {
    for (error, address) in breaks().into_iter().zip(IMU_ADDRESSES.into_iter().cycle()) {
        for last in 0..waking(address).len() {
            let mut transfers = waking(address)[..=last].to_vec();
            let broken = transfers.pop().unwrap().with_error(error);
            transfers.push(broken);
            assert_eq!(
                start(address, &transfers),
                Err(Trouble::Bus(error)),
                "{last}"
            );
        }
    }
}

#[test]
fn every_break_of_the_inertial_sensor_s_reading_arrives_as_what_it_is() {
    for error in breaks() {
        for address in IMU_ADDRESSES {
            let broken =
                Transaction::write_read(address, vec![0x22], vec![0; 12]).with_error(error);
            assert_eq!(motion(address, broken), Err(Trouble::Bus(error)));
        }
    }
}
