"""Arguments of the functions: checked, and converted to what the extension module expects."""

from __future__ import annotations

import contextlib
import json
import math
import operator
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magpie._magpie import MagpieError

PathLike = str | os.PathLike[str]


def input_error(text: str, column: str | None = None) -> MagpieError:
    """An error of a value, with the attributes of those of the extension module."""
    error = MagpieError(text)
    error.file, error.line, error.column, error.notes = None, None, column, []
    return error


def whole(name: str, value: Any, bits: int = 32) -> int | None:
    """A whole number that is not negative, of so many bits; None is kept."""
    if value is None:
        return None
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: a whole number is needed, not {value!r}") from None
    if not 0 <= number < 2**bits:
        raise input_error(f"{name} = {number} is not possible here; give a whole number from 0 to {2**bits - 1}")
    return number


def seed_number(seed: int) -> int | None:
    """The seed of random numbers."""
    # TOML, in which it is written, has no larger integers.
    return whole("seed", seed, 63)


def texts(name: str, value: Any) -> list[str]:
    """Texts of a sequence; one text is a sequence of one."""
    values = [value] if isinstance(value, str) else list(_iterator(name, value))
    for text in values:
        if not isinstance(text, str):
            raise TypeError(f"{name}: a list of texts is needed, and it contains {text!r}")
    return values


def paths(name: str, value: Any) -> list[Path]:
    """Paths of a sequence that is not empty; one path is a sequence of one."""
    values = [value] if isinstance(value, (str, os.PathLike)) else list(_iterator(name, value))
    if not values:
        raise input_error(f"{name}: the list is empty; give at least one file or folder")
    return [Path(path) for path in values]


def _iterator(name: str, value: Any) -> Iterator[Any]:
    try:
        return iter(value)
    except TypeError:
        raise TypeError(f"{name}: a list is needed, not {value!r}") from None


def effect_names(effects: Sequence[Any]) -> list[str]:
    """Names of effects, which are arguments of their own."""
    for effect in effects:
        if not isinstance(effect, str):
            raise TypeError(f'each effect is an argument of its own, "hysteresis", "creep", not {effect!r}; of a list: *LIST')
    return list(effects)


def ranges_of(ranges: Mapping[str, tuple[float, float]] | None) -> list[tuple[str, float, float]]:
    """Names of parameters with the ends of their ranges."""
    try:
        return [(name, float(low), float(high)) for name, (low, high) in (ranges or {}).items()]
    except (AttributeError, TypeError, ValueError):
        raise TypeError(f'ranges: a mapping of names to two numbers is needed, as {{"pitch_mm": (3.1, 3.3)}}, not {ranges!r}') from None


def columns(name: str, table: Any) -> dict[str, np.ndarray]:
    """Columns of a DataFrame, a table of Arrow, a structured array or a mapping; `name` is that of the table in errors."""
    pairs: Any
    if isinstance(table, Mapping):
        pairs = table.items()
    elif hasattr(table, "column_names"):
        pairs = zip(table.column_names, table.columns)
    elif hasattr(table, "columns"):
        pairs = ((column, table[column]) for column in table.columns)
    elif getattr(getattr(table, "dtype", None), "names", None):
        pairs = ((column, table[column]) for column in table.dtype.names)
    else:
        text = f'{name}: {type(table).__name__} has no names of columns; give a DataFrame or a mapping, as {{"t_us": ..., ...}}'
        raise TypeError(text)
    return {str(column): _column(name, str(column), values) for column, values in pairs}


