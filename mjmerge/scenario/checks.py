"""What a well-formed scenario can still get wrong: physics, spacing and names.

A check is a function of the sections it reads, named as in the scenario (``sheets`` are the data sheets, by
car). It runs if those are valid, whatever is wrong with the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from inspect import signature
from itertools import combinations
from math import dist, inf
from typing import Any

import numpy as np

from mjmerge.config.bounds import MOST_METRICS, MOST_ROWS, MOST_TICKS
from mjmerge.drivers import ahead, ask, kinds
from mjmerge.drivers.recorded import Recorded
from mjmerge.errors import Problem, nearest
from mjmerge.law import Law
from mjmerge.law.asked import problems
from mjmerge.roster import EGO, neighbour, roster
from mjmerge.scenario.metrics import metric_name
from mjmerge.scenario.ramp import EDGE_DISTANCE, END_DISTANCE, Ramp
from mjmerge.scenario.schema import Drivers, Expect, GateRow, Initial, Lengths, Models, Road
from mjmerge.scenario.space import Space
from mjmerge.vehicle.datasheet import DataSheet


def check(sections: Mapping[str, Any]) -> Iterator[Problem]:
    """Every problem that the checks find in the sections that are there."""
    for one in _CHECKS:
        needs = signature(one).parameters
        if needs.keys() <= sections.keys():
            yield from one(**{name: sections[name] for name in needs})


def _steps(duration_s: float, control_step_s: float, physics_step_s: float) -> Iterator[Problem]:
    """The steps divide one another, and there is at least one."""
    ratio = control_step_s / physics_step_s
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        yield Problem(
            f"control step ({control_step_s} s) must be a whole multiple of the physics step "
            f"({physics_step_s} s)",
            "control_step_s",
        )
    if duration_s < control_step_s:
        yield Problem(
            f"duration ({duration_s} s) must be at least one control step ({control_step_s} s)",
            "duration_s",
        )
    elif duration_s / control_step_s > MOST_TICKS:
        yield Problem(
            f"{duration_s} s are {duration_s / control_step_s:.3g} control steps of {control_step_s} s; "
            f"a run has at most {MOST_TICKS}",
            "control_step_s",
        )


def _law(law: Law) -> Iterator[Problem]:
    """What the law finds wrong with itself."""
    for key, message in problems(law):
        yield Problem(message, f"law.{key}")


def _distances(initial: Initial, law: Law) -> Iterator[Problem]:
    """The barrier's hypothesis d_j(0) > 0 holds for every neighbour."""
    for car in initial.roster.neighbours:
        apart = dist(initial.ego.front_m, getattr(initial, car).front_m)
        if apart <= law.r_m:
            yield Problem(
                f"the ego starts {apart:g} m from {car}, front axle to front axle; it must be more "
                f"than r_m = {law.r_m} m; move the ego away",
                "initial.ego.front_m",
            )


def _order_and_gap(initial: Initial, law: Law) -> Iterator[Problem]:
    """The follower is behind the leader, and the target between them is at a safe distance from both."""
    there, one, two = initial.roster.neighbours, law.leader, law.follower
    strange = [(key, car) for key, car in (("leader", one), ("follower", two)) if car not in there]
    for key, car in strange:
        yield Problem(f"there is no {car} under initial: {nearest(car, there)}", f"law.{key}")
    if one == two:
        yield Problem(f"the leader and the follower are the same car, {one}", "law.follower")
    if strange or one == two:
        return
    first, second = getattr(initial, one).front_m, getattr(initial, two).front_m
    x_1, x_2 = first[0], second[0]
    if x_2 >= x_1:
        yield Problem(
            f"{two} must start behind {one}: its x is {x_2} m, and {one}'s is {x_1} m",
            f"initial.{two}.front_m",
        )
    r_rho_m = getattr(law, "r_rho_m", None)
    if r_rho_m is not None and r_rho_m >= 0:
        yield Problem(
            f"must be negative, got {r_rho_m}: rho points forward and the target is behind {one}",
            "law.r_rho_m",
        )
    if x_2 >= x_1 or (r_rho_m is not None and r_rho_m >= 0):
        return
    gap = dist(first, second) if law.choice == "named" else inf  # which gap it will be is not known
    furthest = gap - law.r_m
    if furthest <= law.r_m:
        yield Problem(
            f"the gap behind {one} is {gap:g} m at the start; it must be wider than "
            f"2 r_m = {2 * law.r_m:g} m to have room for the target; move {two} back",
            f"initial.{two}.front_m",
        )
    elif r_rho_m is not None and not law.r_m < -r_rho_m < furthest:
        yield Problem(
            f"the target is {-r_rho_m} m behind {one}, closer than r_m = {law.r_m} m to a neighbour "
            f"(the gap is {gap:g} m at the start); choose between {-furthest:g} and {-law.r_m}",
            "law.r_rho_m",
        )


