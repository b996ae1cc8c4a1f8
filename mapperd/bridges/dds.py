"""ROS 2 topics and services over DDS, without ROS.

Names and types on the wire are those of ROS 2: topic `/tf` is `rt/tf` of type
`tf2_msgs::msg::dds_::TFMessage_`, a service has the topics `rq/...Request` and `rr/...Reply`.
Services carry the header of rmw_cyclonedds in their data (the client's id and a number), so that
only clients of that middleware understand them; topics are understood by all.

Messages are those of rosbags, which encodes them; cyclonedds carries the bytes. Both belong to
the extra `ros2`.
"""

import contextlib
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Final, Literal

import numpy as np
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mapperd.errors import LiveError

__all__ = [
    "DdsNode",
    "DdsPublisher",
    "DdsService",
    "DdsSubscriber",
    "Profile",
    "RosTypes",
    "full_name",
]

Floats = NDArray[np.float64]

BASES: Final[dict[str, Any]] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "string": str,
    **{
        name: getattr(types, name)
        for name in (
            *("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
            *("float32", "float64"),
        )
    },
}

MARINE = {
    "marine_acoustic_msgs/msg/PingInfo": (
        "float32 frequency\nfloat32 sound_speed\nfloat32[] tx_beamwidths\nfloat32[] rx_beamwidths"
    ),
    "marine_acoustic_msgs/msg/SonarImageData": (
        "bool is_bigendian\nuint32 dtype\nuint32 beam_count\nuint8[] data"
    ),
    "marine_acoustic_msgs/msg/ProjectedSonarImage": (
        "std_msgs/Header header\nmarine_acoustic_msgs/PingInfo ping_info\n"
        "geometry_msgs/Vector3[] beam_directions\nfloat32[] ranges\n"
        "marine_acoustic_msgs/SonarImageData image"
    ),
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight",
    "nav2_msgs/msg/ParticleCloud": "std_msgs/Header header\nnav2_msgs/Particle[] particles",
}
"""Messages of other packages, by the fields of their definitions."""

EMPTY = "uint8 structure_needs_at_least_one_member"
NAMES = "string[] names"
SERVICES = {
    "std_srvs/Empty": (EMPTY, EMPTY),
    "std_srvs/Trigger": (EMPTY, "bool success\nstring message"),
    "nav2_msgs/LoadMap": ("string map_url", "nav_msgs/OccupancyGrid map\nuint8 result"),
    "nav2_msgs/SaveMap": (
        (
            "string map_topic\nstring map_url\nstring image_format\nstring map_mode\n"
            "float32 free_thresh\nfloat32 occupied_thresh"
        ),
        "bool result",
    ),
    "rcl_interfaces/GetParameters": (NAMES, "rcl_interfaces/ParameterValue[] values"),
    "rcl_interfaces/GetParameterTypes": (NAMES, "uint8[] types"),
    "rcl_interfaces/DescribeParameters": (
        NAMES,
        "rcl_interfaces/ParameterDescriptor[] descriptors",
    ),
    "rcl_interfaces/ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "rcl_interfaces/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult result",
    ),
}
"""Fields of request and response by the name of the service's type."""

CALL_HEADER = "uint64 guid\nint64 seq\n"

CDR_HEADER, DOUBLE = 4, 8
COUNT = struct.Struct("<I")
"""Of the elements of a sequence."""


