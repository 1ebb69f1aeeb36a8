//! Scatter between visits of the same condition: what no model of these columns can explain.

use std::collections::HashMap;

use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::covariate::Kind;
use super::rows::SensorColumns;

/// Two rows are at the same condition where every covariate agrees to this share of its standard
/// deviation.
const CELL: f64 = 0.1;
/// Visits of one condition are apart by at least this many seconds.
const APART_S: f64 = 1.0;
/// Fewer degrees of freedom tell no scatter.
const FEWEST: usize = 30;
/// Probability below which scatter alone does not explain the residual.
const LEVEL: f64 = 0.05;

/// Residuals in groups that share a condition, taken apart into scatter within the groups (pure error)
/// and what is left of their means (lack of fit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LackOfFit {
    /// Mean square within groups.
    pub pure: f64,
    /// Degrees of freedom within groups.
    pub pure_freedom: usize,
    /// Mean square of the groups' means, as lack of fit.
    pub lack: f64,
    /// Its degrees of freedom.
    pub lack_freedom: usize,
}

impl LackOfFit {
    /// Of residuals by group, left by a model of `parameters` coefficients that was fitted to them.
    /// `None` where no group has two, or the groups are not more than the parameters.
    pub fn of(groups: &[Vec<f64>], parameters: usize) -> Option<Self> {
        let (mut within, mut between) = (0.0, 0.0);
        let mut pure_freedom = 0;
        let filled = groups.iter().filter(|group| !group.is_empty());
        let count = filled.clone().count();
        for group in filled {
            let mean = group.iter().sum::<f64>() / group.len() as f64;
            within += group
                .iter()
                .map(|value| (value - mean).powi(2))
                .sum::<f64>();
            between += group.len() as f64 * mean * mean;
            pure_freedom += group.len() - 1;
        }
        let lack_freedom = count
            .checked_sub(parameters)
            .filter(|freedom| *freedom > 0)?;
        (pure_freedom > 0).then(|| Self {
            pure: within / pure_freedom as f64,
            pure_freedom,
            lack: between / lack_freedom as f64,
            lack_freedom,
        })
    }

    /// How many times the lack of fit exceeds the pure error.
    pub fn f(&self) -> f64 {
        self.lack / self.pure
    }

    /// Probability of such an excess by scatter alone.
    pub fn probability(&self) -> f64 {
        let (lack, pure) = (self.lack_freedom as f64, self.pure_freedom as f64);
        FisherSnedecor::new(lack, pure).map_or(f64::NAN, |f| f.sf(self.f()))
    }

    /// In words.
    pub fn verdict(&self) -> &'static str {
        match self.probability() < LEVEL {
            true => "structure remains",
            false => "at the replicate floor",
        }
    }
}

/// Standard deviation between visits of the same condition on each axis of one sensor, in gauss;
/// `None` where too few conditions were met twice.
pub fn scatter(sensor: &SensorColumns) -> Option<[f64; 3]> {
    let widths: Vec<(&[f32], f64)> = sensor
        .covariates
        .iter()
        .filter(|column| column.of.kind == Kind::Quantity)
        .filter_map(|column| Some((column.values.as_slice(), CELL * deviation(&column.values)?)))
        .collect();
    let mut cells: HashMap<Vec<i32>, Vec<usize>> = HashMap::new();
    for row in 0..sensor.len() {
        let place =
            |(values, width): &(&[f32], f64)| (f64::from(values[row]) / width).floor() as i32;
        let visits = cells.entry(widths.iter().map(place).collect()).or_default();
        let again = visits.last().is_none_or(|&last| {
            sensor.recording[last] != sensor.recording[row]
                || sensor.time_s[row] - sensor.time_s[last] > APART_S
        });
        if again {
            visits.push(row);
        }
    }
    let found = [0, 1, 2].map(|axis| {
        let residual = |row: &usize| sensor.residual_g[*row][axis];
        let groups: Vec<Vec<f64>> = cells
            .values()
            .map(|visits| visits.iter().map(residual).collect())
            .collect();
        let split = LackOfFit::of(&groups, 0)?;
        (split.pure_freedom >= FEWEST).then(|| split.pure.sqrt())
    });
    Some([found[0]?, found[1]?, found[2]?])
}

