//! Which channels a recording has, and in what order its rows hold them.

use std::collections::BTreeSet;

use super::columns::{Axis, ForceColumn, HallColumn};

/// What the channels of a row are.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Columns of `hall.csv`, without the clock.
    pub hall: Vec<HallColumn>,
    /// Columns of `force.csv`, without the clock.
    pub forces: Vec<ForceColumn>,
}

impl Layout {
    /// Numbers of the sensors, ascending.
    pub fn sensors(&self) -> Vec<u32> {
        let sensors: BTreeSet<u32> = self
            .hall
            .iter()
            .filter_map(|column| match column {
                HallColumn::Field { sensor, .. } => Some(*sensor),
                _ => None,
            })
            .collect();
        sensors.into_iter().collect()
    }

    /// Where the three axes of a sensor are among the board's channels.
    pub fn field_channels(&self, sensor: u32) -> Option<[usize; 3]> {
        let find = |wanted: Axis| {
            self.hall.iter().position(|column| {
                matches!(column, HallColumn::Field { sensor: s, axis, .. } if *s == sensor && *axis == wanted)
            })
        };
        Some([find(Axis::X)?, find(Axis::Y)?, find(Axis::Z)?])
    }
}
