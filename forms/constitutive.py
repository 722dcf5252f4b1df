"""The materials of a body at its quadrature points: energy, stress and tangent where the displacement is now."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from .kernel import Kernel
from .laws import LawError
from .material import Material, density_at
from .space import Space


@dataclass
class _Group:
    """Points with the same law and extension."""

    material: Material
    kernel: Kernel
    points: NDArray | slice
    positions: NDArray  # (points, 3) centres of the points' cells
    values: NDArray  # (1 or points, parameters)


class Constitutive:
    """Ψ, P and ∂P/∂F of all materials at the points of `space`, from the displacement `space.u`.

    Parameters
    ----------
    space : Space
    materials : mapping of region name to Material
        One for each region of the domain.

    Attributes
    ----------
    energy, stress, tangent : dolfinx.fem.Function
        At the points: scalar, (d*d,) and (d*d, d*d) [Pa]; filled by `update`.
    gradient : (points, d*d)
        Displacement gradient of the last update.
    skipped : int
        Points of the last update that needed no stretches, on this rank.
    """

    def __init__(self, space: Space, materials: Mapping[str, Material]) -> None:
        self.space = space
        d = space.dimension
        self.energy = space.function_at_points()
        self.stress = space.function_at_points((d, d))
        self._tangent: fem.Function | None = None
        self.gradient = np.zeros((space.point_of.size, d * d))
        self.skipped = 0
        self.has_energy = all(material.extension != "ife" for material in materials.values())
        self.is_extended = any(material.extension != "none" for material in materials.values())
        self._groups = agree(space.comm, lambda: self._make_groups(materials))
        for group in self._groups:
            group.kernel = Kernel(group.material.law, group.material.extension, space.comm)
        self.stage()

    def _make_groups(self, materials: Mapping[str, Material]) -> list[_Group]:
        domain = self.space.domain
        missing = [name for name in domain.region_names if name not in materials]
        if missing:
            raise LawError(f"region {missing[0]!r} has no material")
        midpoints = self.space.midpoints()
        groups = []
        for name, material in materials.items():
            if len(materials) == 1:
                points: NDArray | slice = slice(None)
                cells = self.space.point_cells
            else:
                inside = np.zeros(self.space.cells, dtype=bool)
                inside[domain.cells(name)] = True
                points = np.flatnonzero(inside[self.space.point_cells])
                cells = self.space.point_cells[points]
            groups.append(_Group(material, None, points, midpoints[cells], np.empty(0)))  # type: ignore[arg-type]
        return groups

    def stage(self, poisson_ratio: float | None = None, threshold: float | None = None) -> None:
        """Use the materials with ν at most `poisson_ratio` and the threshold ε = `threshold` (collective)."""

        def fill() -> None:
            for group in self._groups:
                given = (*group.material.moduli.values(), *group.material.parameters.values())
                varies = any(callable(value) for value in given)
                x = group.positions if varies else np.zeros((1, 3))
                group.values = np.ascontiguousarray(group.material.values(x, poisson_ratio, threshold))

        agree(self.space.comm, fill)

    @property
    def tangent(self) -> fem.Function:
        """∂P/∂F, allocated when first asked for."""
        if self._tangent is None:
            size = self.space.dimension**2
            self._tangent = self.space.function_at_points((size, size))
        return self._tangent

    def update(
        self, *, energy: bool = False, stress: bool = False, tangent: bool = False, project: bool = True
    ) -> None:
        """Evaluate what is asked for at the present displacement (ghosts of `space.u` up to date)."""
        self.space.gradient(self.gradient)
        size = self.space.dimension**2
        arrays = {
            "energy": self.energy.x.array if energy else None,
            "stress": self.stress.x.array.reshape(-1, size) if stress else None,
            "tangent": self.tangent.x.array.reshape(-1, size, size) if tangent else None,
        }
        self.skipped = 0
        with np.errstate(all="ignore"):
            for group in self._groups:
                self._evaluate(group, arrays, project)

    def _evaluate(self, group: _Group, arrays: dict[str, NDArray | None], project: bool) -> None:
        if isinstance(group.points, slice):
            self.skipped += group.kernel.evaluate(self.gradient, group.values, project=project, **arrays)
            return
        gradient = self.gradient[group.points]
        parts = {name: np.empty((len(gradient), *a.shape[1:])) for name, a in arrays.items() if a is not None}
        self.skipped += group.kernel.evaluate(gradient, group.values, project=project, **parts)
        for name, part in parts.items():
            arrays[name][group.points] = part  # type: ignore[index]

    def stretches(self) -> NDArray:
        """(points, d) stretches at the gradient of the last update."""
        return self._groups[0].kernel.stretches(self.gradient)

    def determinants(self) -> NDArray:
        """(points,) J at the gradient of the last update, or as `Space.gradient` has filled it."""
        d = self.space.dimension
        return np.linalg.det(self.gradient.reshape(-1, d, d) + np.eye(d))

    def largest_poisson_ratio(self) -> float:
        """Largest ν of the body, the same on all ranks."""
        largest = [float(g.material.engineering(g.positions)[1].max(initial=0)) for g in self._groups]
        return self.space.comm.allreduce(max(largest, default=0.0), op=MPI.MAX)

    def density(self) -> NDArray:
        """ρ [kg/m³] of each local cell."""

        def fill() -> NDArray:
            out = np.empty(self.space.point_of.size)
            for group in self._groups:
                out[group.points] = density_at(group.material, group.positions)
            return out[self.space.point_of[:, 0]]

        return agree(self.space.comm, fill)

    def stiffness_scale(self) -> float:
        """Largest Young's modulus of the body [Pa], the same on all ranks."""
        largest = [float(g.material.engineering(g.positions)[0].max(initial=0)) for g in self._groups]
        return self.space.comm.allreduce(max(largest, default=0.0), op=MPI.MAX) or 1.0

    def warnings(self) -> list[str]:
        """What the user should know about the parameters, the same on all ranks."""
        found = [text for group in self._groups for text in group.material.warnings(group.positions)]
        return sorted(set(sum(self.space.comm.allgather(found), [])))


def agree(comm: MPI.Comm, action: Callable[[], Any]) -> Any:
    """Do `action` on every rank; where it raises on some, raise the error of the lowest of them on all."""
    result, error = None, None
    try:
        result = action()
    except Exception as found:
        error = found
    errors = [e for e in comm.allgather(error) if e is not None]
    if errors:
        raise error if error is not None and error is errors[0] else errors[0]
    return result
