"""The loops of `multidetection`. A set of rows is the bits of an int64; tables over sets are addressed by the set itself up to
20 rows, beyond that they are open-addressed hashes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from sonobench.types import Array, Ints

_DIRECT = 20  # rows of which all subsets may have a place of their own
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True)
def _longer(array: Any, count: int, least: int) -> Any:
    more = np.empty(max(2 * len(array), least), array.dtype)
    more[:count] = array[:count]
    return more


@njit(cache=True)
def likelihoods(w: Array, a: Array, q: Array, alone: Array, cut: float, most: int, most_sets: int) -> tuple[Ints, Ints, Array, Ints, Array]:
    """L_W(x) of every particle and set that counts, by a programme over modes.

    Args:
        w, a, q: (N,), (N, L, m), (N, L): weights, p g and 1 − p.
        alone: (m,) weight of each row as a set of its own.
        cut: least handicap. A choice that is less probable than to miss and have the row alone has the quotient as handicap,
            that of an entry is the product of its choices': so much it can weigh beside an entry that stays.
        most, most_sets: values and sets that may be held.

    Returns:
        starts (N + 1,), and of each value its set's number and the value; masks (K,) of the sets, and tau (K,) their sum over
        particles. starts is empty where these did not do.
    """
    n, modes, m = a.shape
    starts, total = np.zeros(n + 1, np.int64), 0
    which, value = np.empty(1 << 12, np.int64), np.empty(1 << 12)
    masks, tau, sets = np.zeros(1 << 10, np.int64), np.zeros(1 << 10), 0
    number, number_bits = np.full(1 << min(m, _DIRECT), -1, np.int64), min(m, _DIRECT)
    room = 1 << 10  # entries of one particle before and after a mode: set, likelihood, handicap
    old_s, old_v, old_h = np.empty(room, np.int64), np.empty(room), np.empty(room)
    new_s, new_v, new_h = np.empty(room, np.int64), np.empty(room), np.empty(room)
    at_bits = min(m, _DIRECT)
    at, seen, now = np.zeros(1 << at_bits, np.int64), np.full(1 << at_bits, -1, np.int64), 0
    bit, odds, chosen = np.empty(m, np.int64), np.empty(m), np.empty(m)
    for i in range(n):
        old_s[0], old_v[0], old_h[0], held = 0, 1.0, 1.0, 1
        for l in range(modes):
            c = 0
            for z in range(m):
                other = q[i, l] * alone[z]
                if a[i, l, z] > 0 and a[i, l, z] >= cut * other:
                    bit[c], chosen[c] = np.int64(1) << z, a[i, l, z]
                    odds[c] = 1.0 if a[i, l, z] >= other else a[i, l, z] / other
                    c += 1
            if held * (c + 1) > most:
                return np.zeros(0, np.int64), which, value, masks, tau
            if held * (c + 1) > room:
                room = 2 * held * (c + 1)
                old_s, old_v, old_h = _longer(old_s, held, room), _longer(old_v, held, room), _longer(old_h, held, room)
                new_s, new_v, new_h = np.empty(len(old_s), np.int64), np.empty(len(old_s)), np.empty(len(old_s))
            if m > _DIRECT and 2 * held * (c + 1) > len(at):
                while 2 * held * (c + 1) > len(at):
                    at_bits += 1
                    at, seen = np.zeros(1 << at_bits, np.int64), np.zeros(0, np.int64)
                seen = np.full(1 << at_bits, -1, np.int64)
            fresh = 0
            for t in range(-1, c):
                x, o, b = (q[i, l], 1.0, np.int64(0)) if t < 0 else (chosen[t], odds[t], bit[t])
                if x <= 0:
                    continue
                for e in range(held):
                    if old_s[e] & b or old_h[e] * o < cut:
                        continue
                    s = old_s[e] | b
                    if m <= _DIRECT:
                        h = s
                    else:
                        h = np.int64((np.uint64(s) * _GOLDEN) >> np.uint64(64 - at_bits))
                        while seen[h] == now and new_s[at[h]] != s:
                            h = (h + 1) & (len(at) - 1)
                    if seen[h] == now:
                        new_v[at[h]] += old_v[e] * x
                        new_h[at[h]] = max(new_h[at[h]], old_h[e] * o)
                    else:
                        seen[h], at[h] = now, fresh
                        new_s[fresh], new_v[fresh], new_h[fresh] = s, old_v[e] * x, old_h[e] * o
                        fresh += 1
            now += 1
            old_s, new_s, old_v, new_v, old_h, new_h = new_s, old_s, new_v, old_v, new_h, old_h
            held = fresh
        if total + held > len(which):
            if total + held > most:
                return np.zeros(0, np.int64), which, value, masks, tau
            which, value = _longer(which, total, total + held), _longer(value, total, total + held)
        if sets > most_sets:
            return np.zeros(0, np.int64), which, value, masks, tau
        if sets + held > len(masks):
            masks, tau = _longer(masks, sets, sets + held), _longer(tau, sets, sets + held)
        if m > _DIRECT and 2 * (sets + held) > len(number):
            while 2 * (sets + held) > 1 << number_bits:
                number_bits += 1
            number = np.full(1 << number_bits, -1, np.int64)
            for k in range(sets):
                number[_free(masks[k], masks, number, number_bits)] = k
        for e in range(held):
            h = old_s[e] if m <= _DIRECT else _free(old_s[e], masks, number, number_bits)
            if number[h] < 0:
                number[h], masks[sets], tau[sets] = sets, old_s[e], 0.0
                sets += 1
            which[total], value[total] = number[h], old_v[e]
            tau[number[h]] += w[i] * old_v[e]
            total += 1
        starts[i + 1] = total
    return starts, which[:total], value[:total], masks[:sets], tau[:sets]


@njit(cache=True)
def _free(key: int, keys: Ints, table: Ints, bits: int) -> np.int64:
    """Where a key stands in a hash of numbers into `keys` (−1 is free), or the free place for it."""
    h = np.int64((np.uint64(key) * _GOLDEN) >> np.uint64(64 - bits))
    while table[h] >= 0 and keys[table[h]] != key:
        h = (h + 1) & (len(table) - 1)
    return h


@njit(cache=True)
def _lowest(mask: int) -> int:
    b = 0
    while not (mask >> b) & 1:
        b += 1
    return b


@njit(cache=True)
def _by_lowest(masks: Ints, n: int) -> tuple[Ints, Ints]:
    """Numbers of sets sorted by their lowest row, and where each row's begin."""
    first = np.zeros(n + 1, np.int64)
    for k in range(len(masks)):
        first[_lowest(masks[k]) + 1] += 1
    for b in range(n):
        first[b + 1] += first[b]
    order, filled = np.empty(len(masks), np.int64), first.copy()
    for k in range(len(masks)):
        b = _lowest(masks[k])
        order[filled[b]] = k
        filled[b] += 1
    return order, first


