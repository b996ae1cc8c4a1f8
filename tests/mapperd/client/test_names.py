"""Names of earlier versions can still be imported."""

import pytest

import mapperd.client
from mapperd.wire import messages


@pytest.mark.parametrize("name", ["Event", "Fan", "Image", "Localization", "Path", "Pose"])
def test_former_names_of_messages_are_importable(name: str) -> None:
    assert getattr(mapperd.client, name) is getattr(messages, f"{name}Message")


def test_former_name_of_the_box_is_importable() -> None:
    from mapperd.client import Box  # noqa: PLC0415

    assert Box is mapperd.client.MapBox


def test_no_other_name_is_made_up() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Hello'"):
        mapperd.client.Hello  # noqa: B018
