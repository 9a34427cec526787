"""What is in a recording as Markdown tables, from the declarations that the recorders use."""

from __future__ import annotations

from mjmerge.record import schema
from mjmerge.record.scene import DRAWN_EVERY_S
from mjmerge.record.schema import CAR_COLUMNS, LAW_COLUMNS, TOLD_COLUMNS, Field
from mjmerge.roster import XY, roster
from mjmerge.simulation.trace import END_COLUMNS, Column

_UNITS = {
    "_n_m": "N m",
    "_mps2": "m/s²",
    "_mps": "m/s",
    "_radps": "rad/s",
    "_rad": "rad",
    "_per_s": "1/s",
    "_m": "m",
    "_s": "s",
}
"""Ends of names, the longer ones first, and the units they stand for."""


def unit(name: str) -> str:
    """The unit that a name ends in; ``1`` for a plain number."""
    return next((u for end, u in _UNITS.items() if name.endswith(end)), "1")


def fields() -> str:
    """Every field of our messages: the same in both formats."""
    tables, wire = [], schema.Wire(roster())
    for topic, message, columns in (
        (schema.LAW_TOPIC, schema.LAW_MESSAGE, LAW_COLUMNS),
        (schema.car_topic("<car>"), schema.CAR_MESSAGE, CAR_COLUMNS),
        (schema.TOLD_TOPIC, schema.TOLD_MESSAGE, TOLD_COLUMNS),
    ):
        by_name = {c.name: c for c in columns}
        tables += [
            f"`{topic}` holds `{schema.PACKAGE}.{message}`, once per tick"
            + (", where the ego was not told the truth:" if topic == schema.TOLD_TOPIC else ":"),
            "",
            "| field | unit | frame | symbol | what it is |",
            "|---|---|---|---|---|",
            *(_row(f, by_name.get(f.name)) for f in wire.messages[message]),
            "",
        ]
    tables += [
        f"`{schema.SIGNAL_TOPIC}` holds `{schema.PACKAGE}.{schema.SIGNAL_MESSAGE}`; where a lane ends:",
        "",
        "| field | unit | frame | symbol | what it is |",
        "|---|---|---|---|---|",
        *(_row(Field(c.name, c.doc), c) for c in END_COLUMNS),
        "",
    ]
    return "\n".join(tables)


def _row(field: Field, column: Column | None) -> str:
    parts = "".join(".{" + ", ".join(names) + "}" for names in field.axes)
    frame = "road" if XY in field.axes else "-"
    symbol, what = (column.symbol, column.doc) if column else ("t", field.doc)
    cells = (f"`{field.name}{parts}`", unit(field.name), frame, symbol, what)
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


def topics() -> str:
    """Everything else, topic by topic, with the rates."""
    drawn = f"{1 / DRAWN_EVERY_S:g} Hz"
    rows = [
        (
            "`/law`, `/car/<car>`, `/told`",
            "`/law`, `/car/<car>`, `/told`",
            "every tick",
            "the numbers, float64, bit for bit",
        ),
        (
            "`/signals`",
            "`/signals`",
            "every tick",
            "`SignalState`: of a law's own, and of the end of the lane; the manifest says what each is",
        ),
        ("`/tf`", "`/world/<car>/<body>`, ...", drawn, "poses of all that is drawn, in the world, float32"),
        (
            "`/scene`",
            "`/world/**`",
            "once",
            "geometry of cars and road, discs; a disc again when it changes colour, a pin where bodies touch",
        ),
        (
            "`/look/<car>`, `/look/disc_of_<car>`",
            "-",
            "once",
            "cars and discs as points, for Rerun where it opens the MCAP by itself",
        ),
        (
            "`/scene`",
            "`/world/contact_<n>`, `/contact`",
            "as it happens",
            "bodies that touch: where, and whose",
        ),
        ("-", "`/world/axles/ego/{u_n, u_c, u}`", drawn, "arrows of the ego's command"),
        ("-", "`/world/trails`", drawn, "paths of the front axles"),
        ("`/log`", "`/events`", "as it happens", "events, with level and car: `ego: touches vehicle_2 ...`"),
        (
            "`/phases`",
            "`/phases/*`, `/hypotheses/*`",
            "as it changes",
            "states: decision, safety, actuation, hypotheses, end of the lane: `safety: touching`",
        ),
        (
            "attachments",
            "`/run/*`, properties",
            "once",
            "scenario, MJCF, manifest, summary; report (Rerun), layout (Foxglove)",
        ),
    ]
    head = ["| MCAP topic | Rerun entity | rate | what it is |", "|---|---|---|---|"]
    return "\n".join([*head, *("| " + " | ".join(row) + " |" for row in rows), ""])
