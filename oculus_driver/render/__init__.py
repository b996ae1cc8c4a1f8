"""Pings as images. Needs OpenCV: the extra `render`."""

from oculus_driver.fan import FanGeometry, fit_fan
from oculus_driver.render.painter import COLOURS, Painter, Style, warp_to_fan

__all__ = ["COLOURS", "FanGeometry", "Painter", "Style", "fit_fan", "warp_to_fan"]