def _bodies(initial: Initial, sheets: Mapping[str, DataSheet]) -> Iterator[Problem]:
    """No two bodies overlap; all are rectangles along the road."""
    spans = {}
    there = initial.roster.cars
    if not sheets.keys() >= set(there):
        return
    for car in there:
        sheet, (x, y) = sheets[car], getattr(initial, car).front_m
        nose = x + sheet.front_overhang_m
        half_width = sheet.width_m / 2
        spans[car] = ((nose - sheet.length_m, nose), (y - half_width, y + half_width))
    for one, other in combinations(there, 2):
        along, across = (
            min(a[1], b[1]) - max(a[0], b[0]) for a, b in zip(spans[one], spans[other], strict=True)
        )
        if along > 0 and across > 0:
            yield Problem(
                f"the bodies of {one} and {other} overlap at the start, by {along:.3g} m along the road and "
                f"{across:.3g} m across it; move one of them",
                f"initial.{other}.front_m",
            )


def _goes_on(road: Road, expect: Expect) -> Iterator[Problem]:
    """Nothing is said of an end where there is none."""
    if road.ends_m is not None:
        return
    given = {"road.taper_m": road.taper_m, "road.told": road.told != "obstacle"}
    given |= {"expect.min_edge_distance_m": expect.min_edge_distance_m.at_least}
    for key in (key for key, of in given.items() if of):
        yield Problem("the ego's lane has no end: give road.ends_m, too", key)


def _ends(road: Road, initial: Initial, law: Law, sheets: Mapping[str, DataSheet]) -> Iterator[Problem]:
    """The ego starts before the end of its lane, can pass it beside, and has that lane for itself."""
    there = initial.roster.cars
    if road.ends_m is None or law.leader not in there or not sheets.keys() >= set(there):
        return
    (x, y), leader = initial.ego.front_m, getattr(initial, law.leader).front_m
    ego, aside = sheets[EGO], abs(y - leader[1])
    ramp = Ramp.at(road, np.array([[y, leader[1]]]), ego, law.r_m)
    assert ramp is not None, "there is an end"
    room_m = aside - ego.width_m
    if ramp.told:
        room_m = min(room_m, abs(float(ramp.corner_m[0, 1]) - leader[1]) - law.r_m)
    if room_m <= 0:
        yield Problem(
            f"the lane that ends is {aside:g} m beside {law.leader}'s, and it cannot pass its end: the ego "
            f"is {ego.width_m:g} m wide and keeps r_m = {law.r_m:g} m away",
            "initial.ego.front_m",
        )
        return
    left = ramp.columns(np.array([[x, y]]), np.zeros((1, 2)), np.zeros(1))
    edge_m, end_m = float(left[EDGE_DISTANCE][0]), float(left[END_DISTANCE][0])
    if edge_m <= 0:
        nose = x + ego.front_overhang_m
        yield Problem(
            f"the ego starts off the road: its nose is at {nose:g} m; the lane must end later", "road.ends_m"
        )
    elif ramp.told and end_m <= 0:
        yield Problem(
            f"the ego starts {end_m + law.r_m:g} m from the end that the law is told of; it must be more "
            f"than r_m = {law.r_m} m",
            "road.ends_m",
        )
    lane = sorted((float(ramp.inner_m[0]), float(ramp.outer_m[0])))
    for car in there[1:]:
        at = getattr(initial, car).front_m[1]
        if lane[0] < at < lane[1]:
            yield Problem(
                f"{car} is in the lane that ends, at y = {at:g} m, and neighbours keep their lane",
                f"initial.{car}.front_m",
            )


def _gate(gate: tuple[GateRow, ...]) -> Iterator[Problem]:
    """The gate is no longer than anybody would wait for."""
    if len(gate) > MOST_ROWS:
        yield Problem(f"has {len(gate)} rows; a gate has at most {MOST_ROWS}", "gate")


def _metrics(metrics: tuple[str, ...]) -> Iterator[Problem]:
    """Each metric can be told from the others, and not more are measured than anybody reads."""
    if len(metrics) > MOST_METRICS:
        yield Problem(f"has {len(metrics)} metrics; a scenario has at most {MOST_METRICS}", "metrics")
    first: dict[str, str] = {}
    for i, reference in enumerate(metrics):
        name = metric_name(reference)
        if not name.isidentifier():
            yield Problem(f"a metric is named as file.py:headway_s, got {reference[:200]!r}", f"metrics.{i}")
        elif name in first:
            message = f"two metrics are called {name!r}: {first[name][:200]} and {reference[:200]}"
            yield Problem(message, f"metrics.{i}")
        first.setdefault(name, reference)


def _bounds(metrics: tuple[str, ...], expect: Expect, gate: tuple[GateRow, ...]) -> Iterator[Problem]:
    """Every bound is one, and of a metric that is there."""
    names = [metric_name(reference) for reference in metrics]
    places = {"expect.metrics": expect.metrics}
    places |= {f"gate.{i}.metrics": row.metrics for i, row in enumerate(gate)}
    for place, bounds in places.items():
        for name, bound in bounds.items():
            low, high = bound.at_least, bound.at_most
            if name not in names:
                yield Problem(
                    f"the scenario has no metric called {name!r}: {nearest(name, names)}", f"{place}.{name}"
                )
            elif low is None and high is None:
                yield Problem("must have at_least or at_most", f"{place}.{name}")
            elif low is not None and high is not None and low > high:
                yield Problem(f"nothing is at least {low} and at most {high}", f"{place}.{name}")


