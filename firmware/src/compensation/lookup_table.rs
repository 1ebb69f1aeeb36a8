//! User-defined effects: a function of up to three covariates as a lookup table with linear interpolation, and the
//! direction in which its value changes the field or the forces.
//!
//! A covariate may be a force: the estimate of the tick before. An effect f(F) of the force is then off by its slope times the
//! change of the force in a tick, and the error of an estimate falls by that factor with each tick; the exporter
//! refuses slopes above a half. The ends of a table bound its values, so no estimate diverges.

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::fixed_point::{Field, Force, mul_q, saturate};

/// Maximum number of dimensions of a table.
pub const SIDES: usize = 3;
/// Filters of covariates per sensor.
pub const FILTERS: usize = 4;
/// Fractional bits of the values of a table.
pub const VALUE_BITS: u32 = 24;
/// Fractional bits of [`FieldMap::along`] and [`ForceMap::along`].
pub const ALONG_BITS: u32 = 8;
/// Fractional bits of [`FieldMap::matrix`].
pub const MATRIX_BITS: u32 = 28;
/// Fractional bits of [`CovariateFilter::gain`].
pub const FILTER_BITS: u32 = 30;
/// Additional fractional bits of [`Covariate::Rate`].
pub const RATE_BITS: u32 = 8;
/// Additional fractional bits of a filter's state.
const STATE_BITS: u32 = 20;
/// Additional fractional bits of a filter's step: 131 kN at most, so that the product with the gain fits 64 bits.
const STEP_BITS: u32 = 4;

/// Independent variable of a lookup table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Covariate {
    /// Opening in micrometres.
    Opening,
    /// Quadrature current in milliamperes.
    MotorIq,
    /// Mechanical angle of the motor in microradians.
    MotorAngle,
    /// Specific force along an axis of the gripper in mm/s^2.
    Acceleration(u8),
    /// Temperature in counts with [`super::thermal::TEMPERATURE_BITS`] fractional bits.
    Temperature,
    /// Force of the tick before, 0 lateral and 1 longitudinal, as [`Force`]; zero in the first tick.
    Force(u8),
    /// Output of the filter of this number, in the unit of its covariate.
    Lagged(u8),
    /// Rate of [`Self::Lagged`] times the filter's time constant, with [`RATE_BITS`] additional fractional bits.
    Rate(u8),
}

/// Two first-order low passes in series, of equal gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CovariateFilter {
    /// Filtered covariate; it may be the output of a filter of a lower number.
    pub covariate: Covariate,
    /// Gain per tick.
    pub gain: i32,
}

impl CovariateFilter {
    /// Outputs of both low passes after the next value; the first value initialises them.
    fn step(&self, outputs: Option<[i64; 2]>, value: i32) -> [i64; 2] {
        let now = i64::from(value) << STATE_BITS;
        let [first, second] = outputs.unwrap_or([now; 2]);
        let low_pass = |from: i64, to: i64| {
            let step = i64::from(saturate(to.saturating_sub(from) >> (STATE_BITS - STEP_BITS)));
            let by = (step * i64::from(self.gain)) >> (FILTER_BITS + STEP_BITS - STATE_BITS);
            from.saturating_add(by)
        };
        let first = low_pass(first, now);
        [first, low_pass(second, first)]
    }
}

/// Estimated forces and filtered covariates of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EstimateState {
    /// Forces of the tick before, and the number of ticks up to 2.
    force: [Force; 2],
    ticks: u8,
    filters: [Option<[i64; 2]>; FILTERS],
}

impl EstimateState {
    /// Sets the forces of a tick.
    pub fn set_force(&mut self, force: [Force; 2]) {
        self.force = force;
        self.ticks = self.ticks.saturating_add(1).min(2);
    }

