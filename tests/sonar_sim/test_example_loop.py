"""The example of a loop is an environment of Gymnasium's, by its own checker."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "drive_loop.py"


@pytest.fixture
def example() -> Any:
    spec = importlib.util.spec_from_file_location("drive_loop", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the checker advises
def test_gymnasium_accepts_it(example: Any) -> None:
    gymnasium = pytest.importorskip("gymnasium")
    checker = pytest.importorskip("gymnasium.utils.env_checker")
    env = example.HarbourEnv()
    assert isinstance(env, gymnasium.Env)
    checker.check_env(env, skip_render_check=True)


def test_episodes_differ_unless_they_are_seeded(example: Any) -> None:
    env = example.HarbourEnv()
    first, _ = env.reset(seed=3)
    other, _ = env.reset()
    again, _ = env.reset(seed=3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_episode_is_the_same_for_the_same_seed_and_comes_nearer(example: Any) -> None:
    def run() -> tuple[bytes, float]:
        env = example.HarbourEnv()
        image, info = env.reset(seed=3)
        for _ in range(4):
            image, _, _, _, info = env.step(np.array([1.0, 0.0]))
        return image.tobytes(), info["distance_m"]

    first, again = run(), run()
    assert first == again
    assert first[1] == pytest.approx(12.0 - 0.8 * (2.0 - 0.6), abs=0.1)
