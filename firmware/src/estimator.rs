//! A frame in, forces out: the ideal model, the networks over it, and the watch for foreign magnets.

use crate::astray::Astray;
use crate::compensate::{Compensation, Memory};
use crate::force::{Estimate, estimate_all};
use crate::foreign::Detector;
use crate::frame::{Frame, SENSORS};
use crate::limits::Limits;
use crate::model::gru::Run;
use crate::model::network::Network;
use crate::model::table::Tables;
use crate::recurrent;
use crate::surroundings::Surroundings;
use crate::units::Force;

/// Recurrent networks with what they remember.
pub trait Networks {
    /// Puts what they tell into the estimates of the next frame.
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]);
}

/// No networks, or some.
impl<N: Networks> Networks for Option<N> {
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        if let Some(networks) = self {
            networks.apply(estimates);
        }
    }
}

/// Networks of one size, and their runs.
#[derive(Clone, Debug)]
pub struct Running<
    'n,
    const INPUTS: usize,
    const HIDDEN: usize,
    const TOLD: usize,
    const NETWORKS: usize,
> {
    networks: &'n [Network<INPUTS, HIDDEN, TOLD>; NETWORKS],
    runs: [Run<INPUTS, HIDDEN, TOLD>; NETWORKS],
}

impl<'n, const INPUTS: usize, const HIDDEN: usize, const TOLD: usize, const NETWORKS: usize>
    Running<'n, INPUTS, HIDDEN, TOLD, NETWORKS>
{
    /// Nothing is remembered yet.
    pub const fn start(networks: &'n [Network<INPUTS, HIDDEN, TOLD>; NETWORKS]) -> Self {
        Self {
            networks,
            runs: [const { Run::RESET }; NETWORKS],
        }
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const TOLD: usize, const NETWORKS: usize> Networks
    for Running<'_, INPUTS, HIDDEN, TOLD, NETWORKS>
{
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        recurrent::apply(self.networks, &mut self.runs, estimates);
    }
}

/// The whole way from frames to forces, with all that it remembers.
#[derive(Clone, Debug)]
pub struct Estimator<'t, N> {
    tables: &'t Tables<'t>,
    memories: [Memory; SENSORS],
    networks: N,
    detector: Detector,
    astray: Astray,
}

impl<'t, N: Networks> Estimator<'t, N> {
    /// Nothing is remembered yet.
    pub fn new(tables: &'t Tables<'t>, networks: N) -> Self {
        Self {
            tables,
            memories: [Memory::default(); SENSORS],
            networks,
            detector: Detector::default(),
            astray: Astray::new(&Limits::GRIPPER),
        }
    }

    /// The same within other limits.
    pub const fn within(mut self, limits: &Limits) -> Self {
        self.astray = Astray::new(limits);
        self
    }

    /// The forces of the next frame.
    pub fn step(&mut self, frame: &Frame, around: &Surroundings) -> [Estimate; SENSORS] {
        let mut estimates = estimate_all(self.tables, frame, around, &mut self.memories);
        let ideal = estimates;
        self.networks.apply(&mut estimates);
        self.detector.watch(&ideal, &mut estimates);
        self.astray.watch(&ideal, &mut estimates);
        estimates
    }

    /// What friction may hold at rest at every sensor ([`crate::tare`]).
    pub fn held(&self) -> [[Force; 2]; SENSORS] {
        let mut number = 0;
        [(); SENSORS].map(|()| {
            let compensation = self.tables.compensation(number);
            number += 1;
            compensation.map_or([Force(0); 2], Compensation::held)
        })
    }

    /// Whether the fingertips' own weight and inertia are taken off the forces.
    pub fn is_without_mass(&self) -> bool {
        let mut compensations = self.tables.compensations.iter();
        compensations.any(Compensation::is_without_mass)
    }

    /// The networks with what they remember.
    pub fn networks(&mut self) -> &mut N {
        &mut self.networks
    }

    /// Whether a sensor's network is not believed.
    pub fn is_astray(&self, sensor: usize) -> bool {
        self.astray.is_astray(sensor)
    }

    /// The watch for foreign magnets.
    pub fn detector(&self) -> &Detector {
        &self.detector
    }
}
