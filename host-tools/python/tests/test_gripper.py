"""A gripper on the bus of the emulated board: grasps, ways out of a block, stops and results."""

import os
import re
import signal
import subprocess
import sys
import threading
import time

import pytest

import magpie
from conftest import ROOT, command_path

IMAGE = ROOT / "target" / "images" / "nominal.elf"
HELD_N = 60.0


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    """The bus of a homed gripper with an object of 40 mm."""
    if not IMAGE.exists():
        pytest.skip("the image is built by EMULATION=required cargo test -p host-tools")
    line = [command_path(), "dev", "emulate", str(IMAGE), "--opening", "3", "--object-width-mm", "40", "--speed", "1"]
    log = tmp_path_factory.mktemp("emulator") / "log"
    with log.open("w") as out:
        emulator = subprocess.Popen(line, stdout=out, stderr=out)
    try:
        addresses = {}
        while len(addresses) < 2:
            assert emulator.poll() is None, log.read_text()
            time.sleep(0.1)
            addresses = dict(re.findall(r"--(port|can) (\S+)", log.read_text()))
        # An emulated gripper is slow where the machine is busy.
        slow = ["board", "parameter", "command_timeout", "500", "--port", addresses["port"]]
        subprocess.run([command_path(), *slow], check=True, capture_output=True)
        with magpie.Gripper(can=addresses["can"]) as gripper:
            gripper.grasp(position_mm=50, home=True)
        yield addresses["can"]
    finally:
        emulator.kill()
        emulator.wait()


def is_held(state):
    return state.state.startswith("hold") and abs(state.force_n - HELD_N) < 10


def test_a_grasp_is_held_while_python_is_busy_and_ends_with_its_block(bus):
    with magpie.Gripper(can=bus) as gripper, magpie.Gripper(can=bus) as observer:
        reached = gripper.grasp(HELD_N)
        assert is_held(reached), reached
        # The lock of the interpreter is not released here.
        end = time.monotonic() + 3
        while time.monotonic() < end:
            sum(range(10**5))
        assert is_held(gripper.status()) and gripper.status().data["faults"] == []
        assert is_held(observer.status())
        with pytest.raises(magpie.GripperError, match="release") as refused:
            gripper.grasp(HELD_N)
        assert (refused.value.code, refused.value.status) == ("refused", 15)
    # The observer gripped nothing: its block ended first, and freed nothing.
    with magpie.Gripper(can=bus) as gripper:
        state = gripper.status()
        assert state.force_n < 5 and state.opening_mm > 45, state


def test_what_another_host_gripped_stays_whatever_ends(bus):
    code = f"import magpie; g = magpie.Gripper(can={bus!r}); print(g.grasp({HELD_N}).state, flush=True); input()"
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline().startswith("hold")
    other.send_signal(signal.SIGKILL)
    other.wait()
    # Until it may be taken over.
    time.sleep(4)
    with pytest.raises(magpie.GripperError) as refused, magpie.Gripper(can=bus) as gripper:
        assert is_held(gripper.status())
        gripper.grasp(position_mm=60)
    assert refused.value.code == "refused" and "gripped" in str(refused.value)
    with pytest.raises(KeyError), magpie.Gripper(can=bus) as gripper:
        assert is_held(gripper.status())
        raise KeyError
    with magpie.Gripper(can=bus) as gripper:
        assert is_held(gripper.status())
        assert gripper.release().opening_mm > 70


def test_a_program_that_ends_opens_its_own_grasp(bus):
    code = f"import magpie; gripper = magpie.Gripper(can={bus!r}); print(gripper.grasp({HELD_N}).state)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("hold"), done
    with magpie.Gripper(can=bus) as gripper:
        state = gripper.status()
        assert state.force_n < 5 and state.opening_mm > 45, state


def test_another_thread_stops_a_motion(bus):
    with magpie.Gripper(can=bus) as gripper:
        gripper.grasp(position_mm=78)
        errors = []

        def move():
            try:
                gripper.grasp(position_mm=45, speed_mm_s=1)
            except magpie.GripperError as error:
                errors.append(error)

        mover = threading.Thread(target=move)
        mover.start()
        while gripper.status().opening_mm > 75:
            time.sleep(0.05)
        gripper.stop()
        mover.join()
        assert len(errors) == 1 and errors[0].code in ("fault", "interrupted"), errors
        stopped_mm = gripper.status().opening_mm
        assert 60 < stopped_mm < 75.5
        with pytest.raises(magpie.GripperError, match="clear_faults"):
            gripper.grasp(position_mm=60)
        assert gripper.status().opening_mm == pytest.approx(stopped_mm, abs=0.1)
        moved = gripper.grasp(position_mm=70, clear_faults=True)
        assert moved.data["code"] == "reached" and abs(moved.opening_mm - 70) < 0.5


def test_ctrl_c_opens_what_was_gripped(bus):
    with magpie.Gripper(can=bus) as gripper:
        timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            gripper.grasp(HELD_N, speed_mm_s=0.5)
        timer.join()
        assert gripper.status().force_n < 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, "force_n"),
        ({"force_n": 20, "position_mm": 30}, "force_n"),
        ({"force_n": 500}, "force_n 500.0 is not possible here; give 5 to 350 N"),
        ({"force_n": 20, "profile": "soft"}, "fragile, normal or strong"),
        ({"position_mm": 90}, "position_mm 90.0 is not possible here"),
    ],
)
def test_arguments_that_are_not_possible(bus, arguments, words):
    with magpie.Gripper(can=bus) as gripper, pytest.raises(magpie.GripperError, match=words) as error:
        gripper.grasp(**arguments)
    assert error.value.code == "failed"


def test_connections_that_cannot_be(tmp_path):
    with pytest.raises(TypeError):
        magpie.Gripper()
    for connection in ({"port": tmp_path / "tty"}, {"can": "127.0.0.1:1"}):
        with pytest.raises(magpie.GripperError):
            magpie.Gripper(**connection)
    with pytest.raises(magpie.MagpieError, match="node"):
        magpie.Gripper(can="127.0.0.1:1", node=64)
