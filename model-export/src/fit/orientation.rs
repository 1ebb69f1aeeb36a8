//! Plausibility of the columns before the fit: swapped, flipped or wrongly scaled columns would give a bad fit
//! that looks like bad physics.
//!
//! For each recording and sensor the field is regressed on the two forces; slopes and field at rest are
//! compared with the nominal design. Only gross errors count: a factor of three or a wrong sign, far beyond
//! manufacturing tolerances.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::fit::FitError;
use crate::physics::ForwardModel;
use crate::recordings::columns::Axis;
use crate::recordings::{Campaign, Location, Recording};

/// Maximum plausible factor from nominal, either way.
const SCALE: f64 = 3.0;
/// Minimum standard deviation in N of a force in a recording for its column to be checked.
const MIN_FORCE_SIGMA_N: f64 = 1.0;
/// Where it is larger in no recording, as of forces in kilonewtons, the minimum relative to the largest one; then only the unit is
/// checked, since small loads are mainly noise.
const MIN_FORCE_SHARE: f64 = 0.3;
/// Maximum correlation of the two forces of a recording for their slopes to be identifiable.
const MAX_CORRELATION: f64 = 0.95;
/// Units of a force by mistake, in newtons, and the maximum factor between one and the sensitivity's ratio to nominal.
const FORCE_UNITS_N: [(&str, f64); 5] =
    [("kN", 1e3), ("kgf", 9.806_65), ("lbf", 4.448_222), ("gf", 9.806_65e-3), ("mN", 1e-3)];
const SAME_UNIT: f64 = 1.4;

/// Checks every recording's columns for `sensor` against the nominal design.
///
/// # Errors
/// The first implausible column.
pub fn check(campaign: &Campaign, sensor: u32, nominal: &ForwardModel) -> Result<(), FitError> {
    for recording in &campaign.recordings {
        let Some(slopes) = Slopes::of(campaign, recording, sensor, sensor) else {
            continue;
        };
        let found = Check { campaign, recording, sensor, nominal, slopes };
        found.rest_field()?;
        found.forces()?;
    }
    Ok(())
}

/// Field at zero force, and its slope to each force that varies.
struct Slopes {
    rest_g: Vector3<f64>,
    /// `[dB/dFx, dB/dFz]` in G/N; `None` where the force does not move.
    per_newton: [Option<Vector3<f64>>; 2],
    /// Whether the force is small in every recording.
    is_small: [bool; 2],
}

impl Slopes {
    fn of(campaign: &Campaign, recording: &Recording, sensor: u32, place: u32) -> Option<Self> {
        let track = recording.sensors.get(&sensor)?;
        let loads = [Axis::X, Axis::Z].map(|axis| recording.forces.get(&(place, axis)));
        let [x, z] = loads;
        let (x, z) = (x?, z?);
        let mut normal: Matrix3<f64> = Matrix3::zeros();
        let mut right: SMatrix<f64, 3, 3> = SMatrix::zeros();
        for ((field, &fx), &fz) in track.field_g.iter().zip(&x.newtons).zip(&z.newtons) {
            let (regressor, field) = (Vector3::new(1.0, fx, fz), Vector3::from(*field));
            if regressor.iter().chain(field.iter()).all(|value| value.is_finite()) {
                normal += regressor * regressor.transpose();
                right += regressor * field.transpose();
            }
        }
        let count = normal[(0, 0)];
        let largest_n = [Axis::X, Axis::Z].map(|axis| max_sigma_n(campaign, (place, axis)));
        let is_small = largest_n.map(|sigma_n| sigma_n <= MIN_FORCE_SIGMA_N);
        let moves = [Axis::X, Axis::Z].map(|axis| {
            let i = if axis == Axis::X { 1 } else { 2 };
            let mean = normal[(0, i)] / count;
            let sigma_n = (normal[(i, i)] / count - mean * mean).max(0.0).sqrt();
            let least_n = if is_small[i - 1] {
                MIN_FORCE_SHARE * largest_n[i - 1]
            } else {
                MIN_FORCE_SIGMA_N
            };
            sigma_n > least_n
        });
        // Forces that rise and fall together have no slopes of their own.
        let covariance = |i: usize, j: usize| {
            normal[(i, j)] / count - normal[(0, i)] * normal[(0, j)] / (count * count)
        };
        let correlation = covariance(1, 2) / (covariance(1, 1) * covariance(2, 2)).sqrt();
        if moves == [true, true] && correlation.abs() > MAX_CORRELATION {
            return None;
        }
        // A constant force has no defined slope: regularised to zero.
        for (i, moves) in moves.iter().enumerate() {
            normal[(i + 1, i + 1)] += if *moves { 0.0 } else { 1e12 };
        }
        let solution = normal.cholesky()?.solve(&right);
        let slope = |i: usize| moves[i].then(|| solution.row(i + 1).transpose());
        Some(Self {
            rest_g: solution.row(0).transpose(),
            per_newton: [slope(0), slope(1)],
            is_small,
        })
    }

