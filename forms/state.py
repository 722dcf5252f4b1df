"""A motion as plain arrays in canonical order, for checkpoints."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from .integrators import Motion
from .space import Space


def gather(space: Space, motion: Motion) -> dict[str, NDArray]:
    """The arrays of `motion` (nodes, d) in canonical order on rank 0; {} elsewhere (collective)."""
    function = fem.Function(space.vectors)
    out: dict[str, NDArray] = {}
    for name in ("u", "v", "a", "u_old", "v_old"):
        values = getattr(motion, name)
        if values is None:
            continue
        function.x.array[:] = values
        gathered = space.gather_nodes(function)
        if gathered is not None:
            out[name] = gathered
    if space.comm.rank == 0:
        out["dt_old"] = np.array([motion.dt_old])
    return out


def scatter(space: Space, state: dict[str, NDArray]) -> Motion:
    """The motion that `gather` gave, from rank 0's arrays, on any number of ranks (collective)."""
    names = space.comm.bcast(sorted(state))
    function = fem.Function(space.vectors)
    values: dict[str, Any] = {}
    for name in names:
        if name == "dt_old":
            values[name] = float(space.comm.bcast(state[name][0] if space.comm.rank == 0 else None))
            continue
        space.scatter_nodes(state.get(name), function)
        values[name] = function.x.array.copy()
    return Motion(**values)
