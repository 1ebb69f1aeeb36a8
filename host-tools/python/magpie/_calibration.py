"""Campaigns, and the functions of calibration over them."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magpie import _magpie
from magpie._results import (
    Comparison,
    Diagnosis,
    Edit,
    Fit,
    ForceError,
    Model,
    Network,
    Proposal,
    Replay,
    Simulation,
    Tables,
    Training,
    Verdict,
    html_table,
)

PathLike = str | os.PathLike[str]


def _columns(table: Any) -> dict[str, Sequence[float]]:
    """Columns by name, of a DataFrame or a mapping."""
    if hasattr(table, "columns") and hasattr(table, "to_numpy"):
        return {str(name): table[name].to_numpy() for name in table.columns}
    return dict(table)


def _write_csv(path: Path, table: Any) -> None:
    columns = _columns(table)
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{path.name}: columns of different length: {lengths}")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        # repr of a float has all of its digits.
        writer.writerows([value.item() if hasattr(value, "item") else value for value in row] for row in zip(*columns.values()))


@dataclass(frozen=True)
class Campaign:
    """A folder of recordings; each has the board's rows (hall.csv) and those of the reference sensor (force.csv)."""

    path: Path
    sensors: list[int]
    recordings: list[dict[str, Any]]
    """Folder, rows, seconds and covariates of each."""
    notes: list[str]
    _folder: tempfile.TemporaryDirectory | None = field(default=None, repr=False, compare=False)

    @classmethod
    def read(cls, path: PathLike, *, delay_ms: float = 0.0) -> Campaign:
        """Reads and checks a campaign.

        Raises `MagpieError` with file, line and column of the first error.
        """
        data = json.loads(_magpie.campaign(Path(path), delay_ms))
        return cls(Path(path), data["sensors"], data["recordings"], data["notes"])

    @classmethod
    def from_files(
        cls,
        sources: Sequence[PathLike],
        mapping: PathLike,
        *,
        folder: PathLike | None = None,
    ) -> Campaign:
        """Imports tables of other loggers, MCAP files or ROS 2 bags, one file (or folder) for each recording, as the mapping says.

        `guess_mapping` proposes a mapping. Without a `folder` (which must not exist) the recordings live in a temporary one, as long
        as this object.
        """
        temporary, folder = _new_folder(folder)
        data = json.loads(_magpie.import_recordings(Path(mapping), [Path(source) for source in sources], folder))
        refused = data["fit_error"]
        notes = data["notes"] + ([f"a fit will refuse these recordings: {refused}"] if refused else [])
        read = cls.read(folder)
        return cls(read.path, read.sensors, read.recordings, notes, temporary)

    @classmethod
    def from_arrays(
        cls,
        recordings: Iterable[tuple[Any, Any]],
        *,
        folder: PathLike | None = None,
        design: Mapping[str, Any] | None = None,
        starts_s: Sequence[float] | None = None,
        covariates: Sequence[str] = (),
        range_gauss: float | None = None,
        gauss_per_lsb: float | None = None,
        description: str = "",
    ) -> Campaign:
        """A campaign of pairs of tables: the board's rows and the reference's, each a DataFrame or a mapping of columns.

        Columns have the names of the files: ``t_us`` and ``s0_x_gauss`` (or ``s0_x_lsb`` with `gauss_per_lsb`), ``s0_temp_c``,
        covariates as ``opening_mm``, further ones named in `covariates` with a unit; ``t_us``, ``f0_x_n`` and ``f0_z_n`` of the
        reference. ``design`` has the keys of ``[design]`` (gap_mm, stiffness_x_n_per_mm, ..., magnet); without it, fit with
        ``base="polynomial"``. ``starts_s``: start of each recording in seconds since the campaign began (default: each begins at
        the end of the one before). ``range_gauss``: full scale of the sensor; samples there are left out as saturated. Without
        a `folder` the files live in a temporary one, as long as this object.
        """
        temporary, root = _new_folder(folder)
        root.mkdir(parents=True)
        start_s = 0.0
        for number, (hall, force) in enumerate(recordings, start=1):
            if starts_s is not None:
                start_s = float(starts_s[number - 1])
            place = root / str(number)
            place.mkdir()
            _write_csv(place / "hall.csv", hall)
            _write_csv(place / "force.csv", force)
            lines = ["format = 1", f"start_s = {start_s}", f"description = {json.dumps(description)}"]
            if covariates:
                lines.append(f"covariates = {json.dumps(list(covariates))}")
            if range_gauss is not None:
                lines.append(f"range_gauss = {float(range_gauss)}")
            if gauss_per_lsb is not None:
                lines.append(f"gauss_per_lsb = {float(gauss_per_lsb)}")
            if design is not None:
                lines.append("\n[design]")
                lines += [f"{key} = {_toml(value)}" for key, value in design.items()]
            (place / "recording.toml").write_text("\n".join(lines) + "\n")
            clock = _columns(hall).get("t_us", ())
            start_s += 1e-6 * float(clock[-1] - clock[0]) if len(clock) else 0.0
        read = cls.read(root)
        return cls(read.path, read.sensors, read.recordings, read.notes, temporary)

    def __fspath__(self) -> str:
        return str(self.path)

    def __str__(self) -> str:
        return f"{len(self.recordings)} recordings of sensors {', '.join(map(str, self.sensors))}: {self.path}"

    def _repr_html_(self) -> str:
        return html_table("\n".join([str(self), *self.notes]), self.recordings)


