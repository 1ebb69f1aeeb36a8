//! The verdict of a comparison as text.

use crate::analysis::compare::attribution::MIN_SHARE;
use crate::analysis::compare::{Attribution, Bin, Comparison, FieldAxisErrors, ForceAxisErrors};
use crate::analysis::data_quality::Finding;

/// Residuals up to this factor times the floor are indistinguishable from noise.
pub const AT_FLOOR: f64 = 1.15;

/// Fraction of the explained residual that counts as concentrated.
const CONCENTRATED: f64 = 0.6;
/// Maximum fraction of the rows in a concentrated range.
const MAX_ROWS: f64 = 0.45;

/// RMS over channels.
fn pooled(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, n), value| (sum + value * value, n + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::NAN }
}

/// Cross-validated error over all channels, in gauss.
pub fn rms_g(axes: &[FieldAxisErrors]) -> f64 {
    pooled(axes.iter().map(|axis| axis.error.rms))
}

/// Noise floor over all channels, in gauss.
pub fn floor_g(axes: &[FieldAxisErrors]) -> f64 {
    pooled(axes.iter().map(|axis| axis.floor.total))
}

/// Error over all forces, in newtons; NaN without forces.
pub fn rmse_n(forces: &[ForceAxisErrors]) -> f64 {
    pooled(forces.iter().map(|force| force.error.rms))
}

/// Verdict in one paragraph.
pub fn verdict(comparison: &Comparison) -> String {
    let (rms, floor) = (rms_g(&comparison.axes), floor_g(&comparison.axes));
    let newtons = match rmse_n(&comparison.forces) {
        n if n.is_finite() => format!(", {n:.2} N through the device's code"),
        _ => String::new(),
    };
    let span = pooled(comparison.axes.iter().map(|axis| axis.error.span));
    let error = format!("{} held out ({:.2} % of the range)", field(rms), 100.0 * rms / span);
    if floor <= 0.0 || floor.is_nan() {
        return format!(
            "Inconclusive: the noise of these recordings is unknown, so there is no floor to compare {error}{newtons} with."
        );
    }
    let worst =
        comparison.axes.iter().map(|axis| axis.error.rms / axis.floor.total).fold(0.0, f64::max);
    let chosen: Vec<&Attribution> = comparison.located.iter().filter(|l| l.chosen).collect();
    if rms <= AT_FLOOR * floor && worst <= AT_FLOOR * AT_FLOOR {
        if let Some(lead) = chosen.first() {
            return format!(
                "Within {:.0} % of the noise floor: {error}, the floor is {}{newtons}; {:.0} % of the remaining residual follows the {}.",
                100.0 * (rms / floor - 1.0),
                field(floor),
                100.0 * lead.share,
                lead.words
            );
        }
        return format!(
            "At the noise floor: {error}, the floor is {}{newtons}. These recordings show no missing effect.",
            field(floor)
        );
    }
    let located: f64 = chosen.iter().map(|l| l.share).sum();
    let unexplained = 1.0 - located;
    let lead = match chosen.first() {
        None => "no covariate explains the residual".to_owned(),
        Some(lead) => format!(
            "{}{}",
            follows(lead),
            match chosen.len() {
                1 => String::new(),
                _ => format!(
                    "; with {} it is {:.0} %",
                    chosen[1].words,
                    100.0 * (lead.share + chosen[1].share)
                ),
            }
        ),
    };
    let open = if unexplained >= MIN_SHARE && !chosen.is_empty() {
        format!(
            "; {:.0} % ({}) are explained by no covariate",
            100.0 * unexplained,
            field((unexplained * (rms * rms - floor * floor).max(0.0)).sqrt())
        )
    } else {
        String::new()
    };
    format!(
        "Structure remains: {error}, {:.1} times the floor of {}{newtons}; {lead}{open}.",
        rms / floor,
        field(floor)
    )
}

