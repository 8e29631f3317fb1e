"""From the pixels of thinned edges to chains: hysteresis, a skeleton, spurs, corners, links; compiled by numba.

Everything here works on lists of edge pixels and on bitmaps, which are framed by empty pixels, so that neighbours are
constant distances and need no test for the border. Which of the eight neighbours belong to edges is read from three
words as the bits of a byte; ends, branches, needless pixels and the way ahead are then one look at a table of 256
patterns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.bitmap import MARGIN, clear, has, lowest, pack, put, window
from harris_perception.core.compiled import called, compiled

Array = npt.NDArray[Any]

# Neighbours in circular order; even ones share a side.
_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)

# Px from a corner within which an edge may pass by it, rounding it off.
_ROUNDED_OFF = 6.0

# What is told of every pixel; 0 is neither.
EDGE, CORNER = 128, 255

_ONE, _LAST = np.uint64(1), np.uint64(63)


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

# The neighbours in circular order by the nine bits of a window of 3x3, in the order of rows.
_NEIGHBOURS = (((np.arange(512)[:, None] >> (3 * _DY + _DX + 4)) & 1) << np.arange(8)).sum(axis=1).astype(np.uint8)
_STEPS = _DIRECT[_NEIGHBOURS]
# The next direction of a line by (direction, window), one behind the other; 8 where a line does not go on by itself.
_ONWARD = np.where(_COUNT[_STEPS] == 2, _AHEAD[:, _STEPS], 8).reshape(-1)


@called
def _pattern(words: Array, here: int, row: int) -> np.uint8:
    """Return as bits in circular order which of the eight neighbours are set; ``row`` is the bytes of one."""
    return np.uint8(_NEIGHBOURS[window(words, here, row)])


@called
def _connected(
    bits: Array, words: Array, strong: Array, strength: Array, steps: Array, least: int, weight: float
) -> tuple[int, Array, int, Array]:
    """Clear all pixels but those of connected pieces with a strong one.

    Returns how many are left; of these the places of free ends and of those that may be needless, a list that can grow,
    and its length; and the same as a bitmap.
    """
    stride = steps[2]
    row = stride >> 3
    first_steps = steps[_FIRST]
    others = ~(1 << (_FIRST ^ 4)) & 255  # all neighbours but the one that a first step comes from
    # Growing lists would make the flood slower, counting the candidates first, too; what is not written costs nothing.
    most = 64 * len(bits)
    kept, odd = np.empty(most, np.int32), np.empty(2 * most, np.int32)
    ahead = np.empty(most, np.uint8)  # where a line may go on: what is left is mostly one way, well predicted
    seen = np.zeros(len(bits), np.uint64)
    count = odds = 0
    left_out = len(kept)  # these are listed from the end on
    for i in range(len(strong)):
        while strong[i] & ~seen[i]:
            first, done, first_odd = count, count, odds
            kept[count] = 64 * i + lowest(strong[i] & ~seen[i])
            ahead[count] = 255
            put(seen, kept[count])
            count += 1
            while done < count:
                here = kept[np.uint64(done)]
                pattern = _pattern(words, here, row)
                odd[np.uint64(odds)] = here
                odds += _ODD[np.uint64(pattern)]
                ways = np.uint64(pattern) & np.uint64(ahead[np.uint64(done)])
                done += 1
                while ways:
                    place = np.uint64(here + first_steps[ways])
                    word, bit = seen[place >> np.uint64(6)], _ONE << (place & _LAST)
                    if word & bit == 0:
                        seen[place >> np.uint64(6)] = word | bit
                        kept[np.uint64(count)], ahead[np.uint64(count)] = place, others[ways]
                        count += 1
                    ways &= ways - _ONE
            total = 0.0
            if weight > 0.0:
                for j in range(first, count):
                    total += strength[kept[j] // stride - 1, kept[j] % stride - MARGIN]
            if count - first < least or total < weight:
                for j in range(first, count):
                    left_out -= 1
                    kept[left_out] = kept[j]
                count, odds = first, first_odd
    for i in range(left_out, len(kept)):
        clear(seen, kept[i])
    listed = seen
    for i in range(len(bits)):  # an assignment to a slice moves them one by one
        bits[i], seen[i] = seen[i], 0
    for i in range(odds):
        put(listed, odd[i])
    return count, odd, odds, listed


@called
def _add(bits: Array, listed: Array, odd: Array, odds: int, here: int) -> int:
    """List a pixel, if it is one of an edge and not listed; return the length of the list."""
    if has(bits, here) and not has(listed, here):
        put(listed, here)
        odd[odds] = here
        odds += 1
    return odds


@called
def _thin_out(bits: Array, words: Array, places: Array, count: int, row: int) -> None:
    """Remove needless pixels among the first ``count`` places, until there are none."""
    changed = True
    while changed:
        changed = False
        for i in range(count):
            here = places[i]
            if _NEEDLESS[_pattern(words, here, row)] and has(bits, here):
                clear(bits, here)
                changed = True


@called
def _branch(words: Array, end: int, steps: Array, path: Array) -> tuple[int, int]:
    """Follow a line from its free end into ``path``; return its length and where it branches, or 0, -1."""
    here, length, back = end, 0, 0
    while length < len(path):
        pattern = _pattern(words, here, steps[2] >> 3) & ~back
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
    bits: Array, words: Array, listed: Array, odd: Array, odds: int, most: int, steps: Array, longest: int
) -> int:
    """Remove branches of up to ``longest`` pixels that end freely, shortest first, and what becomes needless then.

    The ends are among the first ``odds`` of ``odd``; there may be ``most``. Where branches were is added to that list,
    whose length is returned.
    """
    row = steps[2] >> 3
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(most, np.int32), np.empty(most, np.int32)
    marked = np.zeros(len(bits), np.uint64)
    count = 0
    for i in range(odds):  # ends are many, branches few: seen from there, most ends need no look
        branch = odd[i]
        pattern = _pattern(words, branch, row)
        if _COUNT[pattern] < 3 or not has(bits, branch):
            continue
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            here = branch
            for _ in range(longest):
                here += steps[way]
                ahead = _pattern(words, here, row) & ~(1 << (way ^ 4))
                if ahead == 0:
                    put(marked, here)
                if ahead == 0 or ahead & (ahead - 1):
                    break
                way = _FIRST[ahead]
    for i in range(odds):
        if has(marked, odd[i]):
            clear(marked, odd[i])
            ends[count], (lengths[count], _) = odd[i], _branch(words, odd[i], steps, path)
            count += 1
    # Short branches first: of two at the end of a line the longer one continues it.
    for shortest in range(1, longest + 1):
        i = 0
        while i < count:
            end = ends[i]
            i += 1
            if lengths[i - 1] > shortest or not has(bits, end) or _COUNT[_pattern(words, end, row)] != 1:
                continue
            length, branch = _branch(words, end, steps, path)
            if length == 0 or length > shortest:
                lengths[i - 1] = length if length > 0 else longest + 1
                continue
            for j in range(length):
                clear(bits, path[j])
            near = 0
            pattern = _pattern(words, branch, row)
            while pattern:
                beside[near] = branch + steps[_FIRST[pattern]]
                pattern &= pattern - 1
                near += 1
            beside[near] = branch
            _thin_out(bits, words, beside, near + 1, row)
            for j in range(near + 1):
                odds = _add(bits, listed, odd, odds, beside[j])
                alive = has(bits, beside[j])
                if count < len(ends) and alive and _COUNT[_pattern(words, beside[j], row)] == 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1
    return odds


@called
def _cut(words: Array, corners: Array, row: int, radius: float, farthest: float) -> tuple[Array, Array, int]:
    """Clear what lies within a radius of a corner (N, 2) px.

    Returns what else there is up to the radius ``farthest``, as the bits of some rows around a corner, one after the
    other, as many as make a word; where each word begins, its corner, x, y; and how many columns a row has in it.
    """
    height = len(words) // row - 2
    reach = int(farthest)
    side = 2 * reach + 1
    parts = (side + 56) // 57  # a word that begins at a byte has at least so many of the bits wanted
    columns = (side + parts - 1) // parts
    rows = 64 // columns
    across, down = np.arange(64) % columns, np.arange(64) // columns
    inner, outer = np.zeros((2, parts, (side + rows - 1) // rows), np.uint64)
    for part in range(parts):
        for group in range(inner.shape[1]):
            for bit in range(rows * columns):
                x, y = part * columns + across[bit] - reach, group * rows + down[bit] - reach
                if x * x + y * y <= radius * radius:
                    inner[part, group] |= _ONE << np.uint64(bit)
                elif x * x + y * y <= farthest * farthest:
                    outer[part, group] |= _ONE << np.uint64(bit)
    begins, remains = np.empty((len(corners), 3), np.int32), np.empty(len(corners), np.uint64)
    mask = ~np.uint64(0) >> np.uint64(64 - columns)
    count = 0
    for i in range(len(corners)):
        for part in range(parts):
            left = corners[i, 0] - reach + part * columns
            shift = np.uint64((left + MARGIN) & 7)
            for group in range(inner.shape[1]):
                top = corners[i, 1] - reach + group * rows
                low, high = max(top, 0), min(top + rows, height)
                word = np.uint64(0)
                for y in range(low, high):
                    place = np.uint64((y + 1) * row + ((left + MARGIN) >> 3))
                    word |= ((words[place] >> shift) & mask) << np.uint64((y - top) * columns)
                if word == 0:
                    continue
                if count == len(remains):
                    begins, remains = np.concatenate((begins, begins)), np.concatenate((remains, remains))
                begins[count, 0], begins[count, 1], begins[count, 2] = i, left, top
                remains[count] = word & outer[part, group]
                count += remains[count] != 0
                word &= inner[part, group]
                for y in range(low, high if word else low):
                    place = np.uint64((y + 1) * row + ((left + MARGIN) >> 3))
                    words[place] &= ~(((word >> np.uint64((y - top) * columns)) & mask) << shift)
    return remains[:count], begins[:count], columns


@called
def _ends_near(
    bits: Array,
    words: Array,
    listed: Array,
    odd: Array,
    odds: int,
    cut: tuple[Array, Array, int],
    corners: Array,
    row: int,
    radius: float,
) -> tuple[Array, int]:
    """Return pairs (N, 2) of a free end within a radius of a corner, and that corner, the nearest pairs first.

    ``cut`` is from ``_cut``; these pixels are added to the list ``odd``, whose length is returned, too.
    """
    remains, begins, columns = cut
    across, down = np.arange(64) % columns, np.arange(64) // columns
    most = int(radius * radius)
    found = np.empty((4096, 3), np.int32)
    starts = np.zeros(most + 2, np.int32)
    count = 0
    for number in range(len(remains)):
        i, left, top = begins[number]
        word = remains[number]
        while word:
            bit = lowest(word)
            word &= word - _ONE
            x, y = left + across[bit], top + down[bit]
            here = (y + 1) * 8 * row + x + MARGIN
            if not has(bits, here):  # cut at another corner
                continue
            odds = _add(bits, listed, odd, odds, here)
            square = (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2
            if square > most or _COUNT[_pattern(words, here, row)] > 1:
                continue
            if count == len(found):
                found = np.concatenate((found, found))
            found[count, 0], found[count, 1], found[count, 2] = here, i, square
            count += 1
            starts[square + 1] += 1
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
    bits: Array,
    words: Array,
    listed: Array,
    odd: Array,
    odds: int,
    corners: Array,
    steps: Array,
    farthest: float,
) -> int:
    """Draw lines from free ends to the nearest corner (N, 2) px within reach.

    Edges round corners off on the outside, so what passes within three quarters of the reach is cut first, but no more
    than a corner rounds off. All pairs are seen from the corners, which are fewer than pixels. Pixels with new
    neighbours are added to the list ``odd``, whose length is returned.
    """
    stride = steps[2]
    row = stride >> 3
    radius = min(0.75 * farthest, _ROUNDED_OFF)
    # With all neighbours of what is cut, and of what is drawn, which lie at most 0.593 px farther than its end.
    cut = _cut(words, corners, row, radius, max(farthest + 0.6, radius + 1.5))
    pairs, odds = _ends_near(bits, words, listed, odd, odds, cut, corners, row, farthest)
    led = np.zeros(len(bits), np.uint64)
    for i in range(len(pairs)):
        start, corner = pairs[i, 0], corners[pairs[i, 1]]
        if has(led, start):  # to a nearer one
            continue
        put(led, start)
        x0, y0 = start % stride - MARGIN, start // stride - 1
        dx, dy = corner[0] - x0, corner[1] - y0
        length = max(abs(dx), abs(dy))
        for j in range(1, length + 1):
            x, y = x0 + int(np.rint(dx * j / length)), y0 + int(np.rint(dy * j / length))
            here = (y + 1) * stride + x + MARGIN
            if not has(bits, here):
                put(bits, here)
                put(listed, here)
                odd[np.uint64(odds)] = here
                odds += 1
    return odds


@called
def _follow(
    words: Array, linked: Array, labels: Array, chain: Array, filled: int, stride: int, turns: Array, way: int
) -> int:
    """Append to ``chain`` (x, y), whose last pixel is the first of ``filled``, up to a node or what is linked already.

    ``way`` is the direction of the first step; ``turns`` tells the next one by direction and window, and, times
    sixteen, how far away it lies; 8 for a node. Returns the new ``filled``.
    """
    row = stride >> 3
    x, y = chain[filled - 1, 0], chain[filled - 1, 1]
    here = (y + 1) * stride + x + MARGIN
    to = np.uint64(way)
    here += _DY[to] * stride + _DX[to]
    while True:
        x, y = x + _DX[to], y + _DY[to]
        chain[np.uint64(filled), 0], chain[np.uint64(filled), 1] = x, y
        labels[np.uint64(y), np.uint64(x)] = EDGE
        filled += 1
        turn = turns[to, window(words, here, row)]
        if turn == 8 or has(linked, here):
            return filled
        put(linked, here)
        here += turn >> 4
        to = np.uint64(turn & 7)


@called
def _link(
    bits: Array,
    words: Array,
    listed: Array,
    labels: Array,
    most: int,
    odd: Array,
    odds: int,
    corners: Array,
    steps: Array,
) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends, branches and corners: points (N, 2) x, y, starts (M + 1,).

    All pixels that may have other than two neighbours are among the first ``odds`` of ``odd``. Of all there are at most
    ``most``. Each is told in ``labels``.
    """
    stride = steps[2]
    row = stride >> 3
    linked = np.zeros(len(bits), np.uint64)
    nodes = links = 0
    node_places, patterns = np.empty(len(corners) + odds, np.int32), np.empty(len(corners) + odds, np.uint8)
    for i in range(len(corners)):  # a line that goes through a corner is two
        here = (corners[i, 1] + 1) * stride + corners[i, 0] + MARGIN
        pattern = _STEPS[window(words, here, row)]
        if _COUNT[pattern] == 2 and has(bits, here) and not has(linked, here):
            node_places[nodes], patterns[nodes] = here, pattern
            put(linked, here)
            clear(listed, here)
            links += 2
            nodes += 1
    parted = nodes
    for i in range(odds):
        here = odd[i]
        if not (has(bits, here) and has(listed, here)):  # removed, or a second time
            continue
        clear(listed, here)
        pattern = _STEPS[window(words, here, row)]
        if _COUNT[pattern] != 2:
            node_places[nodes], patterns[nodes] = here, pattern
            links += max(_COUNT[pattern], 1)
            nodes += 1
    for i in range(parted):  # here lines end, too, but what lies between two of them is not linked already
        put(listed, node_places[i])
    turns = (np.append(steps, 0) * 16 + np.arange(9)).astype(np.int32)[_ONWARD].reshape(8, 512)
    # At most; what is not written costs nothing.
    chain = np.empty((2 * most + 2 * links + 2, 2), np.int32)
    starts = np.empty(most + links + 2, np.int64)
    filled = chains = starts[0] = 0
    for i in range(nodes):
        node, pattern = node_places[i], patterns[i]
        x, y = node % stride - MARGIN, node // stride - 1
        labels[y, x] = EDGE
        clear(listed, node)
        if pattern == 0:
            chain[filled, 0], chain[filled, 1] = x, y
            filled += 1
            chains += 1
            starts[chains] = filled
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            beside = node + steps[way]
            if has(linked, beside) and not has(listed, beside):  # already, from its other end
                continue
            chain[filled, 0], chain[filled, 1] = x, y
            filled = _follow(words, linked, labels, chain, filled + 1, stride, turns, way)
            chains += 1
            starts[chains] = filled
        put(linked, node)
    for i in range(len(bits)):  # what is left are closed lines without branches
        while bits[i] & ~linked[i]:
            start = 64 * i + lowest(bits[i] & ~linked[i])
            put(linked, start)
            chain[filled, 0], chain[filled, 1] = start % stride - MARGIN, start // stride - 1
            way = _FIRST[_pattern(words, start, row)]
            filled = _follow(words, linked, labels, chain, filled + 1, stride, turns, way)
            chains += 1
            starts[chains] = filled
    return chain[:filled], starts[: chains + 1]


