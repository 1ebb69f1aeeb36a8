"""The extension module: paths in, JSON out. Use the functions of the package instead."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__version__: str

class MagpieError(ValueError):
    """Input that cannot be used, with the remedy."""

    file: Path | None
    line: int | None
    column: str | None
    notes: list[str]

class GripperError(RuntimeError):
    """A gripper that did not do what it was told, with code and status of the result, and the result as JSON."""

    code: str
    status: int
    data: str

Range = tuple[str, float, float]
Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]

class Device:
    sensors: list[int]
    def __init__(self, model: Path, network: Path | None) -> None: ...
    def reset(self) -> None: ...
    def rows(self, columns: dict[str, np.ndarray]) -> Arrays: ...
    def recording(self, folder: Path, delay_ms: float | None) -> Arrays: ...

class Gripper:
    def __init__(self, port: str | None, can: str | None, node: int | None, key: Path | None) -> None: ...
    def status(self) -> str: ...
    def grasp(
        self,
        force_n: float | None,
        position_mm: float | None,
        profile: str | None,
        speed_mm_s: float | None,
        width: tuple[float, float] | None,
        home: bool,
        clear_faults: bool,
        uncalibrated: bool,
    ) -> str: ...
    def release(self, opening_mm: float | None) -> str: ...
    def stop(self) -> str: ...
    def close(self) -> str: ...

def campaign(folder: Path, delay_ms: float) -> str: ...
def fit(campaign: Path, output: Path, base: str, degree: int | None, delay_ms: float, seed: int) -> str: ...
def compare(
    model: Path, campaign: Path, other: Path | None, report: Path | None, delay_ms: float | None, seed: int
) -> str: ...
def diagnose(
    model: Path,
    campaign: Path,
    exprs: list[str],
    ranges: list[Range],
    plans: bool,
    catalogue: bool,
    progress: Callable[[str, float], Any] | None,
    delay_ms: float | None,
    seed: int,
) -> str: ...
def edit(
    model: Path,
    campaign: Path,
    output: Path,
    added: list[str],
    removed: list[str],
    exprs: list[str],
    ranges: list[Range],
    delay_ms: float | None,
    seed: int,
) -> str: ...
def replay(model: Path, campaign: Path, network: Path | None, delay_ms: float | None) -> str: ...
def export(model: Path, output: Path, network: Path | None) -> str: ...
def train(
    model: Path,
    campaign: Path,
    output: Path,
    quick: bool,
    hidden: int | None,
    axes: str,
    with_ideal: bool,
    of_residual: bool,
    shared: bool,
    hold_out: int | None,
    epochs: int | None,
    patience: int | None,
    rate: float | None,
    zero_weight: float,
    checkpoint: Path | None,
    progress: Callable[[str, float], Any] | None,
    delay_ms: float | None,
    seed: int,
) -> str: ...
def guess_mapping(sources: list[Path], output: Path) -> str: ...
def import_recordings(mapping: Path, sources: list[Path], output: Path) -> str: ...
def export_mcap(model: Path, campaign: Path, output: Path, network: Path | None, delay_ms: float | None) -> list[Path]: ...
def simulate(
    output: Path,
    truth: Path | None,
    design: Path | None,
    plan: Path | None,
    effects: list[str],
    orientations: list[str],
    programme: str | None,
    recordings: int | None,
    seconds: float | None,
    sensors: int | None,
    scatter: float | None,
    random_effects: int | None,
    strength: float | None,
    load: float | None,
    warmer: float | None,
    noise: str | None,
    field_noise: float | None,
    reference_noise: float | None,
    seed: int,
) -> str: ...
def effects() -> str: ...
