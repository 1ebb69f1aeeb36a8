//! Mounting of each sensor, and plausibility of the columns before the fit: swapped, flipped or wrongly scaled columns would
//! give a bad fit that looks like bad physics.
//!
//! For each recording and sensor the field is regressed on the two forces; slopes and field at rest are
//! compared with the nominal design. Only gross errors count: a factor of three or a wrong sign, far beyond
//! manufacturing tolerances.
//!
//! Where the nominal mounting is implausible, the other 47 are tried: 24 orientations by right angles, each with both polarities of
//! the magnet. The field at rest gives the sensor's axis along the gap with its sign, each slope one of the others, so that both
//! slopes leave one mounting at most. All recordings must agree with it.
//!
//! Some mountings give the readings of an error in the columns. The slopes do not distinguish a force column from a field column,
//! and the field along the gap, which is even in both forces, does not either:
//!
//! | readings | as of | decision |
//! | --- | --- | --- |
//! | one field or force column negated | a reversed magnet on a sensor turned by 180 degrees | error |
//! | two field columns, or the two force columns, exchanged | a reversed magnet on a sensor turned by 180 degrees about a diagonal | error |
//! | both force columns negated | a sensor turned by 180 degrees about the gap | mounting, with a notice |
//! | two field columns exchanged and one negated, or two negated | a turned sensor | mounting |
//! | all three field columns negated | a reversed magnet | mounting |

use nalgebra::{Matrix3, SMatrix, Vector3};
use rayon::prelude::*;

use crate::fit::FitError;
use crate::fit::rows::{SensorRows, own_forces};
use crate::physics::{ForwardModel, SensorMounting, SensorOrientation};
use crate::recordings::columns::{Axis, force_column_name};
use crate::recordings::{Campaign, Location, Notice, Recording};

/// Maximum plausible factor from nominal, either way.
const SCALE: f64 = 3.0;
/// Minimum standard deviation in N of a force in a recording for its column to be checked.
const MIN_FORCE_SIGMA_N: f64 = 1.0;
/// Where it is larger in no recording, as of forces in kilonewtons, the minimum relative to the largest one; then only the unit is
/// checked, since small loads are mainly noise.
const MIN_FORCE_SHARE: f64 = 0.3;
/// Maximum correlation of the two forces of a recording for their slopes to be identifiable.
const MAX_CORRELATION: f64 = 0.95;
/// Fraction of a field's variance (assumed) below which its forces do not explain it, and above which others do.
const UNEXPLAINED: f64 = 0.5;
const EXPLAINED: f64 = 0.8;
/// Ratio of the variances that two sets of forces leave from which only one of them is that of the sensor.
const MUCH_BETTER: f64 = 4.0;
/// Step of the search of a delay in seconds.
const DELAY_STEP_S: f64 = 0.02;
/// Minimum overlap of field and forces under a delay (short pieces of periodic loads agree under wrong delays), and of the two tables
/// of a recording, as a fraction.
const MIN_OVERLAP: f64 = 0.5;
const MIN_COVERED: f64 = 0.6;
/// Units of a field by mistake, in gauss.
const FIELD_UNITS_G: [(&str, f64); 3] = [("mT", 10.0), ("uT", 0.01), ("T", 1e4)];
/// Units of a force by mistake, in newtons, and the maximum factor between one and the sensitivity's ratio to nominal.
const FORCE_UNITS_N: [(&str, f64); 5] =
    [("kN", 1e3), ("kgf", 9.806_65), ("lbf", 4.448_222), ("gf", 9.806_65e-3), ("mN", 1e-3)];
const SAME_UNIT: f64 = 1.4;

/// Checks every recording's columns for a sensor in this mounting against the nominal design.
///
/// # Errors
/// The first implausible column.
pub fn check(
    campaign: &Campaign,
    rows: &SensorRows,
    nominal: &ForwardModel,
    mounting: SensorMounting,
) -> Result<(), FitError> {
    let nominal = mounting.nominal(nominal);
    let slopes = recorded_slopes(campaign, rows);
    check_slopes(campaign, rows, &nominal, mounting.orientation, &slopes)
}

