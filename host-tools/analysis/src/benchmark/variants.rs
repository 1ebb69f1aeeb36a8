//! The force estimators of the benchmark, and the paper's results.

use model_export::gru::network::Target;
use model_export::gru::train::dataset::Topology;
use serde::Serialize;

/// A force estimator, in order of increasing knowledge of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum EstimatorVariant {
    /// The design before any fit: the paper's ideal model.
    IdealNominal,
    /// The ideal model fitted to the gripper.
    IdealFitted,
    /// A network on the field in the plane of motion.
    Gru2Axis,
    /// A network on all three axes.
    Gru3Axis,
    /// A network on three axes and the fitted ideal model's force that estimates the residual: the paper's
    /// warm start.
    Gru3AxisIdeal,
    /// Three axes, with a higher weight near zero force.
    Gru3AxisNearZero,
    /// The ideal model with the added effects.
    Physics,
    /// The same with a network for the residual.
    PhysicsGru,
}

/// Physics model of a variant, or below its network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhysicsLevel {
    /// The nominal design.
    Nominal,
    /// The fitted ideal model.
    Fitted,
    /// The ideal model with effects.
    Effects,
}

impl EstimatorVariant {
    /// All variants, in the order of the table.
    pub const ALL: [Self; 8] = [
        Self::IdealNominal,
        Self::IdealFitted,
        Self::Gru2Axis,
        Self::Gru3Axis,
        Self::Gru3AxisIdeal,
        Self::Gru3AxisNearZero,
        Self::Physics,
        Self::PhysicsGru,
    ];

    /// Identifier in JSON.
    pub fn id(self) -> &'static str {
        match self {
            Self::IdealNominal => "ideal_nominal",
            Self::IdealFitted => "ideal_fitted",
            Self::Gru2Axis => "gru_2axis",
            Self::Gru3Axis => "gru_3axis",
            Self::Gru3AxisIdeal => "gru_3axis_ideal",
            Self::Gru3AxisNearZero => "gru_3axis_near_zero",
            Self::Physics => "physics_effects",
            Self::PhysicsGru => "physics_effects_gru",
        }
    }

    /// Label in text and reports.
    pub fn words(self) -> &'static str {
        match self {
            Self::IdealNominal => "ideal, nominal",
            Self::IdealFitted => "ideal, fitted",
            Self::Gru2Axis => "GRU 2 axes",
            Self::Gru3Axis => "GRU 3 axes",
            Self::Gru3AxisIdeal => "GRU 3 + ideal",
            Self::Gru3AxisNearZero => "GRU 3, near zero",
            Self::Physics => "physics + effects",
            Self::PhysicsGru => "physics + GRU",
        }
    }

    /// Physics model of the variant.
    pub fn physics(self) -> PhysicsLevel {
        match self {
            Self::IdealNominal => PhysicsLevel::Nominal,
            Self::Physics | Self::PhysicsGru => PhysicsLevel::Effects,
            _ => PhysicsLevel::Fitted,
        }
    }

    /// Inputs and target of the network; `None` without one.
    pub fn topology(self, hidden: usize) -> Option<Topology> {
        let (axes, ideal) = match self {
            Self::IdealNominal | Self::IdealFitted | Self::Physics => return None,
            Self::Gru2Axis => (vec![0, 2], false),
            Self::Gru3Axis | Self::Gru3AxisNearZero => (vec![0, 1, 2], false),
            Self::Gru3AxisIdeal | Self::PhysicsGru => (vec![0, 1, 2], true),
        };
        Some(Topology {
            axes,
            ideal,
            target: if ideal { Target::Residual } else { Target::Force },
            shared: false,
            hidden,
        })
    }
}

/// Published errors of one force, in newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedErrors {
    /// Root mean square error.
    pub rmse_n: f64,
    /// Mean error.
    pub mean_n: f64,
    /// Standard deviation of the error.
    pub std_n: f64,
}

const fn errors(rmse_n: f64, mean_n: f64, std_n: f64) -> PublishedErrors {
    PublishedErrors { rmse_n, mean_n, std_n }
}

/// The paper's errors of a force (0 for Fx, 1 for Fz); `None` for variants it does not have.
///
/// What Table I calls "Variance (N²)" are standard deviations in newtons: only so do RMS and mean agree.
pub fn published(variant: EstimatorVariant, axis: usize) -> Option<PublishedErrors> {
    let [x, z] = match variant {
        EstimatorVariant::IdealNominal => [errors(16.0, -15.1, 5.4), errors(9.2, 6.7, 6.4)],
        EstimatorVariant::Gru2Axis => [errors(15.8, -11.9, 10.4), errors(28.9, -20.4, 20.5)],
        EstimatorVariant::Gru3Axis => [errors(11.0, -9.8, 5.1), errors(7.6, -5.9, 4.7)],
        _ => return None,
    };
    [x, z].get(axis).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_variance_is_a_standard_deviation() {
        for variant in EstimatorVariant::ALL {
            for axis in 0..2 {
                let Some(stated) = published(variant, axis) else {
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
