"""The summary picture: what it shows is right, and it can be drawn for every kind of run."""

import sys

import numpy as np
import pytest
from fake_problem import FakeProblem, box_of_tetrahedra, scene

from extremal.app import frames, session, summary, summary_page


def draw(comm, folder, problem: FakeProblem | None = None, **tables):
    settings = scene(**({"output": {"summary": True}} | tables))
    session.run(problem or FakeProblem(comm), settings, folder, quiet=True)
    return folder / "summary.png"


def test_boundary_of_a_box_is_closed_and_encloses_its_volume():
    points, cells, _ = box_of_tetrahedra(3)
    facets, owner = frames.boundary_facets(cells)
    assert len(facets) == 6 * 9 * 2
    assert all(set(facet) <= set(cells[cell]) for facet, cell in zip(facets, owner, strict=True))
    a, b, c = points[facets].transpose(1, 0, 2)
    # divergence theorem: outward facets enclose the volume 1, up to rounding
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_picture_is_drawn_in_two_and_three_dimensions(comm, tmp_path, dimension):
    picture = draw(comm, tmp_path, FakeProblem(comm, dimension=dimension))
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 20000


@pytest.mark.parametrize(
    "tables",
    [
        {"analysis": {"time_step": 1.0, "largest_step": 1.0}, "output": {"summary": True, "iterations": 2}},
        {"output": {"summary": True, "fields": ["region"]}},
        {
            "output": {"summary": True, "every": 0.5},
            "title": "a [title] with $ and _",
            "expect": {"q": {"above": 1}},
        },
    ],
)
def test_a_picture_is_drawn_whatever_was_written(comm, tmp_path, tables):
    assert draw(comm, tmp_path, **tables).exists()


def test_a_picture_is_drawn_after_a_failure_at_once(comm, tmp_path):
    assert draw(comm, tmp_path, FakeProblem(comm, fails=lambda time, dt: True)).exists()


def test_a_picture_is_drawn_without_mesh_and_of_a_body_flattened_to_a_point(comm, tmp_path):
    class Meshless(FakeProblem):
        def geometry(self):
            return None

    class Flat(FakeProblem):
        def fields(self, names=None):
            at_points, in_cells = super().fields(names)
            return at_points | {"displacement": -self.points}, in_cells

    assert draw(comm, tmp_path / "meshless", Meshless(comm)).exists()
    assert not list((tmp_path / "meshless" / "fields").iterdir())
    assert draw(comm, tmp_path / "flat", Flat(comm)).exists()


def test_the_verdict_is_good_only_when_nothing_is_inverted_and_nothing_missed():
    record = {
        "status": "finished", "reason": "", "steps": 1, "ranks": 2, "wall_seconds": 12.345,
        "diagnostics": {"inverted": 0.0, "smallest_stretch": 0.987654}, "solver_iterations": {"total": 55},
    }  # fmt: skip
    words, second, color = summary_page.verdict(record)
    assert words == (
        "FINISHED  ·  no inverted element  ·  smallest stretch 0.988  ·  55 solver iterations  ·  1 step"
        "  ·  12.3 s  ·  2 ranks"
    )
    assert (second, color) == ("", summary_page.GOOD)
    assert summary_page.verdict(record | {"diagnostics": {"inverted": 3.0}})[2] == summary_page.DOUBTFUL
    missed = [{"name": "energy", "wanted": "< 1", "found": 2.0, "met": False}]
    words, second, color = summary_page.verdict(record | {"expect": missed})
    assert second == "0 of 1 expectation met. Missed: energy < 1, found 2"
    assert color == summary_page.DOUBTFUL
    assert summary_page.verdict(record | {"status": "failed", "reason": "why"})[1:] == ("why", summary_page.BAD)


def test_no_plotting_library_is_loaded_unless_a_summary_is_asked_for(launch, tmp_path):
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); from fake_problem import *\n"
        "session.run(FakeProblem(MPI.COMM_WORLD), scene(), sys.argv[2], quiet=True)\n"
        "print([name for name in ('matplotlib', 'dolfinx', 'gmsh') if name in sys.modules])"
    )
    result = launch(0, "-c", script, __file__.rpartition("/")[0], tmp_path)
    assert result.stdout.splitlines()[-1] == "[]", result.stderr


def test_a_missing_plotting_library_costs_the_picture_only(comm, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "extremal.app.summary", None)
    settings = scene(output={"summary": True})
    assert session.run(FakeProblem(comm), settings, tmp_path, quiet=True).exit_code == 0
    assert "summary.png not drawn: " in capsys.readouterr().out


def test_the_worst_frame_is_shown_where_elements_were_inverted_in_between_only(tmp_path, monkeypatch):
    names = [f"fields/frame_{index:05d}.vtu" for index in range(4)]
    entries = "".join(f'<DataSet timestep="{time}" file="{file}"/>' for time, file in zip((0.0, 0.5, 1.0, 2.0), names))
    (tmp_path / "fields.pvd").write_text(f"<VTKFile><Collection>{entries}</Collection></VTKFile>")
    (tmp_path / "fields").mkdir()
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.setattr(summary, "read_shape", lambda path: path.name)
    time = np.array([0.0, 0.5, 0.6, 1.0, 2.0])

    def shown(inverted: list[float]) -> list[str]:
        history = {"time": time, "inverted": np.array(inverted), "smallest_J": 1 - np.array(inverted)}
        return [title for title, *_ in summary._shapes(tmp_path, history)]

    assert shown([0, 1, 3, 2, 0]) == ["before", "time 0.5", "after"]
    assert shown([5, 1, 3, 2, 0]) == ["before", "after"]
    assert shown([0, 1, 3, 2, 2]) == ["before", "after"]
    assert shown([0, 0, 0, 0, 0]) == ["before", "after"]
