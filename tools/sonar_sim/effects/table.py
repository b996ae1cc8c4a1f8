"""The effects as a table for people."""

from sonar_sim.effects.effect import Effect
from sonar_sim.effects.registry import EFFECTS

HEADINGS = ("effect", "what it does", "formula", "source", "computed if", "cost", "parameters")


def effects_markdown() -> str:
    """All effects, a row each, in Markdown."""
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS)]
    lines += [f"| {' | '.join(_cells(effect))} |" for effect in EFFECTS.values()]
    return "\n".join(lines) + "\n"


def _cells(effect: Effect) -> tuple[str, ...]:
    parameters = "; ".join(f"`{p.name}` ({p.unit}): {p.meaning}" for p in effect.parameters)
    cells = (
        f"`{effect.name}`",
        effect.does,
        effect.formula,
        effect.source,
        effect.rule,
        effect.cost.value,
        parameters or "none",
    )
    # A bar inside of a cell would end it.
    return tuple(cell.replace("|", "\\|") for cell in cells)
