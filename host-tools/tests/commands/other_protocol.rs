//! Heartbeats of another version of the protocol: of a stranger on the bus, or of the gripper.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::time::Duration;

use firmware::protocol::messages::{Heartbeat, Message};
use firmware::protocol::{DEFAULT_NODE, PROTOCOL_VERSION, frame_id};
use serde_json::Value;

use crate::workdir::{WorkDir, text};

/// Bus with a gripper that sends nothing but these heartbeats, ten a second, by their number; its address.
fn bus(versions: fn(u32) -> &'static [u8]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        let _ = stream.write_all(b"< hi >");
        for _ in 0..2 {
            // A bus is opened, and read.
            let _ = stream.read(&mut [0; 256]);
            let _ = stream.write_all(b"< ok >");
        }
        for number in 0.. {
            for version in versions(number) {
                let beat = Heartbeat { protocol_major: *version, state: 2, ..Heartbeat::default() };
                let bytes = Message::Heartbeat(beat).to_bytes().map(|byte| format!("{byte:02X}"));
                let id = frame_id(DEFAULT_NODE, Heartbeat::LAYOUT.number);
                let frame = format!("< frame {id:03X} 0.000000 {} >", bytes.concat());
                if stream.write_all(frame.as_bytes()).is_err() {
                    return;
                }
            }
            let _ = stream.read(&mut [0; 256]);
        }
    });
    address
}

const OWN: u8 = PROTOCOL_VERSION.0;

#[test]
fn a_stranger_on_the_bus_ends_nothing() {
    let dir = WorkDir::empty();
    // One forged frame at first, one later, many between the gripper's own.
    let versions: [fn(u32) -> &'static [u8]; 3] = [
        |number| if number == 0 { &[9] } else { &[OWN] },
        |number| if number == 10 { &[OWN, 0] } else { &[OWN] },
        |_| &[9, 9, 9, 200, OWN, 9, 9, 9],
    ];
    for versions in versions {
        let monitor = format!("monitor --can {} --seconds 3 --json", bus(versions));
        let output = dir.run(&monitor);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("another device or host on its bus"));
        let last: Value =
            serde_json::from_str(text(&output.stdout).lines().last().unwrap()).unwrap();
        assert!(last["lost"]["other_protocol"].as_u64().unwrap() > 0, "{last}");
        assert_eq!(last["heartbeat"]["state"], "safe", "{last}");
        // Nobody opens a session here: that is the error, and not the version.
        let output = dir.run(&format!("grasp --can {} --position 50", bus(versions)));
        let said = text(&output.stderr);
        assert!(!output.status.success() && !said.contains("uses protocol version"), "{said}");
        assert!(said.contains("another device or host on its bus"), "{said}");
    }
}

#[test]
fn firmware_with_another_protocol_is_named() {
    let dir = WorkDir::empty();
    let versions: [fn(u32) -> &'static [u8]; 2] = [
        |_| &[9],
        // It was updated while it was watched.
        |number| if number < 5 { &[OWN] } else { &[9] },
    ];
    for versions in versions {
        for command in ["monitor --seconds 20", "grasp --position 50"] {
            let said = dir.failure(&format!("{command} --can {}", bus(versions)));
            assert!(said.contains("the gripper uses protocol version 9, this tool"), "{said}");
        }
    }
}