    /// Filters the covariates of a tick. A filter without an input starts again with the next one, and all in the second tick,
    /// which is the first with forces.
    pub fn update(
        &mut self,
        filters: &[Option<CovariateFilter>; FILTERS],
        temperature: i32,
        inputs: &AuxiliaryInputs,
    ) {
        for (number, filter) in filters.iter().enumerate() {
            let Some(filter) = filter else { continue };
            let values = CovariateValues { temperature, inputs, estimates: self };
            let value = values.value(filter.covariate);
            let is_started = self.ticks > 1;
            if let Some(outputs) = self.filters.get_mut(number) {
                let before = outputs.filter(|_| is_started);
                *outputs = value.map(|value| filter.step(before, value));
            }
        }
    }

    fn filter(&self, number: u8) -> Option<[i64; 2]> {
        self.filters.get(usize::from(number)).copied().flatten()
    }
}

/// Sources of all covariates of a sensor.
#[derive(Clone, Copy, Debug)]
pub struct CovariateValues<'a> {
    /// Filtered temperature.
    pub temperature: i32,
    /// Auxiliary inputs of the tick.
    pub inputs: &'a AuxiliaryInputs,
    /// Estimates and filters.
    pub estimates: &'a EstimateState,
}

impl CovariateValues<'_> {
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
    #[allow(unsafe_code)] // As of `estimate`.
    fn value(&self, covariate: Covariate) -> Option<i32> {
        let inputs = self.inputs;
        match covariate {
            Covariate::Opening => inputs.opening_um,
            Covariate::MotorIq => inputs.motor.map(|motor| motor.iq_ma),
            Covariate::MotorAngle => inputs.motor.map(|motor| motor.angle_urad),
            Covariate::Acceleration(axis) => inputs.acceleration?.get(usize::from(axis)).copied(),
            Covariate::Temperature => Some(self.temperature),
            Covariate::Force(axis) => {
                self.estimates.force.get(usize::from(axis)).map(|force| force.0)
            }
            Covariate::Lagged(number) => {
                let [first, _] = self.estimates.filter(number)?;
                Some(saturate(first >> STATE_BITS))
            }
            Covariate::Rate(number) => {
                let [first, second] = self.estimates.filter(number)?;
                Some(saturate(first.saturating_sub(second) >> (STATE_BITS - RATE_BITS)))
            }
        }
    }
}

/// One dimension of a table, with equidistant knots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LookupAxis {
    /// Independent variable.
    pub covariate: Covariate,
    /// Value at the first knot.
    pub from: i32,
    /// Distance of two knots; positive.
    pub step: i32,
    /// Number of knots.
    pub knots: u16,
}

impl LookupAxis {
    /// Index of the knot below the value and the fraction to the next with 15 bits, clamped to the ends.
    fn locate(&self, values: &CovariateValues) -> Option<(usize, i64)> {
        let value = values.value(self.covariate)?;
        let step = self.step.max(1).unsigned_abs();
        let last = (u32::from(self.knots.max(2)) - 1).saturating_mul(step) - 1;
        let distance = (i64::from(value) - i64::from(self.from)).clamp(0, last.into()) as u32;
        // Divisions of 32 bits, which the core has: of a step of full length.
        let shift = step.leading_zeros();
        let cell = (step << shift) >> 15;
        let fraction = ((distance % step) << shift).checked_div(cell)?;
        Some(((distance / step) as usize, fraction.into()))
    }
}

/// A function of covariates, relative to its largest magnitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LookupTable<'a> {
    /// Dimensions.
    pub sides: [Option<LookupAxis>; SIDES],
    /// Values with [`VALUE_BITS`]: those over the first dimension's knots, for each knot of the second, for each of the
    /// third.
    pub values: &'a [i32],
}

