//! Figures of the drive over perturbed grippers, and the speed of the simulation on one core.

use anyhow::Result;
use firmware::motor::Setpoint;
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::closed_loop::motor_rig::{self, MotorRig};
use sim::closed_loop::requirements::{self, Requirement};
use sim::closed_loop::{self, ClosedLoop, ClosedLoopSetup};
use sim::drivetrain::parameters::{Lead, PlantParameters, SCATTER};

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 20, quick: 2 };
/// Simulated time of a speed measurement.
const SECONDS: f64 = 20.0;
/// Required multiple of real time on one core, of the motor rig.
const MIN_SPEED: f64 = 20.0;

/// Runs both screws.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let [a, b] = Lead::BOTH.map(|lead| {
        let mut figures = requirements::evaluate(lead, seeds.start..=seeds.end - 1);
        figures.push(Requirement {
            name: "real-time factor on one core",
            unit: "-",
            specified: [MIN_SPEED, f64::INFINITY],
            reached: motor_rig_speed(lead),
        });
        figures
    });
    let is_met = a.iter().chain(&b).all(Requirement::is_met);
    let rows = a.iter().zip(&b).map(|(a, b)| {
        let [minimum, maximum] = a.specified.map(limit);
        [a.name.to_owned(), a.unit.to_owned(), minimum, maximum, reached(a), reached(b)]
    });
    let [whole_a, whole_b] = Lead::BOTH.map(closed_loop_speed);
    let whole = [
        "the same with sensors, board and host".to_owned(),
        "-".to_owned(),
        "-".to_owned(),
        "-".to_owned(),
        format!("{:.1}", whole_a?),
        format!("{:.1}", whole_b?),
    ];
    Ok(Section {
        id: "drive",
        title: "Drive",
        extent: format!("{} and the nominal gripper, each with both screws", seeds_text(&seeds)),
        conditions: format!(
            "Motor, bus, friction, play and stiffness are perturbed by up to {:.0} %, unknown to the controller; speed, \
             force at rated current and the first two braking figures are of the nominal gripper, all others the worst \
             of all grippers. Screw A is self-locking, screw B is backdrivable. Motor constants are assumed.",
            100.0 * SCATTER
        ),
        tables: markdown_table(
            ["figure", "unit", "minimum", "maximum", "screw A", "screw B"],
            rows.chain([whole]),
        ),
        is_met: Some(is_met),
    })
}

fn limit(value: f64) -> String {
    if value.is_finite() { format!("{value:.2}") } else { "-".to_owned() }
}

fn reached(figure: &Requirement) -> String {
    let missed = if figure.is_met() { "" } else { " (not met)" };
    format!("{:.3}{missed}", figure.reached)
}

/// Multiple of real time of a whole gripper that grips over the bus.
fn closed_loop_speed(lead: Lead) -> Result<f64> {
    let setup = ClosedLoopSetup::nominal(lead, 42.0, 1);
    let tables = closed_loop::nominal_tables()?;
    let mut simulation = ClosedLoop::new(&setup, &tables);
    let object = contact_object(&setup.plant, 40.0, 333.0);
    simulation.gripper.borrow_mut().rig.plant.set_object(Some(&object));
    anyhow::ensure!(simulation.enable(), "the simulated gripper cannot be enabled");
    simulation.host.order(grip_command(100.0));
    let start_s = cpu_time_s();
    simulation.run(SECONDS);
    Ok(SECONDS / (cpu_time_s() - start_s))
}

/// Multiple of real time of a drive that moves to and fro.
fn motor_rig_speed(lead: Lead) -> f64 {
    let mut rig = MotorRig::armed(lead, PlantParameters::nominal(lead), 40.0, 1);
    let start_s = cpu_time_s();
    for stroke in 0..(2.0 * SECONDS) as u32 {
        let setpoint = Setpoint::Position {
            opening_mm: if stroke % 2 == 0 { 30.0 } else { 50.0 },
            speed_mm_s: lead.closing_mm_s() as f32,
            max_a: motor_rig::MAX_A as f32,
        };
        rig.run_setpoint(setpoint, 0.5);
    }
    SECONDS / (cpu_time_s() - start_s)
}

/// CPU time of this thread in seconds, independent of other processes.
fn cpu_time_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
    let first = text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
    1e-9 * first.expect("nanoseconds")
}
