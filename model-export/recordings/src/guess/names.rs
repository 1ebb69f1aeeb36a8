//! What the name of a column states: quantity, unit, axis and sensor.

use std::collections::BTreeSet;

use crate::units::{Unit, find_unit, unit_of_text};

/// Physical quantity of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Time,
    Field,
    Force,
    Temperature,
    Acceleration,
    Length,
    Current,
    Angle,
    /// Of another unit, such as a voltage, a torque or a humidity: a covariate.
    Other,
    /// Part of a quaternion.
    Attitude,
    /// Torques and angular rates without a unit.
    Unsupported,
    Unknown,
}

impl Quantity {
    /// Quantity of values in this unit.
    pub(crate) fn of_unit(unit: Unit) -> Self {
        match unit.canonical {
            "us" => Self::Time,
            "gauss" | "lsb" => Self::Field,
            "n" => Self::Force,
            "c" => Self::Temperature,
            "mps2" => Self::Acceleration,
            "mm" => Self::Length,
            "a" => Self::Current,
            "rad" => Self::Angle,
            "v" | "w" | "nm" | "radps" | "hz" | "percent" => Self::Other,
            _ => Self::Unknown,
        }
    }

    /// True if values in this unit can be of this quantity.
    pub fn accepts(self, unit: Unit) -> bool {
        self == Self::of_unit(unit)
    }

    /// Names of the quantity in front of an axis (`bx`, `mag_x`) or alone.
    fn of_word(word: &str) -> Option<Self> {
        Some(match word {
            "t" | "time" | "timestamp" | "stamp" | "clock" | "sec" | "secs" | "nsec" | "nsecs"
            | "epoch" => Self::Time,
            "b" | "m" | "mag" | "magnetic" | "magnetometer" | "hall" | "field" | "flux" => {
                Self::Field
            }
            "f" | "force" | "load" | "weight" | "mass" | "scale" | "wrench" | "loadcell" | "ft" => {
                Self::Force
            }
            "temp" | "temperature" => Self::Temperature,
            "a" | "acc" | "accel" | "acceleration" => Self::Acceleration,
            "opening" | "aperture" | "width" | "position" | "height" | "displacement" => {
                Self::Length
            }
            "iq" | "current" => Self::Current,
            "angle" | "theta" | "rotor" | "roll" | "pitch" | "yaw" => Self::Angle,
            "q" | "quat" | "quaternion" | "orientation" => Self::Attitude,
            "torque" | "moment" | "gyro" | "w" | "omega" | "angular" => Self::Unsupported,
            _ => return None,
        })
    }
}

/// Words of a name besides quantity, axis and unit, and its number.
pub type Group = (Vec<String>, Option<u64>);

/// What a name states.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnName {
    pub quantity: Quantity,
    pub unit: Option<Unit>,
    pub axis: Option<char>,
    pub words: Vec<String>,
    /// Equal for the axes of one sensor.
    pub group: Group,
}

/// Unit at the end of a name, `bx (uT)`, `Fz[N]` or `bx_uT`, and what precedes it.
fn split_unit(name: &str) -> (&str, Option<Unit>) {
    let trimmed = name.trim();
    for (open, close) in [('(', ')'), ('[', ']')] {
        if let Some((stem, unit)) =
            trimmed.strip_suffix(close).and_then(|rest| rest.rsplit_once(open))
        {
            return (stem.trim(), unit_named(stem, unit.trim()));
        }
    }
    let separated = trimmed.rsplit_once(['_', ' ', '.', '-']);
    match separated.map(|(stem, unit)| (stem, unit_named(stem, unit))) {
        Some((stem, Some(unit))) => (stem, Some(unit)),
        _ => (trimmed, None),
    }
}

