//! Detection of magnetic disturbances by the benchmark's best variant.

use crate::benchmark::data::{BenchmarkData, FittedPhysics};
use crate::benchmark::variants::{EstimatorVariant, PhysicsLevel};
use crate::magnetic_disturbance::counts::DetectionCounts;
use crate::magnetic_disturbance::input_rows::{RecordedGripper, RowSource, SimulatedGripper};
use crate::magnetic_disturbance::{DeviceUnderTest, evaluate_detection as count_rows};
use crate::progress;
use anyhow::Result;
use device_run::networks::NetworkSet;
use sim::campaign::truth;

/// Detection counts of a variant.
#[derive(Debug)]
pub struct DisturbanceResult {
    /// The variant.
    pub variant: EstimatorVariant,
    /// Whether the rows are of a simulated gripper; otherwise of the held-out recording.
    pub simulated: bool,
    /// The counts.
    pub counts: DetectionCounts,
}

/// The network variant with the best physics that could be fitted.
pub fn network_variant(physics: &FittedPhysics) -> EstimatorVariant {
    match physics.at(PhysicsLevel::Effects) {
        Some(_) => EstimatorVariant::PhysicsGru,
        None => EstimatorVariant::Gru3AxisIdeal,
    }
}

/// Evaluates the detector over `hours`; `None` for zero hours.
///
/// # Errors
/// The held-out recording cannot be read.
pub fn evaluate_disturbance(
    data: &BenchmarkData,
    physics: &FittedPhysics,
    networks: Option<&NetworkSet>,
    hours: f64,
) -> Result<Option<DisturbanceResult>> {
    let with_network = network_variant(physics);
    let Some(built) = physics.at(with_network.physics()) else {
        return Ok(None);
    };
    if hours == 0.0 {
        return Ok(None);
    }
    let variant = match (networks, with_network.physics()) {
        (Some(_), _) => with_network,
        (None, PhysicsLevel::Effects) => EstimatorVariant::Physics,
        (None, _) => EstimatorVariant::IdealFitted,
    };
    let source = match simulated(data) {
        Some(gripper) => RowSource::Simulated(Box::new(gripper)),
        None => RowSource::Recorded(Box::new(RecordedGripper::open(
            data.held_out.clone(),
            data.alignment,
            built,
            data.seed,
        )?)),
    };
    let bar = progress::progress_bar("magnetic disturbances", 0);
    let counts = count_rows(&DeviceUnderTest { built, networks }, &source, hours, &bar)?;
    bar.finish_and_clear();
    Ok(Some(DisturbanceResult {
        variant,
        simulated: matches!(source, RowSource::Simulated(_)),
        counts,
    }))
}

/// The campaign's simulated gripper, where its truth file exists.
fn simulated(data: &BenchmarkData) -> Option<SimulatedGripper> {
    let path = truth::default_path(&data.campaign.folder).ok()?;
    let settings = truth::read_settings(&path).ok().filter(|_| data.simulated)?;
    SimulatedGripper::from_settings(settings).ok()
}
