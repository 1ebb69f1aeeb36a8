//! `model.toml`: a fitted model with standard errors, nominal design and provenance, human-readable. The device
//! uses exported tables instead.

use std::collections::BTreeSet;
use std::path::Path;

use firmware::config::constants::{self, FORCE_RANGE};
use serde::{Deserialize, Serialize};

use crate::effects::{EffectTerm, ErrorOrigin, FinalState};
use crate::error::{ErrorKind, closest_match};
use crate::fit::campaign::FitSetup;
use crate::fit::joint::{JointFit, SensorFit};
use crate::fit::parameters::{self, PARAMETERS};
use crate::fit::rows::SensorRows;
use crate::fit::{CampaignFits, FitError, FitOptions};
use crate::input::{
    self, MAX_EFFECTS, MAX_MAGNITUDE, MAX_SENSORS, check_plausible, plausible_range,
};
use crate::inverse::grbf::{GrbfShape, MAX_CENTRES_ACROSS};
use crate::inverse::static_model::ForcePolynomial;
use crate::output::{FileSignature, NamedInputs, Output, write_output};
use crate::physics::{ForwardModel, SensorMounting};
use crate::recordings::align::Alignment;
use crate::recordings::description::{NominalDesign, parse_toml};
use crate::recordings::recording::recording_name;
use crate::recordings::{Campaign, DataError, Location};

mod effects;
mod predictor;
mod sensor;

pub use crate::fit::base_model::BaseKind;
pub use effects::{EffectModel, SensorEffect};
pub use predictor::{FieldPrediction, Predictor, RowCorrection};
pub use sensor::{
    CorrelationTable, FittedValue, HeldOutError, PolynomialTable, SensorModel,
    UnidentifiableCombination,
};

/// Format version. Raised where a key is removed, or changes its meaning or unit: earlier files are then refused, and users
/// repeat the fit. Neither an effect nor an optional key with a default raises it. The format of a calibration on the board
/// has a number of its own, `VERSION` in `firmware/src/model/calibration.rs`.
pub const FORMAT: i64 = 1;

/// First line of every generated file of tables.
pub const TABLES_MARK: &str = "// Written by `magpie dev export`.";

/// First line of every model file.
const FIRST_LINE: &str = "# A magpie model, written by `magpie fit`.";

/// Identifies model files; their inputs are [`ModelFile::inputs`].
pub const SIGNATURE: FileSignature<'static> = FileSignature {
    offset: 0,
    text: FIRST_LINE,
    inputs: NamedInputs::Content(|bytes| {
        let model: ModelFile = toml::from_str(str::from_utf8(bytes).ok()?).ok()?;
        Some(model.inputs())
    }),
};

/// Fitted model of one gripper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Format version, [`FORMAT`].
    pub format: i64,
    /// Base model of the field.
    pub base: BaseKind,
    /// Source of the numbers.
    pub provenance: Provenance,
    /// Scale and range of the Hall sensors.
    pub sensor_scale: SensorScale,
    /// Nominal design; absent with the polynomial base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<NominalDesign>,
    /// Shape of the inverse with which the held-out force error was evaluated; selected anew for the tables where it is absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inverse: Option<GrbfShape>,
    /// One entry for each sensor.
    #[serde(rename = "sensor")]
    pub sensors: Vec<SensorModel>,
    /// Effects in addition to the base.
    #[serde(default, rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectModel>,
}

impl ModelFile {
    /// Largest force of each axis, either sign, in newtons: that of the design, or of the forces that polynomials were fitted to.
    pub fn force_range_n(&self) -> f64 {
        let spans = self.sensors.iter().filter_map(|sensor| sensor.polynomial.as_ref());
        let limits =
            spans.flat_map(|table| &table.spans_n).map(|(low, high)| low.abs().max(high.abs()));
        let fitted_n = limits.fold(0.0, f64::max);
        match &self.design {
            Some(design) => design.force_range_n(),
            None if fitted_n > 0.0 => fitted_n,
            None => FORCE_RANGE.value,
        }
    }

    /// The model of a fit without effects.
    pub fn of(campaign: &Campaign, fits: &CampaignFits, provenance: Provenance) -> Self {
        let (base, design, sensors): (_, _, Vec<SensorModel>) = match fits {
            CampaignFits::Cylinder(design, fit) => (
                BaseKind::Cylinder,
                Some(design.clone()),
                fit.sensors.iter().map(|fit| SensorModel::of_cylinder(fit, &[], 0)).collect(),
            ),
            CampaignFits::Polynomial(fits) => {
                (BaseKind::Polynomial, None, fits.iter().map(SensorModel::of_polynomial).collect())
            }
        };
        Self {
            format: FORMAT,
            base,
            provenance,
            sensor_scale: SensorScale::of(campaign, base),
            design,
            inverse: None,
            sensors,
            effects: Vec::new(),
        }
    }

