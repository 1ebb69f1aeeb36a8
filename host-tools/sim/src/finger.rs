//! One sensor's finger: manufactured dimensions, and the magnet's pose under load.

use crate::effects::Effects;
use crate::effects::uncatalogued_kinds::SCREW_RIPPLE;
use crate::flexure::{Flexure, FlexureParameters, REFERENCE_MM};
use crate::random::{Purpose, normal, normal_vector, stream};
use model_export::effects::catalogue::{
    CREEP, CROSS_COUPLING, FINGERTIP_MASS, GEOMETRIC_STIFFENING, HARD_STOP, SOFTENING, THERMAL_GAP,
    TIP_SLOPE, VISCOUS_LAG,
};
use model_export::physics::sensor::{magnet_orientation, reach_mm};
use model_export::physics::{Magnet, SensorMounting, SensorOrientation};
use model_export::recordings::description::NominalDesign;
use nalgebra::{Rotation3, Vector3};
use serde::Serialize;

/// Ratio of the cross-coupling from Fx to Fz to that from Fz to Fx.
const CROSS_BACK: f64 = -0.4;

/// Load at which the stop engages, as a share of the axis' maximum load.
const KNEE: f64 = 0.6;

/// A cantilever of length L, bent by w at its end, is 0.6 w^2/L shorter and ends at a slope of
/// 1.5 w/L (small deflections of a beam under a load at its end).
const FORESHORTENING: f64 = 0.6;
const END_SLOPE: f64 = 1.5;

/// A finger with the state of its flexures.
#[derive(Clone, Debug)]
pub struct SensorFinger {
    specimen: SensorSpecimen,
    flexures: [Flexure; 2],
    coupling: f64,
    mass_kg: f64,
    foreshortening_mm: f64,
    gap_mm_per_k: f64,
    ripple_mm: f64,
}

/// Position and orientation of a magnet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetPose {
    /// Centre relative to the Hall element, gripper axes, in mm.
    pub centre_mm: Vector3<f64>,
    /// Rotation from the magnet's frame (z is the body axis) to the gripper's.
    pub rotation: Rotation3<f64>,
}

impl MagnetPose {
    /// Field at the Hall element per tesla of remanence, gripper axes, in gauss.
    pub fn unit_field(&self, magnet: &Magnet) -> Vector3<f64> {
        self.rotation * magnet.unit_field(self.rotation.inverse() * -self.centre_mm)
    }
}

impl SensorFinger {
    /// A finger that has never been loaded; `max_n` are its maximum loads.
    pub fn new(specimen: &SensorSpecimen, effects: &Effects, max_n: [f64; 2]) -> Self {
        let of = |id: &str| effects.each(id, specimen.number);
        let friction_n = effects.friction_n(specimen.number);
        let lag_s = 1e-3 * of(VISCOUS_LAG.id);
        let flexure = |axis: usize, lag_s: f64| {
            Flexure::new(FlexureParameters {
                stiffness_n_per_mm: specimen.stiffness_n_per_mm[axis],
                stiffening: 0.01 * of(GEOMETRIC_STIFFENING.id),
                stop: (KNEE * max_n[axis], 0.01 * of(HARD_STOP.id)),
                friction_n: friction_n[axis],
                lag_s,
                creep: (0.01 * of(CREEP.id), effects.creep_s),
                softening: (0.01 * of(SOFTENING.id), effects.softening_cycles),
            })
        };
        Self {
            specimen: specimen.clone(),
            flexures: [flexure(0, lag_s), flexure(1, 0.5 * lag_s)],
            coupling: 0.01 * of(CROSS_COUPLING.id),
            mass_kg: of(FINGERTIP_MASS.id),
            foreshortening_mm: 1e-3 * of(TIP_SLOPE.id),
            gap_mm_per_k: 1e-3 * of(THERMAL_GAP.id),
            ripple_mm: 1e-3 * of(SCREW_RIPPLE.id),
        }
    }

    /// Advances by `dt_s` to these loads in N and this specific force in m/s^2.
    pub fn step(&mut self, [fx, fz]: [f64; 2], specific_force: Vector3<f64>, dt_s: f64) {
        let inertia = self.mass_kg * specific_force;
        let [lateral, longitudinal] = &mut self.flexures;
        lateral.step(fx + self.coupling * fz + inertia.x, dt_s);
        longitudinal.step(fz + CROSS_BACK * self.coupling * fx + inertia.z, dt_s);
    }

    /// Whether accelerations deflect the flexures.
    pub fn has_mass(&self) -> bool {
        self.mass_kg != 0.0
    }

    /// Pause without load, in seconds.
    pub fn pause(&mut self, seconds: f64) {
        for flexure in &mut self.flexures {
            flexure.pause(seconds);
        }
    }

