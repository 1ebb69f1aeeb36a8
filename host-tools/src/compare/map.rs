//! The residual over two covariates at once.

use super::Map;
use super::rows::SensorColumns;

/// Cells along each side.
const CELLS: usize = 12;
/// A cell of fewer rows shows nothing.
const FEWEST_ROWS: usize = 5;

/// Root mean square in a grid of evenly wide cells over the middle 99 % of two covariates; `None`
/// where one of them does not move.
pub fn map(sensors: &[SensorColumns], across: usize, upwards: usize) -> Option<Map> {
    let edges = [edges(sensors, across)?, edges(sensors, upwards)?];
    let mut squares = vec![[0.0; CELLS]; CELLS];
    let mut rows = vec![[0_usize; CELLS]; CELLS];
    let (mut floor, mut all) = (0.0, 0_usize);
    for sensor in sensors {
        let (x, y) = (
            &sensor.covariates[across].values,
            &sensor.covariates[upwards].values,
        );
        for (row, residual) in sensor.residual_g.iter().enumerate() {
            floor += sensor.floor_g2[row].sum();
            all += 1;
            let cell = |edges: &[f64], value: f32| {
                let value = f64::from(value);
                let inside = edges.first()? <= &value && &value <= edges.last()?;
                let place = edges
                    .partition_point(|edge| *edge <= value)
                    .saturating_sub(1);
                inside.then(|| place.min(CELLS - 1))
            };
            if let (Some(i), Some(j)) = (cell(&edges[0], x[row]), cell(&edges[1], y[row])) {
                squares[j][i] += residual.norm_squared();
                rows[j][i] += 1;
            }
        }
    }
    let [across_edges, upwards_edges] = edges;
    Some(Map {
        axes: [across, upwards].map(|covariate| label(sensors, covariate)),
        across: across_edges,
        upwards: upwards_edges,
        rms_g: squares
            .iter()
            .zip(&rows)
            .map(|(squares, rows)| {
                let cell = |(square, rows): (&f64, &usize)| match *rows >= FEWEST_ROWS {
                    true => (square / (3 * rows) as f64).sqrt(),
                    false => f64::NAN,
                };
                squares.iter().zip(rows).map(cell).collect()
            })
            .collect(),
        floor_g: (floor / (3 * all.max(1)) as f64).sqrt(),
    })
}

fn label(sensors: &[SensorColumns], covariate: usize) -> String {
    let Some(first) = sensors.first() else {
        return String::new();
    };
    let covariate = &first.covariates[covariate].of;
    match covariate.unit {
        "" => covariate.words.to_string(),
        unit => format!("{} / {unit}", covariate.words),
    }
}

fn edges(sensors: &[SensorColumns], covariate: usize) -> Option<Vec<f64>> {
    let values = sensors
        .iter()
        .flat_map(|sensor| &sensor.covariates[covariate].values);
    let mut sorted: Vec<f32> = values.copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize);
    let (low, high) = (f64::from(*at(0.005)?), f64::from(*at(0.995)?));
    let edge = |i: usize| low + (high - low) * i as f64 / CELLS as f64;
    (high > low).then(|| (0..=CELLS).map(edge).collect())
}
