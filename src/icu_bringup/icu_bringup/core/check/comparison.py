"""Compares the messages of a replay with the expected ones, topic by topic and field by field."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from icu_bringup.core.check.expectation import Expectation, TopicExpectation
from icu_bringup.core.check.tolerances import Difference, Tolerance, difference, limits_text, tolerance_for
from icu_bringup.core.check.values import Kind, Value

COUNT = "messages"
_SHOWN = 60


@dataclass(frozen=True, slots=True)
class ComparedMessage:
    """One message of a bag.

    Attributes
    ----------
    stamp_ns
        Stamp of its header, 0 without one.
    values
        Values of its fields, by the field's path.
    """

    stamp_ns: int
    values: Mapping[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicMessages:
    """All messages of a topic, in the order in which they were recorded."""

    type: str
    messages: Sequence[ComparedMessage] = field(default_factory=tuple)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of a comparison: a field of a topic over all messages.

    Attributes
    ----------
    topic, field
        Compared topic and field; the field ``messages`` is the message count.
    compared, differing
        Number of messages, and of those outside the limits.
    amount
        The largest difference, in the unit of its limit; infinite where two values cannot be compared.
    at
        Stamp in ns (or index, without stamps) of the message with the largest difference.
    expected, found
        The two values there.
    limits
        Allowed difference.
    why
        Reason of the tolerance.
    """

    topic: str
    field: str
    compared: int
    differing: int
    amount: float
    at: int
    expected: str
    found: str
    limits: str
    why: str = ""

    @property
    def passed(self) -> bool:
        """Whether the field is within its limits in every message."""
        return not self.differing


def compare(
    expectation: Expectation, expected: Mapping[str, TopicMessages], found: Mapping[str, TopicMessages]
) -> list[Row]:
    """Return all rows, topic by topic."""
    rows: list[Row] = []
    for name, topic in expectation.topics.items():
        new = found.get(name, TopicMessages(type=topic.type))
        rows.append(_count_row(name, topic, new))
        if new.type != topic.type:
            rows.append(_row(name, "type", topic.type, new.type))
            continue
        old = expected.get(name, TopicMessages(type=topic.type))
        rows += _field_rows(name, topic, old, new)
    return rows


def _row(topic: str, what: str, old: str, new: str, *, amount: float = math.inf, limits: str = "the same") -> Row:
    return Row(
        topic=topic,
        field=what,
        compared=1,
        differing=1,
        amount=amount,
        at=0,
        expected=old,
        found=new,
        limits=limits,
    )


def _count_row(name: str, topic: TopicExpectation, new: TopicMessages) -> Row:
    off = abs(len(new.messages) - topic.messages)
    return Row(
        topic=name,
        field=COUNT,
        compared=1,
        differing=int(off > topic.missing),
        amount=float(off),
        at=0,
        expected=str(topic.messages),
        found=str(len(new.messages)),
        limits=f"missing {topic.missing}",
    )


def matched(
    old: Sequence[ComparedMessage], new: Sequence[ComparedMessage], every: int = 1
) -> list[tuple[ComparedMessage, ComparedMessage | None]]:
    """Return each expected message with the matching one: of equal stamp, or of equal position without stamps.

    Only each ``every``-th of the expected messages was kept.
    """
    if old and all(m.stamp_ns for m in old) and len({m.stamp_ns for m in old}) == len(old):
        by_stamp = {m.stamp_ns: m for m in new}
        return [(m, by_stamp.get(m.stamp_ns)) for m in old]
    kept = new[::every]
    return [(m, kept[i] if i < len(kept) else None) for i, m in enumerate(old)]


def _field_rows(name: str, topic: TopicExpectation, old: TopicMessages, new: TopicMessages) -> list[Row]:
    pairs = matched(old.messages, new.messages, topic.every)
    rows = []
    absent = [before for before, after in pairs if after is None]
    if len(absent) > topic.missing:
        rows.append(
            Row(
                topic=name,
                field="stamps",
                compared=len(pairs),
                differing=len(absent),
                amount=float(len(absent)),
                at=absent[0].stamp_ns,
                expected=f"{len(pairs)} messages",
                found=f"{len(pairs) - len(absent)} of these stamps",
                limits=f"missing {topic.missing}",
            )
        )
    both = [(before, after) for before, after in pairs if after is not None]
    paths = dict.fromkeys(path for pair in both for message in pair for path in message.values)
    for path in paths:
        tolerance = topic.fields.get(_pattern(path, topic.fields), Tolerance())
        if not tolerance.ignored:
            rows += _one_field(name, path, tolerance, both)
    return rows


