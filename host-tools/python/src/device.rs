//! The board's own integer code, row by row or over arrays.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, anyhow, bail};
use device_run::channel_map::SensorChannels;
use device_run::networks::NetworkSet;
use device_run::{DeviceRow, RecordedRows, ReplayModels};
use firmware::compensation::Compensation;
use firmware::config::constants;
use firmware::estimator::{Estimator, Validity};
use firmware::fixed_point::Force;
use firmware::sensors::hall::{HallFrame, SENSORS};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::{
    ChannelLayout, FieldUnit, ForceColumn, HallColumn, hall_column,
};
use model_export::recordings::stream::{RawRow, RawStream};
use numpy::{PyArray1, PyReadonlyArray1, ToPyArray};
use pyo3::prelude::*;

use crate::interrupt;

/// Columns of rows by the names of `hall.csv`, all of one length.
type Columns = BTreeMap<String, Vec<f64>>;

/// Estimates of consecutive rows, one list for each quantity.
#[derive(Debug, Default)]
struct Estimates {
    /// Time of each row in seconds.
    time_s: Vec<f64>,
    /// Lateral and longitudinal force in newtons of each sensor of each row.
    force_n: Vec<f64>,
    /// Standard deviations by a network; NaN without one.
    sigma_n: Vec<f64>,
    /// Whether the estimate of each sensor of each row is valid.
    is_valid: Vec<bool>,
    /// Whether an external magnet is detected, for each row.
    is_disturbed: Vec<bool>,
}

/// What the thread of a device is asked.
enum Job {
    Reset,
    Rows(Columns),
    /// With a delay of the reference in milliseconds; without it, that of the model.
    Recording(PathBuf, Option<f64>),
}

/// Jobs to the thread of a device, and its answers.
struct Worker {
    jobs: Sender<Job>,
    answers: Receiver<Result<Estimates>>,
}

/// The estimator of the board with the tables of a model, and its state: compensations, networks, detectors.
///
/// It borrows its tables, so that it lives on the stack of a thread of its own, which ends with this object.
#[pyclass(frozen)]
pub struct Device {
    /// Numbers of the sensors, in the order of the estimates.
    #[pyo3(get)]
    sensors: Vec<u32>,
    worker: Mutex<Worker>,
}

/// Time, forces, standard deviations, validity and disturbance, each flat.
type Arrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
);

#[pymethods]
impl Device {
    #[new]
    fn new(py: Python<'_>, model: PathBuf, network: Option<PathBuf>) -> PyResult<Self> {
        interrupt::run(py, move |_| Self::start(&model, network.as_deref()))
    }

    /// Clears the state of the estimator.
    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.ask(py, Job::Reset).map(drop)
    }

    /// Estimates of these rows, which follow those before.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        columns: BTreeMap<String, PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Arrays<'py>> {
        let copied = columns.iter().map(|(name, column)| {
            (name.clone(), column.as_array().iter().copied().collect::<Vec<f64>>())
        });
        let columns: Columns = copied.collect();
        self.ask(py, Job::Rows(columns)).map(|estimates| estimates.to_arrays(py))
    }

    /// Estimates of every row of a recording, from the device's reset.
    fn recording<'py>(
        &self,
        py: Python<'py>,
        folder: PathBuf,
        delay_ms: Option<f64>,
    ) -> PyResult<Arrays<'py>> {
        let job = Job::Recording(folder, delay_ms);
        self.ask(py, job).map(|estimates| estimates.to_arrays(py))
    }
}

impl Device {
    fn start(model: &Path, network: Option<&Path>) -> Result<Self> {
        let built = build(model, ModelVariant::Fitted)?;
        let sensors = built.header.sensors.clone();
        if let Some(number) = sensors.iter().find(|number| **number as usize >= SENSORS) {
            bail!(
                "{}: the board has no sensor {number}, its sensors are 0 to {}",
                model.display(),
                SENSORS - 1
            );
        }
        let networks = network.map(|path| NetworkSet::read(path, &built)).transpose()?;
        let (jobs, asked) = mpsc::channel();
        let (answer, answers) = mpsc::channel();
        std::thread::Builder::new()
            .name("magpie device".to_owned())
            .spawn(move || serve(&built, networks.as_ref(), &asked, &answer))
            .context("no thread for the device")?;
        Ok(Self { sensors, worker: Mutex::new(Worker { jobs, answers }) })
    }

    fn ask(&self, py: Python<'_>, job: Job) -> PyResult<Estimates> {
        interrupt::run(py, move |_| {
            let worker = self.worker.lock().unwrap_or_else(PoisonError::into_inner);
            let ended = || anyhow!("the thread of the device has ended");
            worker.jobs.send(job).map_err(|_| ended())?;
            worker.answers.recv().map_err(|_| ended())?
        })
    }
}

impl Estimates {
    fn to_arrays<'py>(&self, py: Python<'py>) -> Arrays<'py> {
        (
            self.time_s.to_pyarray(py),
            self.force_n.to_pyarray(py),
            self.sigma_n.to_pyarray(py),
            self.is_valid.to_pyarray(py),
            self.is_disturbed.to_pyarray(py),
        )
    }

    /// Adds the next row.
    fn push<N: firmware::estimator::NetworkBank>(
        &mut self,
        estimator: &mut Estimator<'_, N>,
        numbers: &[u32],
        row: &DeviceRow,
    ) {
        let frame = HallFrame { readings: row.readings, ..HallFrame::default() };
        let estimates = estimator.update(&frame, &row.inputs);
        if !row.is_recorded {
            return;
        }
        self.time_s.push(row.raw.time_s);
        self.is_disturbed.push(estimator.detector().flag());
        for estimate in numbers.iter().filter_map(|number| estimates.get(*number as usize)) {
            self.force_n.extend(estimate.force.map(Force::newtons));
            let sigma = estimate.sigma.map_or([f64::NAN; 2], |sigma| sigma.map(Force::newtons));
            self.sigma_n.extend(sigma);
            self.is_valid.push(estimate.validity == Validity::Valid);
        }
    }
}

