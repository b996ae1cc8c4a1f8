"""The order in which blocks wait, against sorting all of them."""

import numpy as np
import pytest

from mapperd.stream import nearest as nearest_module
from mapperd.stream.nearest import WAITING, NearestFirst
from mapperd.stream.region import distances_m, vector_of


@pytest.mark.parametrize("front", [8, 1 << 14])
def test_the_nearest_of_all_come_first(front: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest_module, "FRONT", front)
    random = np.random.default_rng([44, front])
    keys = random.integers(-20, 20, (600, 3)).astype(np.int32)
    queue = NearestFirst(lambda numbers: keys[numbers], 0.8)
    queue.make_room(len(keys))
    waiting: set[int] = set()
    position = np.zeros(3)
    for _ in range(300):
        if random.random() < 0.3:
            coming = random.integers(0, len(keys), int(random.integers(0, 60)))
            queue.add(np.unique(coming))
            waiting |= set(coming.tolist())
        position = position + random.normal(0.0, 0.5, 3)
        at = vector_of(position)
        assert at is not None
        most = int(random.integers(1, 7))
        found = queue.nearest(most, at)
        assert len(found) == min(most, len(waiting))
        assert set(found.tolist()) <= waiting
        away = distances_m(keys[found], 0.8, at)
        of_all = np.sort(distances_m(keys[sorted(waiting)], 0.8, at))
        assert away.tolist() == of_all[: len(found)].tolist()
        queue.remove(found)
        waiting -= set(found.tolist())
        assert len(queue) == len(waiting) == int((queue.flags & WAITING != 0).sum())