    /// Slopes relative to nominal: `shares[force][axis]`, each of x and z.
    fn shares(&self, nominal: &ForwardModel) -> [Option<[f64; 2]>; 2] {
        let expected = nominal.per_newton(&nominal.response(Vector3::zeros()));
        let scale = [expected[0].x, expected[1].z];
        self.per_newton.map(|slope| slope.map(|slope| [slope.x / scale[0], slope.z / scale[1]]))
    }
}

/// Maximum over the recordings of the standard deviation of a force.
fn max_sigma_n(campaign: &Campaign, force: (u32, Axis)) -> f64 {
    let sigma_n = |recording: &Recording| {
        let newtons = recording.forces.get(&force)?.newtons.iter().filter(|n| n.is_finite());
        let count = newtons.clone().count().max(1) as f64;
        let mean = newtons.clone().sum::<f64>() / count;
        Some((newtons.map(|n| (n - mean).powi(2)).sum::<f64>() / count).sqrt())
    };
    campaign.recordings.iter().filter_map(sigma_n).fold(0.0, f64::max)
}

/// The unit that explains this ratio of the sensitivity to nominal, as a clause.
fn unit_by_mistake(share: f64) -> String {
    let is_near =
        |(_, newtons): &&(&str, f64)| (SAME_UNIT.recip()..=SAME_UNIT).contains(&(share / newtons));
    let unit = FORCE_UNITS_N.iter().find(is_near);
    unit.map_or_else(String::new, |(name, _)| format!(", as if the force were in {name}"))
}

struct Check<'a> {
    campaign: &'a Campaign,
    recording: &'a Recording,
    sensor: u32,
    nominal: &'a ForwardModel,
    slopes: Slopes,
}

