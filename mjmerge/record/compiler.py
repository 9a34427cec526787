"""The process that compiles an attached world: MJCF on standard input, the binary model on standard output.

A program, not a module: it imports MuJoCo and nothing of ours, so that it starts quickly.
"""

from __future__ import annotations

import sys


def main(most_seconds: int, most_memory_bytes: int) -> int:
    """Compiles within bounds; 0: done, 1: it does not compile, which standard error explains."""
    import mujoco
    import numpy as np

    try:
        import resource
    except ImportError:  # not on this system: the parent's patience remains
        pass
    else:
        resource.setrlimit(resource.RLIMIT_CPU, (most_seconds, most_seconds))
        resource.setrlimit(resource.RLIMIT_AS, (most_memory_bytes, most_memory_bytes))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        model = mujoco.MjModel.from_xml_string(sys.stdin.buffer.read().decode("utf-8", "replace"))
        mujoco.MjData(model)  # what is drawn of it is computed from this
        size = mujoco.mj_sizeModel(model)
        if size > most_memory_bytes // 8:
            raise ValueError(f"the compiled model has {size / 1e6:.0f} MB")
        out = np.empty(size, np.uint8)
        mujoco.mj_saveModel(model, None, out)
    except (ValueError, MemoryError) as error:
        sys.stderr.write(str(error) or "there is not enough memory")
        return 1
    sys.stdout.buffer.write(out.tobytes())
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