impl LookupTable<'_> {
    /// Interpolated value; `None` if an input is missing.
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
    #[allow(unsafe_code)] // As of `estimate`.
    pub fn value(&self, covariates: &CovariateValues) -> Option<i32> {
        let (mut first, mut width) = (0_usize, 1_usize);
        // Distance to the next value along each dimension, and the fraction.
        let mut places = [(0, 0); SIDES];
        for (place, side) in places.iter_mut().zip(self.sides.iter().flatten()) {
            let (index, fraction) = side.locate(covariates)?;
            first = first.saturating_add(index.saturating_mul(width));
            *place = (width, fraction);
            width = width.saturating_mul(side.knots.into());
        }
        let [(x, at_x), (y, at_y), (z, at_z)] = places;
        let value = |at: usize| self.values.get(at).copied();
        let line = |at: usize| Some(interpolate(value(at)?, value(at.saturating_add(x))?, at_x));
        let plane = |at: usize| Some(interpolate(line(at)?, line(at.saturating_add(y))?, at_y));
        Some(interpolate(plane(first)?, plane(first.saturating_add(z))?, at_z))
    }
}

fn interpolate(before: i32, after: i32, fraction: i64) -> i32 {
    let scaled = (i64::from(after) - i64::from(before)) * fraction + (1 << 14);
    saturate(i64::from(before) + (scaled >> 15))
}

/// An effect on the field: a value times a linear function of the field. An external field, the reading's derivative to a
/// displacement or a tilt, a gain and a small rotation are all of this form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldMap<'a> {
    /// The value.
    pub table: LookupTable<'a>,
    /// Change of the field for a value of one without a field, in field units with [`ALONG_BITS`].
    pub along: [i32; 3],
    /// Additional change per unit of field, by rows, with [`MATRIX_BITS`].
    pub matrix: [[i32; 3]; 3],
}

impl FieldMap<'_> {
    /// Subtracts the effect; `None` if an input is missing.
    pub fn compensate(
        &self,
        field: [Field; 3],
        covariates: &CovariateValues,
    ) -> Option<[Field; 3]> {
        let value = self.table.value(covariates)?;
        let [bx, by, bz] = field;
        let [ax, ay, az] = self.along;
        let [mx, my, mz] = self.matrix;
        Some([(bx, ax, mx), (by, ay, my), (bz, az, mz)].map(|(own, along, row)| {
            let change = row.iter().zip(field).fold(along, |sum, (factor, field)| {
                sum.saturating_add(mul_q(*factor, field.0, MATRIX_BITS - ALONG_BITS))
            });
            own.saturating_sub(mul_q(value, change, VALUE_BITS + ALONG_BITS))
        }))
    }
}

/// An effect on the forces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForceMap<'a> {
    /// The value.
    pub table: LookupTable<'a>,
    /// Change of Fx and Fz for a value of one, in force units with [`ALONG_BITS`].
    pub along: [i32; 2],
}

