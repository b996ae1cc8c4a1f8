"""The daemon's sockets for those who steer it: docs/control.md."""
