#!/usr/bin/env python3
"""Forces of grippers on a CAN bus as geometry_msgs/WrenchStamped in an MCAP file: a bridge without a ROS installation.

    pip install cantools mcap-ros2-support
    cargo magpie dev dbc -o gripper.dbc
    can_to_mcap.py gripper.dbc --interface socketcand --host 127.0.0.1 --port 29536 --channel can0 -o forces.mcap

The file is what `ros2 bag record --storage mcap` writes: topics /gripper/force_0 to _3 in newtons, x lateral, z longitudinal,
stamped with the time of reception. A force that the gripper marks as not valid is left out.
"""

import argparse
import time

import can
import cantools
from mcap_ros2.writer import Writer

DEFINITION = """\
std_msgs/Header header
geometry_msgs/Wrench wrench
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
SENSORS = 4


def bridge(bus, database, writer, end_s):
    """Writes the forces that `bus` carries until the time `end_s`, in seconds since 1970; returns their number."""
    schema = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", DEFINITION)
    sensors = {database.get_message_by_name(f"Force{i}").frame_id: i for i in range(SENSORS)}
    written = 0
    while (left_s := end_s - time.time()) > 0:
        frame = bus.recv(timeout=left_s)
        if frame is None or frame.arbitration_id not in sensors:
            continue
        force = database.decode_message(frame.arbitration_id, frame.data)
        if not force["valid"]:
            continue
        sensor, time_ns = sensors[frame.arbitration_id], time.time_ns()
        stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
        message = {
            "header": {"stamp": stamp, "frame_id": f"finger_{sensor}"},
            "wrench": {
                "force": {"x": force["fx"], "y": 0.0, "z": force["fz"]},
                "torque": {"x": 0.0, "y": 0.0, "z": 0.0},
            },
        }
        topic = f"/gripper/force_{sensor}"
        writer.write_message(topic, schema, message, log_time=time_ns, publish_time=time_ns)
        written += 1
    return written


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("dbc", help="written by `cargo magpie dev dbc`")
    parser.add_argument("-o", "--output", required=True, help="MCAP file to write")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--interface", default="socketcan", help="of python-can")
    parser.add_argument("--channel", default="can0")
    parser.add_argument("--host", help="of an interface over TCP")
    parser.add_argument("--port", type=int)
    options = parser.parse_args()
    tcp = {name: value for name, value in (("host", options.host), ("port", options.port)) if value}
    database = cantools.database.load_file(options.dbc)
    with can.Bus(interface=options.interface, channel=options.channel, **tcp) as bus, open(options.output, "xb") as file:
        with Writer(file) as writer:
            written = bridge(bus, database, writer, time.time() + options.seconds)
    print(f"{written} forces written to {options.output}")


if __name__ == "__main__":
    main()
