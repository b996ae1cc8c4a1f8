"""A ROS 2 program with nothing but cyclonedds: its message definitions are written out here.

It writes each message that it hears to its output as a line of JSON: topic, fields, and the bytes
as it encodes them itself. Lines of its input are what it publishes or asks.
"""

import dataclasses
import json
import queue
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as t
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

array: Any = t.array
sequence: Any = t.sequence


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: t.int32
    nanosec: t.uint32


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: t.int32
    nanosec: t.uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Color(IdlStruct, typename="std_msgs::msg::dds_::ColorRGBA_"):
    r: t.float32
    g: t.float32
    b: t.float32
    a: t.float32


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: t.float64
    y: t.float64
    z: t.float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: t.float64
    y: t.float64
    z: t.float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: t.float64
    y: t.float64
    z: t.float64
    w: t.float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[t.float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[t.float64, 36]


@dataclass
class PoseWithCovarianceStamped(
    IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"
):
    header: Header
    pose: PoseWithCovariance


@dataclass
class PoseArray(IdlStruct, typename="geometry_msgs::msg::dds_::PoseArray_"):
    header: Header
    poses: sequence[Pose]


@dataclass
class Particle(IdlStruct, typename="nav2_msgs::msg::dds_::Particle_"):
    pose: Pose
    weight: t.float64


@dataclass
class ParticleCloud(IdlStruct, typename="nav2_msgs::msg::dds_::ParticleCloud_"):
    header: Header
    particles: sequence[Particle]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: t.float32
    width: t.uint32
    height: t.uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[t.int8]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: t.uint32
    width: t.uint32
    encoding: str
    is_bigendian: t.uint8
    step: t.uint32
    data: sequence[t.uint8]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[t.uint8]


@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: t.uint32
    datatype: t.uint8
    count: t.uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: t.uint32
    width: t.uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: t.uint32
    row_step: t.uint32
    data: sequence[t.uint8]
    is_dense: bool


@dataclass
class PingInfo(IdlStruct, typename="marine_acoustic_msgs::msg::dds_::PingInfo_"):
    frequency: t.float32
    sound_speed: t.float32
    tx_beamwidths: sequence[t.float32]
    rx_beamwidths: sequence[t.float32]


@dataclass
class SonarImageData(IdlStruct, typename="marine_acoustic_msgs::msg::dds_::SonarImageData_"):
    is_bigendian: bool
    dtype: t.uint32
    beam_count: t.uint32
    data: sequence[t.uint8]


@dataclass
class ProjectedSonarImage(
    IdlStruct, typename="marine_acoustic_msgs::msg::dds_::ProjectedSonarImage_"
):
    header: Header
    ping_info: PingInfo
    beam_directions: sequence[Vector3]
    ranges: sequence[t.float32]
    image: SonarImageData


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: t.uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class Log(IdlStruct, typename="rcl_interfaces::msg::dds_::Log_"):
    stamp: Time
    level: t.uint8
    name: str
    msg: str
    file: str
    function: str
    line: t.uint32


@dataclass
class UVCoordinate(IdlStruct, typename="visualization_msgs::msg::dds_::UVCoordinate_"):
    u: t.float32
    v: t.float32


@dataclass
class MeshFile(IdlStruct, typename="visualization_msgs::msg::dds_::MeshFile_"):
    filename: str
    data: sequence[t.uint8]


@dataclass
class Marker(IdlStruct, typename="visualization_msgs::msg::dds_::Marker_"):
    header: Header
    ns: str
    id: t.int32
    type: t.int32
    action: t.int32
    pose: Pose
    scale: Vector3
    color: Color
    lifetime: Duration
    frame_locked: bool
    points: sequence[Point]
    colors: sequence[Color]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool


@dataclass
class MarkerArray(IdlStruct, typename="visualization_msgs::msg::dds_::MarkerArray_"):
    markers: sequence[Marker]


@dataclass
class EmptyRequest(IdlStruct, typename="std_srvs::srv::dds_::Empty_Request_"):
    guid: t.uint64
    seq: t.int64
    structure_needs_at_least_one_member: t.uint8


@dataclass
class EmptyResponse(IdlStruct, typename="std_srvs::srv::dds_::Empty_Response_"):
    guid: t.uint64
    seq: t.int64
    structure_needs_at_least_one_member: t.uint8


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: t.uint64
    seq: t.int64
    structure_needs_at_least_one_member: t.uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: t.uint64
    seq: t.int64
    success: bool
    message: str


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: t.uint8
    bool_value: bool = False
    integer_value: t.int64 = 0
    double_value: t.float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[t.uint8] = dataclasses.field(default_factory=list)
    bool_array_value: sequence[bool] = dataclasses.field(default_factory=list)
    integer_array_value: sequence[t.int64] = dataclasses.field(default_factory=list)
    double_array_value: sequence[t.float64] = dataclasses.field(default_factory=list)
    string_array_value: sequence[str] = dataclasses.field(default_factory=list)


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class GetParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    guid: t.uint64
    seq: t.int64
    names: sequence[str]


@dataclass
class GetParametersResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"
):
    guid: t.uint64
    seq: t.int64
    values: sequence[ParameterValue]


