"""Who does the tasks of a survey: this process itself, or workers that Dask has."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Protocol

__all__ = ["Done", "Engine", "InProcess"]

Done = tuple[Any, Any]
"""A task, and what its function returned."""


class Engine(Protocol):
    """Does tasks in any order, each at least once, and reports when one is done."""

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 any task
        """Have a task done."""

    def done(self) -> Iterator[Done]:
        """Tasks as they end, until none is left; meanwhile more may be submitted.

        Raises:
            SurveyError: a task cannot be done, however often it is tried.
        """

    def close(self) -> None:
        """Let the workers go."""


class InProcess:
    """One task after the other, here."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Callable[[Any], Any], Any]] = deque()

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 as above
        """Have a task done."""
        self._waiting.append((function, task))

    def done(self) -> Iterator[Done]:
        """Tasks as they end."""
        while self._waiting:
            function, task = self._waiting.popleft()
            yield task, function(task)

    def close(self) -> None:
        """Nobody to let go."""
