//! What the device's integers cannot hold, and where in the network it stands.

use std::fmt;

use super::network::GATES;

const GATE_NAMES: [&str; GATES] = ["reset", "update", "candidate"];

/// A row of a network, as a person finds it. Rows, units and columns count from zero, layers too, but
/// from one where they are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Their names and the text below say it.
pub enum Row {
    Layer {
        layer: usize,
        gate: usize,
        unit: usize,
    },
    Head {
        output: usize,
    },
    Input {
        number: usize,
    },
    Force {
        axis: usize,
    },
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match *self {
            Self::Layer { layer, gate, unit } => {
                write!(f, "layer {}, {} row {unit}", layer + 1, GATE_NAMES[gate])
            }
            Self::Head { output } => write!(f, "head, row {output}"),
            Self::Input { number } => write!(f, "input {number}"),
            Self::Force { axis } => write!(f, "force of F{}", ["x", "z"][axis]),
        }
    }
}

/// A network that the device's integers cannot hold.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum Unfit {
    #[error("{row}: {what} {value:.4e} does not fit {format}; {advice}")]
    Number {
        row: Row,
        what: String,
        value: f64,
        format: String,
        advice: &'static str,
    },
    #[error(
        "{row}: its sum may reach {greatest:.2} where the accumulator ends at {limit:.0}; {LARGE_WEIGHTS}"
    )]
    Wraps { row: Row, greatest: f64, limit: f64 },
    #[error("{what}: {found} numbers where {expected} belong")]
    Shape {
        what: &'static str,
        found: usize,
        expected: usize,
    },
    #[error(
        "{inputs} inputs, {hidden} units and {sensors} sensors: the device knows up to 16 inputs, 32 units and 4 sensors"
    )]
    Size {
        inputs: usize,
        hidden: usize,
        sensors: usize,
    },
}

/// What to do about it.
pub(super) const LARGE_WEIGHTS: &str = "train with weight decay, or clip weights while training";
