"""From the pixels of thinned edges to chains: hysteresis, a skeleton, spurs, corners, links; compiled by numba.

Everything here works on bitmaps, which are framed by empty pixels, so that neighbours are constant distances and need
no test for the border. Pieces grow by words of 64 pixels, and crowded pixels, ends and nodes are counted in the bits of
all rows. Where single pixels are looked at, their eight neighbours are read from three rows as the bits of a byte,
and what follows from them is one look at a table of 256 patterns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.bitmap import MARGIN, clear, has, lowest, ones, pack, put, window
from harris_perception.core.compiled import called, compiled, inlined
from harris_perception.core.edge_junctions import Lead, bridge, cut, leads, way_to_corner

Array = npt.NDArray[Any]

# Neighbours in circular order; even ones share a side.
_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)

# Up to so many pixels that start and end at one corner are the rest of a line that passed by it.
_REST_PX = 4

# What is told of every pixel; 0 is neither.
EDGE, CORNER = 128, 255

_ONE, _LAST = np.uint64(1), np.uint64(63)
_OUTERMOST = _ONE | (_ONE << _LAST)


def _tables() -> tuple[npt.NDArray[Any], ...]:
    """Return for each pattern of neighbours (bit i is the i-th) their number, the first, and two properties.

    A pixel is needless when at least two neighbours are set and they stay in one piece without it (Yokoi's number,
    8-connected), so that no connection is lost. It is certain to be so when it is not the end of a line that is wider
    than a pixel, which has two neighbours side by side: as long as there are others, these would go one by one.
    """
    full = np.array([[pattern >> i & 1 for i in range(8)] for pattern in range(256)])
    empty = 1 - full
    sides, after, beyond = empty[:, 0::2], empty[:, 1::2], np.roll(empty, -2, axis=1)[:, 0::2]
    pieces = (sides - sides * after * beyond).sum(axis=1)
    count = full.sum(axis=1)
    needless = (count >= 2) & (pieces == 1)
    certain = needless & ((count > 2) | (full[:, 0::2].sum(axis=1) == 2))
    # What a pixel with a common side leads to as well needs no diagonal step.
    direct = full.copy()
    direct[:, 1::2] &= empty[:, 0::2] & np.roll(empty, -2, axis=1)[:, 0::2]
    steps = (direct << np.arange(8)).sum(axis=1).astype(np.uint8)
    return count.astype(np.uint8), full.argmax(axis=1).astype(np.uint8), needless, certain, steps


_COUNT, _FIRST, _NEEDLESS, _CERTAIN, _DIRECT = _tables()

# The neighbours in circular order by the nine bits of a window of 3x3, in the order of rows.
_NEIGHBOURS = (((np.arange(512)[:, None] >> (3 * _DY + _DX + 4)) & 1) << np.arange(8)).sum(axis=1).astype(np.uint8)
_STEPS = _DIRECT[_NEIGHBOURS]
# In place of a step.
_STOP = 2**31 - 1


@called
def _pattern(octets: Array, here: int, row: int) -> np.uint8:
    """Return as bits in circular order which of the eight neighbours are set; ``row`` is the bytes of one."""
    return np.uint8(_NEIGHBOURS[window(octets, here, row)])


@inlined
def _grown(bits: Any, row: int, seed: int, found: Any, places: Any, reached: Any, count: int) -> tuple[int, int]:
    """Clear the piece that holds the pixels ``found`` of word ``seed``; return the new ``count`` and its size.

    Its words go behind the first ``count`` of ``places`` and ``reached``. What waits to be grown lies at their end, as
    ``~place`` where it goes up; both never meet, as all have other pixels.
    """
    line, size, end = np.uint64(row), 0, len(places)
    waiting, here, step = end, np.uint64(seed), line
    while True:
        while found:  # on to the next row at once: its word can be read before this one is done
            free = bits[here] | found
            found |= free & ~(free + found)  # up by what a sum carries, down step by step
            more = free & (found >> _ONE) & ~found
            while more:
                found |= more
                more = free & (more >> _ONE)
            bits[here] = free & ~found
            at = np.uint64(count)
            places[at], reached[at] = here, found
            count += 1
            size += ones(found)
            wide = found | (found << _ONE) | (found >> _ONE)
            back = here - step
            more = wide & bits[back]
            if more:
                bits[back] &= ~more
                waiting -= 1
                at = np.uint64(waiting)
                places[at], reached[at] = ~back if step == line else back, more
            if found & _OUTERMOST:
                for side in range(2):
                    there = found >> _LAST if side else (found & _ONE) << _LAST
                    beside = here + np.uint64(2 * side - 1)
                    for beyond in (beside - line, beside, beside + line):  # a range by ``row`` is a division
                        more = there & bits[beyond]
                        if more:
                            bits[beyond] &= ~more
                            waiting -= 1
                            at = np.uint64(waiting)
                            places[at], reached[at] = beyond, more
            here += step
            found = wide & bits[here]
        if waiting == end:
            return count, size
        at = np.uint64(waiting)
        place, found = places[at], reached[at]
        here, step = (np.uint64(place), line) if place >= 0 else (np.uint64(~place), np.uint64(-row))
        waiting += 1


@called
def _connected(bits: Array, strong: Array, strength: Array, row: int, least: int, weight: float) -> int:
    """Clear all pixels but those of connected pieces with a strong one; return how many are left.

    A piece grows by words of 64 pixels, of which ``row`` make a row.
    """
    # Growing lists would make the flood slower, counting the pixels first, too; what is not written costs nothing.
    places, reached = np.empty(64 * len(bits), np.int32), np.empty(64 * len(bits), np.uint64)
    left = kept = 0
    for i in range(len(strong)):
        while strong[i] & bits[i]:
            seeds = strong[i] & bits[i]
            count, size = _grown(bits, row, i, seeds & (~seeds + _ONE), places, reached, kept)
            total = 0.0
            if weight > 0.0:
                for j in range(kept, count):
                    found = reached[j]
                    while found:
                        x = 64 * (places[j] % row) + lowest(found) - MARGIN
                        total += strength[places[j] // row - 1, x]
                        found &= found - _ONE
            stays = size >= least and total >= weight
            left += size * stays
            kept = count if stays else kept  # no branch, as most pieces are small, but many are not
    for i in range(len(bits)):
        bits[i] = 0
    for i in range(kept):
        bits[np.uint64(places[i])] |= reached[i]
    return left


_HOLES, _CROWDED, _ENDS, _NODES = range(4)


@inlined
def _counted(one: Any, other: Any, third: Any, fourth: Any) -> tuple[Any, Any, Any]:
    """Return which bits of four words are set at least once, twice, and more often."""
    either, both, neither, all_of = one | other, one & other, third | fourth, third & fourth
    return either | neither, both | all_of | (either & neither), (both & neither) | (either & all_of)


@inlined
def _classified_words(above: Any, here: Any, below: Any, kind: int, result: Any, n: int) -> None:
    first, last = np.uint64(1), np.uint64(63)
    for i in range(1, n - 1):
        north, middle, south = above[i], here[i], below[i]
        west, east = (middle << first) | (here[i - 1] >> last), (middle >> first) | (here[i + 1] << last)
        if kind == _HOLES:
            result[i] = north & south & west & east & ~middle
            continue
        nw, ne = (north << first) | (above[i - 1] >> last), (north >> first) | (above[i + 1] << last)
        sw, se = (south << first) | (below[i - 1] >> last), (south >> first) | (below[i + 1] << last)
        if kind == _NODES:
            nw, ne = nw & ~(north | west), ne & ~(north | east)
            sw, se = sw & ~(south | west), se & ~(south | east)
        once, twice, often = _counted(west, east, north, south)
        aslant, two, more = _counted(nw, ne, sw, se)
        both, many = twice | two | (once & aslant), often | more | (twice & aslant) | (once & two)
        if kind == _ENDS:
            result[i] = middle & ~both
        elif kind == _CROWDED:
            beside = ((west | east) & (north | south)) | (north & (nw | ne)) | (south & (sw | se))
            result[i] = middle & (many | beside | (west & (nw | sw)) | (east & (ne | se)))
        else:
            result[i] = middle & (~both | many)


@called
def _classified(bits: Array, row: int, kind: int, result: Array) -> None:
    """Set ``result`` to the pixels of a kind, 64 of them at a time; ``row`` is the words of one, the first is margin.

    Holes are empty ones between four; crowded ones have three neighbours or more, or are needless; ends have at most
    one. Nodes are where a line does not just go through: of steps to other pixels, without the needless diagonal ones,
    they have other than two.

    All rows are one loop, as the rows of small pictures are too short to be vectorised each by itself.
    """
    n = len(bits) - 2 * row
    above, here, below, out = bits[:n], bits[row : row + n], bits[2 * row :], result[row : row + n]
    if kind == _HOLES:
        _classified_words(above, here, below, _HOLES, out, n)
    elif kind == _CROWDED:
        _classified_words(above, here, below, _CROWDED, out, n)
    elif kind == _ENDS:
        _classified_words(above, here, below, _ENDS, out, n)
    else:
        _classified_words(above, here, below, _NODES, out, n)


@called
def _close_holes(bits: Array, row: int, spare: Array) -> int:
    """Set empty pixels between four that are set, so that a line does not part for a pixel; return how many.

    Of a step between two columns noise makes the one stronger or the other, or both beside it.
    """
    _classified(bits, row, _HOLES, spare)
    count = 0
    for i in range(len(bits)):
        bits[i] |= spare[i]
        count += ones(spare[i])
    return count


@called
def _places(bits: Array, most: int) -> Array:
    """Return the places of all pixels that are set, (N,) int32; there may be ``most``."""
    places, words = np.empty(most, np.int32), np.empty(len(bits), np.int32)
    count = filled = 0
    for i in range(len(bits)):  # always writing, sometimes stepping: no branch to mispredict
        words[np.uint64(filled)] = i
        filled += bits[i] != 0
    for i in range(filled):
        word = bits[words[i]]
        while True:  # most have one pixel
            places[count] = 64 * words[i] + lowest(word)
            count += 1
            word &= word - _ONE
            if word == 0:
                break
    return places[:count]


@called
def _thin_out(bits: Array, octets: Array, places: Array, row: int) -> None:
    """Remove needless pixels among these places, the last first; of two equal ones the first stays, as of maxima."""
    changed = True
    while changed:
        changed = False
        for i in range(len(places) - 1, -1, -1):
            if _CERTAIN[_pattern(octets, places[i], row)] and has(bits, places[i]):
                clear(bits, places[i])
                changed = True
    for i in range(len(places) - 1, -1, -1):
        if _NEEDLESS[_pattern(octets, places[i], row)] and has(bits, places[i]):
            clear(bits, places[i])


@inlined
def _branch(octets: Any, end: int, steps: Any, path: Any) -> tuple[int, int]:
    """Follow a line from its free end into ``path``; return its length and where it branches, or 0, -1."""
    here, length, back = end, 0, 0
    while length < len(path):
        pattern = _pattern(octets, here, steps[2] >> 3) & ~back
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
def _prune(bits: Array, octets: Array, crowded: Array, most: int, steps: Array, longest: int) -> None:
    """Remove branches of up to ``longest`` pixels that end freely, shortest first, and what becomes needless then.

    All that may branch are among ``crowded``; there may be ``most`` ends.
    """
    row = steps[2] >> 3
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(most, np.int32), np.empty(most, np.int32)
    marked = np.zeros(len(bits), np.uint64)
    count = 0
    for i in range(len(crowded)):  # ends are many, branches few: seen from there, most ends need no look
        branch = crowded[i]
        pattern = _pattern(octets, branch, row)
        if _COUNT[pattern] < 3 or not has(bits, branch):
            continue
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            here = branch
            for length in range(1, longest + 1):
                here += steps[way]
                ahead = _pattern(octets, here, row) & ~(1 << (way ^ 4))
                if ahead == 0 and not has(marked, here):
                    put(marked, here)
                    ends[count], lengths[count] = here, length
                    count += 1
                if ahead == 0 or ahead & (ahead - 1):
                    break
                way = _FIRST[ahead]
    # Short branches first: of two at the end of a line the longer one continues it.
    for shortest in range(1, longest + 1):
        i = 0
        while i < count:
            end = ends[i]
            i += 1
            if lengths[i - 1] > shortest or not has(bits, end) or _COUNT[_pattern(octets, end, row)] != 1:
                continue
            length, branch = _branch(octets, end, steps, path)
            if length == 0 or length > shortest:
                lengths[i - 1] = length if length > 0 else longest + 1
                continue
            for j in range(length):
                clear(bits, path[j])
            near = 0
            pattern = _pattern(octets, branch, row)
            while pattern:
                beside[near] = branch + steps[_FIRST[pattern]]
                pattern &= pattern - 1
                near += 1
            beside[near] = branch
            _thin_out(bits, octets, beside[: near + 1], row)
            for j in range(near + 1):
                alive = has(bits, beside[j])
                if count < len(ends) and alive and _COUNT[_pattern(octets, beside[j], row)] == 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1


@called
def _sums(steps: Array) -> Array:
    """Return by the window (512,) the sum of a pixel's two steps, or a stop where a line does not go on by itself.

    Less the step back it is the one ahead, so that no direction need be known, on which the next look would wait.
    """
    sums = np.empty(512, np.int32)
    for seen in range(512):
        pattern = _STEPS[seen]
        rest = pattern & (pattern - 1)
        sums[seen] = steps[_FIRST[pattern]] + steps[_FIRST[rest]] if _COUNT[pattern] == 2 else _STOP
    return sums


@called
def _follow(octets: Array, linked: Array, chain: Array, filled: int, row: int, sums: Array, step: int) -> int:
    """Append to ``chain``, whose last pixel is the first of ``filled``, up to a node or what is linked already.

    ``step`` is the first one; ``row`` is the bytes of one. Returns the new ``filled``.
    """
    before = int(chain[filled - 1])
    here = before + step
    while True:
        chain[np.uint64(filled)] = here
        filled += 1
        both = int(sums[window(octets, here, row)])  # each pixel waits for the one before
        if both == _STOP or has(linked, here):
            return filled
        put(linked, here)
        before, here = here, here + (here - before) + both


@called
def _link(
    bits: Array,
    octets: Array,
    most: int,
    room: int,
    spare: Array,
    labels: Array,
    corners: Array,
    steps: Array,
    lead: Lead,
    rest: int,
) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends, branches and corners: points (N, 2) x, y, starts (M + 1,).

    Each pixel, of which there may be ``most``, ``room`` with those on the way from an end to its corner, is told in
    ``labels``. ``spare`` is a bitmap that is written over, ``lead`` of ``leads``. What both starts and ends at the same
    corner, with up to ``rest`` pixels, is the rest of a line that passed by, and left out.
    """
    stride = steps[2]
    row = stride >> 3
    linked = np.zeros(len(bits), np.uint64)
    _classified(bits, row >> 3, _NODES, spare)
    others = _places(spare, most)
    nodes = links = 0
    node_places = np.empty(len(corners) + len(others), np.int32)
    patterns = np.empty(len(node_places), np.uint8)
    for i in range(len(corners)):  # a line that goes through a corner is two
        here = (corners[i, 1] + 1) * stride + corners[i, 0] + MARGIN
        pattern = _STEPS[window(octets, here, row)]
        if _COUNT[pattern] == 2 and has(bits, here) and not has(linked, here):
            node_places[nodes], patterns[nodes] = here, pattern
            put(linked, here)
            links += 2
            nodes += 1
    parted = nodes
    for i in range(len(others)):
        clear(spare, others[i])
        pattern = _STEPS[window(octets, others[i], row)]
        node_places[nodes], patterns[nodes] = others[i], pattern
        links += max(_COUNT[pattern], 1)
        nodes += 1
    for i in range(parted):  # here lines end, too, but what lies between two of them is not linked already
        put(spare, node_places[i])
    # At most; what is not written costs nothing.
    chain, starts = np.empty(most + room + 2 * links + 2, np.int32), np.empty(most + links + 2, np.int64)
    filled = chains = starts[0] = 0
    sums = _sums(steps)
    for i in range(nodes):
        node, pattern = node_places[i], patterns[i]
        clear(spare, node)
        if pattern == 0:
            if has(lead[0], node):
                filled = bridge(bits, chain, filled, node, lead, stride)
            else:
                chain[filled] = node
                filled += 1
            chains += 1
            starts[chains] = filled
        while pattern:
            way = _FIRST[pattern]
            pattern &= pattern - 1
            beside = node + steps[way]
            if has(linked, beside) and not has(spare, beside):  # already, from its other end
                continue
            first = filled
            if has(lead[0], node):
                filled = way_to_corner(bits, chain, filled, node, lead, stride, True)
            chain[filled] = node
            length = _follow(octets, linked, chain, filled + 1, row, sums, steps[way]) - filled
            filled += length
            if has(lead[0], chain[filled - 1]):
                filled = way_to_corner(bits, chain, filled, chain[filled - 1], lead, stride, False)
            if has(lead[0], node) and chain[first] == chain[filled - 1] and length <= rest:
                filled = first
                continue
            chains += 1
            starts[chains] = filled
        put(linked, node)
    for i in range(len(bits)):  # what is left are closed lines without branches
        while bits[i] & ~linked[i]:
            chain[filled] = 64 * i + lowest(bits[i] & ~linked[i])
            put(linked, chain[filled])
            way = _FIRST[_STEPS[window(octets, chain[filled], row)]]
            filled = _follow(octets, linked, chain, filled + 1, row, sums, steps[way])
            chains += 1
            starts[chains] = filled
    points = np.empty((filled, 2), np.int32)
    share = 1.0 / stride
    for i in range(filled):
        y = np.int32((chain[i] + 0.5) * share)  # a division of whole numbers takes longer
        points[i, 0], points[i, 1] = chain[i] - y * stride - MARGIN, y - 1
    for i in range(filled):
        labels[np.uint64(points[i, 1]), np.uint64(points[i, 0])] = EDGE
    return points, starts[: chains + 1]