/// Mounting of a sensor: the nominal one where it is plausible, else the only plausible one. A notice says where the sensor is
/// mounted otherwise, or where the recordings do not determine it.
///
/// A reference with one axis determines the mounting if another one of the sensors `all` is mounted as in the design and follows
/// this axis, which is then the right one, and if the poles of the magnet are those of the design.
///
/// # Errors
/// The first column that is implausible in the nominal mounting, where no other is plausible; several mountings are.
pub fn find(
    campaign: &Campaign,
    rows: &SensorRows,
    all: &[SensorRows],
    nominal: &ForwardModel,
) -> Result<(SensorMounting, Option<Notice>), FitError> {
    let sensor = rows.sensor;
    let slopes = recorded_slopes(campaign, rows);
    let check = |mounting: SensorMounting| {
        let nominal = mounting.nominal(nominal);
        check_slopes(campaign, rows, &nominal, mounting.orientation, &slopes)
    };
    let unknown = (0..2).find(|&force| slopes.iter().all(|(_, s)| s.per_newton[force].is_none()));
    let notice = |message| Notice { location: Location::file(&campaign.folder), message };
    let Err(error) = check(SensorMounting::default()) else {
        let notice = unknown.map(|force| notice(not_moved(sensor, force)));
        return Ok((SensorMounting::default(), notice));
    };
    let is_plausible = |mounting: &SensorMounting| {
        let nominal = mounting.nominal(nominal);
        slopes.iter().all(|(recording, slopes)| {
            Check::new(campaign, recording, rows, &nominal, mounting.orientation, slopes)
                .is_plausible()
        })
    };
    let mountings = SensorOrientation::all().flat_map(|orientation| {
        [false, true].map(|is_reversed| SensorMounting { orientation, is_reversed })
    });
    let found: Vec<SensorMounting> = mountings.filter(is_plausible).collect();
    let is_measured = |force: usize| rows.forces.contains(&own_forces(sensor)[force]);
    let mut as_designed = found.iter().filter(|mounting| !mounting.is_reversed);
    if let (Some(force), Some(mounting), None) = (unknown, as_designed.next(), as_designed.next())
        && let Some(other) =
            all.iter().find(|other| follows_as_designed(campaign, other, nominal, 1 - force))
    {
        let message = format!(
            "{}; this assumes the magnet's poles as in the design and {} along the axis of sensor {}, since {} does not move by itself",
            description(sensor, *mounting),
            force_column(sensor, 1 - force),
            other.sensor,
            force_column(sensor, force),
        );
        return Ok((*mounting, Some(notice(message))));
    }
    match (found.as_slice(), unknown) {
        ([mounting], _) if mounting.equals_column_error() => {
            Err(with_advice(error, WITH_REVERSED_MAGNET))
        }
        ([mounting], _) => Ok((*mounting, Some(notice(description(sensor, *mounting))))),
        ([_, _, ..], Some(force)) if !is_measured(force) => {
            let column = force_column(sensor, force);
            Err(with_advice(
                error,
                &format!(
                    "; or, if all columns are right, sensor {sensor} is not mounted as in the design: record {column}, too, which determines its orientation"
                ),
            ))
        }
        ([_, _, ..], Some(force)) => Err(FitError::Orientation {
            place: Location::file(&campaign.folder).column(force_column(sensor, force)),
            what: format!(
                "sensor {sensor} is not mounted as in the design, and {} mountings explain its field, since this force does not move by itself",
                found.len()
            ),
            advice: "record this force while the other one rests, and fit all recordings together"
                .to_owned(),
        }),
        _ => Err(error),
    }
}

/// Whether a sensor in the nominal mounting follows this force of its own.
fn follows_as_designed(
    campaign: &Campaign,
    rows: &SensorRows,
    nominal: &ForwardModel,
    force: usize,
) -> bool {
    let slopes = recorded_slopes(campaign, rows);
    let mounting = SensorMounting::default();
    slopes.iter().any(|(_, slopes)| slopes.per_newton[force].is_some())
        && check_slopes(campaign, rows, &mounting.nominal(nominal), mounting.orientation, &slopes)
            .is_ok()
}

