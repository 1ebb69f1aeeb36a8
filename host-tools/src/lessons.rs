//! Recordings as a recurrent network on the device sees them: every row through the device's own
//! code, and the truth at the rows that have one.

use firmware::compensate::{Compensation, Memory};
use firmware::force::{Validity, estimate};
use firmware::hall::a31301;
use firmware::units::{Field, Force};
use model_export::gru::train::lesson::{Sequence, Track};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::recordings::Problem;
use model_export::recordings::raw::RawStream;

use crate::replay::Models;
use crate::surroundings::Covariates;
use crate::wiring::{reading, wire};

/// Runs one recording through the device's code.
///
/// The reference is far slower than the board. No row of the board is left out for that: truth stands
/// at the first row at or after each row of the reference, on the straight line to the next, so that
/// it belongs to the very time of the field. Estimates that the device calls invalid have none.
pub fn sequence(
    models: Models,
    name: &str,
    mut stream: RawStream,
    done: impl Fn(u64),
) -> Result<Sequence, Problem> {
    /// Rows between two reports.
    const REPORTED: usize = 4096;
    let wiring = wire(models.numbers, &stream);
    let compensations: Vec<Compensation> = models
        .compensations
        .iter()
        .map(OwnedCompensation::view)
        .collect();
    let tables = models.tables.tables(&compensations);
    let covariates = Covariates::find(stream.layout(), models.design);
    let mut memories = vec![Memory::default(); wiring.len()];
    let mut tracks: Vec<Track> = wiring
        .iter()
        .map(|wires| Track {
            number: wires.number,
            ..Track::default()
        })
        .collect();
    let mut rows = 0;
    while let Some(row) = stream.next_row()? {
        let around = covariates.at(&row);
        let of_sensors = wiring.iter().zip(&mut memories).zip(&mut tracks);
        for ((wires, memory), track) in of_sensors {
            let bytes = a31301::encode(reading(&row, wires, models.gauss_per_lsb));
            let reading = Some(a31301::decode(bytes));
            let number = wires.number as usize;
            let estimate = estimate(&tables, number, reading, &around, memory);
            let gauss = |field: Field| (field.counts() * models.gauss_per_lsb) as f32;
            track.field_g.push(estimate.field.map(gauss));
            let ideal_n = estimate.force.map(|force: Force| force.newtons() as f32);
            track.ideal_n.push(ideal_n);
            track.beside_g.push(gauss(estimate.parity.departure));
            let truth = wires.forces.map(|force| row.forces[force]);
            let known = stream.meets_reference() && truth.iter().all(|n| n.is_finite());
            if known && estimate.validity == Validity::Valid {
                track.truth_n.push((rows, truth.map(|n| n as f32)));
            }
        }
        rows += 1;
        if rows % REPORTED == 0 {
            done(rows as u64);
        }
    }
    done(rows as u64);
    Ok(Sequence {
        name: name.to_owned(),
        rows,
        tracks,
    })
}
