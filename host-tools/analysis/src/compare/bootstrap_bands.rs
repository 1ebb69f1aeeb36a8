//! Mean residuals in bins with block-bootstrap confidence intervals, valid for autocorrelated residuals.

use crate::compare::Bin;
use crate::compare::attribution::Binning;
use crate::compare::residual_table::{ResidualTable, error_unit};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Bootstrap resamples.
const DRAWS: usize = 200;
const MAX_BLOCKS: f64 = 300.0;

/// Block bootstrap over time (Künsch 1989), with the same resamples for all covariates.
pub struct BlockBootstrap {
    /// Multiplicity of each block in each resample.
    draws: Vec<Vec<u32>>,
    /// Block of each row by sensor.
    of: Vec<Vec<usize>>,
    excess: f64,
}

/// Sums over the rows of one bin in one block.
#[derive(Clone, Copy, Default)]
struct Cell {
    sum: Vector3<f64>,
    rows: u32,
}

impl BlockBootstrap {
    pub fn new(sensors: &[ResidualTable], block_s: f64, seed: u64) -> Self {
        let total_s: f64 = sensors.iter().map(duration_s).fold(0.0, f64::max);
        let block_s = block_s.max(total_s / MAX_BLOCKS);
        let mut blocks = 0;
        let mut firsts: Vec<(u32, usize)> = Vec::new();
        let of = sensors
            .iter()
            .map(|sensor| {
                let block = |(recording, time): (&u32, &f64)| {
                    let inside = (time / block_s) as usize;
                    let first = match firsts.iter().find(|(other, _)| other == recording) {
                        Some((_, first)) => *first,
                        None => {
                            firsts.push((*recording, blocks));
                            blocks
                        }
                    };
                    blocks = blocks.max(first + inside + 1);
                    first + inside
                };
                sensor.recording.iter().zip(&sensor.time_s).map(block).collect()
            })
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let draw = |_| {
            let mut times = vec![0; blocks];
            (0..blocks).for_each(|_| times[rng.random_range(0..blocks)] += 1);
            times
        };
        let excess = sensors
            .iter()
            .flat_map(|sensor| sensor.residual.iter().zip(&sensor.floor2))
            .map(|(residual, floor)| residual.norm_squared() - floor.sum())
            .sum::<f64>();
        Self { draws: (0..DRAWS).map(draw).collect(), of, excess: excess.max(f64::MIN_POSITIVE) }
    }

    /// Mean and confidence interval of the residual in the bins of one covariate.
    pub fn bins(&self, sensors: &[ResidualTable], binning: &Binning) -> Vec<Bin> {
        let mut bins: Vec<Bin> = binning
            .ranges
            .iter()
            .zip(&binning.centres)
            .map(|(range, centre)| Bin {
                from: range.0,
                to: range.1,
                centre: *centre,
                ..Bin::default()
            })
            .collect();
        let mut squares = vec![(0.0, 0.0); bins.len()];
        for ((sensor, of), blocks) in sensors.iter().zip(&binning.of).zip(&self.of) {
            let mut cells = vec![vec![Cell::default(); self.block_count()]; bins.len()];
            let rows = sensor.residual.iter().zip(&sensor.floor2);
            for (((residual, floor), bin), block) in rows.zip(of).zip(blocks) {
                if *bin == Binning::NONE {
                    continue;
                }
                let bin = usize::from(*bin);
                cells[bin][*block].sum += residual;
                cells[bin][*block].rows += 1;
                squares[bin].0 += residual.norm_squared();
                squares[bin].1 += floor.sum();
                bins[bin].rows += 1;
            }
            for (bin, cells) in bins.iter_mut().zip(&cells) {
                let (mean, band) = self.band(cells);
                bin.mean.push(mean.into());
                bin.band.push(band);
            }
        }
        for (bin, (squares, floor)) in bins.iter_mut().zip(squares) {
            bin.rms = (squares / (error_unit(sensors).axes() * bin.rows.max(1)) as f64).sqrt();
            bin.share = ((squares - floor) / self.excess).clamp(0.0, 1.0);
        }
        bins
    }

    fn block_count(&self) -> usize {
        self.draws.first().map_or(0, Vec::len)
    }

    /// Mean and 95 % interval over the blocks of one bin.
    fn band(&self, cells: &[Cell]) -> (Vector3<f64>, [(f64, f64); 3]) {
        let filled: Vec<(usize, Cell)> =
            cells.iter().copied().enumerate().filter(|(_, cell)| cell.rows > 0).collect();
        let mean = |weight: &dyn Fn(usize) -> f64| {
            let (mut sum, mut rows) = (Vector3::zeros(), 0.0);
            for (block, cell) in &filled {
                sum += cell.sum * weight(*block);
                rows += weight(*block) * f64::from(cell.rows);
            }
            (rows > 0.0).then(|| sum / rows)
        };
        let Some(middle) = mean(&|_| 1.0) else {
            let none = (f64::NAN, f64::NAN);
            return (Vector3::repeat(f64::NAN), [none; 3]);
        };
        let drawn: Vec<Vector3<f64>> =
            self.draws.iter().filter_map(|times| mean(&|block| f64::from(times[block]))).collect();
        let band = [0, 1, 2].map(|axis| {
            let mut values: Vec<f64> = drawn.iter().map(|mean| mean[axis]).collect();
            values.sort_by(f64::total_cmp);
            let at = |share: f64| values.get((share * values.len() as f64) as usize).copied();
            (at(0.025).unwrap_or(middle[axis]), at(0.975).unwrap_or(middle[axis]))
        });
        (middle, band)
    }
}

fn duration_s(sensor: &ResidualTable) -> f64 {
    let ends = sensor.recording.chunk_by(|a, b| a == b).scan(0, |at, chunk| {
        *at += chunk.len();
        sensor.time_s.get(*at - 1).copied()
    });
    ends.sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn interval_widens_with_autocorrelation() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut state = 0.0;
        let mut sensor = ResidualTable::new(0, &[]);
        for row in 0..20_000 {
            let step: f64 = StandardNormal.sample(&mut rng);
            state = 0.9 * state + step;
            sensor.recording.push(0);
            sensor.time_s.push(0.01 * f64::from(row));
            sensor.residual.push(Vector3::new(state, 0.0, 0.0));
            sensor.floor2.push(Vector3::zeros());
        }
        let binning =
            Binning { ranges: vec![(0.0, 1.0)], centres: vec![0.5], of: vec![vec![0; 20_000]] };
        let sensors = [sensor];
        let bins = BlockBootstrap::new(&sensors, 2.0, 1).bins(&sensors, &binning);
        let (low, high) = bins[0].band[0][0];
        // 1 / (1 - a) / sqrt(n) = 0.0707; 95 % are 2 * 1.96 of these wide.
        assert!((0.20..0.36).contains(&(high - low)), "{}", high - low);
    }
}
