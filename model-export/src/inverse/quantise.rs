//! The device's tables from a floating point model, with the proof that nothing overflows.

use firmware::compensation::Compensation;
use firmware::estimator::ideal;
use firmware::fixed_point::{Field, Force};
use firmware::model::axis_map::AxisMap;
use firmware::model::formats::{
    AxisScale, COORDINATE_LIMIT, CentrePair, EXP_ENTRIES, Linear, MOST_PAIRS, Parity, SLOPE_BITS,
    SensorTable, Tables,
};
use firmware::model::kernel::grbf::{ENTRY_BITS, ENTRY_STEP};
use nalgebra::Vector3;

use crate::inverse::grbf::Grbf;

/// Fractional bits of the exponential.
const EXP_BITS: u32 = 15;

/// A value beyond its format.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("sensor {sensor}, {row}: {value:.6e} does not fit {format}; {advice}")]
pub struct TableOverflow {
    /// Number of the sensor.
    pub sensor: u32,
    /// Name of the table entry.
    pub row: String,
    /// Value.
    pub value: f64,
    /// Range of the format.
    pub format: String,
    /// Remedy.
    pub advice: &'static str,
}

/// The device's tables, owned.
#[derive(Clone, Debug, PartialEq)]
pub struct TableSet {
    /// Identifier on the bus.
    pub id: u16,
    /// Exponential table.
    pub exp: Box<[u32; EXP_ENTRIES]>,
    /// One for each sensor.
    pub sensors: Vec<SensorTable>,
}

impl TableSet {
    /// Tables of `models` (all of one width) for sensors of these numbers, scale and range, without parity
    /// surfaces.
    pub fn build(
        id: u16,
        models: &[Grbf],
        numbers: &[u32],
        gauss_per_lsb: f64,
        range_gauss: f64,
    ) -> Result<Self, TableOverflow> {
        let gamma = models.first().map_or(1.0, |model| model.gamma);
        let sensors = models.iter().zip(numbers).map(|(model, &number)| {
            let row = RowLocation { sensor: number };
            sensor_table(row, model, gauss_per_lsb, range_gauss)
        });
        Ok(Self {
            id,
            exp: Box::new(exponential(gamma)),
            sensors: sensors.collect::<Result<_, _>>()?,
        })
    }

    /// The device's view with its checksum.
    pub fn tables<'a>(&'a self, compensations: &'a [Compensation<'a>]) -> Tables<'a> {
        self.unchecked(compensations).checked()
    }

    fn unchecked<'a>(&'a self, compensations: &'a [Compensation<'a>]) -> Tables<'a> {
        Tables { id: self.id, exp: &self.exp, sensors: &self.sensors, compensations, check: 0 }
    }

    /// Forces in newtons by the device's own code for an unrounded field in gauss: the error of the arithmetic
    /// alone.
    pub fn force(&self, sensor: usize, field_g: &Vector3<f64>, gauss_per_lsb: f64) -> [f64; 2] {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let field = [0, 1, 2].map(|axis| Field((field_g[axis] * units).round() as i32));
        match self.sensors.get(sensor) {
            Some(table) => {
                ideal::evaluate(&self.unchecked(&[]), table, field).force.map(Force::newtons)
            }
            None => [f64::NAN; 2],
        }
    }
}

/// Location of a value for error messages.
#[derive(Clone, Copy)]
struct RowLocation {
    sensor: u32,
}

impl RowLocation {
    fn fit(
        self,
        row: impl Fn() -> String,
        value: f64,
        limit: f64,
        advice: &'static str,
    ) -> Result<f64, TableOverflow> {
        let rounded = value.round();
        if rounded.abs() <= limit {
            return Ok(rounded);
        }
        Err(TableOverflow {
            sensor: self.sensor,
            row: row(),
            value,
            format: format!("±{limit:.0}"),
            advice,
        })
    }
}

