"""Sequences of gestures with a check after each gesture: the grammar of their text; see docs/reference/goals.md.

A step is a gesture of the command grammar, followed by ``=>`` and one or more checks, separated by commas:
``press:RUN_STOP => lamp:RUN_STOP=red, effect``. A file is YAML: a mapping with ``steps`` (a list of such texts, or of
mappings with ``do``, ``check`` and ``within_s``) and optionally ``name``.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.configuration.yaml_text import UNREADABLE, ForeignLoader, mistake
from icu_common.core.panel.gesture import TURNING, Gesture, GestureError, is_mark, parse_gesture
from icu_common.core.panel.panel_state import LAMPS, ControlSeen, PanelSeen
from icu_common.core.reasons.message import Message, quoted

MAX_STEPS = 100
MAX_NAME = 64
"""Maximum number of characters of a sequence's name."""
_CHECK = re.compile(r"(?:(effect|screen)|(lamp|angle):([A-Za-z][A-Za-z0-9_]*)=([^\s=]+))\Z")


class SequenceError(ValueError):
    """A sequence is invalid; the message names the line or the step, and quotes only a part of long texts."""

    def __init__(self, what: str) -> None:
        super().__init__(plain(what))


@dataclass(frozen=True, slots=True, kw_only=True)
class StepCheck:
    """Expected observation after a step; ``kind`` is effect, screen, lamp or angle."""

    kind: str
    control: str = ""
    value: str = ""

    def text(self) -> str:
        return f"{self.kind}:{self.control}={self.value}" if self.control else self.kind


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceStep:
    """One gesture and its checks; with ``within_s`` NaN the configuration decides."""

    gesture: str
    checks: tuple[StepCheck, ...] = ()
    within_s: float = math.nan

    def text(self) -> str:
        """Return the step as on a command line, without its time."""
        checks = ", ".join(check.text() for check in self.checks)
        return f"{self.gesture} => {checks}" if checks else self.gesture


@dataclass(frozen=True, slots=True, kw_only=True)
class GestureSequence:
    """Steps in their order."""

    steps: tuple[SequenceStep, ...]
    name: str = ""

    def text(self) -> str:
        """Return the text of a file; ``parse_file(sequence.text()) == sequence``."""
        entries: list[Any] = []
        for step in self.steps:
            entry: dict[str, Any] = {"do": step.gesture, "check": [check.text() for check in step.checks]}
            entries.append(entry if math.isnan(step.within_s) else entry | {"within_s": step.within_s})
        named = {"name": self.name} if self.name else {}
        return yaml.safe_dump({**named, "steps": entries}, sort_keys=False, width=10**6, allow_unicode=True)


def parse_steps(texts: Sequence[str]) -> GestureSequence:
    """Read steps as given on a command line.

    Raises
    ------
    SequenceError
        With the number of the step and its fault.
    """
    return _sequence([(Message("sequence.place", number=number), text) for number, text in enumerate(texts, 1)], "")


def parse_file(text: str, file_name: str = "sequence") -> GestureSequence:
    """Read the text of a file.

    Raises
    ------
    SequenceError
        In the form ``file:line: what is wrong``.
    """
    try:
        return _sequence_of(yaml.compose(text, Loader=ForeignLoader), file_name)
    except UNREADABLE as error:
        raise SequenceError(f"{file_name}:{mistake(error)}") from error


def unfit(sequence: GestureSequence, seen: PanelSeen) -> str:
    """Return the step that the visible panel can never fulfil, and why; empty if it may fulfil all steps.

    Call it before the first step: otherwise the earlier steps, or a touch whose check must fail, would be carried out.
    """
    for number, step in enumerate(sequence.steps, 1):
        gesture = parse_gesture(step.gesture)
        found = [_unfit_gesture(gesture, seen), *(_unfit_check(check, seen) for check in step.checks)]
        if what := next(filter(None, found), ""):
            return Message("sequence.step_unfit", number=number, what=what)
    return ""


def _unfit_gesture(gesture: Gesture, seen: PanelSeen) -> str:
    if not isinstance(gesture.target, str):
        return ""  # the controller checks where that is
    control = seen.control(gesture.target)
    if control is None:
        return _missing(gesture.target, seen)
    if control.kind == "connector":
        return Message("target.connectors_never_pressed", control=control.name, kind=control.kind)
    if gesture.kind in TURNING and control.kind != "knob":
        return Message("target.only_knob_can_turned", control=control.name, kind=control.kind)
    if gesture.kind == "click" and not control.detent_deg:
        return Message("effect.no_clicks_detent_deg_layout", name=control.name)
    return _unfit_mark(control, gesture.mark) if gesture.mark else ""


