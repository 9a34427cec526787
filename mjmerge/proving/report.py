"""What ``mjmerge identify`` leaves behind: the table for people and machines, and its plots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.style import COLOURS, LINE, MU, head, save, save_columns, save_rows, sheet
from mjmerge.outputs import put
from mjmerge.proving.identify import FRICTION, Identification
from mjmerge.proving.manoeuvres import compliance_rad
from mjmerge.proving.readings import steering_beyond_rad
from mjmerge.state import G_MPS2
from mjmerge.vehicle.acceptance import Measured
from mjmerge.vehicle.actuation import AIR_KG_PER_M3

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

FILES = (
    "cornering.png",
    "handling.png",
    "longitudinal.png",
    "steering.png",
    "turns.csv",
    "table.csv",
    "table.md",
)
"""All that is written; ``table.md`` comes last and marks the folder as complete."""

_FRONT, _REAR, _MODEL = COLOURS["vehicle_1"], COLOURS["vehicle_2"], MU
_SMOOTH = 20  # samples of the line drawn through lateral acceleration
_WORDS = {True: "yes", False: "NO", None: ""}


def write(folder: Path, found: Identification) -> None:
    """Plots and tables, into an empty folder."""
    save(cornering(found), folder / "cornering.png")
    save(handling(found), folder / "handling.png")
    save(longitudinal(found), folder / "longitudinal.png")
    save(steering(found), folder / "steering.png")
    turns = found.turns
    columns = {name: getattr(turns, name) for name in turns.__dataclass_fields__ if name != "unsteady"}
    save_columns(columns, folder / "turns.csv")
    header = ("name", "unit", "measured", "expected", "off", "tolerance", "passed", "how")
    rows = [[getattr(row, name) for name in header] for row in found.table]
    save_rows([header, *rows], folder / "table.csv")
    put(folder / "table.md", markdown(found.table))


def as_json(found: Identification) -> dict[str, Any]:
    """What ``--json`` prints, but for folder and versions."""
    return {
        "model": found.model,
        "passed": found.passed,
        "table": [{**vars(row), "off": row.off, "passed": row.passed} for row in found.table],
    }


def markdown(table: Sequence[Measured]) -> str:
    """The table in Markdown."""
    head = ["measured", "unit", "car", "data sheet or physics", "off", "allowed", "holds", "how"]
    lines = [head, ["---", "---", "---:", "---:", "---:", "---:", "---", "---"]]
    lines += [[r.name, r.unit, *_numbers(r), _WORDS[r.passed], r.how] for r in table]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def rich_table(table: Sequence[Measured]) -> Table:
    """The table for the terminal."""
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    grid.add_column("measured", style="bold", no_wrap=True)
    grid.add_column("unit", no_wrap=True)
    for name in ("car", "data sheet", "off", "allowed"):
        grid.add_column(name, justify="right", no_wrap=True)
    grid.add_column("")
    for r in table:
        style = {True: "", False: "bold red", None: "dim"}[r.passed]
        grid.add_row(r.name, r.unit, *_numbers(r), _WORDS[r.passed], style=style)
    return grid


def _numbers(r: Measured) -> list[str]:
    """Measured, expected, how far off and how far off it may be, as text."""
    if r.expected is None:
        return [_figure(r.measured), "", "", ""]
    allowed = ""
    if r.tolerance is not None:
        allowed = f"{r.tolerance / abs(r.expected):.1%}" if r.expected else f"{r.tolerance:.3g}"
    off = f"{r.off:+.2%}" if r.off is not None else ""
    return [_figure(r.measured), _figure(r.expected), off, allowed]


def _figure(value: float) -> str:
    """Four digits, without exponents where a person would not use them."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1e4 else f"{value:.4g}"


def cornering(found: Identification) -> Figure:
    """Cornering stiffness of each axle over speed, beside the data sheet's."""
    figure, (panel,) = sheet((1,), 3.4)
    turns, given = found.turns, found.sheet.cornering_stiffness_n_per_rad
    for name, colour, values, marker in (
        ("front", _FRONT, turns.front_stiffness_n_per_rad, "o"),
        ("rear", _REAR, turns.rear_stiffness_n_per_rad, "s"),
    ):
        panel.plot(
            turns.speed_mps, values, marker, color=colour, markersize=5, alpha=0.7, label=f"{name} axle"
        )
        if given is not None:
            stiffness = getattr(given, name)
            panel.axhline(stiffness, color=colour, linewidth=1)
            panel.axhspan(0.99 * stiffness, 1.01 * stiffness, color=colour, alpha=0.12, linewidth=0)
    panel.margins(x=0.03, y=0.25)
    panel.set_xlabel("speed (m/s)")
    panel.set_ylabel("cornering stiffness (N/rad)")
    panel.legend(loc="upper left", frameon=False, ncols=2)
    head(figure, f"{found.model}: cornering stiffness in steady turns; lines: its data sheet, bands: 1 %")
    return figure


