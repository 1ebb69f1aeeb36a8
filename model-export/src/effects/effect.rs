//! What an effect of the catalogue states of itself. Each field of [`Effect`] is stated by every effect: there is no default.

use nalgebra::Vector3;

use crate::effects::{EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, StateSeries};

/// How the device compensates an effect.
#[derive(Clone, Copy, Debug)]
pub enum DeviceForm {
    /// On the field, before the ideal model.
    Field(FieldForm),
    /// On the forces, after the ideal model.
    Force(ForceForm),
    /// By the tables of the ideal model: the effect depends only on the present forces.
    Tables,
    /// A permanent change: the tables describe the gripper in its state at the end of the campaign.
    Settled,
    /// Not needed on the device: an error of the reference.
    Bench {
        /// The error, before its magnitude: "the reference drifts by".
        error: &'static str,
        /// The remedy.
        remedy: &'static str,
    },
    /// Impossible on the device, with the reason: the forces keep the effect's error.
    Never(&'static str),
}

impl DeviceForm {
    /// One word for tables of effects.
    pub fn label(self) -> &'static str {
        match self {
            Self::Field(_) | Self::Force(_) => "device",
            Self::Tables => "tables",
            Self::Settled => "settled",
            Self::Bench { .. } => "bench",
            Self::Never(_) => "no",
        }
    }
}

/// Origin of the error that an effect causes in the forces of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorOrigin {
    /// The gripper, in a way that the device compensates.
    Compensated,
    /// A permanent change of the gripper: the tables hold the state of one time ([`super::FinalState`]).
    History,
    /// The reference sensor or its clock, not the device.
    Reference,
    /// A single event, which the device can detect but not compensate.
    Event,
    /// The gripper, in a way that no model of the device compensates.
    Uncompensated,
}

impl ErrorOrigin {
    /// True where no model of the device could remove the error.
    pub fn is_irreducible(self) -> bool {
        matches!(self, Self::Event | Self::Uncompensated)
    }
}

/// Compensation of the field, by the firmware's `FieldEffect` of the same name. Without a function, the values are
/// the effect's parameters, in the stated order and unit.
#[derive(Clone, Copy, Debug)]
pub enum FieldForm {
    /// Per kelvin: offset along x, y and z in gauss, gain in percent.
    SensorTemperature,
    /// Field in gauss per ampere: x, y and z each for the alpha, beta and quadrature current.
    MotorLeakage,
    /// Field along the world's x, y and z in gauss.
    EarthField,
    /// Field in gauss, gripper's axes, by values and opening in mm.
    NeighbourMagnet(fn(&[f64], f64) -> Vector3<f64>),
    /// Change of the remanence in percent per kelvin.
    MagnetTemperature,
    /// Growth of the gap in micrometres per kelvin.
    ThermalGap,
}

/// Compensation of the forces, by the firmware's `ForceEffect` of the same name. Without a function, the values are
/// the effect's parameters, in the stated order and unit. Axis 0 is lateral, axis 1 longitudinal.
#[derive(Clone, Copy, Debug)]
pub enum ForceForm {
    /// Retardation time of each axis in milliseconds.
    ViscousLag,
    /// Parts by values and axis. Both axes have the same time constants.
    Creep(fn(&[f64], usize) -> CreepParts),
    /// Compliance lost in percent: each axis under positive, then under negative force; knee of each axis in newtons.
    HardStop,
    /// Sliders by values and axis.
    Hysteresis(fn(&[f64], usize) -> FrictionSliders),
    /// Mass in kilograms.
    FingertipMass,
}

/// Percentage of the deflection and time constant in seconds of the fast and the slow part of creep along one axis.
pub type CreepParts = [(f64, f64); 2];

/// Friction force in newtons, and weight and reach in newtons of each slider, along one axis.
pub type FrictionSliders = (f64, [(f64, f64); 3]);

