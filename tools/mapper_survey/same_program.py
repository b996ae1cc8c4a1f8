"""Tasks for workers on other machines, which may have another version of the program installed."""

import pickle
from collections.abc import Callable
from typing import Any

from mapper_survey.errors import SurveyError
from mapper_survey.fingerprint import program_digest
from mapperd.version import version

__all__ = ["Sent", "done_by_worker", "sent"]

Sent = tuple[str, str, bytes]
"""Version and digest of who sends it; function and task, unpacked only where these are alike."""


def sent(function: Callable[[Any], Any], task: Any) -> Sent:  # noqa: ANN401 any task
    """What a worker is given."""
    return version(), program_digest(), pickle.dumps((function, task))


def done_by_worker(work: Sent) -> object:
    """Do a task, in the worker.

    Raises:
        SurveyError: the worker has another program, whose shards would not be the same to the bit.
    """
    their_version, their_digest, packed = work
    mine = program_digest()
    if mine != their_digest:
        raise SurveyError(
            f"a worker has mapperd {version()} (program {mine[:8]}); allowed: the one of the "
            f"command, {their_version} (program {their_digest[:8]}), of the same package"
        )
    function, task = pickle.loads(packed)  # noqa: S301 from who began the workers
    return function(task)
