"""Measured tables stand in the pages between two marks that name the program."""

from pathlib import Path

END = "<!-- end of measured -->"


def put_into(page: Path, program: str, text: str) -> None:
    """Replace what stands between a program's marks.

    Raises:
        ValueError: the page has not both marks, in order.
    """
    mark = f"<!-- measured: written by {program}, do not edit -->"
    before, begin, rest = page.read_text(encoding="utf-8").partition(mark)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page} has no section to write into: {mark} ... {END}")
    page.write_text(f"{before}{mark}\n\n{text}\n\n{END}{after}", encoding="utf-8")
