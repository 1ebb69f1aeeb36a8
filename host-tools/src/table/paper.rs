//! Table I of the paper. What it calls "Variance (N²)" are standard deviations in newtons: beside each
//! root mean square and mean no other reading adds up.

use super::variant::Variant;

/// One force by one way, in newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Root mean square error.
    pub rmse_n: f64,
    /// Mean error.
    pub mean_n: f64,
    /// Standard deviation of the error.
    pub std_n: f64,
}

const fn figures(rmse_n: f64, mean_n: f64, std_n: f64) -> Figures {
    Figures {
        rmse_n,
        mean_n,
        std_n,
    }
}

/// What the paper states of a force (0 for Fx, 1 for Fz); `None` for ways that it does not have.
pub fn stated(variant: Variant, axis: usize) -> Option<Figures> {
    let [x, z] = match variant {
        Variant::IdealNominal => [figures(16.0, -15.1, 5.4), figures(9.2, 6.7, 6.4)],
        Variant::Gru2Axis => [figures(15.8, -11.9, 10.4), figures(28.9, -20.4, 20.5)],
        Variant::Gru3Axis => [figures(11.0, -9.8, 5.1), figures(7.6, -5.9, 4.7)],
        _ => return None,
    };
    [x, z].get(axis).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_paper_calls_variance_adds_up_as_a_standard_deviation_only() {
        for variant in Variant::ALL {
            for axis in 0..2 {
                let Some(stated) = stated(variant, axis) else {
                    continue;
                };
                let std_n = (stated.rmse_n.powi(2) - stated.mean_n.powi(2)).sqrt();
                assert!((std_n - stated.std_n).abs() < 0.12, "{stated:?}: {std_n}");
                let as_variance = stated.std_n.sqrt();
                assert!((std_n - as_variance).abs() > 2.0, "{stated:?}");
            }
        }
    }
}
