"""Fields of permanent magnets by MagpyLib, for comparison.

    magpylib_field.py POINTS RESULT     times the points of a file, writes the fields to RESULT
    magpylib_field.py --points          prints the fields at the test points as CSV

POINTS holds rows of little-endian f64: diameter, length, x, y, z, all in mm, in the frame of an axially
magnetised cylinder (axis z, origin at its centre). The test points are drawn as `tests/src/points.rs`
draws them. Fields are in gauss for one tesla of remanence.
"""

import math
import sys
import time

import magpylib
import numpy as np

GRID = 1024  # points in a millimetre
DRAWN = 1250  # points around each shape, magnetised either way

CYLINDER, TUBE, CUBE, SPHERE = range(4)
# Shapes with their sizes in mm: diameter or side, hole, length.
SIZES = {
    CYLINDER: [(2.5, 0, 2.5), (3, 0, 2), (3, 0, 5), (5, 0, 2), (3, 0, 1)],
    TUBE: [(2.5, 1, 2.5), (3, 1, 2), (3, 2, 5), (5, 3, 2), (3, 1, 1)],
    CUBE: [(2.5, 0, 2.5), (1, 0, 1), (2, 0, 2), (3, 0, 3), (5, 0, 5)],
    SPHERE: [(2.5, 0, 2.5), (1, 0, 1), (2, 0, 2), (3, 0, 3), (5, 0, 5)],
}


def field(shape, size, polarization, at_mm):
    width, hole, length = size
    if shape == CYLINDER:
        magnet = magpylib.magnet.Cylinder(
            polarization=polarization, dimension=(width * 1e-3, length * 1e-3)
        )
    elif shape == TUBE:
        magnet = magpylib.magnet.CylinderSegment(
            polarization=polarization,
            dimension=(hole * 0.5e-3, width * 0.5e-3, length * 1e-3, 0, 360),
        )
    elif shape == CUBE:
        magnet = magpylib.magnet.Cuboid(
            polarization=polarization, dimension=(width * 1e-3,) * 3
        )
    else:
        magnet = magpylib.magnet.Sphere(
            polarization=polarization, diameter=width * 1e-3
        )
    return magnet.getB(at_mm * 1e-3) * 1e4


class Draw:
    """SplitMix64 (Steele, Lea and Flood 2014)."""

    def __init__(self, seed):
        self.state = seed

    def next(self):
        mask = (1 << 64) - 1
        self.state = (self.state + 0x9E3779B97F4A7C15) & mask
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        return z ^ (z >> 31)


def outside(shape, size, at):
    """An eighth of a millimetre off the surface or more, in integers; a sphere as its box."""
    room = GRID // 8
    width, hole, length = (int(v * GRID) for v in size)
    x, y, z = at
    if shape in (CUBE, SPHERE):
        return 2 * max(map(abs, at)) >= width + 2 * room
    across = 4 * (x * x + y * y)
    outside = across >= (width + 2 * room) ** 2
    within = hole > 2 * room and across <= (hole - 2 * room) ** 2
    return outside or within or 2 * abs(z) >= length + 2 * room


def points(shape, seed):
    """Sizes with points in units of the grid, every fiftieth on the axis."""
    draw = Draw(seed)
    while True:
        size = SIZES[shape][draw.next() % len(SIZES[shape])]
        at = [draw.next() % (12 * GRID + 1) - 6 * GRID for _ in range(3)]
        if draw.next() % 50 == 0:
            at[:2] = 0, 0
        if outside(shape, size, at):
            yield size, at


def stored_points():
    print("bx_g,by_g,bz_g")
    for shape in SIZES:
        for diametric in (0, 1):
            drawn = points(shape, 2 * shape + diametric)
            for size, at in (next(drawn) for _ in range(DRAWN)):
                direction = (1, 0, 0) if diametric else (0, 0, 1)
                b = field(shape, size, direction, np.array(at) / GRID)
                # Twelve digits of the field's norm.
                digits = 11 - math.floor(math.log10(np.linalg.norm(b)))
                print(",".join(f"{v:.{digits}f}" for v in b))


def timed(points_path, result_path):
    rows = np.fromfile(points_path, "<f8").reshape(-1, 5)
    diameter, length = rows[0, :2]
    at = rows[:, 2:]
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        result = field(CYLINDER, (diameter, 0, length), (0, 0, 1), at)
        best = min(best, time.perf_counter() - start)
    result.astype("<f8").tofile(result_path)
    print(best)


if __name__ == "__main__":
    if sys.argv[1:] == ["--points"]:
        stored_points()
    else:
        timed(*sys.argv[1:])
