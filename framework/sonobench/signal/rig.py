"""The microphones of a recording as one rig, and the sensors that its pairs make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import max_delay, place
from sonobench.types import Array, Header, Ints, MicArray, Sensor, Space


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """All microphone arrays of a recording in the frame of the first, so that pairs of all of them stack.

    Attributes:
        arrays: channels by array name, in order.
        elements: (M, 3) m in the first array's frame.
        room: (M, 3) m in the room.
        pairs: (P, 2) rows of `elements`, each pair within one array (one clock).
        rate_hz: sampling rate.
        max_delay_s: (P,) aperture of each pair over the speed of sound.
    """

    arrays: dict[str, int]
    elements: Array
    room: Array
    pairs: Ints
    rate_hz: float
    max_delay_s: Array


def rig(header: Header, pairs: str, who: str) -> Rig:
    """The rig of a recording; `pairs` "scene" takes those that its arrays name, "all" every two microphones of an array.

    Raises:
        SetupError: no microphones, no pairs, or arrays of different rates.
    """
    arrays = [a for a in header.arrays if a.kind == "microphones"]
    if not arrays:
        have = f"arrays {[(a.name, a.kind) for a in header.arrays]}" if header.arrays else "no samples"
        hint = "; it holds measurement scans, which the front end 'recorded' reads" if header.sensors else ""
        raise SetupError(f"{who} reads samples of microphones; recording {header.name} has {have}{hint}")
    rates = sorted({a.rate_hz for a in arrays})
    if len(rates) > 1:
        raise SetupError(f"{who} reads arrays of one rate; recording {header.name} has {rates} Hz")
    poses = [header.poses[header.array_names.index(a.name)] for a in arrays]
    room = np.concatenate([place(p, a.elements) for p, a in zip(poses, arrays, strict=True)])
    offsets = np.cumsum([0, *(len(a.elements) for a in arrays)])
    found = np.concatenate([_pairs(a, pairs) + o for a, o in zip(arrays, offsets, strict=False)])
    if not len(found):
        hint = "name pairs in the scene or say pairs = 'all'" if pairs == "scene" else "an array needs two microphones"
        raise SetupError(f"{who} reads pairs = {pairs!r}; arrays {[a.name for a in arrays]} of recording {header.name} have none: {hint}")
    elements = place(np.linalg.inv(poses[0]), room)
    return Rig({a.name: a.channels for a in arrays}, elements, room, found, rates[0], max_delay(room, found, header.c_m_s))


def _pairs(array: MicArray, which: str) -> Ints:
    if which == "scene":
        return array.pairs
    if which == "all":
        return np.array(list(combinations(range(len(array.elements)), 2)), np.int64).reshape(-1, 2)
    raise SetupError(f"pairs is {which!r}; 'scene' or 'all' is needed")


def widened(unit: Rig, header: Header) -> Rig:
    """The rig with every two microphones of an array as a pair, those of `unit` first and in its orientation."""
    whole = rig(header, "all", "a search over all pairs")
    own = {frozenset(pair) for pair in unit.pairs.tolist()}
    more = np.array([frozenset(pair) not in own for pair in whole.pairs.tolist()])
    pairs = np.concatenate([unit.pairs, whole.pairs[more]])
    return replace(unit, pairs=pairs, max_delay_s=np.concatenate([unit.max_delay_s, whole.max_delay_s[more]]))


def pair_sensors(unit: Rig, own: int | None = None) -> tuple[Sensor, ...]:
    """One "tdoa" sensor a pair with the pair's two elements: "pair-0" and so on for the `own` first ones (None: all), "wide-0" and so on for others."""
    first, space, both = next(iter(unit.arrays)), Space.of("tau_s"), np.array([[0, 1]])
    last = len(unit.pairs) if own is None else own
    names = [f"pair-{p}" if p < last else f"wide-{p - last}" for p in range(len(unit.pairs))]
    return tuple(Sensor(name, first, "tdoa", unit.elements[ij], space, both) for name, ij in zip(names, unit.pairs, strict=True))


def stack_sensor(unit: Rig) -> Sensor:
    """All pairs as one "tdoa" sensor, "stack", with dz = P."""
    space = Space(tuple(f"tau{p}_s" for p in range(len(unit.pairs))))
    return Sensor("stack", next(iter(unit.arrays)), "tdoa", unit.elements, space, unit.pairs)
