//! Recurrent networks of a replay: the device's fixed-point code, and the same in floating point.

use std::path::Path;

use anyhow::{Context, Result, bail};
use firmware::estimator::{self, Estimate, NetworkBank as _, Validity};
use firmware::fixed_point::Field;
use firmware::sensors::hall::SENSORS;
use model_export::gru::file::NetworkFile;
use model_export::gru::network::{FloatRun, Input, Network, OUTPUTS, Target};
use model_export::gru::pack::{self, NetworkRun, PackedNetwork};
use model_export::inverse::build::DeviceModel;
use model_export::inverse::codegen;

/// Trained networks in floating point and in the device's formats.
#[derive(Debug)]
pub struct NetworkSet {
    /// Networks as trained.
    pub file: NetworkFile,
    /// Quantised networks, in the same order.
    pub packed: Vec<Box<dyn PackedNetwork>>,
    gauss_per_lsb: f64,
    /// Whether networks are warmed up on the first row before a recording starts, as on a gripper that has
    /// been on for a while.
    warm_start: bool,
}

/// The device's tables as Rust source, with the networks that run after the model.
///
/// # Errors
/// The networks differ in size.
pub fn tables_source(built: &DeviceModel, networks: Option<&NetworkSet>) -> Result<String> {
    match networks {
        None => Ok(codegen::tables_source(built)),
        Some(set) => Ok(codegen::source_with_networks(built, &set.file.networks, &set.packed)?),
    }
}

impl NetworkSet {
    /// Reads the networks at `path`; they must have been trained with the model that was built.
    pub fn read(path: &Path, built: &DeviceModel) -> Result<Self> {
        Self::of(NetworkFile::read(path)?, path, built)
    }

    /// Networks in memory; `path` stands for them in messages.
    pub fn of(file: NetworkFile, path: &Path, built: &DeviceModel) -> Result<Self> {
        if file.provenance.model_sha256 != built.header.inputs_sha256 {
            bail!(
                "{}: these networks were trained with another model, whose compensation changes their inputs; train again with this one",
                path.display()
            );
        }
        let gauss_per_lsb = built.model.sensor_scale.gauss_per_lsb;
        let packed = file
            .networks
            .iter()
            .map(|network| pack::pack(network, gauss_per_lsb))
            .collect::<Result<_, _>>()
            .with_context(|| path.display().to_string())?;
        Ok(Self { file, packed, gauss_per_lsb, warm_start: false })
    }

    /// Sizes and warm-up times, one paragraph per network.
    pub fn description(&self) -> String {
        let sizes = self.packed.iter().zip(&self.file.networks);
        let lines = sizes.map(|(packed, network)| {
            let [inputs, hidden, _] = packed.size();
            let sensors: Vec<String> = network.sensors.iter().map(u32::to_string).collect();
            format!(
                "Network of sensor {}: {} inputs, two layers of {} units (on the device {} and {}).\n  \
                 Its forces are not used for {} ms after a start, until the initial state has decayed.\n",
                sensors.join(", "),
                network.inputs.len(),
                network.hidden,
                2 * inputs,
                2 * hidden,
                packed.warm_up(),
            )
        });
        lines.collect::<String>()
            + "No accumulator can overflow. The error of fixed point: `cargo magpie replay --network`.\n"
    }

    /// True if the recording with this fingerprint was training data.
    pub fn trained_on(&self, sha256: &str) -> bool {
        let recordings = &self.file.provenance.recordings;
        recordings.iter().any(|recorded| !recorded.held_out && recorded.sha256 == sha256)
    }

    /// The fixed-point networks after a reset.
    pub fn run(&self) -> DeviceNetworks<'_> {
        DeviceNetworks(self.packed.iter().map(|packed| packed.run()).collect())
    }

    /// Fixed-point and floating-point networks after a reset.
    pub fn start(&self) -> ReplayNetworks<'_> {
        let networks = self.file.networks.iter().zip(&self.packed);
        let floats = networks.map(|(network, packed)| FloatNetwork {
            network,
            run: FloatRun::new(network),
            steps: 0,
            warm_up: packed.warm_up(),
        });
        ReplayNetworks {
            running: self.run(),
            floats: floats.collect(),
            inputs: Vec::new(),
            gauss_per_lsb: self.gauss_per_lsb,
            warm_up_pending: self.warm_start,
        }
    }
}

/// Fixed-point networks with their states.
pub struct DeviceNetworks<'a>(Vec<Box<dyn NetworkRun + 'a>>);

impl estimator::NetworkBank for DeviceNetworks<'_> {
    fn apply(&mut self, frame: &mut [Estimate; SENSORS]) {
        pack::apply(&mut self.0, frame);
    }
}

