"""Why a daemon's map stream does not have us, as an exit code."""

from mapperd.cli.mapperctl.errors import CtlError, Exit
from mapperd.wire.framing import StreamError

__all__ = ["refused"]

NO_PERMISSION = frozenset({"wrong_token", "needs_token", "no_permission", "not_trusted"})


def refused(error: StreamError) -> CtlError:
    """What the command says, and ends with."""
    code = Exit.NO_PERMISSION if error.reason in NO_PERMISSION else Exit.PROTOCOL
    return CtlError(str(error), code)