/// Further advice for the error of a column that a reversed magnet explains, too.
const WITH_REVERSED_MAGNET: &str = "; or, if all columns are right, the magnet sits the other way round on a turned sensor: give remanence_t the other sign in recording.toml";

/// The error of a column with further advice.
fn with_advice(error: FitError, further: &str) -> FitError {
    match error {
        FitError::Orientation { place, what, advice } => {
            FitError::Orientation { place, what, advice: advice + further }
        }
        other => other,
    }
}

fn not_moved(sensor: u32, force: usize) -> String {
    format!(
        "the orientation of sensor {sensor} is assumed to be that of the design: {} does not move by itself in any recording",
        force_column(sensor, force)
    )
}

fn description(sensor: u32, mounting: SensorMounting) -> String {
    let SensorMounting { orientation, is_reversed } = mounting;
    let mut text = format!("sensor {sensor} is mounted");
    if !orientation.is_nominal() {
        let axes = orientation.gripper_axes().map(|(axis, is_negated)| {
            format!("{}{}", if is_negated { "-" } else { "" }, Axis::ALL[axis].letter())
        });
        text += &format!(" turned: its x, y and z are the gripper's {}", axes.join(", "));
    }
    if is_reversed {
        let and = if orientation.is_nominal() { " with" } else { ", and" };
        text += &format!("{and} the poles of its magnet exchanged");
    }
    text += "; results are in the gripper's axes, and the board turns its readings";
    if orientation.sensor_axes() == [(0, true), (1, false), (2, true)] && !is_reversed {
        text += &format!(
            "; with the other sign of both {} and {} it would be mounted as in the design",
            force_column(sensor, 0),
            force_column(sensor, 1)
        );
    }
    text
}

fn force_column(sensor: u32, force: usize) -> String {
    force_column_name((sensor, [Axis::X, Axis::Z][force]))
}

/// The slopes of each recording in which the sensor has any.
fn recorded_slopes<'a>(campaign: &'a Campaign, rows: &SensorRows) -> Vec<(&'a Recording, Slopes)> {
    let places = (rows, rows.sensor);
    let of = |recording| Some((recording, Slopes::of(campaign, recording, places, 0)?));
    campaign.recordings.iter().filter_map(of).collect()
}

fn check_slopes(
    campaign: &Campaign,
    rows: &SensorRows,
    nominal: &ForwardModel,
    orientation: SensorOrientation,
    slopes: &[(&Recording, Slopes)],
) -> Result<(), FitError> {
    slopes.iter().try_for_each(|(recording, slopes)| {
        let check = Check::new(campaign, recording, rows, nominal, orientation, slopes);
        check.rest_field()?;
        check.forces()
    })
}

/// Field at zero force, and its slope to each force that varies.
#[derive(Clone, Copy)]
struct Slopes {
    rest_g: Vector3<f64>,
    /// `[dB/dFx, dB/dFz]` in G/N; `None` where the force does not move.
    per_newton: [Option<Vector3<f64>>; 2],
    /// Whether the force is small in every recording.
    is_small: [bool; 2],
    /// Sums of squares of each axis: of the regression's residual, and about the mean.
    squares: [Vector3<f64>; 2],
}

