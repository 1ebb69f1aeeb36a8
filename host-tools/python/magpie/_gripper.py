"""A gripper on a serial line or a CAN bus."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from magpie import _magpie
from magpie._arguments import PathLike, whole

if TYPE_CHECKING:
    from typing import Self  # Python 3.11


@dataclass(frozen=True)
class GripperState:
    """State of a gripper, as reported or as it was when a call ended."""

    state: str | None
    """As in `cargo magpie monitor`: "idle", "hold active", "fault" ..."""
    force_n: float | None
    opening_mm: float | None
    """None before homing."""
    data: dict[str, Any]
    """All that was reported: ``faults``, or ``code`` and ``status`` of the result."""

    @classmethod
    def _of(cls, text: str) -> Self:
        data = json.loads(text) or {}
        return cls(data.get("state"), data.get("force_n"), data.get("opening_mm"), data)


class Gripper:
    """A gripper on a serial port (``port="/dev/ttyACM0"``) or a CAN bus (``can="can0"`` or ``can="HOST:PORT"``).

    A grasp is kept alive by a thread that no Python code delays. The end of a ``with`` block, or `close`, opens what a grasp of this
    object holds; nothing else is moved or freed, also where the program is killed. ``key`` is the file with the key of the gripper,
    by default that of the commands. Errors are `GripperError`, with the codes of the commands.
    """

    def __init__(
        self,
        port: PathLike | None = None,
        *,
        can: str | None = None,
        node: int | None = None,
        key: PathLike | None = None,
    ) -> None:
        if (port is None) == (can is None):
            raise TypeError("give port= or can=")
        path = None if key is None else Path(key)
        serial = None if port is None else str(port)
        self._gripper = _magpie.Gripper(serial, can, whole("node", node, 6), path)

    def status(self) -> GripperState:
        """State, force, opening and faults; nothing is sent to the gripper."""
        return GripperState._of(self._gripper.status())

    def grasp(
        self,
        force_n: float | None = None,
        *,
        position_mm: float | None = None,
        profile: str | None = None,
        speed_mm_s: float | None = None,
        width: tuple[float, float] | None = None,
        home: bool = False,
        clear_faults: bool = False,
        uncalibrated: bool = False,
    ) -> GripperState:
        """Grips with a force and holds it until `release`, or moves to an opening; returns when it is reached. The fingers move.

        ``profile`` is "fragile", "normal" or "strong"; ``width`` the expected width of the object in mm and half of the window around
        it. ``home``, ``clear_faults`` and ``uncalibrated`` are the options of ``cargo magpie grasp``.
        """
        return GripperState._of(
            self._gripper.grasp(
                force_n, position_mm, profile, speed_mm_s, width, home, clear_faults, uncalibrated
            )
        )

    def release(self, opening_mm: float | None = None) -> GripperState:
        """Ends the grasp of this object, which opens the fingers by 10 mm. Without one, or with an opening, opens the fingers to it
        (by default fully), whoever gripped."""
        return GripperState._of(self._gripper.release(opening_mm))

    def stop(self) -> GripperState:
        """Stops the gripper at once, whoever controls it, also from another thread; an object stays gripped, and the stop is latched
        until a call with ``clear_faults``."""
        return GripperState._of(self._gripper.stop())

    def close(self) -> None:
        """Opens what a grasp of this object holds, and closes the connection.

        Raises `GripperError` if the grasp had ended before, because the object was lost for instance.
        """
        self._gripper.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except _magpie.GripperError:
            # The error of the block tells more.
            if kind is None:
                raise
