"""Words of others (paths, names of files) in what the terminal shows: as they are, never as markup."""

from __future__ import annotations


def bold(text: object) -> str:
    """Emphasised, whatever it has in it."""
    return f"[bold]{plain(text)}[/]"


def plain(text: object) -> str:
    """As it is, whatever it has in it."""
    from rich.markup import escape

    return escape(str(text))
