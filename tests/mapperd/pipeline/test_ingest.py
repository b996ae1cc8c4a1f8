import threading
from typing import Any

from mapperd.pipeline.ingest import MAX_FRAMED_BYTES, SONAR, ChunkQueue, Ingest, Received
from mapperd.session_log import Decision, Drop, Gap, Reset, Skip, decision_of
from oculus_driver.recording import Chunk
from oculus_driver.stream import Framing, MessageBounds

T0 = 5


class Recorded:
    """Remembers what a recorder gets."""

    def __init__(self) -> None:
        self.seen: list[bytes | Decision] = []
        self.gaps: list[bool] = []
        self.bounds: list[MessageBounds | None] = []

    @property
    def newest(self) -> int:
        return len(self.seen)

    def record(self, chunk: Chunk, *, gap: bool, bounds: MessageBounds | None = None) -> int:
        self.seen.append(decision_of(chunk) or chunk.data)
        self.gaps.append(gap)
        self.bounds.append(bounds)
        return self.newest


def ingest_with(max_bytes: int) -> tuple[Ingest, Recorded, ChunkQueue]:
    recorded, queue = Recorded(), ChunkQueue(max_bytes)
    recorder: Any = recorded
    return Ingest(recorder, queue, {"vehicle": "odometry-native"}, lambda: T0), recorded, queue


def taken(queue: ChunkQueue) -> list[bytes | Decision]:
    return [decision_of(one.chunk) or one.chunk.data for one in queue.take(0) or []]


def framing_of(begin: int = 0) -> Framing:
    return Framing((), MessageBounds(0, 400), begin, synchronised=True, source_id=None)


def test_recorder_and_mapper_get_the_same_in_one_order() -> None:
    ingest, recorded, queue = ingest_with(1 << 20)
    ingest.receive(SONAR, b"a", 1, gap=False)
    ingest.order(Reset(1))
    ingest.receive("vehicle", b"b", 2, gap=True)
    assert recorded.seen == [b"a", Reset(1), Gap("vehicle"), b"b"]
    assert recorded.gaps == [False, False, False, True]
    assert taken(queue) == recorded.seen


def test_the_recorder_gets_the_message_boundaries() -> None:
    ingest, recorded, _ = ingest_with(1024)
    for data in (b"a" * 600, b"b" * 600):  # the second has no room in the queue
        ingest.receive(SONAR, data, 1, framing_of(), gap=False)
    assert recorded.bounds == [MessageBounds(0, 400), None, MessageBounds(0, 400)]


def test_remark_is_for_the_recorder_alone() -> None:
    ingest, recorded, queue = ingest_with(1 << 20)
    ingest.remark(Drop(3))
    assert (recorded.seen, taken(queue)) == ([Drop(3)], [])


def test_empty_bytes_are_nothing_but_their_gap_counts() -> None:
    ingest, recorded, queue = ingest_with(1 << 20)
    ingest.receive(SONAR, b"", 1, gap=True)
    assert recorded.seen == taken(queue) == [Gap(SONAR)]


def test_what_has_no_room_is_recorded_with_a_note_before_it() -> None:
    ingest, recorded, queue = ingest_with(1024)
    for data in (b"a" * 600, b"b" * 600, b"c" * 700):
        ingest.receive(SONAR, data, 1, gap=False)
    skips = [Skip(SONAR, 600), Skip(SONAR, 700)]
    assert recorded.seen == [b"a" * 600, skips[0], b"b" * 600, skips[1], b"c" * 700]
    assert (queue.chunks_refused, queue.bytes_refused) == (2, 1300)
    assert taken(queue) == [b"a" * 600]
    ingest.receive("vehicle", b"d", 2, gap=False)
    assert taken(queue) == [Skip(SONAR, 1300), b"d"]  # in one, however many there were
    assert recorded.seen[5:] == [b"d"]


def test_order_comes_through_a_full_queue() -> None:
    ingest, _, queue = ingest_with(512)
    ingest.receive(SONAR, b"a", 1, gap=False)
    ingest.receive(SONAR, b"b", 1, gap=False)
    ingest.order(Reset(1))
    assert taken(queue) == [b"a", Skip(SONAR, 1), Reset(1)]


def test_queue_that_is_closed_gives_what_is_left_then_ends() -> None:
    queue = ChunkQueue()
    queue.put(Chunk(SONAR, "oculus", 0, b"a"))
    queue.close()
    assert len(queue.take(None) or []) == 1
    assert queue.take(None) is None


def test_reader_that_waits_is_woken() -> None:
    queue = ChunkQueue()
    got: list[list[Received] | None] = []
    reader = threading.Thread(target=lambda: got.append(queue.take(None)))
    reader.start()
    queue.put(Chunk(SONAR, "oculus", 0, b"a"))
    reader.join(60)
    assert [len(chunks or []) for chunks in got] == [1]
    assert queue.waiting_bytes == 0


def test_the_mapper_gets_the_drivers_messages_unless_much_waits() -> None:
    ingest, _, queue = ingest_with(4 * MAX_FRAMED_BYTES)
    data = bytes(MAX_FRAMED_BYTES // 2 + 1)
    for k in range(3):
        ingest.receive(SONAR, data, k, framing_of(k), gap=False)
    assert [one.framing for one in queue.take(0) or []] == [framing_of(0), framing_of(1), None]
    ingest.receive(SONAR, data, 3, framing_of(3), gap=False)
    assert [one.framing for one in queue.take(0) or []] == [framing_of(3)]
