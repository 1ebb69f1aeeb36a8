//! The steps.

use std::time::Duration;

use anyhow::{Result, bail};
use firmware::board::selected::table;
use firmware::config::constants;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TaskState, state_code};
use firmware::motor::as5047::diagnosis;
use firmware::parameters::schema::{counter, id};
use firmware::protocol::messages::Command;
use firmware::protocol::serial::Tick;
use firmware::sensors::hall::SENSORS;
use firmware::system::faults::Fault;

use super::gripper::Observed;
use super::step::{Action, BringUp, Reading, Step};
use crate::state::GripperState;

/// All steps.
pub const STEPS: [Step; 12] = [
    Step {
        name: "chip",
        connect: "3.3 V and the debugger's serial line; the motor supply is off.",
        expect: "device 469 (hexadecimal); option DBANK = 1, BFB2 = 0; crystal and store without a fault; chip {}; {} at the bus",
        ranges: &[table::CHIP_C, table::UNSUPPLIED_V],
        otherwise: "Set the option bytes with STM32CubeProgrammer and program the image again; check the crystal",
        run: chip,
    },
    Step {
        name: "lines",
        connect: "A CAN node that acknowledges, and terminators of 120 ohm at both ends.",
        expect: "in 1 s no frame without acknowledge, no broken packet",
        ranges: &[],
        otherwise: "Check the transceiver's standby input, the terminators and the baud rate of 3 Mbaud",
        run: lines,
    },
    Step {
        name: "sensors",
        connect: "The four Hall sensors and the thermistors; look at the rise times of both I2C buses (at most 120 ns).",
        expect: "answers at the two stated addresses of each bus, and no other between 0x60 and 0x6F; a constant configuration of each sensor; noise of {}; {} equal readings in a row; motor {}; a pressed finger moves its own two sensors at least three times as much as the others",
        ranges: &[table::NOISE, table::EQUAL_READINGS, table::MOTOR_C],
        otherwise: "Check address straps, pull-ups and the plugs of the fingers (sensors 0 and 1: finger 1), and the thermistors' wires",
        run: sensors,
    },
    Step {
        name: "rotor sensor",
        connect: "The AS5047P with its magnet.",
        expect: "offsets compensated, no MAGL, MAGH or overflow; gain {}; the angle follows the rotor by 30° to 150°; {} equal angles in a row",
        ranges: &[table::ENCODER_GAIN, table::EQUAL_ANGLES],
        otherwise: "Check the magnet, its distance (0.5 to 3 mm) and centre, and the wires of SPI1",
        run: rotor_sensor,
    },
    Step {
        name: "gates",
        connect: "The gate drivers; the motor supply stays off.",
        expect: "{} at the six gate inputs while the chip is held in reset",
        ranges: &[table::GATES_OFF_V],
        otherwise: "Fit the pull-downs at the gate inputs",
        run: gates,
    },
    Step {
        name: "break input",
        connect: "The power stage's fault output to PB12.",
        expect: "low with an open wire, high with the wire connected; {} at the gates after a halt of the core and during a dip of the 3.3 V rail",
        ranges: &[table::GATES_OFF_V],
        otherwise: "Fit the pull-up of at most 4.7 kilohm at the fault output; check that a halt stops TIM1",
        run: break_input,
    },
    Step {
        name: "supply",
        connect: "The motor supply: 12 V with a limit of 1 A.",
        expect: "{}; {} at rest; arming measures current offsets within 0.8 A",
        ranges: &[table::BENCH_V, table::REST_A],
        otherwise: "Check the divider of the bus voltage, the shunts' amplifiers and their reference",
        run: supply,
    },
    Step {
        name: "motor",
        connect: "The motor; the screw uncoupled.",
        expect: "current senses along the field; resistance within a factor of 1.6 of the data sheet, inductance of 1.8, torque constant of 1.5, inertia of 2; its pole pairs; dry friction at most 0.1 N m",
        ranges: &[],
        otherwise: "Exchanged or inverted current senses, the wrong motor, or a brake: correct it and repeat the step",
        run: motor,
    },
    Step {
        name: "speed",
        connect: "The screw coupled, nothing between or around the fingers, which are at least 10 mm from both ends.",
        expect: "opens at 3 to 7 mm/s for a second, without a fault",
        ranges: &[],
        otherwise: "A wrong sign or speed: check the parameter lead, and the coupling",
        run: speed,
    },
    Step {
        name: "homing",
        connect: "As before; the current is that of the bench, at most 2 A.",
        expect: "homed in 40 s, an opening within 1 mm of the stroke, without a fault, and without a dip of the 3.3 V rail below 2.8 V",
        ranges: &[],
        otherwise: "Check the stroke, the forces' signs (`cargo magpie monitor`) and the calibration",
        run: homing,
    },
    Step {
        name: "stop",
        connect: "As before; a hand at the supply's switch.",
        expect: "below 1.5 mm/s 0.5 s after a stop, and 0.7 s after the host has fallen silent",
        ranges: &[],
        otherwise: "Do not go on: the gripper must stop by itself",
        run: stop,
    },
    Step {
        name: "forces",
        connect: "As before; at first nothing touches the fingertips.",
        expect: "the weight within 15 %",
        ranges: &[],
        otherwise: "Calibrate the gripper (`cargo magpie record`, `fit`, `upload`) and repeat the step",
        run: forces,
    },
];

