"""Commands that a user could give, with something strange about each, and what is wrong with their answers.

Case ``i`` of a kind is the same every time. ``python -W default -m tests.fuzz.cases KIND FIRST COUNT FILE``
runs some in the working folder, and writes what is wrong to a JSON file.
"""

from __future__ import annotations

import io
import json
import random
import re
import resource
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

from ruamel.yaml import YAML

from mjmerge.cli import main
from mjmerge.config import shipped

from .code import brought
from .mutate import HOSTILE, garbled, mutated, paths, written

MOST_S, MOST_BYTES = 10.0, 2**30
ENDS = {0, 1, 2, 3}
PLANTS = ("double_integrator", "bicycle", "bicycle_limited", "mujoco")

Case = tuple[list[str], str]
"""A command line, and what is strange about it."""


def _yaml(path: Path) -> object:
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


def _file(dice: random.Random, value: object, name: str) -> str:
    """Writes a changed file; says what changed."""
    if dice.random() < 0.25:
        data, said = garbled(written(value).replace(', "', ',\n "').encode(), dice)
        Path(name).write_bytes(data)
        return said
    changed, what = mutated(value, dice, dice.choice([1, 1, 1, 2, 4]))
    Path(name).write_text(written(changed), encoding="utf-8", errors="surrogatepass")
    return "; ".join(what)


def _crowded(value: object, more: int) -> object:
    """A scenario with more neighbours, far ahead of all."""
    assert isinstance(value, dict)
    initial, drivers = dict(value["initial"]), dict(value["drivers"])
    for j in range(3, 3 + more):
        initial[f"vehicle_{j}"] = {"front_m": [1000.0 * j, 0.0], "speed_mps": 1.0}
        drivers[f"vehicle_{j}"] = {"kind": "steady", "speed_mps": 1.0}
    return value | {"initial": initial, "drivers": drivers}


def _scenario(dice: random.Random) -> Case:
    name = dice.choice(sorted(shipped.scenarios()))
    said = _file(dice, _crowded(_yaml(shipped.scenarios()[name]), dice.choice([0, 0, 1, 4])), "case.yaml")
    plant = dice.choice(PLANTS)
    more = dice.choice([[], ["--json"], ["--runs", "3"], ["--continuous"], ["--seed", "7"]])
    return [
        "run",
        "case.yaml",
        "--plant",
        plant,
        "--duration",
        "0.05",
        "--no-record",
        *more,
    ], f"{name}: {said}"


def _set(dice: random.Random) -> Case:
    name = dice.choice(sorted(shipped.scenarios()))
    keys = [".".join(map(str, p)) for p in paths(_yaml(shipped.scenarios()[name])) if p]
    keys += [
        "mismatch.friction",
        "mismatch.command_delay_s",
        "models.ego",
        "models.vehicle_3",
        "initial.vehicle_3",
        "drivers.vehicle_3",
        "law.leader",
        "law.k_o",
        "belief.mass_kg",
        "x",
        "",
    ]
    sets = [f"{dice.choice(keys)}={written(dice.choice(HOSTILE))}" for _ in range(dice.choice([1, 1, 2]))]
    words = [word for text in sets for word in ("--set", text)]
    command = dice.choice(["run", "run", "run", "export"])
    rest = ["--plant", dice.choice(PLANTS), "--duration", "0.05", "--no-record"] if command == "run" else []
    return [command, name, *words, *rest], f"{name} {sets}"


CAMPAIGN = {
    "description": "Small.",
    "blocks": [
        {
            "scenarios": ["short.yaml"],
            "plants": ["double_integrator", "bicycle"],
            "variants": ["gated"],
            "set": {"law.eps_1": 0.4},
            "mismatches": {"late": {"mismatch.command_delay_s": 0.02}},
            "grid": {"law.k_o": [0.5, 1.0], "mismatch.position_noise_m": [0.01]},
            "random": {
                "draws": 2,
                "seed": 3,
                "axes": {
                    "mismatch.velocity_noise_mps": {"uniform": [0.0, 0.1]},
                    "law.k_v": {"log_uniform": [1.0, 3.0]},
                    "mismatch.leader_acceleration": {"choice": ["known", "unknown"]},
                },
            },
            "seeds": 1,
            "first_seed": 5,
        }
    ],
}


def _campaign(dice: random.Random) -> Case:
    scenario = _yaml(shipped.scenarios()["charge"])
    assert isinstance(scenario, dict)
    Path("short.yaml").write_text(written(scenario | {"duration_s": 0.05, "gate": []}))
    said = _file(dice, CAMPAIGN, "case.yaml")
    shutil.rmtree("out", ignore_errors=True)
    return ["sweep", "case.yaml", "--workers", "1", "--out", "out"], said


