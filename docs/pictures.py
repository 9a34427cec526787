"""Makes the pictures of these pages again: ``python docs/pictures.py [NAME ...]``, at the top of a checkout.

Every one is what a command leaves behind, run as a reader would run it; nothing is drawn from numbers that
are kept. ``--list`` says which there are and about how long each takes on two cores. Pictures of the viewer
need a Vulkan driver (Debian: mesa-vulkan-drivers), those of cars EGL (or ``MUJOCO_GL=osmesa``), the league
the extra ``laws``.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
AXES = (
    "friction",
    "command_delay_s",
    "sensing_delay_s",
    "steer_lag",
    "neighbour_reference_m",
    "neighbour_velocity_noise_mps",
)
"""Along which docs/mismatch.md looks for breaking points."""
FINDING = "drivers.vehicle_2.moves=[{start_s: 3.7, duration_s: 1.3, gap_m: 1.3}]"
"""What was left of the first failure in docs/search.md, with a friction of 0.5."""


@dataclass(frozen=True)
class Recipe:
    """How some pictures are made.

    Attributes:
        minutes: that it takes, about.
        files: each by its place in docs/, and the file that is left behind.
        make: leaves them in a folder.
    """

    minutes: float
    files: Mapping[str, str]
    make: Callable[[Path], None]


def mjmerge(*arguments: str | Path, good: tuple[int, ...] = (0, 1)) -> None:
    """Runs a command as a reader would; 1 is a verdict."""
    command = [sys.executable, "-m", "mjmerge", *map(str, arguments)]
    code = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL).returncode
    if code not in good:
        sys.exit(f"{' '.join(command)} ended with {code}")


def command(*arguments: str) -> Callable[[Path], None]:
    """One command, into the folder."""
    return lambda folder: mjmerge(*arguments, "--out", folder)


def breaking(scenario: str) -> Recipe:
    """The breaking points of a scenario along the axes of docs/mismatch.md."""
    axes = [word for axis in AXES for word in ("--break", f"mismatch.{axis}")]
    made = {f"mismatch/breaking_{scenario}.png": "breaking.png"}
    return Recipe(3 if scenario == "charge" else 10, made, command("sweep", scenario, *axes))


def ladder(scenario: str, *more: str) -> Recipe:
    """The ladder of a scenario."""
    made = {f"mismatch/ladder_{scenario}.png": "ladder.png"}
    return Recipe(0.3, made, command("sweep", "--ladder", scenario, *more))


def finding(folder: Path) -> None:
    """The first failure of docs/search.md, over its ideal."""
    from mjmerge.scenario.load import dump, load

    folder.mkdir()
    scenario = folder / "charge_finding_1.yaml"
    scenario.write_text(dump(load("charge", [FINDING])), encoding="utf-8")
    mjmerge("run", scenario, "--plant", "double_integrator", "--out", folder / "ideal")
    mjmerge("run", scenario, "--set", "mismatch.friction=0.5", "--out", folder / "run")
    mjmerge("compare", folder / "ideal", folder / "run", "--out", folder / "both")


def cars(folder: Path) -> None:
    """The cars, off-screen, and their identification; docs/cars.md takes its tables from there, too."""
    environment = {"MUJOCO_GL": "egl", **os.environ}
    subprocess.run(
        [sys.executable, "-m", "tests.physics.pictures", folder], cwd=ROOT, env=environment, check=True
    )


def viewer(*arguments: str, shown: tuple[str, ...], at_s: float) -> Callable[[Path], None]:
    """A run, and what the real viewer shows of files that it leaves, off-screen, at a time."""

    def make(folder: Path) -> None:
        sys.path.insert(0, str(ROOT))
        from PIL import Image

        from mjmerge.review.view import write_view
        from tests.recording.viewer import open_headless

        mjmerge("run", *arguments, "--out", folder)
        if "mcap" in shown:
            write_view(folder / "run.mcap", folder / "mcap.rrd")
        for name in shown:
            timeline = "message_log_time" if name == "mcap" else "sim_time"
            for said in open_headless(folder / f"{name}.rrd", folder / f"{name}.png", at_s, timeline):
                print(f"{name}: {said}", file=sys.stderr)
            with Image.open(folder / f"{name}.png") as shot:
                small = shot.convert("RGB").resize((1600, 900), Image.Resampling.LANCZOS)
            small.quantize(dither=Image.Dither.NONE).save(folder / f"{name}.png", optimize=True)

    return make


_PAPER = ("bifurcation", "opinion", "distances", "distances_no_barrier")
_IDENTIFIED = ("cornering", "handling", "longitudinal", "steering", "front", "rear", "crossmodel")
RECIPES = {
    "paper": Recipe(
        0.5,
        {f"figures/{n}{of}.png": f"{n}{of}.png" for n in _PAPER for of in ("", "_mujoco")}
        | {"figures/merge.gif": "merge.gif"},
        command("reproduce"),
    ),
    "cars": Recipe(
        1.5,
        {f"cars/{m}_{n}.png": f"cars/{m}_{n}.png" for m in ("rc", "sedan", "van") for n in _IDENTIFIED}
        | {"cars.md": "cars.md"},
        cars,
    ),
    "ladder_charge": ladder("charge"),
    "ladder_highway": ladder("highway", "--set", "mismatch.command_delay_s=0.05"),
    "breaking_charge": breaking("charge"),
    "breaking_highway": breaking("highway"),
    "frontier_charge": Recipe(
        3,
        {"mismatch/frontier_charge.png": "breaking.png"},
        command("sweep", "charge", "--break", "mismatch.command_delay_s=0:0.25,mismatch.friction=1:0.4"),
    ),
    "league": Recipe(
        4,
        {f"laws/{n}.png": f"{n}.png" for n in ("margins_charge_mujoco", "margins_highway_mujoco")},
        command("sweep", "league"),
    ),
    "falsify": Recipe(
        4,
        {"search/margins.png": "margins.png", "search/space.png": "space.png"},
        command("falsify", "charge", "--budget=400", "--both", "--findings=0", "--no-record"),
    ),
    "finding": Recipe(0.3, {"search/finding.png": "both/figure.png"}, finding),
    "harden": Recipe(
        4,
        {"search/frontier.png": "frontier.png"},
        command("harden", "charge", "--budget=160", "--tries=24", "--rounds=1", "--fresh=1"),
    ),
    "viewer": Recipe(0.5, {"viewer.png": "run.png"}, viewer("paper", shown=("run",), at_s=17.5)),
    "recording": Recipe(
        0.5,
        {f"recording_{name}.png": f"{name}.png" for name in ("run", "mcap", "compare")},
        viewer(
            *("charge", "--runs=2", "--set", "duration_s=6", "--set", "mismatch.friction=0.2"),
            shown=("run", "mcap", "compare"),
            at_s=5.2,
        ),
    ),
}
"""All there are, by name."""


def make(name: str, docs: Path = DOCS) -> None:
    """Makes the pictures of a recipe.

    Args:
        name: of the recipe.
        docs: the folder of the pages.
    """
    recipe = RECIPES[name]
    with TemporaryDirectory() as folder:
        recipe.make(Path(folder) / name)
        for place, made in recipe.files.items():
            (docs / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(Path(folder) / name / made, docs / place)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="which; all by default")
    parser.add_argument("--list", action="store_true", help="say which there are, and make none")
    parser.add_argument("--out", type=Path, default=DOCS, metavar="DIR", help="in place of docs/")
    asked = parser.parse_args()
    if unknown := set(asked.names) - set(RECIPES):
        parser.error(f"no {', '.join(sorted(unknown))}; there are {', '.join(RECIPES)}")
    for name in asked.names or RECIPES:
        recipe = RECIPES[name]
        if asked.list:
            print(f"{name}: {recipe.minutes:g} min\n  {' '.join(recipe.files)}")
            continue
        began = time.monotonic()
        make(name, asked.out)
        print(f"{name}: {len(recipe.files)} files in {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
