"""Checks between the tables of a scene of networks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from .scene_common import Check, expectations, petsc_names
from .scene_fields import Problem

if TYPE_CHECKING:
    from .hawkes_scene import HawkesScene


def _source_of_events(scene: HawkesScene) -> Iterator[Problem]:
    if scene.events is None and scene.simulation is None:
        yield ("events",), "is missing; give [events] with a file, or [simulation]"
    if scene.events is not None and scene.simulation is not None:
        yield ("simulation",), "is given instead of [events]; leave one of them out"


def _simulation(scene: HawkesScene) -> Iterator[Problem]:
    if scene.simulation is None or scene.network.file is not None:
        return
    if scene.network.background == 0:
        yield ("network", "background"), "must be above 0 for a [simulation]: nothing would ever happen"
    if scene.simulation.duration is not None and scene.network.branching >= 1:
        yield ("network", "branching"), "must be below 1 for a [simulation] of a duration: events would multiply"


def _expectations(scene: HawkesScene) -> Iterator[Problem]:
    from .hawkes_scene import DIAGNOSTICS, SCORES

    yield from expectations(scene.expect, DIAGNOSTICS)
    for name in scene.expect:
        if name in SCORES and scene.simulation is None:
            yield ("expect", name), "needs [simulation]: the truth of other events is not known"
        elif (name == "log_loss" or name.endswith("_probabilities")) and scene.method.probabilities == "none":
            yield ("expect", name), 'needs [method] probabilities other than "none"'
        elif name == "drift" and scene.estimation is None:
            yield ("expect", name), "needs [estimation]"
        elif name in ("gap", "tao_iterations") and not scene.method.is_default:
            yield ("expect", name), "belongs to (3.5), which [method] replaces"


CHECKS: tuple[Check, ...] = (
    ({"events", "simulation"}, _source_of_events),
    ({"network", "simulation"}, _simulation),
    (set(), petsc_names),
    ({"simulation", "method", "estimation"}, _expectations),
)