def _gate(dice: random.Random) -> Case:
    scenario = _yaml(shipped.scenarios()["charge"])
    assert isinstance(scenario, dict)
    scenario["duration_s"] = 0.05
    rows = [
        {"name": "ideal", "plant": "double_integrator", "at_least_m": 0.1, "needs": ["barrier"]},
        {"name": "late", "plant": "bicycle", "set": ["mismatch.command_delay_s=0.02"], "at_least_m": 0.0},
    ]
    text = "row,min_d_1_m,min_d_2_m,min_clearance_m,mjmerge,mujoco,numpy\nideal,1.0,1.0,nan,0.1.0,3.17.0,2\n"
    Path("baselines").mkdir(exist_ok=True)
    data, said = text.encode(), "baseline as it is"
    if dice.random() < 0.4:
        data, said = garbled(data, dice)
        Path("case.yaml").write_text(written(scenario | {"gate": rows}))
    else:
        said = _file(dice, rows, "rows.yaml")
        head = written(scenario).rstrip("}").encode()
        Path("case.yaml").write_bytes(head + b', "gate": ' + Path("rows.yaml").read_bytes() + b"}")
    (Path("baselines") / "case.csv").write_bytes(data)
    more = dice.choice([[], ["--json"], ["--update"], ["--junit", "out.xml"], ["--only", "late"]])
    return ["check", "case.yaml", *more], said


def _car(dice: random.Random) -> Case:
    models = shipped.folder("models")
    for name in ("car", "parts"):
        shutil.rmtree(name, ignore_errors=True)
    shutil.copytree(models / "rc", "car")
    shutil.copytree(models / "parts", "parts")
    Path("car/rc.xml").rename("car/car.xml")
    if dice.random() < 0.5:
        said = _file(dice, _yaml(Path("car/datasheet.yaml")), "car/datasheet.yaml")
    else:
        file = Path(dice.choice(["car/car.xml", "parts/car.xml"]))
        said = f"{file}: {_xml(dice, file)}"
    words = ["--set", f"models.{dice.choice(['ego', 'vehicle_2'])}=./car"]
    return ["run", "paper", *words, "--duration", "0.02", "--no-record"], said


def _xml(dice: random.Random, file: Path) -> str:
    """Changes an MJCF file: an attribute, an element, or bytes."""
    text = file.read_text()
    attributes = list(re.finditer(r'(\w+)="([^"]*)"', text))
    how = dice.randrange(4)
    if how == 0:
        data, said = garbled(text.encode(), dice)
        file.write_bytes(data)
        return said
    one = dice.choice(attributes)
    if how == 1:
        new = dice.choice(
            ["", "0", "-1", "1e300", "nan", "x", "1 2 3 4 5 6 7 8 9", "1e-300", "ego/hull", "/dev/zero"]
        )
        file.write_text(text[: one.start(2)] + new + text[one.end(2) :])
        return f"{one[0]} is {new!r}"
    if how == 2:
        file.write_text(text[: one.start()] + text[one.end() :])
        return f"without {one[0]}"
    tags = list(re.finditer(r"<(\w+)[^<>]*/>", text))
    gone = dice.choice(tags)
    again = dice.choice(["", gone[0] * 2, '<include file="/etc/passwd"/>', '<plugin plugin="x"/>', "<x/>"])
    file.write_text(text[: gone.start()] + again + text[gone.end() :])
    return f"{gone[0][:60]} became {again[:60]!r}"


def _code(dice: random.Random) -> Case:
    words, said = brought(dice)
    shutil.rmtree("out", ignore_errors=True)
    plant = dice.choice(PLANTS[:3] if dice.random() < 0.8 else PLANTS)
    more = dice.choice([["--no-record"], ["--no-record", "--runs", "3"], ["--json", "--out", "out"]])
    if plant == "double_integrator" and dice.random() < 0.3:
        more = ["--no-record", "--continuous"]
    return ["run", "charge", *words, "--plant", plant, "--duration", "0.05", *more], said


