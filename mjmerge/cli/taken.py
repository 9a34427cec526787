"""What a command takes, and what it was given: one word of a few is told with the nearest right one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from operator import itemgetter
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from mjmerge.errors import MjmergeError, nearest


@dataclass(frozen=True)
class Option:
    """What a command takes.

    Attributes:
        flags: how it is said; none for what stands by itself.
        takes: what follows it, or what it is, as in the help: N, DIR, SCENARIO|RUN; empty for a switch.
        values: all that it may be, if they are few.
    """

    flags: tuple[str, ...]
    takes: str
    values: tuple[str, ...] = ()


def options(made_by: Any) -> Iterator[Option]:
    """What a command takes, in the order of its help, see :class:`tyro.conf.arg`."""
    hints = get_type_hints(made_by, include_extras=True)
    for field in fields(made_by):
        hint = hints[field.name]
        kind, *more = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        called, takes = (_said(more, key) for key in ("name", "metavar"))
        flag = "--" + (called or field.name).replace("_", "-")
        if is_dataclass(kind):
            yield from options(kind)
        elif tyro.conf.Positional in more:
            yield Option((), takes, _literal(kind))
        elif kind is bool:
            off = () if tyro.conf.FlagCreatePairsOff in more else (f"--no-{flag[2:]}",)
            yield Option((flag, *off), "")
        else:
            yield Option((flag,), takes or "VALUE", _literal(kind))


def given(made_by: Any, name: str, arguments: Sequence[str]) -> Any:
    """The command with what it was given.

    Args:
        made_by: what it is made by.
        name: of the command.
        arguments: what follows the name.

    Raises:
        MjmergeError: a word is none of those that may stand there.
    """
    asked = tyro.cli(made_by, prog=f"mjmerge {name}", args=arguments, registry=_REGISTRY)
    for option, value in zip(options(made_by), _values(asked), strict=True):
        if option.values and value not in option.values:
            where = "/".join(option.flags) or name
            raise MjmergeError(f"{where} takes no {value!r}: {nearest(value, option.values)}")
    return asked


def _said(more: Sequence[object], key: str) -> str:
    """What the markers of an option say of it, the last of them."""
    return next((value for one in reversed(more) if (value := getattr(one, key, None))), "")


def _literal(kind: Any) -> tuple[str, ...]:
    return get_args(kind) if get_origin(kind) is Literal else ()


def _values(asked: Any) -> Iterator[Any]:
    """What was given, in the order of the options."""
    for field in fields(asked):
        value = getattr(asked, field.name)
        if is_dataclass(value):
            yield from _values(value)
        else:
            yield value


_REGISTRY = ConstructorRegistry()


@_REGISTRY.primitive_rule
def _as_it_is(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[str] | None:
    """One word of a few is any word at first: tyro knows no nearest one, and has a form of its own."""
    words = _literal(info.type)
    if not words:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="{" + ",".join(words) + "}",
        instance_from_str=itemgetter(0),
        is_instance=lambda value: value in words,
        str_from_instance=lambda word: [word],
    )
