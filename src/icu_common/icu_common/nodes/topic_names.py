"""Names of topics on a command line."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_topic_name import validate_topic_name


def check_names(topics: Iterable[str]) -> None:
    """Raise ``ValueError`` for the first name that no topic can have."""
    for name in topics:
        if problem := name_problem(name):
            raise ValueError(f"topic {name!r}: {problem}")


def name_problem(name: str) -> str:
    """Return why no topic can have a name, empty if one can."""
    try:
        validate_topic_name(name)
        validate_full_topic_name(expand_topic_name(name, "node", "/"))
    except InvalidTopicNameException as error:
        return str(error).splitlines()[0]
    return ""
