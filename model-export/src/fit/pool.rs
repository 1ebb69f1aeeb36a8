//! Parameters that all sensors of a gripper share, from the fits of each.

use nalgebra::{DMatrix, DVector};

/// One sensor's estimate of the shared parameters, and its covariance, in departures.
#[derive(Clone, Debug)]
pub struct Witness {
    /// Estimates.
    pub value: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
}

/// The mean of all sensors, each with the weight of its knowledge, and its covariance. Sensors that
/// disagree by more than their error bars widen it (Birge 1932).
pub fn pool(witnesses: &[Witness]) -> Option<Witness> {
    let size = witnesses.first()?.value.len();
    let mut precision = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut weights = Vec::new();
    for witness in witnesses {
        let ridge = DMatrix::identity(size, size) * 1e-12;
        let weight = (&witness.covariance + ridge).cholesky()?.inverse();
        precision += &weight;
        right += &weight * &witness.value;
        weights.push(weight);
    }
    let covariance = precision.cholesky()?.inverse();
    let value = &covariance * right;
    let spread: f64 = witnesses
        .iter()
        .zip(&weights)
        .map(|(witness, weight)| {
            let off = &witness.value - &value;
            off.dot(&(weight * &off))
        })
        .sum();
    let freedom = (size * (witnesses.len() - 1)) as f64;
    let birge = if freedom > 0.0 {
        (spread / freedom).max(1.0)
    } else {
        1.0
    };
    Some(Witness {
        value,
        covariance: covariance * birge,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn witness(value: f64, error: f64) -> Witness {
        Witness {
            value: DVector::from_element(1, value),
            covariance: DMatrix::from_element(1, 1, error * error),
        }
    }

    #[test]
    fn who_knows_more_counts_more_and_disagreement_widens_the_error() {
        // 1/4 and 1 are the weights of errors 2 and 1: (0.25 * 10 + 1 * 5) / 1.25 = 6.
        let pooled = pool(&[witness(10.0, 2.0), witness(5.0, 1.0)]).unwrap();
        assert!((pooled.value[0] - 6.0).abs() < 1e-9);
        // Chi squared (4/2)^2 + (1/1)^2 = 5 for one degree of freedom: variance 5 / 1.25.
        assert!((pooled.covariance[(0, 0)] - 4.0).abs() < 1e-6);
        let agreeing = pool(&[witness(5.0, 2.0), witness(5.0, 1.0)]).unwrap();
        assert!((agreeing.covariance[(0, 0)] - 0.8).abs() < 1e-6);
    }
}
