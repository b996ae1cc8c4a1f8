"""Recordings: received bytes with arrival times, in files that survive a crash."""

from oculus_driver.recording.background_log import BackgroundLog
from oculus_driver.recording.chunk import (
    OCULUS,
    OCULUS_STATUS,
    ODOMETRY_NATIVE,
    Chunk,
    DamagedPart,
)
from oculus_driver.recording.convert import WRITABLE, Conversion, convert
from oculus_driver.recording.info import PingInfo, RecordingInfo, describe
from oculus_driver.recording.log_files import LogPolicy
from oculus_driver.recording.network_capture import Datagram, read_datagrams
from oculus_driver.recording.recording import (
    MCAP,
    OCULUS_LOG,
    OCULUS_RAW,
    PCAP,
    PCAPNG,
    VIEWPOINT_LOG,
    Recording,
    open_recording,
)
from oculus_driver.recording.sonar_log import LogCounters, LogPosition, SonarLog
from oculus_driver.recording.writer import RecordingWriter

__all__ = [
    "MCAP",
    "OCULUS",
    "OCULUS_LOG",
    "OCULUS_RAW",
    "OCULUS_STATUS",
    "ODOMETRY_NATIVE",
    "PCAP",
    "PCAPNG",
    "VIEWPOINT_LOG",
    "WRITABLE",
    "BackgroundLog",
    "Chunk",
    "Conversion",
    "DamagedPart",
    "Datagram",
    "LogCounters",
    "LogPolicy",
    "LogPosition",
    "PingInfo",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "SonarLog",
    "convert",
    "describe",
    "open_recording",
    "read_datagrams",
]
