"""How sure one can be of a rate that was counted."""

from __future__ import annotations

from dataclasses import dataclass

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Rate:
    """k of n, with the interval that the true rate lies in.

    Attributes:
        count: k.
        of: n.
        low: lower end of the interval.
        high: upper end.
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float | None:
        """k/n; ``None`` where nothing was counted."""
        return self.count / self.of if self.of else None

    def __str__(self) -> str:
        """As in a table."""
        if not self.of:
            return "-"
        return f"{self.count}/{self.of} = {self.count / self.of:.3f} [{self.low:.3f}, {self.high:.3f}]"


def clopper_pearson(count: int, of: int, confidence: float = CONFIDENCE) -> Rate:
    """The exact binomial interval (Clopper and Pearson 1934): it covers the true rate at least that often.

    Args:
        count: how many of them, k.
        of: how many there were, n; nothing is known of none.
        confidence: of the two-sided interval.
    """
    from scipy.stats import beta  # takes its time to import

    if not 0 <= count <= of:
        raise ValueError(f"{count} of {of} is no count")
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(1 - tail, count + 1, of - count)) if count < of else 1.0
    return Rate(count, of, low, high)