const WEIGHTS_TOO_LARGE: &str = "the weights of the radial basis functions are ill-conditioned: use fewer centres or a larger ridge";

fn sensor_table(
    row: RowLocation,
    model: &Grbf,
    gauss_per_lsb: f64,
    range_gauss: f64,
) -> Result<SensorTable, TableOverflow> {
    let (scale, _) = model.design.device_scale(gauss_per_lsb);
    let too_wide =
        "the design box does not fit the sensor's range: check gap, remanence and force range";
    let mut axes = [AxisScale { offset: 0, gain: 0 }; 3];
    for (axis, (offset, gain)) in scale.into_iter().enumerate() {
        // A reading has 15 bits, compensation may double it: the difference stays inside 21 bits.
        let limit = f64::from(1_i32 << (15 + Field::BITS));
        axes[axis].offset =
            row.fit(|| format!("offset of axis {axis}"), offset, limit, too_wide)? as i32;
        axes[axis].gain =
            row.fit(|| format!("gain of axis {axis}"), gain, f64::from(i32::MAX), too_wide)? as i32;
    }
    let (pairs, shift) = pairs(row, model)?;
    let used_pairs = pairs.len();
    if used_pairs > MOST_PAIRS {
        row.fit(
            || "number of pairs".to_owned(),
            used_pairs as f64,
            MOST_PAIRS as f64,
            "use fewer centres",
        )?;
    }
    let mut padded = [CentrePair::NONE; MOST_PAIRS];
    padded[..used_pairs].copy_from_slice(&pairs);
    let limit_counts =
        ((range_gauss / gauss_per_lsb).floor() - 1.0).clamp(0.0, f64::from(i16::MAX));
    let too_many = "the device supports sensors 0 to 255";
    let number = row.fit(|| "number".to_owned(), f64::from(row.sensor), 255.0, too_many)?;
    Ok(SensorTable {
        number: number as u8,
        axes: AxisMap::NOMINAL,
        scale: axes,
        limit_counts: limit_counts as i16,
        linear: linear(row, model)?,
        pairs: padded,
        used_pairs: used_pairs as u8,
        shift,
        parity: Parity::NONE,
    })
}

fn linear(row: RowLocation, model: &Grbf) -> Result<Linear, TableOverflow> {
    let advice = "forces beyond a million newtons: check the stiffnesses";
    let mut linear = Linear { bias: [0; 2], slope: [[0; 3]; 2] };
    for force in 0..2 {
        let bias = model.bias_n[force] * Force::PER_NEWTON;
        linear.bias[force] =
            row.fit(|| format!("bias of force {force}"), bias, f64::from(1 << 30), advice)? as i32;
        for axis in 0..3 {
            let per_unit =
                model.slope_n[force][axis] * Force::PER_NEWTON / f64::from(COORDINATE_LIMIT);
            let slope = per_unit * f64::from(1_u32 << SLOPE_BITS);
            let name = || format!("slope of force {force} to axis {axis}");
            linear.slope[force][axis] = row.fit(name, slope, f64::from(i32::MAX), advice)? as i32;
        }
    }
    Ok(linear)
}