const SECOND: Duration = Duration::from_secs(1);

fn tenths(count: u32) -> Duration {
    SECOND / 10 * count
}

fn chip(doing: &mut BringUp<'_>) -> Result<()> {
    let chip = doing.gripper.read(counter::CHIP)?;
    doing.check("device", f64::from(chip & 0xFFF), [f64::from(0x469); 2])?;
    doing.note("revision", f64::from(chip >> 16));
    let options = doing.gripper.read(counter::OPTION_BYTES)?;
    doing.check("option DBANK", f64::from(options >> 22 & 1), [1.0; 2])?;
    doing.check("option BFB2", f64::from(options >> 20 & 1), [0.0; 2])?;
    let flags = doing.gripper.read(counter::RESET_CAUSE)?;
    doing.note("flags of the last reset (RCC_CSR, upper byte)", f64::from(flags >> 24));
    let observed = doing.gripper.observe(tenths(5))?;
    let (bus_v, mcu_c, _) = power(&observed)?;
    let is_unsound = has_fault(&observed, Fault::StoreUnsound);
    doing.check("fault of crystal or store", is_unsound.into(), [0.0; 2])?;
    doing.check("bus in V", bus_v, table::UNSUPPLIED_V.limits)?;
    doing.check("chip in °C", mcu_c, table::CHIP_C.limits)
}

fn lines(doing: &mut BringUp<'_>) -> Result<()> {
    let ids = [counter::FRAMES_UNSENT, counter::PACKETS_BROKEN];
    let mut counts = [0; 2];
    for (count, id) in counts.iter_mut().zip(ids) {
        *count = doing.gripper.read(id)?;
    }
    doing.gripper.observe(SECOND)?;
    for ((before, id), name) in counts.into_iter().zip(ids).zip(["frames", "packets"]) {
        let more = doing.gripper.read(id)?.wrapping_sub(before);
        doing.check(&format!("{name} lost in a second"), more.into(), [0.0; 2])?;
    }
    Ok(())
}

