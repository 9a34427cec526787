"""What a run's table says, on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mjmerge.verdict.metrics import MERGED_M, TURNED_RAD, turned_words
from mjmerge.verdict.records import sentence

if TYPE_CHECKING:
    from rich.table import Table


def metres(value: float | None) -> str:
    """A length in words; a dash for none."""
    return "-" if value is None else f"{value:.3f} m"


def seconds(value: float | None) -> str:
    """A time in words; a dash for none."""
    return "-" if value is None else f"{value:.2f} s"


def table(found: dict[str, Any]) -> Table:
    """The summary as a table for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    good = found["floor_held"]
    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    for j, car in enumerate(found["min_distance_m"]):
        least, at = found["min_distance_m"][car], found["t_min_distance_s"][car]
        grid.add_row(f"min d_{j + 1}", f"{metres(least)} at {seconds(at)}  (to {car})")
    clearance = found["min_clearance_m"]
    grid.add_row("body clearance", "- (no bodies)" if clearance is None else metres(clearance))
    if found["collisions"]:
        grid.add_row("collisions", _collided(found["collisions"], found["runs"]))
    if "min_edge_distance_m" in found:
        grid.add_row("edge of the road", _at_the_end(found))
    merged = found["merged_at_s"]
    turned = found["turned_rad"]
    said = f"at {seconds(merged)} (lateral error < {MERGED_M} m)" if merged is not None else "no"
    if turned is not None and abs(turned) > TURNED_RAD:
        said += f"; it turned {turned_words(turned, '{} off the road')}"
    grid.add_row("merged", said)
    busy = [f"{car} {seconds(s)}" for car, s in found["saturated_s"].items() if s]
    grid.add_row("saturated", ", ".join(busy) or "never")
    grid.add_row("hypotheses", _broken(found["hypotheses"]))
    grid.add_row("decision", _hesitation(found["decision"]))
    if "strays" in found:
        grid.add_row("records", "; ".join(sentence(car, one) for car, one in found["strays"].items()))
    for name in found.get("metrics", ()):
        grid.add_row(escape(name), _own(found, name))
    if found.get("distinct_runs", found["runs"]) < found["runs"]:
        grid.add_row("distinct runs", "1: nothing is random here, and every seed gives the same run")
    if found.get("no_effect"):
        grid.add_row("no effect", escape(", ".join(found["no_effect"])))
    reasons = [found["reason"], *found.get("verdict_doubts", ())]
    grid.add_row("verdict", escape(f"{found['verdict']}: {'; but '.join(reasons)}"))
    if found["runs"] > 1:
        grid.add_row("verdicts", ", ".join(f"{n} {v}" for v, n in found["verdicts"].items()))
        grid.add_row("worst run", f"seed {found['worst_seed']}")
    for stop in found["stops"][:5]:
        what = f"seed {stop['seed']} at {seconds(stop['time_s'])}: {stop['car']}, {stop['reason']}"
        grid.add_row("stopped", escape(what))
    edge = f", {found['edge_floor_m']:.3f} m to the edge" if found.get("edge_floor_m") else ""
    floor = f"{found['floor_m']:.3f} m{edge} " + ("held" if good else "BROKEN")
    if found["runs"] > 1:
        floor += f" in {found['floor_held_runs']} of {found['runs']} runs"
    grid.add_row("safety floor", f"[{'green' if good else 'red'}]{floor}[/]")
    grid.add_row("real time", f"x {found['real_time_factor']:.1f}")
    return grid


def _at_the_end(found: Mapping[str, Any]) -> str:
    """How close the body came to the edge where the lane ends, and who ran off; the first four of them."""
    said = f"{metres(found['min_edge_distance_m'])} left where the lane ends"
    off = [
        f"at {seconds(one['time_s'])} at {one['speed_mps']:.2f} m/s"
        + (f" (seed {one['seed']})" if found["runs"] > 1 else "")
        for one in found["ran_off"][:4]
    ]
    more = f" and {len(found['ran_off']) - 4} more" if len(found["ran_off"]) > 4 else ""
    return f"RAN OFF {', '.join(off)}{more}; {said}" if off else said


def _collided(collisions: Sequence[Mapping[str, Any]], runs: int) -> str:
    """Who touched whom, when, and how fast; the first four of them."""
    said = []
    for c in collisions[:4]:
        fast = "" if c["speed_mps"] is None else f" at {c['speed_mps']:.2f} m/s"
        seed = f" (seed {c['seed']})" if runs > 1 else ""
        said.append(f"{c['a']} and {c['b']} at {seconds(c['time_s'])}{fast}{seed}")
    more = f" and {len(collisions) - 4} more" if len(collisions) > 4 else ""
    return ", ".join(said) + more


def _broken(hypotheses: Mapping[str, float | None]) -> str:
    """Which hypotheses broke, and when; the first three of them."""
    broke = sorted((at, name) for name, at in hypotheses.items() if at is not None)
    if not broke:
        return f"all {len(hypotheses)} held"
    more = f" and {len(broke) - 3} more" if len(broke) > 3 else ""
    return ", ".join(f"'{name}' broken at {at:.2f} s" for at, name in broke[:3]) + more


def _own(found: Mapping[str, Any], name: str) -> str:
    """A metric of the scenario's own: its value, those of other runs, and whether it is within bounds."""
    value, runs = found["metrics"][name], found["runs"]
    said = "-" if value is None else f"{value:.4g}"
    if runs > 1:
        of_all = found["metrics_range"][name]
        if of_all["least"] is not None:
            said += f"; {of_all['least']:.4g} to {of_all['most']:.4g} in all runs"
        if of_all["unknown"]:
            said += f"; not known in {of_all['unknown']}"
    bound = found.get("metrics_bounds", {}).get(name)
    if bound is None:
        return said
    sides = [
        f"at {side} {bound[f'at_{side}']:g}" for side in ("least", "most") if bound[f"at_{side}"] is not None
    ]
    good = bound["held_runs"] == runs
    held = f"{' and '.join(sides)} {'held' if good else 'BROKEN'}"
    if runs > 1:
        held += f" in {bound['held_runs']} of {runs} runs"
        if not good:
            held += f", first with seed {bound['first_broken_seed']}"
    return f"{said}  [{'green' if good else 'red'}]{held}[/]"


def _hesitation(found: Mapping[str, float | bool | None]) -> str:
    """The decision metrics in a line."""
    words = {
        "wrong_sign_s": "driven the wrong way for",
        "refusal_memory_s": "slow to trust again by",
        "abort_s": "slow to abort by",
        "straddling_s": "between the lanes for",
    }
    said = [f"{word} {found[key]:.2f} s" for key, word in words.items() if found[key]]
    return ", ".join(said + ["z underflowed"] * bool(found["underflow"])) or "nothing to report"
