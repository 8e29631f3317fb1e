"""Traces pixels of thinned edges to chains: hysteresis, skeleton, spurs, corners, links; compiled by numba.

The steps are those of :func:`trace`. All functions work on bitmaps framed by empty pixels, so that neighbours are at
constant distances and need no test for the border.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.edges.edge_junctions import Lead, bridge, cut, leads, way_to_corner
from harris_perception.core.edges.edge_pieces import connected
from harris_perception.core.edges.edge_pixels import (
    CERTAIN,
    COUNT,
    CROWDED,
    DX,
    DY,
    ENDS,
    FIRST,
    NEEDLESS,
    NODES,
    STEPS,
    classified,
    close_holes,
    pattern_of,
    places_of,
)
from harris_perception.core.image.bitmap import MARGIN, clear, has, lowest, pack, put, window
from harris_perception.core.image.compiled import called, compiled, inlined

Array = npt.NDArray[Any]

# Maximum length of a chain from a corner to itself that is the rest of a line passing by it.
_REST_PX = 4

# Labels of pixels; 0 is neither.
EDGE, CORNER = 128, 255

# Stands for a missing step.
_STOP = 2**31 - 1


@called
def _thin_out(bits: Array, octets: Array, places: Array, row: int) -> None:
    """Remove redundant pixels among these places, the last first; of two equal ones the first stays, as with maxima."""
    changed = True
    while changed:
        changed = False
        for i in range(len(places) - 1, -1, -1):
            if CERTAIN[pattern_of(octets, places[i], row)] and has(bits, places[i]):
                clear(bits, places[i])
                changed = True
    for i in range(len(places) - 1, -1, -1):
        if NEEDLESS[pattern_of(octets, places[i], row)] and has(bits, places[i]):
            clear(bits, places[i])


@inlined
def _branch(octets: Any, end: int, steps: Any, path: Any) -> tuple[int, int]:
    """Follow a line from its free end into ``path``; return its length and the place where it branches, or 0, -1."""
    here, length, back = end, 0, 0
    while length < len(path):
        pattern = pattern_of(octets, here, steps[2] >> 3) & ~back
        if pattern == 0:
            break  # a separate line
        way = FIRST[pattern]
        if pattern & (pattern - 1):
            return length, here
        path[length] = here
        length += 1
        here += steps[way]
        back = 1 << (way ^ 4)
    return 0, -1


@called
def _prune(bits: Array, octets: Array, crowded: Array, most: int, steps: Array, longest: int) -> None:
    """Remove branches of up to ``longest`` pixels with a free end, shortest first, and pixels that become redundant.

    ``crowded`` must contain all pixels that may branch; there may be ``most`` ends.
    """
    row = steps[2] >> 3
    path = np.empty(longest + 1, np.int32)
    beside = np.empty(9, np.int32)
    ends, lengths = np.empty(most, np.int32), np.empty(most, np.int32)
    marked = np.zeros(len(bits), np.uint64)
    count = 0
    for i in range(len(crowded)):  # branches are rarer than ends, so a search from the branches skips most ends
        branch = crowded[i]
        pattern = pattern_of(octets, branch, row)
        if COUNT[pattern] < 3 or not has(bits, branch):
            continue
        while pattern:
            way = FIRST[pattern]
            pattern &= pattern - 1
            here = branch
            for length in range(1, longest + 1):
                here += steps[way]
                ahead = pattern_of(octets, here, row) & ~(1 << (way ^ 4))
                if ahead == 0 and not has(marked, here):
                    put(marked, here)
                    ends[count], lengths[count] = here, length
                    count += 1
                if ahead == 0 or ahead & (ahead - 1):
                    break
                way = FIRST[ahead]
    # Short branches first: of two at the end of a line the longer one continues it.
    for shortest in range(1, longest + 1):
        i = 0
        while i < count:
            end = ends[i]
            i += 1
            if lengths[i - 1] > shortest or not has(bits, end) or COUNT[pattern_of(octets, end, row)] != 1:
                continue
            length, branch = _branch(octets, end, steps, path)
            if length == 0 or length > shortest:
                lengths[i - 1] = length if length > 0 else longest + 1
                continue
            for j in range(length):
                clear(bits, path[j])
            near = 0
            pattern = pattern_of(octets, branch, row)
            while pattern:
                beside[near] = branch + steps[FIRST[pattern]]
                pattern &= pattern - 1
                near += 1
            beside[near] = branch
            _thin_out(bits, octets, beside[: near + 1], row)
            for j in range(near + 1):
                alive = has(bits, beside[j])
                if count < len(ends) and alive and COUNT[pattern_of(octets, beside[j], row)] == 1:
                    ends[count], lengths[count] = beside[j], 0
                    count += 1


@called
def _sums(steps: Array) -> Array:
    """Return by the window (512,) the sum of a pixel's two steps, or a stop where a line does not simply continue.

    The sum minus the step back is the step ahead, so no direction is needed, for which the next pixel would have to
    wait.
    """
    sums = np.empty(512, np.int32)
    for seen in range(512):
        pattern = STEPS[seen]
        rest = pattern & (pattern - 1)
        sums[seen] = steps[FIRST[pattern]] + steps[FIRST[rest]] if COUNT[pattern] == 2 else _STOP
    return sums


@called
def _follow(octets: Array, linked: Array, chain: Array, filled: int, row: int, sums: Array, step: int) -> int:
    """Append to ``chain``, whose last pixel is the first of ``filled``, up to a node or a pixel that is already linked.

    ``step`` is the first step; ``row`` is the number of bytes per row. Returns the new ``filled``.
    """
    before = int(chain[filled - 1])
    here = before + step
    while True:
        chain[np.uint64(filled)] = here
        filled += 1
        both = int(sums[window(octets, here, row)])  # each pixel waits for the previous one
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

    ``labels`` gets the label of each pixel. There may be ``most`` pixels, and ``room`` including those between an end
    and its corner. ``spare`` is a bitmap that is overwritten, ``lead`` the result of ``leads``. A chain of up to
    ``rest`` pixels that starts and ends at the same corner is the rest of a line passing by, and is omitted.
    """
    stride = steps[2]
    row = stride >> 3
    linked = np.zeros(len(bits), np.uint64)
    classified(bits, row >> 3, NODES, spare)
    others = places_of(spare, most)
    nodes = links = 0
    node_places = np.empty(len(corners) + len(others), np.int32)
    patterns = np.empty(len(node_places), np.uint8)
    for i in range(len(corners)):  # a line through a corner is two lines
        here = (corners[i, 1] + 1) * stride + corners[i, 0] + MARGIN
        pattern = STEPS[window(octets, here, row)]
        if COUNT[pattern] == 2 and has(bits, here) and not has(linked, here):
            node_places[nodes], patterns[nodes] = here, pattern
            put(linked, here)
            links += 2
            nodes += 1
    parted = nodes
    for i in range(len(others)):
        clear(spare, others[i])
        pattern = STEPS[window(octets, others[i], row)]
        node_places[nodes], patterns[nodes] = others[i], pattern
        links += max(COUNT[pattern], 1)
        nodes += 1
    for i in range(parted):  # lines also end here, but pixels between two of these are not linked yet
        put(spare, node_places[i])
    # Upper limits; unwritten memory costs nothing.
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
            way = FIRST[pattern]
            pattern &= pattern - 1
            beside = node + steps[way]
            if has(linked, beside) and not has(spare, beside):  # already linked from its other end
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
    for i in range(len(bits)):  # the remaining pixels are closed lines without branches
        while bits[i] & ~linked[i]:
            chain[filled] = 64 * i + lowest(bits[i] & ~linked[i])
            put(linked, chain[filled])
            way = FIRST[STEPS[window(octets, chain[filled], row)]]
            filled = _follow(octets, linked, chain, filled + 1, row, sums, steps[way])
            chains += 1
            starts[chains] = filled
    points = np.empty((filled, 2), np.int32)
    share = 1.0 / stride
    for i in range(filled):
        y = np.int32((chain[i] + 0.5) * share)  # an integer division takes longer
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
        (2, H + 3, B) uint64, bitmaps (see bitmap.py) of the pixels that may be edges, and of the strong ones among
        them: pixels connected with a strong one are kept. Both are overwritten.
    octets
        The memory of the first bitmap as bytes.
    words, strong_words
        The memory of both, as words of 64 bits that start at every byte.
    strength
        (H, W) float32, used only with ``weight``.
    least, weight
        Minimum number of pixels of a piece, and minimum sum of its strengths.
    longest
        Maximum length, px, of branches with a free end that are removed.
    corners_xy
        (M, 2) float32 px.
    ends
        (M,) bool, corners at which edges end.
    farthest
        Maximum distance from a free end to such a corner, to which it is then extended, px; 0 for none.
    labels
        (H, W) uint8 zeros, which become 128 on edges, 255 at corners.

    Returns
    -------
    tuple
        Whether all corners lie inside the image, else nothing is traced; points (K, 2) int32 x, y; starts (C + 1,).
        Chain i is points[starts[i]:starts[i + 1]], a closed one repeats its first point.
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
    steps = (DY * stride + DX).astype(np.int32)
    most = connected(flat, strong, strength, stride >> 6, least, weight)
    most += close_holes(flat, stride >> 6, strong)
    classified(flat, stride >> 6, CROWDED, strong)
    crowded = places_of(strong, most)
    _thin_out(flat, octets, crowded, stride >> 3)
    if longest > 0:
        _prune(flat, octets, crowded, most, steps, longest)
    lead = np.zeros(len(flat), np.uint64), np.empty(0, np.int32), np.empty((2, 0), np.int32), corners
    if farthest > 0.0 and len(corners) > 0:
        cut(words, corners, stride >> 3, farthest)
        classified(flat, stride >> 6, ENDS, strong)
        lead = leads(strong_words, corners, stride >> 3, farthest, lead[0])
    room = most + lead[2].size * int(farthest)
    points, starts = _link(flat, octets, most, room, strong, labels, corners, steps, lead, min(int(farthest), _REST_PX))
    for i in range(len(places)):
        labels[places[i, 1], places[i, 0]] = CORNER
    return True, points, starts


@compiled
def candidates(thinned: Array, low: float, high: float, bits: Array) -> None:
    """Set in two empty bitmaps the pixels of (H, W) float32 that are at least ``low``, and those at least ``high``."""
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
