//! Suggested next command.

use crate::diagnose::diagnosis::{Diagnosis, Suggestion, SuggestionKind};
use crate::diagnose::recording_differences;
use crate::diagnose::verdict::{Verdict, VerdictKind};
use model_export::effects::EffectTerm;
use model_export::model_file::{BaseKind, ModelFile};

/// Arguments of the diagnosis.
pub struct Invocation<'a> {
    /// The model's file.
    pub model: &'a str,
    /// The campaign's folder.
    pub campaign: &'a str,
    /// Delay of the reference's clock in milliseconds.
    pub delay_ms: f64,
    /// The delay in the model's file.
    pub fitted_ms: f64,
    /// The model's base.
    pub base: BaseKind,
    /// Whether the model was fitted to one of these recordings.
    pub is_fitted_here: bool,
    /// User-defined effects.
    pub own: &'a [EffectTerm],
}

/// Columns that a formula can use, in addition to the recorded ones: others that compare knows
/// are made of these.
const MADE: [&str; 8] = [
    "force_n",
    "fx_rate_n_per_s",
    "fz_rate_n_per_s",
    "loading_x",
    "loading_z",
    "temp_rate_c_per_min",
    "recording",
    "constant",
];

impl Diagnosis {
    /// Sets the suggested command; `own` are the user-defined effects.
    pub fn set_suggestion(
        &mut self,
        own: &[EffectTerm],
        model: &ModelFile,
        delay_ms: f64,
        is_fitted_here: bool,
    ) {
        let discovered = self.formulas.iter().chain(&self.equivalent_formulas);
        let discovered = discovered.flat_map(|formula| &formula.effects);
        let own: Vec<EffectTerm> = own.iter().chain(discovered).cloned().collect();
        self.next = suggest(
            self,
            &Invocation {
                model: &self.model,
                campaign: &self.campaign,
                delay_ms,
                fitted_ms: model.provenance.delay_ms,
                base: model.base,
                is_fitted_here,
                own: &own,
            },
        );
    }
}

