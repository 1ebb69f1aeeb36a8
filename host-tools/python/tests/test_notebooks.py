"""The notebooks run from the first to the last cell, with the image that the tests of the emulated chip have built."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from conftest import ROOT, command_path

NOTEBOOKS = sorted((ROOT / "host-tools" / "python" / "notebooks").glob("*.ipynb"))
WITH_PICTURES = {"calibrate", "flash_and_drive", "missing_effects"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path, monkeypatch):
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    image = tmp_path / "target" / "thumbv7em-none-eabihf" / "image" / "firmware"
    image.parent.mkdir(parents=True)
    image.symlink_to(ROOT / "target" / "images" / "nominal.elf")
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(command_path()).parent), os.environ["PATH"]]))
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear the outputs before a commit"
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    kinds = {kind for cell in notebook.cells for output in cell.get("outputs", []) for kind in output.get("data", {})}
    assert "text/html" in kinds or path.stem == "flash_and_drive"
    assert ("image/png" in kinds) == (path.stem in WITH_PICTURES)


def test_every_tutorial_has_a_notebook():
    tutorials = {path.stem.replace("-", "_") for path in (ROOT / "host-tools" / "tutorials").glob("*.md")}
    # A bag is imported in a line of `calibrate`.
    assert {path.stem for path in NOTEBOOKS} == tutorials - {"ros2"}