def _new_folder(folder: PathLike | None) -> tuple[tempfile.TemporaryDirectory | None, Path]:
    """The folder, or one in a temporary folder that is returned, too."""
    if folder is not None:
        return None, Path(folder)
    temporary = tempfile.TemporaryDirectory(prefix="magpie-")
    return temporary, Path(temporary.name) / "campaign"


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, str):
        return json.dumps(value)
    return repr(value)


def fit(
    campaign: PathLike,
    output: PathLike | None = None,
    *,
    base: str = "cylinder",
    degree: int | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Fit:
    """Fits the base physics: ``"cylinder"``, the exact field of the design's magnet, or ``"polynomial"`` of the forces."""
    model = Model.new(output)
    data = json.loads(_magpie.fit(Path(campaign), model.path, base, degree, delay_ms, seed))
    return Fit(data, model, data["held_out_rms_g"], ForceError.of(data["force"]))


def compare(
    model: PathLike,
    campaign: PathLike,
    other: PathLike | None = None,
    *,
    report: PathLike | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Comparison:
    """Compares a model, and optionally another one on the same rows, with recordings; `report` is an HTML file to write."""
    paths = [None if path is None else Path(path) for path in (other, report)]
    data = json.loads(_magpie.compare(Path(model), Path(campaign), *paths, delay_ms, seed))
    return Comparison(data, ForceError.of(data.get("force")))


def diagnose(
    model: PathLike,
    campaign: PathLike,
    *,
    exprs: Sequence[str] = (),
    ranges: Mapping[str, tuple[float, float]] | None = None,
    plan: bool = False,
    progress: Callable[[str, float], Any] | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Diagnosis:
    """Which physical effects the model does not contain, of the catalogue, of your formulas, or of a search for formulas.

    ``exprs``: formulas ``'NAME: TARGET = FORMULA'``, ``ranges`` those of their nonlinear parameters. ``progress`` is called with the
    stage and the share done (0 to 1). Ctrl-C, or an exception in ``progress``, ends it early.
    """
    return _diagnosis(model, campaign, exprs, ranges, plan, True, progress, delay_ms, seed)


def search_formulas(
    model: PathLike,
    campaign: PathLike,
    *,
    progress: Callable[[str, float], Any] | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Diagnosis:
    """Formulas of the covariates that explain what the model leaves, without asking the catalogue first: ``formulas`` of the result.

    None are searched where the error of the field is at its noise floor. ``progress`` as in `diagnose`.
    """
    return _diagnosis(model, campaign, (), None, False, False, progress, delay_ms, seed)


def _diagnosis(model, campaign, exprs, ranges, plan, catalogue, progress, delay_ms, seed) -> Diagnosis:
    options = (list(exprs), _ranges(ranges), plan, catalogue, progress, delay_ms, seed)
    data = json.loads(_magpie.diagnose(Path(model), Path(campaign), *options))
    names = Verdict.__dataclass_fields__
    verdicts = [Verdict(**{name: verdict[name] for name in names}) for verdict in data["verdicts"]]
    return Diagnosis(data, data["accepted"], verdicts, data["at_floor"])


def _ranges(ranges: Mapping[str, tuple[float, float]] | None) -> list[tuple[str, float, float]]:
    return [(name, float(low), float(high)) for name, (low, high) in (ranges or {}).items()]


def _edit(model, campaign, output, added, removed, exprs, ranges, delay_ms, seed) -> Edit:
    new = Model.new(output)
    data = json.loads(
        _magpie.edit(
            Path(model),
            Path(campaign),
            new.path,
            list(added),
            list(removed),
            list(exprs),
            _ranges(ranges),
            delay_ms,
            seed,
        )
    )
    force = data["force"]
    errors = None if force is None else (ForceError.of(force["before"]), ForceError.of(force["after"]))
    return Edit(data, new, errors)


def add(
    model: PathLike,
    campaign: PathLike,
    *effects: str,
    exprs: Sequence[str] = (),
    ranges: Mapping[str, tuple[float, float]] | None = None,
    output: PathLike | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Edit:
    """Adds effects of the catalogue and formulas, refits, and states the error before and after."""
    if not effects and not exprs:
        raise ValueError("name an effect (magpie.effects() lists them), or give a formula in exprs")
    return _edit(model, campaign, output, effects, (), exprs, ranges, delay_ms, seed)


def remove(
    model: PathLike,
    campaign: PathLike,
    *effects: str,
    output: PathLike | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Edit:
    """Removes effects, refits, and states the error before and after."""
    if not effects:
        raise ValueError("name an effect of the model")
    return _edit(model, campaign, output, (), effects, (), None, delay_ms, seed)


def replay(
    model: PathLike,
    campaign: PathLike,
    *,
    network: PathLike | None = None,
    delay_ms: float = 0.0,
) -> Replay:
    """Runs every row of the recordings through the device's code and compares the forces with the reference."""
    weights = None if network is None else Path(network)
    data = json.loads(_magpie.replay(Path(model), Path(campaign), weights, delay_ms))
    return Replay(data, ForceError.of(data["force"]))


def train(
    model: PathLike,
    campaign: PathLike,
    *,
    output: PathLike | None = None,
    quick: bool = False,
    hidden: int | None = None,
    axes: str = "xyz",
    with_ideal: bool = False,
    of_residual: bool = False,
    shared: bool = False,
    hold_out: int | None = None,
    epochs: int | None = None,
    patience: int | None = None,
    rate: float | None = None,
    zero_weight: float = 1.0,
    checkpoint: PathLike | None = None,
    progress: Callable[[str, float], Any] | None = None,
    delay_ms: float = 0.0,
    seed: int = 1,
) -> Training:
    """Trains recurrent networks that estimate each force with its standard deviation, and run on the device after the model.

    Inputs are the field components `axes` after the device's compensation, and the model's own force `with_ideal`; outputs are the
    force, or the residual of the model's (`of_residual`); a network of two layers of `hidden` units for each sensor, or one for all
    (`shared`). The recording `hold_out` (counted from 1; default: the last) selects the epoch. ``quick``: smaller networks and fewer
    epochs; other defaults are those of the command. ``checkpoint``: file in which each epoch is saved, and from which a training that was ended goes on. Ctrl-C, or an
    exception in ``progress``, ends the training after an epoch.
    """
    network = Network.new(output)
    options = (quick, hidden, axes, with_ideal, of_residual, shared, hold_out, epochs, patience, rate, zero_weight)
    saved = None if checkpoint is None else Path(checkpoint)
    data = json.loads(_magpie.train(Path(model), Path(campaign), network.path, *options, saved, progress, delay_ms, seed))
    return Training(data, network)


def guess_mapping(sources: Sequence[PathLike], output: PathLike) -> Proposal:
    """Proposes a mapping from the names and values of files (or folders of two files, or bags), and writes it, to be checked."""
    data = json.loads(_magpie.guess_mapping([Path(source) for source in sources], Path(output)))
    return Proposal(data, Path(output))


def export_mcap(
    model: PathLike, campaign: PathLike, output: PathLike, *, network: PathLike | None = None, delay_ms: float = 0.0
) -> list[Path]:
    """Writes each recording of a campaign with the estimates of the device's code to an MCAP file in a new folder; their paths."""
    weights = None if network is None else Path(network)
    return _magpie.export_mcap(Path(model), Path(campaign), Path(output), weights, delay_ms)


def export(model: PathLike, output: PathLike, *, network: PathLike | None = None) -> Tables:
    """Writes the device's tables as Rust source for the firmware."""
    weights = None if network is None else Path(network)
    data = json.loads(_magpie.export(Path(model), Path(output), weights))
    return Tables(data, Path(output))


def simulate(
    output: PathLike,
    *effects: str,
    truth: PathLike | None = None,
    design: PathLike | None = None,
    programme: str | None = None,
    recordings: int | None = None,
    seconds: float | None = None,
    sensors: int | None = None,
    scatter: float | None = None,
    seed: int = 1,
) -> Simulation:
    """Writes a campaign of a simulated gripper of MAGPIE's design, or of the design file `design`; effects as ``"creep"`` or
    ``"creep=3"``.

    The true parameters are in a file outside of the campaign (default: next to it). Other defaults are those of the command.
    """
    places = [None if path is None else Path(path) for path in (truth, design)]
    settings = (programme, recordings, seconds, sensors, scatter, seed)
    data = json.loads(_magpie.simulate(Path(output), *places, list(effects), *settings))
    return Simulation(data, Path(data["campaign"]), Path(data["truth"]))


def effects() -> list[dict[str, Any]]:
    """The catalogue of physical effects."""
    return json.loads(_magpie.effects())
