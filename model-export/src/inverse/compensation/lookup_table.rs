//! Formulas as lookup tables over the covariates of the board.

use firmware::compensation::lookup_table::{
    ALONG_BITS, Covariate, CovariateFilter, FILTER_BITS, FILTERS, FieldMap, ForceMap, LookupAxis,
    LookupTable, MATRIX_BITS, RATE_BITS, SIDES, VALUE_BITS,
};
use firmware::compensation::thermal;
use firmware::config::constants;
use firmware::fixed_point::Force;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::effects::expression::Quantity;
use crate::effects::{Expression, REFERENCE_C};
use crate::inverse::compensation::effect_tables::RATE_FILTER_MS;
use crate::inverse::compensation::{Converter, NotCompensable};
use crate::inverse::grbf::nearest_forces;
use crate::inverse::static_model::ForceRegion;
use crate::recordings::columns::force_column;

/// Maximum number of values of a table, and of cells along a side.
const MAX_VALUES: usize = 1089;
const MAX_CELLS: usize = 512;
/// Maximum interpolation error relative to the largest value: of a chosen table, and of one that is accepted because the device
/// holds no larger one.
const INTERPOLATION_ERROR: f64 = 0.005;
const ACCEPTED_ERROR: f64 = 0.1;
/// Cells of the lines along which the interpolation error is measured, and levels of the other covariates.
const FINE_CELLS: usize = 1024;
const LEVELS: usize = 5;
/// Range of a force and of its rate per second, relative to the forces in which the model is valid.
const FORCE_RANGE: f64 = 1.1;
const RATE_RANGE: f64 = 20.0;
/// Range of the opening's rate in mm/s.
const OPENING_RATE_RANGE: f64 = 200.0;
/// Longest time constant in milliseconds of the low passes of a rate.
const MAX_RATE_FILTER_MS: f64 = 50.0;
/// Maximum change of a gain.
const MAX_GAIN_CHANGE: f64 = 0.5;
/// Force in newtons by which an effect over the forces may change per newton: the device subtracts the effect at its
/// estimate of the tick before, whose error falls by this factor with each tick.
const MAX_FEEDBACK: f64 = 0.5;

/// Owned lookup table.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedTable {
    sides: [Option<LookupAxis>; SIDES],
    values: Vec<i32>,
}

impl OwnedTable {
    fn view(&self) -> LookupTable<'_> {
        LookupTable { sides: self.sides, values: &self.values }
    }
}

/// Owned effect on the field.
#[derive(Clone, Debug)]
pub(super) struct OwnedFieldMap {
    table: OwnedTable,
    along: [i32; 3],
    matrix: [[i32; 3]; 3],
}

impl OwnedFieldMap {
    pub(super) fn view(&self) -> FieldMap<'_> {
        FieldMap { table: self.table.view(), along: self.along, matrix: self.matrix }
    }
}

/// Owned effect on the forces.
#[derive(Clone, Debug)]
pub(super) struct OwnedForceMap {
    table: OwnedTable,
    along: [i32; 2],
}

impl OwnedForceMap {
    pub(super) fn view(&self) -> ForceMap<'_> {
        ForceMap { table: self.table.view(), along: self.along }
    }
}

/// A formula on the device.
pub(super) struct ConvertedFormula {
    pub(super) map: OwnedMap,
    /// Change of each force in newtons per newton of the estimate of each force, at most: a row for each force that it changes.
    pub(super) feedback: Matrix2<f64>,
}

/// By the quantity that it changes.
pub(super) enum OwnedMap {
    Field(OwnedFieldMap),
    Force(OwnedForceMap),
}

/// A column as the board has it, over the range of a table.
#[derive(Clone, Copy)]
struct BoardColumn {
    covariate: Covariate,
    /// Whether the column is the rate of the covariate.
    is_rate: bool,
    from: f64,
    to: f64,
    /// Units of the covariate per unit of the column, and the column at its zero.
    per_unit: f64,
    zero: f64,
}

impl BoardColumn {
    fn depends_on_force(&self) -> bool {
        matches!(self.covariate, Covariate::Force(_))
    }

