"""Snow and an elastic body push each other: momentum, energy, limits, ranks, restart."""

from __future__ import annotations

import signal
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effects_runs import merged
from mpi4py import MPI
from test_snow_restart import end, finish, last, steps

from extremal.app import cli
from extremal.app.coupled import CoupledProblem
from extremal.app.scene import validate
from extremal.app.scene_errors import literal
from extremal.app.snow import build
from extremal.forms import StepFailure

# a ball of 12.6 kg and a block of 40 kg, both free, in the plane
FREE: dict[str, Any] = tomllib.loads("""
part = "snow"
[grid]
cell_size = 0.03
dimension = 2
[[body]]
shape = "sphere"
center = [-0.11, 0.0]
radius = 0.1
velocity = [5, 0.5]
per_cell = 5
[solid]
friction = 0.3
[solid.mesh]
shape = "box"
dimension = 2
size = [0.1, 0.4]
corner = [-0.005, -0.2]          # not on nodes of the grid: rounding would choose which are inside
cell_size = 0.05
structured = true
[solid.material]
law = "neo_hookean"
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000
extension = "c2"
[analysis]
end_time = 0.03
time_step = 5e-4
[output]
every = 0.01
summary = false
""")
# held, loaded and slowed down in every way that there is
HELD: dict[str, Any] = tomllib.loads("""
[solid]
fixed = [{ where = "y < -0.19" }]
damping = { mass = 20, stiffness = 1e-3 }
traction = [{ boundary = "top", value = [300, "1e4*t"] }]
[solid.contact]
distance = 0.01
[[solid.collider]]
shape = "half_space"
point = [0.115, 0]
normal = [-1, 0]
friction = 0.2
[[collider]]
shape = "half_space"
point = [0, -0.08]
normal = [0, 1]
friction = 0.5
[gravity]
acceleration = [1, -9.81]
""")


def problem(comm: MPI.Intracomm, *changes: dict[str, Any]) -> CoupledProblem:
    tables = FREE
    for change in changes:
        tables = merged(tables, change)
    made = build(validate(tables), comm)
    assert isinstance(made, CoupledProblem)
    return made


def march(made: CoupledProblem, end_time: float, dt: float = 5e-4) -> list[dict[str, float]]:
    """Diagnostics after each step; steps that fail are halved."""
    found = [made.diagnostics()]
    step = dt
    while made.time < end_time * (1 - 1e-9):
        try:
            made.advance(min(step, end_time - made.time))
        except ArithmeticError:
            step /= 2
            assert step > dt / 100
            continue
        found.append(made.diagnostics())
    return found


def close(values: np.ndarray, expected: np.ndarray) -> bool:
    """To 1e-9 of the largest; of a millionth [SI] where all are tiny."""
    a, b = values.astype(float), expected.astype(float)
    return bool(np.abs(a - b).max() <= 1e-9 * max(1e-3, np.abs(b).max()))


# ------------------------------------------------------------------ what is conserved


@pytest.mark.mpi
@pytest.mark.parametrize("integrator", ["backward_euler", "midpoint"])
def test_momentum_is_balanced_in_every_step_whatever_else_acts(integrator: str, comm: MPI.Intracomm) -> None:
    """To what the solvers leave: a residual of 1e-8 of the body's scale of force, 800 N, for each of 60 steps."""
    found = march(problem(comm, HELD, {"solid": {"integrator": integrator}}), 0.03)
    assert max(row["momentum_error"] for row in found) < 1e-6
    assert found[-1]["solid_impulse_x"] > 30
    assert max(row["solid_contact_force"] for row in found) > 100


@pytest.mark.mpi
def test_momentum_of_free_bodies_is_that_of_the_start(comm: MPI.Intracomm) -> None:
    found = march(problem(comm), 0.03)
    for axis in "xy":
        total = [row[f"momentum_{axis}"] + row[f"solid_momentum_{axis}"] for row in found]
        assert total == pytest.approx([total[0]] * len(total), abs=1e-6 * found[0]["momentum_x"])
        assert found[-1][f"solid_impulse_{axis}"] == pytest.approx(found[-1][f"solid_momentum_{axis}"], abs=1e-6)
    assert found[-1]["solid_momentum_x"] > 0.7 * found[0]["momentum_x"]


@pytest.mark.parametrize("density", [10.0, 1000.0])
@pytest.mark.parametrize("beta", [0.0, 1.0])
def test_no_energy_is_gained_on_light_and_heavy_bodies(density: float, beta: float, comm: MPI.Intracomm) -> None:
    change = {"solid": {"material": {"density": density}}, "analysis": {"beta": beta}}
    made = problem(comm, change)
    energy = [row["total_energy"] for row in march(made, 0.03, 2e-4 if beta == 0 else 5e-4)]
    # explicit snow gives back part of what it stored: it is not monotone by itself
    assert max(energy) <= energy[0] * (1 + 1e-9)
    assert energy[-1] < 0.99 * energy[0]


