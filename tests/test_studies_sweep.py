"""Sweeps: points are run once, failures are shown, fits and fronts are right, recommendations say why."""

import json
import signal
import subprocess
import sys
import time

import pytest
import square_sweep

from extremal.app import cli, study_command
from extremal.app.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_SOLVER, InputError
from extremal.app.sweep import recommend, report, running
from extremal.app.sweep.model import load_sweep
from extremal.app.sweep.points import flat, points_of
from extremal.app.sweep.sentences import halving, percent


@pytest.fixture
def sweep_file(tmp_path):
    return square_sweep.write(tmp_path)


class FakeRuns:
    """In place of other processes: errors h^(k+1) for degree k, seconds h^-3; `failing` tells which fail, and how."""

    def __init__(self, failing=None):
        self.failing, self.count = failing or {}, 0

    def __call__(self, command, timeout):
        import tomllib

        self.count += 1
        words = [str(word) for word in command]
        with open(words[words.index("elastic") + 1], "rb") as file:
            scene = tomllib.load(file)
        folder, h = running.Path(words[words.index("-o") + 1]), scene["mesh"]["cell_size"]
        degree = scene.get("element", {}).get("degree", 1)
        how = self.failing.get((degree, h))
        if how == "timeout":
            return None, ""
        if how == "refused":
            return 2, "extremal: mesh: too coarse\n-----\nmpirun noticed\n"
        folder.mkdir(parents=True)
        (folder / "history.csv").write_text(f"time,max_displacement\n1,{1 + (h > 0.1) * h ** (degree + 1)}\n")
        record = {
            "status": "failed" if how else "finished",
            "reason": how or "",
            "size": round(h**-2),
            "steps": 1,
            "solver_iterations": {"total": 3, "newton_iterations": 3},
            "wall_seconds": 1.0,
            "run_cpu_seconds": [h**-3],
            "cpu_seconds": [1.0],
            "peak_memory_bytes": [1],
            "versions": {},
            "diagnostics": {},
        }
        (folder / "run.json").write_text(json.dumps(record))
        return (3 if how else 0), ""


@pytest.fixture
def run(sweep_file, monkeypatch):
    """Run the sweep with fake processes in `results`; return the exit code, what was found, and how many ran."""

    def go(*words, failing=None):
        fake = FakeRuns(failing)
        monkeypatch.setattr(running, "limited", fake)
        folder = sweep_file.parent / "results"
        code = cli.main(["study", str(sweep_file), "-o", str(folder), *words])
        found = folder / "study.json"
        return code, json.loads(found.read_text()) if found.exists() else None, fake.count

    return go


# ---------------------------------------------------------------------------------------- points


def test_points_are_whole_scenes_with_their_changes(sweep_file):
    import tomllib

    points = points_of(load_sweep(sweep_file))
    assert [str(point) for point in points[:2]] == ["reference", "P1 at 0.5"]
    assert len(points) == len({point.folder for point in points}) == 7
    last = tomllib.loads(points[-1].text)
    assert (last["mesh"]["cell_size"], last["mesh"]["dimension"]) == (0.2, 2)
    assert last["element"]["degree"] == 2
    assert last["petsc"]["elastic_ksp_type"] == "gmres"
    assert last["solver"]["tolerance"] == 1e-6
    assert "expect" not in last


def test_a_point_is_another_when_anything_it_depends_on_changes(sweep_file):
    before = [point.digest for point in points_of(load_sweep(sweep_file))]
    assert [point.digest for point in points_of(load_sweep(sweep_file))] == before
    assert not {point.digest for point in points_of(load_sweep(sweep_file), ranks=2)} & {*before}
    (sweep_file.parent / "square.toml").write_text(square_sweep.SCENE.replace("0.3", "0.31"))
    assert not {point.digest for point in points_of(load_sweep(sweep_file))} & {*before}


def test_a_method_without_the_knob_is_one_point(sweep_file):
    sweep_file.write_text(sweep_file.read_text().replace('name = "P1"', 'name = "P1"\nvalues = []', 1))
    point = points_of(load_sweep(sweep_file))[1]
    assert (point.method, point.value, str(point)) == ("P1", None, "P1")
    assert "mesh.cell_size" not in point.settings and "cell_size = 0.5" in point.text


def test_sweeps_of_the_same_runs_share_them(sweep_file, tmp_path, monkeypatch, capsys):
    """Two sweeps that differ in their error alone run each point once."""
    monkeypatch.chdir(tmp_path)
    other = sweep_file.with_name("other.toml")
    other.write_text(sweep_file.read_text().replace('"max_displacement"', '"energy"'))
    measured = []
    monkeypatch.setattr(running, "_run", counted(running._run, measured))
    for path in (sweep_file, other):
        assert cli.main(["study", str(path), "--quick"]) == EXIT_FINISHED
    assert len(measured) == 5 and capsys.readouterr().out.count(": kept") == 5


