//! What runs on the board of a gripper that was made as drawn: the tables of the nominal design.

use anyhow::Result;
use firmware::frame::SENSORS;
use firmware::params::{SENSOR_RANGE, SENSOR_SCALE};
use model_export::inverse::at_rest::AtRest;
use model_export::inverse::quantise::TableSet;
use model_export::inverse::search::choose;
use model_export::physics::ForwardModel;
use model_export::recordings::description::Design;

use crate::bench::element::NOISE_G;

/// Identifies them on the bus.
const ID: u16 = 1;

/// The tables of all sensors; the spread beside their surfaces is the sensor's noise.
///
/// # Errors
/// They overflow, which a test excludes.
pub fn as_drawn() -> Result<TableSet> {
    let numbers: Vec<u32> = (0..SENSORS as u32).collect();
    let design = Design::magpie();
    let model = AtRest::plain(ForwardModel::nominal(&design));
    let models = vec![model; SENSORS];
    let (scale, range) = (SENSOR_SCALE.value, SENSOR_RANGE.value);
    let mut chosen = choose(&models, &numbers, ID, scale, range)?;
    let surfaces = chosen.surfaces.iter().zip(&numbers);
    for (table, (surface, &number)) in chosen.tables.sensors.iter_mut().zip(surfaces) {
        table.parity = surface.table(number, NOISE_G, scale)?;
    }
    Ok(chosen.tables)
}