/// Unit with this symbol or word; a `g` and a `T` of another case are decided by the quantity.
fn unit_named(stem: &str, text: &str) -> Option<Unit> {
    let quantity = quantity_of(&words(stem)).0;
    let by_quantity = match (text.to_lowercase().as_str(), quantity) {
        ("g", Quantity::Field) => Some("G"),
        ("g", Quantity::Acceleration) => Some("g0"),
        (
            "nm" | "n m" | "n\u{b7}m",
            Quantity::Unsupported | Quantity::Field | Quantity::Unknown,
        ) => Some("N m"),
        _ => None,
    };
    let unit = by_quantity.map_or_else(|| unit_of_text(text), find_unit)?;
    // Longer symbols are clear. One letter may be another word: the third channel `channel_c`, a force at the time `force_t`.
    let is_letter = text.chars().count() == 1;
    let is_other = match quantity {
        Quantity::Unknown => !matches!(text, "m" | "s" | "A" | "N" | "T" | "G"),
        Quantity::Unsupported => false,
        // `T1_C`: not a time, but a temperature.
        Quantity::Time if unit.canonical == "c" => false,
        known => !known.accepts(unit),
    };
    (!(is_letter && is_other)).then_some(unit)
}

/// Words of a name in lower case: split at other characters, at a change from lower to upper case, and at digits.
fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut previous = ' ';
    for c in name.chars() {
        let is_start = !previous.is_alphanumeric()
            || previous.is_ascii_digit() != c.is_ascii_digit()
            || (previous.is_lowercase() && c.is_uppercase());
        if c.is_alphanumeric() {
            let lower = c.to_lowercase();
            match words.last_mut() {
                Some(word) if !is_start => word.extend(lower),
                _ => words.push(lower.collect()),
            }
        }
        previous = c;
    }
    words
}

/// Quantity and axis that the words state, with the index of the words that state them.
fn quantity_of(words: &[String]) -> (Quantity, Option<char>, BTreeSet<usize>) {
    let mut quantity = Quantity::Unknown;
    let mut axis = None;
    let mut used = BTreeSet::new();
    for (i, word) in words.iter().enumerate() {
        // `orientation.w` is part of a quaternion, `w` alone an angular rate.
        let is_axis = matches!(word.as_str(), "x" | "y" | "z")
            || (word == "w" && quantity == Quantity::Attitude);
        if is_axis {
            axis = word.chars().next();
            used.insert(i);
            continue;
        }
        // The last quantity counts: `sensor_time`, `motor_angle`; but `bx_a` and `mag_b_x` are of sensors a and b, and `force_t` is
        // not the time of a force.
        let is_label = quantity != Quantity::Unknown && word.len() == 1;
        if let Some(known) = Quantity::of_word(word).filter(|_| !is_label) {
            quantity = known;
            used.insert(i);
            continue;
        }
        let mut letters = word.chars();
        let last = letters.next_back().filter(|letter| "xyzw".contains(*letter));
        let prefix = letters.as_str();
        if let Some(last) = last {
            let of_prefix = Quantity::of_word(prefix);
            if prefix.is_empty() || of_prefix.is_some() {
                axis = Some(last);
                used.insert(i);
            }
            if let Some(known) = of_prefix
                && quantity == Quantity::Unknown
            {
                quantity = if known == Quantity::Time { Quantity::Unsupported } else { known };
            }
        }
    }
    (quantity, axis, used)
}

impl ColumnName {
    pub fn of(name: &str) -> Self {
        let (stem, unit) = split_unit(name);
        let words = words(stem);
        let (mut quantity, axis, used) = quantity_of(&words);
        if let Some(unit) = unit
            && !quantity.accepts(unit)
            && (quantity != Quantity::Unsupported || Quantity::of_unit(unit) == Quantity::Other)
        {
            quantity = Quantity::of_unit(unit);
        }
        let is_number = |word: &String| word.bytes().all(|byte| byte.is_ascii_digit());
        let others =
            words.iter().enumerate().filter(|(i, _)| !used.contains(i)).map(|(_, word)| word);
        let number =
            others.clone().rfind(|word| is_number(word)).and_then(|word| word.parse().ok());
        let group = (others.filter(|word| !is_number(word)).cloned().collect(), number);
        Self { quantity, unit, axis, words, group }
    }
}
