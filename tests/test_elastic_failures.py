"""Bad starts: what every law with every extension makes of them, and how a step fails that has no way out."""

import re

import numpy as np
import pytest
from elastic_bodies import material, on, problem
from mpi4py import MPI

from extremal.forms import Prescribed, StepFailure

pytestmark = pytest.mark.hard
LAWS = ("neo_hookean", "corotated", "fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin")
STARTS = {
    "scatter": ("scatter", {"seed": 1}),
    "mirror": ("mirror", {}),
    "point": ("collapse", {"to": "point"}),
    "line": ("collapse", {"to": "line"}),
    "plane": ("collapse", {"to": "plane"}),
    "nearly a point": ("collapse", {"to": "point", "noise": 1e-3}),
}
HELD = [Prescribed(boundary=("left",))]
REASON = re.compile(
    r"^SNES \w+, KSP \w+ after \d+ Newton iterations, \|F\| = \S+ N \(wanted \S+\); "
    r"worst element \d+ at \(\S+, \S+, \S+\) m: J = \S+, stretches \S+, \S+, \S+$"
)


def cube(comm, law, extension, start, **how):
    """A unit cube of 390 cells, ν = 0.3, one side held at its place."""
    body = problem(
        on(comm, "box", cell_size=0.25),
        material(3, 0.3, law=law, extension=extension),
        prescribed=HELD,
        **how,
    )
    state, more = STARTS[start]
    body.start(state, **more)
    return body


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("law", LAWS)
def test_every_law_with_the_c2_extension_recovers_from_every_start(law, start):
    body = cube(MPI.COMM_SELF, law, "c2", start)
    body.advance(1.0)
    figures = body.diagnostics()
    assert figures["inverted"] == 0
    assert figures["smallest_J"] == pytest.approx(1, abs=1e-5)
    assert figures["max_displacement"] < 1e-5
    assert figures["newton_iterations"] < 100


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("extension", ["c1", "ife"])
@pytest.mark.parametrize("law", LAWS)
def test_no_extended_law_ever_gives_a_number_that_is_not_finite(law, extension, start):
    """C1 and the stress extension need not find the rest state, but they end in numbers, or in a failure."""
    body = cube(MPI.COMM_SELF, law, extension, start)
    before = body.diagnostics()
    residuals = []
    body.on_iteration = lambda figures: residuals.append(figures["residual"])
    try:
        body.advance(1.0)
    except StepFailure as failure:
        assert REASON.match(str(failure))
        assert body.diagnostics()["elastic_energy"] == before["elastic_energy"]
    after = body.diagnostics()
    assert np.all(np.isfinite([*before.values(), *after.values(), *residuals]))


@pytest.mark.parametrize("start", ["point", "line", "plane"])
def test_a_free_collapsed_body_has_no_volume_and_finite_energy(start):
    body = problem(on(MPI.COMM_SELF, "box", cell_size=0.25))
    state, more = STARTS[start]
    body.start(state, **more)
    figures = body.diagnostics()
    assert figures["smallest_J"] == pytest.approx(0, abs=1e-13)
    assert np.isfinite(figures["energy"])
    body.advance(1.0)
    assert body.diagnostics()["smallest_J"] == pytest.approx(1, abs=1e-5)


def test_a_mirrored_body_is_inverted_everywhere():
    body = cube(MPI.COMM_SELF, "neo_hookean", "c2", "mirror")
    free = problem(on(MPI.COMM_SELF, "box", cell_size=0.25))
    free.start("mirror")
    assert free.diagnostics()["inverted"] == len(free.space.domain.original_cells)
    assert free.diagnostics()["smallest_J"] == pytest.approx(-1)
    assert body.diagnostics()["smallest_J"] < -1  # the held side is left behind


@pytest.mark.mpi
@pytest.mark.parametrize(
    "law, extension, start, how, reason",
    [
        ("neo_hookean", "none", "mirror", {}, "SNES DIVERGED_FNORM_NAN"),
        ("neo_hookean", "none", "scatter", {}, "SNES DIVERGED_FNORM_NAN"),
        ("neo_hookean", "c2", "scatter", {"iterations": 3}, "SNES DIVERGED_MAX_IT"),
        ("st_venant_kirchhoff", "none", "point", {}, "SNES DIVERGED_"),
    ],
)
def test_a_failed_step_says_why_and_where_on_all_ranks_and_leaves_the_state(
    comm, law, extension, start, how, reason
):
    body = cube(comm, law, extension, start, **how)
    before, figures = body.state(), body.diagnostics()
    with pytest.raises(StepFailure) as failure:
        body.advance(0.5)
    words = str(failure.value)
    assert comm.allgather(words) == [words] * comm.size
    assert REASON.match(words) and words.startswith(reason)
    assert body.time == 0
    for name, values in body.state().items():
        assert np.array_equal(values, before[name]), name
    again = body.diagnostics()
    assert {k: v for k, v in again.items() if v == v} == {k: v for k, v in figures.items() if v == v}


@pytest.mark.mpi
def test_the_worst_element_is_named_as_in_the_mesh_that_was_given(comm):
    body = cube(comm, "neo_hookean", "none", "scatter")
    fields = body.fields(["J"])
    with pytest.raises(StepFailure) as failure:
        body.advance(1.0)
    found = re.search(r"worst element (\d+) at .* J = (\S+), stretches", str(failure.value))
    if comm.rank == 0:
        J = fields[1]["J"]
        assert int(found[1]) == int(np.argmin(J))
        assert float(found[2]) == pytest.approx(J.min(), rel=1e-2)


@pytest.mark.mpi
def test_a_shorter_step_succeeds_after_a_failed_one(comm):
    """A bar without extension that is pressed to nothing fails; pressed by a third it does not."""
    press = Prescribed(boundary=("right",), motion=lambda x, t: -4.0 * t * np.eye(1, 3, 0) + 0 * x)
    body = problem(on(comm, "bar", cell_size=0.5), material(3, extension="none"), prescribed=[*HELD, press])
    with pytest.raises(StepFailure):
        body.advance(1.2)
    body.advance(0.1)
    assert body.time == 0.1
    assert body.diagnostics()["inverted"] == 0