    /// Load cycles of both flexures since the start of the campaign.
    pub fn cycles(&self) -> [u32; 2] {
        [self.flexures[0].cycles(), self.flexures[1].cycles()]
    }

    /// Pose of the magnet, `warm_k` above the reference temperature, after `screw_turns` of the screw.
    pub fn magnet(&self, warm_k: f64, screw_turns: f64) -> MagnetPose {
        let [x, z] = [self.flexures[0].at_mm(), self.flexures[1].at_mm()];
        let shorter = self.foreshortening_mm * ((x * x + z * z) / REFERENCE_MM.powi(2));
        let gap = self.specimen.gap_mm + self.gap_mm_per_k * warm_k - shorter;
        let ripple = self.ripple_mm * libm::sin(std::f64::consts::TAU * screw_turns);
        let [offset_x, offset_z] = self.specimen.offset_mm;
        let [tilt_x, tilt_z] = self.specimen.tilt_rad;
        MagnetPose {
            centre_mm: Vector3::new(
                offset_x + x,
                gap + self.specimen.reach_mm,
                offset_z + z + ripple,
            ),
            rotation: self.tilt(x, z)
                * Rotation3::from_scaled_axis(Vector3::new(tilt_x, 0.0, tilt_z))
                * self.specimen.upright,
        }
    }

    /// Slope of the beams' ends: the magnet's y axis tilts in the direction of the deflection.
    fn tilt(&self, x: f64, z: f64) -> Rotation3<f64> {
        let per_length = self.foreshortening_mm / (FORESHORTENING * REFERENCE_MM.powi(2));
        let [slope_x, slope_z] = [x, z].map(|w| libm::atan(END_SLOPE * w * per_length));
        Rotation3::from_scaled_axis(Vector3::new(slope_z, 0.0, -slope_x))
    }
}

/// Standard deviations of manufacture, assumed of careful manual work.
const STIFFNESS: f64 = 0.05;
const REMANENCE: f64 = 0.02;
const GAP_MM: f64 = 0.05;
const OFFSET_MM: f64 = 0.05;
const TILT_DEG: f64 = 1.0;
const ROTATION_DEG: f64 = 0.7;
const BIAS_G: f64 = 2.0;

/// Manufactured dimensions of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorSpecimen {
    /// Its number.
    pub number: u32,
    /// Stiffness of the lateral and the longitudinal flexure.
    pub stiffness_n_per_mm: [f64; 2],
    /// Orientation of the element, in addition to its rotation vector.
    #[serde(skip_serializing_if = "SensorOrientation::is_nominal")]
    pub orientation: SensorOrientation,
    /// Remanence of the magnet; of the other sign than the design's where its poles are exchanged.
    pub remanence_t: f64,
    /// Distance from the magnet's face to the element.
    pub gap_mm: f64,
    /// Position error of the magnet along x and z.
    pub offset_mm: [f64; 2],
    /// Tilt of the magnet's axis about x and z.
    pub tilt_rad: [f64; 2],
    /// Rotation vector of the element against the gripper.
    pub rotation_rad: [f64; 3],
    /// Offset of the element, in its axes.
    pub bias_g: [f64; 3],
    /// Nominal magnet.
    #[serde(skip)]
    pub magnet: Magnet,
    /// Rotation from the magnet's frame to the gripper's, before the tilt.
    #[serde(skip)]
    pub upright: Rotation3<f64>,
    /// Distance from its centre to its face, in mm.
    #[serde(skip)]
    pub reach_mm: f64,
}

impl SensorSpecimen {
    /// Draws a sensor; `scatter` multiplies all deviations, 0 is nominal.
    pub fn draw(design: &NominalDesign, number: u32, seed: u64, scatter: f64) -> Self {
        let mut rng = stream(seed, Purpose::Scatter, number);
        let (magnet, axis) = (Magnet::of(&design.magnet), design.magnet.axis);
        let body_axis = design.magnet.body_axis.unwrap_or(axis);
        let mut deviate = |deviation: f64| scatter * deviation * normal(&mut rng);
        Self {
            number,
            orientation: SensorOrientation::default(),
            stiffness_n_per_mm: [
                design.stiffness_x_n_per_mm * (1.0 + deviate(STIFFNESS)),
                design.stiffness_z_n_per_mm * (1.0 + deviate(STIFFNESS)),
            ],
            remanence_t: design.magnet.remanence_t * (1.0 + deviate(REMANENCE)),
            gap_mm: design.gap_mm + deviate(GAP_MM),
            offset_mm: [deviate(OFFSET_MM), deviate(OFFSET_MM)],
            tilt_rad: [deviate(TILT_DEG), deviate(TILT_DEG)].map(f64::to_radians),
            rotation_rad: (normal_vector(&mut rng) * (scatter * ROTATION_DEG).to_radians()).into(),
            bias_g: (normal_vector(&mut rng) * scatter * BIAS_G).into(),
            upright: magnet_orientation(&magnet, axis, body_axis),
            reach_mm: reach_mm(&magnet, axis, body_axis),
            magnet,
        }
    }