fn sensors(doing: &mut BringUp<'_>) -> Result<()> {
    doing.gripper.restart()?;
    let answers = doing.gripper.read(counter::BUS_ANSWERS)?;
    for bus in 0..2_u16 {
        let mut stated = 0_u32;
        for sensor in [2 * bus, 2 * bus + 1] {
            let address = doing.gripper.read(id::ADDRESS + sensor)?;
            stated |= address.checked_sub(0x60).and_then(|bit| 1_u32.checked_shl(bit)).unwrap_or(0);
        }
        let found = answers >> (16 * bus) & 0xFFFF;
        let name = format!("addresses from 0x60 on of bus {bus}, one bit each");
        doing.check(&name, found.into(), [stated.into(); 2])?;
    }
    let still = doing.gripper.observe(SECOND)?;
    for sensor in 0..SENSORS {
        let fields: Vec<_> = still.ticks.iter().map(|tick| tick.sensors[sensor].field).collect();
        for axis in 0..3 {
            let noise = deviation(fields.iter().map(|field| f64::from(field[axis])));
            let name = format!("noise of sensor {sensor}, axis {axis}, in counts");
            doing.check(&name, noise, table::NOISE.limits)?;
        }
        let name = format!("equal readings of sensor {sensor} in a row");
        doing.check(&name, longest_run(&fields), table::EQUAL_READINGS.limits)?;
    }
    let repeated = doing.gripper.read(counter::REPEATED_READINGS)?;
    doing.check(
        "equal readings of a sensor in a row since boot",
        f64::from(repeated + 1),
        table::EQUAL_READINGS.limits,
    )?;
    let configurations = doing.gripper.read(counter::CONFIGURATIONS)?;
    doing.check(
        "sensors with a constant configuration, one bit each",
        f64::from(configurations & 0xFFFF),
        [f64::from((1_u32 << SENSORS) - 1); 2],
    )?;
    doing.check("changes of it", f64::from(configurations >> 16), [0.0; 2])?;
    let (_, _, motor_c) = power(&still)?;
    doing.check("motor in °C", motor_c, table::MOTOR_C.limits)?;
    for finger in 0..2 {
        let before = mean_fields(&doing.gripper.observe(tenths(2))?.ticks);
        doing.act(Action::Press(finger))?;
        let pressed = mean_fields(&doing.gripper.observe(tenths(2))?.ticks);
        doing.act(Action::LetGo)?;
        doing.gripper.observe(tenths(2))?;
        let mut moved = [0.0; SENSORS];
        for (sensor, moved) in moved.iter_mut().enumerate() {
            let change = [0, 1, 2].map(|axis| pressed[sensor][axis] - before[sensor][axis]);
            let most = change.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs()));
            let most = most.unwrap_or_default();
            let axis = change.iter().position(|each| *each == most).unwrap_or_default();
            let name = format!("sensor {sensor}, axis {axis}, in counts, finger {}", finger + 1);
            doing.note(&name, most);
            *moved = most.abs();
        }
        let own = moved[2 * finger].min(moved[2 * finger + 1]);
        let other = moved[2 - 2 * finger].max(moved[3 - 2 * finger]);
        let name = format!("its sensors relative to the others, finger {}", finger + 1);
        doing.check(&name, own / other.max(1.0), [3.0, 1e6])?;
    }
    Ok(())
}

fn rotor_sensor(doing: &mut BringUp<'_>) -> Result<()> {
    doing.gripper.restart()?;
    let found = doing.gripper.read(counter::ROTOR_SENSOR)?;
    let Ok(bits) = u16::try_from(found) else { bail!("the sensor does not answer") };
    doing.check("offsets compensated", (bits & diagnosis::READY != 0).into(), [1.0; 2])?;
    doing.check("MAGL, MAGH, COF", f64::from(bits & diagnosis::WRONG), [0.0; 2])?;
    doing.check("gain", f64::from(bits & diagnosis::GAIN), table::ENCODER_GAIN.limits)?;
    let before = turn(&doing.gripper.observe(tenths(2))?)?;
    doing.act(Action::Turn)?;
    let after = turn(&doing.gripper.observe(tenths(2))?)?;
    let turned = f64::from(after.wrapping_sub(before) as i16) * 360.0 / 65_536.0;
    doing.note("sign of the angle while the fingers close", turned.signum());
    doing.check("turned by degrees", turned.abs(), [30.0, 150.0])?;
    doing.gripper.observe(doing.expected.watch)?;
    let repeated = doing.gripper.read(counter::REPEATED_ANGLES)?;
    doing.check("equal angles in a row", f64::from(repeated + 1), table::EQUAL_ANGLES.limits)
}

fn gates(doing: &mut BringUp<'_>) -> Result<()> {
    let volts = doing.operator.read(Reading::GatesInReset)?;
    doing.check("gates in reset in V", volts, table::GATES_OFF_V.limits)
}

fn break_input(doing: &mut BringUp<'_>) -> Result<()> {
    for (action, name, level) in [
        (Action::OpenBreak, "level with an open wire", 0.0),
        (Action::CloseBreak, "level with the wire connected", 1.0),
    ] {
        doing.act(action)?;
        // It is read ten times a second.
        doing.gripper.observe(tenths(3))?;
        let found = doing.gripper.read(counter::BREAK_INPUT)?;
        doing.check(name, found.into(), [level; 2])?;
    }
    for (reading, name) in [
        (Reading::GatesAfterHalt, "gates after a halt in V"),
        (Reading::GatesAfterDip, "gates during a dip in V"),
    ] {
        let volts = doing.operator.read(reading)?;
        doing.check(name, volts, table::GATES_OFF_V.limits)?;
    }
    // A halt and a dip leave latched faults.
    doing.gripper.clear()
}

