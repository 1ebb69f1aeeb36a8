//! Result of an estimation.

use crate::estimator::parity::ParityResidual;
use crate::fixed_point::{Field, Force};

/// Usability of an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Within the range of the sensor and of the model, all effects compensated.
    Valid,
    /// As [`Self::Valid`], but an effect was not compensated for lack of an input: the forces have its error.
    MissingInputs,
    /// An axis of the sensor is saturated.
    Saturated,
    /// The field is outside the model's design box: the forces are only a bound.
    OutsideModel,
    /// No reading, or no table for this sensor.
    Missing,
}

impl Validity {
    /// Whether the forces are within the range of sensor and model.
    pub const fn is_in_range(self) -> bool {
        matches!(self, Self::Valid | Self::MissingInputs)
    }
}

/// Forces at one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Lateral and longitudinal force; zero if missing.
    pub force: [Force; 2],
    /// Standard deviations predicted by a network, increased outside its training range
    /// ([`crate::model::formats::Guard`]).
    pub sigma: Option<[Force; 2]>,
    /// What a network in use adds to the forces of the ideal model.
    pub network_force: [Force; 2],
    /// Standard deviations as predicted by the network.
    pub network_sigma: Option<[Force; 2]>,
    /// Usability of the forces.
    pub validity: Validity,
    /// Compensated field, the input of the ideal model.
    pub field: [Field; 3],
    /// Forces of the ideal model before the effects of the flexures were compensated.
    pub uncompensated: [Force; 2],
    /// Whether an effect was skipped for lack of an input.
    pub missing_inputs: bool,
    /// Residual of the field against its other axes.
    pub parity: ParityResidual,
    /// Whether an external magnet is detected ([`crate::estimator::disturbance`]): the forces may be wrong.
    pub disturbed: bool,
}

impl Estimate {
    /// Estimate without a reading.
    pub const MISSING: Self = Self {
        force: [Force(0); 2],
        sigma: None,
        network_force: [Force(0); 2],
        network_sigma: None,
        validity: Validity::Missing,
        field: [Field(0); 3],
        uncompensated: [Force(0); 2],
        missing_inputs: false,
        parity: ParityResidual { residual: Field(0), sigma: 0 },
        disturbed: false,
    };
}