def _unfit_check(check: StepCheck, seen: PanelSeen) -> str:
    if check.kind == "screen":
        return "" if any(c.kind == "touch_area" for c in seen.controls) else Message("sequence.panel_no_screen")
    if not check.control:
        return ""
    control = seen.control(check.control)
    if control is None:
        return _missing(check.control, seen)
    if check.kind == "lamp":
        if control.lamp or control.hidden_by:
            return ""
        lit = ", ".join(c.name for c in seen.controls if c.lamp) or "none"
        return Message("sequence.no_lamp_seen_lamps_seen", control=control.name, lit=lit)
    if control.kind != "knob":
        return Message("sequence.only_knob_angle", control=control.name, kind=control.kind)
    return _unfit_mark(control, check.value) if is_mark(check.value) else ""


def _unfit_mark(control: ControlSeen, mark: str) -> str:
    marks = dict(control.marks)
    return (
        ""
        if mark in marks
        else Message("effect.no_mark", name=control.name, mark=quoted(mark), marks=", ".join(marks) or "none")
    )


def _missing(name: str, seen: PanelSeen) -> str:
    names = [control.name for control in seen.controls]
    near = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.4) or names[:5]
    return Message("sequence.panel_no_nearest", name=name, near=", ".join(near))


def _sequence_of(root: yaml.Node | None, file_name: str) -> GestureSequence:
    if not isinstance(root, yaml.MappingNode):
        raise SequenceError(Message("sequence.n_1_mapping_steps_needed", file_name=file_name))
    entries: list[tuple[str, Any]] = []
    name = ""
    for key, value in root.value:
        place = f"{file_name}:{key.start_mark.line + 1}"
        if key.value == "name" and isinstance(value, yaml.ScalarNode):
            name = value.value
            if len(name) > MAX_NAME or not name.isprintable():
                raise SequenceError(
                    Message(
                        "sequence.name_characters_expected_up_printable", place=place, name=len(name), max_name=MAX_NAME
                    )
                )
        elif key.value == "steps" and isinstance(value, yaml.SequenceNode):
            for node in value.value:
                entries.append(
                    (f"{file_name}:{node.start_mark.line + 1}", ForeignLoader("").construct_object(node, deep=True))
                )
        else:
            raise SequenceError(Message("sequence.name_text_steps_list_known", place=place, key=quoted(key.value)))
    return _sequence(entries, name)


def _sequence(entries: Sequence[tuple[str, Any]], name: str) -> GestureSequence:
    if not 0 < len(entries) <= MAX_STEPS:
        raise SequenceError(Message("sequence.steps_1_needed", entries=len(entries), max_steps=MAX_STEPS))
    return GestureSequence(steps=tuple(_step(place, entry) for place, entry in entries), name=name)


def _step(place: str, entry: Any) -> SequenceStep:
    if isinstance(entry, dict):
        unknown = set(entry) - {"do", "check", "within_s"}
        if unknown or not isinstance(entry.get("do"), str):
            found = (
                Message("sequence.unknown_key", map=", ".join(sorted(map(str, unknown))))
                if unknown
                else Message("sequence.no_gesture")
            )
            raise SequenceError(Message("sequence.gesture_check_within_known", place=place, found=found))
        checks = entry.get("check", [])
        texts = [checks] if isinstance(checks, str) else checks
        within = entry.get("within_s", math.nan)
        good = isinstance(within, (int, float)) and not isinstance(within, bool)
        if not good or not (within != within or 0 < within <= 60):  # isnan raises an error for an integer of 400 digits
            raise SequenceError(
                Message("sequence.within_seconds_above_0_up", place=place, within=plain(repr(within), 40))
            )
        if not isinstance(texts, list) or not all(isinstance(t, str) for t in texts):
            raise SequenceError(Message("sequence.check_text_list_texts_needed", place=place, checks=quoted(checks)))
        gesture, within_s = entry["do"], float(within)
    elif isinstance(entry, str):
        gesture, arrow, after = entry.partition("=>")
        texts, within_s = after.split(",") if arrow else [], math.nan
    else:
        raise SequenceError(Message("sequence.neither_text_nor_mapping", place=place, entry=quoted(entry)))
    try:
        parsed = parse_gesture(gesture.strip())
    except GestureError as error:
        raise SequenceError(f"{place}: {error}") from error
    if parsed.id:
        raise SequenceError(Message("sequence.ids_given_sequencer", place=place, gesture=quoted(gesture.strip())))
    return SequenceStep(gesture=parsed.text(), checks=tuple(_check(place, t.strip()) for t in texts), within_s=within_s)


def _check(place: str, text: str) -> StepCheck:
    found = _CHECK.match(text)
    if found is None:
        known = Message("sequence.effect_screen_lamp_name_colour")
        raise SequenceError(Message("sequence.check_none", place=place, text=quoted(text), known=known))
    if found[2] == "lamp" and found[4] not in LAMPS:
        raise SequenceError(Message("sequence.lamp_none", place=place, found=quoted(found[4]), lamps=", ".join(LAMPS)))
    return StepCheck(kind=found[1] or found[2], control=found[3] or "", value=found[4] or "")