/// Standard deviation of a column; `None` where it was not recorded or never moves.
fn deviation(values: &[f32]) -> Option<f64> {
    let finite = || {
        values
            .iter()
            .map(|value| f64::from(*value))
            .filter(|v| v.is_finite())
    };
    let count = finite().count();
    let mean = finite().sum::<f64>() / count.max(1) as f64;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count.max(1) as f64;
    (count == values.len() && variance > 0.0).then(|| variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::covariate::Covariate;
    use model_export::fit::Options;
    use model_export::fit::polynomial;
    use model_export::fit::rows::{Part, SensorRows};
    use model_export::recordings::columns::Axis;
    use nalgebra::Vector3;
    use std::borrow::Cow;

    const FX: Covariate = Covariate {
        name: Cow::Borrowed("fx_n"),
        words: Cow::Borrowed("force"),
        unit: "N",
        kind: Kind::Quantity,
    };

    /// NIST Statistical Reference Datasets, `Pontius`: load (here in millions) and deflection of a load
    /// cell, each load applied twice. Certified for y = b0 + b1 x + b2 x^2.
    const PONTIUS: [(f64, f64); 40] = [
        (0.15, 0.11019),
        (0.3, 0.21956),
        (0.45, 0.32949),
        (0.6, 0.43899),
        (0.75, 0.54803),
        (0.9, 0.65694),
        (1.05, 0.76562),
        (1.2, 0.87487),
        (1.35, 0.98292),
        (1.5, 1.09146),
        (1.65, 1.20001),
        (1.8, 1.30822),
        (1.95, 1.41599),
        (2.1, 1.52399),
        (2.25, 1.63194),
        (2.4, 1.73947),
        (2.55, 1.84646),
        (2.7, 1.95392),
        (2.85, 2.06128),
        (3.0, 2.16844),
        (0.15, 0.11052),
        (0.3, 0.22018),
        (0.45, 0.32939),
        (0.6, 0.43886),
        (0.75, 0.54798),
        (0.9, 0.65739),
        (1.05, 0.76596),
        (1.2, 0.87474),
        (1.35, 0.98300),
        (1.5, 1.09150),
        (1.65, 1.20004),
        (1.8, 1.30818),
        (1.95, 1.41613),
        (2.1, 1.52408),
        (2.25, 1.63159),
        (2.4, 1.73965),
        (2.55, 1.84696),
        (2.7, 1.95445),
        (2.85, 2.06177),
        (3.0, 2.16829),
    ];

    /// A polynomial of the load fitted by the project's own base, and its residuals by load.
    fn fitted(degree: usize) -> (polynomial::Polynomial, Vec<Vec<f64>>) {
        let part = Part {
            time_s: (0..40).map(f64::from).collect(),
            force_n: PONTIUS.iter().map(|(load, _)| vec![*load]).collect(),
            field_g: PONTIUS.iter().map(|(_, y)| Vector3::repeat(*y)).collect(),
            field_noise_g: Vector3::zeros(),
            force_noise_n: vec![0.0],
            track: Default::default(),
        };
        let rows = SensorRows {
            sensor: 0,
            forces: vec![(0, Axis::Z)],
            parts: vec![part],
        };
        let model = polynomial::fit(&rows, Some(degree), Options::default())
            .unwrap()
            .model;
        let mut groups: Vec<(f64, Vec<f64>)> = Vec::new();
        for (load, y) in PONTIUS {
            let residual = y - model.field(&[load]).x;
            match groups.iter_mut().find(|(known, _)| *known == load) {
                Some((_, group)) => group.push(residual),
                None => groups.push((load, vec![residual])),
            }
        }
        (model, groups.into_iter().map(|(_, group)| group).collect())
    }

    #[test]
    fn a_straight_line_through_pontius_leaves_structure() {
        let test = LackOfFit::of(&fitted(1).1, 2).unwrap();
        assert_eq!((test.lack_freedom, test.pure_freedom), (18, 20));
        // In exact fractions 214.746924; the handbook prints 214.7464.
        assert!((test.f() - 214.746_924).abs() < 1e-6, "{}", test.f());
        assert_eq!(test.verdict(), "structure remains");
    }

    #[test]
    fn a_parabola_through_pontius_is_at_the_replicate_floor() {
        let test = LackOfFit::of(&fitted(2).1, 3).unwrap();
        assert!((test.f() - 0.81).abs() < 5e-3, "{}", test.f());
        assert_eq!(test.verdict(), "at the replicate floor");
    }

    #[test]
    fn the_parabola_s_coefficients_are_the_certified_ones() {
        let model = fitted(2).0;
        let at = |load: f64| model.field(&[load]).x;
        // Newton's divided differences at three loads give the coefficients of powers.
        let (x0, x1, x2) = (0.15, 1.5, 3.0);
        let slope = (at(x1) - at(x0)) / (x1 - x0);
        let b2 = ((at(x2) - at(x1)) / (x2 - x1) - slope) / (x2 - x0);
        let b1 = slope - b2 * (x0 + x1);
        let b0 = at(x0) - b1 * x0 - b2 * x0 * x0;
        let certified = [
            0.673_565_789_473_684e-3,
            0.732_059_160_401_003,
            -0.316_081_871_345_029e-2,
        ];
        for (found, certified) in [b0, b1, b2].into_iter().zip(certified) {
            assert!(
                (found / certified - 1.0).abs() < 1e-9,
                "{found} {certified}"
            );
        }
    }

    #[test]
    fn visits_of_one_condition_scatter_by_the_noise_alone() {
        let mut sensor = SensorColumns::new(0, &[FX]);
        // A force that goes up and down through 100 values; the residual alternates by visit.
        for row in 0..4000_u32 {
            let (visit, place) = (row / 100, row % 100);
            sensor.recording.push(0);
            sensor
                .time_s
                .push(f64::from(visit) * 10.0 + f64::from(place) * 0.01);
            sensor
                .residual_g
                .push(Vector3::repeat(if visit % 2 == 0 { 0.3 } else { -0.3 }));
            sensor.floor_g2.push(Vector3::zeros());
            sensor.covariates[0].values.push(place as f32);
        }
        let scatter = scatter(&sensor).unwrap();
        // Twenty visits of +0.3 and twenty of -0.3: 0.3 sqrt(40 / 39).
        assert!((scatter[0] - 0.3 * (40.0_f64 / 39.0).sqrt()).abs() < 1e-12);
    }
}