    /// The sensor in this mounting.
    pub fn mounted(self, mounting: SensorMounting) -> Self {
        let sign = if mounting.is_reversed { -1.0 } else { 1.0 };
        let orientation = mounting.orientation;
        Self { orientation, remanence_t: sign * self.remanence_t, ..self }
    }

    /// The element's rotation vector.
    pub fn rotation(&self) -> Vector3<f64> {
        Vector3::from(self.rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::physics::ForwardModel;
    use model_export::recordings::description::NominalDesign;

    fn finger(ids: &[&str], scatter: f64) -> (SensorSpecimen, SensorFinger) {
        let specimen = SensorSpecimen::draw(&NominalDesign::magpie(), 0, 5, scatter);
        let ids: Vec<_> = ids.iter().map(|id| id.parse().unwrap()).collect();
        let effects = Effects::new(&ids, 5, 1, 0.0).unwrap();
        let finger = SensorFinger::new(&specimen, &effects, [200.0; 2]);
        (specimen, finger)
    }

    #[test]
    fn field_without_effects_equals_the_forward_model() {
        let (specimen, mut finger) = finger(&[], 1.0);
        let model = ForwardModel {
            stiffness_n_per_mm: specimen.stiffness_n_per_mm,
            gap_mm: specimen.gap_mm,
            offset_mm: specimen.offset_mm,
            tilt_rad: specimen.tilt_rad,
            ..ForwardModel::nominal(&NominalDesign::magpie())
        };
        for load in [[0.0, 0.0], [150.0, -80.0], [-200.0, 190.0]] {
            finger.step(load, Vector3::zeros(), 1e-3);
            let own = finger.magnet(0.0, 0.0).unit_field(&specimen.magnet) * 1.2;
            assert!((own - model.field(load)).amax() < 1e-6, "{own}");
        }
    }

    #[test]
    fn tip_slope_foreshortens_and_tilts_the_magnet() {
        let (_, mut finger) = finger(&["tip_slope"], 0.0);
        finger.step([250.0, 0.0], Vector3::zeros(), 1e-3);
        let pose = finger.magnet(0.0, 0.0);
        assert!((pose.centre_mm - Vector3::new(0.5, 2.495, 0.0)).amax() < 1e-9);
        let axis = pose.rotation * Vector3::z();
        assert!((axis.x / axis.y - 1.5 * 0.5 / 30.0).abs() < 1e-9, "{axis}");
    }

    #[test]
    fn fingertip_weight_deflects_the_longitudinal_flexure() {
        let (_, mut finger) = finger(&["fingertip_mass"], 0.0);
        finger.step([0.0; 2], Vector3::new(0.0, 0.0, 9.81), 1e-3);
        let z = finger.magnet(0.0, 0.0).centre_mm.z;
        assert!((z * 800.0 - 0.981).abs() < 1e-9);
    }

    #[test]
    fn cross_coupling_acts_in_both_directions() {
        let (_, mut finger) = finger(&["cross_coupling=2"], 0.0);
        finger.step([100.0, 50.0], Vector3::zeros(), 1e-3);
        let at = finger.magnet(0.0, 0.0).centre_mm;
        assert!((at.x * 500.0 - 101.0).abs() < 1e-9 && (at.z * 800.0 - 49.2).abs() < 1e-9);
    }

    #[test]
    fn gap_grows_with_temperature_and_ripple_moves_the_magnet() {
        let (_, finger) = finger(&["thermal_gap", "screw_ripple"], 0.0);
        let at = finger.magnet(10.0, 0.25).centre_mm;
        assert!((at - Vector3::new(0.0, 2.505, 0.002)).amax() < 1e-12);
    }

    #[test]
    fn sensor_without_scatter_is_nominal() {
        let specimen = SensorSpecimen::draw(&NominalDesign::magpie(), 2, 7, 0.0);
        assert_eq!(specimen.stiffness_n_per_mm, [500.0, 800.0]);
        assert_eq!((specimen.gap_mm, specimen.bias_g), (1.5, [0.0; 3]));
    }

    #[test]
    fn sensors_differ_and_are_reproducible() {
        let specimen = |number| SensorSpecimen::draw(&NominalDesign::magpie(), number, 7, 1.0);
        assert_eq!(specimen(0), specimen(0));
        assert_ne!(specimen(0).gap_mm, specimen(1).gap_mm);
    }
}
