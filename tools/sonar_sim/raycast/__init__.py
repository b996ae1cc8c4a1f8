"""Rays of the sonar and of a depth camera, cast into a scene."""
