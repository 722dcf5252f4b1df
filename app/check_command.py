"""`extremal check SCENE...`: validate scenes without running them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .elastic_scene import ElasticScene
from .errors import EXIT_FINISHED, InputError
from .hawkes_scene import HawkesScene
from .parallel import on_root
from .scene import read_scene
from .snow_scene import SnowScene

if TYPE_CHECKING:
    from mpi4py import MPI


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the arguments of `extremal check`."""
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="scene files (TOML)")
    parser.add_argument("--cost", action="store_true", help="say what they will take, to a factor of three")


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Print a line for each good scene and raise InputError with a line for each error of all scenes."""
    on_root(comm, lambda: _check(args.scenes, args.cost))
    return EXIT_FINISHED


def _check(paths: Sequence[str], with_cost: bool) -> None:
    errors: list[str] = []
    for path in paths:
        try:
            scene = read_scene(path)
            words = summary(scene)
            # it makes the mesh, and so finds what only the mesh can tell
            cost = _cost(scene) if with_cost else ""
        except InputError as error:
            errors += error.messages
        else:
            print(f"{path}: good: {words}", flush=True)
            if cost:
                print(f"{path}: {cost}", flush=True)
    if errors:
        raise InputError(*errors)


def _cost(scene: Any) -> str:
    from .cost import estimate

    return str(estimate(scene))


def summary(scene: Any) -> str:
    """Return what a scene asks for, in a line.

    Raises
    ------
    InputError
        About the tables of pairs and events that a scene of networks names: they are read.
    """
    if isinstance(scene, HawkesScene):
        parts = _hawkes(scene)
    else:
        parts = _snow(scene) if isinstance(scene, SnowScene) else _elastic(scene)
    if scene.expect:
        parts.append(f"{len(scene.expect)} expected")
    return ", ".join(parts)


def _elastic(scene: ElasticScene) -> list[str]:
    dimension = "" if scene.dimension is None else f" {scene.dimension}D"
    body = scene.mesh.shape or scene.mesh.file
    extension = scene.material.extension
    parts = [
        f"{scene.part}, {body}{dimension}, P{scene.element.degree}",
        scene.material.law + (f" with {extension} extension" if extension != "none" else ""),
        scene.analysis.type,
    ]
    counted = {
        key: len(getattr(scene, key)) for key in ("regions", "fixed", "motion", "traction", "pressure")
    }
    parts += [f"{number} {key}" for key, number in counted.items() if number]
    colliders = [collider.shape for collider in scene.collider]
    parts += [_counted(colliders, "collider", "colliders")] if colliders else []
    parts += ["contact with itself"] if scene.contact is not None and scene.contact.self else []
    present = ("gravity", "damping", "continuation")
    parts += [key for key in present if getattr(scene, key) is not None]
    if scene.initial.state != "rest":
        parts.append(f"starts from {scene.initial.state}")
    return parts


def _snow(scene: SnowScene) -> list[str]:
    analysis = scene.analysis
    laws = dict.fromkeys(scene.material_of(body).law for body in scene.body)
    bodies = [body.shape for body in scene.body]
    colliders = [collider.shape for collider in scene.collider]
    parts = [f"{scene.part} {scene.dimension}D, cells of {scene.cell_size:g} m", "/".join(laws)]
    parts += [_counted(bodies, "body", "bodies")]
    parts += [_counted(colliders, "collider", "colliders")] if colliders else []
    parts.append("explicit" if analysis.beta == 0 else f"implicit with beta {analysis.beta:g}")
    parts += ["gravity"] if scene.gravity is not None else []
    if scene.solid is not None:
        parts.append(f"solid {scene.solid.mesh.shape or scene.solid.mesh.file}")
    return parts


def _hawkes(scene: HawkesScene) -> list[str]:
    from . import hawkes_data

    if scene.simulation is None:
        data = hawkes_data.read(scene)
        network, notes = data.network, data.notes
        events = f"{len(data.events)} events of which {int(data.events.incomplete.sum())} are incomplete"
    else:
        notes = []
        network = hawkes_data.read_network(scene, notes)
        wanted = scene.simulation
        length = f"{wanted.count} events" if wanted.count is not None else f"events until {wanted.duration:g}"
        events = f"{length} simulated of which {wanted.incomplete} become incomplete"
    parts = [f"{scene.part}, {len(network.agents)} agents, {len(network)} pairs", events]
    if scene.estimation is not None:
        parts.append(f"parameters estimated in {scene.estimation.rounds} rounds")
    return [*parts, *notes]


def _counted(shapes: Sequence[str], one: str, many: str) -> str:
    return f"{one} {shapes[0]}" if len(shapes) == 1 else f"{len(shapes)} {many}"