impl Check<'_> {
    fn rest_field(&self) -> Result<(), FitError> {
        let (rest, expected) = (self.slopes.rest_g, self.nominal.field([0.0, 0.0]));
        let strongest = expected.iamax();
        let columns = |axis: usize| format!("s{}_{}", self.sensor, Axis::ALL[axis].letter());
        if rest.iamax() != strongest && rest.amax() > expected.amax() / SCALE {
            return self.hall(
                &columns(rest.iamax()),
                format!("the magnet's field is on this axis ({:.0} G at rest), but on {} by the design", rest.amax(), columns(strongest)),
                "the field columns are permuted: rename them, or correct magnet.axis in recording.toml",
            );
        }
        let ratio = rest[strongest] / expected[strongest];
        if ratio.abs() > SCALE || ratio.abs() < 1.0 / SCALE {
            return self.hall(
                &columns(strongest),
                format!("the field at rest is {:.1} G and the design gives {:.1} G, a factor of {ratio:.3}", rest[strongest], expected[strongest]),
                "check the unit (1 mT is 10 G, 100 uT is 1 G), gauss_per_lsb, and the magnet and gap in recording.toml",
            );
        }
        if ratio < 0.0 {
            return self.hall(
                &columns(strongest),
                format!("the field at rest is {:.0} G and the design gives {:.0} G: its sign is flipped", rest[strongest], expected[strongest]),
                "multiply the column by -1, or, if the magnet sits the other way round, give remanence_t the other sign in recording.toml",
            );
        }
        Ok(())
    }

    fn forces(&self) -> Result<(), FitError> {
        let shares = self.slopes.shares(self.nominal);
        let own = |force: usize| shares[force].map(|share| share[force]);
        let other = |force: usize| shares[force].map(|share| share[1 - force]);
        let follows = |share: Option<f64>| share.is_some_and(|share| share.abs() > 1.0 / SCALE);
        let is_small = self.slopes.is_small;
        let silent =
            |force: usize| !is_small[force] && shares[force].is_some() && !follows(own(force));
        if (silent(0) && follows(other(0))) || (silent(1) && follows(other(1))) {
            return self.force(
                if silent(0) { 0 } else { 1 },
                format!("the field along x follows the force along z, and the field along z that along x, at sensor {}", self.sensor),
                "the two force columns (or the two field columns) are swapped: rename them",
            );
        }
        for force in 0..2 {
            let Some(share) = own(force) else { continue };
            let axis = ["x", "z"][force];
            if is_small[force] && (share <= SCALE || unit_by_mistake(share).is_empty()) {
                continue;
            }
            if share < 1.0 / SCALE
                && let Some(place) = self.followed(force)
            {
                return self.force(
                    force,
                    format!("sensor {} does not follow this force, it follows that of place {place}", self.sensor),
                    "the forces of the two places, or the fields of the two sensors, are exchanged; the recordings do not show which: press one finger by hand and see which columns move, then rename those that are wrong",
                );
            }
            if share <= -1.0 / SCALE {
                return self.force(
                    force,
                    format!("the field along {axis} of sensor {} falls where this force rises: one of the two has its sign flipped", self.sensor),
                    "multiply the force column by -1 if the reference is mounted the other way round, else the field column",
                );
            }
            if share < 1.0 / SCALE {
                return self.force(
                    force,
                    format!("sensor {} has {share:.2} of the sensitivity of the design{}", self.sensor, unit_by_mistake(share)),
                    "check the force's unit (newtons), the field's unit, and the stiffness in recording.toml",
                );
            }
            if share > SCALE {
                return self.force(
                    force,
                    format!("sensor {} has {share:.1} times the sensitivity of the design{}", self.sensor, unit_by_mistake(share)),
                    "check the force's unit (newtons, not kilograms), the field's unit, and the stiffness in recording.toml",
                );
            }
        }
        Ok(())
    }

    /// Location of another force that the field follows.
    fn followed(&self, force: usize) -> Option<u32> {
        let places = self.recording.forces.keys().map(|(place, _)| *place);
        places.filter(|place| *place != self.sensor).find(|place| {
            Slopes::of(self.campaign, self.recording, self.sensor, *place)
                .and_then(|slopes| slopes.shares(self.nominal)[force])
                .is_some_and(|shares| shares[force] > 1.0 / SCALE)
        })
    }

    fn hall(&self, column: &str, what: String, advice: &str) -> Result<(), FitError> {
        Err(self.error("hall.csv", column.to_owned(), what, advice))
    }

    fn force(&self, force: usize, what: String, advice: &str) -> Result<(), FitError> {
        let column = format!("f{}_{}_n", self.sensor, ["x", "z"][force]);
        Err(self.error("force.csv", column, what, advice))
    }

    fn error(&self, file: &str, column: String, what: String, advice: &str) -> FitError {
        let packed = self.recording.folder.join(format!("{file}.gz"));
        let path = if packed.exists() { packed } else { self.recording.folder.join(file) };
        FitError::Orientation {
            place: Location::file(&path).column(column),
            what,
            advice: advice.to_owned(),
        }
    }
}
