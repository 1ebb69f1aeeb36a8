//! Recurrent networks in a replay: the device's own code, and floating point beside it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use firmware::estimator::{self, Networks as _};
use firmware::force::{Estimate, Validity};
use firmware::frame::SENSORS;
use firmware::units::Field;
use model_export::gru::file::NetworkFile;
use model_export::gru::float::FloatState;
use model_export::gru::network::{Input, Network, OUTPUTS, Target};
use model_export::gru::pack::{self, Packed, Running};
use model_export::gru::warm_up;
use model_export::inverse::build::Built;

/// Trained networks, and the same in the device's formats.
#[derive(Debug)]
pub struct Networks {
    /// As they were trained.
    pub file: NetworkFile,
    /// As the device holds them, in the same order.
    pub packed: Vec<Box<dyn Packed>>,
    gauss_per_lsb: f64,
    /// Whether a recording begins with networks that have warmed up over its first row, held: the
    /// gripper had been on for a while.
    settled: bool,
}

impl Networks {
    /// Reads the networks at `path`, which were trained behind the model that was built.
    pub fn read(path: &Path, built: &Built) -> Result<Self> {
        Self::of(NetworkFile::read(path)?, path, built)
    }

    /// Networks in memory; `path` stands for them in messages.
    pub fn of(file: NetworkFile, path: &Path, built: &Built) -> Result<Self> {
        if file.provenance.model_sha256 != built.header.inputs_sha256 {
            bail!(
                "{}: these networks were trained behind another model: what it undoes, they never saw; train again with this one",
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
        Ok(Self {
            file,
            packed,
            gauss_per_lsb,
            settled: false,
        })
    }

    /// The same on a gripper that has been on, at rest, for longer than any of them warms up.
    pub fn settled(self) -> Self {
        Self {
            settled: true,
            ..self
        }
    }

    /// How large they are, for a person.
    pub fn sentence(&self) -> String {
        let sizes = self.packed.iter().zip(&self.file.networks);
        let lines = sizes.map(|(packed, network)| {
            let [inputs, hidden, _] = packed.size();
            let sensors: Vec<String> = network.sensors.iter().map(u32::to_string).collect();
            format!(
                "Network of sensor {}: {} inputs, two layers of {} units (on the device {} and {}).\n  \
                 After a start its forces are not used for {} ms: so long it remembers nothing but the start.\n",
                sensors.join(", "),
                network.inputs.len(),
                network.hidden,
                2 * inputs,
                2 * hidden,
                warm_up::steps(network),
            )
        });
        lines.collect::<String>()
            + "No sum of theirs can overflow. What fixed point costs: `magpie replay --network`.\n"
    }

    /// True where the networks learned from the recording with this fingerprint.
    pub fn learned_from(&self, sha256: &str) -> bool {
        let recordings = &self.file.provenance.recordings;
        recordings
            .iter()
            .any(|recorded| !recorded.held_out && recorded.sha256 == sha256)
    }

    /// All of them after a reset, without floating point beside.
    pub fn run(&self) -> OnDevice<'_> {
        OnDevice(self.packed.iter().map(|packed| packed.run()).collect())
    }

    /// All of them after a reset.
    pub fn start(&self) -> Underway<'_> {
        let floats = self.file.networks.iter().map(|network| Float {
            network,
            state: FloatState::at(network, 0.0),
            steps: 0,
            warm_up: warm_up::steps(network),
        });
        Underway {
            running: self.run(),
            floats: floats.collect(),
            seen: Vec::new(),
            gauss_per_lsb: self.gauss_per_lsb,
            unsettled: self.settled,
        }
    }
}

/// What runs on the device, with what it remembers.
pub struct OnDevice<'a>(Vec<Box<dyn Running + 'a>>);

impl estimator::Networks for OnDevice<'_> {
    fn apply(&mut self, frame: &mut [Estimate; SENSORS]) {
        pack::apply(&mut self.0, frame);
    }
}

