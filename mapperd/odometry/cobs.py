"""Consistent overhead byte stuffing: bytes without zeros, so that a zero can end a frame.

S. Cheshire and M. Baker, "Consistent overhead byte stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

__all__ = ["cobs_decoded", "cobs_encoded"]

_RUN = 254  # bytes between two code bytes, at most


def cobs_encoded(data: bytes) -> bytes:
    """The data without zero bytes, at most one byte in 254 and one longer; no delimiter."""
    out = bytearray()
    pieces = data.split(b"\0")
    for place, piece in enumerate(pieces):
        start = 0
        while len(piece) - start >= _RUN:
            out.append(_RUN + 1)
            out += piece[start : start + _RUN]
            start += _RUN
        # A full run that ends the data needs no more; anywhere else, a zero follows.
        if start < len(piece) or not start or place < len(pieces) - 1:
            out.append(len(piece) - start + 1)
            out += piece[start:]
    return bytes(out)


def cobs_decoded(stuffed: bytes) -> bytes | None:
    """What was encoded, or None where these bytes are no such encoding.

    Args:
        stuffed: what stood between two delimiters.
    """
    if not stuffed or 0 in stuffed:
        return None
    parts = []
    place, size = 0, len(stuffed)
    while place < size:
        code = stuffed[place]
        end = place + code
        if end > size:
            return None
        parts.append(stuffed[place + 1 : end])
        if code <= _RUN and end < size:
            parts.append(b"\0")
        place = end
    return b"".join(parts)
