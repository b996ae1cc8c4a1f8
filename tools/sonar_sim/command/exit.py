"""Exit codes of `sonar-sim`."""

from typing import Final

OK: Final = 0
FAULT: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130
