"""The published image-sonar plugin's own pipeline, kept for comparison, defects and all.

From uuvsimulator/uuv_simulator, `gazebo_ros_image_sonar.cpp` of 2020: depth image, "normals",
"SNR", plan view, colours. Nothing here is how sound behaves: `docs/reports/simulator-classic.md`.
"""

from sonar_sim.classic.pipeline import ClassicImages, classic_camera, classic_images

__all__ = ["ClassicImages", "classic_camera", "classic_images"]
