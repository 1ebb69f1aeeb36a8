"""Bags: files of the reference implementations are read value by value, and ours are read by them."""

import contextlib
import json
import sqlite3
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader
from mcap.writer import Writer as JsonWriter
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from conftest import DATA

EPOCH_NS = 1_764_000_000_000_000_000
ROWS = 3000
GAUSS = 0.125


@pytest.fixture(scope="session")
def tables():
    """The first seconds of a recording: two sensors at 1 kHz, their forces at 100 Hz."""
    folder = DATA / "ripple" / "1"
    hall, force = (pd.read_csv(next(folder.glob(f"{name}.csv*"))) for name in ("hall", "force"))
    return hall[:ROWS], force[force.t_us <= hall.t_us[ROWS - 1]]


def imported(command, folder, source):
    """The tables of a source, imported with the proposed mapping."""
    mapping, campaign = folder / "mapping.toml", folder / "campaign"
    proposal = command("import", "--guess", source, "-o", mapping)
    command("import", mapping, source, "-o", campaign)
    read = lambda name: pd.read_csv(campaign / "1" / f"{name}.csv.gz")
    return proposal, read("hall"), read("force")


def is_equal(hall, force, tables):
    expected_hall, expected_force = tables
    assert np.array_equal(hall.t_us, expected_hall.t_us)
    assert np.array_equal(force.t_us, expected_force.t_us)
    for sensor in range(2):
        for axis in "xyz":
            # Nine digits of a recording keep 15-bit counts exactly.
            counts = hall[f"s{sensor}_{axis}_gauss"] / GAUSS
            assert np.array_equal(counts, expected_hall[f"s{sensor}_{axis}_lsb"])
        for axis in "xz":
            name = f"f{sensor}_{axis}_n"
            assert np.array_equal(force[name], expected_force[name])


@pytest.mark.parametrize("storage", ["mcap", "db3", "db3 without definitions"])
def test_ros_2_bags_of_rosbags(command, tables, tmp_path, storage):
    hall, force = tables
    store = get_typestore(Stores.ROS2_JAZZY)
    of = lambda name: store.types[name]
    vector, header = of("geometry_msgs/msg/Vector3"), of("std_msgs/msg/Header")
    magnetic, wrench = "sensor_msgs/msg/MagneticField", "geometry_msgs/msg/WrenchStamped"
    joints = "sensor_msgs/msg/JointState"
    bag = tmp_path / "bag"
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(bag, version=9, storage_plugin=plugin) as writer:
        topic = lambda name, kind: writer.add_connection(name, kind, typestore=store)
        fields = [topic(f"/finger{sensor}/mag", magnetic) for sensor in range(2)]
        forces = [topic(f"/finger{sensor}/wrench", wrench) for sensor in range(2)]
        joint = topic("/joint_states", joints)

        def send(connection, kind, t_us, late_ns, **content):
            stamp_ns = EPOCH_NS + 1000 * int(t_us)
            stamp = of("builtin_interfaces/msg/Time")(stamp_ns // 10**9, stamp_ns % 10**9)
            message = of(kind)(header=header(stamp, "hand"), **content)
            writer.write(connection, stamp_ns + late_ns, store.serialize_cdr(message, kind))

        for number, row in enumerate(hall.itertuples()):
            for sensor, connection in enumerate(fields):
                tesla = [1e-4 * GAUSS * getattr(row, f"s{sensor}_{axis}_lsb") for axis in "xyz"]
                covariance = np.zeros(9)
                # The recorder receives them late.
                content = dict(magnetic_field=vector(*tesla), magnetic_field_covariance=covariance)
                send(connection, magnetic, row.t_us, 400_000 + sensor, **content)
            if number % 2 == 0:
                none = np.zeros(0)
                position = np.array([1e-3 * row.opening_mm])
                content = dict(name=["jaw"], position=position, velocity=none, effort=none)
                send(joint, joints, row.t_us, 0, **content)
        for row in force.itertuples():
            for sensor, connection in enumerate(forces):
                x, z = (getattr(row, f"f{sensor}_{axis}_n") for axis in "xz")
                content = of("geometry_msgs/msg/Wrench")(vector(x, 0.5, z), vector(0.0, 0.0, 0.0))
                send(connection, wrench, row.t_us, 0, wrench=content)
    if storage == "db3 without definitions":
        # As ROS 2 Humble and before write them.
        with contextlib.closing(sqlite3.connect(bag / "bag.db3")) as database:
            database.execute("DROP TABLE message_definitions")
            database.commit()
    proposal, read_hall, read_force = imported(command, tmp_path, bag)
    is_equal(read_hall, read_force, tables)
    assert {column["unit"] for column in proposal["columns"]} == {"T", "N"}
    # An element of an array, at half the rate: each row has that of the nearest message.
    text = (tmp_path / "mapping.toml").read_text()
    opening = '{ from = "/joint_states.position[0]", unit = "m", to = "opening_mm" },'
    mapping = tmp_path / "with-opening.toml"
    mapping.write_text(text.replace("columns = [\n", f"columns = [\n  {opening}\n", 1))
    command("import", mapping, bag, "-o", tmp_path / "with-opening")
    read = pd.read_csv(tmp_path / "with-opening" / "1" / "hall.csv.gz")
    assert np.allclose(read.opening_mm[::2], hall.opening_mm[::2], rtol=1e-8)


def test_protobuf_and_json_of_mcap(command, tables, tmp_path):
    hall, force = tables
    timestamp = "google/protobuf/timestamp.proto"
    file = descriptor_pb2.FileDescriptorProto(name="lab.proto", package="lab", syntax="proto3", dependency=[timestamp])
    kinds = descriptor_pb2.FieldDescriptorProto
    for kind, names in {"Field": ["bx_uT", "by_uT", "bz_uT"], "Force": ["fx_N", "fz_N"]}.items():
        message = file.message_type.add(name=kind)
        stamp = message.field.add(name="stamp", number=1, type=kinds.TYPE_MESSAGE, label=kinds.LABEL_OPTIONAL)
        stamp.type_name = ".google.protobuf.Timestamp"
        for number, name in enumerate(names, start=2):
            message.field.add(name=name, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    pool = descriptor_pool.Default()
    pool.Add(file)
    of = lambda kind: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"lab.{kind}"))
    types = {"mag": of("Field"), "ft": of("Force")}
    rows = {"hall": [], "force": []}
    for sensor in range(2):
        for row in hall.itertuples():
            field = {f"b{a}_uT": 100 * GAUSS * getattr(row, f"s{sensor}_{a}_lsb") for a in "xyz"}
            rows["hall"].append((1000 * int(row.t_us), f"/s{sensor}/mag", field))
        for row in force.itertuples():
            newtons = {f"f{a}_N": getattr(row, f"f{sensor}_{a}_n") for a in "xz"}
            rows["force"].append((1000 * int(row.t_us), f"/s{sensor}/ft", newtons))
    both = sorted(rows["hall"] + rows["force"], key=lambda row: row[0])
    paths = [tmp_path / "protobuf.mcap", tmp_path / "json.mcap"]
    with paths[0].open("wb") as out, ProtobufWriter(out) as writer:
        for time_ns, topic, values in both:
            stamp = Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)
            message = types[topic.split("/")[-1]](stamp=stamp, **values)
            writer.write_message(topic, message, log_time=time_ns, publish_time=time_ns)
    def write_json(path, messages):
        with path.open("wb") as out:
            writer = JsonWriter(out)
            writer.start()
            schema = writer.register_schema("reading", "jsonschema", b'{"type": "object"}')
            topics = dict.fromkeys(row[1] for row in messages)
            channels = {topic: writer.register_channel(topic, "json", schema) for topic in topics}
            for time_ns, topic, values in messages:
                data = json.dumps(values | {"ok": True, "note": None}).encode()
                writer.add_message(channels[topic], time_ns, data, time_ns)
            writer.finish()

    write_json(paths[1], both)
    for path in paths:
        folder = tmp_path / path.stem
        folder.mkdir()
        _, read_hall, read_force = imported(command, folder, path)
        is_equal(read_hall, read_force, tables)
    # Which sensor is first in a file, and has a message more, is chance.
    later = sorted(sorted(both, key=lambda row: row[1], reverse=True)[1:], key=lambda row: row[0])
    write_json(tmp_path / "later.mcap", later)
    mapping = tmp_path / "both.toml"
    command("import", "--guess", paths[1], tmp_path / "later.mcap", "-o", mapping)
    command("import", mapping, paths[1], tmp_path / "later.mcap", "-o", tmp_path / "both")


