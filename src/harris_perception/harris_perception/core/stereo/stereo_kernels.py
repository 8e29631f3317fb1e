"""Loops of sparse stereo over corners and windows, compiled by numba; stereo_matching.py explains their use."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import called, compiled
from icu_common.core.geometry.geometry import Array

F32 = npt.NDArray[np.float32]


@compiled
def best_partners(
    left_windows: F32,
    right_windows: F32,
    left_px: F32,
    right_px: F32,
    tolerance_px: float,
    least_px: float,
    largest_px: float,
) -> tuple[npt.NDArray[np.int64], F32, F32]:
    """Return each left corner's mutual best right corner (else -1), its score, and the best score elsewhere.

    The right corners are sorted by row.
    """
    n, m, size = len(left_px), len(right_px), left_windows.shape[1]
    best = np.full(n, -1, np.int64)
    score = np.full(n, -1.0, np.float32)
    after = np.full(n, -1.0, np.float32)
    right_score = np.full(m, -1.0, np.float32)
    right_best = np.full(m, -1, np.int64)
    scores = np.empty(m, np.float32)
    rows = right_px[:, 1]
    for i in range(n):
        first = np.searchsorted(rows, np.float32(left_px[i, 1] - tolerance_px))
        last = np.searchsorted(rows, np.float32(left_px[i, 1] + tolerance_px), side="right")
        for j in range(first, last):
            disparity = left_px[i, 0] - right_px[j, 0]
            scores[j] = -1.0
            if disparity < least_px or disparity > largest_px:
                continue
            total = np.float32(0.0)
            for k in range(size):
                total += left_windows[i, k] * right_windows[j, k]
            scores[j] = total
            if total > score[i]:
                score[i] = total
                best[i] = j
            if total > right_score[j]:
                right_score[j] = total
                right_best[j] = i
        if best[i] < 0:
            continue
        for j in range(first, last):
            if abs(right_px[j, 0] - right_px[best[i], 0]) > 2.0 and scores[j] > after[i]:
                after[i] = scores[j]
    for i in range(n):
        if best[i] >= 0 and right_best[best[i]] != i:
            best[i] = -1
    return best, score, after


@compiled
def nearest(query: F32, at: F32) -> npt.NDArray[np.int64]:
    """Return for each query (N, 2) the indices of the eight nearest other points, nearest first; -1 for none."""
    near = np.full((len(query), 8), -1, np.int64)
    nearest = np.empty(8, np.float32)
    for i in range(len(query)):
        nearest[:] = np.inf
        for j in range(len(at)):
            dx = query[i, 0] - at[j, 0]
            dy = query[i, 1] - at[j, 1]
            distance = dx * dx + dy * dy
            if distance == 0.0 or distance >= nearest[7]:
                continue
            k = 7
            while k > 0 and nearest[k - 1] > distance:
                nearest[k] = nearest[k - 1]
                near[i, k] = near[i, k - 1]
                k -= 1
            nearest[k] = distance
            near[i, k] = j
    return near


@compiled
def slid(windows: F32, strips: F32, half: int) -> F32:
    """Correlate (N, side^2) normalised windows with every position in (N, side (side + 2 search)) strips."""
    side = 2 * half + 1
    width = strips.shape[1] // side
    count = width - side + 1
    score = np.empty((len(windows), count), np.float32)
    least = 4.0 * side * side
    for i in range(len(windows)):
        for p in range(count):
            total = squares = product = np.float32(0.0)
            for r in range(side):
                for c in range(side):
                    value = strips[i, r * width + p + c]
                    total += value
                    squares += value * value
                    product += value * windows[i, r * side + c]
            spread = squares - total * total / (side * side)
            score[i, p] = product / np.sqrt(spread) if spread > least else np.float32(-1.0)
    return score


@compiled
def along_rows(
    left: F32,
    right: F32,
    at: F32,
    low: npt.NDArray[np.int64],
    high: npt.NDArray[np.int64],
    half: int,
    least: float,
) -> tuple[F32, F32]:
    """Return each corner's best disparity, if the search back confirms it, else NaN, and the correlation."""
    height, width = left.shape
    disparity = np.full(len(at), np.nan, np.float32)
    score = np.full(len(at), -1.0, np.float32)
    row = np.empty(max(np.max(high - low) + 1, 1), np.float32)
    for i in range(len(at)):
        x, y = int(np.round(at[i, 0])), int(np.round(at[i, 1]))
        if x < half or y < half or x >= width - half or y >= height - half or high[i] - low[i] < 2:
            continue
        best = _best_in_row(left, right, x, y, -1, low[i], high[i], half, row)
        if best <= low[i] or best >= high[i]:
            continue
        before, top, after = row[best - 1 - low[i]], row[best - low[i]], row[best + 1 - low[i]]
        if top < least or abs(_best_in_row(right, left, x - best, y, 1, low[i], high[i], half, row) - best) > 1:
            continue
        bend = before - np.float32(2) * top + after
        part = np.float32(0.5) * (before - after) / bend if bend < np.float32(-1e-6) else np.float32(0)
        disparity[i] = np.float32(best) + min(max(part, np.float32(-0.5)), np.float32(0.5))
        score[i] = top
    return disparity, score


