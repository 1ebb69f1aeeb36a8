"""The board's own integer code over arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magpie import _magpie
from magpie._arguments import PathLike, columns, with_microseconds

if TYPE_CHECKING:
    import pandas
    import pyarrow


@dataclass(frozen=True)
class Estimates:
    """Estimates of consecutive rows; `sensors` numbers the second axis."""

    sensors: list[int]
    time_s: np.ndarray
    """Time of each row; NaN where no ``t_us`` was given. Shape (rows,)."""
    force_n: np.ndarray
    """Lateral and longitudinal force. Shape (rows, sensors, 2)."""
    sigma_n: np.ndarray
    """Standard deviations predicted by a network, NaN without one. Shape (rows, sensors, 2)."""
    is_valid: np.ndarray
    """False where the sensor is saturated, outside of the model, or an input is missing. Shape (rows, sensors)."""
    is_disturbed: np.ndarray
    """True while an external magnet is detected. Shape (rows,)."""

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame with a column for each force (``f0_x_n``), its standard deviation by a network (``f0_x_sigma_n``) and its
        validity (``f0_valid``)."""
        import pandas

        return pandas.DataFrame(self._columns())

    def to_arrow(self) -> pyarrow.Table:
        """The same columns as a table of Arrow (``pyarrow.Table``)."""
        import pyarrow

        return pyarrow.table(self._columns())

    def _columns(self) -> dict[str, Any]:
        columns: dict[str, Any] = {"time_s": self.time_s}
        for place, number in enumerate(self.sensors):
            for axis, letter in enumerate("xz"):
                columns[f"f{number}_{letter}_n"] = self.force_n[:, place, axis]
                sigma_n = self.sigma_n[:, place, axis]
                if np.isfinite(sigma_n).any():
                    columns[f"f{number}_{letter}_sigma_n"] = sigma_n
            columns[f"f{number}_valid"] = self.is_valid[:, place]
        columns["disturbed"] = self.is_disturbed
        return columns

    def plot(self, axes: Any = None) -> Any:
        """Forces over time, lateral above longitudinal; returns the axes of matplotlib."""
        if axes is None:
            import matplotlib.pyplot as plt

            _, axes = plt.subplots(2, 1, sharex=True)
        time = self.time_s if np.isfinite(self.time_s).all() else np.arange(len(self.time_s))
        for axis, (plot, name) in enumerate(zip(axes, ("lateral", "longitudinal"))):
            for place, number in enumerate(self.sensors):
                plot.plot(time, self.force_n[:, place, axis], label=f"sensor {number}", linewidth=0.8)
            plot.set_ylabel(f"{name} force, N")
        axes[0].legend(loc="upper right")
        axes[-1].set_xlabel("time, s" if time is self.time_s else "row")
        return axes


class Device:
    """The estimator of the firmware with the tables of a model, bit by bit what the board computes.

    It has the state of the board (compensations with memory, networks, detectors): rows continue those before, until `reset`.
    """

    def __init__(self, model: PathLike, network: PathLike | None = None) -> None:
        self._device = _magpie.Device(Path(model), None if network is None else Path(network))

    @property
    def sensors(self) -> list[int]:
        """Numbers of the sensors of the model."""
        return self._device.sensors

    def reset(self) -> None:
        """Forgets all past rows."""
        self._device.reset()

    def run(self, rows: Any) -> Estimates:
        """Estimates of rows at the rate of the board (1 kHz), a DataFrame or a mapping of columns, named as in hall.csv.

        Fields as ``s0_x_gauss`` or counts as ``s0_x_lsb``; covariates that the model's effects need, as ``opening_mm``, must be
        given in every row.
        """
        # Rows continue those of other calls: their dates need one origin.
        table = with_microseconds("rows", columns("rows", rows), np.datetime64(0, "us"))
        return self._estimates(self._device.rows({name: column.astype(float) for name, column in table.items()}))

    def step(self, row: Mapping[str, float]) -> np.ndarray:
        """Forces in newtons of the next row, shape (sensors, 2); NaN where the estimate is not valid."""
        estimates = self.run({name: [value] for name, value in row.items()})
        return np.where(estimates.is_valid[0, :, None], estimates.force_n[0], np.nan)

    def run_recording(self, folder: PathLike, *, delay_ms: float | None = None) -> Estimates:
        """Estimates of every row of a recording's folder, from a reset."""
        return self._estimates(self._device.recording(Path(folder), delay_ms))

    def _estimates(self, arrays: tuple) -> Estimates:
        time_s, force_n, sigma_n, is_valid, is_disturbed = arrays
        count = len(self.sensors)
        return Estimates(
            self.sensors,
            time_s,
            force_n.reshape(-1, count, 2),
            sigma_n.reshape(-1, count, 2),
            is_valid.reshape(-1, count),
            is_disturbed,
        )
