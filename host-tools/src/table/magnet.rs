//! Whether a foreign magnet is noticed on this gripper, by what would run there.

use anyhow::Result;
use serde_json::{Value, json};

use super::data::Data;
use super::refit::Refitted;
use super::variant::{Behind, Variant};
use crate::bench::{again, truth};
use crate::foreign::pass::Device;
use crate::foreign::rows::{Recorded, Simulated, World};
use crate::foreign::tally::Tally;
use crate::foreign::{count as count_rows, words};
use crate::networks::Networks;
use crate::progress;

/// What was counted, and of what.
#[derive(Debug)]
pub struct Magnet {
    /// What ran.
    pub variant: Variant,
    /// Whether the time is a simulated gripper's; else that of the recording held out.
    pub simulated: bool,
    /// Both in a sentence.
    pub of: String,
    /// The counts.
    pub tally: Tally,
}

impl Magnet {
    /// For `--json`.
    pub fn json(&self) -> Value {
        let mut value = words::json(&self.tally);
        if let Some(object) = value.as_object_mut() {
            object.insert("variant".to_owned(), json!(self.variant.id()));
            object.insert("simulated".to_owned(), json!(self.simulated));
        }
        value
    }
}

/// The network of the most that is known, whose physics stand alone where it was not trained.
pub fn behind(refitted: &Refitted) -> Variant {
    match refitted.behind(Behind::Effects) {
        Some(_) => Variant::PhysicsGru,
        None => Variant::Gru3AxisIdeal,
    }
}

/// Lets magnets pass for so many hours; `None` where there are none.
pub fn count(
    data: &Data,
    refitted: &Refitted,
    networks: Option<&Networks>,
    hours: f64,
) -> Result<Option<Magnet>> {
    let with_network = behind(refitted);
    let Some(built) = refitted.behind(with_network.behind()) else {
        return Ok(None);
    };
    if hours == 0.0 {
        return Ok(None);
    }
    let variant = match (networks, with_network.behind()) {
        (Some(_), _) => with_network,
        (None, Behind::Effects) => Variant::Physics,
        (None, _) => Variant::IdealFitted,
    };
    let (world, whose) = match simulated(data) {
        Some(world) => (
            World::Simulated(Box::new(world)),
            "on fresh recordings of the same simulated gripper".to_owned(),
        ),
        None => (
            World::Recorded(Recorded::open(
                data.held_out.clone(),
                data.alignment,
                built,
                data.seed,
            )?),
            format!(
                "on recording {}, to which the fields of magnets were added",
                data.held_out_name()
            ),
        ),
    };
    let bar = progress::bar("foreign magnets pass", 0);
    let tally = count_rows(&Device { built, networks }, &world, hours, &bar)?;
    bar.finish_and_clear();
    Ok(Some(Magnet {
        variant,
        simulated: matches!(world, World::Simulated(_)),
        of: format!(
            "The firmware's detector behind {}, {whose}:",
            variant.words()
        ),
        tally,
    }))
}

/// The campaign's gripper on the bench again, where the truth lies beside the campaign.
fn simulated(data: &Data) -> Option<Simulated> {
    let path = truth::default_path(&data.campaign.folder).ok()?;
    let settings = again::settings(&path).ok().filter(|_| data.simulated)?;
    Simulated::again(settings).ok()
}
