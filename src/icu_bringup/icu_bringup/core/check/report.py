"""The rows of a comparison as a table, Markdown for a pull request, JUnit XML and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any
from xml.etree import ElementTree

from icu_bringup.core.check.comparison import Row

_HEAD = ("topic", "field", "expected", "found", "difference", "limit")


def table(rows: Sequence[Row]) -> str:
    """Return rows as aligned text."""
    lines = [_HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(_HEAD))]
    return "\n".join("  ".join(text.ljust(width) for text, width in zip(line, widths)).rstrip() for line in lines)


def _cells(row: Row) -> tuple[str, ...]:
    return row.topic, row.field, row.expected, row.found, amount_text(row.amount), row.limits


def amount_text(amount: float) -> str:
    """Return a difference with three digits; ``different`` where two values cannot be compared."""
    return "different" if math.isinf(amount) else f"{amount:.3g}"


def verdict(bag: str, rows: Sequence[Row]) -> str:
    """Return the result in one sentence."""
    bad = [row for row in rows if not row.passed]
    topics = len({row.topic for row in rows})
    if not bad:
        return f"{bag}: as expected ({len(rows)} fields, {topics} topics)"
    where = ", ".join(dict.fromkeys(row.topic for row in bad))
    return f"{bag}: {len(bad)} of {len(rows)} fields differ ({where})"


def markdown(bag: str, rows: Sequence[Row], pictures: Sequence[str] = ()) -> str:
    """Return a summary for a pull request; ``pictures`` are paths relative to it."""
    bad = [row for row in rows if not row.passed]
    lines = [f"### {'✅' if not bad else '❌'} {verdict(bag, rows)}", ""]
    if bad:
        lines += [f"| {' | '.join(_HEAD)} |", "|" + "---|" * len(_HEAD)]
        lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in _cells(row)) + " |" for row in bad]
        lines.append("")
    lines += [f"![{name}]({name})" for name in pictures]
    counts: dict[str, list[int]] = {}
    for row in rows:
        count = counts.setdefault(row.topic, [0, 0])
        count[0] += 1
        count[1] += row.passed
    lines += ["<details><summary>All topics</summary>", "", "| topic | fields within their limits |", "|---|---|"]
    lines += [f"| {topic} | {passed} of {count} |" for topic, (count, passed) in counts.items()]
    return "\n".join([*lines, "", "</details>", ""])


def junit(bag: str, rows: Sequence[Row], seconds: float) -> str:
    """Return JUnit XML: one test case for each field, one class for each topic."""
    bad = sum(not row.passed for row in rows)
    suite = ElementTree.Element(
        "testsuite",
        name=f"bag_check {bag}",
        tests=str(len(rows)),
        failures=str(bad),
        errors="0",
        skipped="0",
        time=f"{seconds:.3f}",
    )
    for row in rows:
        case = ElementTree.SubElement(
            suite, "testcase", classname=f"{bag}{row.topic}".replace("/", "."), name=row.field
        )
        if not row.passed:
            text = f"expected {row.expected}, found {row.found}: {amount_text(row.amount)} (limit: {row.limits})"
            failure = ElementTree.SubElement(case, "failure", message=text)
            failure.text = (
                f"{row.differing} of {row.compared} messages differ; the largest difference is at {row.at} ns"
            )
    return _document(suite)


def junit_error(bag: str, reason: str) -> str:
    """Return JUnit XML for a check that could not run."""
    suite = ElementTree.Element("testsuite", name=f"bag_check {bag}", tests="1", failures="0", errors="1")
    case = ElementTree.SubElement(suite, "testcase", classname=bag, name="run")
    ElementTree.SubElement(case, "error", message=reason)
    return _document(suite)


def _document(suite: ElementTree.Element) -> str:
    suites = ElementTree.Element("testsuites")
    suites.append(suite)
    ElementTree.indent(suites)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suites, encoding="unicode") + "\n"


def as_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows for JSON, which has no infinity: null means a difference without a size."""
    return [
        {**asdict(row), "amount": None if math.isinf(row.amount) else row.amount, "passed": row.passed} for row in rows
    ]
