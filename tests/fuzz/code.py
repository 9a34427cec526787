"""Laws, drivers and metrics that nearly work: those that ``mjmerge new`` writes, and a class, with a change.

Changed by their syntax: what is raised, returned, declared, called, or left out may be anything.
"""

from __future__ import annotations

import ast
import random
from pathlib import Path

from mjmerge.drivers import Driver
from mjmerge.law import Law
from mjmerge.starts.make import make

from .mutate import garbled

CLASS = """
import numpy as np
from mjmerge.law import Decision, Law, Signal, geometry

class MineLaw(Law):
    kind: str
    k: float = 1.0
    on: bool = True
    gives = ("target_m",)
    guard = "its brake"

    @property
    def signals(self):
        closing = Signal("closing_mps", "how fast it closes in", symbol="c", axes=("neighbours",))
        return closing, Signal("fine", "", asks="all is well")

    def problems(self):
        if self.k > 100:
            yield "k", "is too large"

    def start(self, runs, initial):
        return {"least_m": np.full(runs, 1.0 + initial["z"])}

    def unguarded(self):
        return self.model_copy(update={"on": False})

    def decide(self, seen, memory, step_s):
        there = geometry(self, seen)
        u = -self.k * (seen.v - seen.v_j[:, self.j_1])
        least = np.minimum(memory["least_m"], there.d.min(axis=1))
        signals = {"closing_mps": -there.d_dot, "fine": (least > 0).astype(float)}
        return Decision(u, signals | {"target_m": seen.p + 1.0}, after={"least_m": least})
"""
EXPRESSIONS = (
    "None", "True", "0", "-1", "1e300", "10**400", "float('nan')", "-np.inf", "1j", "'x'", "b'x'", "...",
    "[]", "{}", "()", "[1, [2, 3]]", "{'a': 1}", "{5: 6}", "object()", "lambda *a, **k: 0",
    "(i for i in 'ab')", "print", "int", "np.zeros(0)", "np.zeros((3, 3))", "np.zeros((1, 2))",
    "np.zeros(1)", "np.array(None)", "np.array(['a'])", "np.zeros((2, 2), dtype=complex)", "np.ma.masked",
    "1 / 0", "undefined", "open('/nowhere')", "exit(0)", "[].x", "np.float32(0.5)", "np.zeros((2, 2)).sum",
    "np.random.rand()", "__import__('nothing_there')", "range(3)",
)  # fmt: skip
"""What an expression may become."""
STATEMENTS = (
    "raise RuntimeError('no')", "raise SystemExit(0)", "raise SystemExit('text')",
    "raise KeyError('time_s')", "raise ValueError('two\\nlines')", "raise OSError(28, 'full')",
    "raise MemoryError", "raise StopIteration", "raise RecursionError", "raise AssertionError",
    "raise UnicodeError", "raise GeneratorExit", "return", "return 5", "yield 5", "pass",
    "import nothing_there", "print('said')", "global seen", "del np",
    "import warnings; warnings.warn('hm')", "seen.p[:] = 0", "memory['x'] = [1]", "memory[5] = np.zeros(1)",
    "memory.clear()", "own.speed_mps[:] = 0", "trace.front_m[:] = 0", "own.more = 1", "self.k = 3",
    "np.seterr(all='raise')", "class X(Law): pass", "from __future__ import braces",
    "import sys; sys.stdout.close",
)  # fmt: skip
"""What may stand before a statement."""
_Function = (ast.FunctionDef, ast.AsyncFunctionDef)


KINDS = ("law", "class", "driver", "metric")


def begun(what: str, dice: random.Random) -> tuple[str, list[str]]:
    """The text of a law, driver or metric that works, and the words that have a scenario use it."""
    for left in ("mine.py", "begun.py"):
        Path(left).unlink(missing_ok=True)
    text = CLASS if what == "class" else make(what, "begun", Path()).read_text()
    name, words = {
        "law": (dice.choice(["begun", "begun_each"]), "law={{kind: './mine.py:{}'}}"),
        "class": ("MineLaw", "law={{kind: './mine.py:{}'}}"),
        "driver": ("Begun", "drivers.vehicle_2={{kind: './mine.py:{}'}}"),
        "metric": ("begun", "metrics=['./mine.py:{}']"),
    }[what]
    return text, ["--set", words.format(name)]


