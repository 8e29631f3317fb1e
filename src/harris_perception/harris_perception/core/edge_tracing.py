"""From the pixels of thinned edges to chains: hysteresis, a skeleton, spurs, corners, links; compiled by numba.

Everything here touches edge pixels only, in lists, on a picture framed by one empty pixel, where neighbours are
constant distances and need no test for the border. Which of the eight neighbours belong to edges is gathered once for
each pixel, as the bits of a byte, and kept up to date; ends, branches, needless pixels and the way ahead are then one
look at a table of 256 patterns, without a look at the neighbours.
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

# States: a candidate; a pixel of an edge; the mark of what is done with; a corner in the result.
_WEAK, _KEPT, _USED, _CORNER = 1, 128, 32, 255

# Of eight bytes their lowest bits, and the factor that gathers these in the uppermost byte.
_LOWEST_BITS, _GATHER = np.uint64(0x0101010101010101), np.uint64(0x0102040810204080)


def _tables() -> tuple[npt.NDArray[Any], ...]:
    """Return for each pattern of neighbours (bit i is the i-th) their number, the first, and two properties.

    A pixel is needless when at least two neighbours are set and they stay in one piece without it (Yokoi's number,
    8-connected), so that no end or connection is lost; it is crowded when it is needless, or may become so. The last
    table tells the next direction of a line from the one before, straight on first, by (direction, pattern).
    """
    full = np.array([[pattern >> i & 1 for i in range(8)] for pattern in range(256)])
    empty = 1 - full
    sides, after, beyond = empty[:, 0::2], empty[:, 1::2], np.roll(empty, -2, axis=1)[:, 0::2]
    pieces = (sides - sides * after * beyond).sum(axis=1)
    count = full.sum(axis=1)
    needless = (count >= 2) & (pieces == 1)
    ahead = np.zeros((8, 256), np.uint8)
    for way in range(8):
        for turn in (-3, 3, -2, 2, -1, 1, 0):  # the later the better
            to = (way + turn) % 8
            ahead[way, full[:, to] == 1] = to
    # What a pixel with a common side leads to as well needs no diagonal step.
    direct = full.copy()
    direct[:, 1::2] &= empty[:, 0::2] & np.roll(empty, -2, axis=1)[:, 0::2]
    steps = (direct << np.arange(8)).sum(axis=1).astype(np.uint8)
    return count.astype(np.uint8), full.argmax(axis=1).astype(np.uint8), needless, needless | (count > 2), ahead, steps


_COUNT, _FIRST, _NEEDLESS, _CROWDED, _AHEAD, _DIRECT = _tables()


# Of eight bytes their highest bits; a number whose products with the powers of two differ in their upper six bits, and
# which power it was (C. Leiserson, H. Prokop, K. Randall, "Using de Bruijn Sequences to Index a 1 in a Computer Word").
_HIGHEST_BITS, _DE_BRUIJN = np.uint64(0x8080808080808080), np.uint64(0x022FDD63CC95386D)
_POWERS = np.argsort([int(_DE_BRUIJN) * 2**i % 2**64 >> 58 for i in range(64)])


@called
def _lowest(bits: np.uint64) -> int:
    """Return the place of the lowest bit that is set."""
    return int(_POWERS[((bits & (~bits + np.uint64(1))) * _DE_BRUIJN) >> np.uint64(58)])


@called
def _pattern(quads: Array, here: int, stride: int, bit: int) -> np.uint8:
    """Return as bits in circular order which of the eight neighbours have a bit of their state."""
    # Unsigned, an index is not looked at whether it counts from the end.
    north, south, west = np.uint64(here - stride - 1), np.uint64(here + stride - 2), np.uint64(here - 1)
    above, below, beside = np.uint64(quads[north]), np.uint64(quads[south]), np.uint64(quads[west])
    word = (above << np.uint64(40)) | ((below >> np.uint64(16)) & np.uint64(0xFF00))  # NE N NW . . . SE .
    word |= (below & np.uint64(0xFF0000)) | ((below & np.uint64(0xFF00)) << np.uint64(16))  # . . . . SW S . .
    word |= ((beside & np.uint64(0xFF)) << np.uint64(32)) | ((beside >> np.uint64(16)) & np.uint64(0xFF))  # W and E
    return np.uint8((((word >> np.uint64(bit)) & _LOWEST_BITS) * _GATHER) >> np.uint64(56))


@called
def _connected(
    state: Array, quads: Array, around: Array, seeds: Array, strength: Array, steps: Array, least: int, weight: float
) -> tuple[Array, Array]:
    """Set the pixels of connected pieces with a seed to kept and clear all others; fill in the patterns ``around``.

    Returns their places, and of these the ones that may be needless.
    """
    stride = steps[2]
    first_steps = steps[_FIRST]
    # Growing lists would make the flood slower, counting the candidates first, too; what is not written costs nothing.
    kept, crowded = np.empty(len(state) + 1, np.int32), np.empty(len(state) + 1, np.int32)
    count = full = 0
    around[:] = 0
    for i in range(len(seeds)):
        if around[seeds[i]] != 0:
            continue
        first, done, first_full = count, count, full
        kept[count] = seeds[i]
        around[seeds[i]] = 255
        count += 1
        while done < count:
            here = kept[done]
            done += 1
            pattern = _pattern(quads, here, stride, 0)
            around[here] = pattern
            crowded[full] = here
            full += _CROWDED[pattern]
            while pattern:
                beside = here + first_steps[pattern]
                pattern &= pattern - 1
                if around[beside] == 0:
                    around[beside] = 255
                    kept[count] = beside
                    count += 1
        total = 0.0
        if weight > 0.0:
            for j in range(first, count):
                total += strength[kept[j] // stride - 1, kept[j] % stride - 1]
        if count - first < least or total < weight:
            count, full = first, first_full
    state[:] = 0
    for i in range(count):
        state[kept[i]] = _KEPT
    return kept[:count], crowded[:full]


@called
def _drop(state: Array, around: Array, here: int, steps: Array) -> None:
    """Clear a pixel, and its bit in its neighbours' patterns."""
    pattern = around[here]
    state[here] = around[here] = 0
    while pattern:
        way = _FIRST[pattern]
        pattern &= pattern - 1
        around[here + steps[way]] &= ~(1 << (way ^ 4))


