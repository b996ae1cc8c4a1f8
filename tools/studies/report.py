"""The report writer: measured sections in the documentation, their tables, and the machine.

A page holds a section between two comments: `<!-- NAME: begin, written by COMMAND -->` and
`<!-- NAME: end -->`. Only the text between them is generated.
"""

import os
import platform
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

__all__ = ["IMAGES", "PAGES", "ROOT", "cpu_model", "machine", "section", "table", "write_section"]

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs/images"

PAGES = {
    "accuracy-cost": ROOT / "docs/reports/accuracy-cost.md",
    "map-stream": ROOT / "docs/reports/map-stream.md",
    "mapping": ROOT / "docs/reports/mapping.md",
    "mutations": ROOT / "docs/reports/mutations.md",
    "numerical-stability": ROOT / "docs/reports/numerical-stability.md",
    "odometry": ROOT / "docs/reports/odometry.md",
    "performance": ROOT / "docs/reports/performance.md",
    "simulator": ROOT / "docs/reports/simulator.md",
    "simulator-effects": ROOT / "docs/reference/simulator-effects.md",
}
"""Pages that hold measured sections."""


def section(page: str, name: str, text: str, command: str | None = None) -> str:
    """Replace the section of a page, given as text.

    Args:
        page: Markdown.
        name: name of the section.
        text: Markdown that goes between the comments.
        command: command that writes the section; None keeps the one on the page.

    Raises:
        ValueError: the page does not have exactly one such section.
    """
    pattern = rf"(<!-- {re.escape(name)}: begin)([^\n]*)-->\n.*?(<!-- {re.escape(name)}: end -->)"

    def replace(found: re.Match[str]) -> str:
        by = found[2] if command is None else f", written by {command} "
        return f"{found[1]}{by}-->\n\n{text.strip()}\n\n{found[3]}"

    replaced, count = re.subn(pattern, replace, page, flags=re.DOTALL)
    if count != 1:
        raise ValueError(f"the page has no section to write into: {name}")
    return replaced


def write_section(page: Path, name: str, text: str, command: str | None = None) -> None:
    """Replace the section of a page's file.

    Raises:
        ValueError: the page does not have exactly one such section.
    """
    try:
        replaced = section(page.read_text(encoding="utf-8"), name, text, command)
    except ValueError as error:
        raise ValueError(f"{page}: {error}") from error
    page.write_text(replaced, encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a Markdown table."""
    lines = [f"| {' | '.join(map(str, cells))} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def cpu_model() -> str:
    """Return the model of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def machine() -> str:
    """Describe the processor, the number of cores and the version of Python."""
    return f"{cpu_model()}, {os.cpu_count()} cores, Python {platform.python_version()}"
