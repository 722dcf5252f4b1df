"""What a scene will take: seconds of one processor and bytes, from counts that are cheap to know and measured rates.

Good to a factor of three, which is enough to tell a minute from a day. How many iterations a step takes is the part
that cannot be known; what is assumed stands in the table of rates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from .elastic_scene import ElasticScene
from .snow_scene import GRADIENTS, SnowScene

if TYPE_CHECKING:
    from .hawkes_scene import HawkesScene

# Measured on one core of an AMD EPYC with PETSc 3.18, as seconds of the processor in runs of the shipped scenes:
# elastic from scattered_cube, twist, recovery, cook and the study elastic-mesh; snow from falling_block,
# elastic_bounce, snowball_drop, wedge and the study snow-effects; hawkes from estimate, incidents, heterogeneous and
# million.
RATES: Mapping[str, float] = MappingProxyType(
    {
        "newton": 1.5e-3,  # [s] an iteration, however small the body
        "cell P1": 3e-6,  # [s] a tetrahedron and iteration; a triangle takes a third
        "cell P2": 2e-5,
        "krylov static": 20,  # CG iterations for each node along the longest side
        "entry": 6e-10,  # [s] an entry of the matrix and Krylov iteration
        "factor": 4e-8,  # [s] times unknowns to the power 1.7: a factorisation of a body in space by MUMPS
        "iterations static": 5,  # of Newton in a step
        "iterations dynamic": 3,
        "iterations tangled": 22,
        "iterations self contact": 17,
        "self contact cell": 7e-6,  # [s] a cell and iteration, where all bodies touch
        "frame cell": 5e-6,  # [s] a cell of a frame
        "frame": 7e-3,  # [s] a frame, however small
        "unknown bytes": 2500,
        "particle": 3.2e-7,  # [s] a particle and explicit step in space; in the plane a third
        "krylov particle": 7.5e-8,  # [s] a particle and CR iteration
        "krylov": 11,  # CR iterations in an implicit step where snow touches something, 1 where it flies
        "collider particle": 1e-7,
        "gradients particle": 1.8e-6,
        "frame particle": 2.3e-6,
        "step snow": 1e-3,
        "solid sweeps": 1.0,  # times Newton's method of the solid: what its collisions with snow take
        "particle bytes": 900,
        "gradients bytes": 600,
        "event": 3e-7,  # [s] an event simulated or read
        "slot": 3e-6,  # [s] a slot in the reconstruction
        "mean field slot": 3e-6,
        "gibbs slot": 1e-7,  # [s] a slot and sample
        "round": 1.5e-3,  # [s] a round of estimation
        "round slot": 1.5e-6,
        "slot bytes": 300,
        "event bytes": 300,
    }
)
# [bytes] that libraries take
LIBRARIES = {"elastic": 190e6, "gmsh": 65e6, "snow": 105e6, "hawkes": 100e6}
SAMPLES = 20_000  # random points that tell how much of its box a body fills


@dataclass(frozen=True)
class Cost:
    """What a scene will take on one rank.

    Attributes
    ----------
    size : str
        Counts, in words.
    steps : float
    bytes : float
        Largest memory of the process.
    seconds_before : float
        Before the first step.
    shares : dict of str to float
        [s] of a step that each effect of the ledger takes.
    """

    size: str
    steps: float
    bytes: float
    seconds_before: float
    shares: dict[str, float]

    @property
    def seconds_per_step(self) -> float:
        """[s]"""
        return sum(self.shares.values())

    def __str__(self) -> str:
        name = max(self.shares, key=lambda effect: self.shares[effect])
        part = self.shares[name] / self.seconds_per_step
        total = self.seconds_before + self.steps * self.seconds_per_step
        return (
            f"{self.size}; about {self.seconds_per_step:.2g} s a step, {self.steps:.3g} steps, {_time(total)} on one "
            f"core, {self.bytes / 1e6:.0f} MB; most goes to {name} ({part:.0%})"
        )


def estimate(scene: Any) -> Cost:
    """What a scene will take; meshes are made and tables are read for it (not collective).

    Raises
    ------
    InputError, MeshError, BodyError
        Where the scene's mesh, tables or bodies cannot be had.
    """
    if isinstance(scene, ElasticScene):
        return _elastic(scene)
    return _snow(scene) if isinstance(scene, SnowScene) else _hawkes(scene)


def _time(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} s"


def _frames(scene: Any, steps: float) -> float:
    """Frames in a step."""
    every = getattr(scene.output, "every", None)
    return 1.0 if every is None else min(1.0, scene.analysis.end_time / every / steps)


# ------------------------------------------------------------------ elastic


def _elastic(scene: ElasticScene) -> Cost:
    from .elastic import mesh_of

    data = mesh_of(scene)
    d, cells, nodes = data.dimension, len(data.cells), len(np.unique(data.corners))
    degree = scene.element.degree
    points = nodes + (nodes + cells if degree == 2 else 0)  # Euler's formula counts the edges
    unknowns = d * points
    row = d * {(2, 1): 7, (2, 2): 12, (3, 1): 14, (3, 2): 27}[d, degree]
    tangled = scene.initial.state != "rest"
    dynamic = scene.analysis.type == "dynamic"
    steps = scene.analysis.end_time / scene.analysis.time_step
    often = RATES["iterations tangled" if tangled else "iterations dynamic" if dynamic else "iterations static"]
    if tangled and dynamic:  # the first steps untangle
        often = RATES["iterations dynamic"] * 2
    meets_itself = scene.contact is not None and scene.contact.self
    if meets_itself:
        often = max(often, RATES["iterations self contact"])
    extent = np.ptp(data.points, axis=0)
    across = float(extent.max()) * (points / float(extent.prod())) ** (1 / d)  # nodes along the longest side
    krylov = RATES["krylov static"] * across / (10 if dynamic else 1)  # inertia makes the matrix a better one
    solve = krylov * unknowns * row * RATES["entry"]
    ν = scene.material.poisson_ratio
    if isinstance(ν, float) and ν > 0.495 and d == 3 and not scene.pressure and not tangled:
        solve = RATES["factor"] * unknowns**1.7
    assembly = RATES["newton"] + cells * RATES[f"cell P{degree}"] / (1 if d == 3 else 3)
    one = often * (assembly + solve)
    frames = _frames(scene, steps)
    if scene.output.iterations is not None:
        frames = often / scene.output.iterations
    shares = {"elasticity": one, "output": frames * (RATES["frame"] + cells * RATES["frame cell"])}
    if meets_itself:
        shares["self_contact"] = often * cells * RATES["self contact cell"] / (1 if d == 3 else 3)
    load = assembly / 10
    if dynamic:
        shares["inertia"] = often * load
    shares |= {name: often * load for name in ("damping",) if getattr(scene, name) is not None}
    shares |= {"traction": load} if scene.traction else {}
    shares |= {"pressure": often * load} if scene.pressure else {}
    if scene.continuation is not None and tangled:
        stages = len(scene.continuation.poisson_ratio) + len(scene.continuation.threshold)
        shares |= {"elasticity": one / (stages + 1), "continuation": one * stages / (stages + 1)}
    libraries = LIBRARIES["elastic"] + (0 if scene.mesh.shape is None else LIBRARIES["gmsh"])
    memory = libraries + unknowns * RATES["unknown bytes"]
    return Cost(f"{cells:,} cells, {unknowns:,} unknowns", steps, memory, 2.0, shares)


# ------------------------------------------------------------------ snow


def _snow(scene: SnowScene) -> Cost:
    n = sum(_particles(scene, i) for i in range(len(scene.body)))
    d, steps = scene.dimension, scene.analysis.end_time / scene.analysis.time_step
    plane = 1.0 if d == 3 else 1 / 3
    shares = {"snow": RATES["step snow"] + n * RATES["particle"] * plane}
    if scene.analysis.beta:
        krylov = RATES["krylov"] if scene.collider or len(scene.body) > 1 else 1.5
        single = 0.95 if scene.analysis.precision == "single" else 1.0
        shares["implicit"] = krylov * (n * RATES["krylov particle"] * plane * single + RATES["step snow"] / 10)
    if scene.collider:
        shares["colliders"] = len(scene.collider) * n * RATES["collider particle"]
    wants_gradients = any(name in GRADIENTS for name in scene.output.fields or ())
    if wants_gradients:
        shares["gradients"] = n * RATES["gradients particle"]
    shares["output"] = _frames(scene, steps) * (RATES["frame"] + n * RATES["frame particle"])
    alone = None if scene.solid is None else _elastic(scene.solid.elastic(scene))
    if alone is not None:
        shares["solid"] = alone.seconds_per_step + RATES["solid sweeps"] * alone.shares["elasticity"]
    memory = LIBRARIES["snow"] + n * (RATES["particle bytes"] + (RATES["gradients bytes"] if wants_gradients else 0))
    if alone is not None:
        words = f"{n:,.0f} particles and {alone.size}"
        return Cost(words, steps, memory + alone.bytes, 1.0 + alone.seconds_before, shares)
    return Cost(f"{n:,.0f} particles", steps, memory, 1.0, shares)


def _particles(scene: SnowScene, i: int) -> float:
    """Particles of a body, to a per cent: from random points in its bounds."""
    from .snow import body_shape

    body = scene.body[i]
    shape = body_shape(scene, i)
    low, high = (np.asarray(corner, dtype=float) for corner in shape.bounds())
    inside = shape.inside(np.random.default_rng(0).uniform(low, high, (SAMPLES, scene.dimension)))
    cells = math.prod(((high - low) / scene.cell_size).tolist())
    return float(np.mean(inside)) * cells * body.per_cell


# ------------------------------------------------------------------ hawkes


def _hawkes(scene: HawkesScene) -> Cost:
    from . import hawkes_data

    m = scene.method
    if scene.simulation is None:
        data = hawkes_data.read(scene)
        network, events = data.network, float(len(data.events))
        missing = (data.events.participants < 0).sum(axis=1)
        one, both = float((missing == 1).sum()), float((missing == 2).sum())
    else:
        network, s = hawkes_data.read_network(scene, []), scene.simulation
        events = float(s.count if s.count is not None else s.duration * _rate(network))  # type: ignore[operator]
        hidden = min(events, float(s.incomplete))
        one, both = (hidden, 0.0) if s.missing == "one" else (0.0, hidden)
    degrees = np.bincount(network.pairs.ravel())
    mean = float((degrees**2).sum() / max(1, degrees.sum()))  # of who takes part, not of agents
    slots = one * mean + both * len(network)
    rounds = scene.estimation.rounds if scene.estimation is not None else 0
    steps = rounds + 1
    last = {"reconstruction": slots * RATES["slot"]}
    if m.probabilities == "gibbs":
        last["gibbs"] = 4 * m.samples * slots * RATES["gibbs slot"]
    elif m.probabilities == "exact":
        last["exact"] = min(1e300, max(1.0, mean) ** min(one + both, 500.0)) * 1e-8
    elif m.probabilities == "mean_field":
        last["mean_field"] = (slots + events) * RATES["mean field slot"]
    shares = {name: seconds / steps for name, seconds in last.items()}
    if rounds:
        shares["estimation"] = rounds / steps * (RATES["round"] + (slots + events) * RATES["round slot"])
    shares["output"] = (RATES["frame"] * 5 + slots * 1e-6) / steps
    memory = LIBRARIES["hawkes"] + slots * RATES["slot bytes"] + events * RATES["event bytes"]
    before = 1.0 + events * RATES["event"]
    return Cost(f"{events:,.0f} events, {slots:,.0f} slots", steps, memory, before, shares)


def _rate(network: Any) -> float:
    """Events in a unit of time, of all pairs."""
    return float((network.background / np.maximum(1e-3, 1 - network.branching)).sum())