/// The thread of a device: serves jobs until it is no longer asked.
fn serve(
    built: &DeviceModel,
    networks: Option<&NetworkSet>,
    jobs: &Receiver<Job>,
    answers: &Sender<Result<Estimates>>,
) {
    let models = ReplayModels { networks, ..ReplayModels::of(built) };
    let compensations: Vec<Compensation> = models.compensation_views();
    let tables = models.tables.tables(&compensations);
    let start = || Estimator::new(&tables, networks.map(NetworkSet::start));
    let mut estimator = start();
    for job in jobs {
        let mut estimates = Estimates::default();
        let mut push =
            |estimator: &mut _, row: &DeviceRow| estimates.push(estimator, models.numbers, row);
        let done = match job {
            Job::Reset => {
                estimator = start();
                Ok(())
            }
            Job::Rows(columns) => {
                rows(&models, columns).map(|rows| rows.for_each(|row| push(&mut estimator, &row)))
            }
            Job::Recording(folder, delay_ms) => {
                estimator = start();
                let alignment = built.model.alignment(delay_ms);
                recorded(&models, &folder, alignment).and_then(|rows| {
                    for row in rows {
                        push(&mut estimator, &row?);
                    }
                    Ok(())
                })
            }
        };
        if answers.send(done.map(|()| estimates)).is_err() {
            return;
        }
    }
}

fn recorded(models: &ReplayModels, folder: &Path, alignment: Alignment) -> Result<RecordedRows> {
    let rows = models.rows(RawStream::open_folder(folder, alignment)?);
    if rows.sensors().len() < models.numbers.len() {
        bail!(
            "{}: a sensor of the model has no field or no force in this recording; give its columns as arrays instead",
            folder.display()
        );
    }
    check_temperatures(models, rows.sensors())?;
    Ok(rows)
}

/// A sensor of the board always has its temperature, so that the device's code does not notice where it is missing.
fn check_temperatures(models: &ReplayModels, sensors: &[SensorChannels]) -> Result<()> {
    if !models.compensations.iter().any(OwnedCompensation::needs_temperature) {
        return Ok(());
    }
    match sensors.iter().find(|channels| channels.temperature.is_none()) {
        Some(SensorChannels { number, .. }) => bail!(
            "s{number}_temp_c is missing: the model compensates an effect of the sensor's temperature (in degrees Celsius)"
        ),
        None => Ok(()),
    }
}

/// The device's filters and networks advance by one step with each row.
fn check_rate(time_s: &[f64]) -> Result<()> {
    // Without a clock the rows are at the device's rate.
    let steps_s = time_s.windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps_s: Vec<f64> = steps_s.filter(|step_s| step_s.is_finite()).collect();
    steps_s.sort_by(f64::total_cmp);
    let tick_s = 1e-6 * constants::TICK_US as f64;
    match steps_s.get(steps_s.len() / 2) {
        Some(median_s) if !(0.5..1.5).contains(&(median_s / tick_s)) => bail!(
            "the rows are {:.3} ms apart, and the device has one every {:.0} ms: interpolate the columns at that rate, or write a recording and use run_recording, which does",
            1e3 * median_s,
            1e3 * tick_s
        ),
        _ => Ok(()),
    }
}

/// Rows of these columns as inputs of the device.
fn rows<'a>(
    models: &'a ReplayModels,
    columns: Columns,
) -> Result<impl Iterator<Item = DeviceRow> + use<'a>> {
    let count = columns.values().next().map_or(0, Vec::len);
    let mut hall = Vec::new();
    let mut values = Vec::new();
    let mut time_s = vec![f64::NAN; count];
    for (name, mut column) in columns {
        if column.len() != count {
            bail!("{name} has {} rows, another column {count}", column.len());
        }
        if let Some(row) = column.iter().position(|value| !value.is_finite()) {
            bail!(
                "{name}, row {row}: the device has no such value; leave rows with missing values out"
            );
        }
        match hall_column(&name, &[]).map_err(|error| anyhow!("{name}: {error}"))? {
            HallColumn::Time => time_s = column.iter().map(|t_us| 1e-6 * t_us).collect(),
            parsed => {
                if matches!(parsed, HallColumn::Field { unit: FieldUnit::Lsb, .. }) {
                    column.iter_mut().for_each(|counts| *counts *= models.gauss_per_lsb);
                }
                hall.push(parsed);
                values.push(column);
            }
        }
    }
    let forces = models.forces.iter().flatten().flatten();
    let forces = forces.map(|&(sensor, axis)| ForceColumn::Force { sensor, axis }).collect();
    let layout = ChannelLayout { hall, forces };
    let channels = models.channels(&layout);
    if let Some(number) =
        models.numbers.iter().find(|number| layout.field_channels(**number).is_none())
    {
        bail!(
            "the field of sensor {number} is missing: give s{number}_x_gauss, s{number}_y_gauss and s{number}_z_gauss, or counts as s{number}_x_lsb ..."
        );
    }
    check_temperatures(models, channels.sensors())?;
    check_rate(&time_s)?;
    let references = vec![f64::NAN; layout.forces.len()];
    Ok((0..count).map(move |row| {
        channels.row(RawRow {
            time_s: time_s[row],
            hall: values.iter().map(|column| column[row]).collect(),
            forces: references.clone(),
        })
    }))
}
