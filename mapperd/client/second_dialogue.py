"""What a client hears and says on a second line, beside its first connection."""

from mapperd.client.line import Line
from mapperd.client.state import Knowledge
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import VERSION, Blocks, FromServer, Hello, Status, Welcome

__all__ = ["SecondDialogue"]


class SecondDialogue(Line):
    """One second line, from its greeting to its end.

    Args:
        name: of the program, for people.
        knowledge: of the first connection, which is welcome and has a ticket; takes the blocks.
        token: that the daemon may ask for.
    """

    def __init__(self, name: str, knowledge: Knowledge, token: bytes | None) -> None:
        super().__init__(token)
        self._name = name
        self._knowledge = knowledge

    def end(self) -> None:
        """Nothing more is heard."""
        self.is_welcome = False
        self._knowledge.end_beside()

    def _hello(self, proof: str) -> Hello:
        # Not with the welcome: what the daemon says after this may be stuck, and be overtaken.
        self._knowledge.begin_beside()
        return Hello(version=VERSION, proof=proof, name=self._name, beside=self._knowledge.ticket)

    def _begin(self, welcome: Welcome) -> None:
        if not (welcome.resumed and self._knowledge.is_of_this(welcome)):
            raise StreamError("a second line of another connection", "bad_order")

    def _take_news(self, message: FromServer) -> None:
        if isinstance(message, Blocks):
            self._knowledge.take_beside(message)
        elif not isinstance(message, Status):
            what = f"a {type(message).__name__.lower()} on a second line"
            raise StreamError(what, "bad_order")