@called
def _thin_out(state: Array, around: Array, crowded: Array, count: int, steps: Array) -> None:
    """Remove needless pixels among the first ``count`` places of ``crowded``, until there are none."""
    removed = True
    while removed:
        removed = False
        for i in range(count):
            here = crowded[i]
            if _NEEDLESS[around[here]]:
                _drop(state, around, here, steps)
                removed = True


@called
def _branch(around: Array, end: int, steps: Array, path: Array) -> tuple[int, int]:
    """Follow a line from its free end into ``path``; return its length and where it branches, or 0, -1."""
    here, length, back = end, 0, 0
    while length < len(path):
        pattern = around[here] & ~back
        if pattern == 0:
            break  # a line of its own
        way = _FIRST[pattern]
        if pattern & (pattern - 1):
            return length, here
        path[length] = here
        length += 1
        here += steps[way]
        back = 1 << (way ^ 4)
    return 0, -1


@called
def _prune(state: Array, around: Array, kept: Array, steps: Array, longest: int) -> None:
    """Remove branches of up to ``longest`` pixels that end freely, shortest first, and what becomes needless then."""
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(len(kept) + 1, np.int32), np.empty(len(kept) + 1, np.int32)
    count = 0
    for i in range(len(kept)):
        if _COUNT[around[kept[i]]] == 1:
            length, _ = _branch(around, kept[i], steps, path)
            ends[count], lengths[count] = kept[i], length
            count += 0 < length <= longest
    # Short branches first: of two at the end of a line the longer one continues it.
    for shortest in range(1, longest + 1):
        i = 0
        while i < count:
            end = ends[i]
            i += 1
            if lengths[i - 1] > shortest or _COUNT[around[end]] != 1:
                continue
            length, branch = _branch(around, end, steps, path)
            if length == 0 or length > shortest:
                lengths[i - 1] = length if length > 0 else longest + 1
                continue
            for j in range(length):
                _drop(state, around, path[j], steps)
            near = 0
            pattern = around[branch]
            while pattern:
                beside[near] = branch + steps[_FIRST[pattern]]
                pattern &= pattern - 1
                near += 1
            beside[near] = branch
            _thin_out(state, around, beside, near + 1, steps)
            for j in range(near + 1):
                if count < len(ends) and _COUNT[around[beside[j]]] == 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1


@called
def _disc(radius: float, reach: int, left: int, top: int) -> np.uint64:
    """Return which of 8 x 8 pixels, from ``left``, ``top`` of a square on, lie within a radius around its middle."""
    result = np.uint64(0)
    for bit in range(64):
        x, y = left + bit // 8 - reach, top + bit % 8 - reach
        if max(abs(x), abs(y)) <= reach and x * x + y * y <= radius * radius:
            result |= np.uint64(1) << np.uint64(bit)
    return result