/// Suggests the next command after a diagnosis.
pub fn suggest(diagnosis: &Diagnosis, typed: &Invocation) -> Suggestion {
    let command = |what: &str, rest: &[String]| {
        let mut words =
            ["cargo", "magpie", what, typed.model, typed.campaign].map(str::to_owned).to_vec();
        words.extend_from_slice(rest);
        if typed.delay_ms != typed.fitted_ms {
            words.extend(["--delay-ms".to_owned(), typed.delay_ms.to_string()]);
        }
        line(&words)
    };
    let fit = |campaign: &str, delay_ms: f64| {
        let mut words = ["cargo", "magpie", "fit", campaign].map(str::to_owned).to_vec();
        if delay_ms != 0.0 {
            words.extend(["--delay-ms".to_owned(), delay_ms.to_string()]);
        }
        if typed.base == BaseKind::Polynomial {
            words.extend(["--base", "polynomial"].map(str::to_owned));
        }
        if let Some(higher) = diagnosis.higher_degree {
            words.extend(["--degree".to_owned(), higher.degree.to_string()]);
        }
        words.extend(["-o".to_owned(), beside(typed.model, BETTER)]);
        line(&words)
    };
    let suggestion = |kind, commands| Suggestion { kind, commands };
    let report = || vec![command("compare", &["-o", "report.html"].map(str::to_owned))];
    let mut differences =
        diagnosis.findings.iter().filter(|finding| finding.id == recording_differences::ID);
    if let Some(first) = differences.next() {
        // Effects were sought on the recordings without it; as they are, they would be fitted with it.
        let is_fixed = first.fix.is_some() && differences.all(|other| other.fix.is_some());
        if !is_fixed {
            return suggestion(SuggestionKind::Compare, report());
        }
        let copy = format!("{}-corrected", typed.campaign.trim_end_matches('/'));
        let fit = fit(&copy, typed.delay_ms);
        let commands = vec![command("compare", &["--fix".to_owned(), copy]), fit];
        return suggestion(SuggestionKind::CorrectRecordings, commands);
    }
    if let Some(skew_ms) = clock_skew_ms(diagnosis) {
        // The device cannot compensate it; with the clocks aligned, the other effects are found again.
        let delay_ms = ((typed.delay_ms + skew_ms) * 1e2).round() / 1e2;
        return suggestion(SuggestionKind::AlignClocks, vec![fit(typed.campaign, delay_ms)]);
    }
    if diagnosis.higher_degree.is_some() {
        // What the polynomial leaves of the forces hides effects, or imitates them.
        return suggestion(SuggestionKind::RaiseDegree, vec![fit(typed.campaign, typed.delay_ms)]);
    }
    if let Some(sets) = sets(&diagnosis.accepted) {
        let equivalent_formulas =
            diagnosis.equivalent_formulas.iter().flat_map(|formula| &formula.effects);
        let equivalent_formulas: Vec<String> =
            equivalent_formulas.map(|effect| effect.name().to_owned()).collect();
        let equivalent_formulas = (!equivalent_formulas.is_empty())
            .then(|| equivalent_formulas.iter().map(String::as_str).collect());
        let sets: Vec<&Vec<&str>> = sets.iter().chain(&equivalent_formulas).collect();
        let add = |(place, set): (usize, &&Vec<&str>)| {
            let mut rest = named(set, typed.own);
            // Each of several choices has a file of its own: none replaces another.
            let choice =
                if sets.len() > 1 { format!("better-{}", place + 1) } else { BETTER.into() };
            rest.extend(["-o".to_owned(), beside(typed.model, &choice)]);
            command("add", &rest)
        };
        let commands: Vec<String> = sets.iter().enumerate().map(add).collect();
        let kind = match commands.len() {
            1 => SuggestionKind::AddEffects,
            _ => SuggestionKind::ChooseEffect,
        };
        return suggestion(kind, commands);
    }
    if !diagnosis.formulas.is_empty() {
        // Structure remains, but what was found is a model to go on from.
        let mut rest = named(&found_terms(diagnosis), typed.own);
        rest.extend(["-o".to_owned(), beside(typed.model, BETTER)]);
        return suggestion(SuggestionKind::AddEffects, vec![command("add", &rest)]);
    }
    let usable = |covariate: &&str| !MADE.contains(covariate);
    let covariates = diagnosis.unexplained.iter().map(|u| u.covariate.as_str());
    if diagnosis.at_floor && typed.base == BaseKind::Cylinder && !typed.is_fitted_here {
        return suggestion(SuggestionKind::Replay, vec![command("replay", &[])]);
    }
    if diagnosis.at_floor && typed.base == BaseKind::Cylinder {
        let words =
            ["cargo", "magpie", "dev", "export", typed.model, "-o", "tables.rs"].map(str::to_owned);
        return suggestion(SuggestionKind::Export, vec![line(&words)]);
    }
    match (diagnosis.unexplained.is_empty(), covariates.clone().find(usable)) {
        (false, Some(covariate)) => suggestion(
            SuggestionKind::TestFormula,
            vec![command("diagnose", &["--expr".to_owned(), guess(covariate, typed.base)])],
        ),
        _ => suggestion(SuggestionKind::Compare, report()),
    }
}

/// The offset of the clocks in milliseconds, where it was found and no other effect explains the same.
fn clock_skew_ms(diagnosis: &Diagnosis) -> Option<f64> {
    let skew =
        |verdict: &&Verdict| verdict.effect == "clock_skew" && verdict.kind == VerdictKind::Found;
    let found = diagnosis.verdicts.iter().find(skew)?;
    found.value.is_finite().then_some(found.value)
}

/// What to add together: what was found with, for the first tie, each of its members.
fn sets(accepted: &[Vec<String>]) -> Option<Vec<Vec<&str>>> {
    let tie = accepted.iter().position(|step| step.len() > 1);
    let count = tie.map_or(accepted.len().min(1), |tie| accepted[tie].len());
    let set = |member: usize| {
        let steps = accepted.iter().enumerate();
        let of_step = |(i, step): (usize, &'_ Vec<String>)| {
            if Some(i) == tie { member.min(step.len().saturating_sub(1)) } else { 0 }
        };
        let places: Vec<usize> = steps.map(of_step).collect();
        let pairs = accepted.iter().zip(places);
        pairs.filter_map(|(step, place)| step.get(place).map(String::as_str)).collect()
    };
    (count > 0).then(|| (0..count).map(set).collect())
}