def test_our_files_are_read_by_others_and_round_trip(command, fitted, tmp_path):
    source = DATA / "ripple"
    folder = tmp_path / "mcap"
    files = command("dev", "export", fitted.model.path, "--mcap", source, "-o", folder)["files"]
    expected = {name: pd.read_csv(next((source / "1").glob(f"{name}.csv*"))) for name in ("hall", "force")}
    topics = {"/board": expected["hall"], "/reference": expected["force"]}
    with open(files[0], "rb") as file:
        seen = dict.fromkeys(topics, 0)
        for schema, channel, message, decoded in make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=list(topics)):
            if seen[channel.topic] % 500 == 0:
                row = topics[channel.topic].iloc[seen[channel.topic]]
                for name in topics[channel.topic].columns.drop("t_us"):
                    assert getattr(decoded, name) == row[name], (channel.topic, name)
            seen[channel.topic] += 1
        assert seen == {topic: len(table) for topic, table in topics.items()}
    # rosbags knows message types by their definition in the file.
    with AnyReader([Path(files[0])]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/estimate"]
        forces = [reader.deserialize(data, connection.msgtype).f0_x_n for connection, _, data in reader.messages(connections)]
    assert len(forces) == len(expected["hall"])
    # The estimates follow the reference.
    at_reference = np.interp(expected["force"].t_us, expected["hall"].t_us, forces)
    assert np.corrcoef(at_reference, expected["force"].f0_x_n)[0, 1] > 0.9
    mapping, campaign = tmp_path / "mapping.toml", tmp_path / "campaign"
    command("import", "--guess", *files, "-o", mapping)
    command("import", mapping, *files, "-o", campaign)
    for number in range(1, len(files) + 1):
        for name in ("hall", "force"):
            before = pd.read_csv(next((source / str(number)).glob(f"{name}.csv*")))
            after = pd.read_csv(campaign / str(number) / f"{name}.csv.gz")
            pd.testing.assert_frame_equal(after, before, check_exact=True, check_dtype=False)