/// Networks on their way through a recording.
pub struct ReplayNetworks<'a> {
    running: DeviceNetworks<'a>,
    floats: Vec<FloatNetwork<'a>>,
    /// Inputs since [`ReplayNetworks::clear_inputs`], one frame per row.
    inputs: Vec<[Estimate; SENSORS]>,
    gauss_per_lsb: f64,
    /// Whether the next row is repeated until all networks are warmed up.
    warm_up_pending: bool,
}

/// A floating-point network on its way.
struct FloatNetwork<'a> {
    network: &'a Network,
    run: FloatRun,
    steps: u16,
    warm_up: u16,
}

/// Force output of a floating-point network, in newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloatForce {
    /// Whether the output is the force or the residual of the ideal model.
    pub target: Target,
    /// Fx, Fz.
    pub mean_n: [f64; 2],
}

impl FloatForce {
    /// Force along an axis, given the ideal model's estimate `ideal_n`.
    pub fn over(output: Option<Self>, axis: usize, ideal_n: f64) -> f64 {
        match output {
            None => ideal_n,
            Some(output) => match output.target {
                Target::Force => output.mean_n[axis],
                Target::Residual => ideal_n + output.mean_n[axis],
            },
        }
    }
}

impl estimator::NetworkBank for ReplayNetworks<'_> {
    fn apply(&mut self, frame: &mut [Estimate; SENSORS]) {
        if std::mem::take(&mut self.warm_up_pending) {
            self.warm_up(frame);
        }
        self.inputs.push(*frame);
        self.running.apply(frame);
    }
}

impl ReplayNetworks<'_> {
    /// Repeats a frame until the slowest network is warmed up.
    fn warm_up(&mut self, frame: &[Estimate; SENSORS]) {
        let longest = self.floats.iter().map(|float| float.warm_up).max();
        for _ in 0..longest.unwrap_or(0) {
            self.running.apply(&mut frame.clone());
            for float in &mut self.floats {
                float.step(frame, self.gauss_per_lsb);
            }
        }
    }

    /// Inputs of a row since [`ReplayNetworks::clear_inputs`].
    pub fn inputs(&self, row: usize) -> Option<&[Estimate; SENSORS]> {
        self.inputs.get(row)
    }

    /// Discards the stored inputs; row numbers restart at zero.
    pub fn clear_inputs(&mut self) {
        self.inputs.clear();
    }

    /// Floating-point step of a row, by sensor number; rows must be in order.
    pub fn float(&mut self, row: usize) -> [Option<FloatForce>; SENSORS] {
        let mut forces = [None; SENSORS];
        let Some(inputs) = self.inputs.get(row) else {
            return forces;
        };
        for float in &mut self.floats {
            for (sensor, force) in float.step(inputs, self.gauss_per_lsb) {
                if let Some(slot) = forces.get_mut(sensor) {
                    *slot = Some(force);
                }
            }
        }
        forces
    }
}

impl FloatNetwork<'_> {
    /// Resets where an input is missing, as the device does.
    fn step(
        &mut self,
        estimates: &[Estimate; SENSORS],
        gauss_per_lsb: f64,
    ) -> Vec<(usize, FloatForce)> {
        let network = self.network;
        let inputs = network.inputs.iter().map(|input| {
            let value = value(estimates, input.input, gauss_per_lsb)?;
            Some(((value - input.middle) / input.span) as f32)
        });
        let Some(inputs) = inputs.collect::<Option<Vec<f32>>>() else {
            self.run.reset();
            self.steps = 0;
            return Vec::new();
        };
        let outputs = self.run.step(&inputs);
        self.steps = self.steps.saturating_add(1);
        if self.steps <= self.warm_up {
            return Vec::new();
        }
        let sensors = network.sensors.iter().zip(outputs.chunks(OUTPUTS));
        sensors
            .map(|(&sensor, output)| {
                let mean_n = [0, 1].map(|axis| f64::from(output[axis]) * network.force_n[axis]);
                let target = network.target;
                (sensor as usize, FloatForce { target, mean_n })
            })
            .collect()
    }
}

/// An input in its unit; `None` where its sensor is missing.
fn value(estimates: &[Estimate; SENSORS], input: Input, gauss_per_lsb: f64) -> Option<f64> {
    let of = |sensor: u32| {
        let estimate = estimates.get(sensor as usize)?;
        (estimate.validity != Validity::Missing).then_some(estimate)
    };
    match input {
        Input::Field { sensor, axis } => {
            let field: &Field = of(sensor)?.field.get(axis)?;
            Some(field.counts() * gauss_per_lsb)
        }
        Input::Ideal { sensor, axis } => Some(of(sensor)?.force.get(axis)?.newtons()),
    }
}
