"""Bridges, with no settings but those that are given."""

from importlib.util import find_spec

from tests.support.mapperctl import no_settings

__all__ = ["collect_ignore", "no_settings"]

collect_ignore = (
    []
    if find_spec("cyclonedds")
    else [
        "test_bridge_docs.py",
        "test_ros2_bridge.py",
        "test_ros2_with_daemon.py",
    ]
)
"""PyPI has no cyclonedds for ARM64."""
