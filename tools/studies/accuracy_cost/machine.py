"""Where figures come from: the machine, and the commit of what was measured."""

import hashlib
import subprocess
from pathlib import Path

from studies.accuracy_cost.errors import AccuracyCostError
from studies.report import ROOT

__all__ = ["commit"]

MEASURED = (
    *("cpp", "mapperd", "oculus_driver", "tools", "config", "pyproject.toml"),
    ":(exclude,glob)tools/studies/accuracy_cost/*.py",
)
"""What figures depend on: changes of texts, of tests, or of how they are drawn leave them valid."""


def commit(root: Path = ROOT) -> str:
    """The last commit that changed what is measured; `+` and a digest where it is changed since.

    Raises:
        AccuracyCostError: this is no checkout of git.
    """
    last = _git(root, "log", "-1", "--format=%h", "--abbrev=12", "--", *MEASURED).strip()
    if not _git(root, "status", "--porcelain", "--", *MEASURED):
        return last
    names = _git(root, "ls-files", "-co", "--exclude-standard", "-z", "--", *MEASURED)
    digest = hashlib.sha256()
    for name in sorted(filter(None, names.split("\0"))):
        file = root / name
        digest.update(name.encode() + b"\0" + (file.read_bytes() if file.is_file() else b""))
    return f"{last}+{digest.hexdigest()[:8]}"


def _git(root: Path, *words: str) -> str:
    command = ["git", "-C", str(root), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError) as error:
        raise AccuracyCostError(f"{root} is no checkout of git: its commit is unknown") from error
    return done.stdout
