"""Values written into settings files, whose comments stay."""

import pytest

from mapperd.config.catalog import parameters, value_of
from mapperd.config.layers import text_with
from mapperd.config.loader import config_from_text
from mapperd.errors import ConfigError

BLOCK = """\
# our vehicle
filtering:
  min_range: 0.8 # m; the frame is nearer
  intensity_threshold: 40
octree: { voxel_resolution: 0.1 } # m
"""


@pytest.mark.parametrize("text", ["", "# nothing yet\n", BLOCK, BLOCK.rstrip()])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("filtering.min_range", 1.5),
        ("filtering.intensity_threshold", 60),
        ("device.range", 12.0),
        ("octree.voxel_resolution", 0.2),
        ("processing.frame_skip", 3),
        ("mounting.orientation.pitch", 30.0),
        ("server.address", "0.0.0.0:7471"),
    ],
)
def test_a_value_is_in_the_file_and_the_rest_stays(text: str, name: str, value: object) -> None:
    assert name in parameters()
    before, changed = config_from_text(text), text_with(text, name, value)
    after = config_from_text(changed)
    assert value_of(after, name) == value
    for other in parameters():
        assert other == name or value_of(after, other) == value_of(before, other)
    for comment in ("# our vehicle", "# m; the frame is nearer", "# m\n", "# nothing yet"):
        assert (comment in changed) == (comment in text) or comment == "# m\n"


def test_a_second_value_joins_the_first() -> None:
    text = text_with("", "mounting.orientation.pitch", 30.0)
    text = text_with(text, "mounting.orientation.roll", 180.0)
    text = text_with(text, "mounting.position.x", 0.2)
    config = config_from_text(text)
    assert (config.mounting.orientation.pitch, config.mounting.orientation.roll) == (30.0, 180.0)
    assert config.mounting.position.x == 0.2


def test_a_value_of_several_lines_is_not_touched() -> None:
    text = "odometry:\n  sources:\n    - { name: a, link: 'udp://0.0.0.0:27000' }\n"
    with pytest.raises(ConfigError, match="several lines"):
        text_with(text, "odometry.sources", [])


def test_parameters_of_nodes_are_not_touched() -> None:
    text = "mapper:\n  ros__parameters:\n    filtering: {min_range: 0.8}\n"
    with pytest.raises(ConfigError, match="parameters of ROS 2 nodes: edit it there"):
        text_with(text, "filtering.min_range", 1.0)
