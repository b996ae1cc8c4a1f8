"""Runs the tasks of a survey: in this process, or by Dask's workers."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Protocol

__all__ = ["Done", "Engine", "InProcess"]

Done = tuple[Any, Any]
"""A task and its result."""


class Engine(Protocol):
    """Runs tasks in any order, each at least once, and reports finished ones."""

    def submit(self, function: Callable[[Any], Any], task: Any) -> None:  # noqa: ANN401 any task
        """Have a task done."""

    def done(self) -> Iterator[Done]:
        """Yield tasks as they end, until none is left; more may be submitted meanwhile.

        Raises:
            SurveyError: a task fails at all attempts.
        """

    def close(self) -> None:
        """Release the workers."""


class InProcess:
    """Runs one task after the other in this process."""

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
        """Do nothing: there are no workers."""