    /// The model of a fit with effects.
    pub fn with_effects(
        campaign: &Campaign,
        prepared: &FitSetup,
        fit: &JointFit,
        effects: &[EffectTerm],
        provenance: Provenance,
    ) -> Self {
        let sensor = |(i, fit): (usize, &SensorFit)| match prepared.polynomials.get(i) {
            None => SensorModel::of_cylinder(fit, effects, campaign.recordings.len()),
            Some(start) => {
                let recordings = campaign.recordings.len();
                SensorModel::of_polynomial_with_effects(start, fit, effects, recordings)
            }
        };
        let base =
            if prepared.design.is_some() { BaseKind::Cylinder } else { BaseKind::Polynomial };
        Self {
            format: FORMAT,
            base,
            provenance,
            sensor_scale: SensorScale::of(campaign, base),
            design: prepared.design.clone(),
            inverse: None,
            sensors: with_final_states(
                fit.sensors.iter().enumerate().map(sensor).collect(),
                &prepared.rows,
                effects,
            ),
            effects: EffectModel::all_of(fit, effects, campaign.recordings.len()),
        }
    }

    /// Rows of `campaign` and base models for a fit with this model's base.
    ///
    /// # Errors
    /// The recordings are not sufficient for this base.
    pub fn fit_setup(
        &self,
        campaign: &Campaign,
        options: FitOptions,
    ) -> Result<FitSetup, FitError> {
        match self.base {
            BaseKind::Cylinder => {
                FitSetup::cylinder_mounted(campaign, |number| self.mounting(number))
            }
            BaseKind::Polynomial => FitSetup::polynomial(campaign, self.degree(), options),
        }
    }

    /// Degree of the polynomials; `None` with the cylinder base.
    pub fn degree(&self) -> Option<usize> {
        self.sensors.iter().map(|sensor| Some(sensor.polynomial.as_ref()?.degree)).max()?
    }

    /// Whether the field of any sensor depends on a force.
    pub fn has_force_input(&self) -> bool {
        let is_constant = |sensor: &SensorModel| {
            sensor.polynomial.as_ref().is_some_and(|table| table.forces.is_empty())
        };
        !self.sensors.iter().all(is_constant)
    }

    /// The effects, validated.
    pub fn effect_terms(&self, path: &Path) -> Result<Vec<EffectTerm>, DataError> {
        let term = |effect: &EffectModel| {
            effect.term().map_err(|advice| {
                let kind = ErrorKind::bad_value(effect.name.as_str(), advice);
                kind.at(Location::file(path).column("effect"))
            })
        };
        self.effects.iter().map(term).collect()
    }

