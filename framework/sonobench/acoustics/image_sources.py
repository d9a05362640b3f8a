"""The image sources of a box: which images there are and how strong, built once for every source and microphone in it.

Along one axis of length L, image n of a source at x lies at x + n L for even n and at (n + 1) L − x for odd n; its
sound has met the two walls |n| times in all. An image of the box is one n for each axis: the distance is the root of
three squares and the amplitude a product of three factors over the distance. Neither offsets, signs nor amplitudes
depend on the source.

Source: Allen & Berkley 1979, "Image method for efficiently simulating small-room acoustics".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from sonobench.types import Array, Ints, read_only

#: images that an enumeration may visit before it gives up
LIMIT = 50_000_000
_BIN_DB = 1.0
_BINS = 256
_METRES = 1024
_SAMPLES_PER_M = 8000 / 343
_DEEPER = 10 ** (-10 / 20)
_EXTENT = 4000  # images along one axis


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Images of a source in a box, as runs along z.

    Attributes:
        sign, offset_m, amplitude: (3, 2 N + 1), column N + n: the image of x along that axis is sign x + offset_m,
            and the walls across that axis leave `amplitude` of its pressure.
        runs: (r, 4) int64 columns ix, iy, first iz, end iz (exclusive) of the images that were kept.
        reach_m: no kept image is farther than this from any point of the box; infinite in free field.
    """

    sign: Array
    offset_m: Array
    amplitude: Array
    runs: Ints
    reach_m: float

    @property
    def images(self) -> int:
        """Number of images kept, the source itself included."""
        return int((self.runs[:, 3] - self.runs[:, 2]).sum())


def free_field() -> Lattice:
    """A lattice of the source alone."""
    one = read_only(np.ones((3, 1)))
    return Lattice(one, read_only(np.zeros((3, 1))), one, read_only([[0, 0, 0, 1]], np.int64), math.inf)


def build_lattice(box_m: ArrayLike, reflections: ArrayLike, max_order: int | None = None, prune_db: float = -70.0) -> Lattice:
    """Enumerate the images of a box and drop the weakest.

    An image's strength is bounded by its amplitude over the least distance that any source and microphone in the box
    can have. The weakest are dropped as long as the energy of what they add up to stays below `prune_db`, relative to
    the least energy that all images together bring. Late images are so many that they pile up: their energy is that
    of each by itself, plus that of their mean, taken at 8 kHz (at higher rates it is less).

    Args:
        box_m: (3,) lengths of the box, one corner at the origin.
        reflections: (6,) pressure reflection coefficients of the walls x0 x1 y0 y1 z0 z1, in [−1, 1].
        max_order: most reflections of an image; None: as many as pruning leaves.
        prune_db: level of all that is dropped against the whole response; −inf keeps every image of `max_order`.

    Raises:
        ValueError: impossible box or walls, or more images than can be enumerated.
    """
    box, walls = _checked(box_m, reflections, max_order, prune_db)
    if max_order is not None and prune_db == -math.inf:
        if (2 * max_order + 1) * (2 * max_order**2 + 2 * max_order + 3) // 3 > LIMIT:
            raise ValueError(_too_many(box, walls, prune_db))
        return _lattice(_axes(box, walls, max_order), 0.0, max_order)
    floor = 10 ** (prune_db / 20) / float(np.linalg.norm(box))
    while True:
        hidden = int(-20 * math.log10(floor) / _BIN_DB)  # levels that the last floor left out
        floor *= _DEEPER
        extent = _extent(box, walls, floor, max_order)
        if extent == _EXTENT:
            raise ValueError(_too_many(box, walls, prune_db))
        order = 3 * extent if max_order is None else max_order
        axes = _axes(box, walls, extent)
        energy, pile, least = _levels(axes.amplitude, axes.near, axes.far, order, floor)
        if least < 0:
            raise ValueError(_too_many(box, walls, prune_db))
        allowed = 10 ** (prune_db / 10) * least
        if energy[hidden:].sum() + np.square(pile[hidden:].sum(axis=0)).sum() / _SAMPLES_PER_M <= 0.05 * allowed:
            break
    weaker = np.cumsum(energy[::-1]) + np.square(np.cumsum(pile[::-1], axis=0)).sum(axis=1) / _SAMPLES_PER_M
    dropped = np.searchsorted(weaker, allowed, side="right")
    return _lattice(axes, 10 ** (-(_BINS - dropped) * _BIN_DB / 20), order)


class _Axes(NamedTuple):
    """Columns N + n of (3, 2 N + 1) tables; near and far are squares of the least and greatest distance, in m²."""

    sign: Array
    offset: Array
    amplitude: Array
    near: Array
    far: Array


def _axes(box: Array, walls: Array, extent: int) -> _Axes:
    n = np.arange(-extent, extent + 1)
    odd = n % 2
    length = box[:, None]
    near = (np.maximum(np.abs(n) - 1, 0) * length) ** 2
    return _Axes(np.tile(1.0 - 2.0 * odd, (3, 1)), (n + odd) * length, _wall_losses(walls, n), near, ((np.abs(n) + 1) * length) ** 2)


def _wall_losses(walls: Array, n: Ints) -> Array:
    """What the two walls across each axis leave of image n, (3, len(n))."""
    m = (n + n % 2) // 2  # n = 2 m − q: m pairs of reflections, q = 1 for mirrored images
    low, high = np.abs(m - n % 2), np.abs(m)
    return walls[0::2, None] ** low * walls[1::2, None] ** high