class RosTypes:
    """Message classes, their encoding, and their types in DDS.

    Attributes:
        classes: by name, as `Messages` of `mapperd.export.rosbag` has them.
    """

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        texts = dict(MARINE)
        for name, (request, response) in SERVICES.items():
            package, _, short = name.partition("/")
            texts[f"{package}/msg/{short}_Request"] = CALL_HEADER + request
            texts[f"{package}/msg/{short}_Response"] = CALL_HEADER + response
        for name, text in texts.items():
            self._store.register(get_types_from_msg(text, name))
        self._made: dict[str, Any] = {}
        self.classes: dict[str, Any] = dict(self._store.types)

    def encoded(
        self,
        message: Any,  # noqa: ANN401 made at run time
        rows: Floats | None = None,
    ) -> bytes:
        """Return the message as CDR, little endian, with its header of four bytes.

        Args:
            message: with classes of `classes`.
            rows: (N, n), the elements of its last field, a sequence that is empty in the message;
                each element consists of n doubles. Much faster than N objects.
        """
        cdr = bytes(self._store.serialize_cdr(message, message.__msgtype__))
        if rows is None or not len(rows):
            return cdr
        body = cdr[: -COUNT.size] + COUNT.pack(len(rows))
        padding = bytes(-(len(cdr) - CDR_HEADER) % DOUBLE)
        return body + padding + np.ascontiguousarray(rows, "<f8").tobytes()

    def decoded(self, data: bytes, name: str) -> Any:  # noqa: ANN401 as above
        """Return the message of CDR with its header.

        Raises:
            ValueError: the bytes are not of this type.
        """
        try:
            return self._store.deserialize_cdr(data, name)
        except Exception as error:  # the errors of generated code are of many kinds
            raise ValueError(f"not a {name}: {error}") from error

    def hash_of(self, name: str) -> str:
        """Return the hash of a type, by which newer ROS compares types."""
        return str(self._store.hash_rihs01(name))

    def topic_type(self, name: str) -> Any:  # noqa: ANN401 as above
        """Return the type of a topic in DDS, whose samples are bytes: `_Sample`."""
        package, _, short = name.split("/")
        kind = "srv" if short.endswith(("_Request", "_Response")) else "msg"
        made = make_idl_struct(
            f"{package}_{short}", f"{package}::{kind}::dds_::{short}_", self._fields(name)
        )
        setattr(made, "serialize", _serialized)  # noqa: B010 replaces a method
        setattr(made, "deserialize", classmethod(_sample))  # noqa: B010 as above
        return made

    def _idl(self, name: str) -> Any:  # noqa: ANN401 as above
        if name not in self._made:
            package, kind, short = name.split("/")
            self._made[name] = make_idl_struct(
                f"{package}_{short}", f"{package}::{kind}::dds_::{short}_", self._fields(name)
            )
        return self._made[name]

    def _fields(self, name: str) -> dict[str, Any]:
        return {field: self._field(*node) for field, node in self._store.fielddefs[name][1]}

    def _field(self, kind: Nodetype, what: Any) -> Any:  # noqa: ANN401 as above
        if kind == Nodetype.BASE:
            return BASES[what[0]]
        if kind == Nodetype.NAME:
            return self._idl(what)
        (inner_kind, inner), length = what
        of = self._field(inner_kind, inner)
        made: Any = types
        return made.array[of, length] if kind == Nodetype.ARRAY else made.sequence[of]


def _serialized(self: Any, *_: object, **__: object) -> bytes:  # noqa: ANN401 a sample
    data: bytes = self.cdr
    return data


def _sample(kind: Any, /, cdr: bytes, **_: object) -> Any:  # noqa: ANN401 a type of a topic
    sample = object.__new__(kind)
    sample.cdr = cdr
    return sample


Profile = Literal["default", "latched", "sensor", "stream", "tf", "log"]

BLOCKING_MS = 10
"""A reader that does not keep up delays a message by this time at most; then it is dropped."""

DEPTHS: dict[Profile, int] = {
    "default": 10,
    "latched": 1,
    "sensor": 5,
    "stream": 200,
    "tf": 100,
    "log": 1000,
}
LATCHED = ("latched", "log")
BEST_EFFORT = ("sensor", "stream")
"""Profiles whose readers match every writer."""

CDR_1 = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)


def _qos(profile: Profile, type_hash: str, *, reader: bool = False) -> Qos:
    """Return the QoS of a profile.

    Writers are always reliable, so that reliable readers get the topic as well. Maps and static
    transforms are transient local, as in Nav2 and tf2.
    """
    best_effort = reader and profile in BEST_EFFORT
    durable = Policy.Durability.TransientLocal
    return Qos(
        Policy.Reliability.BestEffort
        if best_effort
        else Policy.Reliability.Reliable(duration(milliseconds=BLOCKING_MS)),
        durable if profile in LATCHED else Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTHS[profile]),
        Policy.IgnoreLocal.Participant,
        Policy.Userdata(f"typehash={type_hash};".encode()),
        CDR_1,
    )


