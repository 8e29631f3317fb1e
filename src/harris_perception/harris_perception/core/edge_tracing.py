"""From the pixels of thinned edges to chains: hysteresis, a skeleton, spurs, corners, links; compiled by numba.

Everything here touches edge pixels only, in lists, on a picture framed by one empty pixel, where neighbours are
constant distances and need no test for the border. Each pixel's state is a byte of that picture, so that its eight
neighbours are one lookup in a table of 256 patterns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import called, compiled
from harris_perception.core.harris_kernels import collect_marked

Array = npt.NDArray[Any]

# Neighbours in circular order; even ones share a side.
_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)

# States: a candidate; a pixel of an edge (bit 7) with the number of its neighbours in the lower half; the mark of what
# is done with; a corner in the result.
_WEAK, _KEPT, _USED, _CORNER = 1, 128, 32, 255
_DEGREE = 15


def _tables() -> tuple[npt.NDArray[np.int8], npt.NDArray[np.bool_]]:
    """Return for each pattern of neighbours their number, and whether the pixel between them is needless.

    It is when at least two neighbours are set and they stay in one piece without it (Yokoi's number, 8-connected), so
    that no end or connection is lost.
    """
    empty = 1 - np.array([[pattern >> i & 1 for i in range(8)] for pattern in range(256)])
    sides, after, beyond = empty[:, 0::2], empty[:, 1::2], np.roll(empty, -2, axis=1)[:, 0::2]
    pieces = (sides - sides * after * beyond).sum(axis=1)
    count = 8 - empty.sum(axis=1)
    return count.astype(np.int8), np.asarray((count >= 2) & (pieces == 1))


_COUNT, _NEEDLESS = _tables()


@called
def _pattern(state: Array, here: int, stride: int) -> int:
    """Return which of the eight neighbours belong to edges, as bits."""
    pattern: int = state[here + 1] >> 7
    pattern |= (state[here + stride + 1] >> 7) << 1
    pattern |= (state[here + stride] >> 7) << 2
    pattern |= (state[here + stride - 1] >> 7) << 3
    pattern |= (state[here - 1] >> 7) << 4
    pattern |= (state[here - stride - 1] >> 7) << 5
    pattern |= (state[here - stride] >> 7) << 6
    pattern |= (state[here - stride + 1] >> 7) << 7
    return pattern


@called
def _connected(
    state: Array, seeds: Array, strength: Array, stride: int, steps: Array, least: int, weight: float
) -> tuple[Array, Array]:
    """Set the pixels of connected pieces with a seed to kept and clear all others.

    Returns their places, and of these the ones that may be needless: one look at the neighbours serves both.
    """
    kept, crowded = np.empty(len(seeds) + 8192, np.int32), np.empty(len(seeds) + 8192, np.int32)
    count = full = 0
    for i in range(len(seeds)):
        if state[seeds[i]] != _WEAK:
            continue
        first, done, first_full = count, count, full
        kept[count] = seeds[i]
        state[seeds[i]] = _KEPT
        count += 1
        while done < count:
            if count + 8 >= len(kept):
                kept = np.concatenate((kept, np.empty_like(kept)))
                crowded = np.concatenate((crowded, np.empty_like(crowded)))
            here = kept[done]
            done += 1
            pattern = 0
            for j in range(8):
                beside = here + steps[j]
                value = state[beside]
                pattern |= (value != 0) << j
                kept[count] = beside
                if value == _WEAK:
                    state[beside] = _KEPT
                    count += 1
            state[here] = _KEPT | _COUNT[pattern]
            crowded[full] = here
            full += _COUNT[pattern] > 2 or _NEEDLESS[pattern]
        total = 0.0
        if weight > 0.0:
            for j in range(first, count):
                total += strength[kept[j] // stride - 1, kept[j] % stride - 1]
        if count - first < least or total < weight:
            for j in range(first, count):
                state[kept[j]] = 0
            count, full = first, first_full
    for i in range(len(state)):  # all at once, without a branch
        state[i] = state[i] if state[i] >= _KEPT else 0
    return kept[:count], crowded[:full]


@called
def _drop(state: Array, here: int, steps: Array) -> None:
    """Clear a pixel and count it no longer among its neighbours'."""
    state[here] = 0
    for j in range(8):
        if state[here + steps[j]] != 0:
            state[here + steps[j]] -= 1


@called
def _thin_out(state: Array, crowded: Array, count: int, stride: int, steps: Array) -> None:
    """Remove needless pixels among the first ``count`` places of ``crowded``, until there are none."""
    removed = True
    while removed:
        removed = False
        for i in range(count):
            here = crowded[i]
            if state[here] != 0 and _NEEDLESS[_pattern(state, here, stride)]:
                _drop(state, here, steps)
                removed = True


@called
def _branch(state: Array, end: int, steps: Array, path: Array) -> tuple[int, int]:
    """Follow a line from its free end into ``path``; return its length and where it branches, or 0, -1."""
    here, came, length = end, -1, 0
    while length < len(path):
        ahead, number = -1, 0
        for j in range(8):
            to = here + steps[j]
            if state[to] != 0 and to != came:
                ahead = to
                number += 1
        if number == 0:
            break  # a line of its own
        if number > 1:
            return length, here
        path[length] = here
        length += 1
        came, here = here, ahead
    return 0, -1


@called
def _prune(state: Array, kept: Array, stride: int, steps: Array, longest: int) -> None:
    """Remove branches of up to ``longest`` pixels that end freely, shortest first, and what becomes needless then."""
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(len(kept) + 1, np.int32), np.empty(len(kept) + 1, np.int32)
    count = 0
    for i in range(len(kept)):
        if state[kept[i]] == _KEPT | 1:
            length, _ = _branch(state, kept[i], steps, path)
            ends[count], lengths[count] = kept[i], length
            count += 0 < length <= longest
    # Short branches first: of two at the end of a line the longer one continues it.
    for shortest in range(1, longest + 1):
        i = 0
        while i < count:
            end = ends[i]
            i += 1
            if lengths[i - 1] > shortest or state[end] != _KEPT | 1:
                continue
            length, branch = _branch(state, end, steps, path)
            if length == 0 or length > shortest:
                lengths[i - 1] = length if length > 0 else longest + 1
                continue
            for j in range(length):
                _drop(state, path[j], steps)
            near = 0
            for j in range(8):
                beside[near] = branch + steps[j]
                near += state[branch + steps[j]] != 0
            beside[near] = branch
            _thin_out(state, beside, near + 1, stride, steps)
            for j in range(near + 1):
                if count < len(ends) and state[beside[j]] == _KEPT | 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1


@called
def _lead(state: Array, kept: Array, corners: Array, stride: int, steps: Array, farthest: float) -> Array:
    """Draw lines from free ends to the nearest corner (N, 2) px within reach; return ``kept`` and what was drawn.

    Edges round corners off on the outside, so what passes within three quarters of the reach is cut first.
    """
    height, width = len(state) // stride - 2, stride - 2
    reach, cut = int(farthest), 0.75 * farthest
    dx, dy = np.empty((2 * reach + 1) ** 2, np.int32), np.empty((2 * reach + 1) ** 2, np.int32)
    near = within = 0
    for ring in range(2):  # the pixels to cut come first, then those where ends are looked for
        for y in range(-reach, reach + 1):
            for x in range(-reach, reach + 1):
                square = x * x + y * y
                if (square <= cut * cut) == (ring == 0) and square <= farthest * farthest:
                    dx[within], dy[within] = x, y
                    within += 1
        near = within if ring == 0 else near
    offsets = dy[:within] * stride + dx[:within]
    whole = np.empty(len(corners), np.bool_)  # the discs that need no look at the picture's border
    for i in range(len(corners)):
        x, y = corners[i, 0], corners[i, 1]
        whole[i] = x >= reach and y >= reach and x < width - reach and y < height - reach
        centre = (y + 1) * stride + x + 1
        for j in range(near):
            inside = whole[i] or (0 <= x + dx[j] < width and 0 <= y + dy[j] < height)
            if inside and state[centre + offsets[j]] != 0:
                _drop(state, centre + offsets[j], steps)
    # Each end is led to its nearest corner: all pairs are seen from the corners, which are fewer than pixels.
    number = np.empty(len(state), np.int32)  # of an end in the lists, where marked as used
    squares, chosen = np.empty(4096, np.int32), np.empty(4096, np.int32)
    count = 0
    for i in range(len(corners)):
        x, y = corners[i, 0], corners[i, 1]
        centre = (y + 1) * stride + x + 1
        for j in range(near, within):
            if not (whole[i] or (0 <= x + dx[j] < width and 0 <= y + dy[j] < height)):
                continue
            here = centre + offsets[j]
            if state[here] == 0 or state[here] & _DEGREE > 1:
                continue
            square = dx[j] * dx[j] + dy[j] * dy[j]
            if state[here] & _USED == 0:
                if count == len(chosen):
                    squares, chosen = np.concatenate((squares, squares)), np.concatenate((chosen, chosen))
                state[here] |= _USED
                number[here] = count
                squares[count], chosen[count] = square, i
                count += 1
            elif square < squares[number[here]]:
                squares[number[here]], chosen[number[here]] = square, i
    drawn = np.empty(len(kept) + count * (reach + 1), np.int32)
    drawn[: len(kept)] = kept
    total = len(kept)
    for i in range(len(kept)):
        start = kept[i]
        if state[start] & _USED == 0:
            continue
        state[start] &= 255 - _USED
        corner = corners[chosen[number[start]]]
        x0, y0 = start % stride - 1, start // stride - 1
        across, down = corner[0] - x0, corner[1] - y0
        length = max(abs(across), abs(down))
        for j in range(1, length + 1):
            x, y = x0 + int(np.rint(across * j / length)), y0 + int(np.rint(down * j / length))
            here = (y + 1) * stride + x + 1
            if state[here] == 0:
                for k in range(8):
                    if state[here + steps[k]] != 0:
                        state[here + steps[k]] += 1
                state[here] = _KEPT | _COUNT[_pattern(state, here, stride)]
                drawn[total] = here
                total += 1
    return drawn[:total]


@called
def _follow(state: Array, chain: Array, filled: int, steps: Array, way: int) -> int:
    """Append to ``chain`` (x, y), whose last pixel is the first of ``filled``, up to a node or a used pixel.

    ``way`` is the direction of the first step. Returns the new ``filled``.
    """
    stride = steps[2]
    x, y = chain[filled - 1, 0], chain[filled - 1, 1]
    here = (y + 1) * stride + x + 1
    while True:
        came = here
        here += steps[way]
        x, y = x + _DX[way], y + _DY[way]
        chain[filled, 0], chain[filled, 1] = x, y
        filled += 1
        if state[here] & _USED or state[here] & _DEGREE != 2:
            return filled
        state[here] |= _USED
        back = way
        for turn in range(8):  # straight ahead first, then 1, -1, 2, -2, ...
            way = (back + ((turn + 1) // 2 if turn % 2 else -(turn // 2))) & 7
            if state[here + steps[way]] != 0 and here + steps[way] != came:
                break


@called
def _link(state: Array, kept: Array, stride: int, steps: Array) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends and branch points: points (N, 2) x, y and starts (M + 1,)."""
    count = total = 0
    for i in range(len(kept)):
        value = state[kept[i]]
        count += value != 0
        if value != 0 and value & _DEGREE != 2:
            total += max(value & _DEGREE, 1)
    chain = np.empty((2 * count + 2 * total + 2, 2), np.int32)
    starts = np.zeros(total + count + 2, np.int64)
    filled = chains = 0
    for i in range(len(kept)):
        node = kept[i]
        if state[node] == 0 or state[node] & _DEGREE == 2 or state[node] & _USED:
            continue
        x, y = node % stride - 1, node // stride - 1
        degree = state[node] & _DEGREE
        for way in range(8):
            here = node + steps[way]
            if state[here] == 0 or state[here] & _USED:  # from a node that was here before, it is linked already
                continue
            chain[filled, 0], chain[filled, 1] = x, y
            filled = _follow(state, chain, filled + 1, steps, way)
            chains += 1
            starts[chains] = filled
        state[node] |= _USED
        if degree == 0:
            chain[filled, 0], chain[filled, 1] = x, y
            filled += 1
            chains += 1
            starts[chains] = filled
    for i in range(len(kept)):  # what is left are closed lines without branches
        start = kept[i]
        if state[start] == 0 or state[start] & _USED:
            continue
        way = 0
        while state[start + steps[way]] == 0:
            way += 1
        state[start] |= _USED
        chain[filled, 0], chain[filled, 1] = start % stride - 1, start // stride - 1
        filled = _follow(state, chain, filled + 1, steps, way)
        chains += 1
        starts[chains] = filled
    return chain[:filled], starts[: chains + 1]


@compiled
def trace(
    marks: Array,
    seeds: Array,
    strength: Array,
    least: int,
    weight: float,
    longest: int,
    corners: Array,
    farthest: float,
) -> tuple[Array, Array]:
    """Link thinned pixels to chains.

    Parameters
    ----------
    marks
        (H + 2, W + 2) uint8, framed by a pixel of zeros: 1 where an edge may be; it is changed to 128 on edges, 255 on
        corners.
    seeds
        (N,) int32 places in ``marks``, taken as one row: what is connected with one of them is kept.
    strength
        (H, W) float32, looked at for ``weight`` only.
    least, weight
        Pieces of fewer pixels, or whose strengths add up to less than ``weight``, are left out.
    longest
        Branches of up to so many px that end freely are removed.
    corners
        (M, 2) int32 px inside the picture.
    farthest
        Free ends this near to a corner are led to it, px; 0 for none.

    Returns
    -------
    tuple
        Points (K, 2) int32 x, y; starts (C + 1,): chain i is points[starts[i]:starts[i + 1]], a closed one repeats its
        first point.
    """
    stride = marks.shape[1]
    state = marks.reshape(marks.size)
    steps = _DY * stride + _DX
    kept, crowded = _connected(state, seeds, strength, stride, steps, least, weight)
    _thin_out(state, crowded, len(crowded), stride, steps)
    if longest > 0:
        _prune(state, kept, stride, steps, longest)
    if farthest > 0.0 and len(corners) > 0:
        kept = _lead(state, kept, corners, stride, steps, farthest)
    points, starts = _link(state, kept, stride, steps)
    for i in range(len(kept)):
        if state[kept[i]] != 0:
            state[kept[i]] = _KEPT
    for i in range(len(corners)):
        state[(corners[i, 1] + 1) * stride + corners[i, 0] + 1] = _CORNER
    return points, starts


@compiled
def candidates(thinned: Array, low: float, high: float) -> tuple[Array, Array]:
    """Return marks and seeds, as ``trace`` takes them, of (H, W) float32: what is at least ``low``, and ``high``."""
    height, width = thinned.shape
    lower, upper, zero = np.float32(low), np.float32(max(low, high)), np.float32(0.0)
    result = np.zeros((height + 2, width + 2), np.uint8)
    seeds = np.empty(4096, np.int32)
    words = np.zeros((width + 31) // 32 * 4, np.uint64)
    marks = words.view(np.uint8)
    count = 0
    for y in range(height):
        row, out = thinned[y], result[y + 1, 1:]
        for x in range(width):
            out[x] = (row[x] > zero) & (row[x] >= lower)
            marks[x] = (row[x] > zero) & (row[x] >= upper)
        seeds, count = collect_marked(words, width, (y + 1) * (width + 2) + 1, seeds, count)
    return result, seeds[:count]
