//! Under a steady load the flexure gives way a little more, and comes back slowly.

use super::memory::low_pass;
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "creep",
    stage: Stage::Flexure,
    physics: "A polymer, and to a much smaller degree a metal, does not stop moving when the load stands \
              still. Part of the deflection comes with a delay of seconds to minutes, and goes with the \
              same delay after unloading. No single time constant describes a material: one part follows \
              within seconds, another takes a good deal longer. Metals creep by 0.02 to 0.1 %, printed \
              polymers by 1 to 10 %.",
    equation: "F' = F + c (y1 + w y2) / (1 + w), taui yi' + yi = F",
    regressors: "dB/dF times the low-passed F",
    needs: &[],
    shows_against: &["loading_x", "loading_z", "fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("creep_x", "%", 2.0),
        Parameter::coefficient("creep_z", "%", 2.0),
        // Any time may be the only one: the fast part's grid spans them all, and the least weight leaves
        // next to nothing for a slow part that is not there.
        Parameter::shape("time1", "s", &[0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0]),
        Parameter::shape("time2", "s", &[6.0, 12.0, 25.0, 50.0]),
        Parameter::shape("weight", "", &[0.03, 0.1, 0.3, 1.0, 3.0]),
    ],
    size: Size {
        words: "delayed share of the deflection",
        unit: "%",
        first: 2,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 2.0,
        plausible: (0.0, 15.0),
        possible: (0.0, 300.0),
    },
    record: "Hold a high load for 60 s, then no load for 60 s, twice: creep relaxes back, a drift goes \
              on.",
    confused_with: &[
        ("field_drift", "both are slow"),
        (
            "hysteresis",
            "where the load always returns at the same pace",
        ),
        ("softening", "both grow under load"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    for axis in [0, 1] {
        let parts = parts_of(values, axis);
        if parts.iter().all(|(percent, _)| *percent == 0.0) {
            continue;
        }
        let force: Vec<f64> = track.smooth_n.iter().map(|force| force[axis]).collect();
        for (percent, time_s) in parts {
            let delayed = low_pass(&track.time_s, &force, time_s);
            series.add_force(axis, |row| 0.01 * percent * delayed[row]);
        }
    }
}

/// Delayed share of the deflection in percent and time constant in seconds of the fast and of the slow
/// part along one axis (0 lateral, 1 longitudinal); `values` in the order of the parameters.
pub fn parts_of(values: &[f64], axis: usize) -> [(f64, f64); 2] {
    let &[creep_x, creep_z, fast_s, slow_s, weight] = values else {
        return [(0.0, 1.0); 2];
    };
    let creep = [creep_x, creep_z][axis.min(1)];
    let fast = creep / (1.0 + weight);
    [(fast, fast_s), (weight * fast, slow_s)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unloaded for one second, then 100 N on both axes for a hundred.
    fn step() -> Track {
        let time_s: Vec<f64> = (0..=10_100).map(|i| f64::from(i) * 0.01).collect();
        let force_n: Vec<[f64; 2]> = time_s
            .iter()
            .map(|t| [if *t > 1.0 { 100.0 } else { 0.0 }; 2])
            .collect();
        Track {
            smooth_n: force_n.clone(),
            force_n,
            time_s,
            ..Track::default()
        }
    }

    fn shift(values: &[f64]) -> Vec<[f64; 2]> {
        let track = step();
        let mut series = Series::of(&track, [1.0; 2], &[]);
        apply(values, &track, &mut series);
        let rows = series.force_n.iter().zip(&track.force_n);
        rows.map(|(after, before)| [after[0] - before[0], after[1] - before[1]])
            .collect()
    }

    #[test]
    fn after_a_step_two_parts_come_each_in_its_time() {
        // 3 %: one for the fast part, two for the slow one; 1.5 % along z.
        let shift = shift(&[3.0, 1.5, 1.0, 20.0, 2.0]);
        for (row, expected) in [
            (100, 0.0),
            // One second: 63.2 % of 1 N and 4.9 % of 2 N.
            (200, 0.632 + 2.0 * 0.049),
            (2100, 1.0 + 2.0 * 0.632),
            (10_100, 1.0 + 2.0 * 0.9933),
        ] {
            let [x, z] = shift[row];
            assert!((x - expected).abs() < 0.01, "{row}: {x} {expected}");
            assert!((z - 0.5 * x).abs() < 1e-12);
        }
    }

    #[test]
    fn two_equal_times_are_one_whatever_the_weight() {
        let (a, b) = (
            shift(&[2.0, 0.0, 5.0, 5.0, 0.1]),
            shift(&[2.0, 0.0, 5.0, 5.0, 7.0]),
        );
        for (a, b) in a.iter().zip(&b) {
            assert!((a[0] - b[0]).abs() < 1e-12 && b[1] == 0.0);
        }
        // After one time constant.
        assert!((a[600][0] - 2.0 * 0.632).abs() < 0.01, "{}", a[600][0]);
    }
}
