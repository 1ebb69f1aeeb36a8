//! Dictionary of terms: functions of one covariate, and products of two.

use std::collections::BTreeMap;
use std::sync::Arc;

use model_export::effects::ExcitationSeries;
use model_export::effects::excitation::BUILT_IN_COVARIATES;
use model_export::fit::campaign::FitSetup;
use model_export::recordings::columns::Axis;
use model_export::stop;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::diagnose::formulas::atoms::{Atom, Span, atoms_of, force_of_another};
use crate::diagnose::formulas::candidate::{COEFFICIENTS, Candidate};
use crate::diagnose::formulas::chain_points::ChainPoint;
use crate::diagnose::formulas::rows::{Windows, averaged, excitations};

/// The forces; functions of searched period are multiplied with them only.
const FORCES: [&str; 2] = ["fx_n", "fz_n"];

/// Numbers in a line of the processor's cache.
const CACHE_LINE: usize = 8;

/// Terms with their values.
pub struct Dictionary {
    atoms: Vec<Atom>,
    /// Indices of the factors of each term.
    terms: Vec<Vec<usize>>,
    /// Term with the other phase.
    partners: Vec<Option<usize>>,
    /// Forces of one axis on all sensors, which act on the other ones together.
    of_others: Vec<Vec<usize>>,
    /// A row for each term and a column for each averaged row, of each sensor.
    values: Vec<DMatrix<f64>>,
}

/// A candidate of terms of the dictionary.
pub struct RankedCandidate {
    pub candidate: Candidate,
    /// Indices of its terms.
    pub terms: Vec<usize>,
}

impl Dictionary {
    /// Over these covariates, with these harmonics of the rotor's turn.
    pub fn new(
        setup: &FitSetup,
        covariates: &[String],
        harmonics: &[u32],
        windows: &[Vec<Windows>],
    ) -> Self {
        let tracks = setup.rows.iter().flat_map(|rows| rows.parts.iter().map(|part| &part.track));
        let durations = tracks.filter_map(|track| {
            Some(track.time_s.last().copied()? - track.time_s.first().copied()?)
        });
        let longest_s = durations.fold(0.0, f64::max);
        let mut atoms: Vec<Atom> = covariates
            .iter()
            .filter_map(|covariate| {
                let all = (0..setup.rows.len()).flat_map(|sensor| excitations(setup, sensor));
                let values = all.filter_map(|series| series.covariate(covariate)).flatten();
                Some(atoms_of(covariate, Span::of(values.collect())?, harmonics, longest_s))
            })
            .flatten()
            .collect();
        let sensors = 0..setup.rows.len();
        // Of the gripper's covariates every sensor has the same values, where it has the same rows.
        let has_rows_of_first = |sensor: usize| {
            let (own, first) = (excitations(setup, sensor), excitations(setup, 0));
            own.zip(first).all(|(own, first)| own.time_s == first.time_s)
        };
        let same: Vec<bool> = sensors.clone().map(has_rows_of_first).collect();
        let is_shared = |sensor: usize, covariate: &str| {
            sensor > 0 && same[sensor] && !BUILT_IN_COVARIATES.contains(&covariate)
        };
        let evaluate = |atom: &Atom, sensor: usize| -> Option<Vec<f64>> {
            let parts: Option<Vec<Vec<f64>>> =
                excitations(setup, sensor).map(|series| atom.values(series)).collect();
            parts.map(|parts| parts.concat())
        };
        let columns: Vec<Option<Vec<Arc<Vec<f64>>>>> = atoms
            .par_iter()
            .map(|atom| {
                stop::check();
                let first = Arc::new(evaluate(atom, 0)?);
                let of_sensor = |sensor: usize| {
                    if sensor == 0 || is_shared(sensor, &atom.covariate) {
                        Some(first.clone())
                    } else {
                        evaluate(atom, sensor).map(Arc::new)
                    }
                };
                sensors.clone().map(of_sensor).collect()
            })
            .collect();
        // What is undefined somewhere is left out.
        let mut defined = columns.iter().map(Option::is_some);
        atoms.retain(|_| defined.next().unwrap_or(false));
        let columns: Vec<Vec<Arc<Vec<f64>>>> = columns.into_iter().flatten().collect();
        let mut terms = terms(&atoms);
        if setup.design.is_none() {
            // A polynomial of the forces contains these: they are a matter of its degree.
            let is_force = |factor: &usize| FORCES.contains(&atoms[*factor].covariate.as_str());
            terms.retain(|term| !term.iter().all(is_force));
        }
        let index: BTreeMap<String, usize> =
            terms.iter().enumerate().map(|(i, term)| (text(&atoms, term), i)).collect();
        let partners = terms.iter().map(|term| index.get(&partner_text(&atoms, term)?).copied());
        let partners = partners.collect();
        let of_axis = |axis: Axis| -> Vec<usize> {
            let is_own = |term: &&[usize]| match term {
                [one] => force_of_another(&atoms[*one].covariate) == Some(axis),
                _ => false,
            };
            let all = terms.iter().map(Vec::as_slice).enumerate();
            all.filter(|(_, term)| is_own(term)).map(|(place, _)| place).collect()
        };
        let of_others = [Axis::X, Axis::Z].map(of_axis).into_iter();
        let of_others = of_others.filter(|all| (2..=COEFFICIENTS.len()).contains(&all.len()));
        let of_others = of_others.collect();
        let lengths: Vec<Vec<usize>> = sensors
            .clone()
            .map(|sensor| excitations(setup, sensor).map(ExcitationSeries::len).collect())
            .collect();
        let rows: Vec<Vec<Arc<Vec<f64>>>> = terms
            .par_iter()
            .map(|term| {
                stop::check();
                let of_sensor = |sensor: usize| {
                    let mut product = vec![1.0; lengths[sensor].iter().sum()];
                    for factor in term {
                        product
                            .iter_mut()
                            .zip(columns[*factor][sensor].iter())
                            .for_each(|(product, value)| *product *= value);
                    }
                    Arc::new(normalised(&product, &lengths[sensor], &windows[sensor]))
                };
                let first = of_sensor(0);
                let all_shared = |sensor: usize| {
                    sensor == 0
                        || term.iter().all(|factor| is_shared(sensor, &atoms[*factor].covariate))
                };
                let or_first = |sensor: usize| {
                    if all_shared(sensor) { first.clone() } else { of_sensor(sensor) }
                };
                sensors.clone().map(or_first).collect()
            })
            .collect();
        let values = sensors
            .into_par_iter()
            .map(|sensor| {
                let count = rows.first().map_or(0, |row| row[sensor].len());
                let mut values = DMatrix::zeros(rows.len(), count);
                // By blocks, since both sides are read in order within a cache line only.
                for start in (0..count).step_by(CACHE_LINE) {
                    for (term, row) in rows.iter().enumerate() {
                        let block = row[sensor].iter().enumerate().skip(start).take(CACHE_LINE);
                        block.for_each(|(column, value)| values[(term, column)] = *value);
                    }
                }
                values
            })
            .collect();
        Self { atoms, terms, partners, of_others, values }
    }

