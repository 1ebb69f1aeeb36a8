"""Campaigns, and the functions of calibration over them."""

from __future__ import annotations

import contextlib
import csv
import json
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magpie import _magpie
from magpie._arguments import (
    PathLike,
    columns,
    design_table,
    effect_names,
    first_time,
    input_error,
    paths,
    ranges_of,
    renamed_places,
    seed_number,
    texts,
    whole,
    with_microseconds,
)
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

def _write_csv(path: Path, table: Mapping[str, np.ndarray], may_be_empty: bool = False) -> None:
    """Writes a table; where its cells may be empty, NaN is an empty cell, except in its clock."""

    def cells(name: str, column: np.ndarray) -> list[Any]:
        values = column.tolist()
        return ["" if value != value else value for value in values] if may_be_empty and name != "t_us" else values

    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        # A float is written with all of its digits.
        writer.writerows(zip(*(cells(name, column) for name, column in table.items())))


def _tables(number: int, recording: Any) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The two tables of a recording of `Campaign.from_arrays`, counted from 0."""
    name = f"recordings[{number}]"
    if not isinstance(recording, (tuple, list)) or len(recording) != 2:
        text = f"{name}: a pair of tables (hall, force) is needed, not {type(recording).__name__}; recordings is a list of such pairs"
        raise TypeError(text)
    names = (f"{name}, hall", f"{name}, force")
    hall, force = (columns(name, table) for name, table in zip(names, recording))
    origin = first_time(hall)
    hall, force = (with_microseconds(name, table, origin) for name, table in zip(names, (hall, force)))
    for name, table in zip(names, (hall, force)):
        lengths = {column: len(values) for column, values in table.items()}
        if len(set(lengths.values())) > 1:
            raise input_error(f"{name}: columns of different length: {lengths}")
    return hall, force


@dataclass(frozen=True)
class Campaign:
    """A folder of recordings; each has the board's rows (hall.csv) and those of the reference sensor (force.csv)."""

    path: Path
    sensors: list[int]
    recordings: list[dict[str, Any]]
    """Of each: ``folder``, ``rows`` (of the reference, with the board's values at their times), ``seconds`` and ``covariates``."""
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
        sources: PathLike | Sequence[PathLike],
        mapping: PathLike,
        *,
        folder: PathLike | None = None,
        design: Mapping[str, Any] | None = None,
    ) -> Campaign:
        """Imports tables of other loggers, MCAP files or ROS 2 bags, one file (or folder) for each recording, as the mapping says.

        `guess_mapping` proposes a mapping. ``design`` as in `from_arrays`, in place of a table ``[design]`` in the mapping. Without a
        `folder` (which must not exist) the recordings live in a temporary one, as long as this object.
        """
        files = paths("sources", sources)
        temporary, root = _new_folder(folder)
        with renamed_places(root, "sources", temporary is not None), _with_design(Path(mapping), design) as complete:
            data = json.loads(_magpie.import_recordings(complete, files, root))
            read = cls.read(root)
        refused = data["fit_error"]
        notes = data["notes"] + ([f"a fit will refuse these recordings: {refused}"] if refused else [])
        return cls(read.path, read.sensors, read.recordings, notes, temporary)

    @classmethod
    def from_arrays(
        cls,
        recordings: Iterable[tuple[Any, Any]],
        *,
        folder: PathLike | None = None,
        design: Mapping[str, Any] | None = None,
        starts_s: Sequence[float] | None = None,
        covariates: str | Sequence[str] = (),
        range_gauss: float | None = None,
        gauss_per_lsb: float | None = None,
        description: str = "",
    ) -> Campaign:
        """A campaign of pairs of tables: the board's rows and the reference's, each a DataFrame, a table of Arrow or a mapping of
        columns.

        Columns have the names of the files: ``t_us`` and ``s0_x_gauss`` (or ``s0_x_lsb`` with `gauss_per_lsb`), ``s0_temp_c``,
        covariates as ``opening_mm``, further ones named in `covariates` with a unit; ``t_us``, ``f0_x_n`` and ``f0_z_n`` of the
        reference, NaN where a force was not measured. ``t_us`` are microseconds of one clock, or dates (datetime64) in both tables.

        ``design`` has the keys of ``[design]`` (gap_mm, stiffness_x_n_per_mm, ..., magnet); without it, fit with
        ``base="polynomial"``. ``starts_s``: start of each recording in seconds since the campaign began (default: each begins at
        the end of the one before). ``range_gauss``: full scale of the sensor; samples there are left out as saturated. Without
        a `folder` the files live in a temporary one, as long as this object.
        """
        tables = [_tables(number, recording) for number, recording in enumerate(recordings)]
        if not tables:
            raise input_error("recordings: the list is empty; give at least one pair of tables (hall, force)")
        starts = None if starts_s is None else [float(start) for start in starts_s]
        if starts is not None and len(starts) != len(tables):
            raise input_error(f"starts_s: there are {len(starts)} values for {len(tables)} recordings; give one for each")
        lines = ["format = 1", f"description = {json.dumps(description)}"]
        if covariates:
            lines.append(f"covariates = {json.dumps(texts('covariates', covariates))}")
        if range_gauss is not None:
            lines.append(f"range_gauss = {float(range_gauss)}")
        if gauss_per_lsb is not None:
            lines.append(f"gauss_per_lsb = {float(gauss_per_lsb)}")
        written = "\n".join([*lines, "" if design is None else design_table(design)])
        temporary, root = _new_folder(folder)
        root.mkdir(parents=True)
        start_s = 0.0
        for number, (hall, force) in enumerate(tables, start=1):
            if starts is not None:
                start_s = starts[number - 1]
            place = root / str(number)
            place.mkdir()
            _write_csv(place / "hall.csv", hall)
            _write_csv(place / "force.csv", force, may_be_empty=True)
            (place / "recording.toml").write_text(f"start_s = {start_s}\n{written}\n")
            clock = hall.get("t_us")
            start_s += 1e-6 * float(clock[-1] - clock[0]) if clock is not None and len(clock) else 0.0
        with renamed_places(root, "recordings", temporary is not None):
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