impl Slopes {
    /// Of the field of a sensor to the forces at a place, each force `delay` rows before the field.
    fn of(
        campaign: &Campaign,
        recording: &Recording,
        (rows, place): (&SensorRows, u32),
        delay: isize,
    ) -> Option<Self> {
        let track = recording.sensors.get(&rows.sensor)?;
        let is_used = |force: &(u32, Axis)| place != rows.sensor || rows.forces.contains(force);
        let loads = [Axis::X, Axis::Z]
            .map(|axis| recording.forces.get(&(place, axis)).filter(|_| is_used(&(place, axis))));
        let any = loads.into_iter().flatten().next()?;
        // A force that was not measured is assumed to be zero.
        let unloaded = vec![0.0; any.newtons.len()];
        let [x, z] = loads.map(|load| load.map_or(&unloaded, |load| &load.newtons));
        let mut normal: Matrix3<f64> = Matrix3::zeros();
        let mut right: SMatrix<f64, 3, 3> = SMatrix::zeros();
        let mut squares: Vector3<f64> = Vector3::zeros();
        let (later, earlier) = (delay.max(0) as usize, (-delay).max(0) as usize);
        let fields = track.field_g.iter().skip(later);
        let forces = x.iter().zip(z).skip(earlier);
        for (field, (&fx, &fz)) in fields.zip(forces) {
            let (regressor, field) = (Vector3::new(1.0, fx, fz), Vector3::from(*field));
            if regressor.iter().chain(field.iter()).all(|value| value.is_finite()) {
                normal += regressor * regressor.transpose();
                right += regressor * field.transpose();
                squares += field.component_mul(&field);
            }
        }
        let count = normal[(0, 0)];
        let largest_n = [0, 1].map(|i| {
            let axis = [Axis::X, Axis::Z][i];
            loads[i].map_or(0.0, |_| max_sigma_n(campaign, (place, axis)))
        });
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
        let moves = if moves == [true, true] && correlation.abs() > MAX_CORRELATION {
            [false; 2]
        } else {
            moves
        };
        // A constant force has no defined slope: regularised to zero.
        for (i, moves) in moves.iter().enumerate() {
            normal[(i + 1, i + 1)] += if *moves { 0.0 } else { 1e12 };
        }
        let solution = normal.cholesky()?.solve(&right);
        let about = |axis: usize| {
            [
                squares[axis] - solution.column(axis).dot(&right.column(axis)),
                squares[axis] - right[(0, axis)].powi(2) / count,
            ]
        };
        let about = [about(0), about(1), about(2)];
        let slope = |i: usize| moves[i].then(|| solution.row(i + 1).transpose());
        Some(Self {
            rest_g: solution.row(0).transpose(),
            per_newton: [slope(0), slope(1)],
            is_small,
            squares: [0, 1].map(|of| about.map(|squares| squares[of]).into()),
        })
    }

    /// The same in the gripper's axes, of a sensor in this orientation.
    fn turned(self, orientation: SensorOrientation) -> Self {
        let axes = orientation.sensor_axes().map(|(axis, _)| axis);
        Self {
            rest_g: orientation.to_gripper(self.rest_g),
            per_newton: self.per_newton.map(|slope| Some(orientation.to_gripper(slope?))),
            squares: self.squares.map(|squares| axes.map(|axis| squares[axis]).into()),
            ..self
        }
    }

    /// Fraction of the variance of the field along x and z that the regression explains.
    fn explained(&self) -> f64 {
        let [rest, all] = self.squares.map(|squares| squares.x + squares.z);
        1.0 - rest / all.max(f64::MIN_POSITIVE)
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

/// The unit of the force, or else of the field along `axis`, that explains this ratio of the sensitivity to nominal, as a clause.
fn unit_by_mistake(share: f64, axis: &str) -> String {
    let is_near = |ratio: f64| (SAME_UNIT.recip()..=SAME_UNIT).contains(&(share / ratio));
    if let Some((name, _)) = FORCE_UNITS_N.iter().find(|(_, newtons)| is_near(*newtons)) {
        return format!(", as if the force were in {name}");
    }
    let unit = FIELD_UNITS_G.iter().find(|(_, gauss)| is_near(gauss.recip()));
    unit.map_or_else(String::new, |(name, _)| {
        format!(", as if its field along {axis} were in {name}")
    })
}

struct Check<'a> {
    campaign: &'a Campaign,
    recording: &'a Recording,
    rows: &'a SensorRows,
    sensor: u32,
    nominal: &'a ForwardModel,
    orientation: SensorOrientation,
    /// In the gripper's axes.
    slopes: Slopes,
}

impl<'a> Check<'a> {
    /// Of a sensor in this orientation, with the slopes in its own axes.
    fn new(
        campaign: &'a Campaign,
        recording: &'a Recording,
        rows: &'a SensorRows,
        nominal: &'a ForwardModel,
        orientation: SensorOrientation,
        slopes: &Slopes,
    ) -> Self {
        let slopes = slopes.turned(orientation);
        Self { campaign, recording, rows, sensor: rows.sensor, nominal, orientation, slopes }
    }

