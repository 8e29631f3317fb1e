"""The switch in the stylus as evidence of a contact."""

from __future__ import annotations

import pytest

from gantry_driver.core.contact.switch import StylusSwitch


@pytest.mark.parametrize(
    "air, contact, closed",
    [
        ([False] * 3, [True] * 3, True),
        ([False] * 3, [False, True, False, True, False], False),  # single reports are damage
        ([True] * 3, [True] * 3, None),  # a broken wire of a closed contact
        ([False, True, False], [True] * 3, None),  # not at rest before
        ([None] * 3, [None] * 3, None),
        ([False] * 3, [True, True, False], True),
    ],
)
def test_only_a_switch_that_was_open_before_is_evidence(
    air: list[bool | None], contact: list[bool | None], closed: bool | None
) -> None:
    switch = StylusSwitch()
    for probe in air:
        switch.take(probe)
    switch.goes_down()
    for probe in contact:
        switch.take(probe)
    assert switch.closed is closed