    /// Value at this fraction of the range.
    fn at(&self, fraction: f64) -> f64 {
        self.from + (self.to - self.from) * fraction
    }
}

/// An input of a formula.
struct TableInput {
    column: BoardColumn,
    /// Time constant of its low pass in seconds.
    lag_s: Option<f64>,
}

/// A dimension of a table.
struct TableAxis {
    axis: LookupAxis,
    /// Units of the axis per unit of the formula's input, and the input at the axis' zero.
    per_unit: f64,
    zero: f64,
}

/// Change by a formula per unit of its value.
enum Direction {
    /// Forces in newtons.
    Force(Vector2<f64>),
    /// Field in gauss: of no field, and additionally per gauss.
    Field { along_g: Vector3<f64>, matrix: Matrix3<f64> },
}

/// Why the device compensates a formula with no values of its parameters; `None` if it compensates it with some.
pub(in crate::inverse) fn unsupported(formula: &Expression) -> Option<String> {
    for column in &formula.covariates {
        match column.as_str() {
            "time_s" | "session_s" => {
                return Some(format!(
                    "the board does not know {column}: it has no start of a recording"
                ));
            }
            "roll_rad" | "pitch_rad" | "yaw_rad" => {
                return Some(format!(
                    "its tables are not over angles of the attitude such as {column}; use accel_x_mps2, accel_y_mps2 or accel_z_mps2, which contain gravity"
                ));
            }
            force if force_column(force).is_ok() => {
                return Some(format!(
                    "the tables of a sensor are not over the force on another, {column}"
                ));
            }
            _ if board_column(column, ForceRegion::symmetric(1.0)).is_none() => {
                return Some(format!("the board does not know {column}"));
            }
            _ => {}
        }
    }
    let inputs = formula.inputs(&[]);
    if inputs.iter().any(|(column, lag)| *column == "motor_angle_rad" && lag.is_some()) {
        return Some(
            "the board measures motor_angle_rad modulo one turn: it has no lag".to_owned(),
        );
    }
    match inputs.len() {
        0 => Some("a constant is part of the base: fit again without it".to_owned()),
        1..=SIDES => None,
        count => Some(format!(
            "it depends on {count} quantities, and the device holds tables over {SIDES}"
        )),
    }
}

/// A column over the range of a table, for a model that is valid in this region; `None` if the board does not have it.
fn board_column(column: &str, region: ForceRegion) -> Option<BoardColumn> {
    let plain = |covariate, from, to, per_unit| BoardColumn {
        covariate,
        is_rate: false,
        from,
        to,
        per_unit,
        zero: 0.0,
    };
    let force = |axis: u8| {
        let range = region.scaled(FORCE_RANGE);
        let [from, to] = [-1.0, 1.0].map(|end| range.at([end; 2])[usize::from(axis)]);
        plain(Covariate::Force(axis), from, to, Force::PER_NEWTON)
    };
    let rate =
        |of: BoardColumn, range: f64| BoardColumn { is_rate: true, from: -range, to: range, ..of };
    let opening = plain(Covariate::Opening, 0.0, 64.0, 1e3);
    let acceleration = |axis: u8| plain(Covariate::Acceleration(axis), -40.0, 40.0, 1e3);
    Some(match column {
        "opening_mm" => opening,
        "opening_rate_mm_per_s" => rate(opening, OPENING_RATE_RANGE),
        "motor_iq_a" => plain(Covariate::MotorIq, -32.0, 32.0, 1e3),
        "motor_angle_rad" => plain(Covariate::MotorAngle, 0.0, std::f64::consts::TAU, 1e6),
        "accel_x_mps2" => acceleration(0),
        "accel_y_mps2" => acceleration(1),
        "accel_z_mps2" => acceleration(2),
        "temp_c" => BoardColumn {
            zero: REFERENCE_C,
            ..plain(
                Covariate::Temperature,
                -10.0,
                90.0,
                constants::TEMPERATURE_SCALE.value * f64::from(1 << thermal::TEMPERATURE_BITS),
            )
        },
        "fx_n" => force(0),
        "fz_n" => force(1),
        "fx_rate_n_per_s" => rate(force(0), RATE_RANGE * region.half_n[0]),
        "fz_rate_n_per_s" => rate(force(1), RATE_RANGE * region.half_n[1]),
        _ => return None,
    })
}

