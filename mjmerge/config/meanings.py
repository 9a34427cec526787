"""What the keys of a file mean: the text that stands under each field of a class.

It is for errors, JSON schemas and files to fill in, and is read from the class's source when one of them
asks: pydantic's own ``use_attribute_docstrings`` reads it whenever a class is made, which took a quarter of
the time that importing takes.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from textwrap import dedent

from pydantic import BaseModel


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """By field, in their order; those without are left out. What a ``Field`` says itself comes first."""
    found: dict[str, str] = {}
    for name, field in model.model_fields.items():
        where = next((one for one in model.__mro__ if name in vars(one).get("__annotations__", ())), model)
        if said := field.description or _texts(where).get(name):
            found[name] = said
    return found


@cache
def _texts(cls: type) -> Mapping[str, str]:
    """The texts under the fields that a class declares; none where its source is not to be had."""
    try:
        (tree,) = ast.parse(dedent(inspect.getsource(cls))).body
    except (OSError, TypeError, SyntaxError, ValueError):
        return {}
    found = {}
    for declared, text in pairwise(getattr(tree, "body", ())):
        if isinstance(declared, ast.AnnAssign) and isinstance(declared.target, ast.Name):
            match text:
                case ast.Expr(value=ast.Constant(value=str(said))):
                    found[declared.target.id] = inspect.cleandoc(said)
    return found
