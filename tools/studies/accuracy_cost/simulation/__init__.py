"""Study of the simulator: what each effect, ray and decibel of tolerance buys and costs."""

from studies.accuracy_cost.simulation.study import STUDY

__all__ = ["STUDY"]
