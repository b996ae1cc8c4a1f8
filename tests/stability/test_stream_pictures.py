"""Hard cases of the map stream: pictures, returns and the path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from mapperd.client.state import ClientState
from mapperd.client.validation import check_message, image_of
from mapperd.config.tree import Config
from mapperd.imaging.ping_image import PingImage
from mapperd.server.state_messages import IMAGE_SIZES, VehiclePath, first_returns, image_message
from mapperd.wire.blocks import path_message
from mapperd.wire.messages import Interest, PathMessage
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.stream import StreamParser
from tests.mapperd.conftest import make_ping

if TYPE_CHECKING:
    from numpy.typing import NDArray


def ping_of(image: NDArray[np.generic]) -> Ping:
    beams = image.shape[1]
    bearings = np.linspace(-6000, 6000, beams).round().astype(np.int16)
    (message,) = StreamParser().feed(make_ping(1, image=image, bearings_cdeg=bearings), 1)
    decoded = decode_ping(message)
    assert isinstance(decoded, Ping)
    return decoded


@pytest.mark.parametrize("shape", [(1, 2), (2, 513), (513, 2), (515, 257)])
def test_a_picture_of_any_size_keeps_its_single_brightest_sample(shape: tuple[int, int]) -> None:
    """A coarser picture is the highest of each group of samples: a mine is one of them.

    Naively every second row is left out, or the last group, which is not whole, is cut off with
    what is in it.
    """
    for row, beam in ((0, 0), (shape[0] - 1, shape[1] - 1)):
        image = np.zeros(shape, np.uint8)
        image[row, beam] = 255
        for most in IMAGE_SIZES:
            made = image_message(ping_of(image), 5, most)
            check_message(made)
            pixels = image_of(made)
            assert pixels.shape[0] <= most[0]
            assert pixels.shape[1] <= most[1]
            assert pixels.max() == 255
            assert (pixels == 255).sum() == 1


def test_pictures_of_16_bits_do_not_wrap_at_their_ends() -> None:
    """Full scale of 16 bits is 65535, and a sample just below it rounds to it.

    Naively 65535 / 256 is rounded to 256, which is 0 in eight bits: what is brightest is black.
    """
    image = np.array([[0, 1, 65279, 65407, 65408, 65534, 65535, 65535]], np.uint16)
    pixels = image_of(image_message(ping_of(image), 5, IMAGE_SIZES[0]))
    exact = np.rint(image.astype(np.float64) * 255 / 65535)
    assert pixels[0].tolist() == exact[0].tolist()


def test_returns_behind_the_least_range_of_all_are_invalid() -> None:
    """`filtering.min_range` may lie beyond the image, or be a whole number of rows.

    Naively the first row is a negative number or beyond the last, and counts from the end.
    """
    image = np.full((10, 5), 200, np.float32)
    for row_m in (0.001, 0.05, 0.09, 0.5):
        echo = PingImage(image, np.linspace(-1, 1, 5), row_m)
        points, bright = first_returns(echo, Config())
        min_m = Config().filtering.min_range
        assert len(points) == len(bright) == (5 if 10 * row_m > min_m else 0)
        assert (np.linalg.norm(points, axis=1) >= min_m).all()


def test_a_path_of_a_year_stays_within_its_points() -> None:
    """A daemon keeps the path of all its dives, in as many points as it was given room for.

    Naively the path grows by a point for every metre, or forgets where it began.
    """
    track = VehiclePath(100, 1.0)
    for metre in range(20_000):
        track.add(np.array([float(metre), 0.0, 0.0]))
    assert len(track) <= 100
    version, first, points = track.since(0, 0, 1000)
    assert version == track.version > 5
    assert first == 0
    assert points[0].tolist() == [0.0, 0.0, 0.0]
    steps = np.diff(points[:, 0])
    assert (steps == steps[0]).all()
    assert points[-1, 0] > 19_000


def test_a_path_in_universal_coordinates_is_sent_to_a_millimetre() -> None:
    """A path goes on 4650 km from the zero of its zone, a decimetre from point to point.

    Naively its points are in single precision, in steps of half a metre: a staircase.
    """
    track = VehiclePath(1000, 0.05)
    way = np.array([500_000.123, 4_649_776.25, -12.5]) + np.outer(np.arange(300), [0.07, 0.071, 0])
    for position_m in way:
        track.add(position_m)
    version, first, points = track.since(0, 0, 1000)
    client_state = ClientState(Interest(), lambda _: None)
    for begin in (0, 100, 200):
        piece = path_message(first + begin, points[begin : begin + 100], version)
        client_state.take(msgspec.msgpack.decode(msgspec.msgpack.encode(piece), type=PathMessage))
    assert np.abs(client_state.path - way).max() < 1e-6
    # Who knows no more than points reads them where they were before.
    old = np.frombuffer(piece.points, "<f4").reshape(-1, 3)
    assert np.abs(old - way[200:]).max() < 0.5


def test_a_path_near_the_map_s_zero_has_no_rest() -> None:
    """Within some kilometres single precision holds a path to the millimetre.

    Naively each point takes twice the bytes of the link, for digits that nobody sees.
    """
    near, far = (np.array([[x_m, 0.1, -5.0]]) for x_m in (9_000.1, 90_000.1))
    assert path_message(0, near).rest == b""
    assert len(path_message(0, far).rest) == len(path_message(0, far).points)


def test_a_position_beyond_all_numbers_is_no_point_of_the_path() -> None:
    """Odometry may send 1e300 m once, which single precision holds as infinity.

    Naively it is sent as that, and every client that checks what it reads ends its connection.
    """
    track = VehiclePath(10, 0.1)
    for x in (0.0, 1e300, -1e300, 1e31, 1.0):
        track.add(np.array([x, 0.0, 0.0]))
    _, _, points = track.since(0, 0, 10)
    assert points[:, 0].tolist() == [0.0, 1.0]
