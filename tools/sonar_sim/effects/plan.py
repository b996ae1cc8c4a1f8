"""The plan of a ping: which effects are computed, and why."""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from sonar_sim.effects.effect import Effect, RuleResult
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.preview import PingPreview
from sonar_sim.effects.registry import EFFECTS
from sonar_sim.errors import EffectError
from sonar_sim.propagation.physics import Physics

AUTO, ALL = "auto", "all"
HIDING = "shadows"
"""The one effect that saves work where it is computed."""

Choice = str | Mapping[str, bool]
"""See `EffectSelection`."""


class EffectWarning(UserWarning):
    """An effect that the scene calls for is switched off."""


@dataclass(frozen=True, slots=True)
class EffectSelection:
    """The effects that a user requests.

    Attributes:
        ground: "auto" asks the rules, "all" computes everything, "none" nothing.
        forced: effects that are on or off regardless of the ground.
    """

    ground: str
    forced: Mapping[str, bool]

    @classmethod
    def read(cls, choice: Choice) -> "EffectSelection":
        """Read a choice.

        Args:
            choice: "auto", "all" or "none", or names of the effects to compute, with commas
                between them; after a ground, `+name` and `-name` switch one on or off
                ("auto,-noise"). A mapping of names to on or off stands on "auto".

        Raises:
            EffectError: an effect has an unknown name.
        """
        if not isinstance(choice, str):
            return cls(AUTO, {_known(name): bool(on) for name, on in choice.items()})
        words = [word.strip() for word in choice.split(",") if word.strip()]
        ground, forced = "none", {}
        for place, word in enumerate(words):
            if place == 0 and word in (AUTO, ALL, "none"):
                ground = word
            else:
                forced[_known(word.lstrip("+-"))] = not word.startswith("-")
        return cls(ground, forced)

    def on(self, name: str, verdict: RuleResult) -> bool:
        """Return whether an effect with this rule result is computed."""
        ground = verdict.on if self.ground == AUTO else self.ground == ALL
        return self.forced.get(name, ground)


@dataclass(frozen=True, slots=True)
class Decision:
    """What becomes of one effect.

    Attributes:
        effect: which.
        verdict: of its rule.
        on: whether it is computed, regardless of the rule.
    """

    effect: Effect
    verdict: RuleResult
    on: bool


@dataclass(frozen=True, slots=True)
class EffectPlan:
    """Decisions on all effects of one ping.

    Attributes:
        decisions: in the order of `EFFECTS`.
        auto: whether the rules' word is law, so that what they leave out may be had either way.
    """

    decisions: tuple[Decision, ...]
    auto: bool = False

    @classmethod
    def make(
        cls,
        view: PingPreview,
        selection: EffectSelection,
        tolerance: Tolerance,
        names: Collection[str] = frozenset(EFFECTS),
    ) -> "EffectPlan":
        """Evaluate the rules of all or some effects, then apply the selection."""
        decisions = []
        for effect in EFFECTS.values():
            if effect.name in names:
                verdict = effect.decide(view, tolerance)
                decisions.append(Decision(effect, verdict, selection.on(effect.name, verdict)))
        return cls(tuple(decisions), selection.ground == AUTO)

    def without(self, names: Collection[str]) -> "EffectPlan":
        """The decisions on other effects."""
        kept = tuple(d for d in self.decisions if d.effect.name not in names)
        return EffectPlan(kept, self.auto)

    def switched_off(self, name: str) -> "EffectPlan":
        """The same decisions with one effect off."""
        off = (replace(d, on=False) if d.effect.name == name else d for d in self.decisions)
        return EffectPlan(tuple(off), self.auto)

    def with_more(self, other: "EffectPlan") -> "EffectPlan":
        """The decisions of two plans on different effects."""
        places = {name: place for place, name in enumerate(EFFECTS)}
        both = (*self.decisions, *other.decisions)
        return EffectPlan(tuple(sorted(both, key=lambda d: places[d.effect.name])), self.auto)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that are computed."""
        return tuple(d.effect.name for d in self.decisions if d.on)

    @property
    def missed(self) -> tuple[Decision, ...]:
        """Effects that the ping calls for and that are switched off."""
        return tuple(d for d in self.decisions if d.verdict.on and not d.on)

    def warn(self, known: set[str]) -> None:
        """Warn of each missed effect that is not yet known to be, and enter it there."""
        for decision in self.missed:
            if decision.effect.name not in known:
                known.add(decision.effect.name)
                message = f"{decision.effect.name} is switched off, but {decision.verdict.reason}"
                warnings.warn(message, EffectWarning, stacklevel=3)

    def physics(self, view: PingPreview) -> Physics:
        """Fill in the settings of the effects that are on."""
        physics = Physics(silent=view.bottoms)
        self.configure(physics, view)
        return physics

    def configure(self, physics: Physics, view: PingPreview) -> None:
        """Fill them into given settings."""
        for decision in self.decisions:
            if decision.on:
                decision.effect.configure(physics, view)
            elif self.auto and decision.effect.name == HIDING and not decision.verdict.on:
                # What lies behind does not show, and not to look for it is cheaper.
                physics.shadows = True


def _known(name: str) -> str:
    if name not in EFFECTS:
        raise EffectError(
            f"no effect {name!r}; there are {', '.join(EFFECTS)}, and auto, all, none"
        )
    return name