def brought(dice: random.Random) -> tuple[list[str], str]:
    """Writes ``mine.py``: the words that have a scenario use it, and what is strange about it."""
    what = dice.choice((*KINDS, "class", "driver"))
    text, words = begun(what, dice)
    if dice.random() < 0.1:
        data, said = garbled(text.encode(), dice)
        Path("mine.py").write_bytes(data)
    else:
        tree = ast.parse(text)
        said = "; ".join(_changed(tree, dice) for _ in range(dice.choice([1, 1, 1, 2, 3])))
        Path("mine.py").write_text(ast.unparse(ast.fix_missing_locations(tree)) + "\n")
    return words, f"{what}: {said}"


def _changed(tree: ast.Module, dice: random.Random) -> str:
    """Changes a syntax tree somewhere; says how."""
    inside = [node for f in ast.walk(tree) if isinstance(f, _Function) for node in ast.walk(f)]
    holders = [node for node in ast.walk(tree) if isinstance(getattr(node, "body", None), list)]
    match dice.randrange(7):
        case 0 | 1:  # an expression
            spots = [
                (node, field, i)
                for node in inside
                for field, value in ast.iter_fields(node)
                for i, one in enumerate(value if isinstance(value, list) else [value])
                if isinstance(one, ast.expr) and not isinstance(getattr(one, "ctx", None), ast.Store)
            ]
            if not spots:
                return "nothing"
            node, field, i = dice.choice(spots)
            text = dice.choice(EXPRESSIONS)
            new = ast.parse(text, mode="eval").body
            old = getattr(node, field)
            said = ast.unparse(old[i] if isinstance(old, list) else old)
            if isinstance(old, list):
                old[i] = new
            else:
                setattr(node, field, new)
            return f"{said} is {text}"
        case 2:  # one statement more, somewhere
            holder, text = dice.choice(holders), dice.choice(STATEMENTS)
            holder.body.insert(dice.randrange(len(holder.body) + 1), _statement(text))
            return f"in line {getattr(holder, 'lineno', 0)}: {text}"
        case 3:  # one less
            holder = dice.choice([h for h in holders if len(h.body) > 1] or holders)
            gone = holder.body.pop(dice.randrange(len(holder.body)))
            holder.body = holder.body or [ast.Pass()]
            return f"without {ast.unparse(gone)[:60]}"
        case 4:  # another signature
            functions = [node for node in ast.walk(tree) if isinstance(node, _Function)]
            if not functions:
                return "nothing"
            args = (one := dice.choice(functions)).args.args
            how = dice.randrange(4)
            if how == 0 and args:
                return f"{one.name} without {args.pop(dice.randrange(len(args))).arg}"
            if how == 1:
                dice.shuffle(args)
                return f"{one.name} with its arguments in any order"
            if how == 2:
                args.append(ast.arg("more"))
                return f"{one.name} wants more"
            one.decorator_list = [
                ast.parse(dice.choice(["staticmethod", "property", "print", "1 / 0"]), mode="eval").body
            ]
            return f"{one.name} is a {ast.unparse(one.decorator_list[0])}"
        case 5:  # another name
            named = [
                node for node in ast.walk(tree) if isinstance(node, (*_Function, ast.ClassDef, ast.Attribute))
            ]
            if not named:
                return "nothing"
            one = dice.choice(named)
            key = "attr" if isinstance(one, ast.Attribute) else "name"
            was = getattr(one, key)
            setattr(one, key, dice.choice(["x", "kind", "_y", "model_dump", "r_m", f"{was}s"]))
            return f"{was} is called {getattr(one, key)}"
        case _:  # a class says something of itself
            classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
            if not classes:
                return "nothing"
            one = dice.choice(classes)
            base = Law if one.name.endswith("Law") else Driver
            name = dice.choice(
                [n for n in dir(base) if not n.startswith("__")] + ["__init__", "__eq__", "__hash__"]
            )
            text = dice.choice(EXPRESSIONS)
            ways = (
                f"{name} = {text}",
                f"{name}: int = {text}",
                f"def {name}(*a, **k):\n  return {text}",
                f"def {name}(*a, **k):\n  {dice.choice(STATEMENTS)}",
                f"@property\ndef {name}(self):\n  return {text}",
            )
            one.body.append(_statement(way := dice.choice(ways)))
            return f"{one.name} has {way}"


def _statement(text: str) -> ast.stmt:
    """A statement from its text; what cannot be parsed stands there as it is."""
    try:
        return ast.parse(text).body[0]
    except SyntaxError:  # such as a return outside of a function, or braces: the file cannot be either
        return ast.Expr(ast.Name(text))
