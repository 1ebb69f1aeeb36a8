//! Creep: delayed deflection under constant load, with recovery.

use crate::effects::operators::low_pass_with_rates;
use crate::effects::{
    CreepParts, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, ForceForm,
    MagnitudeSpec, Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "creep",
    stage: EffectStage::Flexure,
    physics: "A polymer, and to a much smaller degree a metal, continues to deform under constant load. A part \
              of the deflection is delayed by seconds to minutes, and recovers with the same delay after \
              unloading. A single time constant does not describe a material: a fast part responds within \
              seconds, a slow part much later. Metals creep by 0.02 to 0.1 %, printed polymers by 1 to \
              10 %.",
    equation: "F' = F + c (y1 + w y2) / (1 + w), taui yi' + yi = F",
    regressors: "dB/dF times the low-passed F",
    needs: &[],
    plot_against: &["loading_x", "loading_z", "fx_n", "fz_n"],
    parameters: &[
        EffectParameter::coefficient("creep_x", "%", 2.0),
        EffectParameter::coefficient("creep_z", "%", 2.0),
        // The grid of the fast part spans all times, and the minimum weight makes the slow part negligible: a
        // material with a single time constant is covered.
        // Below a fifth of a second it would be the delay of a clock or a filter.
        EffectParameter::shape("time1", "s", &[0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0])
            .within(0.2, 500.0),
        EffectParameter::shape("time2", "s", &[6.0, 12.0, 25.0, 50.0]).within(0.2, 500.0),
        EffectParameter::shape("weight", "", &[0.03, 0.1, 0.3, 1.0, 3.0]),
    ],
    size: MagnitudeSpec {
        description: "delayed fraction of the deflection",
        unit: "%",
        first: 2,
        typical: 2.0,
        plausible: (0.0, 15.0),
        possible: (0.0, 300.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Apply a high load for 60 s, then no load for 60 s, twice: creep recovers, a drift \
              continues.",
    confused_with: &[
        ("field_drift", "both are slow"),
        ("hysteresis", "where the load always returns at the same speed"),
        ("softening", "both increase under load"),
    ],
    similar_outside: "creep of the reference",
    signatures: &[Signature::LoadHistory, Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 10,
        range: (0.0, 50.0),
        meaning: "delayed compliance, as a share of the instantaneous one",
        shared: false,
    }),
    device: DeviceForm::Force(ForceForm::Creep(parts_of)),
    is_transient: false,
    has_memory: true,
    time: TimeDependence::Rows,
    reads: EffectStage::FORCES,
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    for axis in [0, 1] {
        let parts = parts_of(values, axis);
        if parts.iter().all(|(percent, _)| *percent == 0.0) {
            continue;
        }
        let (force, rates) = series.history(excitation, axis);
        for (percent, time_s) in parts {
            let delayed = low_pass_with_rates(&excitation.time_s, &force, &rates, time_s);
            series.add_force(axis, |row| 0.01 * percent * delayed[row]);
        }
    }
}

/// Delayed fraction of the deflection in percent and time constant in seconds of the fast and the slow part along
/// one axis (0 lateral, 1 longitudinal); `values` in the order of the parameters.
fn parts_of(values: &[f64], axis: usize) -> CreepParts {
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

    /// No load for 1 s, then 100 N on both axes for 100 s.
    fn step() -> ExcitationSeries {
        let time_s: Vec<f64> = (0..=10_100).map(|i| f64::from(i) * 0.01).collect();
        let force_n: Vec<[f64; 2]> =
            time_s.iter().map(|t| [if *t > 1.0 { 100.0 } else { 0.0 }; 2]).collect();
        ExcitationSeries {
            smooth_n: force_n.clone(),
            rate_n_per_s: vec![[0.0; 2]; force_n.len()],
            force_n,
            time_s,
            ..ExcitationSeries::default()
        }
    }

    fn shift(values: &[f64]) -> Vec<[f64; 2]> {
        let excitation = step();
        let mut series = StateSeries::of(&excitation, [1.0; 2], &[]);
        apply(values, &excitation, &mut series);
        let rows = series.force_n.iter().zip(&excitation.force_n);
        rows.map(|(after, before)| [after[0] - before[0], after[1] - before[1]]).collect()
    }

    #[test]
    fn step_response_has_two_time_constants() {
        // Along x 1 % fast and 2 % slow, along z half of it.
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
    fn equal_time_constants_are_independent_of_the_weight() {
        let (a, b) = (shift(&[2.0, 0.0, 5.0, 5.0, 0.1]), shift(&[2.0, 0.0, 5.0, 5.0, 7.0]));
        for (a, b) in a.iter().zip(&b) {
            assert!((a[0] - b[0]).abs() < 1e-12 && b[1] == 0.0);
        }
        // After one time constant.
        assert!((a[600][0] - 2.0 * 0.632).abs() < 0.01, "{}", a[600][0]);
    }
}
