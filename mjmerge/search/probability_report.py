"""What a person gets from an estimate of a probability: how it was made, in words and tables, and a plot."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.figures.style import COLOURS, LINE, MU, head, save, words
from mjmerge.outputs import put
from mjmerge.scenario.ran import beneath, ran
from mjmerge.scenario.space import Distribution
from mjmerge.search.findings import LOOKS
from mjmerge.search.kept import FIGURE, REPORT, RESULTS, looks
from mjmerge.search.probability import Probability, as_json
from mjmerge.search.rare import ACCEPTED, CALIBRATION, CONFIDENCE, FEW_CHAINS, Estimate
from mjmerge.search.screen import Screened, Within
from mjmerge.state import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SURE = f"{CONFIDENCE:.0%}"


def write(found: Probability, folder: Path) -> None:
    """Everything, the results last: a folder that has them is finished."""
    put(folder / LOOKS, looks(found))
    save(figure(found), folder / FIGURE)
    put(folder / REPORT, markdown(found))
    put(folder / RESULTS, json.dumps(as_json(found), indent=1) + "\n")


def sentence(found: Probability) -> str:
    """It in a line."""
    value, low, high = found.interval
    return (
        f"a margin of at most {found.asked.bound_m:g} m has a probability of {value:.3g}, within "
        f"[{low:.3g}, {high:.3g}] with {_SURE} confidence, by {found.runs} runs"
    )


def spread_words(spread: Distribution) -> str:
    """A distribution in words."""
    if spread.uniform is not None:
        return f"uniform from {spread.uniform[0]:g} to {spread.uniform[1]:g}"
    if spread.log_uniform is not None:
        return f"log-uniform from {spread.log_uniform[0]:g} to {spread.log_uniform[1]:g}"
    if spread.normal is not None:
        return f"normal, mean {spread.normal[0]:g}, standard deviation {spread.normal[1]:g}"
    if spread.lognormal is not None:
        median, sigma = spread.lognormal
        return f"lognormal, median {median:g}, standard deviation of the logarithm {sigma:g}"
    assert spread.choice is not None, "one of the five is given"
    return f"one of {', '.join(map(str, spread.choice))}"


def correction(by: Screened, bound_m: float, cheap: str, plant: str) -> list[str]:
    """How what a cheap plant says was corrected, in sentences."""
    here, inside = by.cheap, by.strata[-1]
    outside = [one for one in by.strata[:-1] if one.runs]
    lines = [
        f"{cheap} looked first: its margin is at most {bound_m:g} + {by.offset:.3g} = "
        f"{bound_m + by.offset:.3g} m with a probability of {here.probability:.3g} "
        f"[{here.low:.3g}, {here.high:.3g}], by {by.cheap_runs} runs. What was added to the bound is how "
        f"far {plant} fell below it in a few samples that were run on both, but for the furthest tenth."
    ]
    if inside.runs:
        lines.append(
            f"There {inside.failing} of {inside.runs} samples fail on {plant}, which makes "
            f"{_within(by.found)} of the probability."
        )
    else:
        lines.append(f"No sample from there was run on {plant}.")
    runs, failing = sum(one.runs for one in outside), sum(one.failing for one in outside)
    if runs:
        lines.append(
            f"Where {cheap} shows no such margin, {failing} of {runs} samples fail on {plant}, which adds "
            f"{_within(by.missed)}: what {cheap} misses."
        )
    else:
        lines.append(f"Elsewhere nothing was run on {plant}; that counts {_within(by.missed)}.")
    if by.missed.high > 2 * by.found.high:
        lines.append(
            f"The upper end is what so few runs cannot exclude where {cheap} says it is safe; only more runs "
            "there bring it down."
        )
    return lines


def _within(one: Within) -> str:
    return f"{one.probability:.3g} [{one.low:.3g}, {one.high:.3g}]"


def markdown(found: Probability) -> str:
    """The report."""
    ground, asked, e = found.ground, found.asked, found.estimate
    name, plant = ground.scenario.name, ground.plant
    line = sentence(found)
    parts: list[str] = [
        f"# How likely {name} on {plant} comes too close",
        *beneath(ground.scenario, plant)[:1],
        f"{line[0].upper()}{line[1:]}. Seed {asked.seed}.",
        f"![Probability of margins]({FIGURE})",
        "The margin is the least of every d_j and of every clearance of the ego, over a run. The seed of a "
        "run, from which its noise follows, is part of a sample.",
        "## What is drawn",
        _table(
            ("key", "distribution"),
            [(f"`{c.key}`", spread_words(c.spread)) for c in ground.coordinates],
        ),
    ]
    if ground.left_out:
        parts.append("Left out, since it is without effect there:")
        parts.append("\n".join(f"- `{key}` {why}" for key, why in ground.left_out))
    if found.nowhere:
        parts.append(
            f"{found.nowhere:.2%} of independent samples are no scenario, such as one whose cars overlap, or "
            "end before a margin is known; they count as not failing."
        )
    if found.screened is not None and asked.screen is not None:
        parts.append(f"## What {asked.screen} says, and its correction")
        parts += correction(found.screened, asked.bound_m, asked.screen, plant)
        parts.append(_strata(found.screened, asked.screen))
        parts.append(
            "The probability is the sum over the rows: how likely the row is, times the part that fails. "
            "Its interval is melded (Fay, Proschan and Brittain 2015) from those of the rows, of Clopper and "
            f"Pearson for what was run on {plant}."
        )
        parts.append(f"## Levels on {asked.screen}")
    else:
        parts.append("## How")
    parts += _how(e)
    parts.append("## Samples that fail")
    if len(found.below):
        parts.append(
            f"{len(found.below)} different ones are in `{LOOKS}`, the worst first: "
            f"{found.below.values[0]:.4g} m. `mjmerge falsify --from` goes on from them."
        )
    else:
        parts.append("None was seen.")
    return "\n\n".join(parts) + "\n"


def _how(e: Estimate) -> Iterator[str]:
    if not e.chains:
        yield (
            f"{e.runs} independent samples, of which {len(e.below)} fail; the interval is of Clopper and "
            "Pearson."
        )
        return
    yield (
        f"Subset simulation (Au and Beck 2001): {len(e.levels[0].samples)} independent samples; from the "
        f"tenth of them with the least margins {e.chains} chains of {e.length} samples each, which do not "
        "leave the level; from the least tenth of those the next, and so on down to the bound. A chain moves "
        f"in the space of standard normals, as far at once as lets {ACCEPTED:.0%} of its moves be taken."
    )
    rows = [
        (
            str(k),
            str(len(level.samples)),
            f"{level.bound:.4g}",
            f"{level.part:.4g}",
            f"{level.variation:.3g}",
            f"{level.accepted:.0%}" if k else "-",
        )
        for k, level in enumerate(e.levels)
    ]
    head = ("level", "samples", "bound (m)", "part below", "coefficient of variation", "moves taken")
    yield _table(head, rows)
    if len(e.levels) == 1:
        yield "One level is enough: its samples are independent, and the interval is of Clopper and Pearson."
    elif e.probability:
        factor = CALIBRATION * (1 + FEW_CHAINS / e.chains)
        yield (
            "The probability is the product of the parts. Its interval is lognormal. Its coefficient of "
            f"variation is that of the levels together, times {factor:.3g}, since chains remember: this was "
            f"measured, by repeats on functions with known answers, so that {_SURE} of the intervals cover "
            "or a little less. No interval knows of failures that no level came near."
        )
    else:
        yield (
            "No sample came down to the bound, and the levels did not lead to it. The upper end is what the "
            "last level's samples could have missed."
        )


def _strata(by: Screened, cheap: str) -> str:
    rows = []
    for one in by.strata:
        above = "" if one.inside else f"more than {one.above:.4g}"
        up_to = f"at most {one.up_to:.4g}" if isfinite(one.up_to) else ""
        between = " and ".join(filter(None, (above, up_to))) or "any"
        rows.append((between, f"{one.weight:.4g}", str(one.runs), str(one.failing)))
    return _table((f"margin on {cheap} (m)", "how likely", "run on the plant", "fail there"), rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def distribution(e: Estimate) -> list[tuple[Array, Array]]:
    """How likely a margin of at most a value is, over all levels.

    Returns:
        For each level values, (M,), from the lowest on, and their probabilities, (M,); where the next level
        knows better it says nothing.
    """
    found, weight = [], 1.0
    for k, level in enumerate(e.levels):
        values = np.sort(level.samples.values)
        below = weight * np.arange(1, len(values) + 1) / len(values)
        last = k + 1 == len(e.levels)
        mine = np.isfinite(values) & (values >= (-np.inf if last else level.bound))
        found.append((values[mine], below[mine]))
        weight *= level.part
    return found


def figure(found: Probability) -> Figure:
    """The distribution of the margin, level by level, and the bound with its interval."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(8, 4.5), layout="constrained")
    FigureCanvasAgg(sheet)
    axes = sheet.subplots()
    asked, plant = found.asked, found.ground.plant
    curves = [(x, y) for x, y in distribution(found.estimate) if len(x)]
    for k, (x, y) in enumerate(curves):
        shade = COLOURS["ego"] if k % 2 == 0 else COLOURS["vehicle_1"]
        axes.plot(x, y, drawstyle="steps-post", color=shade, linewidth=1.6)
        if found.estimate.chains:
            middle = len(x) // 2
            where = (float(x[middle]), float(y[middle]))
            axes.annotate(
                f"level {k}", where, (8, -8), textcoords="offset points", fontsize=9, color=shade, va="top"
            )
    axes.set_yscale("log")
    value, low, high = found.interval
    said = f"at most {asked.bound_m:g} m: {value:.2g} [{low:.2g}, {high:.2g}]"
    _mark(axes, asked.bound_m, said, LINE)
    if found.screened is not None:
        there = asked.bound_m + found.screened.offset
        if found.screened.offset:
            _mark(axes, there, f"bound on {asked.screen}\n", MU)
        curve = f"{found.screened.cheap_runs} runs on {asked.screen}"
    else:
        curve = f"{found.runs} runs on {plant}"
    _interval(axes, found)
    axes.set_xlabel("margin, the least of every $d_j$ and clearance (m)")
    axes.set_ylabel("probability of at most that")
    axes.grid(alpha=0.25)
    axes.margins(x=0.08, y=0.1)
    axes.set_ylim(top=2.0)
    head(sheet, *ran(found.ground.scenario, plant), f"margins by {curve}")
    return sheet


def _mark(axes: Axes, value: float, text: str, shade: str) -> None:
    """A bound, and above the panel what it is."""
    axes.axvline(value, color=shade, linewidth=1)
    at, where = (value, 1.01), axes.get_xaxis_transform()
    axes.text(*at, words(text), transform=where, color=shade, ha="center", va="bottom", fontsize=9)


def _interval(axes: Axes, found: Probability) -> None:
    """The probability at the bound, with its interval; an arrow down where its lower end is 0."""
    value, low, high = found.interval
    at = found.asked.bound_m
    point = value or high
    down = point - low if low else point * 0.7
    axes.errorbar(
        [at],
        [point],
        yerr=[[down], [high - point]],
        fmt="o" if value else "none",
        uplims=not low,
        color="black",
        capsize=3,
        markersize=4,
        zorder=4,
    )
