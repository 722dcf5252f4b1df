"""The hard cases of elasticity: a body, a start and what is done to it.

The body is the unit cube with its left face (x = 0) held, E = 1 Pa, ρ = 1 kg/m³ and, unless said, ν = 0.3. Every case
ends where rest is the only right answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .recovery import ITERATIONS, TOLERANCE

if TYPE_CHECKING:
    from extremal.forms import Field, Prescribed
    from extremal.meshes import Domain, MeshData

SEEDS, FEWER, FEWEST = 10, 5, 3  # random starts
THIN = 0.01  # thickness of the flat elements over their length
CONTRAST = 1e6
MANY, FEW = 60, 20  # time steps where they are long and where they are short
PATIENCE = 1500  # Newton iterations where a stiff part has to turn


@dataclass(frozen=True)
class Case:
    """One row of the map.

    Attributes
    ----------
    group, label : str
    start : str
        A function of `forms.initial`, or "rest"; `how` is passed to it.
    seeds : int
        Random starts; 1 where there is nothing random.
    poisson_ratio : float
    mesh : str
        A key of `MESHES`.
    young_modulus : float or function of positions (n, 3) [m]
        [Pa]
    motion : callable or None
        Displacement [m] of `moved` as a function of positions (n, d) and time: out from 0 to 1 s, back from 1 to 2 s.
    moved : str
        The boundary that `motion` moves.
    dt : float or None
        Step [s] of backward Euler; None for equilibrium.
    tolerance : float
        Of |F| relative to E V^(2/3).
    iterations : int
        Most Newton iterations of a step.
    """

    group: str
    label: str
    start: str = "rest"
    how: dict[str, Any] = field(default_factory=dict)
    seeds: int = 1
    poisson_ratio: float = 0.3
    mesh: str = "cube"
    young_modulus: Field = 1.0
    motion: Callable[[NDArray, float], NDArray] | None = None
    moved: str = "right"
    dt: float | None = None
    tolerance: float = TOLERANCE
    iterations: int = ITERATIONS

    @property
    def name(self) -> str:
        """What the table calls it."""
        return f"{self.group}: {self.label}"

    @property
    def steps(self) -> Sequence[float]:
        """Lengths of the steps [s]."""
        if self.dt is not None:
            return [self.dt] * (MANY if self.dt >= 1 else FEW)
        return [1.0, 1.0] if self.motion else [1.0]

    def prescribed(self) -> list[Prescribed]:
        """The moved boundary, if any."""
        from extremal.forms import Prescribed

        return [Prescribed(boundary=(self.moved,), motion=self.motion)] if self.motion else []

    def begin(self, seed: int) -> dict[str, Any]:
        """Arguments of `ElasticProblem.start`."""
        return {"state": self.start, **self.how, **({"seed": seed} if self.seeds > 1 else {})}


def _there_and_back(gradient: Sequence[Sequence[float]]) -> Callable[[NDArray, float], NDArray]:
    """Out along straight lines to (F - I)(x - c) with c in the middle of the held face, and back."""
    H, c = np.array(gradient, dtype=float) - np.eye(3), np.array([0.0, 0.5, 0.5])
    return lambda x, t: min(t, 2.0 - t) * (x - c) @ H.T


def _half(stiff_left: bool) -> Callable[[NDArray], NDArray]:
    return lambda x: np.where((x[:, 0] < 0.5) == stiff_left, CONTRAST, 1.0)


def _diagonal(*stretches: float) -> dict[str, Any]:
    return {"gradient": np.diag(stretches)}


SCATTER = {"amplitude": 1.0}
# the tolerance is a part of the largest E: 1e-8 of the soft half is 1e-14 of the stiff one
CONTRASTED: dict[str, Any] = {"tolerance": TOLERANCE / CONTRAST, "iterations": PATIENCE}
TURN_X, TURN_Z = _diagonal(1, -1, -1), _diagonal(-1, -1, 1)
CASES = (
    Case("collapse", "point", "collapse", {"to": "point"}),
    Case("collapse", "point, noise 0.001", "collapse", {"to": "point", "noise": 1e-3}, SEEDS),
    Case("collapse", "line", "collapse", {"to": "line"}),
    Case("collapse", "plane", "collapse", {"to": "plane"}),
    Case("scatter", "half the box", "scatter", {"amplitude": 0.5}, SEEDS),
    Case("scatter", "the box", "scatter", SCATTER, SEEDS),
    Case("scatter", "twice the box", "scatter", {"amplitude": 2.0}, SEEDS),
    Case("mirror", "mirrored in x", "mirror", {"axis": "x"}),
    Case("mirror", "mirrored in z", "mirror", {"axis": "z"}),
    Case("mirror", "F = -I", "affine", _diagonal(-1, -1, -1)),
    Case("turn", "180° about x", "affine", TURN_X),
    Case("turn", "180° about z", "affine", TURN_Z),
    Case("turn", "end twisted by 180°", motion=_there_and_back(TURN_X["gradient"])),
    *(Case("kink", f"σ2 + σ3 = {gap:g}", "affine", _diagonal(1.3, 0.6, gap - 0.6)) for gap in (1e-2, 1e-5, 1e-8, 0)),
    *(Case("equal stretches", f"F = {s:g} I", "affine", _diagonal(s, s, s)) for s in (0.1, 0.5, 3)),
    Case("threshold", "J = 0.9, equal σ", "affine", _diagonal(*[0.9 ** (1 / 3)] * 3)),
    Case("threshold", "J = 0.9 - 1e-12", "affine", _diagonal(1, 1, 0.9 - 1e-12)),
    Case("threshold", "J = 0.9 + 1e-12", "affine", _diagonal(1, 1, 0.9 + 1e-12)),
    Case("threshold", "σ3 = 0.4 (of C1)", "affine", _diagonal(1, 1, 0.4)),
    *(Case("ν", f"ν = {ν:g}", "scatter", SCATTER, FEWER, ν) for ν in (0.0, 0.45, 0.49, 0.499, 0.4999)),
    Case("slivers", "a layer", "scatter", SCATTER, FEWEST, mesh="layer"),
    Case("slivers", "all elements", "scatter", SCATTER, FEWER, mesh="plate", tolerance=1e-12),
    Case("contrast 1e6", "stiff half held", "scatter", SCATTER, FEWEST, young_modulus=_half(True), **CONTRASTED),
    Case("contrast 1e6", "soft half held", "scatter", SCATTER, FEWEST, young_modulus=_half(False), **CONTRASTED),
    *(Case("time step", f"{dt:g} s", "scatter", SCATTER, FEWEST, dt=dt) for dt in (1e-6, 1e-4, 1e-2, 1.0, 10.0)),
    Case("boundary", "×10 in one step", motion=_there_and_back(np.diag([10.0, 1, 1]).tolist())),
    Case("boundary", "×0.1 in one step", motion=_there_and_back(np.diag([0.1, 1, 1]).tolist())),
    Case("boundary", "end through the other", motion=_there_and_back(np.diag([-1.0, 1, 1]).tolist())),
    Case(
        "boundary", "surface mirrored", motion=_there_and_back(np.diag([1.0, 1, -1]).tolist()), moved="surface"
    ),
)


def domains(cell_size: float, wanted: set[str]) -> dict[str, Domain]:
    """The meshes, each on this rank alone."""
    from mpi4py import MPI

    from extremal import meshes

    return {name: meshes.distribute(MPI.COMM_SELF, MESHES[name](cell_size)) for name in sorted(wanted)}


def _cube(cell_size: float) -> MeshData:
    from extremal import meshes

    return meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=cell_size)


def _plate(cell_size: float) -> MeshData:
    """A plate a hundredth as thick as it is long: every element is flat."""
    return _flattened(cell_size, lambda z: THIN * z)


def _layer(cell_size: float) -> MeshData:
    """A cube, one layer of whose elements is flat."""

    def squeeze(z: NDArray) -> NDArray:
        levels = np.unique(z)
        low, high = levels[len(levels) // 2 - 1 :][:2]
        return np.interp(z, [0, low, high, 1], [0, low, low + THIN * cell_size, 1])

    return _flattened(cell_size, squeeze)


def _flattened(cell_size: float, squeeze: Callable[[NDArray], NDArray]) -> MeshData:
    from extremal import meshes

    data = meshes.generate("box", size=[1.0, 1.0, 1.0], cell_size=cell_size, structured=True)
    points = data.points.copy()
    points[:, 2] = squeeze(points[:, 2])
    return meshes.repair(replace(data, points=points), "flat elements")


MESHES: dict[str, Callable[[float], MeshData]] = {"cube": _cube, "layer": _layer, "plate": _plate}


def refusal(cell_size: float) -> str:
    """What is said of the cube if one element has no volume."""
    from extremal import meshes

    data = _cube(cell_size)
    points = data.points.copy()
    a, b, c, d = data.corners[0]
    points[d] = (points[a] + points[b] + points[c]) / 3
    try:
        meshes.repair(replace(data, points=points), "cube.msh")
    except meshes.MeshError as error:
        return str(error)
    return ""
