"""What a mesh is before it is distributed: plain arrays and names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class MeshError(ValueError):
    """A mesh, or what was asked of a mesh, cannot be used; the message is one line for the user."""


def choose(given: object, accepted: Iterable[str]) -> str:
    """Say what would have been accepted instead of `given`: the nearest name first, then all of them."""
    names = [str(name) for name in accepted]
    if not names:
        return "there are none"
    near = difflib.get_close_matches(str(given), names, n=1, cutoff=0.5)
    listing = "accepted: " + ", ".join(names)
    return f"did you mean '{near[0]}'? {listing}" if near else listing


@dataclass(frozen=True)
class MeshData:
    """A whole simplex mesh with named regions and boundaries.

    Attributes
    ----------
    points : NDArray, shape (n, d)
        Node positions [m]; d = 2 (triangles) or 3 (tetrahedra).
    cells : NDArray of int64, shape (m, k)
        Nodes of each cell: corners first, then for second order the mid-edge nodes in gmsh's order.
    order : int
        1 (triangle3, tetra4) or 2 (triangle6, tetra10).
    regions : NDArray of int32, shape (m,)
        Region of each cell, a value of `region_names`.
    facets : NDArray of int64, shape (f, d)
        Corner nodes of the tagged facets (edges in 2D, triangles in 3D).
    facet_tags : NDArray of int32, shape (f,)
        Tag of each of them, a value of `boundary_names`; a facet has one tag.
    region_names, boundary_names : dict of str to int
        Tag of each name.
    notes : tuple of str
        What was changed or is worth knowing, one line each, from the import of a file.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    order: int
    regions: NDArray[np.int32]
    facets: NDArray[np.int64]
    facet_tags: NDArray[np.int32]
    region_names: dict[str, int]
    boundary_names: dict[str, int]
    notes: tuple[str, ...] = ()

    @property
    def dimension(self) -> int:
        """2 for triangles in the plane, 3 for tetrahedra."""
        return int(self.points.shape[1])

    @property
    def corners(self) -> NDArray[np.int64]:
        """Corner nodes of each cell, shape (m, d + 1)."""
        return self.cells[:, : self.dimension + 1]

    def volumes(self) -> NDArray[np.float64]:
        """Signed volume (in 2D area) of each cell.

        First order: det(x₁-x₀, ..., x_d-x₀)/d!.  Second order: the integral of det(∂x/∂ξ) over the
        reference simplex, exact, so that curved sides count.

        Returns
        -------
        NDArray, shape (m,)
            Signed volumes [m³], or areas [m²]; positive where the cell is well oriented.
        """
        from .quality import cell_volumes

        return cell_volumes(self.points, self.cells, self.order)
