"""Physical effects written in Python: functions over arrays, fitted and evaluated like those of the catalogue."""

from __future__ import annotations

import csv
import gzip
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magpie._arguments import PathLike, input_error
from magpie._calibration import Campaign, _write_csv, add, diagnose
from magpie._results import Diagnosis, Edit, html_table

if TYPE_CHECKING:
    import pandas
    import pyarrow

Function = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Effect:
    """An effect that is a sum of functions, each times a coefficient of its own for every sensor.

    ``function(columns, **parameters)`` receives the columns of ``hall.csv`` of one recording as arrays (``opening_mm``, ``motor_iq_a``,
    ``s0_temp_c``, ..., and ``time_s`` since its first row) and returns an array of shape (rows,), or (rows, k) for k functions. The
    result acts on `target`, as in a formula: a force (``fx_n``), a displacement of the magnet (``dz_um``), a field (``bx_g``), a gain
    (``gain_percent``). ``parameters`` are nonlinear ones with the range in which they are searched. ``times`` multiplies each function
    by a formula of the sensor's own force, for example ``"fx_n"``.

    The board does not know the function: there is no force error through its code, errors are those of the field in gauss, and
    `export` refuses such a model. An effect that proves itself can be written as a formula, or be added to the catalogue.
    """

    name: str
    target: str
    function: Function
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    times: str = ""

    def formula(self, count: int) -> str:
        """The effect as a formula of the columns that its functions become."""
        factor = f"*{self.times}" if self.times else ""
        terms = [f"a{i}*{self._column(i)}{factor}" for i in range(count)]
        return f"{self.name}: {self.target} = {' + '.join(terms)}"

    def _column(self, index: int) -> str:
        # A covariate's name ends in a unit; the coefficient has the one that makes up for it.
        return f"{self.name}_{index}_mm"

    def columns_of(self, columns: Mapping[str, np.ndarray], parameters: Mapping[str, float]) -> dict[str, np.ndarray]:
        """The functions on one recording, by the names of their columns."""
        values = np.asarray(self.function(columns, **parameters), dtype=float)
        rows = len(columns["t_us"])
        if values.ndim not in (1, 2) or values.shape[0] != rows or not np.isfinite(values).all():
            needed = f"finite values of shape ({rows},) or ({rows}, k) are needed"
            raise input_error(f"{self.name}: the function gave an array of shape {values.shape}; {needed}")
        return {self._column(i): column for i, column in enumerate(values.reshape(rows, -1).T)}


@dataclass(frozen=True)
class EffectFit:
    """A model with an effect written in Python."""

    effect: Effect
    parameters: dict[str, float]
    """Values of the nonlinear parameters: those of the least held-out error."""
    edit: Edit
    """Model and errors before and after, as of `magpie.add`."""
    campaign: Path
    """The recordings with the effect's functions as covariates; as long as this object lives."""
    formula: str
    _base: PathLike = field(repr=False)
    _folder: tempfile.TemporaryDirectory = field(repr=False, compare=False)

    def diagnose(self, **options: Any) -> Diagnosis:
        """The verdict on the effect next to those on the catalogue, as of `magpie.diagnose` of the model without it."""
        return diagnose(self._base, self.campaign, exprs=[self.formula], **options)

    def to_pandas(self) -> pandas.DataFrame:
        """The effects of the model as a DataFrame, as of `Edit`."""
        return self.edit.to_pandas()

    def to_arrow(self) -> pyarrow.Table:
        """The same as a table of Arrow."""
        return self.edit.to_arrow()

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.parameters.items())
        return f"{self.edit}\n{values}" if values else str(self.edit)

    def _repr_html_(self) -> str:
        return html_table(str(self), self.edit.data["effects"])