/// Verdict where a setup error stops the comparison.
pub fn stopped_verdict(findings: &[Finding]) -> String {
    let mut stop: Vec<&str> = findings.iter().filter(|f| f.stops).map(|f| f.id).collect();
    stop.dedup();
    let fix = if findings.iter().any(|finding| finding.fix.is_some()) {
        " (--fix NEW writes a copy of the recordings with all unambiguous repairs)"
    } else {
        ""
    };
    format!(
        "Not compared: fix {} first{fix}; until then the errors do not describe the model.",
        stop.join(", ")
    )
}

/// Caveat to the verdict where the data contain setup errors.
pub fn caveat(findings: &[Finding]) -> Option<String> {
    let mut ids: Vec<&str> = findings.iter().map(|finding| finding.id).collect();
    ids.retain(|id| *id != "constant_covariate");
    ids.dedup();
    (!ids.is_empty()).then(|| {
        format!(
            "The data contain {}; results below include it. Fix the data before judging the model.",
            ids.join(", ")
        )
    })
}

/// "48 % of the residual follows the opening, most of it below 12 mm".
pub fn follows(located: &Attribution) -> String {
    let share = 100.0 * located.share;
    if located.covariate == "constant" {
        return format!(
            "{share:.0} % of the residual is {}: another gripper, a displaced magnet, or a reference that was not zeroed",
            located.words
        );
    }
    let share = format!("{share:.0} % of the residual follows the {}", located.words);
    match concentrated(located) {
        Some(place) => format!("{share}, most of it {place}"),
        None => share,
    }
}

/// Range below or above a limit that contains most of the explained residual.
fn concentrated(located: &Attribution) -> Option<String> {
    let all: f64 = located.bins.iter().map(|bin| bin.share).sum();
    let (count, rows) =
        (located.bins.len(), located.bins.iter().map(|bin| bin.rows).sum::<usize>());
    if all <= 0.0 || count < 4 {
        return None;
    }
    let few = |bins: &[Bin]| {
        let share: f64 = bins.iter().map(|bin| bin.share).sum();
        let inside: usize = bins.iter().map(|bin| bin.rows).sum();
        share >= CONCENTRATED * all && (inside as f64) < MAX_ROWS * rows as f64
    };
    let number = |value: f64| match located.unit {
        "" => format!("{value:.0}"),
        unit => format!("{} {unit}", short(value)),
    };
    (1..count).find_map(|k| {
        if few(&located.bins[..k]) {
            return Some(format!("below {}", number(located.bins[k - 1].to)));
        }
        few(&located.bins[count - k..])
            .then(|| format!("above {}", number(located.bins[count - k].from)))
    })
}

/// A number to three digits.
pub fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// A field in gauss, or in milligauss below 0.1 G.
pub fn field(gauss: f64) -> String {
    match gauss.abs() {
        size if size < 0.1 => format!("{} mG", short(1e3 * gauss)),
        _ => format!("{gauss:.3} G"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::compare::Bin;

    fn located(shares: [f64; 6]) -> Attribution {
        let bin = |(i, share): (usize, &f64)| Bin {
            from: 4.0 * i as f64,
            to: 4.0 * i as f64 + 4.0,
            rows: 100,
            share: *share,
            ..Bin::default()
        };
        Attribution {
            covariate: "opening_mm".into(),
            words: "opening".into(),
            unit: "mm",
            share: 0.48,
            alone: 0.48,
            chosen: true,
            sensors: vec![0],
            bins: shares.iter().enumerate().map(bin).collect(),
        }
    }

    #[test]
    fn concentrated_residual_is_reported_with_its_limit() {
        assert_eq!(
            follows(&located([0.3, 0.1, 0.02, 0.02, 0.02, 0.02])),
            "48 % of the residual follows the opening, most of it below 4.00 mm"
        );
        assert_eq!(
            follows(&located([0.0, 0.0, 0.0, 0.01, 0.15, 0.35])),
            "48 % of the residual follows the opening, most of it above 20.0 mm"
        );
    }

    #[test]
    fn uniform_residual_has_no_limit() {
        assert_eq!(follows(&located([0.1; 6])), "48 % of the residual follows the opening");
    }
}
