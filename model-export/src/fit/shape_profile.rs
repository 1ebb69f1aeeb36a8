//! Solutions of a fit over the values of one shape, with their likelihoods.

/// Solutions over the values of one shape of an effect.
#[derive(Clone, Debug)]
pub struct ShapeProfile {
    /// Values of each sensor with the fitted shape.
    pub fitted: Vec<Vec<f64>>,
    /// Those with other shapes, each with its likelihood relative to that of the fitted one.
    pub others: Vec<(f64, Vec<Vec<f64>>)>,
}

impl ShapeProfile {
    /// Variance of a quantity over the profile, about its value with the fitted shape. A quantity without a value is left out.
    pub fn variance(&self, of: impl Fn(&[Vec<f64>]) -> Option<f64>) -> f64 {
        let Some(fitted) = of(&self.fitted) else { return 0.0 };
        let (mut weights, mut squares) = (1.0, 0.0);
        for (weight, values) in &self.others {
            if let Some(value) = of(values) {
                weights += weight;
                squares += weight * (value - fitted).powi(2);
            }
        }
        squares / weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a sensor with one value each: 2 as fitted, 5 half as likely, and 10 without a quantity.
    #[test]
    fn shapes_count_by_their_likelihood() {
        let values = |value: f64| vec![vec![value]];
        let profile = ShapeProfile {
            fitted: values(2.0),
            others: vec![(0.5, values(5.0)), (3.0, values(10.0))],
        };
        let of = |values: &[Vec<f64>]| Some(values[0][0]).filter(|value| *value < 9.0);
        // 0.5 * 3^2 / 1.5.
        assert!((profile.variance(of) - 3.0).abs() < 1e-12);
        assert_eq!(profile.variance(|_| None), 0.0);
    }
}
