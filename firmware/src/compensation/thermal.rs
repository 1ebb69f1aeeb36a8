//! Temperature effects on the field: the Hall element's drift, the magnet's remanence, the growth of the gap.
//!
//! A kelvin changes the magnet's field by 1.4 G, so the noise of a temperature count would be visible. Thermal time
//! constants are long: the temperature is low-pass filtered with 256 ms.

use crate::fixed_point::{Field, mul_q};

/// Fractional bits of a filtered temperature.
pub const TEMPERATURE_BITS: u32 = 8;
/// The filter's gain per tick is 2^-8: 256 ms at 1 kHz.
const SHIFT: u32 = 8;

/// Low-pass filter of the temperature, in counts with [`TEMPERATURE_BITS`] fractional bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TemperatureFilter(Option<i32>);

impl TemperatureFilter {
    /// Filters a reading; the first one initialises the filter.
    pub fn update(&mut self, counts: i16) -> i32 {
        let input = i32::from(counts) << TEMPERATURE_BITS;
        let filtered = match self.0 {
            None => input,
            Some(before) => {
                // Rounding to nearest limits the steady-state error to half a count.
                let step = input.saturating_sub(before);
                before.saturating_add((step + (1 << (SHIFT - 1))) >> SHIFT)
            }
        };
        self.0 = Some(filtered);
        filtered
    }

    /// Latest filtered value; 0 before the first reading.
    pub fn value(&self) -> i32 {
        self.0.unwrap_or(0)
    }
}

/// Fractional bits of [`SensorTemperatureTable::offset`] and [`SensorTemperatureTable::gain`].
pub const DRIFT_BITS: u32 = 24;

/// Drift of the Hall element per temperature count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorTemperatureTable {
    /// Drift of each axis' offset, in field units.
    pub offset: [i32; 3],
    /// Relative drift of the gain.
    pub gain: i32,
}

impl SensorTemperatureTable {
    /// Corrects the field to the sensor's reference temperature.
    pub fn compensate(&self, field: [Field; 3], temperature: i32) -> [Field; 3] {
        let gain = mul_q(self.gain, temperature, TEMPERATURE_BITS);
        let [x, y, z] = self.offset;
        let [bx, by, bz] = field;
        [(bx, x), (by, y), (bz, z)].map(|(field, offset)| {
            let centred =
                field.saturating_sub(mul_q(offset, temperature, TEMPERATURE_BITS + DRIFT_BITS));
            centred.saturating_sub(mul_q(centred.0, gain, DRIFT_BITS))
        })
    }
}

/// Fractional bits of [`MagnetTemperatureTable::per_count`].
pub const REMANENCE_BITS: u32 = 28;
/// Fractional bits of the relative change while it is applied.
const CHANGE_BITS: u32 = 24;

/// Temperature coefficient of the magnet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MagnetTemperatureTable {
    /// Sensor output without the magnet, in field units.
    pub without: [i32; 3],
    /// Relative change of the remanence per temperature count.
    pub per_count: i32,
}

impl MagnetTemperatureTable {
    /// Corrects the field to the magnet's reference temperature.
    pub fn compensate(&self, field: [Field; 3], temperature: i32) -> [Field; 3] {
        // B = B0 (1 + c), so B0 = B - B c / (1 + c), and c / (1 + c) = c - c^2 up to c^3, which is
        // below 1e-6 at 30 K.
        let change =
            mul_q(self.per_count, temperature, TEMPERATURE_BITS + REMANENCE_BITS - CHANGE_BITS);
        let correction = change.saturating_sub(mul_q(change, change, CHANGE_BITS));
        let [x, y, z] = self.without;
        let [bx, by, bz] = field;
        [(bx, x), (by, y), (bz, z)].map(|(field, without)| {
            let own = field.0.saturating_sub(without);
            field.saturating_sub(mul_q(own, correction, CHANGE_BITS))
        })
    }
}

/// Fractional bits of [`ThermalGapTable::rest`] and [`ThermalGapTable::bend`].
pub const GAP_BITS: u32 = 24;

/// Field change per temperature count due to the expansion of the structure between magnet and sensor: a linear
/// function of the field, fitted over the design box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThermalGapTable {
    /// Unloaded field, in field units.
    pub at: [i32; 3],
    /// Change of the unloaded field, in field units per count.
    pub rest: [i32; 3],
    /// Gradient of the change with the field, per count and unit.
    pub bend: [[i32; 3]; 3],
}

impl ThermalGapTable {
    /// Corrects the field to the gap at the reference temperature.
    pub fn compensate(&self, field: [Field; 3], temperature: i32) -> [Field; 3] {
        let [bx, by, bz] = field;
        let [ax, ay, az] = self.at;
        let offset = [bx.0.saturating_sub(ax), by.0.saturating_sub(ay), bz.0.saturating_sub(az)];
        let [sx, sy, sz] = self.bend.map(|row| {
            row.iter()
                .zip(offset)
                .fold(0_i32, |sum, (slope, offset)| sum.saturating_add(mul_q(*slope, offset, 0)))
        });
        let [rx, ry, rz] = self.rest;
        [(bx, rx, sx), (by, ry, sy), (bz, rz, sz)].map(|(field, rest, linear)| {
            let per_count = rest.saturating_add(linear);
            field.saturating_sub(mul_q(per_count, temperature, TEMPERATURE_BITS + GAP_BITS))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_has_256_ms_and_half_a_count_of_final_error() {
        for (ticks, counts, tolerance) in [(256, 63.21, 2.0), (4000, 100.0, 0.5)] {
            let mut filter = TemperatureFilter::default();
            filter.update(0);
            let last = (0..ticks).map(|_| filter.update(100)).last();
            let found = f64::from(last.unwrap()) / f64::from(1 << TEMPERATURE_BITS);
            assert!((found - counts).abs() <= tolerance, "{ticks}: {found}");
        }
    }

    #[test]
    fn the_remanence_at_plus_10_k_is_corrected() {
        // 8 counts per kelvin, -0.1 % per kelvin: -1.25e-4 per count.
        let table = MagnetTemperatureTable {
            without: [0, 160, 0],
            per_count: -(1.25e-4 * f64::from(1 << REMANENCE_BITS)) as i32,
        };
        let cold = [10_000, 160_160, -5_000];
        let warm = [9_900, 158_560, -4_950].map(Field);
        let corrected = table.compensate(warm, 80 << TEMPERATURE_BITS);
        for (found, cold) in corrected.iter().zip(cold) {
            assert!((found.0 - cold).abs() <= 1, "{found:?} {cold}");
        }
    }
}
