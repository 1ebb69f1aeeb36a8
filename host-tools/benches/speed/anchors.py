"""What other programs take for the same work, on the same data, in the same run: one JSON object on stdout for each.

    anchors.py NAME ARGUMENT...

Times are of the work alone, without the start of the interpreter and its imports.
"""

import gzip
import json
import sys
import time
from pathlib import Path

import numpy as np

GAUSS_PER_LSB = 0.125
# The nominal design of the recordings, as in their [design].
DIAMETER_MM, LENGTH_MM, REMANENCE_T, GAP_MM = 3.0, 2.0, 1.2, 1.5
STIFFNESS_N_PER_MM = (500.0, 800.0)
# Between grippers of one design, as the fit assumes: stiffnesses, remanence (relative), gap, offsets (mm), tilts, rotations (deg), bias (G).
TOLERANCES = np.array([0.1, 0.1, 0.03, 0.1, 0.1, 0.1, 1.5, 1.5, 1.5, 1.5, 1.5, 5.0, 5.0, 5.0])


def timed(work, rounds=1):
    """Shortest time of several rounds, and the last result."""
    best, result = np.inf, None
    for _ in range(rounds):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return best, result


def recordings(campaign):
    return sorted((path for path in Path(campaign).iterdir() if path.is_dir()), key=lambda path: int(path.name))


def tables(campaign, name):
    return [folder / f"{name}.csv.gz" for folder in recordings(campaign)]


def read(path):
    with gzip.open(path, "rt") as file:
        names = [name.strip('"') for name in file.readline().strip().split(",")]
        return names, np.loadtxt(file, delimiter=",")


def gunzip(campaign):
    """Decompression of all tables."""
    files = tables(campaign, "hall") + tables(campaign, "force")
    return {"seconds": timed(lambda: [gzip.decompress(path.read_bytes()) for path in files], 3)[0]}


def loadtxt(campaign):
    """numpy.loadtxt of all tables."""
    files = tables(campaign, "hall") + tables(campaign, "force")
    return {"seconds": timed(lambda: [read(path) for path in files], 2)[0]}


def rbf(campaign, centres):
    """Gaussian radial basis functions of three fields and two forces for each sensor, in float64."""
    rng = np.random.default_rng(1)
    centres = int(centres)
    names, rows = read(tables(campaign, "hall")[0])
    sensors = sum(name.endswith("_x_lsb") for name in names)
    fields = [rows[:, [names.index(f"s{sensor}_{axis}_lsb") for axis in "xyz"]] * GAUSS_PER_LSB for sensor in range(sensors)]
    grid = rng.normal(size=(centres, 3)) * 300
    weights = rng.normal(size=(centres, 2))

    def work():
        for field in fields:
            squared = (field**2).sum(1)[:, None] + (grid**2).sum(1)[None] - 2 * field @ grid.T
            np.exp(-squared * 1e-5) @ weights

    count = len(recordings(campaign))
    return {"seconds": count * timed(work, 3)[0]}


def field_g(magnetic, parameters, force_n):
    """Field of a cylinder that is magnetised along the gap (y) on flexures."""
    from scipy.spatial.transform import Rotation

    stiffness, (remanence, gap, x, z) = parameters[:2], parameters[2:6]
    tilt = Rotation.from_euler("xz", parameters[6:8], degrees=True)
    sensor = Rotation.from_euler("xyz", parameters[8:11], degrees=True)
    displacement = force_n / stiffness
    magnet = np.stack([x + displacement[:, 0], np.full(len(force_n), gap + LENGTH_MM / 2), z + displacement[:, 1]], axis=1)
    at = tilt.inv().apply(-magnet) / (DIAMETER_MM / 2)
    radius = np.maximum(np.hypot(at[:, 0], at[:, 2]), 1e-12)
    radial, _, axial = magnetic(np.full(len(at), LENGTH_MM / DIAMETER_MM), radius, at[:, 1])
    own = 1e4 * remanence * np.stack([radial * at[:, 0] / radius, axial, radial * at[:, 2] / radius], axis=1)
    return sensor.inv().apply(tilt.apply(own)) + parameters[11:]


def fit(campaign):
    """The fourteen parameters of each sensor by scipy.optimize.least_squares with MagpyLib's cylinder, one fit to all recordings."""
    import magpylib.core
    from scipy.optimize import least_squares

    magnetic = magpylib.core.magnet_cylinder_axial_Bfield
    halls, forces = [read(p) for p in tables(campaign, "hall")], [read(p) for p in tables(campaign, "force")]
    names, sensors = halls[0][0], sum(name.endswith("_x_lsb") for name in halls[0][0])
    nominal = np.array([*STIFFNESS_N_PER_MM, REMANENCE_T, GAP_MM, *np.zeros(10)])
    widths = np.concatenate([TOLERANCES[:3] * nominal[:3], TOLERANCES[3:]])

    def work():
        squares, count = 0.0, 0
        for sensor in range(sensors):
            columns = [names.index(f"s{sensor}_{axis}_lsb") for axis in "xyz"]
            measured, applied = [], []
            for (_, hall), (of_force, force) in zip(halls, forces):
                at = force[:, of_force.index("t_us")]
                # The mean of the rows around one of the reference, as our fit has it.
                means = [np.convolve(np.pad(hall[:, column], 5, "edge"), np.full(11, 1 / 11), "valid") for column in columns]
                measured.append(np.stack([np.interp(at, hall[:, 0], mean) for mean in means], axis=1))
                applied.append(force[:, [of_force.index(f"f{sensor}_{axis}_n") for axis in "xz"]])
            measured, applied = GAUSS_PER_LSB * np.concatenate(measured), np.concatenate(applied)

            def residuals(scaled, start):
                field = field_g(magnetic, start + widths * scaled, applied)
                return np.concatenate([((field - measured) / 0.2).ravel(), scaled])

            # The sign of the magnet is not known.
            starts = [nominal * np.where(np.arange(14) == 2, sign, 1) for sign in (1, -1)]
            start = min(starts, key=lambda start: (residuals(np.zeros(14), start) ** 2).sum())
            best = least_squares(residuals, np.zeros(14), method="lm", args=(start,))
            squares += ((0.2 * best.fun[:-14]) ** 2).sum()
            count += best.fun.size - 14
        return np.sqrt(squares / count)

    seconds, rms_g = timed(work)
    return {"seconds": seconds, "rms_g": rms_g}


