"""Python under the mutation check: packages come from the copy, not from where they are installed.

Found by way of PYTHONPATH, so that programs that a test starts do the same. Where a test imported
the mutated file, a witness is left: a file that nobody imports is broken unnoticed.
"""

import atexit
import os
import sys
from pathlib import Path

# An editable install has a finder of its own, which comes before PYTHONPATH.
sys.meta_path[:] = [
    finder for finder in sys.meta_path if type(finder).__name__ != "ScikitBuildRedirectingFinder"
]


def bear_witness(mutated: Path, witness: Path) -> None:
    """Touch the witness where the mutated file has been imported."""
    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    if any(file is not None and Path(file) == mutated for file in files):
        witness.touch()


if "MUTATIONS_FILE" in os.environ:
    atexit.register(
        bear_witness,
        Path(os.environ["MUTATIONS_FILE"]),
        Path(os.environ["MUTATIONS_WITNESS"]),
    )
