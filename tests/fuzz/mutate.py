"""Files and options a little, or very, different from right ones: structure-aware, from what is shipped."""

from __future__ import annotations

import copy
import json
import random
import re
from collections.abc import Callable, Iterator
from typing import Any

HOSTILE: tuple[Any, ...] = (
    0, -1, 1, 2, 10**6, 10**18, 10**30, -(10**30), 0.5, -0.0, 1e-300, 5e-324, 1e300, -1e300, 1e-9, 1e9,
    float("nan"), float("inf"), -float("inf"), True, False, None, "", " ", "x", "no", "1e3", "null", "~",
    "\x00", "\x1b[2J", "../../etc/passwd", "/dev/zero", "/etc/passwd", "a" * 5000, "größe", "\ud83d\ude00",
    "::", "[/bold]", "$x_{$", "%s%n", "{}", "=", "a=b", [], {}, [[]], [None], {"": 1}, [1, 2], [1, 2, 3],
    ["x"], {"kind": "steady"}, {"kind": "x"}, {"kind": 3}, {"a": {"b": {"c": {}}}}, [0] * 500,
)  # fmt: skip
"""Values that are wrong nearly everywhere, and right somewhere."""

Path_ = tuple[Any, ...]


def paths(value: Any, at: Path_ = ()) -> Iterator[Path_]:
    """Where something stands in nested dicts and lists."""
    yield at
    if isinstance(value, dict):
        for key in value:
            yield from paths(value[key], (*at, key))
    elif isinstance(value, list):
        for i in range(len(value)):
            yield from paths(value[i], (*at, i))


def get(value: Any, at: Path_) -> Any:
    for key in at:
        value = value[key]
    return value


def mutated(value: Any, dice: random.Random, times: int) -> tuple[Any, list[str]]:
    """Nested dicts and lists with some changes, and what they are."""
    value, said = copy.deepcopy(value), []
    ways = dice.choice((_HARD, _SOFT, _SOFT))
    for _ in range(times):
        at = dice.choice([p for p in paths(value) if p] or [()])
        if not at:
            break
        holder, last = get(value, at[:-1]), at[-1]
        how = dice.choice(ways)
        said.append(f"{how.__name__} {'.'.join(map(str, at))}")
        how(holder, last, dice)
    return value, said


def _replace(holder: Any, key: Any, dice: random.Random) -> None:
    holder[key] = copy.deepcopy(dice.choice(HOSTILE))


def _scale(holder: Any, key: Any, dice: random.Random) -> None:
    value = holder[key]
    if isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = value * dice.choice([-1, 0, 1.001, 0.999, 10, 0.1, 1e3, 1e-3, 1e6, 1e-6])
    else:
        _replace(holder, key, dice)


def _remove(holder: Any, key: Any, dice: random.Random) -> None:
    del holder[key]


def _rename(holder: Any, key: Any, dice: random.Random) -> None:
    if isinstance(holder, dict):
        holder[dice.choice([f"{key}s", key[:-1], key.upper(), "", "x", f" {key}"])] = holder.pop(key)


def _wrap(holder: Any, key: Any, dice: random.Random) -> None:
    for _ in range(dice.choice([1, 2, 30])):
        holder[key] = [holder[key]] if dice.random() < 0.5 else {"a": holder[key]}


def _repeat(holder: Any, key: Any, dice: random.Random) -> None:
    if isinstance(holder, list):
        holder.extend(copy.deepcopy(holder[key]) for _ in range(dice.choice([1, 3])))
    else:
        holder[f"{key}_"] = copy.deepcopy(holder[key])


def _odd(holder: Any, key: Any, dice: random.Random) -> None:
    """A value of the same kind that may well be right."""
    match holder[key]:
        case bool() as flag:
            holder[key] = not flag
        case int():
            holder[key] = dice.choice([0, 1, 2, 3, 17, 300])
        case float():
            holder[key] = dice.choice([1, 1, -1]) * 10 ** dice.uniform(
                *dice.choice([(-2, 2), (-9, 9), (-300, 300)])
            )
        case str():
            holder[key] = dice.choice(NAMES)
        case _:
            _remove(holder, key, dice)


NAMES = (
    "double_integrator", "bicycle", "mujoco", "gated+one_sided", "capped", "guarded", "literal+gated", "rc",
    "sedan", "van", "steady", "gap", "flips", "idm", "speeds", "slip", "ideal", "known", "unknown", "barrier",
    "grip", "mild", "law.k_o=2", "mismatch.friction=0.3", "drivers.vehicle_2={kind: idm}", "duration_s=0.03",
    "charge", "short.yaml",
)  # fmt: skip
"""Words that are right somewhere."""
_Way = Callable[[Any, Any, random.Random], None]
_HARD: tuple[_Way, ...] = (_replace, _replace, _scale, _remove, _rename, _wrap, _repeat)
_SOFT: tuple[_Way, ...] = (_scale, _scale, _odd, _odd, _odd, _repeat)


def written(value: Any) -> str:
    """As JSON, which YAML 1.2 reads; infinities and NaN as YAML spells them."""
    text = json.dumps(value, ensure_ascii=False)
    text = re.sub(r"(?<![\w\"])-Infinity(?![\w\"])", "-.inf", text)
    return re.sub(
        r"(?<![\w\".])(NaN|Infinity)(?![\w\"])", lambda m: ".nan" if m[1] == "NaN" else ".inf", text
    )


def garbled(data: bytes, dice: random.Random) -> tuple[bytes, str]:
    """A file that was damaged, or edited by a program that does not know what it is."""
    at = dice.randrange(len(data) + 1)
    match dice.randrange(10):
        case 0:
            return data[:at], f"cut at {at}"
        case 1:
            flipped = bytearray(data)
            for _ in range(dice.choice([1, 5])):
                flipped[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
            return bytes(flipped), "bits flipped"
        case 2:
            return data[:at] + bytes([dice.randrange(256)]) * dice.choice([1, 40]) + data[
                at:
            ], f"bytes at {at}"
        case 3:
            return b"\xef\xbb\xbf" + data.replace(b"\n", b"\r\n"), "as a Windows editor saves it"
        case 4:
            return data.decode("utf-8", "replace").encode("utf-16"), "UTF-16"
        case 5:
            lines = data.split(b"\n")
            line = dice.randrange(len(lines))
            lines[line:line] = [lines[line]] * dice.choice([1, 3])
            return b"\n".join(lines), f"line {line} again"
        case 6:
            lines = data.split(b"\n")
            dice.shuffle(lines)
            return b"\n".join(lines), "lines in any order"
        case 7:
            return data + b"\n---\n" + data, "twice"
        case 8:
            bomb = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
                f"{b}: &{b} [*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a}]\n".encode()
                for a, b in zip("abcdefgh", "bcdefghi", strict=True)
            )
            return bomb + data, "a billion laughs"
        case _:
            return b"[" * dice.choice([10, 30, 5000]) + data, "deep"
