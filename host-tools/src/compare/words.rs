//! What the numbers say, in words.

use super::locate::WORTH;
use super::{AxisFigures, Comparison, Finding, ForceFigures, Located};

/// Up to this many times the floor nothing that is left can be told from noise.
pub const AT_FLOOR: f64 = 1.15;

/// Share of what a covariate locates that counts as most of it.
const MOST: f64 = 0.6;
/// It is worth saying where only if those bins are fewer than this share of all.
const FEW: f64 = 0.45;

/// Root of the mean square over channels.
fn pooled(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, n), value| (sum + value * value, n + 1.0));
    match count > 0.0 {
        true => f64::sqrt(sum / count),
        false => f64::NAN,
    }
}

/// Held-out error over all channels, in gauss.
pub fn rms_g(axes: &[AxisFigures]) -> f64 {
    pooled(axes.iter().map(|axis| axis.error.rms))
}

/// Floor over all channels, in gauss.
pub fn floor_g(axes: &[AxisFigures]) -> f64 {
    pooled(axes.iter().map(|axis| axis.floor.total))
}

/// Error over all forces, in newtons; NaN without forces.
pub fn rmse_n(forces: &[ForceFigures]) -> f64 {
    pooled(forces.iter().map(|force| force.error.rms))
}

/// The one line.
pub fn verdict(comparison: &Comparison) -> String {
    let (rms, floor) = (rms_g(&comparison.axes), floor_g(&comparison.axes));
    let newtons = match rmse_n(&comparison.forces) {
        n if n.is_finite() => format!(", {n:.2} N through the device's code"),
        _ => String::new(),
    };
    let span = pooled(comparison.axes.iter().map(|axis| axis.error.span));
    let error = format!(
        "{} held out ({:.2} % of the range)",
        field(rms),
        100.0 * rms / span
    );
    if floor <= 0.0 || floor.is_nan() {
        return format!(
            "Cannot be judged: these recordings show no noise to hold {error}{newtons} against."
        );
    }
    let worst = comparison
        .axes
        .iter()
        .map(|axis| axis.error.rms / axis.floor.total)
        .fold(0.0, f64::max);
    let chosen: Vec<&Located> = comparison.located.iter().filter(|l| l.chosen).collect();
    if rms <= AT_FLOOR * floor && worst <= AT_FLOOR * AT_FLOOR {
        if let Some(lead) = chosen.first() {
            return format!(
                "Within {:.0} % of the noise floor: {error}, the floor is {}{newtons}; of the little that is left {:.0} % follows the {}.",
                100.0 * (rms / floor - 1.0),
                field(floor),
                100.0 * lead.share,
                lead.words
            );
        }
        return format!(
            "At the noise floor: {error}, the floor is {}{newtons}. These recordings show nothing that the model lacks.",
            field(floor)
        );
    }
    let located: f64 = chosen.iter().map(|l| l.share).sum();
    let rest = 1.0 - located;
    let lead = match chosen.first() {
        None => "no covariate locates what is left".to_owned(),
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
    let open = match rest >= WORTH && !chosen.is_empty() {
        true => format!(
            "; {:.0} % ({}) follow none of the covariates",
            100.0 * rest,
            field((rest * (rms * rms - floor * floor).max(0.0)).sqrt())
        ),
        false => String::new(),
    };
    format!(
        "Structure remains: {error}, {:.1} times the floor of {}{newtons}; {lead}{open}.",
        rms / floor,
        field(floor)
    )
}

/// The one line where a mistake of the rig stops the comparison.
pub fn stopped(findings: &[Finding]) -> String {
    let mut stop: Vec<&str> = findings.iter().filter(|f| f.stops).map(|f| f.id).collect();
    stop.dedup();
    let fix = match findings.iter().any(|finding| finding.fix.is_some()) {
        true => " (--fix NEW writes the recordings anew with what can be mended without doubt)",
        false => "",
    };
    format!(
        "Not compared: {} must be mended first{fix}; until then no figure would be about the model.",
        stop.join(", ")
    )
}

/// What must be said beside a verdict whose figures a mistake of the rig may have made.
pub fn doubt(findings: &[Finding]) -> Option<String> {
    let mut doubtful: Vec<&str> = findings.iter().map(|finding| finding.id).collect();
    doubtful.retain(|id| *id != "constant_covariate");
    doubtful.dedup();
    (!doubtful.is_empty()).then(|| {
        format!(
            "In the recordings stands {}, which is in these figures: mend it before the model is blamed.",
            doubtful.join(", ")
        )
    })
}

/// "48 % of what is left follows the opening, most of it below 12 mm".
pub fn follows(located: &Located) -> String {
    let share = 100.0 * located.share;
    if located.covariate == "constant" {
        return format!(
            "{share:.0} % of what is left is {}: another gripper, a magnet displaced, or a reference not zeroed",
            located.words
        );
    }
    let share = format!("{share:.0} % of what is left follows the {}", located.words);
    match concentrated(located) {
        Some(place) => format!("{share}, most of it {place}"),
        None => share,
    }
}

/// The side on which a covariate locates most, where it is one.
fn concentrated(located: &Located) -> Option<String> {
    let all: f64 = located.bins.iter().map(|bin| bin.share).sum();
    let (count, rows) = (
        located.bins.len(),
        located.bins.iter().map(|bin| bin.rows).sum::<usize>(),
    );
    if all <= 0.0 || count < 4 {
        return None;
    }
    let few = |bins: &[super::Bin]| {
        let share: f64 = bins.iter().map(|bin| bin.share).sum();
        let inside: usize = bins.iter().map(|bin| bin.rows).sum();
        share >= MOST * all && (inside as f64) < FEW * rows as f64
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

/// A number to about three digits.
pub fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// A field in gauss, or in smaller units where it is small.
pub fn field(gauss: f64) -> String {
    match gauss.abs() {
        size if size < 0.1 => format!("{} mG", short(1e3 * gauss)),
        _ => format!("{gauss:.3} G"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::Bin;

    fn located(shares: [f64; 6]) -> Located {
        let bin = |(i, share): (usize, &f64)| Bin {
            from: 4.0 * i as f64,
            to: 4.0 * i as f64 + 4.0,
            rows: 100,
            share: *share,
            ..Bin::default()
        };
        Located {
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
    fn what_lies_on_one_side_is_said_with_its_limit() {
        assert_eq!(
            follows(&located([0.3, 0.1, 0.02, 0.02, 0.02, 0.02])),
            "48 % of what is left follows the opening, most of it below 4.00 mm"
        );
        assert_eq!(
            follows(&located([0.0, 0.0, 0.0, 0.01, 0.15, 0.35])),
            "48 % of what is left follows the opening, most of it above 20.0 mm"
        );
    }

    #[test]
    fn what_lies_everywhere_has_no_side() {
        assert_eq!(
            follows(&located([0.1; 6])),
            "48 % of what is left follows the opening"
        );
    }
}
