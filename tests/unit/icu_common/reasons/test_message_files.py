"""Every code has a sentence in every language, and every sentence uses only values that its code has."""

from __future__ import annotations

from typing import Any

import pytest
from fluent.runtime import FluentBundle, FluentResource
from fluent.runtime.types import fluent_number
from support.message_files import GRAPH, constants, language, languages, made, messages, values

from icu_common.core.reasons.catalogue import english, key_of

SAMPLES: dict[str, Any] = {"one": 1, "many": 12_345, "part": 0.062, "word": "RUN_STOP"}


def test_each_language_has_a_sentence_for_each_key_with_the_same_values() -> None:
    wanted = language("en")
    assert languages() == ["de", "en"] and len(wanted) > 1000
    for name in languages():
        found = {key: message for key, message in language(name).items() if not key.startswith("word-")}
        assert found.keys() == wanted.keys(), name
        wrong = [key for key in wanted if values(key, found) != values(key, wanted)]
        assert wrong == [], name


def test_each_message_that_a_program_makes_has_a_sentence_with_its_values() -> None:
    known = messages(GRAPH)
    wrong = []
    for message in made():
        key = key_of(message.code)
        used = values(key, known) if key in known else None
        fits = used is not None and (message.values <= used if message.more else message.values == used)
        if not fits:
            wrong.append(f"{message.where}: {message.code} has {sorted(message.values)}, its sentence {used}")
    assert wrong == []


def test_each_sentence_of_the_graph_belongs_to_a_code() -> None:
    codes = {key_of(text) for text in constants()}
    assert [key for key in messages(GRAPH) if key not in codes] == []


@pytest.mark.parametrize("sample", SAMPLES)
def test_programs_write_the_sentences_as_fluent_does(sample: str) -> None:
    """Fluent's Python runtime reads the same file; numbers without a function are written without separators."""
    bundle = FluentBundle(["en"], functions={"FIXED": _fixed, "SHORT": _short}, use_isolating=False)
    bundle.add_resource(FluentResource(GRAPH.read_text(encoding="utf-8")))
    known = messages(GRAPH)
    for key in known:
        given = dict.fromkeys(values(key, known), SAMPLES[sample])
        shown = {name: _ungrouped(value) for name, value in given.items()}
        pattern = bundle.get_message(key).value
        assert pattern is not None
        text, errors = bundle.format_pattern(pattern, shown)
        assert errors == []
        assert english().sentence(key, given) == text, key


def _ungrouped(value: Any) -> Any:
    return value if isinstance(value, str) else fluent_number(value, useGrouping=False, maximumFractionDigits=20)


def _fixed(value: Any, digits: Any, sign: Any = 0) -> str:
    return f"{float(value):{'+' if sign else ''}.{int(digits)}f}" if not isinstance(value, str) else value


def _short(value: Any) -> str:
    return f"{float(value):g}" if not isinstance(value, str) else value