@dataclass
class SetParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    guid: t.uint64
    seq: t.int64
    parameters: sequence[Parameter]


@dataclass
class SetParametersResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"
):
    guid: t.uint64
    seq: t.int64
    results: sequence[SetParametersResult]


@dataclass
class GetParameterTypesRequest(
    IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameterTypes_Request_"
):
    guid: t.uint64
    seq: t.int64
    names: sequence[str]


@dataclass
class GetParameterTypesResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameterTypes_Response_"
):
    guid: t.uint64
    seq: t.int64
    types: sequence[t.uint8]


@dataclass
class FloatingPointRange(IdlStruct, typename="rcl_interfaces::msg::dds_::FloatingPointRange_"):
    from_value: t.float64
    to_value: t.float64
    step: t.float64


@dataclass
class IntegerRange(IdlStruct, typename="rcl_interfaces::msg::dds_::IntegerRange_"):
    from_value: t.int64
    to_value: t.int64
    step: t.uint64


@dataclass
class ParameterDescriptor(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterDescriptor_"):
    name: str
    type: t.uint8
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    floating_point_range: sequence[FloatingPointRange]
    integer_range: sequence[IntegerRange]


@dataclass
class DescribeParametersRequest(
    IdlStruct, typename="rcl_interfaces::srv::dds_::DescribeParameters_Request_"
):
    guid: t.uint64
    seq: t.int64
    names: sequence[str]


@dataclass
class DescribeParametersResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::DescribeParameters_Response_"
):
    guid: t.uint64
    seq: t.int64
    descriptors: sequence[ParameterDescriptor]


@dataclass
class ListParametersRequest(
    IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Request_"
):
    guid: t.uint64
    seq: t.int64
    prefixes: sequence[str]
    depth: t.uint64


@dataclass
class ListParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::ListParametersResult_"):
    names: sequence[str]
    prefixes: sequence[str]


@dataclass
class ListParametersResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Response_"
):
    guid: t.uint64
    seq: t.int64
    result: ListParametersResult


@dataclass
class SetParametersAtomicallyRequest(
    IdlStruct, typename="rcl_interfaces::srv::dds_::SetParametersAtomically_Request_"
):
    guid: t.uint64
    seq: t.int64
    parameters: sequence[Parameter]


@dataclass
class SetParametersAtomicallyResponse(
    IdlStruct, typename="rcl_interfaces::srv::dds_::SetParametersAtomically_Response_"
):
    guid: t.uint64
    seq: t.int64
    result: SetParametersResult


@dataclass
class LoadMapRequest(IdlStruct, typename="nav2_msgs::srv::dds_::LoadMap_Request_"):
    guid: t.uint64
    seq: t.int64
    map_url: str


@dataclass
class LoadMapResponse(IdlStruct, typename="nav2_msgs::srv::dds_::LoadMap_Response_"):
    guid: t.uint64
    seq: t.int64
    map: OccupancyGrid
    result: t.uint8


@dataclass
class SaveMapRequest(IdlStruct, typename="nav2_msgs::srv::dds_::SaveMap_Request_"):
    guid: t.uint64
    seq: t.int64
    map_topic: str
    map_url: str
    image_format: str
    map_mode: str
    free_thresh: t.float32
    occupied_thresh: t.float32


@dataclass
class SaveMapResponse(IdlStruct, typename="nav2_msgs::srv::dds_::SaveMap_Response_"):
    guid: t.uint64
    seq: t.int64
    result: bool


RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(100))
SENSOR = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5))
USUAL = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(100))

TOPICS: dict[str, tuple[Any, Qos]] = {
    "/tf": (TFMessage, USUAL),
    "/tf_static": (TFMessage, LATCHED),
    "/rov/mapperd/odometry": (Odometry, USUAL),
    "/rov/amcl_pose": (PoseWithCovarianceStamped, LATCHED),
    "/rov/particlecloud": (PoseArray, SENSOR),
    "/rov/particle_cloud": (ParticleCloud, SENSOR),
    "/sensor/sonar/oculus/m750d/image": (Image, USUAL),  # a reliable reader gets it too
    "/rov/mapperd/ping": (ProjectedSonarImage, SENSOR),
    "/rov/mapperd/fan_image": (Image, SENSOR),
    "/rov/mapperd/returns": (PointCloud2, SENSOR),
    "/rov/my_cloud": (PointCloud2, LATCHED),
    "/map": (OccupancyGrid, LATCHED),
    "/sonar_3d_map_markers": (MarkerArray, LATCHED),
    "/diagnostics": (DiagnosticArray, USUAL),
    "/rosout": (Log, LATCHED),
}