def test_snow_that_sticks_and_its_block_end_as_in_an_inelastic_collision(comm: MPI.Intracomm) -> None:
    """Velocities of the centres of mass to 2%: what still swings in the block is damped within 0.1 s."""
    change = {"solid": {"sticky": True, "damping": {"stiffness": 5e-3}}}
    change |= {"body": [{"velocity": [5, 0]}]}
    tables = merged(FREE, change)
    del tables["solid"]["friction"]
    made = build(validate(tables), comm)
    assert isinstance(made, CoupledProblem)
    found = march(made, 0.1)
    heavy = 0.1 * 0.4 * 1000
    common = found[0]["momentum_x"] / (found[0]["mass"] + heavy)
    assert found[-1]["momentum_x"] / found[-1]["mass"] == pytest.approx(common, rel=0.02)
    assert found[-1]["solid_momentum_x"] / heavy == pytest.approx(common, rel=0.02)


# ------------------------------------------------------------------ limits


def test_a_hard_heavy_block_that_is_held_acts_as_a_rigid_collider(comm: MPI.Intracomm) -> None:
    """To 1e-3 of the momentum of the snow: the block gives way a little."""
    hard = {"material": {"young_modulus": 1e9, "density": 1e5}, "fixed": [{"boundary": "right"}]}
    made = march(problem(comm, {"solid": hard}), 0.02)[-1]
    tables = {key: table for key, table in FREE.items() if key != "solid"}
    wall = {"shape": "box", "low": [-0.005, -0.2], "high": [0.095, 0.2], "friction": 0.3}
    alone = build(validate(tables | {"collider": [wall]}), comm)
    while alone.time < 0.02 * (1 - 1e-9):
        alone.advance(5e-4)
    expected = alone.diagnostics()
    for axis in "xy":
        difference = made[f"momentum_{axis}"] - expected[f"momentum_{axis}"]
        assert abs(difference) < 1e-3 * 63


def test_a_light_stiff_beam_carries_snow(comm: MPI.Intracomm) -> None:
    """A layer of 96 kg comes to rest on a beam of 0.8 kg: reaction = weight to 5%, and nothing sinks in."""
    change = tomllib.loads("""
    [[body]]
    shape = "box"
    low = [-0.3, 0.0]
    high = [0.3, 0.4]
    velocity = [0, 0]
    [solid]
    damping = { stiffness = 0.01 }
    fixed = [{ boundary = ["left", "right"] }]
    mesh = { size = [0.8, 0.1], corner = [-0.4, -0.1] }
    material = { young_modulus = 3e6, density = 10 }
    [gravity]
    acceleration = [0, -9.81]
    """)
    del (tables := merged(FREE, change))["body"][0]["center"], tables["body"][0]["radius"]
    made = build(validate(tables), comm)
    assert isinstance(made, CoupledProblem)
    found = march(made, 0.2, 1e-3)
    late = [row for row in found if row["time"] > 0.1]
    carried = (late[0]["solid_impulse_y"] - late[-1]["solid_impulse_y"]) / (late[-1]["time"] - late[0]["time"])
    assert carried == pytest.approx(9.81 * found[0]["mass"], rel=0.05)
    phi = made._exchange._surface.nearest(made.snow.particles.position).phi
    assert phi.min() > -0.5 * made.h


# ------------------------------------------------------------------ ranks and restart


@pytest.mark.mpi
def test_any_number_of_ranks_gives_the_same(comm: MPI.Intracomm) -> None:
    """To 1e-9: sums are rounded in another order, and friction of the body's own ends its solves by a tolerance."""
    made, alone = problem(comm, HELD), problem(MPI.COMM_SELF, HELD)
    march(made, 0.01)
    march(alone, 0.01)
    found, expected = made.state(), alone.state()
    for name, values in found.items():
        assert close(values, expected[name]), name


@pytest.mark.mpi
def test_a_failed_step_leaves_everything_as_it_was(comm: MPI.Intracomm) -> None:
    made = problem(comm, HELD)
    march(made, 0.005)
    before, rows = made.state(), made.diagnostics()
    with pytest.raises(ArithmeticError):
        made.advance(0.01)
    after = made.state()
    assert made.time == made.snow.time == made.solid.time == 0.005
    assert all(np.array_equal(after[name], values) for name, values in before.items())
    assert made.diagnostics()["total_energy"] == pytest.approx(rows["total_energy"], rel=1e-12)


def test_a_step_too_long_for_the_solid_is_cut_and_grows_again(comm: MPI.Intracomm) -> None:
    made = problem(comm)
    march(made, 0.005)
    whole, limit = made.solid.advance, 2e-4

    def advance(dt: float) -> dict[str, float]:
        if dt > limit:
            raise StepFailure("too long")
        return whole(dt)

    made.solid.advance = advance  # type: ignore[method-assign]
    with pytest.raises(ArithmeticError, match="^solid: too long$") as caught:
        made.advance(5e-4)
    assert caught.value.wanted_step == 2.5e-4  # type: ignore[attr-defined]
    wanted = made.advance(1e-4)["wanted_step"]
    limit = 1.0
    assert wanted == 2.5e-4
    for _ in range(10):
        wanted = made.advance(wanted)["wanted_step"]
    assert wanted > 5e-4


