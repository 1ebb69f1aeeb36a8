"""Results as dataclasses, made of the same JSON that the commands print."""

from __future__ import annotations

import html
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from typing import Self  # Python 3.11

    import pandas
    import pyarrow


@dataclass(frozen=True)
class _File:
    """A file that a function writes. One that was made without an output path lives in a temporary folder, as long as this object."""

    path: Path
    _folder: tempfile.TemporaryDirectory | None = field(default=None, repr=False, compare=False)
    _name: ClassVar[str]
    _function: ClassVar[str]

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The file at this path."""
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file; magpie.{cls._function} writes one")
        return cls(path)

    @classmethod
    def new(cls, output: str | Path | None) -> Self:
        """A place for a file that is about to be written."""
        if output is not None:
            return cls(Path(output))
        folder = tempfile.TemporaryDirectory(prefix="magpie-")
        return cls(Path(folder.name) / cls._name, folder)

    def save(self, path: str | Path, *, force: bool = False) -> Self:
        """Copies the file; an existing one with another content is replaced only with ``force``."""
        if not force and Path(path).exists() and Path(path).read_bytes() != self.path.read_bytes():
            raise FileExistsError(f"{path}: the output path exists; it is not overwritten: choose another path, or give force=True")
        shutil.copyfile(self.path, path)
        return type(self)(Path(path))

    def __fspath__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class Model(_File):
    """A model file."""

    _name = "model.toml"
    _function = "fit"


@dataclass(frozen=True)
class Network(_File):
    """A file of networks of one model."""

    _name = "network.safetensors"
    _function = "train"


@dataclass(frozen=True)
class ForceError:
    """Error of the device's code on held-out rows, RMS over all forces, in newtons."""

    rms_n: float
    noise_n: float
    excess_n: float
    """Root of the difference of their squares, which a better model could remove."""

    @classmethod
    def of(cls, data: dict[str, float] | None) -> ForceError | None:
        return None if data is None else cls(data["rms_n"], data["noise_n"], data["excess_n"])

    def __str__(self) -> str:
        return f"{self.rms_n:.3f} N (noise {self.noise_n:.3f} N, excess {self.excess_n:.3f} N)"


def html_table(title: str, rows: list[dict[str, Any]]) -> str:
    """Rows as a table of a notebook, without what is no number or text."""
    names = [name for name, value in (rows[0] if rows else {}).items() if not isinstance(value, (dict, list))]
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)

    def cell(value: Any) -> str:
        return f"{value:.4g}" if isinstance(value, float) else html.escape(str("" if value is None else value))

    body = "".join("<tr>" + "".join(f"<td>{cell(row.get(name))}</td>" for name in names) + "</tr>" for row in rows)
    return f"<p>{html.escape(title)}</p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


@dataclass(frozen=True)
class _Result:
    data: dict[str, Any] = field(repr=False)
    """Everything that the command prints with --json."""

    @property
    def notes(self) -> list[str]:
        """What to know about the recordings and the model."""
        return self.data.get("notes", [])

    def _rows(self) -> list[dict[str, Any]]:
        raise NotImplementedError

    def to_pandas(self) -> pandas.DataFrame:
        """The main table as a DataFrame."""
        import pandas

        return pandas.DataFrame(self._rows())

    def to_arrow(self) -> pyarrow.Table:
        """The main table as a table of Arrow (``pyarrow.Table``)."""
        import pyarrow

        return pyarrow.Table.from_pylist(self._rows())

    def _repr_html_(self) -> str:
        return html_table(str(self), self._rows())


@dataclass(frozen=True)
class _WithParameters(_Result):
    @property
    def parameters(self) -> list[dict[str, Any]]:
        """Each parameter of each sensor: value, standard error, design (``nominal``), ``prior_width`` (of the base the manufacturing
        tolerance) and ``deviation`` from the design in standard deviations of tolerance and standard error together (of an
        effect from zero, in standard errors)."""
        return self.data["parameters"]

    @property
    def unidentified(self) -> list[dict[str, Any]]:
        """Combinations that the prior decides, with the recording that would identify each (``remedy``)."""
        return self.data["unidentified"]

    def parameters_to_pandas(self) -> pandas.DataFrame:
        """The parameters as a DataFrame."""
        import pandas

        return pandas.DataFrame(self.parameters)

    def correlation(self, sensor: int) -> pandas.DataFrame:
        """The correlation matrix of the parameters of a sensor, without those of single recordings and those that all sensors share."""
        import pandas

        tables = [table for table in self.data["correlations"] if table["sensor"] == sensor]
        if not tables:
            raise KeyError(f"no correlations of sensor {sensor}; the model file has none, or only the coefficients of a polynomial")
        names = tables[0]["names"]
        # The rows below the diagonal begin with the second parameter.
        lower = [[*row, 1.0] for row in [[], *tables[0]["rows"]]]
        full = [[lower[max(i, j)][min(i, j)] for j in range(len(names))] for i in range(len(names))]
        return pandas.DataFrame(full, index=names, columns=names)


@dataclass(frozen=True)
class Fit(_WithParameters):
    """A fitted base model."""

    model: Model
    held_out_rms_g: float
    """Error of the field on held-out rows, RMS over all channels, in gauss."""
    force: ForceError | None
    """None with a polynomial that has no inverse."""

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["axes"]

    def __str__(self) -> str:
        return self.data["verdict"]


