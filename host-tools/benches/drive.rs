//! The drive's figures over scattered grippers, and how fast it is simulated on one core.
//! `cargo bench -p host-tools --bench drive [-- --seeds N]`

use firmware::motor::Setpoint;
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::closed_loop::motor_rig::{self, MotorRig};
use sim::closed_loop::{self, ClosedLoop, ClosedLoopSetup, requirements};
use sim::drivetrain::parameters::{Lead, PlantParameters, SCATTER};

/// Time of the drive that is simulated to see how long that takes.
const SECONDS: f64 = 20.0;

fn main() {
    let mut arguments = std::env::args().skip_while(|argument| argument != "--seeds");
    let seeds: u64 = arguments.nth(1).map_or(20, |seeds| seeds.parse().expect("a number"));
    println!("{}", requirements::table_text(seeds));
    println!(
        "The worst of the gripper on the card and of {seeds} whose motor, bus, friction, play and \
         stiffness are off by up to {:.0} % each; speed, force and brake of the one on the card.\n",
        100.0 * SCATTER
    );
    for lead in Lead::BOTH {
        println!("screw {lead:?}: {:.1} times real time on one core", speed(lead));
        println!(
            "screw {lead:?} with sensors, board and host: {:.1} times real time on one core",
            whole_speed(lead)
        );
    }
}

/// The same of a whole gripper that grips over the bus and holds.
fn whole_speed(lead: Lead) -> f64 {
    let plan = ClosedLoopSetup::nominal(lead, 42.0, 1);
    let tables = closed_loop::nominal_tables().expect("tables of the design");
    let mut cell = ClosedLoop::new(&plan, &tables);
    let object = contact_object(&plan.plant, 40.0, 333.0);
    cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
    assert!(cell.enable());
    cell.host.order(grip_command(100.0));
    let start_s = on_cpu_s();
    cell.run(SECONDS);
    SECONDS / (on_cpu_s() - start_s)
}

/// How many times as fast as real time a drive that goes to and fro is simulated.
fn speed(lead: Lead) -> f64 {
    let mut rig = MotorRig::armed(lead, PlantParameters::nominal(lead), 40.0, 1);
    let start_s = on_cpu_s();
    for way in 0..(2.0 * SECONDS) as u32 {
        let setpoint = Setpoint::Position {
            opening_mm: if way % 2 == 0 { 30.0 } else { 50.0 },
            speed_mm_s: lead.closing_mm_s() as f32,
            max_a: motor_rig::MAX_A as f32,
        };
        rig.run_setpoint(setpoint, 0.5);
    }
    SECONDS / (on_cpu_s() - start_s)
}

/// Seconds for which this thread has run, whatever else the machine does.
fn on_cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells");
    let first = text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
    1e-9 * first.expect("nanoseconds")
}