COMMANDS = (
    "run paper --plant double_integrator --duration 0.05 --no-record --runs 2 --seed 3 --continuous",
    "run paper --duration 0.02 --live-at 127.0.0.1:9 --out out",
    "export paper --set law.k_o=1 --out world.xml",
    "sweep paper --break law.k_o=1:2 --plant double_integrator --seeds 1 --workers 1 --until floor",
    "sweep paper --ladder --workers 1 --seed 1 --out out",
    "theorem --runs 2 --seed 1 --duration 0.5",
    "survey --runs 2 --seed 1 --variants literal gated",
    "falsify charge --plant bicycle --seed 1 --method random --against bicycle --findings 0 --out out",
    "falsify charge --both --findings 1 --no-record --json",
    "explain charge --plant double_integrator --seed 1",
    "probability charge --plant bicycle --below 0 --seed 1 --method montecarlo --out out",
    "harden charge --plant double_integrator --seed 1 --out out",
    "traffic case.xml --map ngsim --tighten 1 --plant bicycle --out out",
    "list all",
    "schema scenario",
    "check --junit out.xml --threads 1",
    "view out --check",
    "verify out --json",
    "replay out --threads 1",
    "compare out out --out both",
    "recover out --out x.mcap",
    "convert out --csv --out x.csv",
    "video out --camera chase --speed 1 --fps 30",
    "new car mine --out .",
    "identify ./car --out out",
)
_SHORT = ["--workers", "1", "--set", "duration_s=0.05"]
ENOUGH = {
    "theorem": ["--runs", "2"], "survey": ["--runs", "2"], "check": ["--only", "nothing"],
    "sweep": ["--set", "duration_s=0.05"], "run": ["--duration", "0.05"],
    "falsify": [*_SHORT, "--budget", "1"], "explain": _SHORT, "probability": [*_SHORT, "--budget", "1"],
    "harden": [*_SHORT, "--budget", "1", "--tries", "1", "--rounds", "1", "--fresh", "1"],
}  # fmt: skip
"""What keeps a command short, at its end, where it has the last word."""
WORDS = [str(v) for v in HOSTILE] + [
    "--set", "--out", "--json", "--runs", "--help", "--", "-", "--seed=-1", "--duration=nan", "--plant=x",
    ".", "..", "/", "/dev/null", "/dev/zero", "/proc/self/mem", "case.yaml", "paper",
    "mismatch.friction=1:0.1", "a" * 300, "--no-record",
]  # fmt: skip


def _options(dice: random.Random) -> Case:
    words = dice.choice(COMMANDS).split()
    for _ in range(dice.choice([1, 1, 2, 3])):
        at = dice.randrange(1, len(words) + 1)
        match dice.randrange(3):
            case 0:
                words[at:at] = [dice.choice(WORDS)]
            case 1 if at < len(words):
                words[at] = dice.choice(WORDS)
            case _:
                del words[at : at + 1]
    words = [word.replace("\x00", "") for word in words]  # no system passes that on
    return words + ENOUGH.get(words[0], []), ""


KINDS: dict[str, Callable[[random.Random], Case]] = {
    "scenario": _scenario, "set": _set, "campaign": _campaign,
    "gate": _gate, "car": _car, "code": _code, "options": _options,
}  # fmt: skip


def case(kind: str, i: int) -> Case:
    """Makes a case, and the files that it needs in the working folder."""
    return KINDS[kind](random.Random(f"{kind} {i}"))


def _peak_bytes() -> int:
    """The most memory that this process had since its start, or since its peak was forgotten."""
    status = Path("/proc/self/status")
    if status.exists():  # of this program alone; the other one begins with what started it
        found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
        if found:
            return int(found[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _forget_peak() -> None:
    """Lowers the peak to what is taken now, where the system can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def trouble(args: list[str], command: Callable[[list[str]], object] = main) -> str:
    """What is wrong with how a command ended; empty if nothing is."""
    out, err = io.StringIO(), io.StringIO()
    _forget_peak()
    before_bytes = _peak_bytes()
    began = time.monotonic()
    code: object = None
    try:
        with redirect_stdout(out), redirect_stderr(err):
            command(args)
    except SystemExit as end:
        code = end.code
    except BaseException as error:
        return f"raised {error!r}"
    said, took_s = err.getvalue(), time.monotonic() - began
    if code not in ENDS:
        return f"ended with {code!r}: {said[-500:]}"
    if "mistake of mjmerge" in said or "Traceback" in said:
        return said[-500:]
    if code == 2 and not said and not out.getvalue():
        return "refused without a word"
    if "/tmp/tmp" in said:
        return f"names a temporary folder: {said[-500:]}"
    if took_s > MOST_S:
        return f"took {took_s:.1f} s"
    took_bytes = _peak_bytes() - before_bytes
    return f"took {took_bytes / 1e9:.1f} GB" if took_bytes > MOST_BYTES else ""


def troubles(kind: str, numbers: range) -> list[str]:
    """What is wrong with some cases of a kind."""
    bad = []
    for i in numbers:
        args, said = case(kind, i)
        wrong = trouble(args)
        if wrong:
            bad.append(f"{kind} {i}: {args} ({said}): {wrong}")
    return bad


if __name__ == "__main__":
    kind, first, count, file = sys.argv[1:]
    found = troubles(kind, range(int(first), int(first) + int(count)))
    Path(file).write_text(json.dumps(found))
