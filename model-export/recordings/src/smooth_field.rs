//! A smooth through the field of one sensor over recordings: a polynomial in its forces and in the covariates on which the field
//! depends, with the rates of the forces and a cubic in time. It serves the estimate of the noise only, never a model.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector3};

use crate::Recording;
use crate::columns::Axis;
use crate::noise::autocorrelation_rows;
use crate::smoothing;

/// Maximum number of terms.
pub const MAX_TERMS: usize = 70;
/// Minimum number of rows for each term.
pub const ROWS_PER_TERM: usize = 12;
/// Maximum number of rows that are fitted.
const MAX_ROWS: usize = 4000;
/// Maximum degree of the polynomial in the forces and the leading covariates.
const MAX_DEGREE: usize = 5;
/// Maximum number of leading covariates.
const MAX_LEADING: usize = 3;
/// Share of the residual that a covariate explains, from which it is a leading one.
const LEADING_SHARE: f64 = 0.02;
/// Time constants of the past of a covariate, as shares of the recording.
const HISTORIES: [f64; 2] = [0.025, 0.1];
/// Ridge relative to the mean of the diagonal.
const RIDGE: f64 = 1e-11;
/// Step of the derivative to a force, in half spans.
const STEP: f64 = 1e-4;

/// Fitted smooth with its residual.
pub struct SmoothField {
    /// Forces of the polynomial.
    pub forces: Vec<(u32, Axis)>,
    /// Rows of the recording with field and forces.
    pub rows: Vec<usize>,
    /// Residual of each of these rows in gauss.
    pub residual_g: Vec<Vector3<f64>>,
    /// Derivative to each force in G/N, by row.
    pub slopes: Vec<Vec<Vector3<f64>>>,
    /// Share of the field's variance that the smooth explains.
    pub explained: f64,
    /// Covariates on which the field depends, by column name.
    pub covariates: Vec<String>,
    /// Number of terms.
    terms: usize,
}

/// A column, scaled to -1 to 1.
struct Scaled {
    values: Vec<f64>,
    half_span: f64,
}

impl Scaled {
    /// `None` for a constant or a column with missing values.
    fn of(column: impl Iterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = column.collect();
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let half_span = 0.5 * (high - low);
        let is_usable = values.iter().all(|value| value.is_finite()) && half_span > 0.0;
        let middle = 0.5 * (high + low);
        is_usable.then(|| Self {
            values: values.iter().map(|value| (value - middle) / half_span).collect(),
            half_span,
        })
    }
}

/// Values that follow a column with this time constant in seconds, from its first value on.
fn low_pass(time_s: &[f64], values: &[f64], tau_s: f64) -> Vec<f64> {
    let mut followed = values.first().copied().unwrap_or(0.0);
    let mut before_s = time_s.first().copied().unwrap_or(0.0);
    let follow = |(time_s, value): (&f64, &f64)| {
        followed += (value - followed) * (1.0 - libm::exp(-(time_s - before_s) / tau_s));
        before_s = *time_s;
        followed
    };
    time_s.iter().zip(values).map(follow).collect()
}

/// Exponents of all monomials of `variables` up to `degree`.
fn monomials(variables: usize, degree: usize) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new()];
    for _ in 0..variables {
        all = all
            .iter()
            .flat_map(|powers: &Vec<usize>| {
                let left = degree - powers.iter().sum::<usize>();
                (0..=left).map(move |power| [&powers[..], &[power]].concat())
            })
            .collect();
    }
    all
}

/// Polynomial in the leading columns, and further columns that enter linearly.
struct Basis<'a> {
    leading: Vec<&'a Scaled>,
    powers: Vec<Vec<usize>>,
    further: Vec<&'a [f64]>,
}

impl<'a> Basis<'a> {
    /// The highest degree that leaves room for the further columns in `budget` terms.
    fn new(leading: Vec<&'a Scaled>, further: Vec<&'a [f64]>, budget: usize) -> Self {
        let room = budget.saturating_sub(further.len());
        let degree = (1..=MAX_DEGREE)
            .rev()
            .find(|degree| monomials(leading.len(), *degree).len() <= room)
            .unwrap_or(1);
        Self { powers: monomials(leading.len(), degree), leading, further }
    }

    fn len(&self) -> usize {
        self.powers.len() + self.further.len()
    }

