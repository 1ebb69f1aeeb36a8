"""The bridge from a CAN bus to an MCAP file: forces as cantools and the reader of ROS 2 messages see them."""

import importlib.util
import subprocess
import threading
import time

import can
import cantools
from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer

from conftest import ROOT, command_path


def load_example():
    path = ROOT / "host-tools" / "python" / "examples" / "can_to_mcap.py"
    spec = importlib.util.spec_from_file_location("can_to_mcap", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_valid_forces_of_a_virtual_bus_are_written_in_newtons(tmp_path):
    dbc = tmp_path / "gripper.dbc"
    subprocess.run([command_path(), "dev", "dbc", "-o", dbc], check=True, capture_output=True)
    database = cantools.database.load_file(dbc)
    example, target = load_example(), tmp_path / "forces.mcap"
    numbers = []

    def run():
        with can.Bus(interface="virtual", channel="bridge") as bus, open(target, "wb") as file:
            with Writer(file) as writer:
                numbers.append(example.bridge(bus, database, writer, time.time() + 1.0))

    bridge = threading.Thread(target=run)
    bridge.start()
    time.sleep(0.3)
    rest = {"sigma_x": 1, "sigma_z": 1, "disturbed": 0, "saturated": 0, "stale": 0, "model": 0, "missing_inputs": 0}
    sent = [(2, -123.0, 47.05, 1), (0, 0.05, -1638.4, 1), (1, 5.0, 5.0, 0)]
    with can.Bus(interface="virtual", channel="bridge") as bus:
        for counter, (sensor, fx, fz, valid) in enumerate(sent):
            message = database.get_message_by_name(f"Force{sensor}")
            data = message.encode({"fx": fx, "fz": fz, "valid": valid, "counter": counter, **rest})
            bus.send(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))
        heartbeat = database.get_message_by_name("Heartbeat")
        bus.send(can.Message(arbitration_id=heartbeat.frame_id, data=bytes(8), is_extended_id=False))
        bridge.join()
    assert numbers == [2]
    forces = [(m.channel.topic, m.ros_msg.wrench.force) for m in read_ros2_messages(str(target))]
    read = [(topic, round(force.x, 6), round(force.z, 6)) for topic, force in forces]
    assert read == [("/gripper/force_2", -123.0, 47.05), ("/gripper/force_0", 0.05, -1638.4)]