@contextlib.contextmanager
def _with_design(mapping: Path, design: Mapping[str, Any] | None) -> Iterator[Path]:
    """The mapping, or a copy with this design, which errors do not name."""
    # What is no file is an error of the import.
    if design is None or not mapping.is_file():
        yield mapping
        return
    text = mapping.read_text(encoding="utf-8")
    if re.search(r"^\s*(\[\s*design\b|design\s*[.=])", text, re.MULTILINE):
        raise input_error(f"design: {mapping} has a table [design] already; leave one of the two out")
    with tempfile.TemporaryDirectory(prefix="magpie-") as folder:
        copy = Path(folder) / mapping.name
        copy.write_text(f"{text}\n{design_table(design)}", encoding="utf-8")
        try:
            yield copy
        except _magpie.MagpieError as error:
            message = str(error)
            if error.file == copy:
                error.file = mapping
                if error.line is not None and error.line > text.count("\n") + 1:
                    # It is not of the file.
                    message = message.replace(f"{copy}, line {error.line}", "argument design")
                    error.file = error.line = None
            error.args = (message.replace(str(copy), str(mapping)),)
            raise


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
    data = json.loads(_magpie.fit(Path(campaign), model.path, base, whole("degree", degree, 8), delay_ms, seed_number(seed)))
    return Fit(data, model, data["held_out_rms_g"], ForceError.of(data["force"]))


def compare(
    model: PathLike,
    campaign: PathLike,
    other: PathLike | None = None,
    *,
    report: PathLike | None = None,
    delay_ms: float | None = None,
    seed: int = 1,
) -> Comparison:
    """Compares a model, and optionally another one on the same rows, with recordings; `report` is an HTML file to write."""
    places = [None if path is None else Path(path) for path in (other, report)]
    data = json.loads(_magpie.compare(Path(model), Path(campaign), *places, delay_ms, seed_number(seed)))
    return Comparison(data, ForceError.of(data.get("force")))