    /// Reads and validates a model file.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        if path.is_dir() {
            return Err(ErrorKind::ModelIsFolder.at(Location::file(path)));
        }
        if path.extension().is_some_and(|extension| extension == "safetensors") {
            return Err(ErrorKind::NetworkForModel.at(Location::file(path)));
        }
        let text = input::read_text(path)?;
        if text.starts_with(TABLES_MARK) {
            return Err(ErrorKind::TablesForModel.at(Location::file(path)));
        }
        let is_model =
            |table: &toml::Table| table.contains_key("base") && table.contains_key("sensor");
        // The format first: another one has other keys.
        if let Ok(table) = text.parse::<toml::Table>() {
            if !is_model(&table) {
                return Err(ErrorKind::NotAModel.at(Location::file(path)));
            }
            let format = table.get("format").and_then(toml::Value::as_integer);
            if let Some(format) = format.filter(|format| *format != FORMAT) {
                let advice = format!("this tool reads format = {FORMAT}: repeat the fit");
                let kind = ErrorKind::bad_value(format.to_string(), advice);
                return Err(kind.at(Location::file(path).column("format")));
            }
        }
        let model: Self = parse_toml(path, &text)?;
        model.check(path)?;
        Ok(model)
    }

    fn check(&self, path: &Path) -> Result<(), DataError> {
        let location = |key: String| Location::file(path).column(key);
        let bad = |key: String, found: String, advice: &str| {
            Err(ErrorKind::bad_value(found, advice).at(location(key)))
        };
        if self.base == BaseKind::Cylinder && self.design.is_none() {
            let example = "the [design] table of the recordings";
            return Err(ErrorKind::MissingKey { example }.at(location("design".to_owned())));
        }
        let scale = [
            ("sensor_scale.gauss_per_lsb", self.sensor_scale.gauss_per_lsb),
            ("sensor_scale.range_gauss", self.sensor_scale.range_gauss),
        ];
        let design = self.design.as_ref().map_or_else(Vec::new, NominalDesign::positive_values);
        for (key, value) in scale.into_iter().chain(design) {
            if !(value.is_finite() && value > 0.0) {
                return bad(
                    key.to_owned(),
                    format!("{value:?}"),
                    "give a positive number, or repeat the fit",
                );
            }
            check_plausible(key, value).map_err(|kind| kind.at(location(key.to_owned())))?;
        }
        for (key, count, max) in [
            ("sensor", self.sensors.len(), MAX_SENSORS),
            ("effect", self.effects.len(), MAX_EFFECTS),
        ] {
            if count > max {
                let advice = format!("the limit is {max}: repeat the fit");
                return bad(key.to_owned(), format!("{count} entries"), &advice);
            }
        }
        for effect in &self.effects {
            let parameters = effect.sensors.iter().flat_map(|sensor| &sensor.parameters);
            if let Some((name, value)) = parameters
                .map(|(name, value)| (name, value.value))
                .find(|(_, value)| !(-MAX_MAGNITUDE..=MAX_MAGNITUDE).contains(value))
            {
                let key = format!("{name} of {}", effect.name);
                return bad(key, format!("{value:?}"), "correct it, or add the effect again");
            }
        }
        if let Some(shape) = self.inverse {
            let advice = "remove the table [inverse]: it is then selected again";
            let positive = [("inverse.gamma", shape.gamma), ("inverse.ridge", shape.ridge)];
            for (key, value) in positive {
                if !(1e-12..=1e6).contains(&value) {
                    return bad(key.to_owned(), format!("{value:?}"), advice);
                }
            }
            if !(2..=MAX_CENTRES_ACROSS).contains(&shape.centres_across) {
                let found = shape.centres_across.to_string();
                return bad("inverse.centres_across".to_owned(), found, advice);
            }
        }
        let mut numbers = BTreeSet::new();
        for sensor in &self.sensors {
            let key = |name: &str| format!("{name} of sensor {}", sensor.number);
            if !numbers.insert(sensor.number) {
                return bad(
                    key("number"),
                    sensor.number.to_string(),
                    "duplicate number: use the sensor numbers of the recordings",
                );
            }
            if sensor.correlation.as_ref().is_some_and(|table| !table.is_complete()) {
                return bad(
                    key("correlation"),
                    "not one value from -1 to 1 for each pair".to_owned(),
                    "remove this table, or repeat the fit",
                );
            }
            if self.base == BaseKind::Polynomial {
                if sensor.polynomial().is_none() {
                    return bad(
                        key("polynomial"),
                        "a table inconsistent with its degree".to_owned(),
                        "repeat the fit",
                    );
                }
                if !sensor.orientation.is_nominal() {
                    return bad(
                        key("orientation"),
                        sensor.orientation.to_string(),
                        "remove it: a polynomial is of the sensor's own axes",
                    );
                }
                continue;
            }
            let known = || PARAMETERS.iter().map(|parameter| parameter.name);
            let mut names = sensor.parameters.keys();
            if let Some(unknown) = names.find(|name| !known().any(|known| known == *name)) {
                let nearest = closest_match(unknown, known());
                let advice = nearest.map_or_else(
                    || "there is no such parameter: remove it".to_owned(),
                    |nearest| format!("did you mean {nearest}?"),
                );
                return bad(key("parameters"), unknown.clone(), &advice);
            }
            for parameter in &PARAMETERS {
                let Some(value) = sensor.parameters.get(parameter.name).map(|value| value.value)
                else {
                    let example = "it in the form written by `cargo magpie fit`, or repeat the fit";
                    return Err(ErrorKind::MissingKey { example }.at(location(key(parameter.name))));
                };
                let must_be_positive =
                    parameter.name == "gap" || parameter.name.starts_with("stiffness");
                let (min, max) = plausible_range(parameter.name);
                let min = match parameter.name {
                    "remanence" => min,
                    _ if must_be_positive => 1e-9,
                    _ => 0.0,
                };
                let is_plausible = (min..=max).contains(&value.abs());
                if !is_plausible || (must_be_positive && value <= 0.0) {
                    return bad(
                        key(parameter.name),
                        format!("{value:?}"),
                        "correct it, or repeat the fit",
                    );
                }
            }
        }
        Ok(())
    }

    /// The alignment of recordings with their reference: with a delay that the user gives, otherwise as in the fit.
    pub fn alignment(&self, given_ms: Option<f64>) -> Alignment {
        Alignment { delay_us: 1e3 * given_ms.unwrap_or(self.provenance.delay_ms) }
    }

    /// What the model was written from: the recordings, and the effects that the user chose.
    pub fn inputs(&self) -> Vec<String> {
        let recordings = self.provenance.recordings.iter().map(|fitted| fitted.sha256.clone());
        recordings.chain(self.effects.iter().map(|effect| effect.name.clone())).collect()
    }

    /// Writes the file; see [`write_output`].
    pub fn write(&self, path: &Path) -> Result<(), DataError> {
        write_output(path, self.to_toml(path)?.as_bytes(), SIGNATURE)
    }

    /// Writes the file of a command.
    pub fn write_output(&self, output: &Output) -> Result<(), DataError> {
        output.write(self.to_toml(output.path())?.as_bytes())
    }

    /// Content of the file; errors name `path`.
    pub fn to_toml(&self, path: &Path) -> Result<String, DataError> {
        toml::to_string(self)
            .map(|text| format!("{FIRST_LINE}\n{text}"))
            .map_err(|error| ErrorKind::Toml(error.to_string()).at(Location::file(path)))
    }

    /// Time of the state that the tables of a sensor hold.
    pub(crate) fn table_state(&self, number: u32) -> FinalState {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number);
        sensor.and_then(|sensor| sensor.final_state).unwrap_or(FinalState::ENDED)
    }

    /// Standard deviation in gauss of a sensor's residual that no force explains; without it, the held-out
    /// RMS error of the axis.
    pub fn residual_sigma(&self, number: u32, axis: usize) -> f64 {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number);
        let of_axis = |sensor: &SensorModel| sensor.held_out.get(axis).map(|score| score.rms_g);
        let sigma_g =
            sensor.and_then(|sensor| sensor.parity_residual_g.or_else(|| of_axis(sensor)));
        sigma_g.filter(|sigma_g| sigma_g.is_finite()).unwrap_or(0.0)
    }

    /// The polynomial of one sensor for its inversion; `None` where it has no force, or several along one axis.
    pub(crate) fn force_polynomial(&self, number: u32) -> Option<ForcePolynomial> {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let floor = sensor.held_out.iter().map(|score| score.floor_g.powi(2)).sum::<f64>();
        let floor_g = (floor / sensor.held_out.len().max(1) as f64).sqrt();
        let rounding_g = self.sensor_scale.gauss_per_lsb / 12.0_f64.sqrt();
        ForcePolynomial::new(sensor.polynomial()?, rounding_g.max(floor_g))
    }

    /// Whether the polynomial of every sensor can be inverted to one or two forces.
    pub fn has_force_polynomials(&self) -> bool {
        self.sensors.iter().all(|sensor| self.force_polynomial(sensor.number).is_some())
    }

    /// Mounting of a sensor; `None` for an unknown one. Its magnet is reversed where remanence and design differ in sign.
    pub fn mounting(&self, number: u32) -> Option<SensorMounting> {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let design = self.design.as_ref().map(|design| design.magnet.remanence_t);
        let fitted = sensor.parameters.get("remanence").map(|fitted| fitted.value);
        let is_reversed = design.zip(fitted).is_some_and(|(design, fitted)| design * fitted < 0.0);
        Some(SensorMounting { orientation: sensor.orientation, is_reversed })
    }

    /// The nominal design with the polarity of one sensor; `None` for a polynomial or an unknown sensor.
    pub fn nominal(&self, number: u32) -> Option<ForwardModel> {
        let nominal = ForwardModel::nominal(self.design.as_ref()?);
        Some(self.mounting(number)?.nominal(&nominal))
    }

    /// The forward model of one sensor; `None` for a polynomial or an unknown sensor.
    pub fn forward(&self, number: u32) -> Option<ForwardModel> {
        let nominal = self.nominal(number)?;
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let mut values = parameters::values(&nominal);
        for (value, parameter) in values.iter_mut().zip(&PARAMETERS) {
            *value = sensor.parameters.get(parameter.name)?.value;
        }
        Some(parameters::with_values(&nominal, &values))
    }
}

