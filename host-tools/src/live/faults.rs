//! Faults as people read them.

use std::fmt::Debug;

use firmware::loops::SERIAL;
use firmware::status::Fault;
use firmware::units::Force;

/// A fault in words: "sensor lost".
pub fn name(fault: Fault) -> String {
    spaced(fault)
}

/// The name of a variant in words: "hold active" of `HoldActive`.
pub fn spaced(variant: impl Debug) -> String {
    let mut words = String::new();
    for letter in format!("{variant:?}").chars() {
        if letter.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    words
}

/// Where it is; empty where there is one place only.
pub fn place(fault: Fault, source: u8) -> String {
    match fault {
        Fault::SensorLost
        | Fault::SensorFrozen
        | Fault::SensorSaturated
        | Fault::OutsideModel
        | Fault::NetworkAstray => format!("sensor {source}"),
        Fault::BusStuck => format!("sensors' bus {source}"),
        Fault::Flooded if source == SERIAL => "serial line".to_owned(),
        Fault::Flooded => "CAN bus".to_owned(),
        _ => String::new(),
    }
}

/// What was measured as it came; empty where nothing is.
pub fn detail(fault: Fault, detail: u32) -> String {
    match fault {
        Fault::SensorLost | Fault::SensorFrozen => format!("{detail} ticks old"),
        Fault::Unbalanced => format!("by {:.1} N", f64::from(detail) / Force::PER_NEWTON),
        Fault::StoreUnsound => format!("reason {detail}"),
        Fault::TicksMissed => format!("{detail} since its start"),
        Fault::Crashed => format!("at {detail:#010x}"),
        Fault::Flooded | Fault::StrangeFrames => format!("{detail} dropped"),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_told_with_its_place_and_measure() {
        assert_eq!(name(Fault::SensorLost), "sensor lost");
        assert_eq!(place(Fault::SensorLost, 2), "sensor 2");
        assert_eq!(detail(Fault::SensorLost, 2), "2 ticks old");
        assert_eq!(name(Fault::BusOff), "bus off");
        assert_eq!(place(Fault::BusOff, 0), "");
        assert_eq!(detail(Fault::Unbalanced, 17 << 10), "by 17.0 N");
        assert_eq!(place(Fault::Flooded, SERIAL), "serial line");
    }
}
