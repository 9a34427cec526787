"""What commonroad-io makes of a file of ``mjmerge traffic --export``: no test, but the outside check of it.

commonroad-io pins versions of libraries that do not go with ours, so it has an environment of its own:

    python3 -m venv cr && cr/bin/pip install commonroad-io
    cr/bin/python tests/recording/commonroad_reader.py run.xml

It reads the file, holds it against the format's own schema, and prints the least distance and the least time
to collision between the ego's rectangle and each other car's as one JSON object, for comparison with
``min_clearance_m`` of the run's summary. Nothing of mjmerge is imported.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

EGO = 1
LONGEST_S = 20.0


def read(path: str) -> tuple[Any, Any]:
    """Scenario and planning problems, by commonroad-io."""
    from commonroad.common.file_reader import CommonRoadFileReader

    return CommonRoadFileReader(path).open()


def is_valid(path: str) -> bool:
    """Whether the schema of CommonRoad 2020a, as commonroad-io ships it, has nothing against the file."""
    import commonroad
    from lxml import etree

    schema = Path(commonroad.__file__).parent / "common/xml_definition_files/XML_commonRoad_XSD.xsd"
    return bool(etree.XMLSchema(etree.parse(schema)).validate(etree.parse(path)))


def shape_at(obstacle: Any, step: int) -> tuple[Any, float, float]:
    """Its rectangle as a polygon, and its velocity in x and y, m/s."""
    from math import cos, sin

    state = obstacle.state_at_time(step)
    polygon = obstacle.occupancy_at_time(step).shapely_object
    return polygon, state.velocity * cos(state.orientation), state.velocity * sin(state.orientation)


def time_to_collision_s(one: tuple[Any, float, float], other: tuple[Any, float, float]) -> float:
    """How long until two rectangles touch that go on as they go, s; infinite where they do not soon."""
    from shapely import MultiPolygon
    from shapely.affinity import translate

    (a, *v), (b, *w) = one, other

    def swept(time_s: float) -> Any:
        return MultiPolygon([a, translate(a, (v[0] - w[0]) * time_s, (v[1] - w[1]) * time_s)]).convex_hull

    low, high = 0.0, LONGEST_S
    if not swept(high).intersects(b):
        return float("inf")
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (low, middle) if swept(middle).intersects(b) else (middle, high)
    return high


def judged(path: str) -> dict[str, Any]:
    """The file as others see it."""
    scenario, problems = read(path)
    ego = scenario.obstacle_by_id(EGO)
    last = ego.prediction.final_time_step
    found: dict[str, Any] = {
        "valid": is_valid(path),
        "benchmark": str(scenario.scenario_id),
        "step_s": scenario.dt,
        "steps": last,
        "lanelets": len(scenario.lanelet_network.lanelets),
        "goals": [len(one.goal.state_list) for one in problems.planning_problem_dict.values()],
    }
    for other in scenario.dynamic_obstacles:
        if other.obstacle_id == EGO:
            continue
        pairs = [(shape_at(ego, k), shape_at(other, k)) for k in range(last + 1)]
        distance_m = [a[0].distance(b[0]) for a, b in pairs]
        ttc_s = [time_to_collision_s(a, b) for a, b in pairs]
        found[f"to {other.obstacle_id}"] = {
            "least_distance_m": min(distance_m),
            "at_s": distance_m.index(min(distance_m)) * scenario.dt,
            "least_time_to_collision_s": min(ttc_s),
        }
    return found


if __name__ == "__main__":
    print(json.dumps(judged(sys.argv[1]), indent=2))