def _extent(box: Array, walls: Array, floor: float, max_order: int | None) -> int:
    """The greatest |n| along an axis whose image could still reach `floor`."""
    limit = _EXTENT if max_order is None else min(max_order, _EXTENT)
    n = np.arange(1, limit + 1)
    loss = np.maximum(np.abs(_wall_losses(walls, n)), np.abs(_wall_losses(walls, -n)))
    loud = (loss > 0) & (loss >= floor * (n - 1) * box[:, None])
    return int(n[loud.any(axis=0)].max(initial=0))


def _lattice(axes: _Axes, floor: float, order: int) -> Lattice:
    runs = _enumerate(axes.amplitude, axes.near, order, floor)
    extent = axes.sign.shape[1] // 2
    last = np.maximum(np.abs(runs[:, 2] - extent), np.abs(runs[:, 3] - 1 - extent)) + extent
    far = axes.far[0, runs[:, 0]] + axes.far[1, runs[:, 1]] + axes.far[2, last]
    return Lattice(
        read_only(axes.sign),
        read_only(axes.offset),
        read_only(axes.amplitude),
        read_only(runs, np.int64),
        float(np.sqrt(far.max())),
    )


def _checked(box_m: ArrayLike, reflections: ArrayLike, max_order: int | None, prune_db: float) -> tuple[Array, Array]:
    box = read_only(box_m, shape=(3,), name="box_m")
    walls = read_only(reflections, shape=(6,), name="reflections")
    if not (np.isfinite(box).all() and (box > 0).all()):
        raise ValueError(f"box_m is {box}; three lengths above 0 are needed")
    if not (np.abs(walls) <= 1).all():
        raise ValueError(f"reflections are {walls}; pressure coefficients lie in [-1, 1]")
    if max_order is not None and max_order < 0:
        raise ValueError(f"max_order is {max_order}; 0 (the direct sound alone) is the least")
    if not prune_db < 0 or (max_order is None and prune_db == -math.inf):
        raise ValueError(f"prune_db is {prune_db}; it must lie below 0, and be finite where max_order does not end the response")
    if max_order is None and (np.abs(walls[0::2] * walls[1::2]) == 1).any():
        raise ValueError(f"reflections {walls} lose nothing between two walls, so the response never ends; give max_order")
    return box, walls


def _too_many(box: Array, walls: Array, prune_db: float) -> str:
    return (
        f"a box of {box} m with reflections {walls} has more than {LIMIT} images to weigh at prune_db = {prune_db}; "
        "give (a lower) max_order, lower reflections or a higher prune_db"
    )


@njit(cache=True)
def _strength(amplitude: float, near: float) -> float:
    """Upper bound of an image's pressure (1/m), inf where image and microphone could meet."""
    if amplitude == 0.0:
        return 0.0
    return abs(amplitude) / math.sqrt(near) if near > 0.0 else math.inf


@njit(cache=True)
def _run(amplitude: Array, near: Array, ix: int, iy: int, order: int, floor: float) -> tuple[int, int]:
    """First and end column along z of the images (ix, iy, ·) that are as strong as `floor`; strength falls with |n|."""
    extent = amplitude.shape[1] // 2
    left = order - abs(ix - extent) - abs(iy - extent)
    plane = amplitude[0, ix] * amplitude[1, iy]
    square = near[0, ix] + near[1, iy]
    first = end = extent
    if left < 0:
        return first, end
    while end - extent <= min(left, extent) and _strength(plane * amplitude[2, end], square + near[2, end]) >= floor:
        end += 1
    if end == extent:
        return first, end
    while extent - first < min(left, extent) and _strength(plane * amplitude[2, first - 1], square + near[2, first - 1]) >= floor:
        first -= 1
    return first, end


@njit(cache=True)
def _levels(amplitude: Array, near: Array, far: Array, order: int, floor: float) -> tuple[Array, Array, float]:
    """Bounds by level (bins of _BIN_DB below 1/m): squares (b,), sums (b, metre of distance); and the least energy of all.

    The least energy is −1 where there are too many images.
    """
    farthest = math.sqrt(near[0].max() + near[1].max() + near[2].max())
    energy, pile = np.zeros(_BINS), np.zeros((_BINS, min(int(farthest) + 1, _METRES)))
    least, seen = 0.0, 0
    width = amplitude.shape[1]
    for ix in range(width):
        for iy in range(width):
            first, end = _run(amplitude, near, ix, iy, order, floor)
            seen += end - first
            for iz in range(first, end):
                a = amplitude[0, ix] * amplitude[1, iy] * amplitude[2, iz]
                least += a * a / (far[0, ix] + far[1, iy] + far[2, iz])
                square = near[0, ix] + near[1, iy] + near[2, iz]
                strength = _strength(a, square)
                if 0.0 < strength < math.inf:
                    level = min(max(int(-20.0 * math.log10(strength) / _BIN_DB), 0), _BINS - 1)
                    energy[level] += strength * strength
                    pile[level, min(int(math.sqrt(square)), pile.shape[1] - 1)] += strength
        if seen > LIMIT:
            return energy, pile, -1.0
    return energy, pile, least


@njit(cache=True)
def _enumerate(amplitude: Array, near: Array, order: int, floor: float) -> Ints:
    """Runs (r, 4) of the images that are as strong as `floor`."""
    width = amplitude.shape[1]
    count = 0
    for ix in range(width):
        for iy in range(width):
            first, end = _run(amplitude, near, ix, iy, order, floor)
            count += end > first
    runs = np.empty((count, 4), np.int64)
    count = 0
    for ix in range(width):
        for iy in range(width):
            first, end = _run(amplitude, near, ix, iy, order, floor)
            if end > first:
                runs[count] = ix, iy, first, end
                count += 1
    return runs
