//! What was recorded, for people and for programs.

use std::path::Path;

use serde_json::{Value, json};

use crate::live::recorder::Tally;
use crate::show;

/// The page.
pub fn text(output: &Path, start_s: f64, tally: &Tally) -> String {
    let seconds = |us: u64| us as f64 * 1e-6;
    let numbers = |sensors: &[usize]| {
        let numbers: Vec<String> = sensors.iter().map(usize::to_string).collect();
        numbers.join(", ")
    };
    let mut text = format!(
        "Recorded to {}: {:.1} s, {} rows of sensors {}; start_s = {}.\n",
        output.display(),
        seconds(tally.span_us),
        tally.rows,
        numbers(&tally.sensors),
        show::plain(start_s, 3),
    );
    match tally.gaps {
        0 => text += "No row was lost.\n",
        gaps => {
            let gaps = if gaps == 1 {
                "1 gap".to_owned()
            } else {
                format!("{gaps} gaps")
            };
            let (longest_us, at_us) = tally.longest_us;
            text += &format!(
                "Lost: {} rows in {gaps} of t_us, the longest {:.1} ms at {:.3} s.\n",
                tally.lost,
                1e3 * seconds(longest_us),
                seconds(at_us),
            );
        }
    }
    if tally.left_out > 0 {
        let silent = tally.silent.iter().enumerate();
        let silent = silent.filter(|(sensor, count)| **count > 0 && tally.sensors.contains(sensor));
        let silent: Vec<String> = silent
            .map(|(sensor, count)| format!("sensor {sensor} in {count}"))
            .collect();
        text += &show::paragraph(&format!(
            "Left out: {} rows in which a sensor had not answered ({}); a row has all sensors or is none.",
            tally.left_out,
            silent.join(", ")
        ));
    }
    text += &show::paragraph(
        "No force is known: force.csv holds times and empty forces. Until the reference's table stands in its \
         place (t_us from the same start), fit, compare and replay have nothing to hold the field against.",
    );
    text
}

/// The object.
pub fn json(output: &Path, start_s: f64, tally: &Tally) -> Value {
    json!({
        "recording": output,
        "start_s": start_s,
        "span_s": tally.span_us as f64 * 1e-6,
        "sensors": tally.sensors,
        "rows": tally.rows,
        "lost_rows": tally.lost,
        "gaps": tally.gaps,
        "longest_gap_s": tally.longest_us.0 as f64 * 1e-6,
        "longest_gap_at_s": tally.longest_us.1 as f64 * 1e-6,
        "left_out_rows": tally.left_out,
        "silent_rows": tally.silent,
        "reference": false,
    })
}
