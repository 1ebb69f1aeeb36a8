use std::path::Path;
use std::time::Instant;
use model_export::effects::{Addition, CATALOGUE, find};
use model_export::fit::{Options, campaign::Prepared, evidence::Around};
use model_export::recordings::{Campaign, align::Alignment};
use rand::{RngExt, SeedableRng};

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let campaign = Campaign::read(Path::new(&args[1]), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let prepared = Prepared::cylinder(&campaign).unwrap();
    let effects: Vec<Addition> = args[2..].iter().map(|n| Addition::Catalogue(find(n).unwrap())).collect();
    let t = Instant::now();
    let fit = prepared.fit(&effects, prepared.split(&effects), Options::default(), |_| ()).unwrap();
    println!("fit {:.2} s  rms {:.4} floor {:.4}", t.elapsed().as_secs_f64(), fit.tally().mean_square().sqrt(), fit.tally().floor_g());
    let t = Instant::now();
    let around = Around::new(&prepared, &effects, &fit, 5.0);
    println!("around {:.2} s, {} blocks", t.elapsed().as_secs_f64(), around.blocks);
    let mut all = Vec::new();
    for effect in CATALOGUE {
        let add = Addition::Catalogue(effect);
        if effects.contains(&add) { continue; }
        let t = Instant::now();
        let e = around.evidence(&add).unwrap();
        all.push((effect.id, e, t.elapsed().as_secs_f64()));
    }
    all.sort_by(|a, b| b.1.gain().total_cmp(&a.1.gain()));
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let draws: Vec<Vec<f64>> = (0..500).map(|_| (0..around.blocks).map(|_| if rng.random::<bool>() { 1.0 } else { -1.0 }).collect()).collect();
    let t = Instant::now();
    let best = &all[0].1;
    let mut z = Vec::new();
    let mut most = vec![f64::NEG_INFINITY; draws.len()];
    for (_, e, _) in &all {
        let drawn = around.drawn(e, best, &draws);
        let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
        let sd = (drawn.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / drawn.len() as f64).sqrt().max(1e-12);
        most.iter_mut().zip(&drawn).for_each(|(m, d)| *m = m.max((d - mean) / sd));
        z.push((e.explained - mean) / sd);
    }
    println!("bootstrap {:.2} s", t.elapsed().as_secs_f64());
    for ((name, e, s), z) in all.iter().zip(z) {
        let p = (1 + most.iter().filter(|m| **m >= z).count()) as f64 / (1 + most.len()) as f64;
        println!("{name:22} gain {:8.4} wins {}/{} explained {:10.1} / {:2}  z {z:8.2} p {p:.3} ztyp {:8.2}  {s:.2} s", e.gain(), e.wins(), e.folds.len(), e.explained, e.count, e.z_typical);
    }
}
