//! All ways of telling the force from the field, side by side on one recording: the paper's Table I.
//!
//! - [`variant`]: the ways, and what each is made of.
//! - [`paper`]: the paper's figures.
//! - [`data`]: what is learned from, what tells when to stop, and what is judged.
//! - [`mod@refit`]: the physics fitted to what is learned from alone.
//! - [`mod@teach`]: the networks.
//! - [`mod@judge`]: each way on the held-out recording, through the device's code.
//! - [`mod@length`]: how the error falls with the seconds that are learned from.
//! - [`magnet`]: whether a foreign magnet is noticed.
//!
//! A network that the device cannot hold is left out with the reason: the table is of what runs there.
//!
//! The held-out recording chooses nothing: no weight, no parameter, no epoch, no scale.

pub mod data;
pub mod judge;
pub mod length;
pub mod magnet;
pub mod paper;
pub mod refit;
pub mod teach;
pub mod variant;

use anyhow::Result;
use model_export::gru::file::fingerprint;
use model_export::gru::train::course::Best;
use model_export::gru::unfit::Unfit;

use data::Data;
use judge::{Judged, judge};
use length::Point;
use magnet::Magnet;
use refit::refit;
use teach::{Lessons, Plan};
use variant::Variant;

/// What was trained for a row of the table.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The row.
    pub variant: Variant,
    /// Where the weights of each network were found.
    pub found: Vec<Best>,
    /// SHA-256 over the weights.
    pub sha256: String,
}

/// The whole comparison.
#[derive(Debug)]
pub struct Table {
    /// Names of the recordings that were learned from, and of the one that was not.
    pub recordings: (Vec<String>, String),
    /// Seconds that were learned from.
    pub training_s: f64,
    /// Seconds of these at their end that told when to stop.
    pub stopping_s: f64,
    /// Every way that was judged, in the order of [`Variant::ALL`].
    pub judged: Vec<Judged>,
    /// The networks among them.
    pub trained: Vec<Trained>,
    /// Errors against the seconds that were learned from.
    pub lengths: Vec<Point>,
    /// Whether a foreign magnet is noticed; `None` where it was not asked for.
    pub foreign: Option<Magnet>,
    /// Whether the recordings say that they are simulated.
    pub simulated: bool,
    /// The physics's effects.
    pub effects: Vec<String>,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Table {
    /// The way's figures, where it was judged.
    pub fn of(&self, variant: Variant) -> Option<&Judged> {
        self.judged.iter().find(|judged| judged.variant == variant)
    }

    /// What white noise alone would leave of each force, Fx and Fz, in newtons, made of one reading.
    pub fn noise_n(&self) -> Option<[f64; 2]> {
        self.of(Variant::IdealFitted)
            .map(|judged| judged.axes.map(|axis| axis.noise_n))
    }
}

/// Fits, trains and judges everything; `plan` says how, and is told how far it is. At the end magnets
/// pass for so many hours.
pub fn compute(data: &Data, plan: &Plan, magnet_hours: f64) -> Result<Table> {
    let whole = data.training_s();
    let refitted = refit(data, whole)?;
    let lessons = Lessons::of(data, &refitted, whole)?;
    let mut notes = data.notes.clone();
    notes.extend(refitted.notes.iter().cloned());
    let (mut judged, mut trained) = (Vec::new(), Vec::new());
    let mut networks = None;
    for variant in Variant::ALL {
        let Some(built) = refitted.behind(variant.behind()) else {
            continue;
        };
        let taught = match plan.teach(variant, &lessons, built, whole) {
            Err(error) if error.is::<Unfit>() => {
                notes.push(format!(
                    "left out, since the device cannot hold it: {error:#}"
                ));
                continue;
            }
            taught => taught?,
        };
        judged.push(judge(data, variant, built, taught.as_ref())?);
        if let Some(taught) = taught {
            trained.push(Trained {
                variant,
                sha256: fingerprint(&taught.networks.file.networks),
                found: taught.networks.file.provenance.found.clone(),
            });
            if variant == magnet::behind(&refitted) {
                networks = Some(taught.networks);
            }
        }
    }
    let lengths = length::compute(data, plan, &judged)?;
    plan.close();
    let foreign = magnet::count(data, &refitted, networks.as_ref(), magnet_hours)?;
    Ok(Table {
        recordings: (data.names(), data.held_out_name()),
        training_s: whole,
        stopping_s: lessons.stopping_s,
        judged,
        trained,
        lengths,
        foreign,
        simulated: data.simulated,
        effects: refitted.effects,
        notes,
    })
}

/// What adding a network to the physics with effects is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Worth {
    /// The physics alone is at the floor of each force.
    Floor,
    /// The network takes no share of the error worth it.
    Nothing,
    /// It takes this share of the error.
    Share(f64),
    /// It adds this share.
    Harm(f64),
}

/// At the floor: within this factor of what white noise leaves.
pub const AT_FLOOR: f64 = 1.1;
/// Less than this share is no difference worth a network.
pub const WORTH: f64 = 0.02;

/// The verdict; `None` where the model has no effects.
pub fn worth(table: &Table) -> Option<Worth> {
    let (physics, both) = (table.of(Variant::Physics)?, table.of(Variant::PhysicsGru)?);
    let floor = table.noise_n()?;
    let rms = |judged: &Judged| judged.axes.map(|axis| axis.fixed.rms());
    let at_floor = rms(physics)
        .iter()
        .zip(floor)
        .all(|(rms, floor)| *rms <= AT_FLOOR * floor);
    let ratio = both.rmse_n() / physics.rmse_n();
    Some(match ratio {
        _ if ratio > 1.0 + WORTH => Worth::Harm(ratio - 1.0),
        _ if at_floor => Worth::Floor,
        _ if ratio > 1.0 - WORTH => Worth::Nothing,
        _ => Worth::Share(1.0 - ratio),
    })
}
