//! Curves for the page's script in 16-bit fixed point, reduced to a maximum size.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

use analysis::compare::{Comparison, Envelope, Trace};

/// Total number of values in a page: at 8/3 characters each they take 2.7 MB of the 5 MB that
/// e-mail allows.
const NUMBERS: usize = 1_000_000;
/// Overhead of half a curve in values.
const AROUND: usize = 16;
/// Minimum number of stretches of a curve.
const FEWEST: usize = 30;
/// Minimum number of stretches of the curves with the largest errors, which are
/// zoomed into.
const WORST: usize = 1000;
/// Code of NaN.
const HOLE: u16 = u16::MAX;

#[derive(Debug, Serialize)]
pub struct Pack {
    traces: Vec<PackedTrace>,
}

#[derive(Debug, Serialize)]
struct PackedTrace {
    recording: String,
    sensor: u32,
    times: Vec<Codes>,
    panels: Vec<Panel>,
}

#[derive(Debug, Serialize)]
struct Panel {
    kind: &'static str,
    name: &'static str,
    unit: &'static str,
    sign: &'static str,
    lines: Vec<Line>,
    left: Vec<Line>,
}

/// Envelope: `role` 0 measured, 1 first model, 2 second model.
#[derive(Debug, Serialize)]
struct Line {
    role: usize,
    time: usize,
    low: Codes,
    /// `None` where every stretch is one value.
    #[serde(skip_serializing_if = "Option::is_none")]
    high: Option<Codes>,
}

/// 16-bit little-endian codes in base 64, with the values of the first and the last valid
/// code.
#[derive(Debug, Serialize)]
struct Codes(f32, f32, String);

impl Codes {
    fn of(values: &[f64]) -> Self {
        let (from, to) = super::plot::bounds(values.iter().copied()).unwrap_or((0.0, 0.0));
        // Rounded as written to the page.
        let (from, to) = (from as f32, to as f32);
        let (start, span) = (f64::from(from), f64::from(to) - f64::from(from));
        let most = f64::from(HOLE - 1);
        let code = |value: &f64| match value.is_finite() {
            true if span > 0.0 => ((value - start) / span * most).round().clamp(0.0, most) as u16,
            true => 0,
            false => HOLE,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|v| code(v).to_le_bytes()).collect();
        Self(from, to, STANDARD.encode(bytes))
    }
}

/// Difference of two curves. Exact where a stretch is one row; for longer stretches the difference of the
/// minima and that of the maxima: these occur at about the same rows, so that a steep stretch
/// does not appear as an error.
fn difference(one: &Envelope, other: &Envelope) -> Envelope {
    let pairs = |of: fn(f64, f64) -> f64| {
        let low = one.low.iter().zip(&other.low).map(|(a, b)| a - b);
        let high = one.high.iter().zip(&other.high).map(|(a, b)| a - b);
        low.zip(high).map(|(low, high)| of(low, high)).collect()
    };
    Envelope { time_s: one.time_s.clone(), low: pairs(f64::min), high: pairs(f64::max) }
}

pub fn channels(trace: &Trace) -> impl Iterator<Item = Channel<'_>> {
    let forces = ["lateral force", "longitudinal force"];
    let fields = ["field x", "field y", "field z"];
    let force = trace.force.iter().zip(forces);
    let field = trace.field.iter().zip(fields);
    force.map(|(curves, name)| Channel::of("force", name, "N", curves)).chain(
        field.map(move |(curves, name)| Channel::of("field", name, trace.unit.symbol(), curves)),
    )
}

/// Measured and modelled curve of one quantity.
#[derive(Clone, Copy, Debug)]
pub struct Channel<'a> {
    /// `force` or `field`.
    pub kind: &'static str,
    pub name: &'static str,
    pub unit: &'static str,
    pub measured: &'a Envelope,
    pub modelled: &'a Envelope,
}

impl<'a> Channel<'a> {
    /// Error with the sign convention of the tables.
    pub fn error(&self) -> Envelope {
        match self.kind {
            "force" => difference(self.modelled, self.measured),
            _ => difference(self.measured, self.modelled),
        }
    }

    /// Sign convention as text.
    pub fn sign(&self) -> &'static str {
        match self.kind {
            "force" => "device minus reference",
            _ => "measured minus modelled",
        }
    }

    fn of(
        kind: &'static str,
        name: &'static str,
        unit: &'static str,
        [measured, modelled]: &'a [Envelope; 2],
    ) -> Self {
        Self { kind, name, unit, measured, modelled }
    }
}

/// Trace of the same sensor and recording.
pub fn same<'a>(other: Option<&'a Comparison>, trace: &Trace) -> Option<&'a Trace> {
    let traces = &other?.traces;
    traces.iter().find(|t| t.recording == trace.recording && t.sensor == trace.sensor)
}

/// Packs all traces within the size limit.
pub fn pack(comparison: &Comparison) -> Pack {
    let common = stretches(comparison, NUMBERS);
    let other = comparison.other.as_deref();
    let trace = |trace: &Trace| {
        let most = if fails_most(comparison, trace) { common.max(WORST) } else { common };
        packed(trace, same(other, trace), most)
    };
    Pack { traces: comparison.traces.iter().map(trace).collect() }
}

/// True if each stretch is one value.
fn is_single(curve: &Envelope) -> bool {
    let mut sides = curve.low.iter().zip(&curve.high);
    sides.all(|(low, high)| low == high || low.is_nan())
}