    /// Terms of a row; one of the leading columns may be moved.
    fn terms(&self, row: usize, moved: Option<(usize, f64)>) -> DVector<f64> {
        let value = |column: usize| {
            let step = moved.filter(|(of, _)| *of == column).map_or(0.0, |(_, step)| step);
            self.leading[column].values[row] + step
        };
        let products = self.powers.iter().map(|powers| {
            let factors = powers.iter().enumerate().filter(|(_, power)| **power > 0);
            factors.map(|(column, &power)| value(column).powi(power as i32)).product::<f64>()
        });
        let further = self.further.iter().map(|column| column[row]);
        DVector::from_iterator(self.len(), products.chain(further))
    }

    /// Coefficients by axis, from evenly spaced rows.
    fn fit(&self, field: &[Vector3<f64>]) -> Option<DMatrix<f64>> {
        let mut normal = DMatrix::zeros(self.len(), self.len());
        let mut right = DMatrix::zeros(self.len(), 3);
        for row in (0..field.len()).step_by(field.len().div_ceil(MAX_ROWS).max(1)) {
            let terms = self.terms(row, None);
            normal.ger(1.0, &terms, &terms, 1.0);
            right.ger(1.0, &terms, &field[row], 1.0);
        }
        let ridge = RIDGE * normal.trace() / self.len() as f64;
        let ridge = DMatrix::identity(self.len(), self.len()) * ridge;
        Some((normal + ridge).cholesky()?.solve(&right))
    }

    fn residual(&self, field: &[Vector3<f64>]) -> Option<(DMatrix<f64>, Vec<Vector3<f64>>)> {
        let coefficients = self.fit(field)?;
        let modelled = |row: usize| {
            let sum = coefficients.tr_mul(&self.terms(row, None));
            Vector3::new(sum[0], sum[1], sum[2])
        };
        let residual = (0..field.len()).map(|row| field[row] - modelled(row)).collect();
        Some((coefficients, residual))
    }
}

/// Recordings one after the other, with the first row of each; `None` where they have other columns.
fn joined(recordings: &[Recording], sensor: u32) -> Option<(Recording, Vec<usize>)> {
    let mut all = recordings.first()?.without_rows();
    let mut starts = Vec::new();
    for one in recordings {
        let first = recordings.first()?;
        let is_same = one.forces.keys().eq(first.forces.keys())
            && one.covariates.keys().eq(first.covariates.keys());
        let (own, to) = (one.sensors.get(&sensor)?, all.sensors.get_mut(&sensor)?);
        if !is_same
            || own.temperature_c.is_empty() != first.sensors.get(&sensor)?.temperature_c.is_empty()
        {
            return None;
        }
        to.field_g.extend(&own.field_g);
        to.temperature_c.extend(&own.temperature_c);
        for (key, force) in &one.forces {
            all.forces.entry(*key).or_default().newtons.extend(&force.newtons);
        }
        for (name, values) in &one.covariates {
            all.covariates.entry(name.clone()).or_default().extend(values);
        }
        let from_s = one.time_s.first().copied().unwrap_or(0.0);
        let after_s = all.time_s.last().map_or(0.0, |last| last + 1.0);
        starts.push(all.time_s.len());
        all.time_s.extend(one.time_s.iter().map(|time_s| time_s - from_s + after_s));
    }
    Some((all, starts))
}

impl SmoothField {
    /// Through the field of `sensor` over its own forces (or all, where there are none of its own) and all covariates, with at most
    /// `terms` terms. `None` with too few rows.
    pub fn of(recording: &Recording, sensor: u32, terms: usize) -> Option<Self> {
        Self::of_parts(recording, sensor, terms, &[0])
    }

    /// One smooth through all recordings, with an offset for each: of few rows each, together they determine more terms. `None` where
    /// they have other columns.
    pub fn through(recordings: &[Recording], sensor: u32, terms: usize) -> Option<Vec<Self>> {
        let (all, starts) = joined(recordings, sensor)?;
        let whole = Self::of_parts(&all, sensor, terms, &starts)?;
        let share = whole.terms as f64 / whole.rows.len() as f64;
        let part = |(index, from): (usize, &usize)| {
            let end = starts.get(index + 1).copied().unwrap_or(all.time_s.len());
            let places = whole.places(*from..end);
            Self {
                forces: whole.forces.clone(),
                rows: whole.rows[places.clone()].iter().map(|row| row - from).collect(),
                residual_g: whole.residual_g[places.clone()].to_vec(),
                slopes: whole.slopes[places.clone()].to_vec(),
                explained: whole.explained,
                covariates: whole.covariates.clone(),
                terms: (share * places.len() as f64).ceil() as usize,
            }
        };
        Some(starts.iter().enumerate().map(part).collect())
    }