@compiled
def trace(
    bits: Array,
    words: Array,
    strength: Array,
    least: int,
    weight: float,
    longest: int,
    corners: Array,
    farthest: float,
    labels: Array,
) -> tuple[Array, Array]:
    """Link thinned pixels to chains.

    Parameters
    ----------
    bits
        (2, H + 3, B) uint64, bitmaps (see bitmap.py) of the pixels where an edge may be, which is changed, and of
        strong ones among them: what is connected with one of these is kept.
    words
        The memory of the first, as words of 64 bits that begin at every byte.
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
    labels
        (H, W) uint8 zeros, which become 128 on edges, 255 at corners.

    Returns
    -------
    tuple
        Points (K, 2) int32 x, y; starts (C + 1,): chain i is points[starts[i]:starts[i + 1]], a closed one repeats its
        first point.
    """
    flat, strong = bits[0].reshape(bits[0].size), bits[1].reshape(bits[1].size)
    stride = 64 * bits.shape[2]
    steps = (_DY * stride + _DX).astype(np.int32)
    count, odd, odds, listed = _connected(flat, words, strong, strength, steps, least, weight)
    _thin_out(flat, words, odd, odds, stride >> 3)
    if longest > 0:
        odds = _prune(flat, words, listed, odd, odds, count + 1, steps, longest)
    if farthest > 0.0 and len(corners) > 0:
        odds = _lead(flat, words, listed, odd, odds, corners, steps, farthest)
    points, starts = _link(flat, words, listed, labels, count + odds, odd, odds, corners, steps)
    for i in range(len(corners)):
        labels[corners[i, 1], corners[i, 0]] = CORNER
    return points, starts


@compiled
def candidates(thinned: Array, low: float, high: float, bits: Array) -> None:
    """Set in two empty bitmaps what of (H, W) float32 is at least ``low``, and what at least ``high``."""
    height, width = thinned.shape
    lower, upper, zero = np.float32(low), np.float32(max(low, high)), np.float32(0.0)
    words = np.zeros((2, (width + 7) // 8), np.uint64)
    marks = words.view(np.uint8)
    for y in range(height):
        row = thinned[y]
        for x in range(width):
            marks[0, x] = (row[x] > zero) & (row[x] >= lower)
            marks[1, x] = (row[x] > zero) & (row[x] >= upper)
        for i in range(2):
            pack(words[i], words.shape[1], bits[i, y + 1, MARGIN // 8 :])
