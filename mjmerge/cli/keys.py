"""Keys of a scenario for completion: a table, from which the shell offers those that a scenario has."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from mjmerge.config import shipped

Schema = Mapping[str, Any]
CAR = "CAR"
"""What stands in the table for each neighbour's name."""


def table() -> str:
    """A line per key: what must be there for it, the key, and all that it may be, if that is few.

    ``-`` is always there, ``law:mpc`` where that is the law, ``car:-`` for each neighbour and ``car:gap`` for
    each that has such a driver.
    """
    from mjmerge.law import VARIANTS

    root = json.loads((shipped.folder("scenarios") / "schema.json").read_text(encoding="utf-8"))
    found: dict[tuple[str, str], list[str]] = {}
    for there, key, choices in _keys(root, root["$defs"], "", "-"):
        found.setdefault((there, key), []).extend(choices)
    models = shipped.models()
    named = {"law.variant": VARIANTS, "law.leader": [CAR], "law.follower": [CAR]}
    named |= {"models.ego": models, f"models.{CAR}": models}
    return "\n".join(
        " ".join((there, key, *dict.fromkeys(choices or named.get(key, ()))))
        for (there, key), choices in found.items()
    )


def _keys(node: Schema, of: Schema, key: str, there: str) -> Iterator[tuple[str, str, list[str]]]:
    """What must be there, key and choices of every value in a part of a JSON schema."""
    if "$ref" in node:
        node = of[node["$ref"].rpartition("/")[2]]
    either = [*node.get("anyOf", ()), *node.get("oneOf", ())]
    for one in either:
        yield from _keys(one, of, key, there)
    inside, each_car = node.get("properties", {}), node.get("patternProperties", {})
    kind = inside.get("kind", {}).get("const")
    within = f"{'car' if CAR in key else 'law'}:{kind}" if kind else there
    for name, child in inside.items():
        if not (each_car and name.startswith("vehicle_")):
            yield from _keys(child, of, f"{key}.{name}".lstrip("."), there if name == "kind" else within)
    for child in each_car.values():
        yield from _keys(child, of, f"{key}.{CAR}", "car:-")
    if not (either or inside or node.get("type") == "null"):
        yield there, key, _choices(node)


def _choices(node: Schema) -> list[str]:
    if node.get("type") == "boolean":
        return ["true", "false"]
    return [str(value) for value in node.get("enum", [node["const"]] if "const" in node else [])]
