//! The argument by which the reference's clock is brought to the board's, the same for every command.

use anyhow::{Result, bail};
use model_export::recordings::align::Alignment;

/// How the two clocks belong together.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Clocks {
    /// Delay of the reference's clock: added to its times before the fields around them are taken.
    #[arg(
        long,
        value_name = "MS",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    delay_ms: f64,
}

impl Clocks {
    /// As the readers of recordings take it.
    pub fn alignment(self) -> Result<Alignment> {
        if !self.delay_ms.is_finite() {
            bail!("--delay-ms must be a finite number of milliseconds");
        }
        Ok(Alignment {
            delay_us: self.delay_ms * 1e3,
        })
    }
}