fn supply(doing: &mut BringUp<'_>) -> Result<()> {
    doing.gripper.set_bench(true)?;
    doing.gripper.restart()?;
    let (bus_v, ..) = power(&doing.gripper.observe(tenths(5))?)?;
    doing.check("bus in V", bus_v, table::BENCH_V.limits)?;
    let mut armed = doing.gripper.arm()?;
    let enable = Command { mode: mode::ENABLE, ..Command::default() };
    let unhomed = state_code(PowerState::Enabled, TaskState::Unhomed);
    let observed = armed.command(enable, SECOND, |_| false)?;
    let is_on = state(&observed.state) == Some(unhomed);
    let bus_a =
        observed.state.power.map_or(f64::NAN, |power| 0.01 * f64::from(power.value.current));
    armed.end()?;
    doing.check("armed, with current offsets within the limit", is_on.into(), [1.0; 2])?;
    doing.check("current at rest in A", bus_a, table::REST_A.limits)
}

fn motor(doing: &mut BringUp<'_>) -> Result<()> {
    doing.gripper.measure_motor()?;
    let expected = doing.expected;
    let mut read = |id, scale: f64| doing.gripper.read(id).map(|count| scale * f64::from(count));
    let found = [
        ("resistance in ohm", read(id::RESISTANCE, 1e-6)?, expected.resistance_ohm, 1.6),
        ("inductance in mH", read(id::INDUCTANCE, 1e-6)?, expected.inductance_mh, 1.8),
        ("pole pairs", read(id::POLE_PAIRS, 1.0)?, expected.pole_pairs, 1.0),
        ("torque constant in N m/A", read(id::TORQUE_CONSTANT, 1e-6)?, expected.torque_nm_a, 1.5),
        ("inertia in kg m^2", read(id::INERTIA, 1e-9)?, expected.inertia_kg_m2, 2.0),
    ];
    let friction_nm = read(id::DRY_FRICTION, 1e-6)?;
    let wiring = [
        ("phases V and W swapped", read(id::SWAPPED, 1.0)?),
        ("offset of the rotor sensor in turns", read(id::ROTOR_OFFSET, 1.0 / 65_536.0)?),
    ];
    for (name, value) in wiring {
        doing.note(name, value);
    }
    for (name, value, stated, factor) in found {
        doing.check(name, value, [stated / factor, stated * factor])?;
    }
    doing.check("dry friction in N m", friction_nm, [0.0, 0.1])?;
    // With all measured values.
    doing.gripper.restart()
}

fn speed(doing: &mut BringUp<'_>) -> Result<()> {
    let open =
        Command { mode: mode::RELEASE, position: FULLY_OPEN, speed: 40, ..Command::default() };
    let mut armed = doing.gripper.arm()?;
    let observed = armed.command(open, SECOND, |_| false)?;
    armed.end()?;
    doing.check("speed of opening in mm/s", opening_mm_s(&observed.state), [3.0, 7.0])?;
    faultless(doing, &observed)
}

/// The stroke in units of [`Command`].
const FULLY_OPEN: u16 = (constants::STROKE.value / 0.05) as u16;

fn homing(doing: &mut BringUp<'_>) -> Result<()> {
    let mut armed = doing.gripper.arm()?;
    let enable = Command { mode: mode::ENABLE, ..Command::default() };
    let is_in = |task| {
        move |seen: &GripperState| state(seen) == Some(state_code(PowerState::Enabled, task))
    };
    armed.command(enable, SECOND, is_in(TaskState::Unhomed))?;
    let home = Command { mode: mode::HOME, ..Command::default() };
    let observed = armed.command(home, 40 * SECOND, is_in(TaskState::Idle))?;
    armed.end()?;
    let opening_mm =
        observed.state.grip.map_or(f64::NAN, |grip| 0.01 * f64::from(grip.value.position));
    faultless(doing, &observed)?;
    let low = doing.gripper.read(counter::LOW_SUPPLY)?;
    doing.check("low 3.3 V, how often", low.into(), [0.0; 2])?;
    let stroke = constants::STROKE.value;
    doing.check("opening after homing in mm", opening_mm, [stroke - 1.0, stroke + 1.0])
}