@called
def _block(state: Array, quads: Array, left: int, top: int, rows: int, width: int, height: int) -> np.uint64:
    """Return which of 8 x 8 pixels of the picture, or of only so many rows, belong to edges.

    As bits, column by column; pixels outside the picture do not.
    """
    stride = width + 2
    result = np.uint64(0)
    if left >= 0 and top >= 0 and left + 8 <= width and top + rows <= height:
        place = np.uint64((top + 1) * stride + left + 1)
        for y in range(rows):
            eight = np.uint64(quads[place]) | (np.uint64(quads[place + np.uint64(4)]) << np.uint64(32))
            result |= (eight & _HIGHEST_BITS) >> np.uint64(7 - y)
            place += np.uint64(stride)
        return result
    for x in range(max(-left, 0), min(width - left, 8)):
        for y in range(max(-top, 0), min(height - top, rows)):
            edge = state[(top + y + 1) * stride + left + x + 1] >> 7
            result |= np.uint64(edge) << np.uint64(8 * x + y)
    return result


@called
def _cut(
    state: Array, quads: Array, around: Array, corners: Array, stride: int, radius: float, reach: int
) -> tuple[Array, Array]:
    """Clear what lies within a radius of a corner (N, 2) px; patterns of what is beside it are left as they were.

    Returns what else lies within a square of ``reach`` around the corners, as bits of blocks of 8 x 8 pixels, and of
    each block its corner and where it begins, x, y.
    """
    width, height, side = stride - 2, len(state) // stride - 2, 2 * reach + 1
    across = (side + 7) // 8
    square, inner = np.empty((across, across), np.uint64), np.empty((across, across), np.uint64)
    for row in range(across):
        for column in range(across):
            square[row, column] = _disc(2.0 * side, reach, 8 * column, 8 * row)
            inner[row, column] = _disc(radius, reach, 8 * column, 8 * row)
    offsets = np.arange(64) // 8 + np.arange(64) % 8 * stride
    begins, remains = np.empty((len(corners), 3), np.int32), np.empty(len(corners), np.uint64)
    count = 0
    for i in range(len(corners)):
        for row in range(across):
            for column in range(across):
                left, top = corners[i, 0] - reach + 8 * column, corners[i, 1] - reach + 8 * row
                block = _block(state, quads, left, top, min(8, side - 8 * row), width, height) & square[row, column]
                if count == len(remains):
                    begins, remains = np.concatenate((begins, begins)), np.concatenate((remains, remains))
                begins[count, 0], begins[count, 1], begins[count, 2] = i, left, top
                remains[count] = block & ~inner[row, column]
                count += remains[count] != 0
                block &= inner[row, column]
                while block:
                    here = (top + 1) * stride + left + 1 + offsets[_lowest(block)]
                    block &= block - np.uint64(1)
                    state[here] = around[here] = 0
    return remains[:count], begins[:count]