@called
def _best_in_row(picture: F32, other: F32, x: int, y: int, sign: int, low: int, high: int, half: int, row: F32) -> int:
    """Return the best shift of the window at (x, y) in the other image, low - 1 for none; ``row`` gets all scores."""
    width = picture.shape[1]
    area = np.float32((2 * half + 1) ** 2)
    total = square = np.float32(0)
    for r in range(y - half, y + half + 1):
        for c in range(x - half, x + half + 1):
            total += picture[r, c]
            square += picture[r, c] * picture[r, c]
    mean = total / area
    spread = square - total * mean
    best, top = low - 1, np.float32(-1)
    for k in range(low, high + 1):
        row[k - low] = np.float32(-1)
        there = x + sign * k
        if spread < 4 * area or there < half or there >= width - half:
            continue
        total = square = product = np.float32(0)
        for r in range(-half, half + 1):
            for c in range(-half, half + 1):
                value = other[y + r, there + c]
                total += value
                square += value * value
                product += value * picture[y + r, x + c]
        texture = square - total * total / area
        if texture < 4 * area:
            continue
        row[k - low] = (product - mean * total) / np.sqrt(texture * spread)
        if row[k - low] > top:
            best, top = k, row[k - low]
    return best


@compiled
def gauss_newton(wanted: F32, strips: F32, fraction: Array, half: int, turns: int) -> Array:
    """Fit each strip of the right image to its window of the left one.

    Parameters
    ----------
    wanted
        (N, side^2) windows of the left image.
    strips
        (N, side (side + 2 margin)) of the right image, one column per pixel column.
    fraction
        (N,) start of the fit, in columns right of the strip's middle column.

    Returns
    -------
    result
        (N, 2): columns to the right of the start, and their standard deviation; NaN if there is no solution.
    """
    side = 2 * half + 1
    width = strips.shape[1] // side
    margin = (width - side) // 2
    result = np.full((len(wanted), 2), np.nan)
    normal = np.empty((5, 5))
    known = np.empty(5)
    row = np.empty(5)
    for i in range(len(wanted)):
        slant_x = slant_y = 0.0
        first = half + margin + fraction[i]
        place = first
        for turn in range(turns):
            normal[:] = 0.0
            known[:] = 0.0
            square = 0.0
            inside = True
            for r in range(side):
                for c in range(side):
                    x = place + (c - half) * (1.0 - slant_x) - (r - half) * slant_y
                    j = int(np.floor(x))
                    if j < 1 or j + 2 >= width:
                        inside = False
                        break
                    t = x - j
                    o = r * width + j
                    p0, p1, p2, p3 = strips[i, o - 1], strips[i, o], strips[i, o + 1], strips[i, o + 2]
                    # Catmull-Rom's cubic and its derivative.
                    a = 0.5 * (p3 - p0) + 1.5 * (p1 - p2)
                    b = p0 - 2.5 * p1 + 2.0 * p2 - 0.5 * p3
                    d = 0.5 * (p2 - p0)
                    value = ((a * t + b) * t + d) * t + p1
                    slope = (3.0 * a * t + 2.0 * b) * t + d
                    row[0] = -slope
                    row[1] = -slope * (c - half)
                    row[2] = -slope * (r - half)
                    row[3] = value
                    row[4] = 1.0
                    target = wanted[i, r * side + c]
                    square += target * target
                    for k in range(5):
                        known[k] += row[k] * target
                        for m in range(k + 1):
                            normal[k, m] += row[k] * row[m]
                if not inside:
                    break
            if not inside:
                break
            # A window with little texture does not determine its slant; this keeps the slant near its start.
            texture = normal[0, 0]
            normal[1, 1] += 0.02 * texture * half * half
            normal[2, 2] += 0.02 * texture * half * half
            for k in range(5):
                normal[k, k] += 1e-4
            if not _factorised(normal):
                break
            solved = known.copy()
            _back(normal, solved)
            if abs(solved[3]) < 0.1:
                break
            gain = solved[3]
            step = solved[0] / gain
            place -= min(max(step, -0.7), 0.7)
            slant_x += min(max(solved[1] / gain, -0.1), 0.1)
            slant_y += min(max(solved[2] / gain, -0.1), 0.1)
            if turn == turns - 1 or abs(step) < 0.005:
                residual = square
                for k in range(5):
                    residual -= solved[k] * known[k]
                unit = np.zeros(5)
                unit[0] = 1.0
                _back(normal, unit)
                variance = max(residual, 0.0) / (side * side - 5) + 0.5
                result[i, 0] = place - first
                result[i, 1] = np.sqrt(variance * unit[0]) / abs(gain)
                break
    return result


@compiled
def _factorised(matrix: Array) -> bool:
    """Replace the lower triangle by its Cholesky factor (numba's own needs SciPy); False if there is none."""
    n = len(matrix)
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        if matrix[j, j] <= 1e-9:
            return False
        matrix[j, j] = np.sqrt(matrix[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    return True


@compiled
def _back(factor: Array, known: Array) -> None:
    """Solve with a Cholesky factor in place."""
    n = len(factor)
    for i in range(n):
        for k in range(i):
            known[i] -= factor[i, k] * known[k]
        known[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            known[i] -= factor[k, i] * known[k]
        known[i] /= factor[i, i]
