"""Environments for learning: an agent drives the ego in the law's place, or a neighbour against the law.

Importing this room makes ``mjmerge/Merge-v0`` and ``mjmerge/Adversary-v0`` known to gymnasium, where it is
installed; :mod:`mjmerge.envs.dm` has them for dm_env.
"""

from importlib.util import find_spec

IDS = {"mjmerge/Merge-v0": "merge", "mjmerge/Adversary-v0": "adversary"}
"""Names in gymnasium, and what makes them in :mod:`~mjmerge.envs.single` and :mod:`~mjmerge.envs.vector`."""


def _register() -> None:
    import gymnasium  # an extra

    for name, maker in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"mjmerge.envs.single:{maker}",
                vector_entry_point=f"mjmerge.envs.vector:{maker}",
            )


if find_spec("gymnasium") is not None:
    _register()