def handling(found: Identification) -> Figure:
    """Steering beyond the kinematic bicycle's over lateral acceleration, and the way to the limit."""
    figure, (left, right) = sheet((1,), 3.8, columns=2)
    turns = found.turns
    more = np.degrees(steering_beyond_rad(found.sheet, turns))
    a_g = turns.lateral_mps2 / G_MPS2
    front, rear = compliance_rad(found.sheet)
    line = np.linspace(0, 1.1 * a_g.max(), 2)
    left.plot(line, np.degrees(front - rear) * line, color=_MODEL, label="$W_f/C_f - W_r/C_r$")
    points = left.scatter(a_g, more, c=turns.speed_mps, s=22, cmap="viridis", zorder=3, label="steady turns")
    figure.colorbar(points, ax=left, label="speed (m/s)")
    left.set_xlabel("lateral acceleration (g)")
    left.set_ylabel(r"$\delta - \arctan(L r/v)$ (deg)")
    left.legend(loc="upper left", frameon=False)
    ahead_m = found.sheet.wheelbase_m - found.sheet.com_behind_front_axle_m
    ramp = found.ramp
    for a, steer, v, colour in zip(
        ramp.lateral_mps2(ahead_m) / G_MPS2,
        ramp.steer_rad,
        ramp.speed_mps[:, 0],
        (_FRONT, _REAR),
        strict=True,
    ):
        right.plot(np.degrees(steer), a, color=colour, linewidth=0.5, alpha=0.35)
        mean = np.convolve(a, np.full(_SMOOTH, 1 / _SMOOTH), "valid")
        middle = steer[_SMOOTH // 2 :][: len(mean)]
        right.plot(np.degrees(middle), mean, color=colour, label=f"at {v:.3g} m/s")
    right.axhline(FRICTION, color=LINE, linewidth=1, label=r"$\mu g$")
    right.set_xlabel("steering angle, slowly raised (deg)")
    right.set_ylabel("lateral acceleration (g)")
    right.legend(loc="lower right", frameon=False)
    head(
        figure,
        f"{found.model}: left, steering beyond that of a car without slip; right, all that its tyres give",
    )
    return figure


def longitudinal(found: Identification) -> Figure:
    """Coasting down and full braking, each beside what the data sheet says."""
    figure, (left, right) = sheet((1,), 3.8, columns=2)
    car, coasting, braking = found.sheet, found.coasting, found.braking
    for i, v in enumerate(coasting.speed_mps):
        left.plot(coasting.time_s, v, color=_FRONT, linewidth=1.5, label=None if i else "car")
        believed = _coasted(car, float(v[0]), coasting.time_s)
        left.plot(coasting.time_s, believed, "--", color=_MODEL, label=None if i else "data sheet")
    left.set_xlabel("time (s)")
    left.set_ylabel("speed (m/s)")
    for i, v in enumerate(braking.speed_mps):
        way = braking.x_m[i] - braking.x_m[i, 0]
        right.plot(way, v, color=_FRONT, linewidth=1.5, label=None if i else "car")
        s = np.linspace(0, v[0] ** 2 / (2 * FRICTION * G_MPS2), 200)
        ideal = np.sqrt(np.maximum(v[0] ** 2 - 2 * FRICTION * G_MPS2 * s, 0))
        right.plot(s, ideal, "--", color=_MODEL, label=None if i else r"$\sqrt{v_0^2 - 2\mu g s}$")
    right.set_xlabel("distance (m)")
    right.set_ylabel("speed (m/s)")
    right.set_xlim(left=0)
    for panel, place in ((left, "lower left"), (right, "upper right")):
        panel.set_ylim(bottom=0)
        panel.legend(loc=place, frameon=False)
    head(figure, f"{found.model}: left, coasting; right, full braking")
    return figure


def steering(found: Identification) -> Figure:
    """Steps of the steering: a small one for the lag, a large one for the rate limit."""
    figure, panels = sheet((1,), 3.4, columns=2)
    step = found.step
    for i, panel in enumerate(panels):
        panel.plot(step.time_s, np.degrees(step.steer_command_rad[i]), color=_MODEL, label="commanded")
        panel.plot(step.time_s, np.degrees(step.steer_rad[i]), color=_FRONT, label="wheels")
        panel.set_xlabel("time (s)")
        panel.set_ylabel("steering angle (deg)")
    panels[0].set_xlim(0, 8 * found.sheet.steer_lag_s)
    panels[0].axvline(found.sheet.steer_lag_s, color=LINE, linewidth=1, label="63 % by the data sheet")
    panels[0].axhline(0.632 * np.degrees(step.steer_command_rad[0, -1]), color=LINE, linewidth=0.5)
    rate, end = found.sheet.steer_rate_limit_radps, step.steer_command_rad[1, -1]
    panels[1].plot([0, end / rate], [0, np.degrees(end)], "--", color=LINE, linewidth=1, label="rate limit")
    for panel in panels:
        panel.legend(loc="lower right", frameon=False)
    head(figure, f"{found.model}: steps of the steering; left, a small one; right, a large one")
    return figure


def _coasted(car: Any, speed_mps: float, time_s: Any) -> Any:
    """Speed under rolling resistance and drag of the data sheet: the closed form of m v' = -a - b v^2."""
    a = car.rolling_resistance * car.mass_kg * G_MPS2 / car.effective_mass_kg
    b = AIR_KG_PER_M3 / 2 * car.drag_area_m2 / car.effective_mass_kg
    if b == 0:
        return np.maximum(speed_mps - a * time_s, 0)
    if a == 0:
        return speed_mps / (1 + b * speed_mps * time_s)
    angle = np.arctan(speed_mps * np.sqrt(b / a)) - np.sqrt(a * b) * time_s
    return np.sqrt(a / b) * np.tan(np.maximum(angle, 0))
