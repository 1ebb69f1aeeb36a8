//! A kind of simulated effect.

use model_export::effects::SimulatedMagnitude;

/// Relative variation between sensors of effects that are not a material property.
pub(super) const VARIATION: f64 = 0.1;

/// A kind of effect, with unit and range of its magnitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectKind {
    /// Identifier on the command line and in the truth file.
    pub id: &'static str,
    /// Magnitude where none is given.
    pub typical: f64,
    /// Unit of the magnitude.
    pub unit: &'static str,
    /// Range and definition of the magnitude.
    pub magnitude: SimulatedMagnitude,
    /// Relative variation between sensors; unused where the magnitude is shared.
    pub variation: f64,
    /// May be drawn at random; effects outside the catalogue are simulated by name only.
    pub is_in_catalogue: bool,
    /// Equation, gripper axes.
    pub equation: &'static str,
    /// Recorded columns on which an effect outside the catalogue depends; for the others, see the catalogue.
    pub covariates: &'static [&'static str],
}
