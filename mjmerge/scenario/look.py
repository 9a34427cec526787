"""A scenario on a line, and on a page of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mjmerge.notebook.html import facts, page, table

if TYPE_CHECKING:
    from mjmerge.config.frozen import Frozen
    from mjmerge.scenario.schema import Scenario


def line(scenario: Scenario) -> str:
    """What it is called, who is there, how long, under which law, and what was given beside its file."""
    cars = f"{len(scenario.roster.cars)} cars ({', '.join(dict.fromkeys(scenario.car_models))})"
    given = "; set " + ", ".join(scenario.changes) if scenario.changes else ""
    return f"<Scenario {scenario.name}: {cars}, {scenario.duration_s:g} s, law {_law(scenario)}{given}>"


def html(scenario: Scenario) -> str:
    """The same, who starts where and is driven by whom, and what is different in truth."""
    drivers = [f"law {_law(scenario)}", *(driver.kind for driver in scenario.neighbours)]
    cars = zip(scenario.roster.cars, scenario.car_models, scenario.starts, drivers, strict=True)
    rows = [
        (car, model, f"({start.front_m[0]:g}, {start.front_m[1]:g}) m", f"{start.speed_mps:g} m/s", driver)
        for car, model, start, driver in cars
    ]
    return page(
        line(scenario).strip("<>"),
        facts(
            {
                "what": scenario.description,
                "set": ", ".join(scenario.changes),
                "mismatch": ", ".join(_different(scenario.mismatch)),
                "floor": f"every d_j at least {scenario.expect.min_distance_m.at_least:g} m",
            }
        ),
        table(("car", "model", "starts at", "speed", "driver"), rows),
    )


def _law(scenario: Scenario) -> str:
    kind, label = scenario.law.kind, scenario.law.label
    return label if label in kind else f"{kind} ({label})"


def _different(section: Frozen) -> list[str]:
    """The keys of a section that are not at their defaults, with their values."""
    fields = type(section).model_fields
    return [f"{key}={value}" for key, value in section if value != fields[key].get_default()]
