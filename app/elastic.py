"""From a scene to an elastic problem: mesh, materials, conditions, start."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from extremal import forms, meshes

from .elastic_checks import check_bodies, check_on_mesh
from .errors import InputError
from .expression import function_of, numeric, parse, parse_condition
from .keyframes import rigid_motion
from .parallel import on_root
from .scene_fields import SPACE, SPACE_TIME

if TYPE_CHECKING:
    from extremal.obstacles.colliders import Collider

    from .conditions_scene import Motion
    from .elastic_scene import Body, ElasticScene
    from .material_scene import Material

_ENERGY_NAMES = ("i1", "i2", "J", "I1", "I2", "s1", "s2", "s3", "d", "mu", "lam")


def build(scene: ElasticScene, comm: MPI.Comm) -> forms.ElasticProblem:
    """The problem a scene describes, at its start (collective).

    Raises
    ------
    InputError
        On all ranks, where mesh, names or values do not fit together.
    """
    name = str(scene.path or "scene")
    kept: list[meshes.MeshData] = []  # the mesh stays on rank 0
    dimension = on_root(comm, lambda: _read(scene, kept))
    data = kept[0] if kept else None
    try:
        domain = meshes.distribute(comm, data)
        problem = _problem(scene, domain, dimension)
        notes = [*(data.notes if data is not None else ()), *problem.laws.warnings()]
        _start(scene, problem)
    except (meshes.MeshError, forms.LawError) as error:
        raise InputError(f"{name}: {error}") from None
    if comm.rank == 0:
        for note in notes:
            print(f"{name}: note: {note}", file=sys.stderr)
    return problem


def _read(scene: ElasticScene, kept: list[meshes.MeshData]) -> int:
    data = mesh_of(scene)
    check_on_mesh(scene, data.boundary_names, data.region_names, data.dimension)
    kept.append(data)
    return data.dimension


def mesh_of(scene: ElasticScene) -> meshes.MeshData:
    """The mesh of a scene, made or read (not collective); raises InputError."""
    try:
        if scene.mesh_file is not None:
            order = scene.mesh.order if "order" in scene.mesh.model_fields_set else None
            data = meshes.read_mesh(scene.mesh_file, cell_size=scene.mesh.cell_size, order=order)
        else:
            data = meshes.generate(str(scene.mesh.shape), **scene.mesh.parameters)
        if not scene.mesh.body:
            return data
        check_bodies(scene, data.dimension)
        return meshes.copies(data, [_copies(one) for one in scene.mesh.body])
    except meshes.MeshError as error:
        raise InputError(f"{scene.path or 'scene'}: [mesh] {error}") from None


def _copies(one: Body) -> meshes.Copies:
    turn = one.rotation or 0.0
    return meshes.Copies(
        translation=one.translation,
        rotation=turn if isinstance(turn, tuple) else (0.0, 0.0, turn),
        count=one.count,
        spacing=one.spacing,
        tumbled=one.tumbled,
        name=one.name or "",
    )


def _problem(scene: ElasticScene, domain: meshes.Domain, dimension: int) -> forms.ElasticProblem:
    analysis, damping = scene.analysis, scene.damping
    prescribed = [
        forms.Prescribed(**_place(one), components=_components(one.components)) for one in scene.fixed
    ]
    for one in scene.motion:
        prescribed += _moved(one, dimension)
    return forms.ElasticProblem(
        domain,
        {region: _material(scene.material_of(region), dimension) for region in domain.region_names},
        degree=scene.element.degree,
        prescribed=prescribed,
        tractions=[(one.boundary, _vector(one.value, SPACE_TIME)) for one in scene.traction],
        pressures=[(one.boundary, _scalar(one.value)) for one in scene.pressure],
        gravity=scene.gravity.acceleration if scene.gravity else None,
        integrator=analysis.integrator if analysis.type == "dynamic" else None,
        damping=(damping.mass, damping.stiffness) if damping else (0.0, 0.0),
        stages=_stages(scene),
        tolerance=scene.solver.tolerance,
        iterations=scene.solver.iterations,
        exact_tangent=scene.solver.tangent == "exact",
        error_tolerance=analysis.error_tolerance,
        obstacles=_obstacles(scene, dimension),
        contact=scene.contact.model_dump() if scene.contact is not None else None,
    )


def _obstacles(scene: ElasticScene, dimension: int) -> Sequence[Collider]:
    if not scene.collider:
        return ()
    from .colliders import colliders

    return colliders(scene, scene.collider, dimension)


def _stages(scene: ElasticScene) -> list[forms.Stage]:
    """ν rises first, with the first threshold; then the threshold goes through its own stages."""
    if scene.continuation is None:
        return []
    thresholds = scene.continuation.threshold
    first = thresholds[0] if thresholds else None
    stages = [forms.Stage(ν, first) for ν in scene.continuation.poisson_ratio]
    return stages + [forms.Stage(threshold=ε) for ε in thresholds]


def _start(scene: ElasticScene, problem: forms.ElasticProblem) -> None:
    start = scene.initial
    every: dict[str, dict[str, Any]] = {
        "rest": {},
        "scatter": {"amplitude": start.amplitude, "seed": start.seed},
        "collapse": {"to": start.to, "axis": start.axis, "noise": start.noise, "seed": start.seed},
        "mirror": {"axis": start.axis},
    }
    velocity = None
    if start.velocity is not None:
        field = _vector(start.velocity, SPACE)
        velocity = lambda x: field(x, 0.0)  # noqa: E731
    problem.start(start.state, velocity, **every[start.state])


# ---------------------------------------------------------------------------------------- materials


def _material(table: Material, dimension: int) -> forms.Material:
    moduli = {
        key: _field(getattr(table, key))
        for key in ("young_modulus", "poisson_ratio", "shear_modulus", "lame_lambda")
        if getattr(table, key) is not None
    }
    parameters = {key: _field(value) for key, value in table.parameters.items()}
    if table.law == "custom":
        symbols = parse(str(table.energy), [*_ENERGY_NAMES, *table.parameters])
        law = forms.custom(symbols, dimension, tuple(table.parameters))
    else:
        law = forms.law(table.law, dimension)
    if table.c1 is not None and table.c2 is not None:
        parameters["share"] = table.c2 / (table.c1 + table.c2)
        moduli |= _mooney_rivlin(2 * (table.c1 + table.c2), moduli)
    return forms.Material(
        law,
        moduli,
        parameters,
        density=1.0 if table.density is None else _field(table.density),
        extension=table.extension,
        threshold=table.threshold,
        stiffness=table.stiffness,
    )


def _mooney_rivlin(shear_modulus: float, moduli: dict[str, Any]) -> dict[str, Any]:
    """The modulus that c1 and c2 leave open, in the form that goes with the one given."""
    if "lame_lambda" in moduli:
        return {"shear_modulus": shear_modulus}
    ν = moduli["poisson_ratio"]
    if callable(ν):
        return {"young_modulus": lambda x: 2 * shear_modulus * (1 + ν(x))}
    return {"young_modulus": 2 * shear_modulus * (1 + ν)}


def _field(value: float | str) -> forms.Field:
    if not isinstance(value, str):
        return value
    function = function_of(value, SPACE)
    return lambda x: function(*_columns(x, SPACE))


# ---------------------------------------------------------------------------------------- conditions


def _columns(x: NDArray, names: Sequence[str]) -> list[NDArray]:
    """One array for each of `names`; a plane body has z = 0."""
    return [x[:, k] if k < x.shape[1] else np.zeros(len(x)) for k in range(3)][: len(names)]


def _place(one: Any) -> dict[str, Any]:
    if one.where is None:
        return {"boundary": one.boundary}
    chosen = numeric(parse_condition(one.where, SPACE), SPACE)
    return {"where": lambda x: np.broadcast_to(chosen(*_columns(x, SPACE)), (len(x),))}


def _components(names: Sequence[str]) -> tuple[int, ...]:
    return tuple(SPACE.index(name) for name in names)


def _vector(values: Sequence[float | str], names: Sequence[str]) -> Callable[[NDArray, float], NDArray]:
    """Function of positions (n, d) and time giving (n, d)."""
    functions = [function_of(value, names) for value in values]

    def at(x: NDArray, time: float) -> NDArray:
        arguments = _columns(x, SPACE) + [np.full(len(x), time)] * (len(names) - 3)
        return np.column_stack([f(*arguments) for f in functions[: x.shape[1]]])

    return at


def _scalar(value: float | str) -> Callable[[NDArray, float], NDArray]:
    function = function_of(value, SPACE_TIME)
    return lambda x, time: function(*_columns(x, SPACE), np.full(len(x), time))


def _moved(one: Motion, dimension: int) -> list[forms.Prescribed]:
    place = _place(one)
    if one.keyframes is not None:
        every = tuple(range(dimension))
        return [forms.Prescribed(**place, components=every, motion=rigid_motion(one.keyframes, dimension))]
    assert one.displacement is not None
    given = tuple(k for k, value in enumerate(one.displacement) if value is not None)
    values = [0.0 if value is None else value for value in one.displacement]
    return [forms.Prescribed(**place, components=given, motion=_vector(values, SPACE_TIME))]