def _column(name: str, column: str, values: Any) -> np.ndarray:
    """Numbers, or the dates of a clock. What is missing (None, NA) is NaN."""
    place = f"{name}, column {column}"
    try:
        has_zone = getattr(getattr(values, "dtype", None), "tz", None) is not None
        array = np.asarray(values, dtype="datetime64[ns]" if has_zone else None)
    except ValueError:
        raise input_error(f"{place}: the rows have different numbers of values; give one value for each row", column) from None
    if array.ndim != 1:
        text = f"{place}: the shape is {array.shape}; give one value for each row, and each axis of a sensor as a column of its own"
        raise input_error(text, column)
    # A clock may have dates or durations.
    if array.dtype.kind in "iuf" or (column == "t_us" and array.dtype.kind in "Mm"):
        return array
    try:
        if array.dtype.kind == "O" and hasattr(values, "to_numpy"):
            return values.to_numpy(dtype=float, na_value=math.nan)
        if array.dtype.kind in "Ob":
            return array.astype(float)
    except (TypeError, ValueError):
        pass
    found = type(array[0]).__name__ if array.dtype.kind == "O" else array.dtype
    remedy = 'for dates, numpy.asarray(dates, dtype="datetime64[us]")' if column == "t_us" else "convert it, as with .astype(float)"
    raise TypeError(f"{place}: numbers are needed, not {found}; {remedy}")


def first_time(table: Mapping[str, np.ndarray]) -> np.datetime64 | None:
    """The first date of a table, if its clock has dates."""
    clock = table.get("t_us")
    return clock[0] if clock is not None and clock.dtype.kind == "M" and len(clock) else None


def with_microseconds(name: str, table: dict[str, np.ndarray], origin: np.datetime64 | None) -> dict[str, np.ndarray]:
    """The table with the dates of its clock as microseconds since `origin`."""
    clock = table.get("t_us")
    if clock is None or clock.dtype.kind not in "Mm":
        return table
    if np.isnat(clock).any():
        raise input_error(f"{name}, row {int(np.isnat(clock).argmax())}, column t_us: there is no time; leave the row out", "t_us")
    if clock.dtype.kind == "M":
        if origin is None:
            raise input_error(f"{name}, column t_us: this table has dates and the board's has none; give both tables one clock", "t_us")
        clock = clock - origin
    return {**table, "t_us": clock.astype("timedelta64[us]").astype(np.int64)}


def toml(name: str, value: Any) -> str:
    """A value as TOML; `name` is that of the argument in errors."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml(f'{name}.{key}', inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, str):
        return json.dumps(value)
    if hasattr(value, "tolist"):
        # Scalars and arrays of NumPy.
        return toml(name, value.tolist())
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(name, inner) for inner in value) + "]"
    raise TypeError(f"{name}: a number, a text, a list or a mapping is needed, not {value!r}")


def design_table(design: Any) -> str:
    """The argument ``design`` as the table of a description or a mapping file."""
    if not isinstance(design, Mapping):
        raise TypeError(f"design: a mapping is needed, as {{\"gap_mm\": 1.5, ...}}, not {type(design).__name__}")
    return "\n".join(["\n[design]", *(f"{key} = {toml(f'design.{key}', value)}" for key, value in design.items()), ""])


@contextlib.contextmanager
def renamed_places(root: Path, name: str, is_temporary: bool) -> Iterator[None]:
    """Errors in the files of a campaign that is made of the argument `name` state its element in place of the file, which the caller
    has not written, and which is deleted afterwards if temporary."""

    def element(match: re.Match[str]) -> str:
        number, table, line = match.groups()
        # The header is line 1.
        row = f", row {int(line) - 2}" if line and int(line) > 1 else ""
        return f"{name}[{int(number) - 1}]" + (f", {table}{row}" if table else "")

    try:
        yield
    except MagpieError as error:
        place = re.escape(str(root)) + r"[/\\](\d+)"
        text = re.sub(place + r"[/\\](hall|force)\.csv(?:\.gz)?(?:, line (\d+))?", element, str(error))
        # A line is where the syntax or the keys are wrong, which only those of a design can be.
        text = re.sub(place + r"[/\\]recording\.toml, line \d+", "argument design", text)
        text = re.sub(place + r"(?:[/\\]recording\.toml)?()()", element, text)
        text = re.sub(r"in recording\.toml as `(\w+) = ([^`]*)`", r"by the argument \1=\2", text.replace(str(root), name))
        error.args = (text,)
        if is_temporary and error.file is not None and error.file.is_relative_to(root):
            error.file = error.line = None
        raise
