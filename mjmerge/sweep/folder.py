"""The folder of a sweep: whose it is, and the rows of every shard that is finished, whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import secrets
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.config import shipped
from mjmerge.errors import OutputError
from mjmerge.outputs import cannot_write
from mjmerge.scenario.cars import codes
from mjmerge.sweep.losses import lost_of
from mjmerge.sweep.plan import Batch, Plan
from mjmerge.sweep.shards import Shard
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa

_ROOMS = (
    "config",
    "drivers",
    "law",
    "plant",
    "scenario",
    "simulation",
    "traffic",
    "vehicle",
    "verdict",
    "world",
)
_FILES = ("roster", "state", "sweep/fidelity", "sweep/plan", "sweep/rows", "sweep/shards", "sweep/table")
"""What computes a row, of this package, with the rooms; and of others:"""
_PACKAGES = ("mujoco", "dm-control", "numpy", "scipy", "daqp")
PLAN, SHARDS, TABLE = "plan.json", "shards", "table.parquet"


def identity(plan: Plan) -> dict[str, Any]:
    """What the rows of a plan depend on: name of each part, and a digest of it."""
    batches: dict[int, Batch] = {id(case.batch): case.batch for case in plan.cases}
    order = {key: i for i, key in enumerate(batches)}
    scenarios = [
        [
            plan.labels[b.source],
            b.plant,
            b.continuous,
            b.scenario.model_dump_json(),
            *([b.fidelity.model_dump_json()] if b.fidelity else ()),
        ]
        for b in batches.values()
    ]
    models = {model for b in batches.values() for model in b.scenario.car_models}
    runs = [
        [order[id(case.batch)], case.point, case.seed, *case.overrides, case.mismatch.model_dump(mode="json")]
        for case in plan.cases
    ]
    code = {c.name: c for b in batches.values() for c in codes(b.scenario)}.values()
    return {
        "campaign": _digest(json.dumps([plan.name, runs])),
        "scenarios": _digest(json.dumps(scenarios)),
        "car models": _digest(
            *(path.read_bytes() for name in sorted(models) for path in _files(shipped.model_folder(name)))
        ),
        **computing(),
        **({"code from outside": _digest(*(c.sha256 for c in code))} if code else {}),
    }


@cache
def computing() -> dict[str, Any]:
    """What any row depends on, wherever it is computed: the code that computes it, versions, the machine."""
    found = versions(_PACKAGES)
    return {
        "mjmerge's code": _digest(*(path.read_bytes() for path in code_files())),
        "kind of machine": platform.machine(),
        "versions": found | {"python": ".".join(found["python"].split(".")[:2])},
    }


def code_files() -> list[Path]:
    """What computes a row, of this package: neither the command line nor figures, recordings or searches."""
    package = Path(__file__).parents[1]
    rooms = [path for room in _ROOMS for path in (package / room).rglob("*.py")]
    return sorted([*rooms, *(package / f"{name}.py" for name in _FILES)])


def _files(folder: Path) -> list[Path]:
    """Everything in a folder and below it, but for what is hidden."""
    found = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return [folder / path for path in found if not any(part.startswith(".") for part in path.parts)]


def _digest(*parts: bytes | str) -> str:
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def claim(folder: Path, whose: dict[str, Any]) -> None:
    """Makes the folder this plan's, or finds that it is; of several at once, one makes it.

    Raises:
        OutputError: it is no folder, cannot be written, or is something else's.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        plan = folder / PLAN
        if not plan.exists() and any(p.suffix != ".partial" for p in folder.iterdir()) and not plan.exists():
            raise OutputError(f"{folder} is not empty, and holds no sweep: choose another --out")
        if not plan.exists():
            _replace(plan, (json.dumps(whose, indent=2) + "\n").encode(), keep=True)
        changed = differing(folder, whose)
        if changed:
            raise OutputError(
                f"{folder} holds a sweep begun with another {', another '.join(changed)}; rows of both "
                "would not compare: choose another --out, or remove that folder"
            )
        (folder / SHARDS).mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from error


def differing(folder: Path, whose: dict[str, Any]) -> list[str]:
    """What of the plan that a folder is of is not as it is now, in words; of a plan's own folder nothing.

    Raises:
        OSError: it is no plan's.
    """
    return _changed((folder / PLAN).read_bytes(), whose)


def _changed(text: bytes, now_is: dict[str, Any]) -> list[str]:
    """What of a plan is not as it was, in words."""
    try:
        before = json.loads(text)
        told = {**before.pop("versions"), **before}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return ["file format"]
    now = {**now_is["versions"], **{k: v for k, v in now_is.items() if k != "versions"}}
    return [
        f"version of {name} ({told.get(name, 'none')}, now {now.get(name, 'none')})"
        if name in now_is["versions"] or name not in now_is
        else {"campaign": "campaign", "scenarios": "scenario", "shards": "size of shards"}.get(name, name)
        for name in {**told, **now}
        if told.get(name) != now.get(name)
    ]


def place(folder: Path, shard: Shard) -> Path:
    """File of a shard's rows."""
    return folder / SHARDS / f"{shard.number:06d}.parquet"


def read(
    folder: Path, shard: Shard, schema: pa.Schema, known: Callable[[Sequence[int]], pa.Table]
) -> pa.Table | None:
    """A finished shard's rows; ``None`` where there are none, or they are damaged or another plan's.

    Args:
        folder: of the sweep.
        shard: which.
        schema: what columns it must have.
        known: what some of them must say, of some runs.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = place(folder, shard)
    if not path.exists():
        return None
    try:
        if pq.read_metadata(path).num_rows > len(shard.at):
            return None  # before anything is unpacked
        found: pa.Table = pq.read_table(path, page_checksum_verification=True)
        lost = lost_of(found)
        described = known([i for i in shard.at if i not in lost])
        right = found.schema.equals(schema) and found.select(described.column_names).equals(described)
        return found if right else None
    except (pa.ArrowException, OSError, KeyError, ValueError, RecursionError):
        return None


def write(found: pa.Table, path: Path) -> None:
    """A table as a file that is there whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = pa.BufferOutputStream()
    pq.write_table(found, buffer, compression="zstd", write_page_checksum=True)
    try:
        _replace(path, buffer.getvalue().to_pybytes())
    except OSError as error:
        raise cannot_write(path, error) from error


def _replace(path: Path, content: bytes, *, keep: bool = False) -> None:
    """Writes a file, whole or not at all; ``keep`` leaves one that is there as it is."""
    for tries in range(3, -1, -1):
        partial = path.with_name(f"{path.name}.{secrets.token_hex(4)}.partial")
        try:
            with partial.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            if keep:
                _link(partial, path)
            else:
                partial.replace(path)
            return
        except FileNotFoundError:  # somebody else was finished, and swept up what seemed to be left
            if not tries:
                raise
        finally:
            with suppress(OSError):
                partial.unlink(missing_ok=True)


def _link(partial: Path, path: Path) -> None:
    """Gives a file its name, unless there is one of that name, made meanwhile by somebody else."""
    try:
        os.link(partial, path)
    except FileExistsError:
        return
    except FileNotFoundError:
        raise
    except OSError:  # a file system without links
        if not path.exists():
            partial.replace(path)