def counted(function, calls):
    def call(*args):
        calls.append(args)
        return function(*args)

    return call


def test_dotted_keys_and_tables_are_the_same():
    assert flat({"a": {"b": 1, "c": {"d": 2}}, "e.f": {}}) == {"a.b": 1, "a.c.d": 2, "e.f": {}}


def test_finished_points_are_not_run_again(run):
    code, first, count = run("-j", "2")
    assert (code, count) == (EXIT_FINISHED, 7)
    code, second, count = run()
    assert (code, count) == (EXIT_FINISHED, 0)
    assert second["points"] == first["points"]


def test_a_killed_study_goes_on_where_it_was(tmp_path):
    path, folder = tmp_path / "case.toml", tmp_path / "results"
    path.write_text(square_sweep.CASE)
    command = [sys.executable, "-m", "extremal.app", "study", str(path), "-o", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 120
    while not list(folder.glob("points/*/point.json")) and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = {file: file.stat().st_mtime_ns for file in folder.glob("points/*/point.json")}
    assert 1 <= len(done) < 3
    assert not (folder / "study.json").exists()
    said = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert said.returncode == EXIT_FINISHED, said.stderr
    assert said.stdout.count("kept") == len(done)
    assert {file: file.stat().st_mtime_ns for file in done} == done
    study = json.loads((folder / "study.json").read_text())
    # P1's gradient is of first order; three coarse meshes leave a tenth of doubt
    assert study["fits"]["P1"]["error_of_knob"]["slope"] == pytest.approx(-1, abs=0.1)
    assert study["points"][-1]["size"] == 2 * 9**2


def test_a_real_scene_is_measured_and_compared(sweep_file):
    text = square_sweep.SWEEP.replace("diagnostic", "field").replace("max_displacement", "displacement")
    sweep_file.write_text(text.replace("[0.5, 0.25, 0.2]", "[0.5, 0.25]"))
    folder = sweep_file.parent / "real"
    assert cli.main(["study", str(sweep_file), "-o", str(folder), "-j", "2"]) == EXIT_FINISHED
    study = json.loads((folder / "study.json").read_text())
    errors = [row["error"] for row in study["points"]]
    assert errors[0] > errors[1] > errors[3]  # a finer mesh, then a higher degree
    assert all(row["seconds"] > 0 and row["memory"] > 1e6 and row["size"] > 0 for row in study["points"])
    assert (folder / "study.png").stat().st_size > 10_000
    assert len((folder / "study.csv").read_text().splitlines()) == 5


# ---------------------------------------------------------------------------------------- failures


def test_failed_points_are_shown_and_not_dropped(run, capsys):
    failing = {(1, 0.5): "it blew up", (1, 0.25): "timeout", (2, 0.2): "refused"}
    code, study, _ = run(failing=failing)
    assert code == EXIT_FINISHED
    assert len(study["points"]) == 6
    reasons = {(row["method"], row["value"]): (row["status"], row["reason"]) for row in study["points"]}
    assert reasons["P1", 0.5] == ("failed", "it blew up")
    assert reasons["P1", 0.25] == ("timeout", "not finished after 120 s")
    assert reasons["P2", 0.2] == ("failed", "mesh: too coarse")
    shown = capsys.readouterr().out
    assert "3 of 6 points have failed: P1 at mesh.cell_size = 0.5 (it blew up); " in shown
    assert "timeout: not finished after 120 s |" in shown


def test_a_point_that_ran_out_of_time_is_run_again_with_more(run, sweep_file):
    failing = {(1, 0.25): "timeout"}
    run(failing=failing)
    assert run(failing=failing)[2] == 0
    sweep_file.write_text(square_sweep.SWEEP.replace("timeout = 120", "timeout = 240"))
    code, study, count = run()
    assert count == 1
    assert all("error" in row for row in study["points"])


def test_without_a_reference_there_is_no_study(run, capsys):
    code, study, _ = run(failing={(1, 0.1): "it blew up"})
    assert (code, study) == (EXIT_SOLVER, None)
    assert "the reference failed: it blew up" in capsys.readouterr().err


# ---------------------------------------------------------------------------------------- fits, sentences


def test_fits_of_a_sweep_are_those_of_its_points(run):
    _, study, _ = run()
    fits = study["fits"]["P2"]
    wanted = {"error_of_knob": 3, "error_of_size": -1.5, "seconds_of_size": 1.5, "seconds_of_error": -1}
    assert {name: fit["slope"] for name, fit in fits.items()} == pytest.approx(wanted)
    assert all(fit["low"] <= fit["slope"] <= fit["high"] for fit in fits.values())


def test_front_of_a_sweep_is_the_better_method(run):
    _, study, _ = run()
    assert {row["method"] for row in study["points"] if row.get("front")} == {"P2"}


def test_sentences_are_plain(run):
    _, study, _ = run()
    assert study["sentences"] == [
        "With P1, halving the error costs 2.8x the time (95% confidence: 2.8x to 2.8x, 3 points).",
        "With P2, halving the error costs 2x the time (95% confidence: 2x to 2x, 3 points).",
        "The cheapest way to an error of 10% is P2 at mesh.cell_size = 0.25: 64 s (its error: 1.6%).",
        "The cheapest way to an error of 1% is P2 at mesh.cell_size = 0.2: 1.2e+02 s (its error: 0.8%).",
    ]
    fit = {"slope": -2.0, "low": -2.3219281, "high": -1.5849625, "count": 4}
    assert halving(fit) == "halving the error costs 4x the time (95% confidence: 3x to 5x, 4 points)"
    assert halving({**fit, "slope": -0.1}).startswith("halving the error costs 1.07x the time")
    assert "no clear relation" in halving({**fit, "high": 0.1})
    assert "nothing is known" in halving({**fit, "low": None, "high": None, "count": 2})
    assert (percent(0.01), percent(0.0123), percent(1e-5)) == ("1%", "1.2%", "1.0e-05")


# ---------------------------------------------------------------------------------------- recommendations


@pytest.fixture
def stored(run, sweep_file, monkeypatch, tmp_path):
    """The sweep's study.json where recommendations are looked for."""
    run()
    for place in ("OWN", "SHIPPED"):
        monkeypatch.setattr(recommend, place, tmp_path / place)
    (tmp_path / "SHIPPED").mkdir()
    study = tmp_path / "SHIPPED" / "sweep.json"
    study.write_text((tmp_path / "results" / "study.json").read_text())
    return str(tmp_path / "square.toml")


def test_recommendation_is_the_cheapest_point_that_is_good_enough(stored, capsys):
    assert cli.main(["study", "recommend", stored, "--error", "0.02"]) == EXIT_FINISHED
    out = capsys.readouterr().out
    assert "P2 at mesh.cell_size = 0.25" in out
    for line in ("element.degree = 2", "mesh.cell_size = 0.25", 'petsc.elastic_ksp_type = "gmres"'):
        assert f"    {line}\n" in out
    assert "    solver.tolerance = 1e-06" in out
    assert "margin: 1.3x in the error" in out  # 0.02 / 0.25³
    assert "how sure: 5 points within a factor of 10 of its error, 3 of them of P2;" in out
    assert "measured on this very scene" in out


def test_recommendation_within_seconds_is_the_most_accurate_point(stored):
    assert "P2 at mesh.cell_size = 0.25" in recommend.recommend(stored, None, 70.0)  # 0.25^-3 s = 64 s


def test_recommendation_says_what_is_not_known(stored, sweep_file, tmp_path):
    shipped = tmp_path / "SHIPPED" / "sweep.json"
    study = json.loads(shipped.read_text())
    shipped.write_text(json.dumps({**study, "machine": "another, 1 cores", "quick": True}))
    (tmp_path / "square.toml").write_text(square_sweep.SCENE.replace("9.81", "9.8"))
    words = recommend.recommend(stored, 0.1, None)
    for caveat in ("seconds are of another machine: another", "short form", "the scene was different"):
        assert caveat in words


def test_what_no_point_reaches_is_refused_with_an_estimate(stored, capsys):
    assert cli.main(["study", "recommend", stored, "--error", "1e-9"]) == EXIT_INPUT
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no point has an error of 1.0e-09 or less" in err and "accepted is --error" in err
    with pytest.raises(InputError, match="accepted is --seconds 8 or more"):
        recommend.recommend(stored, None, 1e-3)
    with pytest.raises(InputError, match="no sweep of it has been run; known: square"):
        recommend.recommend("pastry", 0.1, None)


# ---------------------------------------------------------------------------------------- shipped


@pytest.mark.parametrize("name", study_command.sweeps())
def test_shipped_sweeps_can_be_run_and_their_fronts_are_of_their_scene(name):
    sweep = load_sweep(study_command.sweeps()[name])
    assert sweep.title
    for quick in (True, False):
        assert len(points_of(sweep, quick)) >= 2
    stored = recommend.SHIPPED / f"{sweep.name}.json"
    if stored.exists():
        study = json.loads(stored.read_text())
        assert (recommend.subject(study), study["quick"]) == (sweep.subject, False)
        assert study["digest"] == (report.digest(sweep.scene_path) if sweep.case is None else "")