fn stop(doing: &mut BringUp<'_>) -> Result<()> {
    for (name, is_stopped) in
        [("speed after a stop in mm/s", true), ("speed after a silence in mm/s", false)]
    {
        let mut armed = doing.gripper.arm()?;
        let enable = Command { mode: mode::ENABLE, ..Command::default() };
        armed.command(enable, tenths(5), |_| false)?;
        let position = if is_stopped { FULLY_OPEN / 2 } else { FULLY_OPEN };
        let away = Command { mode: mode::MOVE, position, speed: 40, ..Command::default() };
        let moving = armed.command(away, tenths(5), |_| false)?;
        // A host that has ended sends nothing.
        let after = match is_stopped {
            true => armed.stop(tenths(5))?,
            false => armed.gripper.observe(tenths(7))?,
        };
        armed.end()?;
        let (moved, rest) = (opening_mm_s(&moving.state), opening_mm_s(&after.state));
        doing.check("speed before in mm/s", moved.abs(), [3.0, 15.0])?;
        // The noise of the speed at rest is up to half a millimetre per second.
        doing.check(name, rest.abs(), [0.0, 1.5])?;
        doing.gripper.clear()?;
        doing.gripper.observe(tenths(3))?;
    }
    Ok(())
}

fn forces(doing: &mut BringUp<'_>) -> Result<()> {
    doing.gripper.tare()?;
    let weight_n = doing.expected.weight_n;
    doing.act(Action::Weight(weight_n))?;
    doing.gripper.observe(tenths(3))?;
    let observed = doing.gripper.observe(tenths(5))?;
    doing.act(Action::LetGo)?;
    let [first, second, ..] = &observed.state.sensors;
    let found_n = (first.force_n[0] + second.force_n[0]).abs();
    doing.check("weight in N", found_n, [0.85 * weight_n, 1.15 * weight_n])
}

fn faultless(doing: &mut BringUp<'_>, observed: &Observed) -> Result<()> {
    let faults = observed.state.heartbeat.map_or(u32::MAX, |beat| beat.value.faults);
    doing.check("bits of faults", faults.into(), [0.0; 2])
}

fn state(seen: &GripperState) -> Option<u8> {
    seen.heartbeat.map(|beat| beat.value.state)
}

fn opening_mm_s(seen: &GripperState) -> f64 {
    seen.grip.map_or(f64::NAN, |grip| 0.01 * f64::from(grip.value.speed))
}

fn has_fault(observed: &Observed, fault: Fault) -> bool {
    let faults = observed.state.heartbeat.map_or(u32::MAX, |beat| beat.value.faults);
    faults & 1 << fault.index() != 0
}

/// Bus in volts, chip and motor in degrees Celsius.
fn power(observed: &Observed) -> Result<(f64, f64, f64)> {
    let Some(power) = observed.state.power else { bail!("no message Power arrives") };
    let power = power.value;
    Ok((0.01 * f64::from(power.bus), power.mcu.into(), power.motor.into()))
}

fn angle(tick: &Tick) -> Option<u16> {
    tick.covariates.motor.map(|motor| motor.turn)
}

fn turn(observed: &Observed) -> Result<u16> {
    match observed.ticks.iter().filter_map(angle).next_back() {
        Some(turn) => Ok(turn),
        None => {
            bail!("no rotor angle arrives: the parameter telemetry must be 1, on a serial line")
        }
    }
}

fn mean_fields(ticks: &[Tick]) -> [[f64; 3]; SENSORS] {
    let mut sums = [[0.0; 3]; SENSORS];
    for tick in ticks {
        for (sums, sensor) in sums.iter_mut().zip(&tick.sensors) {
            for (sum, counts) in sums.iter_mut().zip(sensor.field) {
                *sum += f64::from(counts) / ticks.len() as f64;
            }
        }
    }
    sums
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

fn longest_run<T: PartialEq>(values: &[T]) -> f64 {
    let runs = values.chunk_by(PartialEq::eq).map(<[T]>::len);
    runs.max().unwrap_or_default() as f64
}