def full_name(namespace: str, name: str) -> str:
    """Return the absolute name of a topic or service; one without a leading / is relative."""
    parts = [name] if name.startswith("/") else [namespace, name]
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))


class DdsErrors:
    """Counts the errors of DDS while it runs; the bridge goes on with the next message.

    The first of a kind is a line, of whichever topic, then the 10th, the 100th and so on.

    Args:
        report: takes the lines.

    Attributes:
        counts: errors by the name of the topic or service, and the code of DDS.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self.counts: Counter[tuple[str, int]] = Counter()
        self._report = report
        self._slow: set[str] = set()

    def dropped(self, name: str) -> None:
        """Report once that readers of a topic do not keep up."""
        if name not in self._slow:
            self._slow.add(name)
            self._report(f"ROS 2: a subscriber of {name} does not keep up")

    @contextlib.contextmanager
    def counted(self, name: str) -> Iterator[None]:
        """Count an error of the topic or service instead of raising it."""
        try:
            yield
        except DDSException as error:
            self.counts[name, error.code] += 1
            count = sum(number for (_, code), number in self.counts.items() if code == error.code)
            if str(count).rstrip("0") == "1":
                times = f"; {count} errors of this kind" if count > 1 else ""
                self._report(f"ROS 2: {name}: {_reason(error)}{times}")


def _reason(error: DDSException) -> str:
    _, text = error.error_message_mapping.get(error.code, ("", f"error {error.code} of DDS"))
    return str(text)


@contextlib.contextmanager
def _opening(name: str) -> Iterator[None]:
    try:
        yield
    except DDSException as error:
        raise LiveError(f"ROS 2: {name} cannot be opened: {_reason(error)}") from error


class DdsPublisher:
    """A topic that is published.

    Attributes:
        name: absolute.
    """

    def __init__(self, node: "DdsNode", name: str, kind: str, profile: Profile) -> None:
        self.name = name
        self._types = node.types
        self._sample_type = node.types.topic_type(kind)
        self._errors = node.errors
        qos = _qos(profile, node.types.hash_of(kind))
        with _opening(name):
            topic = Topic(node.participant, f"rt{name}", self._sample_type, qos=qos)
            self._writer = DataWriter(node.participant, topic, qos=qos)

    @property
    def readers(self) -> int:
        """Number of readers that match."""
        with self._errors.counted(self.name):
            return len(self._writer.get_matched_subscriptions())
        return 0

    def publish(
        self,
        message: Any,  # noqa: ANN401 of rosbags
        rows: Floats | None = None,
    ) -> bool:
        """Send a message; return False if readers do not keep up, or DDS refuses it.

        Args:
            message: of the topic's type.
            rows: elements of its last field, as in `RosTypes.encoded`.
        """
        sample = _sample(self._sample_type, self._types.encoded(message, rows))
        with self._errors.counted(self.name):
            if _written(self._writer, sample):
                return True
            self._errors.dropped(self.name)
        return False


def _written(writer: Any, sample: Any) -> bool:  # noqa: ANN401 of cyclonedds
    """Write; return False if readers do not keep up."""
    try:
        writer.write(sample)
    except DDSException as error:
        if error.code != DDSException.DDS_RETCODE_TIMEOUT:
            raise
        return False
    return True


class DdsSubscriber:
    """A topic that is subscribed.

    Attributes:
        name: absolute.
        invalid: messages that are not of its type.
    """

    def __init__(self, node: "DdsNode", name: str, kind: str, profile: Profile) -> None:
        self.name = name
        self.invalid = 0
        self._types, self._kind = node.types, kind
        sample_type = node.types.topic_type(kind)
        self._errors = node.errors
        qos = _qos(profile, node.types.hash_of(kind), reader=True)
        with _opening(name):
            topic = Topic(node.participant, f"rt{name}", sample_type, qos=qos)
            self._reader = DataReader(node.participant, topic, qos=qos)

    @property
    def writers(self) -> int:
        """Number of writers that match."""
        with self._errors.counted(self.name):
            return len(self._reader.get_matched_publications())
        return 0

    def take(self, most: int) -> Iterator[Any]:
        """Yield at most so many messages that have arrived."""
        for cdr in _taken(self._reader, most, self._errors, self.name):
            try:
                yield self._types.decoded(cdr, self._kind)
            except ValueError:
                self.invalid += 1


def _taken(reader: Any, most: int, errors: DdsErrors, name: str) -> list[bytes]:  # noqa: ANN401
    """Return the messages that have arrived, without notes that a writer went away."""
    samples: list[Any] = []
    with errors.counted(name):
        samples = reader.take(most)
    return [sample.cdr for sample in samples if getattr(sample, "cdr", None) is not None]


class DdsService:
    """A service that is offered to clients of rmw_cyclonedds.

    Attributes:
        name: absolute.
    """

    def __init__(self, node: "DdsNode", name: str, kind: str) -> None:
        self.name = name
        package, _, short = kind.partition("/")
        self._types = node.types
        self._request = f"{package}/msg/{short}_Request"
        self._response = f"{package}/msg/{short}_Response"
        request = node.types.topic_type(self._request)
        self._response_type = node.types.topic_type(self._response)
        qos = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=BLOCKING_MS)),
            Policy.Durability.Volatile,
            Policy.History.KeepLast(DEPTHS["default"]),
            CDR_1,
        )
        self._errors = node.errors
        with _opening(name):
            asked = Topic(node.participant, f"rq{name}Request", request, qos=qos)
            answered = Topic(node.participant, f"rr{name}Reply", self._response_type, qos=qos)
            self._reader = DataReader(node.participant, asked, qos=qos)
            self._writer = DataWriter(node.participant, answered, qos=qos)

    def take(self, most: int) -> Iterator[Any]:
        """Yield at most so many requests that have arrived.

        They have `guid` and `seq` before their own fields.
        """
        for cdr in _taken(self._reader, most, self._errors, self.name):
            try:
                yield self._types.decoded(cdr, self._request)
            except ValueError:
                continue

    def answer(self, request: Any, **fields: object) -> None:  # noqa: ANN401 of `take`
        """Answer a request with the fields of the response."""
        response = self._types.classes[self._response](
            guid=request.guid,
            seq=request.seq,
            **fields,
        )
        sample = _sample(self._response_type, self._types.encoded(response))
        with self._errors.counted(self.name):
            _written(self._writer, sample)


class DdsNode:
    """A participant in one domain; its topics and services live as long as it does.

    Args:
        domain: number of the domain.
        namespace: of relative names.
        report: takes a line for errors of DDS.
        remap: other names, as of `ros2.remap`.

    Raises:
        LiveError: DDS cannot start in this domain.

    Attributes:
        types: messages.
        errors: of all topics and services.
        participant: of cyclonedds.
    """

    def __init__(
        self,
        domain: int,
        namespace: str,
        report: Callable[[str], None] = lambda _: None,
        remap: str = "",
    ) -> None:
        self.types = RosTypes()
        self.errors = DdsErrors(report)
        self._namespace = namespace
        rules = (rule.split(":=") for rule in remap.split())
        self._names = {
            full_name(namespace, before): full_name(namespace, after) for before, after in rules
        }
        try:
            self.participant = DomainParticipant(domain)
        except DDSException as error:
            raise LiveError(
                f"DDS cannot start in domain {domain}: {error}; check CYCLONEDDS_URI and the "
                "network interfaces"
            ) from error

    def close(self) -> None:
        """Leave the domain; topics and services end."""
        self.participant.__del__()

    def publisher(self, name: str, kind: str, profile: Profile = "default") -> DdsPublisher:
        """Publish a topic, of a message type such as `nav_msgs/msg/Odometry`.

        Raises:
            LiveError: DDS refuses it.
        """
        return DdsPublisher(self, self._name(name), kind, profile)

    def subscriber(self, name: str, kind: str, profile: Profile = "default") -> DdsSubscriber:
        """Subscribe to a topic."""
        return DdsSubscriber(self, self._name(name), kind, profile)

    def service(self, name: str, kind: str) -> DdsService:
        """Offer a service, of a type such as `std_srvs/Empty`."""
        return DdsService(self, self._name(name), kind)

    def _name(self, name: str) -> str:
        absolute = full_name(self._namespace, name)
        return self._names.get(absolute, absolute)