@dataclass(frozen=True)
class Comparison(_WithParameters):
    """A model compared with recordings."""

    force: ForceError | None

    @property
    def findings(self) -> list[dict[str, Any]]:
        """Setup errors in the recordings."""
        return self.data["findings"]

    def _rows(self) -> list[dict[str, Any]]:
        return self.data.get("axes", [])

    def __str__(self) -> str:
        return self.data["verdict"]


@dataclass(frozen=True)
class Verdict:
    """The verdict on one effect."""

    effect: str
    verdict: str
    """found, tied, shadow, not_judgeable (inconclusive) or absent."""
    gain: float
    """Reduction of the held-out squared error, as a fraction."""
    p_adjusted: float | None
    """p-value of no reduction of the held-out squared error by more than 0.1 %, adjusted for all tested effects; None where
    it was not tested, or only a full fit is significant."""
    value: float | None
    std_error: float | None
    unit: str
    reason: str


@dataclass(frozen=True)
class Diagnosis(_Result):
    """Which effects a model does not contain."""

    accepted: list[list[str]]
    """Accepted steps, each one effect of the catalogue or several that these recordings cannot distinguish; formulas are in
    `expressions`."""
    verdicts: list[Verdict]
    at_floor: bool

    @property
    def formulas(self) -> list[dict[str, Any]]:
        """Formulas that explain what no effect of the catalogue does."""
        return self.data["formulas"]

    @property
    def expressions(self) -> list[str]:
        """The found formulas as text, for ``exprs`` of `magpie.add`; empty where effects of the catalogue explain everything."""
        return [effect["expression"] for formula in self.formulas for effect in formula["effects"]]

    @property
    def next(self) -> list[str]:
        """Suggested commands."""
        return self.data["next"]

    def plot(self, axes: Any = None) -> Any:
        """Held-out error of the field, in noise floors, over the effects that were added one by one; returns the axes of matplotlib."""
        if axes is None:
            import matplotlib.pyplot as plt

            _, axes = plt.subplots()
        steps = self.data["staircase"]
        floors = [step["held_out_rms_g"] / step["floor_g"] for step in steps]
        axes.step(range(len(steps)), floors, where="mid", marker="o")
        axes.axhline(1, linestyle="--", color="0.5", label="noise floor")
        names = ["base", *("+ " + " or ".join(step["added"]) for step in steps[1:])]
        axes.set(yscale="log", ylabel="held-out field error, noise floors", xticks=range(len(steps)), xticklabels=names)
        axes.legend()
        return axes

    def _rows(self) -> list[dict[str, Any]]:
        return [vars(verdict) for verdict in self.verdicts]

    def __repr__(self) -> str:
        return f"Diagnosis(accepted={self.accepted}, expressions={self.expressions}, at_floor={self.at_floor})"

    def __str__(self) -> str:
        return "\n".join([self.data["verdict"], *self.expressions])


@dataclass(frozen=True)
class Edit(_WithParameters):
    """A model with other effects, before and after.

    Both are fitted and evaluated anew on the same held-out rows: the folds of the cross-validation are those that the effects before
    and after need together, so that the errors before may differ from those of `magpie.fit`.
    """

    model: Model
    force: tuple[ForceError, ForceError] | None
    """Before and after; None where the device cannot compute them: of a polynomial that has no inverse, or for the reason in
    `notes`."""

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["effects"]

    def __str__(self) -> str:
        before, after = (self.data[side]["held_out_rms_g"] for side in ("before", "after"))
        field_error = f"Error of the field: {before:.4f} G before, {after:.4f} G after (noise {self.data['floor_g']:.4f} G)"
        if self.force is None:
            forces = ["Error of the forces: not available, because the board cannot compute them with this model"]
        else:
            forces = [f"Error of the forces {when}: {error}" for when, error in zip(("before", "after"), self.force)]
        return "\n".join([self.data["verdict"], field_error, *forces, *(f"Note: {note}" for note in self.notes)])


@dataclass(frozen=True)
class Replay(_Result):
    """The device's code on every row of a campaign."""

    force: ForceError | None

    def _rows(self) -> list[dict[str, Any]]:
        return [
            {"recording": recording["name"], **sensor}
            for recording in self.data["recordings"]
            for sensor in recording["sensors"]
        ]

    def __str__(self) -> str:
        return f"Force error of the device's code: {self.force}"


@dataclass(frozen=True)
class Tables(_Result):
    """The device's tables as Rust source."""

    path: Path

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["sensors"]

    def __str__(self) -> str:
        return f"Tables of {self.data['centres']} radial basis functions: {self.path}"


@dataclass(frozen=True)
class Training(_Result):
    """Trained networks, evaluated on the recording that was held out to select the epoch."""

    network: Network

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["sensors"]

    def __str__(self) -> str:
        return self.data["verdict"]


@dataclass(frozen=True)
class Proposal(_Result):
    """A proposed mapping, to be checked before an import."""

    mapping: Path

    @property
    def checks(self) -> list[str]:
        """What the source files do not state."""
        return self.data["checks"]

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["columns"]

    def __str__(self) -> str:
        return "\n".join([f"Proposed mapping {self.mapping}", *self.checks])


@dataclass(frozen=True)
class Simulation(_Result):
    """A simulated campaign."""

    campaign: Path
    truth: Path

    def _rows(self) -> list[dict[str, Any]]:
        return self.data["effects"] or []

    def __str__(self) -> str:
        return f"Simulated campaign {self.campaign}, seed {self.data['seed']}"
