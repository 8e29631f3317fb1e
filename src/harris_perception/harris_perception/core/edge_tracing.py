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

# States: a pixel of an edge; marks of what is drawn (before that, of a candidate), used, listed as odd; a corner.
_KEPT, _DRAWN, _USED, _LISTED, _CORNER = 128, 1, 32, 64, 255

# Of eight bytes their lowest bits, and the factor that gathers these in the uppermost byte.
_LOWEST_BITS, _GATHER = np.uint64(0x0101010101010101), np.uint64(0x0102040810204080)


def _tables() -> tuple[npt.NDArray[Any], ...]:
    """Return for each pattern of neighbours (bit i is the i-th) their number, the first, and two properties.

    A pixel is needless when at least two neighbours are set and they stay in one piece without it (Yokoi's number,
    8-connected), so that no end or connection is lost; it is odd when it is needless, may become so, or is an end.
    Then a table tells the next direction of a line from the one before, straight on first, by (direction, pattern).
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
    return count.astype(np.uint8), full.argmax(axis=1).astype(np.uint8), needless, needless | (count != 2), ahead, steps


_COUNT, _FIRST, _NEEDLESS, _ODD, _AHEAD, _DIRECT = _tables()
_AHEAD_FLAT = _AHEAD.reshape(-1)


# A number whose products with the powers of two differ in their upper six bits, and
# which power it was (C. Leiserson, H. Prokop, K. Randall, "Using de Bruijn Sequences to Index a 1 in a Computer Word").
_DE_BRUIJN = np.uint64(0x022FDD63CC95386D)
_POWERS = np.argsort([int(_DE_BRUIJN) * 2**i % 2**64 >> 58 for i in range(64)])


@called
def _lowest(bits: np.uint64) -> int:
    """Return the place of the lowest bit that is set."""
    return int(_POWERS[((bits & (~bits + np.uint64(1))) * _DE_BRUIJN) >> np.uint64(58)])


@called
def _neighbours(quads: Array, here: int, stride: int) -> np.uint64:
    """Return the states of the eight neighbours as the bytes of a word, in circular order."""
    # Unsigned, an index is not looked at whether it counts from the end.
    north, south, west = np.uint64(here - stride - 1), np.uint64(here + stride - 2), np.uint64(here - 1)
    above, below, beside = np.uint64(quads[north]), np.uint64(quads[south]), np.uint64(quads[west])
    word = (above << np.uint64(40)) | ((below >> np.uint64(16)) & np.uint64(0xFF00))  # NE N NW . . . SE .
    word |= (below & np.uint64(0xFF0000)) | ((below & np.uint64(0xFF00)) << np.uint64(16))  # . . . . SW S . .
    word |= ((beside & np.uint64(0xFF)) << np.uint64(32)) | ((beside >> np.uint64(16)) & np.uint64(0xFF))  # W and E
    return word


@called
def _pattern(neighbours: np.uint64, bit: int) -> np.uint8:
    """Return as bits in circular order which of the eight neighbours have a bit of their state."""
    return np.uint8((((neighbours >> np.uint64(bit)) & _LOWEST_BITS) * _GATHER) >> np.uint64(56))


@called
def _connected(
    state: Array, quads: Array, around: Array, seeds: Array, strength: Array, steps: Array, least: int, weight: float
) -> tuple[Array, Array, int, Array]:
    """Set the pixels of connected pieces with a seed to kept and clear all others; fill in their patterns ``around``.

    Returns their places; of these, in the same order, the free ends and those that may be needless, a list that can
    grow, and its length; and a bitmap of all, which is so small that it stays in the cache.
    """
    stride = steps[2]
    first_steps = steps[_FIRST]
    others = ~(1 << (_FIRST ^ 4)) & 255  # all neighbours but the one that a first step comes from
    # Growing lists would make the flood slower, counting the candidates first, too; what is not written costs nothing.
    kept, odd = np.empty(len(state) + 1, np.int32), np.empty(2 * len(state) + 1, np.int32)
    ahead = np.empty(len(state) + 1, np.uint8)  # where a line may go on: what is left is mostly one way, well predicted
    packed = np.zeros(len(state) // 64 + 2, np.uint64)
    one, last = np.uint64(1), np.uint64(63)
    around[:] = 0  # in the cache from here on: sooner than line by line later
    count = odds = 0
    left_out = len(kept)  # these are listed from the end on
    for i in range(len(seeds)):
        place = np.uint64(seeds[i])
        if (packed[place >> np.uint64(6)] >> (place & last)) & one:
            continue
        first, done, first_odd = count, count, odds
        kept[count] = seeds[i]
        ahead[count] = 255
        packed[place >> np.uint64(6)] |= one << (place & last)
        count += 1
        while done < count:
            here = kept[np.uint64(done)]
            pattern = _pattern(_neighbours(quads, here, stride), 0)
            around[np.uint64(here)] = pattern
            odd[np.uint64(odds)] = here
            odds += _ODD[np.uint64(pattern)]
            ways = np.uint64(pattern) & np.uint64(ahead[np.uint64(done)])
            done += 1
            while ways:
                place = np.uint64(here + first_steps[ways])
                word, bit = packed[place >> np.uint64(6)], one << (place & last)
                if word & bit == 0:
                    packed[place >> np.uint64(6)] = word | bit
                    kept[np.uint64(count)], ahead[np.uint64(count)] = place, others[ways]
                    count += 1
                ways &= ways - one
        total = 0.0
        if weight > 0.0:
            for j in range(first, count):
                total += strength[kept[j] // stride - 1, kept[j] % stride - 1]
        if count - first < least or total < weight:
            for j in range(first, count):
                left_out -= 1
                kept[left_out] = kept[j]
            count, odds = first, first_odd
    state[:] = 0
    for i in range(count):
        state[kept[i]] = _KEPT
    for i in range(odds):
        state[odd[i]] = _KEPT | _LISTED
    for i in range(left_out, len(kept)):
        place = np.uint64(kept[i])
        packed[place >> np.uint64(6)] &= ~(one << (place & last))
    return kept[:count], odd, odds, packed


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
def _add(state: Array, odd: Array, odds: int, here: int) -> int:
    """List a pixel, if it is one of an edge and not listed; return the length of the list."""
    if state[here] & (_KEPT | _LISTED) == _KEPT:
        state[here] |= _LISTED
        odd[odds] = here
        odds += 1
    return odds


@called
def _thin_out(state: Array, around: Array, places: Array, count: int, steps: Array) -> int:
    """Remove needless pixels among the first ``count`` places, until there are none; return how many."""
    total, before = 0, -1
    while total > before:
        before = total
        for i in range(count):
            here = places[i]
            if _NEEDLESS[around[here]]:
                _drop(state, around, here, steps)
                total += 1
    return total


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
def _prune(
    state: Array, around: Array, odd: Array, odds: int, most: int, steps: Array, longest: int
) -> tuple[int, int]:
    """Remove branches of up to ``longest`` pixels that end freely, shortest first, and what becomes needless then.

    The ends are among the first ``odds`` of ``odd``; there may be ``most``. Where branches were is added to that list.
    Returns its length and how many pixels were removed.
    """
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(most, np.int32), np.empty(most, np.int32)
    count = removed = 0
    for i in range(odds):  # ends are many, branches few: seen from there, most ends need no look
        branch = odd[i]
        pattern = around[branch] if _COUNT[around[branch]] > 2 else np.uint8(0)
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            here = branch
            for _ in range(longest):
                here += steps[way]
                ahead = around[here] & ~(1 << (way ^ 4))
                if ahead == 0:
                    state[here] |= _USED
                if ahead == 0 or ahead & (ahead - 1):
                    break
                way = _FIRST[ahead]
    for i in range(odds):
        if state[odd[i]] & _USED:
            state[odd[i]] &= 255 - _USED
            ends[count], (lengths[count], _) = odd[i], _branch(around, odd[i], steps, path)
            count += 1
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
            removed += length
            near = 0
            pattern = around[branch]
            while pattern:
                beside[near] = branch + steps[_FIRST[pattern]]
                pattern &= pattern - 1
                near += 1
            beside[near] = branch
            removed += _thin_out(state, around, beside, near + 1, steps)
            for j in range(near + 1):
                odds = _add(state, odd, odds, beside[j])
                if count < len(ends) and _COUNT[around[beside[j]]] == 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1
    return odds, removed


@called
def _cut(
    state: Array, packed: Array, around: Array, corners: Array, stride: int, radius: float, farthest: float
) -> tuple[Array, Array, int, int]:
    """Clear what lies within a radius of a corner (N, 2) px; patterns of what is beside it are left as they were.

    ``packed`` has a bit for each pixel of the frame, set where an edge is or was. Returns what else it has up to the
    radius ``farthest``, as the bits of some rows around a corner, one after the other, as many as make a word; where
    each word begins, its corner, x, y; how many columns a row has in it; and how many pixels were cleared.
    """
    width, height = stride - 2, len(state) // stride - 2
    reach = int(farthest)
    side = 2 * reach + 1
    parts = (side + 63) // 64
    columns = (side + parts - 1) // parts
    rows = 64 // columns
    across, down = np.arange(64) % columns, np.arange(64) // columns
    inner, outer = np.zeros((2, parts, (side + rows - 1) // rows), np.uint64)
    for part in range(parts):
        for group in range(inner.shape[1]):
            for bit in range(rows * columns):
                x, y = part * columns + across[bit] - reach, group * rows + down[bit] - reach
                if x * x + y * y <= radius * radius:
                    inner[part, group] |= np.uint64(1) << np.uint64(bit)
                elif x * x + y * y <= farthest * farthest:
                    outer[part, group] |= np.uint64(1) << np.uint64(bit)
    begins, remains = np.empty((len(corners), 3), np.int32), np.empty(len(corners), np.uint64)
    count = removed = 0
    for i in range(len(corners)):
        for part in range(parts):
            left = corners[i, 0] - reach + part * columns
            first = max(left, 0)
            shift = np.uint64(first - left)
            inside = min(min(left + columns, corners[i, 0] + reach + 1), width) - first
            if inside <= 0:
                continue
            mask = ~np.uint64(0) >> np.uint64(64 - inside)
            for group in range(inner.shape[1]):
                top = corners[i, 1] - reach + group * rows
                word = np.uint64(0)
                for y in range(max(top, 0), min(min(top + rows, corners[i, 1] + reach + 1), height)):
                    place = (y + 1) * stride + first + 1
                    low, high = packed[np.uint64(place >> 6)], packed[np.uint64((place >> 6) + 1)]
                    row = (low >> np.uint64(place & 63)) | ((high << np.uint64(1)) << np.uint64(63 - (place & 63)))
                    word |= ((row & mask) << shift) << np.uint64((y - top) * columns)
                if word == 0:
                    continue
                if count == len(remains):
                    begins, remains = np.concatenate((begins, begins)), np.concatenate((remains, remains))
                begins[count, 0], begins[count, 1], begins[count, 2] = i, left, top
                remains[count] = word & outer[part, group]
                count += remains[count] != 0
                word &= inner[part, group]
                while word:
                    bit = _lowest(word)
                    word &= word - np.uint64(1)
                    here = (top + down[bit] + 1) * stride + left + across[bit] + 1
                    removed += state[np.uint64(here)] != 0
                    state[np.uint64(here)] = around[np.uint64(here)] = 0
    return remains[:count], begins[:count], columns, removed


@called
def _ends_near(
    state: Array,
    quads: Array,
    around: Array,
    odd: Array,
    odds: int,
    cut: tuple[Array, Array, int, int],
    corners: Array,
    stride: int,
    radius: float,
) -> tuple[Array, int]:
    """Return pairs (N, 2) of a free end within a radius of a corner, and that corner, the nearest pairs first.

    Ends get marked as used. ``cut`` is from ``_cut``; the patterns of these pixels are renewed, and they are added to
    the list ``odd``, whose length is returned, too.
    """
    remains, begins, columns, _ = cut
    across, down = np.arange(64) % columns, np.arange(64) // columns
    most = int(radius * radius)
    found = np.empty((4096, 3), np.int32)
    starts = np.zeros(most + 2, np.int32)
    count = 0
    for number in range(len(remains)):
        i, left, top = begins[number]
        word = remains[number]
        while word:
            bit = _lowest(word)
            word &= word - np.uint64(1)
            x, y = left + across[bit], top + down[bit]
            here = (y + 1) * stride + x + 1
            if state[np.uint64(here)] == 0:  # removed before, or cut at another corner
                continue
            pattern = _pattern(_neighbours(quads, here, stride), 7)
            around[np.uint64(here)] = pattern
            odds = _add(state, odd, odds, here)
            square = (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2
            if _COUNT[np.uint64(pattern)] > 1 or square > most:
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
    return pairs, odds


@called
def _lead(
    state: Array,
    quads: Array,
    around: Array,
    packed: Array,
    odd: Array,
    odds: int,
    corners: Array,
    steps: Array,
    farthest: float,
) -> tuple[int, int]:
    """Draw lines from free ends to the nearest corner (N, 2) px within reach.

    Edges round corners off on the outside, so what passes within three quarters of the reach is cut first. All pairs
    are seen from the corners, which are fewer than pixels. Pixels with new neighbours are added to the list ``odd``.
    Returns its length, and how many pixels there are more than before.
    """
    stride = steps[2]
    radius = 0.75 * farthest
    cut = _cut(state, packed, around, corners, stride, radius, max(farthest, radius + 1.5))  # with all neighbours
    pairs, odds = _ends_near(state, quads, around, odd, odds, cut, corners, stride, farthest)
    first = odds
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
            if state[np.uint64(here)] == 0:
                state[np.uint64(here)] = _KEPT | _DRAWN | _LISTED
                odd[np.uint64(odds)] = here
                odds += 1
    drawn = odds - first
    for i in range(first, first + drawn):
        here = odd[i]
        neighbours = _neighbours(quads, here, stride)
        pattern = _pattern(neighbours, 7)
        around[here] = pattern
        old = np.int64(pattern) & ~np.int64(_pattern(neighbours, 0))
        while old:
            way = _FIRST[old]
            old &= old - 1
            around[here + steps[way]] |= 1 << (way ^ 4)
            odds = _add(state, odd, odds, here + steps[way])
    for i in range(first, first + drawn):
        state[odd[i]] = _KEPT | _LISTED
    return odds, drawn - cut[3]


@called
def _follow(around: Array, chain: Array, filled: int, stride: int, turns: Array, way: int) -> int:
    """Append to ``chain`` (x, y), whose last pixel is the first of ``filled``, up to a node or what is linked already.

    ``way`` is the direction of the first step; ``turns`` tells the next one by direction and pattern, and, times eight,
    how far away it lies. Patterns of what is linked become 0. Returns the new ``filled``.
    """
    x, y = chain[filled - 1, 0], chain[filled - 1, 1]
    here = (y + 1) * stride + x + 1
    to = np.uint64(way)
    here += _DY[to] * stride + _DX[to]
    while True:
        x, y = x + _DX[to], y + _DY[to]
        chain[np.uint64(filled), 0], chain[np.uint64(filled), 1] = x, y
        filled += 1
        pattern = around[np.uint64(here)]
        if _COUNT[np.uint64(pattern)] != 2:
            return filled
        around[np.uint64(here)] = 0
        turn = turns[to, np.uint64(pattern)]
        here += turn >> 3
        to = np.uint64(turn & 7)


@called
def _link(
    state: Array, around: Array, kept: Array, alive: int, odd: Array, odds: int, corners: Array, steps: Array
) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends, branches and corners: points (N, 2) x, y, starts (M + 1,).

    All pixels that may have other than two neighbours are among the first ``odds`` of ``odd``; closed lines without
    such among ``kept``. Of all there are ``alive`` pixels.
    """
    stride = steps[2]
    nodes = links = 0
    node_places, patterns = np.empty(len(corners) + odds, np.int32), np.empty(len(corners) + odds, np.uint8)
    for i in range(len(corners)):  # a line that goes through a corner is two
        here = (corners[i, 1] + 1) * stride + corners[i, 0] + 1
        if state[here] == 0:
            continue
        pattern = _DIRECT[around[here]]
        if _COUNT[pattern] == 2:
            node_places[nodes], patterns[nodes] = here, pattern
            state[here], around[here] = _KEPT, 0
            links += 2
            nodes += 1
    for i in range(odds):
        here = odd[i]
        if state[here] & _LISTED == 0:  # removed, or a second time
            continue
        state[here] = _KEPT
        pattern = _DIRECT[around[here]]
        around[here] = pattern
        if _COUNT[pattern] != 2:
            node_places[nodes], patterns[nodes] = here, pattern
            links += max(_COUNT[pattern], 1)
            nodes += 1
    between = alive - nodes  # these have two neighbours
    turns = (steps * 8 + np.arange(8, dtype=np.int32))[_AHEAD_FLAT].reshape(8, 256)
    chain = np.empty((2 * between + 2 * links + 2, 2), np.int32)
    starts = np.zeros(between + links + 2, np.int64)
    filled = chains = 0
    for i in range(nodes):
        node, pattern = node_places[i], patterns[i]
        x, y = node % stride - 1, node // stride - 1
        if pattern == 0:
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
            filled = _follow(around, chain, filled + 1, stride, turns, way)
            chains += 1
            between -= filled - starts[chains - 1] - 2
            starts[chains] = filled
        around[node] = 0
    for i in range(len(kept) if between > 0 else 0):  # what is left are closed lines without branches
        start = kept[i]
        pattern = around[start]
        if pattern == 0:
            continue
        around[start] = 0
        chain[filled, 0], chain[filled, 1] = start % stride - 1, start // stride - 1
        filled = _follow(around, chain, filled + 1, stride, turns, _FIRST[pattern])
        chains += 1
        starts[chains] = filled
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
    kept, odd, odds, packed = _connected(state, quads, around, seeds, strength, steps, least, weight)
    alive = len(kept) - _thin_out(state, around, odd, odds, steps)
    if longest > 0:
        odds, removed = _prune(state, around, odd, odds, len(kept) + 1, steps, longest)
        alive -= removed
    if farthest > 0.0 and len(corners) > 0:
        odds, more = _lead(state, quads, around, packed, odd, odds, corners, steps, farthest)
        alive += more
    points, starts = _link(state, around, kept, alive, odd, odds, corners, steps)
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
