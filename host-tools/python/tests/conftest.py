"""The command, and a campaign with its fit."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

import magpie

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT / "tests" / "data"


def command_path():
    """The command, as built by the tests of the workspace or found on the path."""
    built = [ROOT / "target" / profile / "magpie" for profile in ("debug", "release")]
    found = [str(path) for path in built if path.exists()] + [shutil.which("magpie")]
    if not found[0]:
        pytest.fail("build the command first: cargo build --workspace")
    return found[0]


@pytest.fixture(scope="session")
def command():
    """Runs the command; returns its JSON."""

    def run(*arguments):
        line = [command_path(), *map(str, arguments), "--json"]
        done = subprocess.run(line, capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    return run


@pytest.fixture(scope="session")
def ripple():
    return magpie.Campaign.read(DATA / "ripple")


@pytest.fixture(scope="session")
def fitted(ripple):
    return magpie.fit(ripple)
