"""Several bodies from the mesh of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .data import MeshData, MeshError


@dataclass(frozen=True)
class Copies:
    """Where a mesh is put, once or on the places of a lattice.

    Attributes
    ----------
    translation : (d,) [m] or None
        Of the first copy.
    rotation : (3,) [rad]
        Rotation vector about the middle of the mesh's bounding box; in the plane only its last entry counts.
    count : (d,) int or None
        Copies along each axis; None: one.
    spacing : (d,) [m] or None
        From one to the next.
    tumbled : int or None
        Seed of random rotations of all copies, each its own, after `rotation`; None: they are turned alike.
    name : str
        What the names of their regions and boundaries begin with; "": they share them with other copies.
    """

    translation: Sequence[float] | None = None
    rotation: Sequence[float] = (0.0, 0.0, 0.0)
    count: Sequence[int] | None = None
    spacing: Sequence[float] | None = None
    tumbled: int | None = None
    name: str = ""

    def placements(self, d: int) -> list[tuple[NDArray, NDArray]]:
        """Rotation (d, d) and translation (d,) [m] of each copy."""
        from scipy.spatial.transform import Rotation

        steps = [range(n) for n in ((1,) * d if self.count is None else self.count)]
        places = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, d)
        turn = Rotation.from_rotvec(self.rotation)
        turns = [turn] * len(places)
        if self.tumbled is not None:
            rng = np.random.default_rng(self.tumbled)
            if d == 3:
                free = Rotation.random(len(places), random_state=np.random.RandomState(rng.integers(1 << 31)))
            else:
                angles = rng.uniform(0, 2 * np.pi, len(places))
                free = Rotation.from_rotvec(angles[:, None] * np.array([0.0, 0.0, 1.0]))
            turns = [one * turn for one in free]
        shift, spacing = (np.zeros(d) if v is None else np.asarray(v) for v in (self.translation, self.spacing))
        shifts = shift + places * spacing
        return [(one.as_matrix()[:d, :d], shift) for one, shift in zip(turns, shifts)]


def copies(data: MeshData, placed: Sequence[Copies]) -> MeshData:
    """The mesh of all copies of `data`, in their order (not collective).

    Raises
    ------
    MeshError
        Where there are more than 20 million cells.
    """
    d = data.dimension
    low, high = data.points.min(axis=0), data.points.max(axis=0)
    middle = (low + high) / 2
    points, regions, facet_tags = [], [], []
    names: tuple[dict[str, int], dict[str, int]] = ({}, {})
    for one in placed:
        tables = []
        for known, given, values in (
            (names[0], data.region_names, data.regions),
            (names[1], data.boundary_names, data.facet_tags),
        ):
            table = np.zeros(max(given.values(), default=0) + 1, dtype=np.int32)
            for name, tag in given.items():
                table[tag] = known.setdefault(f"{one.name}_{name}" if one.name else name, len(known) + 1)
            tables.append(table[values])
        for turn, shift in one.placements(d):
            points.append((data.points - middle) @ turn.T + middle + shift)
            regions.append(tables[0])
            facet_tags.append(tables[1])
    if len(points) * len(data.cells) > 20_000_000:
        raise MeshError(f"{len(points)} copies of {len(data.cells)} cells are more than 20 million; use fewer")
    shifts = np.arange(len(points))[:, None, None] * len(data.points)
    return replace(
        data,
        points=np.concatenate(points),
        cells=(data.cells + shifts).reshape(-1, data.cells.shape[1]),
        regions=np.concatenate(regions),
        facets=(data.facets + shifts).reshape(-1, d),
        facet_tags=np.concatenate(facet_tags),
        region_names=names[0],
        boundary_names=names[1],
    )