@njit(cache=True)
def partitions_dense(masks: Ints, d: Array, n: int, most: int) -> Array:
    """Z(S∖W) / Z(S) of sets W (K,) of weight d (K,) of n ≤ 20 rows; empty where that takes more than `most` steps.

    Forward, A(T) collects the weight of all ways to take S down to T; backward, Z(T) that of all ways to partition T.
    The ratio is then Σ_T A(T) Z(T∖W) / Z(S) over those T of which W takes the lowest row: dZ(S)/dd_W.
    """
    order, first = _by_lowest(masks, n)
    weight, number = np.zeros(1 << n), np.full(1 << n, -1, np.int64)
    for k in range(len(masks)):
        weight[masks[k]], number[masks[k]] = d[k], k
    A, Z, ratio, work = np.zeros(1 << n), np.zeros(1 << n), np.zeros(len(masks)), 0
    A[(1 << n) - 1], Z[0] = 1.0, 1.0
    for back in range(2):
        for step in range(n):
            b = n - 1 - step if back else step
            low, own = np.int64(1) << b, first[b + 1] - first[b]
            for u in range(1 << (n - 1 - b)):
                T = low | (u << (b + 1))
                if A[T] == 0:
                    continue
                rest, size = T ^ low, 0
                while rest:
                    rest &= rest - 1
                    size += 1
                listed = own < (1 << size)  # through the row's sets, or through all subsets of T that hold it
                work += min(own, 1 << size)
                if work > most:
                    return np.zeros(0)
                rest = T ^ low
                j, sub = 0, rest
                while True:
                    if listed:
                        if j == own:
                            break
                        k = order[first[b] + j]
                        j += 1
                        fits = masks[k] & ~T == 0
                    else:
                        if j:
                            if sub == 0:
                                break
                            sub = (sub - 1) & rest
                        j = 1
                        k = number[low | sub]
                        fits = k >= 0
                    if fits:
                        left = T ^ masks[k]
                        if back:
                            Z[T] += d[k] * Z[left]
                            ratio[k] += A[T] * Z[left]
                        else:
                            A[left] += A[T] * d[k]
    return ratio / Z[-1]