    /// Values of the terms at each sensor.
    pub fn values(&self) -> &[DMatrix<f64>] {
        &self.values
    }

    pub fn values_of(&self, sensor: usize, terms: &[usize]) -> Vec<Vec<f64>> {
        let row = |term: &usize| self.values[sensor].row(*term).iter().copied().collect();
        terms.iter().map(row).collect()
    }

    /// Candidates with the largest gains: the best `count` of each class of complexity and number of columns. The gain of
    /// several columns is estimated by the sum of theirs.
    pub fn ranked(
        &self,
        gains: &[DMatrix<f64>],
        points: &[ChainPoint],
        count: usize,
    ) -> Vec<RankedCandidate> {
        let Some(sum) = gains.iter().cloned().reduce(|sum, gain| sum + gain) else {
            return Vec::new();
        };
        let mut sets: Vec<Vec<usize>> = (0..points.len()).map(|point| vec![point]).collect();
        for vector in ChainPoint::vectors(points) {
            let place = |point: &ChainPoint| points.iter().position(|own| own == point);
            sets.push(vector.iter().filter_map(place).collect());
        }
        let mut all: Vec<(f64, Vec<usize>, &[usize])> = Vec::new();
        for set in &sets {
            for term in 0..self.terms.len() {
                let gain = |term: usize| set.iter().map(|point| sum[(term, *point)]).sum::<f64>();
                let own = gain(term);
                all.push((own, vec![term], set));
                if let Some(partner) = self.partners[term].filter(|partner| *partner > term) {
                    all.push((own + gain(partner), vec![term, partner], set));
                }
            }
            for together in &self.of_others {
                let gain =
                    together.iter().flat_map(|term| set.iter().map(|point| sum[(*term, *point)]));
                all.push((gain.sum(), together.clone(), set));
            }
        }
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut taken = [[0; 3]; 4];
        let mut ranked = Vec::new();
        for (gain, terms, set) in all {
            let complexity: f64 =
                terms.iter().map(|term| self.complexity(*term)).fold(0.0, f64::max);
            let class = match complexity {
                c if c < 1.25 => 0,
                c if c < 1.65 => 1,
                c if c < 2.5 => 2,
                _ => 3,
            };
            let columns = match terms.len() * set.len() {
                1 => 0,
                2 | 3 => 1,
                _ => 2,
            };
            if gain <= 0.0 || taken[class][columns] >= count {
                continue;
            }
            taken[class][columns] += 1;
            let candidate = Candidate {
                terms: terms.iter().map(|term| self.factors(*term)).collect(),
                points: set.iter().map(|point| points[*point]).collect(),
                own: Vec::new(),
            };
            ranked.push(RankedCandidate { candidate, terms });
        }
        ranked
    }

