"""The field of an axially magnetised cylinder by MagpyLib, for comparison.

    magpylib_field.py POINTS RESULT     times the points of a file, writes the fields beside them
    magpylib_field.py --points          prints the stored test points with their fields as CSV

POINTS holds rows of little-endian f64: diameter, length, x, y, z, all in mm, in the magnet's frame
(axis z, origin at its centre). Fields are in gauss for one tesla of remanence.
"""

import sys
import time

import magpylib
import numpy as np


def field(diameter, length, at):
    magnet = magpylib.magnet.Cylinder(
        polarization=(0, 0, 1), dimension=(diameter * 1e-3, length * 1e-3)
    )
    return magnet.getB(at * 1e-3) * 1e4


def timed(points_path, result_path):
    rows = np.fromfile(points_path, "<f8").reshape(-1, 5)
    diameter, length = rows[0, :2]
    at = rows[:, 2:]
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        result = field(diameter, length, at)
        best = min(best, time.perf_counter() - start)
    result.astype("<f8").tofile(result_path)
    print(best)


def stored_points():
    rng = np.random.default_rng(1)
    print("diameter_mm,length_mm,x_mm,y_mm,z_mm,bx_g,by_g,bz_g")
    for diameter, length in [(3, 2), (3, 1), (3, 5), (5, 2), (2.5, 2.5)]:
        face = length / 2
        at = np.column_stack(
            [
                rng.uniform(-3, 3, 100),
                rng.uniform(-3, 3, 100),
                # Half of the points in front, half behind, none inside.
                (face + rng.uniform(0.2, 5, 100)) * rng.choice([-1, 1], 100),
            ]
        )
        at[:3, :2] = 0.0  # on the axis
        for point, b in zip(at, field(diameter, length, at)):
            print(",".join(repr(float(v)) for v in (diameter, length, *point, *b)))


if __name__ == "__main__":
    if sys.argv[1:] == ["--points"]:
        stored_points()
    else:
        timed(*sys.argv[1:])