@compiled
def trace(
    bits: Array,
    octets: Array,
    words: Array,
    strong_words: Array,
    strength: Array,
    least: int,
    weight: float,
    longest: int,
    corners_xy: Array,
    ends: Array,
    farthest: float,
    labels: Array,
) -> tuple[bool, Array, Array]:
    """Link thinned pixels to chains.

    Parameters
    ----------
    bits
        (2, H + 3, B) uint64, bitmaps (see bitmap.py) of the pixels where an edge may be, and of strong ones among them:
        what is connected with one of these is kept. Both are written over.
    octets
        The memory of the first as bytes.
    words, strong_words
        The memory of both, as words of 64 bits that begin at every byte.
    strength
        (H, W) float32, looked at for ``weight`` only.
    least, weight
        Pieces of fewer pixels, or whose strengths add up to less than ``weight``, are left out.
    longest
        Branches of up to so many px that end freely are removed.
    corners_xy
        (M, 2) float32 px.
    ends
        (M,) bool, at which of these edges end.
    farthest
        Free ends this near to such a corner are led to it, px; 0 for none.
    labels
        (H, W) uint8 zeros, which become 128 on edges, 255 at corners.

    Returns
    -------
    tuple
        Whether all corners lie inside the picture, else nothing is traced; points (K, 2) int32 x, y; starts (C + 1,):
        chain i is points[starts[i]:starts[i + 1]], a closed one repeats its first point.
    """
    corners, places = np.empty((len(corners_xy), 2), np.int32), np.empty((len(corners_xy), 2), np.int32)
    count = 0
    for i in range(len(corners_xy)):
        x, y = np.rint(corners_xy[i, 0]), np.rint(corners_xy[i, 1])
        if not (x >= 0 and x < labels.shape[1] and y >= 0 and y < labels.shape[0]):
            return False, corners[:0], np.zeros(1, np.int64)
        places[i, 0], places[i, 1] = x, y
        corners[count, 0], corners[count, 1] = x, y
        count += ends[i]
    corners = corners[:count]
    flat, strong = bits[0].reshape(bits[0].size), bits[1].reshape(bits[1].size)
    stride = 64 * bits.shape[2]
    steps = (_DY * stride + _DX).astype(np.int32)
    most = _connected(flat, strong, strength, stride >> 6, least, weight)
    most += _close_holes(flat, stride >> 6, strong)
    _classified(flat, stride >> 6, _CROWDED, strong)
    crowded = _places(strong, most)
    _thin_out(flat, octets, crowded, stride >> 3)
    if longest > 0:
        _prune(flat, octets, crowded, most, steps, longest)
    lead = np.zeros(len(flat), np.uint64), np.empty(0, np.int32), np.empty((2, 0), np.int32), corners
    if farthest > 0.0 and len(corners) > 0:
        cut(words, corners, stride >> 3, farthest)
        _classified(flat, stride >> 6, _ENDS, strong)
        lead = leads(strong_words, corners, stride >> 3, farthest, lead[0])
    room = most + lead[2].size * int(farthest)
    points, starts = _link(flat, octets, most, room, strong, labels, corners, steps, lead, min(int(farthest), _REST_PX))
    for i in range(len(places)):
        labels[places[i, 1], places[i, 0]] = CORNER
    return True, points, starts


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