@called
def _ends_near(
    state: Array, quads: Array, around: Array, remains: Array, begins: Array, corners: Array, stride: int, radius: float
) -> Array:
    """Return pairs (N, 2) of a free end within a radius of a corner, and that corner, the nearest pairs first.

    Ends get marked as used. ``remains`` and ``begins`` are from ``_cut``; the patterns of these pixels are renewed.
    """
    most = int(radius * radius)
    found = np.empty((4096, 3), np.int32)
    starts = np.zeros(most + 2, np.int32)
    count = 0
    for number in range(len(remains)):
        i, left, top = begins[number]
        block = remains[number]
        while block:
            bit = _lowest(block)
            block &= block - np.uint64(1)
            x, y = left + bit // 8, top + bit % 8
            here = (y + 1) * stride + x + 1
            if state[here] == 0:  # cut at another corner
                continue
            pattern = _pattern(quads, here, stride, 7)
            around[here] = pattern
            square = (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2
            if _COUNT[pattern] > 1 or square > most:
                continue
            if count == len(found):
                found = np.concatenate((found, found))
            found[count, 0], found[count, 1], found[count, 2] = here, i, square
            count += 1
            starts[square + 1] += 1
            state[here] |= _USED
    for square in range(most):
        starts[square + 1] += starts[square]
    pairs = np.empty((count, 2), np.int32)
    for i in range(count):
        square = found[i, 2]
        pairs[starts[square]] = found[i, :2]
        starts[square] += 1
    return pairs


@called
def _lead(
    state: Array, quads: Array, around: Array, kept: Array, corners: Array, steps: Array, farthest: float
) -> Array:
    """Draw lines from free ends to the nearest corner (N, 2) px within reach; return ``kept`` and what was drawn.

    Edges round corners off on the outside, so what passes within three quarters of the reach is cut first. All pairs
    are seen from the corners, which are fewer than pixels.
    """
    stride = steps[2]
    cut = 0.75 * farthest
    reach = max(int(farthest), int(cut) + 1)  # what was cut had neighbours in this square at most
    remains, begins = _cut(state, quads, around, corners, stride, cut, reach)
    pairs = _ends_near(state, quads, around, remains, begins, corners, stride, farthest)
    drawn = np.empty(len(kept) + len(pairs) * (reach + 1), np.int32)
    drawn[: len(kept)] = kept
    total = len(kept)
    for i in range(len(pairs)):
        start, corner = pairs[i, 0], corners[pairs[i, 1]]
        if state[start] & _USED == 0:  # led to a nearer one
            continue
        state[start] &= 255 - _USED
        x0, y0 = start % stride - 1, start // stride - 1
        dx, dy = corner[0] - x0, corner[1] - y0
        length = max(abs(dx), abs(dy))
        for j in range(1, length + 1):
            x, y = x0 + int(np.rint(dx * j / length)), y0 + int(np.rint(dy * j / length))
            here = (y + 1) * stride + x + 1
            if state[here] == 0:
                state[here] = _KEPT
                pattern = _pattern(quads, here, stride, 7)
                around[here] = pattern
                while pattern:
                    way = _FIRST[pattern]
                    pattern &= pattern - 1
                    around[here + steps[way]] |= 1 << (way ^ 4)
                drawn[total] = here
                total += 1
    return drawn[:total]


@called
def _follow(around: Array, chain: Array, filled: int, steps: Array, way: int) -> int:
    """Append to ``chain`` (x, y), whose last pixel is the first of ``filled``, up to a node or what is linked already.

    ``way`` is the direction of the first step. Patterns of what is linked become 0. Returns the new ``filled``.
    """
    stride = steps[2]
    x, y = chain[filled - 1, 0], chain[filled - 1, 1]
    here = (y + 1) * stride + x + 1
    while True:
        here += steps[way]
        x, y = x + _DX[way], y + _DY[way]
        chain[filled, 0], chain[filled, 1] = x, y
        filled += 1
        pattern = around[here]
        if _COUNT[pattern] != 2:
            return filled
        around[here] = 0
        way = _AHEAD[way, pattern]


@called
def _link(state: Array, around: Array, kept: Array, corners: Array, steps: Array) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends, branches and corners: points (N, 2) x, y, starts (M + 1,)."""
    stride = steps[2]
    count = total = nodes = 0
    node_places = np.empty(len(kept) + len(corners), np.int32)
    for i in range(len(kept)):
        around[kept[i]] = _DIRECT[around[kept[i]]]
    passed = np.empty(len(corners), np.uint8)  # the patterns of corners that a line goes through
    for i in range(len(corners)):
        here = (corners[i, 1] + 1) * stride + corners[i, 0] + 1
        if state[here] != 0 and _COUNT[around[here]] == 2:
            node_places[nodes], passed[nodes] = here, around[here]
            around[here] = 0
            nodes += 1
    through = nodes
    total = 2 * through
    for i in range(len(kept)):
        degree = _COUNT[around[kept[i]]]
        if degree == 2:
            count += 1
        elif degree > 0 or state[kept[i]] != 0:
            count += 1
            total += max(degree, 1)
            node_places[nodes] = kept[i]
            nodes += 1
    chain = np.empty((2 * count + 2 * total + 2, 2), np.int32)
    starts = np.zeros(total + count + 2, np.int64)
    filled = chains = 0
    for i in range(nodes):
        node = node_places[i]
        x, y = node % stride - 1, node // stride - 1
        pattern = passed[i] if i < through else around[node]
        if pattern == 0 and state[node] == _KEPT:  # what was cut and drawn again is listed twice
            chain[filled, 0], chain[filled, 1] = x, y
            filled += 1
            chains += 1
            starts[chains] = filled
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            if around[node + steps[way]] == 0:  # linked already, from its other end
                continue
            chain[filled, 0], chain[filled, 1] = x, y
            filled = _follow(around, chain, filled + 1, steps, way)
            chains += 1
            starts[chains] = filled
        around[node] = 0
        state[node] = _USED
    for i in range(len(kept)):  # what is left are closed lines without branches
        start = kept[i]
        pattern = around[start]
        if pattern == 0:
            continue
        around[start] = 0
        chain[filled, 0], chain[filled, 1] = start % stride - 1, start // stride - 1
        filled = _follow(around, chain, filled + 1, steps, _FIRST[pattern])
        chains += 1
        starts[chains] = filled
    for i in range(nodes):
        state[node_places[i]] = _KEPT
    return chain[:filled], starts[: chains + 1]


@compiled
def trace(
    marks: Array,
    quads: Array,
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
    quads
        (N - 3,) uint32: the same memory, any four bytes as a number, the first the lowest.
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
    around = np.empty(marks.size, np.uint8)
    kept, crowded = _connected(state, quads, around, seeds, strength, steps, least, weight)
    _thin_out(state, around, crowded, len(crowded), steps)
    if longest > 0:
        _prune(state, around, kept, steps, longest)
    if farthest > 0.0 and len(corners) > 0:
        kept = _lead(state, quads, around, kept, corners, steps, farthest)
    points, starts = _link(state, around, kept, corners, steps)
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
