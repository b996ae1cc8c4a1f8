"""Minimised inputs of the fuzzers, a file per fuzzer: `name base64` on each line."""

import base64
import sys
from collections.abc import Callable
from pathlib import Path

FOLDER = Path(__file__).parent


def read_cases(name: str) -> dict[str, bytes]:
    """Return the inputs of `NAME.cases` by their names."""
    lines = (FOLDER / f"{name}.cases").read_text(encoding="ascii").splitlines()
    return {key: base64.b64decode(data) for key, data in map(str.split, lines)}


def fuzz(name: str, one_input: Callable[[bytes], None]) -> None:
    """Hand over to libFuzzer with the command line `CORPUS [options]`.

    Adds the cases to the folder CORPUS first.
    """
    import atheris  # noqa: PLC0415 only the fuzzers need it

    corpus = Path(sys.argv[1])
    corpus.mkdir(parents=True, exist_ok=True)
    for key, data in read_cases(name).items():
        (corpus / key).write_bytes(data)
    # Not at import: an editable install hides its imports from atheris.
    atheris.instrument_all()
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