    /// Places of these rows of the recording among its own.
    fn places(&self, rows: Range<usize>) -> Range<usize> {
        let place = |row: usize| self.rows.partition_point(|own| *own < row);
        place(rows.start)..place(rows.end)
    }

    /// `starts`: first row of each part of the recording, between which the rows have no order.
    fn of_parts(
        recording: &Recording,
        sensor: u32,
        terms: usize,
        starts: &[usize],
    ) -> Option<Self> {
        let series = recording.sensors.get(&sensor)?;
        let keys = || recording.forces.keys().copied();
        let own: Vec<(u32, Axis)> = keys().filter(|(place, _)| *place == sensor).collect();
        let forces: Vec<(u32, Axis)> = if own.is_empty() { keys().collect() } else { own };
        let newtons: Vec<&[f64]> = forces
            .iter()
            .filter_map(|key| recording.forces.get(key))
            .map(|force| force.newtons.as_slice())
            .collect();
        let is_usable = |row: &usize| {
            series.field_g[*row].iter().all(|b| b.is_finite())
                && newtons.iter().all(|column| column[*row].is_finite())
        };
        let rows: Vec<usize> = (0..series.field_g.len()).filter(is_usable).collect();
        let budget = terms.min(rows.len() / ROWS_PER_TERM);
        let place = |row: &usize| rows.partition_point(|own| own < row);
        let ends = starts.iter().skip(1).map(place).chain([rows.len()]);
        let parts: Vec<Range<usize>> =
            starts.iter().map(place).zip(ends).map(|(from, end)| from..end).collect();
        if 3 * (parts.len() - 1) > budget {
            return None;
        }
        let at = |column: &[f64]| Scaled::of(rows.iter().map(|&row| column[row]));
        let loads: Vec<(usize, Scaled)> = newtons
            .iter()
            .enumerate()
            .filter_map(|(force, column)| Some((force, at(column)?)))
            .collect();
        if budget < 2 + loads.len() {
            return None;
        }
        let field: Vec<Vector3<f64>> =
            rows.iter().map(|&row| Vector3::from(series.field_g[row])).collect();
        let time_s: Vec<f64> = rows.iter().map(|&row| recording.time_s[row]).collect();
        let temperature = (!series.temperature_c.is_empty()).then_some(&series.temperature_c);
        let columns = recording.covariates.iter().map(|(name, values)| (name.as_str(), values));
        let columns = columns.chain(temperature.map(|values| ("temp_c", values)));
        let (names, covariates): (Vec<&str>, Vec<Scaled>) =
            columns.filter_map(|(name, values)| Some((name, at(values)?))).unzip();
        let squares: Vec<Vec<f64>> = covariates
            .iter()
            .map(|column| column.values.iter().map(|value| value * value).collect())
            .collect();
        let clock = Scaled::of(time_s.iter().copied())?;
        let power = |power: i32| -> Vec<f64> {
            clock.values.iter().map(|value| value.powi(power)).collect()
        };
        let offset = |part: &Range<usize>| -> Vec<f64> {
            (0..rows.len()).map(|row| f64::from(part.contains(&row))).collect()
        };
        let mut further: Vec<Vec<f64>> = parts.iter().skip(1).map(offset).collect();
        further.extend([1, 2, 3].map(power));
        let by_part = |of: &dyn Fn(Range<usize>) -> Vec<f64>| -> Vec<f64> {
            parts.iter().flat_map(|part| of(part.clone())).collect()
        };
        for (_, load) in &loads {
            let rates =
                by_part(&|part| smoothing::smooth(&time_s[part.clone()], &load.values[part]).1);
            further.extend(Scaled::of(rates.into_iter()).map(|rates| rates.values));
        }
        let spare = budget.saturating_sub(1 + 2 * loads.len());
        further.truncate(spare);
        let mut leading: Vec<usize> = Vec::new();
        let basis = |leading: &[usize]| {
            let others = (0..covariates.len()).filter(|place| !leading.contains(place));
            let others = others.flat_map(|place| [&covariates[place].values, &squares[place]]);
            let columns = loads.iter().map(|(_, load)| load);
            let columns: Vec<&Scaled> =
                columns.chain(leading.iter().map(|place| &covariates[*place])).collect();
            let room = spare.saturating_sub(further.len() + 2 * leading.len());
            let linear = further.iter().chain(others.take(room));
            Basis::new(columns, linear.map(Vec::as_slice).collect(), budget)
        };
        // Covariates join the polynomial in the order of what they explain of the rest.
        while leading.len() < MAX_LEADING {
            let (_, residual) =
                Basis::new(basis(&leading).leading, Vec::new(), budget).residual(&field)?;
            let free = (0..covariates.len()).filter(|place| !leading.contains(place));
            let share = |place: usize| {
                let columns = vec![&covariates[place].values[..], &squares[place][..]];
                let alone =
                    Basis { leading: Vec::new(), powers: vec![Vec::new()], further: columns };
                let (_, after) = alone.residual(&residual)?;
                Some((1.0 - sum_of_squares(&after) / sum_of_squares(&residual), place))
            };
            let best = free.filter_map(share).max_by(|a, b| a.0.total_cmp(&b.0));
            match best.filter(|(share, _)| *share > LEADING_SHARE) {
                Some((_, place)) => leading.push(place),
                None => break,
            }
        }
        // The field may follow the past of a covariate, as that of a sensor that warms slowly.
        let span_s = recording.span_s() / parts.len() as f64;
        let history = leading.iter().flat_map(|&place| {
            let values = &covariates[place].values;
            HISTORIES.map(|share| {
                by_part(&|part| low_pass(&time_s[part.clone()], &values[part], share * span_s))
            })
        });
        let history: Vec<Vec<f64>> = history.collect();
        let mut basis = basis(&leading);
        let room = (rows.len() / ROWS_PER_TERM).saturating_sub(basis.len());
        basis.further.extend(history.iter().take(room).map(Vec::as_slice));
        let (coefficients, residual_g) = basis.residual(&field)?;
        let mut slopes = vec![vec![Vector3::zeros(); forces.len()]; rows.len()];
        for (place, (force, load)) in loads.iter().enumerate() {
            for (row, slopes) in slopes.iter_mut().enumerate() {
                let [up, down] = [STEP, -STEP].map(|step| basis.terms(row, Some((place, step))));
                let slope = coefficients.tr_mul(&(up - down)) / (2.0 * STEP * load.half_span);
                slopes[*force] = Vector3::new(slope[0], slope[1], slope[2]);
            }
        }
        let mean = field.iter().sum::<Vector3<f64>>() / field.len() as f64;
        let centred: Vec<Vector3<f64>> = field.iter().map(|b| b - mean).collect();
        let explained = 1.0 - sum_of_squares(&residual_g) / sum_of_squares(&centred);
        let terms = basis.len();
        let covariates = leading.iter().map(|&place| names[place].to_owned()).collect();
        Some(Self { forces, rows, slopes, explained, covariates, terms, residual_g })
    }

