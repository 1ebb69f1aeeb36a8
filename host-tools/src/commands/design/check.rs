//! `magpie design check`: judges a design.

use std::path::PathBuf;

use anyhow::Result;
use model_export::design::interference::{DRAWS, Surroundings};
use model_export::design::{Design, Judged, sweep};

use super::words;
use crate::report;
use crate::report::design as pages;
use crate::report::numbers::number;
use crate::show;

/// Judge a design: range of forces and what ends it, sensitivity, interference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design check                      # MAGPIE's own
  cargo magpie design check design.toml -o design.html
  cargo magpie design check design.toml --json

A design.toml, lengths in mm; sensor, limits, tolerances and material.NAME may be left out:
  gap_mm = 1.5
  force_range_n = 250.0         # what is asked; 250 without it
  stiffness_x_n_per_mm = 500.0  # of the whole axis; without it the beam's alone
  [magnet]
  shape = \"cylinder\"
  diameter_mm = 3.0
  length_mm = 2.0
  remanence_t = 1.2
  axis = \"y\"
  [flexure_x]                   # and the same for [flexure_z]
  support = \"clamped-free\"      # or clamped-clamped, clamped-guided
  material = \"17-4PH\"
  length_mm = 30.0
  width_mm = 15.0
  thickness_mm = 5.0
  [sensor]                      # range_gauss, gauss_per_lsb, noise_gauss, package_mm
  [limits]                      # stroke_mm, life_cycles, safety
  [tolerances]                  # offset_mm, gap_mm, tilt_deg, remanence
  [material.\"my steel\"]         # modulus_gpa, yield_mpa, fatigue_coefficient_mpa, fatigue_exponent")]
pub struct Args {
    /// The design; otherwise MAGPIE's own.
    design: Option<PathBuf>,
    /// Where the report goes.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Seed of the draws of misalignment: the same seed, the same numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let design = match &args.design {
        Some(path) => Design::read(path)?,
        None => Design::magpie(),
    };
    let judged = Judged::of(&design);
    let around = Surroundings::assumed(args.seed, DRAWS);
    let shifts = sweep::shifts(&design, design.force_range_n, &around);
    if let Some(path) = &args.output {
        let sections = pages::of_one(&design, &judged, &shifts);
        report::write_sections(path, "magpie: a design judged", &sections)?;
    }
    if args.json {
        let told = words::report_json(&design, &judged, &shifts);
        show::page(&format!("{told}\n"))?;
        return Ok(());
    }
    let mut page = words::described(&design) + "\n" + &words::tables(&judged, &shifts);
    page += &verdict(&design, &judged);
    page += &words::binding(&judged);
    page += &words::assumed(&design);
    if let Some(path) = &args.output {
        page += &format!("Report: {}\n", path.display());
    }
    show::page(&page)?;
    Ok(())
}

/// Whether it does what is asked.
pub fn verdict(design: &Design, judged: &Judged) -> String {
    let asked = number(design.force_range_n);
    let has = number(judged.range_n());
    let sentence = match judged.reaches(design.force_range_n) {
        true => format!("It measures {has} N on both axes; {asked} N are asked."),
        false => format!("It falls short: {has} N of the {asked} N that are asked."),
    };
    show::paragraph(&sentence)
}
