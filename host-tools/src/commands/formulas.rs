//! Effects of a person's own, as commands take them.

use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use model_export::effects::expression::Range;
use model_export::effects::{Addition, Expression};
use model_export::recordings::Campaign;

/// Formulas and the ranges of their nonlinear parameters.
#[derive(Debug, clap::Args)]
pub struct Formulas {
    /// An effect of your own: 'NAME: TARGET = FORMULA'.
    #[arg(long, value_name = "FORMULA")]
    expr: Vec<String>,
    /// Range of a nonlinear parameter in the formulas: NAME=FROM..TO.
    #[arg(long, value_name = "NAME=FROM..TO", value_parser = range)]
    range: Vec<Range>,
}

fn range(text: &str) -> Result<Range, String> {
    let advice = || "write NAME=FROM..TO, as in p=2..5".to_owned();
    let (name, ends) = text.split_once('=').ok_or_else(advice)?;
    let (from, to) = ends.split_once("..").ok_or_else(advice)?;
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| advice());
    Ok(Range {
        name: name.trim().to_owned(),
        from: number(from)?,
        to: number(to)?,
    })
}

impl Formulas {
    /// True where none was given.
    pub fn is_empty(&self) -> bool {
        self.expr.is_empty()
    }

    /// Reads them; each takes the ranges that it names.
    pub fn read(&self, campaign: &Campaign) -> Result<Vec<Addition>> {
        formulas(&self.expr, &self.range, campaign)
    }
}

fn formulas(texts: &[String], ranges: &[Range], campaign: &Campaign) -> Result<Vec<Addition>> {
    let first = campaign
        .recordings
        .first()
        .context("the campaign is empty")?;
    let columns: Vec<String> = first.covariates.keys().cloned().collect();
    let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
    for range in ranges {
        if !texts
            .iter()
            .any(|text| text.split(word).any(|name| name == range.name))
        {
            bail!("--range {}: no formula has such a name", range.name);
        }
    }
    let read = |text: &String| {
        let own: Vec<Range> = ranges
            .iter()
            .filter(|range| text.split(word).any(|name| name == range.name))
            .cloned()
            .collect();
        let formula =
            Expression::parse(text, &own, &columns).map_err(|error| anyhow!("--expr: {error}"))?;
        Ok(Addition::Expression(Arc::new(formula)))
    };
    texts.iter().map(read).collect()
}