/// True if it contains one of the worst stretches.
fn fails_most(comparison: &Comparison, trace: &Trace) -> bool {
    let mut worst = comparison.worst.iter();
    worst.any(|worst| worst.recording == trace.recording && worst.sensor == trace.sensor)
}

/// Maximum number of stretches of the other traces' curves.
fn stretches(comparison: &Comparison, numbers: usize) -> usize {
    // Measured, modelled and residual, each low and high; a second model adds two.
    let halves = if comparison.other.is_some() { 10 } else { 6 };
    let curves: Vec<(bool, bool, usize)> = comparison
        .traces
        .iter()
        .flat_map(|trace| {
            let worst = fails_most(comparison, trace);
            channels(trace).map(move |channel| {
                let curve = channel.measured;
                (worst, is_single(curve), curve.len())
            })
        })
        .collect();
    let taken = |common: usize| -> usize {
        let of = |&(worst, single, len): &(bool, bool, usize)| {
            let most = if worst { common.max(WORST) } else { common };
            // One value per stretch of a single row.
            let sides = if single && most >= len { halves / 2 } else { halves };
            sides * most.min(len) + halves * AROUND
        };
        curves.iter().map(of).sum()
    };
    let mut common = curves.iter().map(|(_, _, len)| *len).max().unwrap_or(0);
    while common > FEWEST && taken(common) > numbers {
        common = common * 9 / 10;
    }
    common.max(FEWEST)
}

fn packed(trace: &Trace, other: Option<&Trace>, most: usize) -> PackedTrace {
    let mut times: Vec<Vec<f64>> = Vec::new();
    let mut panels: Vec<Panel> = Vec::new();
    for (model, trace) in [Some(trace), other].into_iter().enumerate() {
        for channel in trace.into_iter().flat_map(channels) {
            let mut line = |role: usize, curve: &Envelope| {
                let curve = curve.coarser(most);
                let known = times.iter().position(|time| *time == curve.time_s);
                let time = known.unwrap_or_else(|| {
                    times.push(curve.time_s.clone());
                    times.len() - 1
                });
                let single = is_single(&curve);
                Line {
                    role,
                    time,
                    low: Codes::of(&curve.low),
                    high: (!single).then(|| Codes::of(&curve.high)),
                }
            };
            let measured = (model == 0).then(|| line(0, channel.measured));
            let modelled = line(model + 1, channel.modelled);
            let left = line(model + 1, &channel.error());
            let known = panels.iter().position(|panel| panel.name == channel.name);
            match known.and_then(|at| panels.get_mut(at)) {
                Some(panel) => {
                    panel.lines.push(modelled);
                    panel.left.push(left);
                }
                None => panels.push(Panel {
                    kind: channel.kind,
                    name: channel.name,
                    unit: channel.unit,
                    sign: channel.sign(),
                    lines: measured.into_iter().chain([modelled]).collect(),
                    left: vec![left],
                }),
            }
        }
    }
    PackedTrace {
        recording: trace.recording.clone(),
        sensor: trace.sensor,
        times: times.iter().map(|time| Codes::of(time)).collect(),
        panels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_round_trip_to_a_part_in_65534_of_the_span() {
        let codes = Codes::of(&[-1.0, f64::NAN, 0.0, 1.0]);
        assert_eq!((codes.0, codes.1), (-1.0, 1.0));
        let bytes = STANDARD.decode(codes.2).unwrap();
        // -1 is the first code, 0 the middle, 1 the last valid one.
        assert_eq!(bytes, [0, 0, 0xFF, 0xFF, 0xFF, 0x7F, 0xFE, 0xFF]);
    }

    #[test]
    fn constant_values_round_trip() {
        let codes = Codes::of(&[5.0, 5.0]);
        assert_eq!((codes.0, codes.1, codes.2.as_str()), (5.0, 5.0, "AAAAAA=="));
    }

    #[test]
    fn steep_stretch_is_no_error() {
        // Ten rows per stretch at a slope of 1 per row; the model is 0.5 lower throughout.
        let time: Vec<f64> = (0..100).map(f64::from).collect();
        let model: Vec<f64> = time.iter().map(|t| t - 0.5).collect();
        let left = difference(&Envelope::of(&time, &time, 10), &Envelope::of(&time, &model, 10));
        assert_eq!(left.low, [0.5; 10]);
        assert_eq!(left.high, [0.5; 10]);
    }

    #[test]
    fn error_has_the_sign_of_the_tables() {
        let (three, one) = (Envelope::of(&[0.0], &[3.0], 1), Envelope::of(&[0.0], &[1.0], 1));
        let curves = [three, one];
        let field = Channel::of("field", "field x", "G", &curves);
        assert_eq!((field.error().low, field.sign()), (vec![2.0], "measured minus modelled"));
        let force = Channel::of("force", "lateral force", "N", &curves);
        assert_eq!((force.error().low, force.sign()), (vec![-2.0], "device minus reference"));
    }

    #[test]
    fn many_recordings_share_the_space_and_peaks_survive() {
        let time: Vec<f64> = (0..2000).map(f64::from).collect();
        let mut values = vec![0.0; 2000];
        values[777] = 9.0;
        let curve = Envelope::of(&time, &values, 2000);
        let trace = Trace { field: vec![[curve.clone(), curve]; 3], ..Trace::default() };
        let comparison = Comparison { traces: vec![trace; 100], ..Comparison::default() };
        let most = stretches(&comparison, NUMBERS);
        assert!((400..=540).contains(&most), "{most}");
        let packed = packed(&comparison.traces[0], None, most);
        let line = &packed.panels[0].lines[0];
        assert_eq!(line.high.as_ref().unwrap().1, 9.0);
    }
}