/// Sets the end of the campaign where an effect changes the gripper permanently.
fn with_final_states(
    mut sensors: Vec<SensorModel>,
    rows: &[SensorRows],
    effects: &[EffectTerm],
) -> Vec<SensorModel> {
    if effects.iter().any(|effect| effect.error_origin() == ErrorOrigin::History) {
        for sensor in &mut sensors {
            let own = rows.iter().find(|rows| rows.sensor == sensor.number);
            let last = own.and_then(|rows| rows.parts.last());
            sensor.final_state = last.and_then(|part| FinalState::of(&part.track));
        }
    }
    sensors
}

/// Source of a model's numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Name of the campaign's folder.
    pub campaign: String,
    /// Fitted recordings.
    pub recordings: Vec<FittedRecording>,
    /// Number of aligned rows of all recordings.
    pub rows: usize,
    /// Half the averaging window in milliseconds.
    pub half_window_ms: f64,
    /// Assumed delay of the reference in milliseconds.
    pub delay_ms: f64,
    /// Random seed of the bootstrap.
    pub seed: u64,
    /// Name and version of the tool.
    pub tool: String,
}

/// Identification of a fitted recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedRecording {
    /// Name of the folder.
    pub name: String,
    /// SHA-256 over the files.
    pub sha256: String,
    /// Date of the recording, if stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
}