impl ForceMap<'_> {
    /// Subtracts the effect; `None` if an input is missing.
    pub fn compensate(
        &self,
        force: [Force; 2],
        covariates: &CovariateValues,
    ) -> Option<[Force; 2]> {
        let value = self.table.value(covariates)?;
        let [fx, fz] = force;
        let [ax, az] = self.along;
        Some([(fx, ax), (fz, az)].map(|(force, along)| {
            Force(force.0.saturating_sub(mul_q(value, along, VALUE_BITS + ALONG_BITS)))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A value of one.
    const ONE: i32 = 1 << VALUE_BITS;
    /// After the second tick, without forces.
    const STARTED: EstimateState =
        EstimateState { force: [Force(0); 2], ticks: 2, filters: [None; FILTERS] };

    fn side(covariate: Covariate, from: i32, step: i32, knots: u16) -> Option<LookupAxis> {
        Some(LookupAxis { covariate, from, step, knots })
    }

    fn inputs(opening_um: i32) -> AuxiliaryInputs {
        AuxiliaryInputs { opening_um: Some(opening_um), ..Default::default() }
    }

    fn value(table: &LookupTable, inputs: &AuxiliaryInputs, estimates: &EstimateState) -> i32 {
        table.value(&CovariateValues { temperature: 5, inputs, estimates }).unwrap()
    }

    #[test]
    fn one_dimension_interpolates_and_clamps() {
        let sides = [side(Covariate::Opening, 1000, 500, 3), None, None];
        let table = LookupTable { sides, values: &[0, 100, 400] };
        let at = |um| value(&table, &inputs(um), &EstimateState::default());
        assert_eq!([0, 1250, 1500, 1750].map(at), [0, 50, 100, 250]);
        assert!((399..=400).contains(&at(99_999)));
    }

    #[test]
    fn steps_of_any_length_interpolate_within_two_parts_in_10000() {
        for step in [1, 3, 1000, 65_537, 1 << 20, i32::MAX / 2, i32::MAX] {
            let sides = [side(Covariate::Opening, 0, step, 2), None, None];
            let table = LookupTable { sides, values: &[0, 1_000_000] };
            for tenth in 0..10 {
                let um = (i64::from(step) * tenth / 10) as i32;
                let expected = 1e6 * f64::from(um) / f64::from(step);
                let found = f64::from(value(&table, &inputs(um), &EstimateState::default()));
                assert!((found - expected).abs() < 100.0, "{step} {um}: {found} {expected}");
            }
        }
    }

    #[test]
    fn three_dimensions_interpolate_and_a_missing_input_is_reported() {
        let sides = [
            side(Covariate::Opening, 0, 10, 2),
            side(Covariate::Temperature, 0, 10, 2),
            side(Covariate::Force(1), -1024, 2048, 2),
        ];
        let table = LookupTable { sides, values: &[0, 100, 200, 300, 1000, 1100, 1200, 1300] };
        let estimates = EstimateState { force: [Force(0), Force(512)], ..STARTED };
        // 50 + 100 + three quarters of 1000.
        assert_eq!(value(&table, &inputs(5), &estimates), 900);
        let missing = AuxiliaryInputs::default();
        let values = CovariateValues { temperature: 5, inputs: &missing, estimates: &estimates };
        assert_eq!(table.value(&values), None);
    }

    #[test]
    fn gain_of_two_percent_is_removed_around_the_bias() {
        let sides = [side(Covariate::Opening, 0, 1000, 2), None, None];
        // 1 - 1 / 1.02 at an opening of 1 mm, of the field minus 160 units of bias along y.
        let share = 1.0 - 1.0 / 1.02;
        let row = (share * f64::from(1 << MATRIX_BITS)) as i32;
        let map = FieldMap {
            table: LookupTable { sides, values: &[0, ONE] },
            along: [0, -(share * 160.0 * f64::from(1 << ALONG_BITS)) as i32, 0],
            matrix: [[row, 0, 0], [0, row, 0], [0, 0, row]],
        };
        let measured = [10_200, 102_160, -5_100].map(Field);
        let estimates = EstimateState::default();
        let inputs = inputs(1000);
        let values = CovariateValues { temperature: 0, inputs: &inputs, estimates: &estimates };
        let found = map.compensate(measured, &values).unwrap();
        for (found, expected) in found.iter().zip([10_000, 100_160, -5_000]) {
            assert!((found.0 - expected).abs() <= 4, "{found:?} {expected}");
        }
    }

    #[test]
    fn force_map_subtracts_along_its_direction() {
        let sides = [side(Covariate::Force(0), -102_400, 204_800, 2), None, None];
        // 3 N along x and -1.5 N along z at 100 N.
        let map = ForceMap {
            table: LookupTable { sides, values: &[-ONE, ONE] },
            along: [3072 << ALONG_BITS, -1536 * (1 << ALONG_BITS)],
        };
        let estimates = EstimateState { force: [Force(51_200), Force(0)], ..STARTED };
        let inputs = AuxiliaryInputs::default();
        let values = CovariateValues { temperature: 0, inputs: &inputs, estimates: &estimates };
        let found = map.compensate([Force(50_000), Force(2000)], &values).unwrap();
        assert_eq!(found, [Force(50_000 - 1536), Force(2000 + 768)]);
    }

    #[test]
    fn filter_has_its_time_constant_and_restarts_after_a_gap() {
        // 30 s at 1 kHz; a step of 10 mm.
        let gain = (f64::from(1 << FILTER_BITS) / 30_000.0) as i32;
        let filters =
            [Some(CovariateFilter { covariate: Covariate::Opening, gain }), None, None, None];
        let mut state = STARTED;
        let lagged = |state: &EstimateState| {
            let inputs = AuxiliaryInputs::default();
            CovariateValues { temperature: 0, inputs: &inputs, estimates: state }
                .value(Covariate::Lagged(0))
        };
        state.update(&filters, 0, &inputs(0));
        (0..30_000).for_each(|_| state.update(&filters, 0, &inputs(10_000)));
        assert!((lagged(&state).unwrap() - 6321).abs() <= 2, "{:?}", lagged(&state));
        (0..300_000).for_each(|_| state.update(&filters, 0, &inputs(10_000)));
        assert!((lagged(&state).unwrap() - 10_000).abs() <= 1, "{:?}", lagged(&state));
        state.update(&filters, 0, &AuxiliaryInputs::default());
        assert_eq!(lagged(&state), None);
        state.update(&filters, 0, &inputs(4000));
        assert_eq!(lagged(&state), Some(4000));
    }

    #[test]
    fn filter_of_a_force_starts_with_the_first_estimate() {
        let filters = [
            Some(CovariateFilter { covariate: Covariate::Force(0), gain: 1 << 20 }),
            None,
            None,
            None,
        ];
        let (mut state, inputs) = (EstimateState::default(), AuxiliaryInputs::default());
        let lagged = [5000, 6000, 6000].map(|force| {
            state.update(&filters, 0, &inputs);
            let values = CovariateValues { temperature: 0, inputs: &inputs, estimates: &state };
            let found = values.value(Covariate::Lagged(0));
            state.set_force([Force(force), Force(0)]);
            found
        });
        assert_eq!(lagged, [Some(0), Some(5000), Some(5000)]);
    }

    #[test]
    fn rate_of_a_ramp_is_its_slope_times_the_time_constant() {
        // 20 mm/s and 20 ticks: 0.4 mm less the step of a tick.
        let gain = (1 << FILTER_BITS) / 20;
        let filters =
            [Some(CovariateFilter { covariate: Covariate::Opening, gain }), None, None, None];
        let mut state = STARTED;
        (0..1000).for_each(|tick| state.update(&filters, 0, &inputs(20 * tick)));
        let values = CovariateValues {
            temperature: 0,
            inputs: &AuxiliaryInputs::default(),
            estimates: &state,
        };
        let rate = f64::from(values.value(Covariate::Rate(0)).unwrap());
        assert!((rate / f64::from(1 << RATE_BITS) - 380.0).abs() < 0.1, "{rate}");
    }

    #[test]
    fn any_numbers_in_tables_and_filters_saturate() {
        let ends = [i32::MIN, -1, 0, 1, i32::MAX];
        for (a, b) in ends.into_iter().flat_map(|a| ends.map(|b| (a, b))) {
            let covariate = Covariate::Force(0);
            let filters = [Some(CovariateFilter { covariate, gain: b }); FILTERS];
            let sides = [
                side(covariate, a, b, u16::MAX),
                side(Covariate::Rate(3), b, a, 2),
                side(Covariate::Lagged(9), 0, 1, 0),
            ];
            let values = &[a, b, a, b];
            let mut state = EstimateState { force: [Force(a); 2], ..STARTED };
            state.update(&filters, a, &AuxiliaryInputs::default());
            state.set_force([Force(b); 2]);
            state.update(&filters, b, &AuxiliaryInputs::default());
            let inputs = AuxiliaryInputs::default();
            let covariates = CovariateValues { temperature: a, inputs: &inputs, estimates: &state };
            for sides in [sides, [sides[1], None, None], [None; SIDES]] {
                let table = LookupTable { sides, values };
                let field = FieldMap { table, along: [a; 3], matrix: [[b; 3]; 3] };
                field.compensate([Field(a); 3], &covariates);
                ForceMap { table, along: [b; 2] }.compensate([Force(a); 2], &covariates);
            }
        }
    }
}