/// The effects of all steps: the first of equivalent ones, and all of a formula.
fn found_terms(diagnosis: &Diagnosis) -> Vec<&str> {
    let of_formulas =
        diagnosis.formulas.iter().flat_map(|formula| formula.effects.iter().map(|of| of.name()));
    let steps = diagnosis.staircase.iter().filter_map(|step| step.added.first());
    let is_formula = |name: &str| diagnosis.formulas.iter().any(|formula| formula.name == name);
    steps.map(String::as_str).filter(|name| !is_formula(name)).chain(of_formulas).collect()
}

/// Effects as `add` takes them: names of the catalogue first, then formulas with their ranges.
fn named(set: &[&str], own: &[EffectTerm]) -> Vec<String> {
    let formula = |name: &str| {
        own.iter().find_map(|addition| match addition {
            EffectTerm::Expression(expression) if expression.name == name => Some(expression),
            _ => None,
        })
    };
    let (mut names, mut formulas) = (Vec::new(), Vec::new());
    for name in set {
        let Some(expression) = formula(name) else {
            names.push((*name).to_owned());
            continue;
        };
        formulas.extend(["--expr".to_owned(), expression.text.clone()]);
        for range in &expression.ranges {
            let ends = format!("{}={}..{}", range.name, range.from, range.to);
            // A command has one range for each name.
            if !formulas.contains(&ends) {
                formulas.extend(["--range".to_owned(), ends]);
            }
        }
    }
    names.extend(formulas);
    names
}

/// A first formula over a covariate: it turns with an angle, and bends over everything else.
fn guess(covariate: &str, base: BaseKind) -> String {
    let target = match base {
        BaseKind::Cylinder => "dz_um",
        BaseKind::Polynomial => "by_g",
    };
    if covariate.ends_with("_rad") {
        format!("own: {target} = a*sin({covariate}) + b*cos({covariate})")
    } else {
        format!("own: {target} = a*{covariate} + b*{covariate}^2")
    }
}

/// Ending of the name of a better model.
const BETTER: &str = "better";

/// A new file name, so that the old model is preserved.
fn beside(model: &str, ending: &str) -> String {
    let stem = model.strip_suffix(".toml").unwrap_or(model);
    format!("{stem}-{ending}.toml")
}