def diagnose(
    model: PathLike,
    campaign: PathLike,
    *,
    exprs: str | Sequence[str] = (),
    ranges: Mapping[str, tuple[float, float]] | None = None,
    plan: bool = False,
    progress: Callable[[str, float], Any] | None = None,
    delay_ms: float | None = None,
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
    delay_ms: float | None = None,
    seed: int = 1,
) -> Diagnosis:
    """Formulas of the covariates that explain what the model leaves, without asking the catalogue first: ``formulas`` of the result.

    None are searched where the error of the field is at its noise floor. ``progress`` as in `diagnose`.
    """
    return _diagnosis(model, campaign, (), None, False, False, progress, delay_ms, seed)


def _diagnosis(model, campaign, exprs, ranges, plan, catalogue, progress, delay_ms, seed) -> Diagnosis:
    options = (texts("exprs", exprs), ranges_of(ranges), plan, catalogue, progress, delay_ms, seed_number(seed))
    data = json.loads(_magpie.diagnose(Path(model), Path(campaign), *options))
    names = Verdict.__dataclass_fields__
    verdicts = [Verdict(**{name: verdict[name] for name in names}) for verdict in data["verdicts"]]
    return Diagnosis(data, data["accepted"], verdicts, data["at_floor"])


def _edit(model, campaign, output, added, removed, exprs, ranges, delay_ms, seed) -> Edit:
    new = Model.new(output)
    data = json.loads(
        _magpie.edit(
            Path(model),
            Path(campaign),
            new.path,
            effect_names(added),
            effect_names(removed),
            texts("exprs", exprs),
            ranges_of(ranges),
            delay_ms,
            seed_number(seed),
        )
    )
    force = data["force"]
    errors = None if force is None else (ForceError.of(force["before"]), ForceError.of(force["after"]))
    return Edit(data, new, errors)


def add(
    model: PathLike,
    campaign: PathLike,
    *effects: str,
    exprs: str | Sequence[str] = (),
    ranges: Mapping[str, tuple[float, float]] | None = None,
    output: PathLike | None = None,
    delay_ms: float | None = None,
    seed: int = 1,
) -> Edit:
    """Adds effects of the catalogue and formulas, refits, and states the error before and after."""
    if not effects and not exprs:
        raise input_error("name an effect (magpie.effects() lists them), or give a formula in exprs")
    return _edit(model, campaign, output, effects, (), exprs, ranges, delay_ms, seed)


def remove(
    model: PathLike,
    campaign: PathLike,
    *effects: str,
    output: PathLike | None = None,
    delay_ms: float | None = None,
    seed: int = 1,
) -> Edit:
    """Removes effects, refits, and states the error before and after."""
    if not effects:
        raise input_error("name an effect of the model")
    return _edit(model, campaign, output, (), effects, (), None, delay_ms, seed)


def replay(
    model: PathLike,
    campaign: PathLike,
    *,
    network: PathLike | None = None,
    delay_ms: float | None = None,
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
    delay_ms: float | None = None,
    seed: int = 1,
) -> Training:
    """Trains recurrent networks that estimate each force with its standard deviation, and run on the device after the model.

    Inputs are the field components `axes` after the device's compensation, and the model's own force `with_ideal`; outputs are the
    force, or the residual of the model's (`of_residual`); a network of two layers of `hidden` units for each sensor, or one for all
    (`shared`). The recording `hold_out` (counted from 1; default: the last) selects the epoch. ``quick``: smaller networks and fewer
    epochs; other defaults are those of the command. ``checkpoint``: file in which each epoch is saved, and from which a
    training that was ended goes on. Ctrl-C, or an exception in ``progress``, ends the training after an epoch.
    """
    network = Network.new(output)
    hidden, hold_out, epochs, patience = (
        whole(name, value)
        for name, value in (("hidden", hidden), ("hold_out", hold_out), ("epochs", epochs), ("patience", patience))
    )
    options = (quick, hidden, axes, with_ideal, of_residual, shared, hold_out, epochs, patience, rate, zero_weight)
    saved = None if checkpoint is None else Path(checkpoint)
    rest = (saved, progress, delay_ms, seed_number(seed))
    data = json.loads(_magpie.train(Path(model), Path(campaign), network.path, *options, *rest))
    return Training(data, network)