impl Converter<'_> {
    /// Converts a formula; adds the filters that it needs.
    pub(super) fn formula(
        &self,
        formula: &Expression,
        values: &[f64],
        filters: &mut Vec<CovariateFilter>,
    ) -> Result<ConvertedFormula, NotCompensable> {
        if let Some(why) = unsupported(formula) {
            return Err(self.error(why));
        }
        self.check_turns(formula, values)?;
        let region = self.model.region();
        let inputs: Vec<TableInput> = formula
            .inputs(values)
            .into_iter()
            .filter_map(|(name, lag_s)| {
                Some(TableInput { column: board_column(name, region)?, lag_s })
            })
            .collect();
        let evaluate = |columns: Vec<Vec<f64>>| self.evaluate(formula, values, columns);
        let cells = self.cells(&inputs, &evaluate)?;
        let direction = self.direction(formula)?;
        let sensitivity = self.sensitivity(&inputs, &direction, &evaluate)?;
        let mut feedback = Matrix2::zeros();
        let mut axes = Vec::new();
        for ((input, cells), sensitivity) in inputs.iter().zip(cells).zip(sensitivity) {
            let largest = sensitivity.norm();
            let rate_s = (1e-3 * RATE_FILTER_MS).max(1.05 * largest).min(1e-3 * MAX_RATE_FILTER_MS);
            if let Covariate::Force(axis) = input.column.covariate {
                let mut column = feedback.column_mut(usize::from(axis).min(1));
                column += match input.column.is_rate {
                    // The largest gain of the two low passes with the derivative, at the corner frequency.
                    true => sensitivity / (2.0 * rate_s),
                    false => sensitivity,
                };
            }
            axes.push(self.axis(input, cells, rate_s, filters)?);
        }
        self.check_feedback(&feedback)?;
        let (table, largest) = self.table(&axes, &evaluate)?;
        let map = match direction {
            Direction::Force(along_n) => {
                let along = along_n * (largest * Force::PER_NEWTON);
                let along =
                    [self.integer(along.x, ALONG_BITS)?, self.integer(along.y, ALONG_BITS)?];
                OwnedMap::Force(OwnedForceMap { table, along })
            }
            Direction::Field { along_g, matrix } => OwnedMap::Field(OwnedFieldMap {
                table,
                along: self.three(along_g * (largest * self.units), ALONG_BITS)?,
                matrix: self.matrix(matrix * largest, MATRIX_BITS)?,
            }),
        };
        Ok(ConvertedFormula { map, feedback })
    }

    /// Checks that the device's estimates converge.
    pub(super) fn check_feedback(&self, feedback: &Matrix2<f64>) -> Result<(), NotCompensable> {
        let feedback = feedback.singular_values().max();
        if feedback < MAX_FEEDBACK {
            return Ok(());
        }
        Err(self.error(format!(
            "it changes the force by up to {feedback:.2} N per newton of the forces that it depends on; the device subtracts it at its estimate of the tick before, which converges below {MAX_FEEDBACK} N: write it with other covariates"
        )))
    }

    /// Values of a formula at rows of its inputs, 0 where it is undefined. Of a gain: the share of the reading to subtract.
    fn evaluate(
        &self,
        formula: &Expression,
        values: &[f64],
        columns: Vec<Vec<f64>>,
    ) -> Result<Vec<f64>, NotCompensable> {
        let mut found = formula.values_at(values, columns);
        let is_gain = matches!(formula.target().0, Quantity::Gain | Quantity::AxisGain);
        for value in &mut found {
            if !value.is_finite() {
                *value = 0.0;
            }
            if is_gain {
                let change = 0.01 * *value;
                if change.abs() > MAX_GAIN_CHANGE {
                    return Err(self.error(format!(
                        "it changes a gain by {value:.0} % within the range of the board's covariates, and the device allows {:.0} %",
                        100.0 * MAX_GAIN_CHANGE
                    )));
                }
                *value = change / (1.0 + change);
            }
        }
        Ok(found)
    }

    /// What a unit of the formula's value changes. Derivatives to displacement and tilt are linear functions of the field, as
    /// [`Self::linear_in_field`]; a rotation is of first order, with an error of the square of its angle.
    fn direction(&self, formula: &Expression) -> Result<Direction, NotCompensable> {
        let model = self.model;
        let (quantity, axis) = formula.target();
        let along: Vector3<f64> = Vector3::ith(axis, 1.0);
        let in_plane = along.xz();
        let of_reading =
            |matrix: Matrix3<f64>| Direction::Field { along_g: -matrix * model.bias_g(), matrix };
        let of_state = |derivative: &dyn Fn([f64; 2]) -> Vector3<f64>| {
            let fitted = self.linear_in_field(derivative)?;
            let along_g = fitted.rest_g - fitted.bend * fitted.at_g;
            Ok(Direction::Field { along_g, matrix: fitted.bend })
        };
        Ok(match quantity {
            Quantity::Force => Direction::Force(in_plane),
            // A displacement in the plane of motion is equivalent to a force of the flexure.
            Quantity::Displacement if axis != 1 => {
                let [kx, kz] = model.stiffness_n_per_mm();
                Direction::Force(in_plane.component_mul(&Vector2::new(1e-3 * kx, 1e-3 * kz)))
            }
            Quantity::Displacement => {
                of_state(&|force_n| model.response(force_n).per_mm.column(axis) * 1e-3)?
            }
            Quantity::Tilt => {
                of_state(&|force_n| model.response(force_n).per_tilt[axis / 2] * 1e-3)?
            }
            Quantity::Field => {
                Direction::Field { along_g: model.element() * along, matrix: Matrix3::zeros() }
            }
            Quantity::Gain => of_reading(Matrix3::identity()),
            Quantity::AxisGain => of_reading(Matrix3::from_diagonal(&along)),
            Quantity::Rotation => of_reading(along.cross_matrix() * 1e-3),
        })
    }

    /// The board measures the rotor angle modulo one turn: the formula must be periodic.
    fn check_turns(&self, formula: &Expression, values: &[f64]) -> Result<(), NotCompensable> {
        let inputs = formula.inputs(values);
        let Some(i) = inputs.iter().position(|(column, _)| *column == "motor_angle_rad") else {
            return Ok(());
        };
        let at = |angle: f64| {
            let mut covariates = vec![1.0; inputs.len()];
            covariates[i] = angle;
            formula.value(values, &covariates).0
        };
        let differs = |angle: f64| {
            let (one, next) = (at(angle), at(angle + std::f64::consts::TAU));
            (one - next).abs() > 1e-6 * one.abs().max(1e-9)
        };
        if [0.3, 1.7, 4.1].into_iter().any(differs) {
            Err(self.error("the board measures motor_angle_rad modulo one turn, and the formula is not periodic"))
        } else {
            Ok(())
        }
    }

    /// Cells along each side: a power of two, the least whose linear interpolation is close enough.
    fn cells(
        &self,
        inputs: &[TableInput],
        evaluate: &dyn Fn(Vec<Vec<f64>>) -> Result<Vec<f64>, NotCompensable>,
    ) -> Result<Vec<usize>, NotCompensable> {
        let points = FINE_CELLS + 1;
        let mut lines = Vec::new();
        for side in 0..inputs.len() {
            let mut counts = vec![LEVELS; inputs.len()];
            counts[side] = 1;
            let mut columns = vec![Vec::new(); inputs.len()];
            for start in lattice(&counts) {
                for point in 0..points {
                    for (i, (input, level)) in inputs.iter().zip(&start).enumerate() {
                        let fraction = match i == side {
                            true => point as f64 / FINE_CELLS as f64,
                            false => *level as f64 / (LEVELS - 1) as f64,
                        };
                        columns[i].push(input.column.at(fraction));
                    }
                }
            }
            lines.push(evaluate(columns)?);
        }
        let largest = lines.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs()));
        let error = |side: usize, cells: usize| {
            let stride = FINE_CELLS / cells;
            let mut error = 0.0_f64;
            for line in lines[side].chunks(points) {
                for (i, value) in line.iter().enumerate() {
                    let before = i / stride * stride;
                    let after = (before + stride).min(FINE_CELLS);
                    let fraction = (i - before) as f64 / stride as f64;
                    let interpolated = line[before] + (line[after] - line[before]) * fraction;
                    error = error.max((interpolated - value).abs());
                }
            }
            error
        };
        let mut cells: Vec<usize> = (0..inputs.len())
            .map(|side| {
                let mut cells = 1;
                while cells < MAX_CELLS && error(side, cells) > INTERPOLATION_ERROR * largest {
                    cells *= 2;
                }
                cells
            })
            .collect();
        let count = |cells: &[usize]| cells.iter().map(|cells| cells + 1).product::<usize>();
        while count(&cells) > MAX_VALUES {
            let most = cells.iter_mut().max();
            most.into_iter().for_each(|most| *most /= 2);
        }
        let errors = cells.iter().enumerate().map(|(side, cells)| error(side, *cells));
        let error = errors.sum::<f64>() / largest.max(f64::MIN_POSITIVE);
        if error > ACCEPTED_ERROR {
            return Err(self.error(format!(
                "it varies too fast for the device's table of {MAX_VALUES} values: the interpolation error is {:.0} % of its largest value; use fewer periods or fewer covariates",
                100.0 * error
            )));
        }
        Ok(cells)
    }

    /// Change of both forces in newtons per unit of each input that depends on a force, at most; 0 for the others.
    fn sensitivity(
        &self,
        inputs: &[TableInput],
        direction: &Direction,
        evaluate: &dyn Fn(Vec<Vec<f64>>) -> Result<Vec<f64>, NotCompensable>,
    ) -> Result<Vec<Vector2<f64>>, NotCompensable> {
        if !inputs.iter().any(|input| input.column.depends_on_force()) {
            return Ok(vec![Vector2::zeros(); inputs.len()]);
        }
        let levels = lattice(&vec![LEVELS; inputs.len()]);
        let at = |i: usize, level: usize, by: f64| {
            inputs[i].column.at((level as f64 / (LEVELS - 1) as f64 + by).clamp(0.0, 1.0))
        };
        let columns = |moved: usize, by: f64| -> Vec<Vec<f64>> {
            let column = |i: usize| {
                let by = if i == moved { by } else { 0.0 };
                levels.iter().map(|level| at(i, level[i], by)).collect()
            };
            (0..inputs.len()).map(column).collect()
        };
        // Forces of a unit of the value, at the forces of each point.
        let values = evaluate(columns(0, 0.0))?;
        let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let force_n = |level: &[usize]| {
            let mut coordinates = [0.0; 2];
            for (i, input) in inputs.iter().enumerate() {
                if let (Covariate::Force(axis), false) =
                    (input.column.covariate, input.column.is_rate)
                {
                    coordinates[usize::from(axis)] =
                        2.0 * level[i] as f64 / (LEVELS - 1) as f64 - 1.0;
                }
            }
            self.model.region().at(coordinates)
        };
        let per_value = |force_n: [f64; 2]| match direction {
            Direction::Force(along_n) => along_n.abs(),
            Direction::Field { along_g, matrix } => {
                let field_g = self.model.field(force_n);
                let changed = field_g + (along_g + matrix * field_g) * largest;
                let nearest = Vector2::from(nearest_forces(self.model, &changed, force_n));
                (nearest - Vector2::from(force_n)).abs() / largest.max(f64::MIN_POSITIVE)
            }
        };
        let mut known: Vec<([f64; 2], Vector2<f64>)> = Vec::new();
        let mut per_value_at = |force: [f64; 2]| {
            if let Some((_, found)) = known.iter().find(|(own, _)| *own == force) {
                return *found;
            }
            known.push((force, per_value(force)));
            known.last().map_or(Vector2::zeros(), |(_, found)| *found)
        };
        let scales: Vec<Vector2<f64>> =
            levels.iter().map(|level| per_value_at(force_n(level))).collect();
        const STEP: f64 = 0.01;
        let mut sensitivity = vec![Vector2::zeros(); inputs.len()];
        for (i, input) in inputs.iter().enumerate() {
            if !input.column.depends_on_force() {
                continue;
            }
            let (before, after) = (evaluate(columns(i, -STEP))?, evaluate(columns(i, STEP))?);
            for (point, level) in levels.iter().enumerate() {
                let distance = at(i, level[i], STEP) - at(i, level[i], -STEP);
                let slope = (after[point] - before[point]) / distance;
                sensitivity[i] = sensitivity[i].sup(&(scales[point] * slope.abs()));
            }
        }
        Ok(sensitivity)
    }

    /// Dimension of the table over an input; `rate_s`: time constant of the low passes of a rate.
    fn axis(
        &self,
        input: &TableInput,
        cells: usize,
        rate_s: f64,
        filters: &mut Vec<CovariateFilter>,
    ) -> Result<TableAxis, NotCompensable> {
        let tick_s = 1.0 / constants::SENSE_RATE.value;
        let column = &input.column;
        let (mut covariate, mut per_unit) = (column.covariate, column.per_unit);
        let mut filter = |covariate: Covariate, time_s: f64| {
            let share = -libm::expm1(-tick_s / time_s);
            let filter = CovariateFilter { covariate, gain: self.integer(share, FILTER_BITS)? };
            let known = filters.iter().position(|own| *own == filter);
            let number = known.unwrap_or(filters.len());
            if known.is_none() {
                filters.push(filter);
            }
            if number >= FILTERS {
                return Err(self.error(format!(
                    "with it a sensor needs {} filters of rates and lags, and the device has {FILTERS}",
                    number + 1
                )));
            }
            Ok((number as u8, share))
        };
        if column.is_rate {
            let (number, share) = filter(covariate, rate_s)?;
            covariate = Covariate::Rate(number);
            // On a ramp the second low pass trails the first by this time.
            per_unit *= tick_s * (1.0 - share) / share * f64::from(1 << RATE_BITS);
        }
        if let Some(time_s) = input.lag_s {
            let (number, _) = filter(covariate, time_s)?;
            covariate = Covariate::Lagged(number);
        }
        let axis = LookupAxis {
            covariate,
            from: self.integer((column.from - column.zero) * per_unit, 0)?,
            step: self.integer((column.to - column.from) * per_unit / cells as f64, 0)?.max(1),
            knots: cells as u16 + 1,
        };
        Ok(TableAxis { axis, per_unit, zero: column.zero })
    }

    /// The table and its largest value.
    fn table(
        &self,
        axes: &[TableAxis],
        evaluate: &dyn Fn(Vec<Vec<f64>>) -> Result<Vec<f64>, NotCompensable>,
    ) -> Result<(OwnedTable, f64), NotCompensable> {
        let knots: Vec<usize> = axes.iter().map(|of| of.axis.knots.into()).collect();
        let places = lattice(&knots);
        let column = |(i, of): (usize, &TableAxis)| -> Vec<f64> {
            let (from, step) = (f64::from(of.axis.from), f64::from(of.axis.step));
            let at = |place: &Vec<usize>| of.zero + (from + step * place[i] as f64) / of.per_unit;
            places.iter().map(at).collect()
        };
        let found = evaluate(axes.iter().enumerate().map(column).collect())?;
        let largest = found.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let scale = largest.max(f64::MIN_POSITIVE);
        let values: Result<Vec<i32>, NotCompensable> =
            found.iter().map(|value| self.integer(value / scale, VALUE_BITS)).collect();
        let mut sides = [None; SIDES];
        sides.iter_mut().zip(axes).for_each(|(side, of)| *side = Some(of.axis));
        Ok((OwnedTable { sides, values: values? }, largest))
    }
}

/// All places of a lattice with so many points along each side, the first side fastest.
fn lattice(counts: &[usize]) -> Vec<Vec<usize>> {
    let total = counts.iter().product();
    let place = |mut index: usize| {
        let digit = |count: &usize| {
            let digit = index % count;
            index /= count;
            digit
        };
        counts.iter().map(digit).collect()
    };
    (0..total).map(place).collect()
}