/// Networks on their way through a recording.
pub struct Underway<'a> {
    running: OnDevice<'a>,
    floats: Vec<Float<'a>>,
    /// What the networks saw since [`Underway::forget`], a frame for each row.
    seen: Vec<[Estimate; SENSORS]>,
    gauss_per_lsb: f64,
    /// Whether the first row is still to be held until all have warmed up.
    unsettled: bool,
}

/// A network in floating point with its state.
struct Float<'a> {
    network: &'a Network,
    state: FloatState,
    steps: u16,
    warm_up: u16,
}

/// A force that a network tells in floating point, in newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloatForce {
    /// What its mean is.
    pub target: Target,
    /// Fx, Fz.
    pub mean_n: [f64; 2],
}

impl FloatForce {
    /// The force along an axis, where the ideal model tells `ideal_n`.
    pub fn over(told: Option<Self>, axis: usize, ideal_n: f64) -> f64 {
        match told {
            None => ideal_n,
            Some(told) => match told.target {
                Target::Force => told.mean_n[axis],
                Target::Rest => ideal_n + told.mean_n[axis],
            },
        }
    }
}

impl estimator::Networks for Underway<'_> {
    /// One step of the device's code over the estimates of one row.
    fn apply(&mut self, frame: &mut [Estimate; SENSORS]) {
        if std::mem::take(&mut self.unsettled) {
            self.settle(frame);
        }
        self.seen.push(*frame);
        self.running.apply(frame);
    }
}

impl Underway<'_> {
    /// Holds a frame until the slowest network has warmed up.
    fn settle(&mut self, frame: &[Estimate; SENSORS]) {
        let longest = self.floats.iter().map(|float| float.warm_up).max();
        for _ in 0..longest.unwrap_or(0) {
            self.running.apply(&mut frame.clone());
            for float in &mut self.floats {
                float.step(frame, self.gauss_per_lsb);
            }
        }
    }

    /// What the networks saw in a row since [`Underway::forget`].
    pub fn saw(&self, row: usize) -> Option<&[Estimate; SENSORS]> {
        self.seen.get(row)
    }

    /// Begins to count rows anew.
    pub fn forget(&mut self) {
        self.seen.clear();
    }

    /// The same step in floating point, by the number of the sensor; rows in their order.
    pub fn float(&mut self, row: usize) -> [Option<FloatForce>; SENSORS] {
        let mut told = [None; SENSORS];
        let Some(seen) = self.seen.get(row) else {
            return told;
        };
        for float in &mut self.floats {
            for (sensor, force) in float.step(seen, self.gauss_per_lsb) {
                if let Some(place) = told.get_mut(sensor) {
                    *place = Some(force);
                }
            }
        }
        told
    }
}

impl Float<'_> {
    /// Begins anew where an input is missing, as the device does.
    fn step(&mut self, seen: &[Estimate; SENSORS], gauss_per_lsb: f64) -> Vec<(usize, FloatForce)> {
        let network = self.network;
        let inputs = network.inputs.iter().map(|input| {
            let value = value(seen, input.input, gauss_per_lsb)?;
            Some((value - input.middle) / input.span)
        });
        let Some(inputs) = inputs.collect::<Option<Vec<f64>>>() else {
            (self.state, self.steps) = (FloatState::at(network, 0.0), 0);
            return Vec::new();
        };
        let outputs = self.state.step(network, &inputs);
        self.steps = self.steps.saturating_add(1);
        if self.steps <= self.warm_up {
            return Vec::new();
        }
        let sensors = network.sensors.iter().zip(outputs.chunks(OUTPUTS));
        sensors
            .map(|(&sensor, told)| {
                let mean_n = [0, 1].map(|axis| told[axis] * network.force_n[axis]);
                let target = network.target;
                (sensor as usize, FloatForce { target, mean_n })
            })
            .collect()
    }
}

/// An input in its unit; nothing where its sensor is missing.
fn value(seen: &[Estimate; SENSORS], input: Input, gauss_per_lsb: f64) -> Option<f64> {
    let of = |sensor: u32| {
        let estimate = seen.get(sensor as usize)?;
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
