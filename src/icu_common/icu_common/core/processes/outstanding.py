"""Messages that have been published and not yet processed, from the counts of all processes of a graph."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Counts = npt.NDArray[np.int64]


class Outstanding:
    """Difference between expected and finished deliveries of each topic since a baseline.

    A new or ended subscription makes the two counts incomparable. A late subscriber of a latched topic processes a
    message that was published before, and an ended one leaves messages unprocessed. The baseline of the topic then
    starts again. New topics are added at the end of the counts.
    """

    def __init__(self) -> None:
        self._baseline: Counts = np.zeros(0, np.int64)
        self._subscriptions: Counts = np.zeros(0, np.int64)

    def update(self, finished: Counts, expected: Counts, subscriptions: Counts) -> Counts:
        """Return the number of outstanding deliveries of each topic, (topics,).

        Parameters
        ----------
        finished, expected, subscriptions
            (topics,): callbacks that have returned, deliveries that publishers expect, and subscriptions.
        """
        if added := len(finished) - len(self._baseline):
            self._baseline = np.pad(self._baseline, (0, added))
            self._subscriptions = np.pad(self._subscriptions, (0, added))
        owed: Counts = expected - finished - self._baseline
        restart = (subscriptions != self._subscriptions) | (owed < 0)
        self._baseline[restart] += owed[restart]
        owed[restart] = 0
        self._subscriptions = subscriptions
        return owed

    def forgive(self, owed: Counts) -> None:
        """Stop waiting for ``owed``, as returned by :meth:`update`."""
        self._baseline += owed
