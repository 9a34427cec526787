"""What a failure is held against: where the same behaviour must be safe, another plant or another law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mjmerge.config.doors import from_outside
from mjmerge.errors import UnknownNameError
from mjmerge.law import VARIANTS, Law, kinds
from mjmerge.roster import PLANTS
from mjmerge.scenario.effect import acting
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.verdict.counterfactual import IDEAL


@dataclass(frozen=True)
class Against:
    """Where the same behaviour must be safe.

    Attributes:
        name: what somebody called it: a plant, or a law.
        law: that law, on the same plant with the same mismatch; ``None`` for a plant, on which nothing is
            different in truth and every hypothesis must hold.
    """

    name: str = IDEAL
    law: Law | None = None

    @classmethod
    def named(cls, name: str, other: Callable[[str], Scenario]) -> Against:
        """By the name of a plant, of a variant of the paper's law, or of a kind of law.

        Args:
            name: the name.
            other: the scenario with another value at one key, such as ``law.kind=mpc``.

        Raises:
            UnknownNameError: there is nothing of that name.
            ScenarioError: the law does not go with the scenario.
        """
        if name in PLANTS:
            return cls(name)
        if name in VARIANTS:
            return cls(name, other(f"law.variant={name}").law)
        if name in kinds() or from_outside(name):
            return cls(name, other(f"law.kind={name}").law)
        raise UnknownNameError("plant or law", name, [*PLANTS, *VARIANTS, *kinds()])

    def plant(self, plant: str) -> str:
        """The plant of the comparison."""
        return self.name if self.law is None else plant

    def of(self, scenario: Scenario) -> Scenario:
        """The scenario as it is compared."""
        if self.law is not None:
            return scenario.model_copy(update={"law": self.law})
        return acting(scenario.settled().model_copy(update={"mismatch": Mismatch()}), self.name)

    @property
    def words(self) -> str:
        """It after "safe"."""
        if self.law is not None:
            return f"under {self.name}"
        return f"on {self.name}, with nothing different in truth"


PROOF = Against()
"""The world of the proof."""