/// Dependence on the excitation that an effect has in common with others: recordings with a special excitation (a single sine, the
/// same warm-up) do not distinguish them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signature {
    /// History or rate of the load: one elliptic response to a single sine.
    LoadHistory,
    /// Time, or the number of the recording.
    Time,
    /// Temperature.
    Temperature,
    /// A uniform field that is constant in the world; without it, the sensor's offset contains that field.
    AmbientField,
}

/// Times on which an effect depends. A recording whose times are assumed decides nothing on such an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeDependence {
    /// None: the excitation of the rows and their order at most.
    None,
    /// The times of the rows: by a rate, a time constant or a drift.
    Rows,
    /// Also the times between the recordings.
    Starts,
}

/// How the simulator generates an effect.
#[derive(Clone, Copy, Debug)]
pub enum Simulation {
    /// By physics of its own, independent of [`Effect::apply`], with this magnitude.
    Magnitude(SimulatedMagnitude),
    /// Not at all, with the reason.
    Never(&'static str),
}

/// Magnitude of a simulated effect; typical value and unit are those of [`Effect::size`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedMagnitude {
    /// Number of the random stream, and position in lists of simulated effects. Unique and never changed, so that a
    /// seed continues to give the same gripper. A test of `sim/src/effects/mod.rs` prints the next free number.
    pub random_stream: u32,
    /// Valid range.
    pub range: (f64, f64),
    /// Definition.
    pub meaning: &'static str,
    /// Property of a material or of the whole gripper: equal in every sensor.
    pub shared: bool,
}

/// A physical effect of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name in commands and files.
    pub id: &'static str,
    /// Position in the chain from force to field.
    pub stage: EffectStage,
    /// Explanation, one paragraph.
    pub physics: &'static str,
    /// Governing equation.
    pub equation: &'static str,
    /// Regressors in the field.
    pub regressors: &'static str,
    /// Required columns besides force and field, all that [`Effect::apply`] reads. With `temp_c`, `replay` refuses rows
    /// without a temperature.
    pub needs: &'static [&'static str],
    /// Covariates for plots of the effect; the one with the strongest dependence is used.
    pub plot_against: &'static [&'static str],
    /// Parameters, coefficients first.
    pub parameters: &'static [EffectParameter],
    /// Definition of its magnitude.
    pub size: MagnitudeSpec,
    /// Recommended recording to identify it.
    pub record: &'static str,
    /// Ids of confusable effects, each with the condition. A pair may be stated at one of the two only.
    pub confused_with: &'static [(&'static str, &'static str)],
    /// A cause outside the catalogue that can leave nearly the same; empty where none is known.
    pub similar_outside: &'static str,
    /// What it has in common with other effects.
    pub signatures: &'static [Signature],
    /// How it is simulated.
    pub simulation: Simulation,
    /// How the device compensates it.
    pub device: DeviceForm,
    /// True for events within single recordings: a held-out recording carries no information on them.
    pub is_transient: bool,
    /// Whether its action on a row depends on the excitation of other rows. Without a memory, and after the stages of the
    /// force, the fit computes a change of a parameter row by row (`EffectTerm::is_pointwise`). An effect with a memory
    /// starts each recording in a state that the fit does not know: give it an [`EffectParameter::initial_state`] (as
    /// `hysteresis`), or compute the state from the first row. A state of the magnet belongs into `SensorUnit` of the
    /// simulator, and both its callers, recordings and the drivetrain, must advance it.
    pub has_memory: bool,
    /// Times on which it depends.
    pub time: TimeDependence,
    /// Stages of the effects before it whose results it reads or scales: its contribution depends on them.
    pub reads: &'static [EffectStage],
    /// Applies the effect. Arguments: values in the order of [`Effect::parameters`] (those of each
    /// recording repeated), the excitation, the series so far. It has no state from one recording to the next: what lasts
    /// is a function of the excitation (load cycles, times) or a parameter of each recording.
    pub apply: fn(&[f64], &ExcitationSeries, &mut StateSeries),
}
