//! The ways of telling the force from the field.

use model_export::gru::network::Target;
use model_export::gru::train::lesson::Topology;

/// A way, from the least to the most that is known of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// The design before any fit: the paper's ideal model.
    IdealNominal,
    /// The ideal model fitted to the gripper.
    IdealFitted,
    /// A network that sees the field in the plane of motion.
    Gru2Axis,
    /// A network that sees all three axes.
    Gru3Axis,
    /// The same that also sees the fitted ideal model's force, and tells what that leaves: the paper's
    /// warm start.
    Gru3AxisIdeal,
    /// Three axes, with rows near zero force weighted more.
    Gru3AxisNearZero,
    /// The ideal model with the effects that were added.
    Physics,
    /// The same, and a network for what is left.
    PhysicsGru,
}

/// The physics that a way is made of, or that its network stands behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behind {
    /// The nominal design.
    Nominal,
    /// The fitted ideal model.
    Fitted,
    /// The same with effects.
    Effects,
}

impl Variant {
    /// All, in the order of the table.
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

    /// Its name for machines.
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

    /// Its name for people.
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

    /// The physics in it.
    pub fn behind(self) -> Behind {
        match self {
            Self::IdealNominal => Behind::Nominal,
            Self::Physics | Self::PhysicsGru => Behind::Effects,
            _ => Behind::Fitted,
        }
    }

    /// What its network sees and tells; `None` where it has none.
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
            target: match ideal {
                true => Target::Rest,
                false => Target::Force,
            },
            shared: false,
            hidden,
        })
    }
}
