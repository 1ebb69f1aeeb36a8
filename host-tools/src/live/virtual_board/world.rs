//! What the virtual board's sensors feel.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use model_export::inverse::build::Built;
use model_export::recordings::Problem;
use model_export::recordings::align::Alignment;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;

use crate::board::pressed::Pressed;
use crate::board::recorded::Recorded;
use crate::board::world::World;

/// Seed of the sensors' noise.
const SEED: u64 = 1;
/// A grasp takes this long, with this force at each sensor, and this much across it.
const GRASP_S: f64 = 8.0;
const GRASP_N: f64 = 40.0;
const ACROSS_N: f64 = 12.0;

/// What goes on around the board.
#[derive(Clone, Debug, PartialEq)]
pub enum Doing {
    /// The fingers close on something, lift it and let it go, again and again.
    Grasps,
    /// Each finger is pressed with the same forces all the time, in newtons: lateral, against the other
    /// finger, and longitudinal.
    Pressed([f64; 2]),
    /// A recording happens again.
    Recorded(PathBuf),
}

impl Doing {
    /// The recording, opened; `None` where there is none.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn stream(&self) -> Result<Option<RawStream>, Problem> {
        match self {
            Self::Recorded(folder) => open(folder).map(Some),
            Self::Grasps | Self::Pressed(_) => Ok(None),
        }
    }

    /// The world, of the recording where there is one.
    pub fn world(&self, stream: Option<RawStream>, built: &Built) -> Box<dyn World> {
        let (model, pressed) = (&built.model, |newtons: [f64; 2]| {
            let [x, z] = newtons;
            [[x, z], [x, z], [-x, z], [-x, z]]
        });
        match (self, stream) {
            (_, Some(stream)) => Box::new(Recorded::new(stream, built)),
            (Self::Pressed(newtons), None) => {
                let forces = pressed(*newtons);
                Box::new(Pressed::new(model, SEED, move |_| forces))
            }
            (_, None) => Box::new(Pressed::new(model, SEED, move |s| pressed(grasp(s)))),
        }
    }
}

fn open(folder: &Path) -> Result<RawStream, Problem> {
    let (description, _) = Description::read(folder)?;
    RawStream::open(folder, &description, Alignment { delay_us: 0.0 })
}

/// Lateral and longitudinal force of a grasp after so many seconds: a second of nothing, for the tare.
fn grasp(seconds: f64) -> [f64; 2] {
    let phase = TAU * (seconds - 1.0).max(0.0) / GRASP_S;
    [
        GRASP_N * (1.0 - phase.cos()) / 2.0,
        ACROSS_N * (1.0 - phase.cos()) / 2.0 * (2.0 * phase).sin(),
    ]
}
