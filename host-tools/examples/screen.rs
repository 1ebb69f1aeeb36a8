use host_tools::diagnose::{candidates::candidates, select::select};
use model_export::fit::{Options, campaign::Prepared};
use model_export::model_file::Base;
use model_export::recordings::{Campaign, align::Alignment};
use std::path::Path;
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let campaign =
        Campaign::read(Path::new(&args[1]), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let prepared = Prepared::cylinder(&campaign).unwrap();
    let (judged, not) = candidates(&campaign, Base::Cylinder, None, &[], &[]);
    let t = Instant::now();
    let s = select(
        &campaign,
        &prepared,
        &[],
        &judged,
        Options::default(),
        &|_| (),
    )
    .unwrap();
    println!(
        "== {} {:.1} s  not judged: {}",
        args[1],
        t.elapsed().as_secs_f64(),
        not.iter()
            .map(|u| u.effect.clone())
            .collect::<Vec<_>>()
            .join(",")
    );
    for (step, stage) in s.steps.iter().zip(&s.stages[1..]) {
        println!(
            "  {} tied {:?} shadows {:?} gain {:.4} p {:.3} z {:.1} -> {:.3} floors",
            step.chosen.name(),
            step.tied
                .iter()
                .map(|t| t.name().to_owned())
                .collect::<Vec<_>>(),
            step.shadows
                .iter()
                .map(|t| t.name().to_owned())
                .collect::<Vec<_>>(),
            step.gain,
            step.p_adjusted,
            step.z_typical,
            stage.floors()
        );
    }
    println!(
        "  end {:.3} floors, withheld {:?}, located {:?}, block {:.1} s, {} blocks",
        s.stages.last().unwrap().floors(),
        s.withheld,
        s.located
            .iter()
            .map(|(c, x)| format!("{} {:.2}", c.name, x))
            .collect::<Vec<_>>(),
        s.block_s,
        s.blocks
    );
}