def test_a_solid_that_cannot_be_solved_ends_the_run_with_status_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = merged(FREE, {"solid": {"solver": {"iterations": 1, "tolerance": 1e-13}}, "body": [{"velocity": [9, 0]}]})
    path = tmp_path / "scene.toml"
    path.write_text("".join(f"{key} = {literal(table)}\n" for key, table in tables.items()))
    assert cli.main(["snow", str(path), "-o", str(tmp_path / "out"), "--quiet"]) == 3
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "solid: SNES" in said[0] and "the smallest step" in said[0]


@pytest.mark.parametrize(("before", "after"), [(2, 0), pytest.param(0, 3, marks=pytest.mark.long)])
def test_killed_half_way_a_run_ends_as_if_it_had_not_been(before: int, after: int, tmp_path: Path) -> None:
    """To 1e-9, on another number of ranks too; and ParaView has as many frames of the solid."""
    tables = merged(FREE, {"output": {"checkpoint_every": 7}, "analysis": {"end_time": 0.02}})
    (tmp_path / "scene.toml").write_text("".join(f"{key} = {literal(table)}\n" for key, table in tables.items()))
    whole, folder = tmp_path / "whole", tmp_path / "killed"
    finish(whole, 0)
    end(folder, signal.SIGKILL, before)
    finish(folder, after, "--restart")
    assert steps(folder) == steps(whole)
    (step, state), (last_step, reference) = last(folder), last(whole)
    assert step == last_step
    for name, values in reference.items():
        assert close(state[name], values), name
    frames = sorted(path.name for path in (whole / "solid" / "fields").iterdir())
    assert frames == [f"frame_{i:05d}.vtu" for i in range(3)]
    assert frames == sorted(path.name for path in (folder / "solid" / "fields").iterdir())


# ------------------------------------------------------------------ a run


@pytest.mark.mpi
def test_a_run_leaves_frames_of_the_solid_and_a_picture_of_both(comm: MPI.Intracomm, shared_path: Path) -> None:
    import meshio

    from extremal.app.solid_scene import DIAGNOSTICS

    tables = merged(FREE, {"output": {"summary": True}, "analysis": {"end_time": 0.01}})
    tables["expect"] = {"momentum_error": {"below": 1e-6}, "solid_inverted": 0}
    path, folder = shared_path / "scene.toml", shared_path / "out"
    if comm.rank == 0:
        path.write_text("".join(f"{key} = {literal(table)}\n" for key, table in tables.items()))
    comm.barrier()
    assert cli.main(["snow", str(path), "-o", str(folder), "--quiet"]) == 0
    if comm.rank > 0:
        return
    columns = (folder / "history.csv").read_text().splitlines()[0].split(",")
    absent = {"solid_momentum_z", "solid_impulse_z", "solid_smallest_gap", "solid_contact_force"}
    absent |= {"solid_intersections"}
    assert set(DIAGNOSTICS) - set(columns) == absent
    last_frame = meshio.vtu.read(str(folder / "solid" / "fields" / "frame_00001.vtu"))
    assert {"displacement", "velocity"} <= set(last_frame.point_data) and len(last_frame.cells[0].data) == 32
    assert (folder / "solid" / "fields.pvd").read_text().count("<DataSet") == 2
    assert (folder / "summary.png").stat().st_size > 10_000


def test_the_picture_shows_the_solid_where_it_is(comm: MPI.Intracomm, tmp_path: Path) -> None:
    from extremal.app.results import Series
    from extremal.app.solid_frames import RecordedSolid
    from extremal.obstacles.shapes import Box

    points = np.array([[0, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0], [0, 0.1, 0]], dtype=float)
    (tmp_path / "fields").mkdir()
    series = Series(tmp_path, (points, np.array([[0, 1, 2], [0, 2, 3]]), "triangle"), [])
    for time, shift in ((0.0, 0.0), (1.0, 0.5)):
        series.write(time, {"displacement": np.full((4, 3), shift) * [1, 0, 0]}, {})
    seen = RecordedSolid(tmp_path, 2)
    x = np.random.default_rng(0).uniform(-0.1, 0.9, (500, 2))
    for time, shift in ((0.1, 0.0), (0.9, 0.5)):
        box = Box([shift, 0], [shift + 0.2, 0.1])
        assert np.array(seen.bounds(time)) == pytest.approx(np.array(box.bounds()))
        # linear on cells of 1.3 mm; farther away it is less than φ, but for the margin of two cells round the grid
        found, phi = seen.distance(x, time), box.distance(x)
        near = np.abs(phi) < 2e-3
        assert near.any() and found[near] == pytest.approx(phi[near], abs=1e-3)
        assert (np.sign(found) == np.sign(phi))[~near].all() and (found < phi + 4e-3).all()
