"""A program that starts daemons at once: it has imported everything, and forks.

Reads command lines (JSON lists) from its standard input, and prints the number of the process that
carries each one out, and later how it ended: `began PID`, `ended PID STATUS`.
"""

import json
import os
import sys
import threading
import traceback
from typing import IO

from mapperd.cli import mapperd as cli


def work(words: list[str]) -> None:
    """Be the daemon; never returns."""
    code = 70
    try:
        code = int(cli.main(words))
    except BaseException:  # noqa: BLE001 nobody else could report it
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def main(commands: IO[str]) -> None:
    for line in commands:
        process = os.fork()
        if process == 0:
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(2, 1)
            work(json.loads(line))
        print(f"began {process}", flush=True)  # noqa: T201 the test reads it
        _, status = os.waitpid(process, 0)
        print(f"ended {process} {os.waitstatus_to_exitcode(status)}", flush=True)  # noqa: T201


if __name__ == "__main__":
    assert threading.active_count() == 1  # or a fork would not be safe
    main(sys.stdin)