@njit(cache=True)
def partitions_sparse(masks: Ints, d: Array, n: int, most: int) -> Array:
    """The same for up to 62 rows, over the subsets that can be reached."""
    order, first = _by_lowest(masks, n)
    keys, A, after = np.zeros(1 << 10, np.int64), np.zeros(1 << 10), np.full(1 << 10, -1, np.int64)
    bits, count, work = 11, 2, 0
    keys[1], A[1] = (np.int64(1) << n) - 1, 1.0  # beside the empty set, number 0
    table = np.full(1 << bits, -1, np.int64)
    for k in range(count):
        table[_free(keys[k], keys, table, bits)] = k
    head = np.full(n, -1, np.int64)  # subsets by their lowest row, linked through `after`
    head[0] = 1
    for b in range(n):
        state = head[b]
        while state >= 0:
            work += 2 * (first[b + 1] - first[b])
            if work > most:
                return np.zeros(0)
            for j in range(first[b], first[b + 1]):
                if masks[order[j]] & ~keys[state]:
                    continue
                left = keys[state] ^ masks[order[j]]
                h = _free(left, keys, table, bits)
                if table[h] < 0:
                    if count == len(keys):
                        keys, A, after = _longer(keys, count, 0), _longer(A, count, 0), _longer(after, count, 0)
                    table[h], keys[count], A[count] = count, left, 0.0
                    lowest = _lowest(left)
                    after[count], head[lowest] = head[lowest], count
                    count += 1
                    if 2 * count > len(table):
                        bits += 1
                        table = np.full(1 << bits, -1, np.int64)
                        for k in range(count):
                            table[_free(keys[k], keys, table, bits)] = k
                        h = _free(left, keys, table, bits)
                A[table[h]] += A[state] * d[order[j]]
            state = after[state]
    Z, ratio = np.zeros(count), np.zeros(len(masks))
    Z[0] = 1.0
    for b in range(n - 1, -1, -1):
        state = head[b]
        while state >= 0:
            for j in range(first[b], first[b + 1]):
                if masks[order[j]] & ~keys[state]:
                    continue
                rest = Z[table[_free(keys[state] ^ masks[order[j]], keys, table, bits)]]
                Z[state] += d[order[j]] * rest
                ratio[order[j]] += A[state] * rest
            state = after[state]
    return ratio / Z[1]


@njit(cache=True)
def summed(starts: Ints, which: Ints, value: Array, masks: Ints, ratio: Array, m: int) -> tuple[Array, Array]:
    """Factors (N,), and the part of each (N, m) in which a row is among the target's; none with m = 0."""
    n = len(starts) - 1
    factor, explained = np.zeros(n), np.zeros((n, m))
    for i in range(n):
        for e in range(starts[i], starts[i + 1]):
            part = value[e] * ratio[which[e]]
            factor[i] += part
            for z in range(m if part > 0 else 0):
                if (masks[which[e]] >> z) & 1:
                    explained[i, z] += part
    return factor, explained