SERVICES: dict[str, tuple[Any, Any]] = {
    "/rov/global_localization": (EmptyRequest, EmptyResponse),
    "/rov/reinitialize_global_localization": (EmptyRequest, EmptyResponse),
    "/rov/request_nomotion_update": (EmptyRequest, EmptyResponse),
    "/rov/mapperd/reset": (TriggerRequest, TriggerResponse),
    "/rov/mapperd/snapshot": (TriggerRequest, TriggerResponse),
    "/rov/mapperd/reload": (TriggerRequest, TriggerResponse),
    "/rov/mapperd/load_map": (LoadMapRequest, LoadMapResponse),
    "/rov/mapperd/save_map": (SaveMapRequest, SaveMapResponse),
    "/rov/mapperd/get_parameters": (GetParametersRequest, GetParametersResponse),
    "/rov/mapperd/get_parameter_types": (GetParameterTypesRequest, GetParameterTypesResponse),
    "/rov/mapperd/describe_parameters": (DescribeParametersRequest, DescribeParametersResponse),
    "/rov/mapperd/list_parameters": (ListParametersRequest, ListParametersResponse),
    "/rov/mapperd/set_parameters": (SetParametersRequest, SetParametersResponse),
    "/rov/mapperd/set_parameters_atomically": (
        SetParametersAtomicallyRequest,
        SetParametersAtomicallyResponse,
    ),
}


def plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, bytes | bytearray):
        return list(value)
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


def say(topic: str, sample: Any) -> None:
    line = {"topic": topic, "fields": plain(sample), "cdr": sample.serialize().hex()}
    print(json.dumps(line), flush=True)  # noqa: T201 its output


def initial_pose(x_m: float, y_m: float, z: float, w: float, frame: str) -> Any:
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = 0.25
    covariance[35] = 0.06
    pose = Pose(Point(x_m, y_m, 0.0), Quaternion(0.0, 0.0, z, w))
    return PoseWithCovarianceStamped(
        Header(Time(1, 2), frame), PoseWithCovariance(pose, covariance)
    )


def odometry(x_m: float) -> Any:
    pose = Pose(Point(x_m, 2.0, -3.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    covariance = [float(number == 0) for number in range(36)]
    twist = Twist(Vector3(0.5, 0.0, 0.0), Vector3(0.0, 0.0, 0.1))
    return Odometry(
        Header(Time(10, 500), "odom"),
        "base_link",
        PoseWithCovariance(pose, covariance),
        TwistWithCovariance(twist, [0.0] * 36),
    )


class Peer:
    def __init__(self, domain: int) -> None:
        self.participant = DomainParticipant(domain)
        self.readers = {
            name: DataReader(
                self.participant, Topic(self.participant, f"rt{name}", kind, qos=qos), qos=qos
            )
            for name, (kind, qos) in TOPICS.items()
        }
        self.pose = self.writer("rt/rov/initialpose", PoseWithCovarianceStamped)
        self.odometry = self.writer("rt/slam/odometry", Odometry)
        self.fast_odometry = self.writer("rt/fast/odometry", Odometry, SENSOR)
        self.clients = {
            name: (
                self.writer(f"rq{name}Request", request),
                DataReader(
                    self.participant,
                    Topic(self.participant, f"rr{name}Reply", response, qos=USUAL),
                    qos=USUAL,
                ),
            )
            for name, (request, response) in SERVICES.items()
        }

    def writer(self, name: str, kind: Any, qos: Any = USUAL) -> Any:
        return DataWriter(self.participant, Topic(self.participant, name, kind, qos=qos), qos=qos)

    def do(self, line: str) -> None:
        asked = json.loads(line)
        match asked.pop("do"):
            case "pose":
                self.pose.write(initial_pose(**asked))
            case "flood":
                for number in range(asked["number"]):
                    self.pose.write(initial_pose(float(number), 0.0, 0.0, 1.0, "map"))
            case "odometry":
                self.odometry.write(odometry(**asked))
            case "fast_odometry":
                for number in range(asked["number"]):
                    self.fast_odometry.write(odometry(float(number)))
                    time.sleep(0.0025)
            case "call":
                name = asked.pop("name")
                if "parameters" in asked:
                    asked["parameters"] = [
                        Parameter(one["name"], ParameterValue(**one["value"]))
                        for one in asked["parameters"]
                    ]
                kind = SERVICES[name][0]
                self.clients[name][0].write(kind(guid=77, **asked))

    def listen(self) -> None:
        for name, reader in self.readers.items():
            for sample in reader.take(100):
                if isinstance(sample, IdlStruct):  # else a note that a writer went away
                    say(name, sample)
        for name, (_, reader) in self.clients.items():
            for sample in reader.take(100):
                if isinstance(sample, IdlStruct):  # else a note that a writer went away
                    say(name, sample)


def main() -> None:
    peer = Peer(int(sys.argv[1]))
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put("end")

    threading.Thread(target=read, daemon=True).start()
    while True:
        peer.listen()
        while not lines.empty():
            line = lines.get()
            if line.strip() == "end":
                return
            peer.do(line)
        time.sleep(0.01)


if __name__ == "__main__":
    main()