def fit_effect(
    model: PathLike,
    campaign: PathLike,
    effect: Effect,
    *,
    output: PathLike | None = None,
    evaluations: int = 40,
    delay_ms: float | None = None,
    seed: int = 1,
) -> EffectFit:
    """Adds an effect written in Python to a model and refits it; its nonlinear parameters minimise the held-out error of the field.

    They are searched within their ranges by at most about `evaluations` fits (SciPy: bounded Brent for one, Nelder-Mead for several).
    """
    folder = tempfile.TemporaryDirectory(prefix="magpie-effect-")
    target = Path(folder.name) / "campaign"
    recordings = _read(Path(campaign), target)
    options = {"delay_ms": delay_ms, "seed": seed}

    def edit(values: Mapping[str, float], to: PathLike | None = None) -> tuple[Edit, str]:
        count = 0
        for place, columns in recordings:
            own = effect.columns_of({**columns, "time_s": 1e-6 * (columns["t_us"] - columns["t_us"][0])}, values)
            count = len(own)
            _declare(place, own)
            (place / "hall.csv").unlink(missing_ok=True)
            _write_csv(place / "hall.csv", {**columns, **own})
        formula = effect.formula(count)
        return add(model, target, exprs=[formula], output=to, **options), formula

    def error_g(point: Sequence[float]) -> float:
        return edit(dict(zip(effect.parameters, point)))[0].data["after"]["held_out_rms_g"]

    values = dict(zip(effect.parameters, _minimum(error_g, list(effect.parameters.values()), evaluations)))
    fitted, formula = edit(values, output)
    return EffectFit(effect, values, fitted, target, formula, model, folder)


def _minimum(error: Callable[[Sequence[float]], float], ranges: list[tuple[float, float]], evaluations: int) -> list[float]:
    if not ranges:
        return []
    from scipy import optimize

    if len(ranges) == 1:
        # A coarse search first: an error over a period has several minima.
        (low, high), count = ranges[0], max(evaluations // 2, 3)
        grid = np.linspace(low, high, count)
        best = int(np.argmin([error([value]) for value in grid]))
        around = (grid[max(best - 1, 0)], grid[min(best + 1, count - 1)])
        found = optimize.minimize_scalar(lambda value: error([value]), bounds=around, method="bounded", options={"maxiter": evaluations - count})
        return [float(found.x)]
    start = [0.5 * (low + high) for low, high in ranges]
    found = optimize.minimize(error, start, bounds=ranges, method="Nelder-Mead", options={"maxfev": evaluations})
    return [float(value) for value in found.x]


def _read(campaign: Path, target: Path) -> list[tuple[Path, dict[str, np.ndarray]]]:
    """Copies a campaign; the columns of its board tables, which are to be written there."""
    Campaign.read(campaign)
    shutil.copytree(campaign, target, ignore=shutil.ignore_patterns("hall.csv*"))
    recordings = []
    for description in sorted(campaign.glob("*/recording.toml")):
        source = next(path for path in (description.parent / name for name in ("hall.csv", "hall.csv.gz")) if path.exists())
        with (gzip.open(source, "rt") if source.suffix == ".gz" else source.open()) as file:
            lines = (line for line in file if not line.startswith("#"))
            names = next(csv.reader(lines))
            values = np.loadtxt(lines, delimiter=",", ndmin=2)
        columns = dict(zip(names, values.T))
        for name in names:
            # Counts and times are whole numbers in a file.
            if name == "t_us" or name.endswith("_lsb"):
                columns[name] = columns[name].astype(np.int64)
        recordings.append((target / description.parent.name, columns))
    return recordings


def _declare(place: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Declares covariates in the recording's description, once."""
    path = place / "recording.toml"
    text = path.read_text()
    new = [name for name in columns if f'"{name}"' not in text]
    if not new:
        return
    quoted = ", ".join(f'"{name}"' for name in new)
    before, key, after = text.partition("covariates = [")
    if key:
        text = f"{before}{key}{quoted}, {after}"
    else:
        text = f"covariates = [{quoted}]\n{text}"
    path.write_text(text)
