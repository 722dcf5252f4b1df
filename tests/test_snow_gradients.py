"""F_E and F_P: carried only when asked for as output, then consistent with all else that a particle carries."""

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from snow_reference import ball, share, unpack

from extremal.app import cli
from extremal.app.snow_scene import GRADIENTS, PARTICLE_FIELDS
from extremal.mpm import gradients
from extremal.mpm.law import Law
from extremal.mpm.problem import SnowProblem
from extremal.obstacles.colliders import Contact, Rigid
from extremal.obstacles.shapes import HalfSpace

SERIAL = MPI.COMM_SELF
H, RADIUS = 0.05, 0.15
LAWS = {"snow": Law(), "fixed_corotated": Law("fixed_corotated", 2e5)}

SCENE = """
part = "snow"
[grid]
cell_size = 0.05
dimension = {d}
[[body]]
shape = "sphere"
center = {center}
radius = 0.12
per_cell = 4
velocity = {velocity}
[[collider]]
shape = "half_space"
point = {origin}
normal = {up}
friction = 0.5
[analysis]
end_time = {end}
time_step = 1e-3
[output]
every = 0.01
fields = {fields}
summary = false
[expect]
status = "finished"
"""


def smashed(d: int, law: str, comm: MPI.Comm = SERIAL, steps: int = 30, **options: object) -> SnowProblem:
    """A ball after it has hit the ground obliquely."""
    up = np.eye(d)[-1]
    p = ball(d, H, RADIUS, 0.17 * up, 2 * np.eye(d)[0] - 6 * up)
    ground = Rigid(HalfSpace([0.0] * d, up), Contact(friction=0.5))
    made = SnowProblem(comm, share(p, comm), [LAWS[law]], cell_size=H, colliders=[ground], **options)
    for _ in range(steps):
        made.advance(5e-4)
    return made


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("d", [2, 3])
def test_the_product_is_the_whole_deformation_and_each_factor_is_what_w_and_j_p_say(d, law, monkeypatch):
    total = {}

    def follow(p, gradient, dt):
        """Also multiply the steps' deformations up, knowing nothing of elastic and plastic."""
        for ident, G in zip(p.ident, gradient.reshape(-1, d, d), strict=True):
            total[ident] = (np.eye(d) + dt * G) @ total.get(ident, np.eye(d))
        original(p, gradient, dt)

    original = gradients.follow
    monkeypatch.setattr(gradients, "follow", follow)
    p = smashed(d, law, with_gradients=True).particles
    elastic, plastic = (a.reshape(-1, d, d) for a in (p.elastic_gradient, p.plastic_gradient))
    whole = np.array([total[ident] for ident in p.ident])
    # 30 steps of rounding
    assert np.abs(elastic @ plastic - whole).max() < 1e-12 * np.abs(whole).max()
    assert np.abs(np.linalg.det(plastic) / p.plastic - 1).max() < 1e-12
    W = unpack(p.stretch, d)
    values, vectors = np.linalg.eigh(elastic @ elastic.transpose(0, 2, 1))
    root = (vectors * np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    assert np.abs(root - W).max() < 1e-12
    assert np.abs(whole - np.eye(d)).max() > 0.1, "there is something to follow"
    away = np.abs(plastic - np.eye(d)).max()
    assert away > 0.05 if law == "snow" else away < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
def test_gradients_go_with_their_particles_on_any_number_of_ranks(comm, d):
    together = smashed(d, "snow", comm, rebalance=1.01, with_gradients=True).state()
    alone = smashed(d, "snow", with_gradients=True).state()
    if comm.rank == 0:
        for name in GRADIENTS:
            assert np.abs(together[name] - alone[name]).max() < 1e-10


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_else_depends_on_them(d):
    """Bit for bit."""
    without, carried = (smashed(d, "snow", with_gradients=asked).state() for asked in (False, True))
    assert set(carried) - set(without) == set(GRADIENTS)
    assert all(np.array_equal(without[name], carried[name]) for name in without)


def test_not_asked_for_they_cost_neither_memory_nor_work(monkeypatch):
    def follow(*arguments):
        raise AssertionError("no work")

    monkeypatch.setattr(gradients, "follow", follow)
    made = smashed(3, "snow", steps=2)
    assert not set(made.particles.arrays()) & set(GRADIENTS)
    assert made.particles.elastic_gradient is None and made.particles.plastic_gradient is None
    assert "gradients" not in made.effects


def scene(folder: Path, d: int, fields: str, end: float = 0.03, name: str = "scene") -> Path:
    rest = ", 0.0" * (d - 2)
    words = {
        "d": d, "fields": fields, "end": end, "center": f"[0.0{rest}, 0.14]", "velocity": f"[1.0{rest}, -5.0]",
        "origin": f"[0.0{rest}, 0.0]", "up": f"[0.0{rest}, 1.0]",
    }  # fmt: skip
    path = folder / f"{name}.toml"
    path.write_text(SCENE.format(**words))
    return path


def run(path: Path, folder: Path, *words: str) -> int:
    return cli.main(["snow", str(path), "-o", str(folder), "--quiet", *words])


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
def test_frames_hold_matrices_of_nine_components_and_the_record_their_cost(comm, shared_path, d):
    if comm.rank == 0:
        scene(shared_path, d, '["J_P", "elastic_gradient", "plastic_gradient"]')
    comm.barrier()
    assert run(shared_path / "scene.toml", shared_path / "results") == 0
    if comm.rank > 0:
        return
    frames = sorted((shared_path / "results" / "fields").iterdir())
    assert 'Name="elastic_gradient" NumberOfComponents="9"' in frames[-1].read_text().replace("'", '"')
    for frame in frames:
        data = meshio.vtu.read(str(frame)).point_data
        assert set(data) == {"J_P", *GRADIENTS}
        # frames are in single precision
        assert np.linalg.det(data["plastic_gradient"].reshape(-1, 3, 3)) == pytest.approx(data["J_P"], rel=1e-5)
    assert data["J_P"].min() < 0.95
    effects = json.loads((shared_path / "results" / "run.json").read_text())["effects"]
    assert effects["gradients"]["seconds"] > 0


def test_a_restart_goes_on_with_them_and_refuses_a_checkpoint_without_them(tmp_path, capsys):
    asked = '["elastic_gradient"]'
    whole, half, plain = (tmp_path / name for name in ("whole", "half", "plain"))
    long, short = scene(tmp_path, 3, asked), scene(tmp_path, 3, asked, 0.01, "short")
    assert run(long, whole) == run(short, half) == run(long, half, "--restart") == 0
    last = [
        meshio.vtu.read(str(sorted((folder / "fields").iterdir())[-1])).point_data["elastic_gradient"]
        for folder in (whole, half)
    ]
    assert np.array_equal(*last)
    capsys.readouterr()
    names = json.dumps(PARTICLE_FIELDS)
    assert run(scene(tmp_path, 3, names, 0.01, "plain"), plain) == 0
    assert run(long, plain, "--restart") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("extremal: ") and "step_000010.h5: has no elastic_gradient and no plastic_gradient; " in line
    # the other way round they are left behind
    assert run(scene(tmp_path, 3, names, 0.03, "fewer"), half, "--restart") == 0
