"""Pictures of a run's frames: refused in one line where they cannot be, drawn once, a film, volumes."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from PIL import Image

from extremal.app import cli, pictures
from extremal.app.frames import boundary_facets, frame_list
from extremal.app.results import Series
from extremal.obstacles.isosurface import isosurface

SNOW = """
part = "snow"
[grid]
cell_size = 0.05
[[body]]
shape = "box"
low = [0, 0, 0.02]
high = [0.2, 0.2, 0.2]
[[collider]]
shape = "half_space"
point = [0, 0, 0]
normal = [0, 0, 1]
[gravity]
acceleration = [0, 0, -9.81]
[analysis]
end_time = 0.01
time_step = 1e-3
[output]
every = 5e-3
summary = false
"""
# two tetrahedra that share a face; the second is given as inverted
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
CELLS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
BALL = {"shape": "sphere", "center": [-0.45, -0.3, 0.5], "radius": 0.3}


def elastic_results(folder: Path, inverted: bool = False, collider: dict | None = None, frames: int = 2) -> Path:
    """A results folder as an elastic run leaves it."""
    folder.mkdir()
    (folder / "fields").mkdir()
    scene = 'part = "elastic"\n[mesh]\nshape = "box"\n[material]\nyoung_modulus = 1\npoisson_ratio = 0.3\ndensity = 1\n'
    if collider:
        scene += '[analysis]\ntype = "dynamic"\ntime_step = 0.1\nend_time = 1\n'
        scene += "[[collider]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in collider.items())
    (folder / "scene.toml").write_text(scene)
    table = {"collider": [collider] if collider else [], "output": {}, "gravity": None}
    record = {"part": "elastic", "title": "two", "scene": table, "scene_file": str(folder / "scene.toml")}
    (folder / "run.json").write_text(json.dumps(record))
    series = Series(folder, (POINTS, CELLS, "tetra"), [])
    for step in range(frames):
        cell_data = {"smallest_stretch": np.array([1.0, -0.5 if inverted else 0.8]),
                     "inverted": np.array([0, int(inverted)]), "velocity": np.zeros((2, 3))}  # fmt: skip
        series.write(0.1 * step, {"displacement": np.full((5, 3), 0.01 * step)}, cell_data)
    return folder


@pytest.fixture(scope="module")
def snow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a small run of snow."""
    folder = tmp_path_factory.mktemp("snow")
    (folder / "scene.toml").write_text(SNOW)
    assert cli.main(["snow", str(folder / "scene.toml"), "-o", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which the command is refused."""
    capsys.readouterr()
    assert cli.main(["render", *words]) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert out == "" and line.startswith("extremal: ")
    return line.removeprefix("extremal: ")


# ------------------------------------------------------------- refusals


def test_missing_libraries_are_named_with_what_installs_them(
    snow: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("pyvista", "mitsuba", "openvdb", "pyopenvdb"):
        monkeypatch.setitem(sys.modules, module, None)
    elastic = elastic_results(tmp_path / "out")
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    assert "'extremal[view]'" in refused([str(elastic)], capsys)
    words = refused([str(snow), "-o", str(tmp_path / "none")], capsys)
    assert "'extremal[render]'" in words and "--preview" in words
    assert "--vdb: OpenVDB is not installed; apt install python3-openvdb" == refused([str(snow), "--vdb"], capsys)
    assert not (tmp_path / "none").exists()


def test_a_machine_without_egl_is_told_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from extremal.app import shaded

    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    monkeypatch.setattr(shaded, "find_library", lambda name: None)
    assert "apt install libegl1" in refused([str(elastic_results(tmp_path / "out"))], capsys)


@pytest.mark.parametrize(
    ("part", "words", "message"),
    [
        ("elastic", "--preview", "--preview: has no effect on an elastic run; leave it out"),
        ("elastic", "--vdb", "--vdb: has no effect on an elastic run; leave it out"),
        ("snow", "--field J", "--field: has no effect on a run of snow; leave it out"),
        ("snow", "--preview --samples 4", "--samples: has no effect with --preview; leave it out"),
        ("snow", "--vdb --preview", "--preview: has no effect with --vdb; leave it out"),
        ("snow", "--view 30", "render: --view: 30: must be azimuth,elevation in degrees, from -360 to 360 and "
         "from -89 to 89, as -60,20"),
        ("snow", "--view -30,90", "render: --view: -30,90: must be azimuth,elevation in degrees, from -360 to 360 and "
         "from -89 to 89, as -60,20"),
        ("snow", "--samples 0", "render: --samples: 0: must be a whole number from 1 to 100000"),
        ("snow", "--extinction nan", "render: --extinction: nan: must be a number above 0"),
        ("snow", "--cell-size 1e-6", "--cell-size: 1e-06: must be from 0.005 to 0.5 [m]"),
        ("elastic", "--cell-size 0.1", "--cell-size: has no effect on an elastic run; leave it out"),
        ("snow", "--film 0", "render: --film: 0: must be a number above 0 and at most 1000"),
    ],
)  # fmt: skip
def test_options_without_meaning_are_refused(
    part: str, words: str, message: str, snow: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = snow if part == "snow" else elastic_results(tmp_path / "out")
    assert refused([str(folder), *words.split()], capsys) == message


@pytest.mark.parametrize("damage", ["cut", "missing", "noise", "list"])
def test_damaged_frames_end_it_in_one_line(
    damage: str, snow: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    for path in (path for path in snow.rglob("*") if path.is_file()):
        (folder / path.relative_to(snow)).parent.mkdir(exist_ok=True)
        (folder / path.relative_to(snow)).write_bytes(path.read_bytes())
    frame = folder / frame_list(folder)[1][1]
    if damage == "cut":
        frame.write_bytes(frame.read_bytes()[:700])
    elif damage == "missing":
        frame.unlink()
    elif damage == "noise":
        frame.write_bytes(bytes(range(256)) * 9)
    else:
        frame = folder / "fields.pvd"
        frame.write_text("<VTKFile><Coll")
    assert refused([str(folder), "--preview", "--size", "32x32"], capsys).startswith(f"{frame}: ")


def test_what_is_no_run_with_pictures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, words in (
        ("[1]", "is not the record of a run"),
        ('{"part": "elastic"}', "is not the record of a run"),
        ('{"part": "hawkes", "scene": {"output": {}}}', "only elastic runs and runs of snow have pictures"),
        ('{"part": "snow", "scene": {"output": {}}}', "has no frame"),
    ):
        (tmp_path / "run.json").write_text(text)
        assert words in refused([str(tmp_path)], capsys)


# ------------------------------------------------------------- what is drawn, and how often


def test_a_picture_is_drawn_again_only_if_frame_or_settings_changed(tmp_path: Path) -> None:
    frames = {index: (float(index), tmp_path / f"{index}.vtu") for index in (0, 2)}
    for _, path in frames.values():
        path.write_text("first")
    drawn: list[Path] = []

    def draw(time: float, path: Path, tell: object) -> np.ndarray:
        drawn.append(path)
        return np.full((4, 6, 3), 0.5)

    folder = tmp_path / "pictures"
    assert pictures.draw_all(draw, frames, {"size": (6, 4)}, folder) == (2, 0)
    assert sorted(path.name for path in folder.iterdir()) == ["frame_00000.png", "frame_00002.png"]
    assert pictures.draw_all(draw, frames, {"size": (6, 4)}, folder) == (0, 2)
    frames[2][1].write_text("second")
    assert pictures.draw_all(draw, frames, {"size": (6, 4)}, folder) == (1, 1)
    damaged = folder / "frame_00000.png"
    damaged.write_bytes(damaged.read_bytes()[:30])
    assert pictures.draw_all(draw, frames, {"size": (6, 4)}, folder) == (1, 1)
    assert pictures.draw_all(draw, frames, {"size": (9, 4)}, folder) == (2, 0)
    assert [path.name for path in drawn] == ["0.vtu", "2.vtu", "2.vtu", "0.vtu", "0.vtu", "2.vtu"]


def test_quick_pictures_of_snow_need_no_library_and_are_kept(
    snow: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["render", str(snow), "--preview", "--size", "64x48", "--every", "2", "-o", str(tmp_path)]
    assert cli.main(words) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"2 pictures in {tmp_path}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frame_00000.png", "frame_00002.png"]
    assert cli.main([*words, "--view", "30,40"]) == 0
    assert cli.main([*words, "--view", "30,40"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"2 pictures in {tmp_path}, 2 of them as they were"


def test_a_film_of_odd_size_is_made(snow: Path, tmp_path: Path) -> None:
    if pictures.ffmpeg() is None:
        pytest.skip("no ffmpeg")
    words = ["render", str(snow), "--preview", "--size", "65x47", "-o", str(tmp_path), "--film", "12"]
    assert cli.main(words) == 0
    assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"


def test_without_ffmpeg_the_pictures_are_there_and_the_way_to_a_film_is_told(
    snow: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "ffmpeg", lambda: None)
    assert cli.main(["render", str(snow), "--preview", "--size", "64x48", "-o", str(tmp_path), "--film", "24"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].startswith("no film: ffmpeg is not installed; apt install ffmpeg")
    assert lines[-1].startswith(f"    ffmpeg -framerate 24 -pattern_type glob -i '{tmp_path}/frame_*.png'")


def test_volumes_hold_the_mass_where_it_is(snow: Path, tmp_path: Path) -> None:
    vdb = pytest.importorskip("pyopenvdb" if sys.version_info < (3, 13) else "openvdb")
    assert cli.main(["render", str(snow), "--vdb", "-o", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"density_{index:05d}.vdb" for index in range(3)]
    grid = vdb.read(str(tmp_path / "density_00002.vdb"), "density")
    assert grid.transform.voxelSize() == pytest.approx((0.05, 0.05, 0.05))
    assert grid["time"] == pytest.approx(0.01)
    frame = meshio.vtu.read(str(snow / frame_list(snow)[2][1]))
    mass = frame.point_data["mass"].astype(float)
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    density = np.zeros(high - low + 1, dtype=np.float32)
    grid.copyToArray(density, ijk=tuple(int(i) for i in low))
    assert density.sum(dtype=float) * 0.05**3 == pytest.approx(mass.sum(), rel=1e-5)  # single precision
    for axis in range(3):
        others = tuple(k for k in range(3) if k != axis)
        nodes = 0.05 * np.arange(low[axis], high[axis] + 1)
        centre = (density.sum(axis=others, dtype=float) * nodes).sum() / density.sum(dtype=float)
        assert centre == pytest.approx((mass * frame.points[:, axis]).sum() / mass.sum(), abs=1e-6)


# ------------------------------------------------------------- surfaces


def test_a_ball_as_triangles_is_closed_and_has_its_volume() -> None:
    axis = np.linspace(-1, 1, 33)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    phi = np.linalg.norm(nodes - [0.03, 0.0, -0.02], axis=-1) - 0.7
    points, triangles = isosurface(phi, np.full(3, -1.0), np.full(3, 2 / 32))
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    # each edge is passed once in each direction
    assert len(np.unique(edges, axis=0)) == len(edges) == 2 * len(np.unique(np.sort(edges, axis=1), axis=0))
    a, b, c = points[triangles].transpose(1, 0, 2)
    # to the second order in the spacing
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.01)


def test_curved_facets_are_as_closed_as_flat_ones() -> None:
    ten = np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]])
    facets, owner = boundary_facets(ten, curved=True)
    assert len(facets) == 16 and set(owner) == {0}
    edges = np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges) == 2 * len(np.unique(np.sort(edges, axis=1), axis=0))


# ------------------------------------------------------------- shaded surfaces


def colours(path: Path) -> np.ndarray:
    """A picture's colours (h, w, 3), from 0 to 255."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), dtype=int)


def shaded(folder: Path, *words: str) -> np.ndarray:
    """The first picture of an elastic run, drawn by a process of its own.

    In one that has compiled and loaded what other tests need, OpenGL may run out of memory in its first picture.
    """
    pytest.importorskip("pyvista")
    from extremal.app.shaded import WINDOWS, find_library

    if not any(map(find_library, WINDOWS)):
        pytest.skip("nothing to draw with")
    command = [sys.executable, "-m", "extremal.app", "render", str(folder), "--size", "160x120", *words]
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == 0, done.stderr
    return colours(folder / "pictures" / "frame_00000.png")


def red(image: np.ndarray) -> int:
    """Number of pixels that are clearly red."""
    r, g, b = np.moveaxis(image, 2, 0)
    return int(((r > 100) & (g < 0.4 * r) & (b < 0.4 * r)).sum())


def test_inverted_elements_and_they_alone_are_red(tmp_path: Path) -> None:
    assert red(shaded(elastic_results(tmp_path / "bad", inverted=True))) > 100
    assert red(shaded(elastic_results(tmp_path / "good"))) == 0


def test_obstacles_of_an_elastic_run_are_drawn_and_the_field_is_the_users(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = shaded(elastic_results(tmp_path / "bare"), "--view", "-60,20")
    ball = shaded(elastic_results(tmp_path / "ball", collider=BALL), "--view", "-60,20")
    changed = np.abs(bare - ball).sum(axis=2) > 30
    grey = np.ptp(ball[changed], axis=1) < 30  # neither viridis nor red
    assert changed.sum() > 300 and grey.mean() > 0.9
    line = refused([str(tmp_path / "bare"), "--field", "velocity"], capsys)
    assert line.endswith("has no field velocity with a number in each element; there are: smallest_stretch, inverted")


def test_the_eye_stays_where_it_is(tmp_path: Path) -> None:
    folder = elastic_results(tmp_path / "out")
    first = shaded(folder)[20:100]  # without the time and the scale of colours
    second = colours(folder / "pictures" / "frame_00001.png")[20:100]
    # moved by (0.01, 0.01, 0.01): the picture shifts by a pixel and is not centred again
    assert 0 < (np.abs(first - second).sum(axis=2) > 60).mean() < 0.1


def test_an_elastic_body_among_snow_is_in_its_picture(snow: Path, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    out = tmp_path / "out"
    shutil.copytree(snow, out)
    (out / "solid" / "fields").mkdir(parents=True)
    series = Series(out / "solid", (0.2 * POINTS + [0.25, 0.0, 0.0], CELLS, "tetra"), [])
    for time, _ in frame_list(snow):
        series.write(time, {"displacement": np.zeros((5, 3))}, {})
    drawn = {}
    for name, folder in (("with", out), ("without", snow)):
        words = ["--size", "64x48", "--samples", "4", "--every", "2", "-o", str(tmp_path / name)]
        assert cli.main(["render", str(folder), *words, "--view", "30,20"]) == 0
        drawn[name] = colours(tmp_path / name / "frame_00002.png")
    rubber = {name: (image[..., 0] > 1.5 * image[..., 2]).sum() for name, image in drawn.items()}
    assert rubber["with"] > 40 and rubber["without"] == 0


@pytest.mark.mpi
def test_one_rank_draws_and_all_end_alike(
    comm: MPI.Intracomm, shared_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = shared_path / "scene.toml", shared_path / "out"
    if comm.rank == 0:
        scene.write_text(SNOW)
    comm.barrier()
    assert cli.main(["snow", str(scene), "-o", str(out), "--quiet"]) == 0
    capsys.readouterr()
    assert cli.main(["render", str(out), "--preview", "--size", "64x48"]) == 0
    assert len(list((out / "pictures").glob("frame_*.png"))) == 3
    assert ("3 pictures in" in capsys.readouterr().out) == (comm.rank == 0)
    assert cli.main(["render", str(out), "--field", "J"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == (comm.rank == 0)