/// One line for a shell.
fn line(words: &[String]) -> String {
    shell_words::join(words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::formulas::discovered::DiscoveredFormula;
    use crate::diagnose::verdict::{Reason, Unexplained};
    use model_export::effects::expression::Expression;

    const TYPED: Invocation = Invocation {
        model: "m.toml",
        campaign: "my campaign",
        delay_ms: 0.0,
        fitted_ms: 0.0,
        base: BaseKind::Cylinder,
        is_fitted_here: true,
        own: &[],
    };

    fn accepted(steps: &[&[&str]]) -> Diagnosis {
        let step = |names: &&[&str]| names.iter().map(|&name| name.to_owned()).collect();
        Diagnosis { accepted: steps.iter().map(step).collect(), ..Diagnosis::default() }
    }

    #[test]
    fn found_effects_are_added_together() {
        let next = suggest(&accepted(&[&["hysteresis"], &["creep"]]), &TYPED);
        assert_eq!(
            next.commands,
            ["cargo magpie add m.toml 'my campaign' hysteresis creep -o m-better.toml"]
        );
    }

    fn clock_skew(kind: VerdictKind) -> Verdict {
        Verdict {
            effect: "clock_skew".to_owned(),
            kind,
            provisional: false,
            tied_with: Vec::new(),
            inclusion: f64::NAN,
            reproduces: Vec::new(),
            excess_n: None,
            gain: 0.9,
            p_adjusted: 0.002,
            value: 10.104,
            std_error: 0.05,
            differs: None,
            unit: "ms".to_owned(),
            z_typical: 100.0,
            implausible: None,
            reason: Reason::ReducesError,
            record: String::new(),
        }
    }

    #[test]
    fn clocks_are_aligned_before_effects_are_added() {
        let found = Diagnosis {
            verdicts: vec![clock_skew(VerdictKind::Found)],
            ..accepted(&[&["clock_skew"], &["creep"]])
        };
        let next = suggest(&found, &Invocation { delay_ms: 300.0, ..TYPED });
        assert_eq!(next.kind, SuggestionKind::AlignClocks);
        let command = "cargo magpie fit 'my campaign' --delay-ms 310.1 -o m-better.toml";
        assert_eq!(next.commands, [command]);
        // Where another effect explains the same, the clocks may be right.
        let tied = Diagnosis {
            verdicts: vec![clock_skew(VerdictKind::Tied)],
            ..accepted(&[&["clock_skew", "viscous_lag"]])
        };
        assert_eq!(suggest(&tied, &TYPED).kind, SuggestionKind::ChooseEffect);
    }

    #[test]
    fn a_model_of_other_recordings_is_not_exported() {
        let diagnosis = Diagnosis { at_floor: true, ..Diagnosis::default() };
        assert_eq!(suggest(&diagnosis, &TYPED).kind, SuggestionKind::Export);
        let next = suggest(&diagnosis, &Invocation { is_fitted_here: false, ..TYPED });
        assert_eq!(next.kind, SuggestionKind::Replay);
        assert_eq!(next.commands, ["cargo magpie replay m.toml 'my campaign'"]);
    }

    #[test]
    fn each_equivalent_effect_gets_a_command() {
        let typed = Invocation { delay_ms: -2.5, ..TYPED };
        let tied = accepted(&[&["magnet_temperature", "thermal_gap"], &["creep"]]);
        assert_eq!(
            suggest(&tied, &typed).commands,
            [
                "cargo magpie add m.toml 'my campaign' magnet_temperature creep -o m-better-1.toml --delay-ms -2.5",
                "cargo magpie add m.toml 'my campaign' thermal_gap creep -o m-better-2.toml --delay-ms -2.5",
            ]
        );
        assert_eq!(suggest(&tied, &typed).kind, SuggestionKind::ChooseEffect);
        let fitted = suggest(&tied, &Invocation { fitted_ms: -2.5, ..typed });
        assert!(!fitted.commands[0].contains("--delay-ms"), "{fitted:?}");
    }

    #[test]
    fn a_formula_that_explains_as_much_gets_a_command() {
        let text = "formula_1: dx_um = a*opening_mm";
        let parsed = Expression::parse(text, &[], &["opening_mm".to_owned()]).unwrap();
        let effect = EffectTerm::Expression(std::sync::Arc::new(parsed));
        let equivalent = DiscoveredFormula {
            name: "formula_1".to_owned(),
            effects: vec![effect.clone()],
            covariates: Vec::new(),
            targets: Vec::new(),
            models: Vec::new(),
            gain: 0.9,
            p_value: 0.002,
            other_targets: None,
        };
        let diagnosis = Diagnosis {
            equivalent_formulas: vec![equivalent],
            ..accepted(&[&["sensor_temperature"]])
        };
        let next = suggest(&diagnosis, &Invocation { own: &[effect], ..TYPED });
        assert_eq!(next.kind, SuggestionKind::ChooseEffect);
        assert_eq!(
            next.commands[1],
            "cargo magpie add m.toml 'my campaign' --expr 'formula_1: dx_um = a*opening_mm' -o m-better-2.toml"
        );
    }

    #[test]
    fn unexplained_residual_suggests_a_recorded_column() {
        let follows = |covariate: &str| Unexplained {
            covariate: covariate.to_owned(),
            words: String::new(),
            share: 0.5,
        };
        let diagnosis = Diagnosis {
            unexplained: vec![follows("loading_x"), follows("motor_angle_rad")],
            ..Diagnosis::default()
        };
        assert_eq!(
            suggest(&diagnosis, &TYPED).commands,
            [
                "cargo magpie diagnose m.toml 'my campaign' --expr 'own: dz_um = a*sin(motor_angle_rad) + b*cos(motor_angle_rad)'"
            ]
        );
    }

    #[test]
    fn export_is_suggested_at_the_noise_floor() {
        let diagnosis = Diagnosis { at_floor: true, ..Diagnosis::default() };
        assert_eq!(
            suggest(&diagnosis, &TYPED).commands,
            ["cargo magpie dev export m.toml -o tables.rs"]
        );
    }
}
