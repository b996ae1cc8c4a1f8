"""The camera's calibration, in the fields that ROS gives it (sensor_msgs/CameraInfo)."""

from typing import Any

from sonar_sim.raycast.depth_camera import Pinhole


def camera_info(camera: Pinhole, frame_id: str = "sonar_optical") -> dict[str, Any]:
    """Intrinsics of a camera without distortion, axes x right, y down, z ahead."""
    focal = camera.focal_px
    across, down = camera.centre_px
    return {
        "header": {"frame_id": frame_id},
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": [focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