def sweep(designs):
    """Fields at rest, at the force limits of both axes, and of 128 mounting errors for each design, by MagpyLib's cylinder."""
    import magpylib.core

    designs, rng = int(designs), np.random.default_rng(1)
    diameter, length, gap = (10 ** rng.uniform(0, np.log10(high), designs) for high in (8, 8, 4))

    def work():
        points = np.zeros((designs, 5 + 128, 3))
        points[:, 1:5, 0] = [0.3, -0.3, 0, 0]
        points[:, 1:5, 2] = [0, 0, 0.3, -0.3]
        points[:, 5:] = rng.normal(size=(designs, 128, 3)) * 0.05
        points[:, :, 1] += (gap + length / 2)[:, None]
        scaled = points / (diameter / 2)[:, None, None]
        radius = np.maximum(np.hypot(scaled[:, :, 0], scaled[:, :, 2]), 1e-12)
        shape = np.broadcast_to((length / diameter)[:, None], radius.shape)
        return magpylib.core.magnet_cylinder_axial_Bfield(shape.ravel(), radius.ravel(), scaled[:, :, 1].ravel())

    return {"seconds": timed(work, 2)[0]}


def train(campaign, hidden, epochs):
    """Recurrent networks of the same size by PyTorch: one for each sensor, Gaussian likelihood, truncated back-propagation in 16
    streams of 64 rows, Adam with a cosine schedule. The last recording is held out. The field is not compensated."""
    import torch

    hidden, epochs = int(hidden), int(epochs)
    torch.manual_seed(1)
    halls, forces = [read(p) for p in tables(campaign, "hall")], [read(p) for p in tables(campaign, "force")]
    names = halls[0][0]
    sensors = sum(name.endswith("_x_lsb") for name in names)
    data = []
    for (_, hall), (of_force, force) in zip(halls, forces):
        inputs = np.stack([hall[:, [names.index(f"s{s}_{a}_lsb") for a in "xyz"]] for s in range(sensors)], axis=1)
        at = hall[:, 0]
        wanted = np.stack(
            [np.stack([np.interp(at, force[:, 0], force[:, of_force.index(f"f{s}_{a}_n")]) for a in "xz"], axis=1) for s in range(sensors)],
            axis=1,
        )
        # The reference has a row for ten of the board's.
        has_force = np.isin(np.arange(len(at)), np.searchsorted(at, force[:, 0]))
        data.append((inputs, wanted, has_force))
    mean, scale = data[0][0].mean(0), data[0][0].std(0)
    force_scale = data[0][1].std((0, 1))
    tensors = [
        (torch.tensor((i - mean) / scale, dtype=torch.float32), torch.tensor(w / force_scale, dtype=torch.float32), torch.tensor(h))
        for i, w, h in data
    ]
    networks = torch.nn.ModuleList(
        torch.nn.ModuleDict({"gru": torch.nn.GRU(3, hidden, 2, batch_first=True), "head": torch.nn.Linear(hidden, 4)}) for _ in range(sensors)
    )
    optimizer = torch.optim.Adam(networks.parameters(), lr=5e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs, eta_min=5e-5)
    streams, window = 16, 64
    rows = sum(len(i) for i, _, _ in tensors[:-1])
    length = rows // (streams * window) * window
    joined = [torch.cat([part[k] for part in tensors[:-1]])[: streams * length] for k in range(3)]
    inputs, wanted, has_force = (part.reshape(streams, length, *part.shape[1:]) for part in joined)

    def work():
        for _ in range(epochs):
            states = [None] * sensors
            for first in range(0, length, window):
                part = slice(first, first + window)
                mask, loss = has_force[:, part], 0.0
                for sensor, network in enumerate(networks):
                    out, state = network["gru"](inputs[:, part, sensor], states[sensor])
                    states[sensor] = state.detach()
                    mu, log_sigma = network["head"](out)[mask].split(2, dim=-1)
                    loss = loss + (log_sigma + 0.5 * ((wanted[:, part, sensor][mask] - mu) / log_sigma.exp()) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(networks.parameters(), 1.0)
                optimizer.step()
            schedule.step()

    seconds, _ = timed(work)
    held_in, held_out, mask = tensors[-1]
    squares = []
    with torch.no_grad():
        for sensor, network in enumerate(networks):
            out, _ = network["gru"](held_in[None, :, sensor])
            error = (network["head"](out)[0, :, :2] - held_out[:, sensor]) * torch.tensor(force_scale)
            squares.append((error[mask][len(error[mask]) // 10 :] ** 2).mean())
    return {"seconds": seconds, "rmse_n": float(torch.stack(squares).mean().sqrt())}


if __name__ == "__main__":
    name, *arguments = sys.argv[1:]
    print(json.dumps({"gunzip": gunzip, "loadtxt": loadtxt, "rbf": rbf, "fit": fit, "sweep": sweep, "train": train}[name](*arguments)))
