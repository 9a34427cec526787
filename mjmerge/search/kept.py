"""What is kept of an estimate of a probability: every margin as it comes, and the samples that fail.

The margins let an estimate that was interrupted go on where it was; the samples are for ``mjmerge falsify``
to shrink.
"""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

from mjmerge.errors import MjmergeError, OutputError
from mjmerge.outputs import cannot_write, put
from mjmerge.search.findings import LOOKS
from mjmerge.search.probability import Asked, Probability
from mjmerge.search.space import Ground
from mjmerge.state import Array

SAMPLED, RESULTS, REPORT, FIGURE = "sampled.jsonl", "results.json", "report.md", "probability.png"
"""Files of an estimate beside ``looks.jsonl``: all margins, and, once it is finished, what they come to."""
FILES = (SAMPLED, RESULTS, REPORT, FIGURE, LOOKS)


class Margins:
    """Margins of an estimate, written as they come, a batch to a line."""

    def __init__(self, folder: Path, ground: Ground, asked: Asked) -> None:
        """Goes on with what lies in a folder, if anything does.

        Args:
            folder: of the estimate; made if need be.
            ground: the scenario and the space.
            asked: what is estimated.

        Raises:
            OutputError: it cannot be written, or holds something else, which is not overwritten.
        """
        self._path, of = folder / SAMPLED, _digest(ground, asked)
        found = _read(self._path, of)
        if found is None and any((folder / name).exists() for name in FILES):
            raise OutputError(
                f"{folder} holds something else, and nothing is overwritten: choose another --out"
            )
        self.known = found or []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(folder, error) from error
        lines = [json.dumps({"of": of}), *([json.dumps(self.known)] if self.known else [])]
        put(self._path, "".join(line + "\n" for line in lines))

    def add(self, margins: Array) -> None:
        """Writes a batch, m, (M,).

        Raises:
            OutputError: it cannot be written.
        """
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(margins.tolist()) + "\n")
        except OSError as error:
            raise cannot_write(self._path, error) from error


def settled(folder: Path, ground: Ground, asked: Asked) -> Path:
    """The folder, or, where something else lies there (of an edited file), one with a digest in its name."""
    of = _digest(ground, asked)
    there = any((folder / name).exists() for name in FILES)
    return (
        folder.with_name(f"{folder.name}-{of[:8]}")
        if there and _read(folder / SAMPLED, of) is None
        else folder
    )


def _digest(ground: Ground, asked: Asked) -> str:
    return sha256(json.dumps([ground.digest(), vars(asked)]).encode()).hexdigest()


def _read(path: Path, of: str) -> list[float] | None:
    """Margins as far as they are whole; ``None`` where they are of something else."""
    try:
        head, *lines = path.read_text(encoding="utf-8").splitlines()
        if json.loads(head)["of"] != of:
            return None
    except (OSError, ValueError, TypeError, KeyError):
        return None
    found: list[float] = []
    for line in lines:
        try:
            found += [float(value) for value in json.loads(line)]
        except (ValueError, TypeError):
            break
    return found


def looks(found: Probability) -> str:
    """The samples that fail, each once, the worst first, as lines of JSON, which :func:`failing` reads."""
    below = found.below
    lines = [json.dumps({"of": found.ground.digest(), "below_m": found.asked.bound_m})]
    from scipy.special import ndtr  # takes its time to import

    points = ndtr(below.u).tolist()
    for seed, point, value in zip(below.seeds.tolist(), points, below.values.tolist(), strict=True):
        lines.append(json.dumps({"seed": seed, "point": point, "margin_m": value}))
    return "".join(line + "\n" for line in lines)


def failing(folder: Path, ground: Ground) -> list[tuple[int, tuple[float, ...]]]:
    """The samples that failed in an estimate of a probability: where a search can go on from.

    Args:
        folder: of the estimate, as ``mjmerge probability`` writes it.
        ground: the scenario, plant and space that it must be of.

    Returns:
        Seed of the run, and point of the space, (D,), each 0 to 1; the least margin first.

    Raises:
        MjmergeError: there is none, or it is of another scenario, plant, space or version.
    """
    path = folder / LOOKS
    try:
        head, *lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        of = head["of"]
        found = [(int(one["seed"]), tuple(map(float, one["point"]))) for one in lines]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise MjmergeError(f"{folder} holds no samples of `mjmerge probability`") from error
    if of != ground.digest():
        raise MjmergeError(
            f"{folder} is of another scenario, plant, search or version: run `mjmerge probability` again"
        )
    return found