impl Provenance {
    /// The provenance of a fit of `campaign` with these options.
    pub fn of(campaign: &Campaign, delay_us: f64, options: FitOptions) -> Result<Self, FitError> {
        let absolute = campaign.folder.canonicalize().unwrap_or_else(|_| campaign.folder.clone());
        let half_widths = campaign.recordings.iter().map(|r| r.half_width_s);
        Ok(Self {
            campaign: recording_name(&absolute),
            recordings: campaign
                .recordings
                .iter()
                .map(|recording| {
                    Ok(FittedRecording {
                        name: recording.name.clone(),
                        sha256: recording.sha256()?.to_owned(),
                        recorded: recording.description.recorded.clone(),
                    })
                })
                .collect::<Result<_, DataError>>()?,
            rows: campaign.recordings.iter().map(|r| r.time_s.len()).sum(),
            half_window_ms: 1e3 * half_widths.fold(0.0, f64::max),
            delay_ms: delay_us / 1e3,
            seed: options.seed,
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
        })
    }
}

/// Conversion from counts to gauss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorScale {
    /// Gauss per count.
    pub gauss_per_lsb: f64,
    /// Range of each axis in gauss, either sign.
    pub range_gauss: f64,
    /// True where the recordings do not state it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub assumed: bool,
}

/// Range of an assumed scale relative to the largest field: room for drift and for the fields of other loads.
const SCALE_MARGIN: f64 = 1.5;

impl SensorScale {
    /// The scale stated in the recordings, or that of the A31301. A polynomial describes any sensor: where no scale is stated, its
    /// scale is that of the A31301 by the power of two whose range contains the largest field of the campaign with a margin, so
    /// that the device's integers resolve fields of microteslas.
    pub fn of(campaign: &Campaign, base: BaseKind) -> Self {
        let description = campaign.recordings.first().map(|recording| &recording.description);
        let stated = description.and_then(|d| d.gauss_per_lsb.zip(d.range_gauss));
        let a31301 = (constants::SENSOR_SCALE.value, constants::SENSOR_RANGE.value);
        let factor = match base {
            BaseKind::Cylinder => 1.0,
            BaseKind::Polynomial => {
                scale_factor(SCALE_MARGIN * largest_field_g(campaign), a31301.1)
            }
        };
        let (gauss_per_lsb, range_gauss) = stated.unwrap_or((factor * a31301.0, factor * a31301.1));
        Self { gauss_per_lsb, range_gauss, assumed: stated.is_none() }
    }
}

/// Least power of two by which `range_g` contains `needed_g`.
fn scale_factor(needed_g: f64, range_g: f64) -> f64 {
    if needed_g > 0.0 { (needed_g / range_g).log2().ceil().exp2() } else { 1.0 }
}

fn largest_field_g(campaign: &Campaign) -> f64 {
    let sensors = campaign.recordings.iter().flat_map(|recording| recording.sensors.values());
    let fields = sensors.flat_map(|track| track.field_g.iter().flatten());
    fields.filter(|field| field.is_finite()).fold(0.0, |largest, field| largest.max(field.abs()))
}