    /// Whether the field at rest and every slope agree with the design, and no forces explain the field better.
    fn is_plausible(&self) -> bool {
        let shares = self.slopes.shares(self.nominal);
        let mut own = (0..2).filter_map(|force| Some(shares[force]?[force]));
        let is_driven = self.slopes.per_newton.iter().any(Option::is_some);
        self.rest_field().is_ok()
            && own.all(|share| (1.0 / SCALE..=SCALE).contains(&share))
            && !(is_driven && self.slopes.explained() < UNEXPLAINED)
            && self.followed().is_none()
    }

    fn rest_field(&self) -> Result<(), FitError> {
        let (rest, expected) = (self.slopes.rest_g, self.nominal.field([0.0, 0.0]));
        let strongest = expected.iamax();
        let columns = |axis: usize| {
            let (axis, _) = self.orientation.sensor_axes()[axis];
            format!("s{}_{}", self.sensor, Axis::ALL[axis].letter())
        };
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
                "multiply the column by -1 (scale = -1 in a mapping)",
            );
        }
        Ok(())
    }

    /// Forces that do not explain the field at all are at another place or another time, whatever their slopes look like.
    fn forces(&self) -> Result<(), FitError> {
        let Err(error) = self.force_columns() else {
            return Ok(());
        };
        if let Some(place) = self.followed() {
            return self.force(
                0,
                format!("sensor {} does not follow the forces of its place, it follows those of place {place}", self.sensor),
                "the forces of the two places, or the fields of the two sensors, are exchanged; the recordings do not show which: press one finger by hand and see which columns move, then rename those that are wrong",
            );
        }
        if self.slopes.explained() > UNEXPLAINED {
            return Err(error);
        }
        let (_, reference) = self.recording.rows_read;
        let covered = self.recording.time_s.len() as f64 / reference.max(1) as f64;
        if covered < MIN_COVERED {
            return self.clock(
                format!("the field does not follow these forces, and only {:.0} % of the reference's rows are within the time of the board's: the two clocks probably differ by seconds", 100.0 * covered),
                "give both tables one clock, or read them with the difference as --delay-ms; two loggers that start at zero each need the instants of their starts",
            );
        }
        if let Some(delay_s) = self.delay_s() {
            return self.clock(
                format!("the field follows these forces only if they are read {:.2} s {}: the two clocks differ", delay_s.abs(), if delay_s > 0.0 { "later" } else { "earlier" }),
                &format!("read the recordings with --delay-ms {:.0} (added to a delay that is given already) for a first fit (`compare` then gives the exact value), or correct one of the two clocks", 1e3 * delay_s),
            );
        }
        Err(error)
    }

    fn force_columns(&self) -> Result<(), FitError> {
        let shares = self.slopes.shares(self.nominal);
        let own = |force: usize| shares[force].map(|share| share[force]);
        let other = |force: usize| shares[force].map(|share| share[1 - force]);
        let follows = |share: Option<f64>| share.is_some_and(|share| share.abs() > 1.0 / SCALE);
        let is_small = self.slopes.is_small;
        let silent =
            |force: usize| !is_small[force] && shares[force].is_some() && !follows(own(force));
        if (silent(0) && follows(other(0))) || (silent(1) && follows(other(1))) {
            let force = if silent(0) { 0 } else { 1 };
            if self.slopes.is_small[1 - force] {
                let [own, other] = [["x", "z"][force], ["x", "z"][1 - force]];
                return self.force(
                    force,
                    format!("the field along {other} of sensor {} follows this force, and the field along {own} does not", self.sensor),
                    &format!("rename the column to f{}_{other}_n if the force acts along {other}; else the field columns x and z are swapped: rename those", self.sensor),
                );
            }
            return self.force(
                force,
                format!("the field along x follows the force along z, and the field along z that along x, at sensor {}", self.sensor),
                "the two force columns (or the two field columns) are swapped: rename them",
            );
        }
        for force in 0..2 {
            let Some(share) = own(force) else { continue };
            let axis = ["x", "z"][force];
            // A small force of the right unit is mainly noise, which explains nothing.
            let is_scaled = share > SCALE
                && (self.slopes.explained() > EXPLAINED
                    || !unit_by_mistake(share, axis).is_empty());
            if is_small[force] && !is_scaled {
                continue;
            }
            if share <= -1.0 / SCALE {
                return self.force(
                    force,
                    format!("the field along {axis} of sensor {} falls where this force rises: one of the two has its sign flipped", self.sensor),
                    "multiply the force column by -1 (scale = -1 in a mapping) if the reference is mounted the other way round, else the field column",
                );
            }
            if share < 1.0 / SCALE {
                return self.force(
                    force,
                    format!("sensor {} has {share:.2} of the sensitivity of the design along {axis}{}", self.sensor, unit_by_mistake(share, axis)),
                    "check the force's unit (newtons), the field's unit, and stiffness, gap and magnet in recording.toml",
                );
            }
            if share > SCALE {
                return self.force(
                    force,
                    format!("sensor {} has {share:.1} times the sensitivity of the design along {axis}{}", self.sensor, unit_by_mistake(share, axis)),
                    "check the force's unit (newtons, not kilograms), the field's unit, and stiffness, gap and magnet in recording.toml",
                );
            }
        }
        Ok(())
    }

    /// Another place whose forces explain the field, much better than those of the sensor's place.
    fn followed(&self) -> Option<u32> {
        let places = self.recording.forces.keys().map(|(place, _)| *place);
        places.filter(|place| *place != self.sensor).find(|place| {
            self.explained_by(*place, 0).is_some_and(|explained| {
                let better = MUCH_BETTER * (1.0 - explained) < 1.0 - self.slopes.explained();
                better && explained > EXPLAINED
            })
        })
    }

    /// Fraction of the field's variance that the forces at a place explain, each `delay` rows before the field.
    fn explained_by(&self, place: u32, delay: isize) -> Option<f64> {
        let slopes = Slopes::of(self.campaign, self.recording, (self.rows, place), delay)?;
        Some(slopes.turned(self.orientation).explained())
    }

    /// Time in seconds by which the forces must be read later to explain the field.
    fn delay_s(&self) -> Option<f64> {
        let time_s = &self.recording.time_s;
        let rows = time_s.len();
        let period_s = (time_s.last()? - time_s.first()?) / rows.saturating_sub(1).max(1) as f64;
        let step = ((DELAY_STEP_S / period_s) as usize).max(1);
        let most = ((1.0 - MIN_OVERLAP) * rows as f64) as isize;
        let explained = |delay: isize| Some((self.explained_by(self.sensor, delay)?, delay));
        let steps = most / step as isize;
        let delays: Vec<isize> = (-steps..=steps).map(|count| count * step as isize).collect();
        let best = delays.into_par_iter().filter_map(explained).max_by(|a, b| a.0.total_cmp(&b.0));
        let (share, delay) = best?;
        (share > EXPLAINED).then_some(delay as f64 * period_s)
    }

    fn clock(&self, what: String, advice: &str) -> Result<(), FitError> {
        Err(self.error("force.csv", "t_us".to_owned(), what, advice))
    }

    fn hall(&self, column: &str, what: String, advice: &str) -> Result<(), FitError> {
        Err(self.error("hall.csv", column.to_owned(), what, advice))
    }

    fn force(&self, force: usize, what: String, advice: &str) -> Result<(), FitError> {
        Err(self.error("force.csv", force_column(self.sensor, force), what, advice))
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