def guess_mapping(sources: PathLike | Sequence[PathLike], output: PathLike) -> Proposal:
    """Proposes a mapping from the names and values of files (or folders of two files, or bags), and writes it, to be checked."""
    data = json.loads(_magpie.guess_mapping(paths("sources", sources), Path(output)))
    return Proposal(data, Path(output))


def export_mcap(
    model: PathLike, campaign: PathLike, output: PathLike, *, network: PathLike | None = None, delay_ms: float | None = None
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
    random_effects: int | None = None,
    strength: float | None = None,
    load: float | None = None,
    warmer: float | None = None,
    noise: str | None = None,
    field_noise: float | None = None,
    reference_noise: float | None = None,
    plan: PathLike | None = None,
    orientations: Sequence[str] = (),
    seed: int = 1,
) -> Simulation:
    """Writes a campaign of a simulated gripper of MAGPIE's design, or of the design file `design`; effects as ``"creep"`` or
    ``"creep=3"`` (``"hysteresis=2.5:both"``: of friction, in which flexures).

    Effects are those of the catalogue (`effects`), and some beyond it, which ``cargo magpie simulate --help`` and the error of an
    unknown name list. ``random_effects``: so many effects of the catalogue that the seed draws, named in the truth file alone, to
    test a diagnosis blind; ``strength`` is a factor on their typical magnitudes.

    ``programme``: ``"bench"`` (loads, opening, current, temperature and orientation vary; the default), ``"still"`` (constant
    opening and motor current), ``"level"`` (constant orientation), ``"isothermal"``, ``"same-warm-up"`` (in every recording) or
    ``"single-sine"`` (both forces a sine of 0.5 Hz). ``plan``: file of a plan of more recordings, as ``cargo magpie diagnose --plan``
    writes it.

    ``scatter`` and ``load`` are factors on the tolerances of manufacturing and on every load, ``warmer`` an offset of the
    temperature in kelvin. ``noise`` of the field: ``"white"``, ``"ar1"`` or ``"walk"``; ``field_noise`` in gauss and
    ``reference_noise`` in newtons are the white noise of one sample.

    ``orientations``: of sensors that are mounted turned by right angles, such as ``"2=-x+y-z"``: the gripper's axis along each axis of
    sensor 2; with ``":reversed"`` the poles of its magnet are exchanged.

    The true parameters are in a file outside of the campaign (default: next to it). Other defaults are those of the command.
    """
    places = [None if path is None else Path(path) for path in (truth, design, plan)]
    sizes = (whole("recordings", recordings), seconds, whole("sensors", sensors), scatter)
    drawn = (whole("random_effects", random_effects), strength)
    conditions = (load, warmer, noise, field_noise, reference_noise)
    settings = (list(orientations), programme, *sizes, *drawn, *conditions, seed_number(seed))
    data = json.loads(_magpie.simulate(Path(output), *places, effect_names(effects), *settings))
    return Simulation(data, Path(data["campaign"]), Path(data["truth"]))


def effects() -> list[dict[str, Any]]:
    """The catalogue of physical effects, a dictionary of each: its name ``effect``, its ``physics``, ``equation`` and ``parameters``,
    the columns that it ``needs``, its magnitude (``size``), what to ``record`` to identify it, the effects with which it may be
    ``confused_with``, ``similar_outside`` (a cause outside the catalogue that can leave nearly the same), and how the
    board compensates it (``compensated``)."""
    return json.loads(_magpie.effects())
