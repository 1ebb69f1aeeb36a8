//! Compensation of physical effects on the device.
//!
//! Effects on the field are removed before the ideal model, in reverse order of the signal path: the sensor
//! ([`thermal`]), other field sources ([`crosstalk`]), the magnet, the gap. Effects of the flexures are removed from the
//! forces afterwards ([`flexure`], [`hysteresis`]). User-defined effects are [`lookup_table`]s, also over the forces estimated
//! in the tick before. Effects that depend only
//! on the present forces (stiffening, tip slope, cross coupling, compression of the sensor) are part of the ideal
//! model's tables.

pub mod auxiliary_inputs;
pub mod covariates;
pub mod crosstalk;
pub mod flexure;
pub mod hysteresis;
pub mod lookup_table;
pub mod thermal;

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::compensation::crosstalk::{EarthFieldTable, MotorLeakageTable, NeighbourMagnetTable};
use crate::compensation::flexure::{
    CreepState, CreepTable, FingertipMassTable, HardStopTable, ViscousLagState, ViscousLagTable,
};
use crate::compensation::hysteresis::{HysteresisState, HysteresisTable, Slider};
use crate::compensation::lookup_table::{
    CovariateFilter, CovariateValues, EstimateState, FILTERS, FieldMap, ForceMap,
};
use crate::compensation::thermal::{
    MagnetTemperatureTable, SensorTemperatureTable, TemperatureFilter, ThermalGapTable,
};
use crate::fixed_point::{Field, Force};

/// Maximum number of effects on the field, and on the forces, of a sensor.
pub const MAX_EFFECTS: usize = 8;

/// Compensated effects of one sensor, in the order of their application.
#[derive(Clone, Copy, Debug)]
pub struct Compensation<'a> {
    /// Number of the sensor.
    pub number: u8,
    /// Filters of covariates.
    pub filters: [Option<CovariateFilter>; FILTERS],
    /// Effects on the field.
    pub field: [Option<FieldEffect<'a>>; MAX_EFFECTS],
    /// Effects on the forces.
    pub force: [Option<ForceEffect<'a>>; MAX_EFFECTS],
}

/// An effect on the field.
#[derive(Clone, Copy, Debug)]
pub enum FieldEffect<'a> {
    /// Drift of offset and gain of the Hall element.
    SensorTemperature(SensorTemperatureTable),
    /// Field of the motor.
    MotorLeakage(MotorLeakageTable),
    /// Ambient field.
    EarthField(EarthFieldTable),
    /// Field of the opposing finger's magnet.
    NeighbourMagnet(NeighbourMagnetTable<'a>),
    /// User-defined.
    Map(FieldMap<'a>),
    /// Temperature coefficient of the remanence.
    MagnetTemperature(MagnetTemperatureTable),
    /// Thermal growth of the gap.
    ThermalGap(ThermalGapTable),
}

/// An effect on the forces.
#[derive(Clone, Copy, Debug)]
pub enum ForceEffect<'a> {
    /// Viscous lag of the flexures.
    ViscousLag(ViscousLagTable),
    /// Creep of the flexures.
    Creep(CreepTable),
    /// Hard stops of the flexures.
    HardStop(HardStopTable),
    /// Friction parallel to the flexures.
    Hysteresis(HysteresisTable),
    /// Weight and inertia of the fingertip.
    FingertipMass(FingertipMassTable),
    /// User-defined force, or displacement as a force.
    Map(ForceMap<'a>),
}

/// State of the dynamic effects of one sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct CompensationState {
    temperature: TemperatureFilter,
    lag: ViscousLagState,
    creep: CreepState,
    hysteresis: HysteresisState,
    estimates: EstimateState,
}

/// Result of a compensation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compensated<T> {
    /// Compensated field or forces.
    pub value: T,
    /// Whether an effect was skipped for lack of an input.
    pub missing_inputs: bool,
}

impl Compensation<'_> {
    /// Maximum friction at rest, of either sign: the offset it may leave in Fx and Fz.
    pub fn friction_deadband(&self) -> [Force; 2] {
        let mut deadband = [Force(0); 2];
        for effect in self.force.iter().flatten() {
            if let ForceEffect::Hysteresis(table) = effect {
                for (deadband, sliders) in deadband.iter_mut().zip(&table.sliders) {
                    let forces = sliders.iter().map(Slider::force);
                    deadband.0 = forces.fold(deadband.0, |sum, force| sum.saturating_add(force.0));
                }
            }
        }
        deadband
    }

    /// Whether the fingertip's weight and inertia are compensated.
    pub fn compensates_fingertip_mass(&self) -> bool {
        let mut effects = self.force.iter().flatten();
        effects.any(|effect| matches!(effect, ForceEffect::FingertipMass(_)))
    }

    /// Removes the effects on the field.
    pub fn compensate_field(
        &self,
        mut field: [Field; 3],
        temperature: i16,
        inputs: &AuxiliaryInputs,
        state: &mut CompensationState,
    ) -> Compensated<[Field; 3]> {
        let temperature = state.temperature.update(temperature);
        state.estimates.update(&self.filters, temperature, inputs);
        let covariates = CovariateValues { temperature, inputs, estimates: &state.estimates };
        let mut missing_inputs = false;
        for effect in self.field.iter().flatten() {
            let compensated = match effect {
                FieldEffect::SensorTemperature(table) => Some(table.compensate(field, temperature)),
                FieldEffect::MotorLeakage(table) => table.compensate(field, inputs),
                FieldEffect::EarthField(table) => table.compensate(field, inputs),
                FieldEffect::NeighbourMagnet(table) => table.compensate(field, inputs),
                FieldEffect::Map(map) => map.compensate(field, &covariates),
                FieldEffect::MagnetTemperature(table) => Some(table.compensate(field, temperature)),
                FieldEffect::ThermalGap(table) => Some(table.compensate(field, temperature)),
            };
            match compensated {
                Some(compensated) => field = compensated,
                None => missing_inputs = true,
            }
        }
        Compensated { value: field, missing_inputs }
    }

    /// Removes the effects on the forces.
    pub fn compensate_force(
        &self,
        mut force: [Force; 2],
        inputs: &AuxiliaryInputs,
        state: &mut CompensationState,
    ) -> Compensated<[Force; 2]> {
        let temperature = state.temperature.value();
        let covariates = CovariateValues { temperature, inputs, estimates: &state.estimates };
        let mut missing_inputs = false;
        for effect in self.force.iter().flatten() {
            let compensated = match effect {
                ForceEffect::ViscousLag(table) => Some(table.compensate(force, &mut state.lag)),
                ForceEffect::Creep(table) => Some(table.compensate(force, &mut state.creep)),
                ForceEffect::HardStop(table) => Some(table.compensate(force)),
                ForceEffect::Hysteresis(table) => {
                    Some(table.compensate(force, &mut state.hysteresis))
                }
                ForceEffect::FingertipMass(table) => table.compensate(force, inputs),
                ForceEffect::Map(map) => map.compensate(force, &covariates),
            };
            match compensated {
                Some(compensated) => force = compensated,
                None => missing_inputs = true,
            }
        }
        state.estimates.set_force(force);
        Compensated { value: force, missing_inputs }
    }
}
