//! The grasp's figures over scattered grippers, on all cores.
//! `cargo bench -p host-tools --bench grasp [-- --seeds N] [--hours H]`

use analysis::numbers;
use analysis::progress;
use report::text::terminal;
use sim::closed_loop::motor_rig::DriveCase;
use sim::closed_loop::requirements::{
    FORCES_N, contact_latencies_ms, count_false_contacts, current_limited_peak_n,
    force_bandwidth_hz, force_frequency_response, grasp_statistics, max_overshoot_n, quantile,
};
use sim::drivetrain::parameters::Lead;

/// The first seed: the law's constants were chosen on others.
const FIRST: u64 = 1001;

fn main() {
    let seeds = argument("--seeds", 1000.0) as u64;
    let hours = argument("--hours", 10.0);
    let all = FIRST..FIRST + seeds;
    let bar = progress::progress_bar("gripping", 2 * FORCES_N.len() * seeds as usize);
    let mut table = terminal::table([
        "screw",
        "N",
        "over, p50",
        "p99",
        "most",
        "asked",
        "95 %, p99, ms",
        "most",
        "rms, p99",
        "held",
        "by current",
    ]);
    for lead in Lead::BOTH {
        for set_n in FORCES_N {
            let found = grasp_statistics(lead, set_n, all.clone(), || bar.inc(1));
            let plain = |value: f64| numbers::decimal(value, 2);
            table.add_row([
                format!("{lead:?}"),
                plain(set_n),
                plain(quantile(&found.over_n, 0.5)),
                plain(quantile(&found.over_n, 0.99)),
                plain(quantile(&found.over_n, 1.0)),
                plain(max_overshoot_n(set_n)),
                plain(quantile(&found.rise_ms, 0.99)),
                plain(quantile(&found.rise_ms, 1.0)),
                plain(quantile(&found.error_n, 0.99)),
                found.held.to_string(),
                plain(current_limited_peak_n(lead, set_n, 1)),
            ]);
        }
    }
    bar.finish_and_clear();
    println!(
        "Grasps of something rigid (333 N/mm), seeds {FIRST} to {}, everything uncertain off by up to 20 %; \
         newtons beyond the force asked for. Simulated, motor constants assumed.\n{table}",
        FIRST + seeds - 1
    );
    for lead in Lead::BOTH {
        let tones = force_frequency_response(&DriveCase::nominal(lead, 1));
        let gains = tones.iter().map(|[hz, gain]| format!("{hz}: {gain:.2}"));
        println!(
            "screw {lead:?}: gain of 100 N +- 20 N over Hz {}; -3 dB at {:.0} Hz (asked: 25)",
            gains.collect::<Vec<_>>().join(", "),
            force_bandwidth_hz(&tones).unwrap_or(f64::NAN)
        );
    }
    for rates in [[50e3, 200e3], [100e3, 400e3]] {
        let found = contact_latencies_ms(rates, FIRST..FIRST + seeds);
        println!(
            "ground contacts, {:.0} to {:.0} kN/s on a fingertip: reported {:.2} ms after the touch (p50), {:.2} (p99), {:.2} (most); \
             asked: 2",
            1e-3 * rates[0],
            1e-3 * rates[1],
            quantile(&found, 0.5),
            quantile(&found, 0.99),
            quantile(&found, 1.0)
        );
    }
    for noise in [1.0, 2.0] {
        println!(
            "false contacts in {hours} virtual hours of the detectors, {noise} times the noise, swung at 3 Hz and 30 \
             m/s^2: {} (seed 1)",
            count_false_contacts(hours, noise, 1)
        );
    }
}

fn argument(name: &str, otherwise: f64) -> f64 {
    let mut arguments = std::env::args().skip_while(|argument| argument != name);
    arguments.nth(1).map_or(otherwise, |value| value.parse().expect("a number"))
}