    /// Degrees of freedom of the residual.
    pub fn freedom(&self) -> f64 {
        self.rows.len().saturating_sub(self.terms).max(1) as f64
    }

    /// Standard deviation of the residual in gauss, each axis.
    pub fn deviation_g(&self) -> Vector3<f64> {
        let squares = self.residual_g.iter().map(|r| r.component_mul(r)).sum::<Vector3<f64>>();
        (squares / self.freedom()).map(f64::sqrt)
    }

    /// Longest correlation time of the residual in seconds.
    pub fn correlation_s(&self, recording: &Recording) -> f64 {
        let period_s = recording.span_s() / self.rows.len().max(1) as f64;
        let of_axis = |axis: usize| {
            let values: Vec<f64> = self.residual_g.iter().map(|r| r[axis]).collect();
            period_s * autocorrelation_rows(&values)
        };
        [0, 1, 2].map(of_axis).into_iter().fold(0.0, f64::max)
    }

    /// Forces of the rows in newtons, by force.
    pub fn force_columns(&self, recording: &Recording) -> Vec<Vec<f64>> {
        let forces = self.forces.iter().filter_map(|key| recording.forces.get(key));
        forces.map(|force| self.rows.iter().map(|&row| force.newtons[row]).collect()).collect()
    }
}

fn sum_of_squares(values: &[Vector3<f64>]) -> f64 {
    values.iter().map(Vector3::norm_squared).sum()
}
