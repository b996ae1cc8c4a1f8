"""Recordings: bytes as they came, with arrival stamps, in files that survive a kill."""

from oculus_driver.recording.chunk import OCULUS, ODOMETRY_NATIVE, Chunk
from oculus_driver.recording.recording import MCAP, OCULUS_RAW, Recording, open_recording
from oculus_driver.recording.writer import RecordingWriter

__all__ = [
    "MCAP",
    "OCULUS",
    "OCULUS_RAW",
    "ODOMETRY_NATIVE",
    "Chunk",
    "Recording",
    "RecordingWriter",
    "open_recording",
]