def _pattern(path: str, fields: Mapping[str, Tolerance]) -> str:
    """Return the key of a field's tolerance: its path, or that with ``[*]`` for all indices."""
    return path if path in fields else generic(path)


def generic(path: str) -> str:
    """Return a path with ``[*]`` in place of its indices."""
    parts = path.split("[")
    return parts[0] + "".join("[*]" + part.partition("]")[2] for part in parts[1:])


def _one_field(
    name: str, path: str, tolerance: Tolerance, pairs: Sequence[tuple[ComparedMessage, ComparedMessage]]
) -> list[Row]:
    worst: tuple[Difference, ComparedMessage, Value | None, Value | None] | None = None
    differing = compared = 0
    for before, after in pairs:
        old, new = before.values.get(path), after.values.get(path)
        if old is None and new is None:
            continue
        compared += 1
        apart = Difference({"absent": math.inf}) if old is None or new is None else difference(old, new, tolerance)
        bad = apart.exceeds(tolerance)
        differing += bad
        if worst is None or apart.size > worst[0].size:
            worst = apart, before, old, new
    if worst is None:
        return []
    apart, before, old, new = worst
    return [
        Row(
            topic=name,
            field=path,
            compared=compared,
            differing=differing,
            amount=apart.size,
            at=before.stamp_ns,
            expected=text_of(old),
            found=text_of(new),
            limits=limits_text(tolerance),
            why=tolerance.why,
        )
    ]


def text_of(value: Value | None) -> str:
    """Return a value as a short text."""
    if value is None:
        return "absent"
    match value.kind:
        case Kind.TEXT:
            text = value.text
        case Kind.CLOUD:
            text = f"{len(value.data)} points"
        case Kind.IMAGE:
            text = "x".join(str(n) for n in value.data.shape) + f", mean {np.nan_to_num(value.data).mean():.2f}"
        case _:
            text = " ".join(f"{v:.7g}" for v in value.data[:7]) + (" ..." if value.data.size > 7 else "")
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def unknown_fields(expectation: Expectation, expected: Mapping[str, TopicMessages]) -> list[str]:
    """Return the fields with a tolerance, as ``topic: path``, that no expected message has."""
    found = []
    for name, topic in expectation.topics.items():
        messages = expected[name].messages if name in expected else ()
        there = {form for message in messages for path in message.values for form in (path, generic(path))}
        found += [f"{name}: {path}" for path in topic.fields if path not in there]
    return found


def new_topic(runs: Sequence[TopicMessages], every: int = 1, old: TopicExpectation | None = None) -> TopicExpectation:
    """Return the expectation of a topic from repeated runs; tolerances of an ``old`` one are kept."""
    first = runs[0]
    samples: dict[str, Value] = {}
    worst: dict[str, dict[str, float]] = {}
    for message in first.messages:
        for path, value in message.values.items():
            samples.setdefault(generic(path), value)
    for other in runs[1:]:
        for before, after in matched(first.messages[::every], other.messages, every):
            for path, value in before.values.items():
                new = after.values.get(path) if after is not None else None
                if new is None:
                    continue
                seen = worst.setdefault(generic(path), {})
                for name, amount in difference(value, new, Tolerance()).amounts.items():
                    seen[name] = max(seen.get(name, 0.0), amount)
    fields = {path: tolerance_for(path, value, worst.get(path, {}), len(runs)) for path, value in samples.items()}
    if old is not None:
        fields |= {path: tolerance for path, tolerance in old.fields.items() if generic(path) in fields}
    missing = max(abs(len(run.messages) - len(first.messages)) for run in runs)
    return TopicExpectation(
        type=first.type,
        messages=len(first.messages),
        missing=max(missing, old.missing if old is not None else 0),
        every=every,
        fields=fields,
    )
