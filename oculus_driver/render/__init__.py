"""Pings as pictures. Needs OpenCV: the extra `render`."""

from oculus_driver.render.fan import Fan, fan_of
from oculus_driver.render.painter import COLOURS, Painter, Style, laid_out

__all__ = ["COLOURS", "Fan", "Painter", "Style", "fan_of", "laid_out"]