    /// The harmonics of the covariate of a candidate, which is one or several of them, as further pairs of terms.
    pub fn further_harmonics(&self, candidate: &Candidate) -> Vec<[Vec<Atom>; 2]> {
        let is_harmonic = |term: &Vec<Atom>| matches!(&term[..], [one] if one.parameters.is_empty() && one.partner().is_some());
        let Some([first]) = candidate.terms.first().map(Vec::as_slice) else { return Vec::new() };
        if !candidate.terms.iter().all(is_harmonic) {
            return Vec::new();
        }
        let pair = |term: usize| {
            let partner = self.partners[term].filter(|partner| *partner > term)?;
            let pair = [self.factors(term), self.factors(partner)];
            let is_new = pair.iter().all(|own| {
                is_harmonic(own)
                    && own[0].covariate == first.covariate
                    && !candidate.terms.contains(own)
            });
            is_new.then_some(pair)
        };
        (0..self.terms.len()).filter_map(pair).collect()
    }

    fn factors(&self, term: usize) -> Vec<Atom> {
        self.terms[term].iter().map(|factor| self.atoms[*factor].clone()).collect()
    }

    fn complexity(&self, term: usize) -> f64 {
        self.terms[term].iter().map(|factor| self.atoms[*factor].complexity).sum()
    }
}

/// Single functions, and products of functions of two covariates.
fn terms(atoms: &[Atom]) -> Vec<Vec<usize>> {
    let mut terms: Vec<Vec<usize>> = (0..atoms.len()).map(|atom| vec![atom]).collect();
    for (i, one) in atoms.iter().enumerate() {
        for (j, other) in atoms.iter().enumerate().skip(i + 1) {
            let searched = |periodic: &Atom, factor: &Atom| {
                periodic.partner().is_some()
                    && !periodic.parameters.is_empty()
                    && FORCES.contains(&factor.covariate.as_str())
                    && factor.complexity == 1.0
            };
            let both = one.is_factor && other.is_factor;
            let is_product = both || searched(one, other) || searched(other, one);
            if one.covariate != other.covariate && is_product {
                terms.push(vec![i, j]);
            }
        }
    }
    terms
}

/// Unique text of a term, for the search of partners.
fn text(atoms: &[Atom], term: &[usize]) -> String {
    let factors: Vec<String> =
        term.iter().map(|factor| atoms[*factor].text(&mut std::iter::empty())).collect();
    factors.join("*")
}

/// Text of the term with the other phase of its first harmonic.
fn partner_text(atoms: &[Atom], term: &[usize]) -> Option<String> {
    let mut found = false;
    let factors: Vec<String> = term
        .iter()
        .map(|factor| {
            let atom = &atoms[*factor];
            let partner = if found { None } else { atom.partner() };
            found |= partner.is_some();
            partner.as_ref().unwrap_or(atom).text(&mut std::iter::empty())
        })
        .collect();
    found.then(|| factors.join("*"))
}

/// Means over the windows of each recording, with unit mean square.
fn normalised(values: &[f64], lengths: &[usize], windows: &[Windows]) -> Vec<f64> {
    let mut means = Vec::new();
    let mut first = 0;
    for (length, windows) in lengths.iter().zip(windows) {
        means.extend(averaged(&values[first..first + length], windows));
        first += length;
    }
    let squares: f64 = means.iter().map(|mean| mean * mean).sum();
    let scale = (squares / means.len().max(1) as f64).sqrt();
    if scale > 0.0 {
        means.iter_mut().for_each(|mean| *mean /= scale);
    }
    means
}
