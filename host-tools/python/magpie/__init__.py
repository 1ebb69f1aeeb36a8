"""Forces from Hall sensors in a robot gripper: fit, compare, diagnose, and the device's own code over arrays.

Every function is the command `magpie` of the same name and returns what the command prints with ``--json``, as a dataclass: the
numbers that matter as attributes, everything in ``data``, tables by ``to_pandas()``. Fields are in gauss, forces in newtons, times
in seconds, unless a name ends in another unit. Errors of input are `MagpieError` with ``file``, ``line`` and ``column``.
"""

from magpie._device import Device, Estimates
from magpie._effects import Effect, EffectFit, fit_effect
from magpie._gripper import Gripper, GripperState
from magpie._magpie import GripperError, MagpieError, __version__
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
)
from magpie._calibration import (
    Campaign,
    add,
    compare,
    diagnose,
    effects,
    export,
    export_mcap,
    fit,
    guess_mapping,
    remove,
    replay,
    search_formulas,
    simulate,
    train,
)

__all__ = [
    "Campaign",
    "Comparison",
    "Device",
    "Diagnosis",
    "Edit",
    "Effect",
    "EffectFit",
    "Estimates",
    "Fit",
    "ForceError",
    "Gripper",
    "GripperError",
    "GripperState",
    "MagpieError",
    "Model",
    "Network",
    "Proposal",
    "Replay",
    "Simulation",
    "Tables",
    "Training",
    "Verdict",
    "__version__",
    "add",
    "compare",
    "diagnose",
    "effects",
    "export",
    "export_mcap",
    "fit",
    "fit_effect",
    "guess_mapping",
    "remove",
    "replay",
    "search_formulas",
    "simulate",
    "train",
]