/// Pairs of centres, and for each force the shift with the best use of the weights' bits.
fn pairs(row: RowLocation, model: &Grbf) -> Result<(Vec<CentrePair>, [u8; 2]), TableOverflow> {
    let mut shift = [0_u8; 2];
    let mut weights: Vec<[i16; 2]> = vec![[0; 2]; model.centres.len()];
    for force in 0..2 {
        let newtons: Vec<f64> = model.weights_n.iter().map(|weight| weight[force]).collect();
        shift[force] = best_shift(&newtons);
        let scale =
            f64::from(1_u32 << shift[force]) * Force::PER_NEWTON / f64::from(1_u32 << EXP_BITS);
        for (k, newtons) in newtons.iter().enumerate() {
            let name = || format!("weight of centre {k} for force {force}");
            weights[k][force] =
                row.fit(name, newtons * scale, f64::from(i16::MAX), WEIGHTS_TOO_LARGE)? as i16;
        }
        // Worst case: every function at its maximum, all weights of one sign.
        let max_sum: f64 = weights
            .iter()
            .map(|weight| f64::from(weight[force]).abs() * f64::from(1_u32 << EXP_BITS))
            .sum();
        row.fit(
            || format!("sum of the weights for force {force}"),
            max_sum,
            f64::from(i32::MAX),
            WEIGHTS_TOO_LARGE,
        )?;
    }
    let limit = f64::from(COORDINATE_LIMIT);
    let mut coordinates: Vec<[i16; 3]> = Vec::new();
    for (k, centre) in model.centres.iter().enumerate() {
        let mut at = [0; 3];
        for axis in 0..3 {
            let name = || format!("axis {axis} of centre {k}");
            let advice = "a centre is outside the design box: use another lattice of centres";
            at[axis] = row.fit(name, centre[axis] * limit, limit, advice)? as i16;
        }
        coordinates.push(at);
    }
    let paired = coordinates.chunks(2).zip(weights.chunks(2)).map(|(at, weight)| {
        let [x1, y1, z1] = at[0];
        // An odd last centre is paired with zero weights.
        let [x2, y2, z2] = at.get(1).copied().unwrap_or([0; 3]);
        let [first, second] = [weight[0], weight.get(1).copied().unwrap_or([0; 2])];
        CentrePair {
            xy: [[x1, y1], [x2, y2]],
            z: [z1, z2],
            weight: [[first[0], second[0]], [first[1], second[1]]],
        }
    });
    Ok((paired.collect(), shift))
}

/// The largest shift for which neither a weight nor the sum of all can overflow.
fn best_shift(weights_n: &[f64]) -> u8 {
    let fits = |shift: u8| {
        let scale = f64::from(1_u32 << shift) * Force::PER_NEWTON / f64::from(1_u32 << EXP_BITS);
        let max_weight =
            weights_n.iter().fold(0.0_f64, |max_weight, w| max_weight.max((w * scale).abs()));
        let sum: f64 = weights_n.iter().map(|w| (w * scale).abs() + 0.5).sum();
        max_weight.round() <= f64::from(i16::MAX)
            && sum * f64::from(1_u32 << EXP_BITS) <= f64::from(i32::MAX)
    };
    (0..=30).rev().find(|&shift| fits(shift)).unwrap_or(0)
}

/// Rounds coordinates to the device's format.
pub fn representable(at: Vector3<f64>) -> Vector3<f64> {
    let limit = f64::from(COORDINATE_LIMIT);
    at.map(|c| (c * limit).round().clamp(-limit, limit) / limit)
}

/// exp(-gamma d^2) in the device's format. The device interpolates linearly between entries; the line is
/// shifted by half its maximum error.
fn exponential(gamma: f64) -> [u32; EXP_ENTRIES] {
    let limit = f64::from(COORDINATE_LIMIT);
    let at = |entry: f64| libm::exp(-gamma * entry * f64::from(ENTRY_STEP) / (limit * limit));
    // Value in bits 31 to 16, so one is 2^31.
    let one = f64::from(1_u32 << 31);
    std::array::from_fn(|k| {
        let (start, end) = (at(k as f64), at(k as f64 + 1.0));
        let sag = 0.5 * (at(k as f64 + 0.5) - 0.5 * (start + end));
        let slope = ((end - start) * one / f64::from(1_u32 << ENTRY_BITS)).round() as i64;
        // Odd entries are read from their end, with a negative fraction.
        let reference = if k % 2 == 0 { start } else { end };
        // Half of the last bit shifted out, minus the contribution of the slope's bits.
        let value = ((reference + sag) * one).round() as i64 + (1 << 15) - slope;
        let upper = ((value + (1 << 15)) >> 16).min(i64::from(i16::MAX));
        ((upper << 16) + slope) as u32
    })
}
