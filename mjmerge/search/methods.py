"""How a search chooses its points: a method is asked for a batch of them, and told what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.state import Array

Method = Literal["cma", "random"]
TOGETHER = 16
"""Points of a batch: a population."""
_AT_FIRST = 64  # points that are drawn at random before it begins
_SPREAD = 0.2  # first standard deviation, over the width of the cube
_SPREAD_LATER = 0.15  # the same where it begins from what is known to be good
_GOOD = 0.1  # part of all points that it may begin from
_STILL = 6  # generations without getting better by more than _BETTER_M, after which it begins elsewhere
_BETTER_M = 2e-3


class Asked(Protocol):
    """A method at work."""

    def ask(self) -> Array:
        """The next points, (M, D), each coordinate 0 to 1."""

    def tell(self, costs: Sequence[float]) -> None:
        """What came of each of them; less is worse for the law, and what is looked for."""


class Random:
    """Points drawn uniformly: what every other method has to beat."""

    def __init__(self, size: int, seed: int) -> None:
        """Args: how many coordinates, D; the seed."""
        self._size, self._rng = size, np.random.default_rng(seed)

    def ask(self) -> Array:
        """See :meth:`Asked.ask`."""
        return self._rng.random((TOGETHER, self._size))

    def tell(self, costs: Sequence[float]) -> None:
        """Nothing is learnt."""
        del costs


class Cma:
    """CMA-ES (N. Hansen), which begins elsewhere when it is still.

    Outside of the cube its coordinates are folded back, so that it knows no bounds. It starts from the best
    of some random points; later, of what was good so far, from what is furthest from where it has ended.
    """

    def __init__(self, size: int, seed: int) -> None:
        """Args: how many coordinates, D; the seed.

        Raises:
            MjmergeError: the library is not installed.
        """
        check("cma")
        self._size, self._rng = size, np.random.default_rng(seed)
        self._search: Any = None
        self._asked: Array = np.zeros((0, size))
        self._points: Array = np.zeros((0, size))
        self._costs: Array = np.zeros(0)
        self._ends: list[Array] = []
        self._best, self._still = np.inf, 0

    def ask(self) -> Array:
        """See :meth:`Asked.ask`."""
        if len(self._costs) < _AT_FIRST:
            self._asked = self._rng.random((TOGETHER, self._size))
            return self._asked
        if self._search is None:
            self._begin()
        self._asked = np.array(self._search.ask())
        return folded(self._asked)

    def tell(self, costs: Sequence[float]) -> None:
        """See :meth:`Asked.tell`."""
        self._points = np.concatenate([self._points, folded(self._asked)])
        self._costs = np.concatenate([self._costs, costs])
        if self._search is None:
            return
        self._search.tell(list(self._asked), list(costs))
        best = min(costs)
        better = best < self._best - _BETTER_M
        self._best, self._still = min(self._best, best), 0 if better else self._still + 1
        if self._still >= _STILL or self._search.stop():
            self._ends.append(folded(self._search.best.x))
            self._search = None

    def _begin(self) -> None:
        import cma

        order = np.argsort(self._costs, kind="stable")
        if not self._ends:
            start = self._points[order[0]]
        else:
            good = self._points[order[: max(TOGETHER, round(_GOOD * len(order)))]]
            away = np.linalg.norm(good[:, None] - np.array(self._ends), axis=2).min(axis=1)
            start = good[int(np.argmax(away))]
        spread = _SPREAD if not self._ends else _SPREAD_LATER
        draws = np.random.RandomState(int(self._rng.integers(1, 2**31)))  # its own, and nobody else's
        options = {"popsize": TOGETHER, "seed": np.nan, "randn": draws.randn, "verbose": -9}
        self._search = cma.CMAEvolutionStrategy(start, spread, options)
        self._best, self._still = np.inf, 0


METHODS: dict[Method, type[Cma] | type[Random]] = {"cma": Cma, "random": Random}
"""By name."""


def check(method: Method) -> None:
    """Raises MjmergeError if the library of a method is not installed."""
    if method == "cma" and find_spec("cma") is None:
        raise MjmergeError("the method cma needs cma: pip install 'mjmerge[search]'")


def folded(points: Array) -> Array:
    """Points as they are mirrored at the sides of the unit cube until they are inside."""
    inside: Array = 1 - np.abs(1 - np.mod(points, 2.0))
    return inside