def _leads(drivers: Drivers, car: str) -> Iterator[Problem]:
    """A car that has nobody ahead has a driver who needs nobody."""
    leads = getattr(drivers, car)
    if not leads.can_lead:
        leaders = ", ".join(sorted(kind for kind, driver in kinds().items() if driver.can_lead))
        yield Problem(
            f"{leads.kind!r} follows the car ahead, and {car} has nobody ahead of it; "
            f"kinds that can lead: {leaders}",
            f"drivers.{car}.kind",
        )


def _drivers(drivers: Drivers) -> Iterator[Problem]:
    """What each driver finds wrong with itself."""
    for car in (*roster().neighbours, *drivers.further):
        for key, message in ask(getattr(drivers, car), "problems"):
            yield Problem(message, f"drivers.{car}.{key}")


def _records(initial: Initial, drivers: Drivers, duration_s: float) -> Iterator[Problem]:
    """Every record lasts as long as the run, and begins as its car does."""
    there = {*roster().neighbours, *drivers.further}
    for car in (c for c in initial.roster.neighbours if c in there):
        driver = getattr(drivers, car)
        if not isinstance(driver, Recorded) or any(driver.problems()):
            continue
        keys = {"duration": "duration_s", "speed": f"initial.{car}.speed_mps"}
        for what, message in driver.fits(getattr(initial, car).speed_mps, duration_s):
            yield Problem(f"{car}: {message}", keys[what])


def _ahead(
    initial: Initial, law: Law, drivers: Drivers, sheets: Mapping[str, DataSheet]
) -> Iterator[Problem]:
    """Every driver who follows has somebody to follow."""
    there = initial.roster.neighbours
    two = there.index(law.leader) if law.leader in there else 0, law.j_2
    if not (sheets.keys() >= set(there) and {*roster().neighbours, *drivers.further} >= set(there)):
        return
    starts = [getattr(initial, car).front_m for car in there]
    for car, leader in zip(there, ahead(starts, [sheets[car] for car in there], two), strict=True):
        if leader is None:
            yield from _leads(drivers, car)


def _numbers(initial: Initial) -> Iterator[Problem]:
    """The neighbours are numbered without a hole."""
    for j, car in enumerate(initial.roster.neighbours):
        if car != neighbour(j):
            yield Problem(f"there is no {neighbour(j)}: neighbours are numbered on", f"initial.{car}")
            return


def _driven(initial: Initial, drivers: Drivers) -> Iterator[Problem]:
    """Each neighbour has a driver, and nobody else has one."""
    for car in (c for c in initial.further if c not in drivers.further):
        yield Problem(f"missing; {car} stands under initial, and nobody drives it", f"drivers.{car}")
    yield from _nowhere(initial, drivers, "drivers")


def _modelled(initial: Initial, models: Models) -> Iterator[Problem]:
    """Nobody else has a model."""
    yield from _nowhere(initial, models, "models")
    yield from _nowhere(initial, models.length_m, "models.length_m")
    yield from _nowhere(initial, models.width_m, "models.width_m")


def _nowhere(initial: Initial, section: Drivers | Models | Lengths, key: str) -> Iterator[Problem]:
    for car in (c for c in section.further if c not in initial.further):
        yield Problem(f"there is no {car} under initial: nobody knows where it starts", f"{key}.{car}")


def _search(search: Space | None, initial: Initial, duration_s: float) -> Iterator[Problem]:
    """Ranges are ranges, and each neighbour that may do something is there and has time for it."""
    if search is None:
        return
    for key, spread in search.axes.items():
        for below, message in spread.problems():
            yield Problem(message, f"search.axes.{key}{'.' if below else ''}{below}")
    there = initial.roster.neighbours
    named = ["vehicle_1", "vehicle_2", *search.neighbours.further]
    for car in named:
        may, at = search.neighbours.of(car), f"search.neighbours.{car}"
        if may is None:
            continue
        if car not in there:
            yield Problem(f"there is no {car} under initial: {nearest(car, there)}", at)
        if (may.gap_m is None) == (may.speed_mps is None):
            yield Problem("must have one of gap_m (behind another) and speed_mps (with nobody ahead)", at)
        for name, pair in (("gap_m", may.gap_m), ("speed_mps", may.speed_mps)):
            if pair is not None and not 0 <= pair[0] <= pair[1]:
                yield Problem(
                    f"must go from a smaller to a larger number, from 0 on, got {pair}", f"{at}.{name}"
                )
        if may.from_s >= duration_s:
            yield Problem(
                f"must be less than the duration ({duration_s} s), got {may.from_s}", f"{at}.from_s"
            )


_CHECKS = (
    _numbers,
    _driven,
    _modelled,
    _steps,
    _law,
    _distances,
    _order_and_gap,
    _bodies,
    _goes_on,
    _ends,
    _ahead,
    _drivers,
    _records,
    _metrics,
    _bounds,
    _gate,
    _search,
)
