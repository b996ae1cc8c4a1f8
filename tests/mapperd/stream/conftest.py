"""Folders and certificates, as the tests of the control socket have them."""

from tests.mapperd.control.conftest import authority, short, tls

__all__ = ["authority", "short", "tls"]
