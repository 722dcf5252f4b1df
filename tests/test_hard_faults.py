"""Whatever ends a run, a restart ends where it would have ended: kill -9, signals, full disks, damage, lost ranks."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import hard_runs as runs
import pytest

from extremal.app import checkpoint

pytestmark = pytest.mark.hard
PARTS = tuple(runs.SCENES)
MANY = pytest.mark.long


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of a run of each part that nobody disturbed, made when asked for."""

    class Made(dict[str, Path]):
        def __missing__(self, part: str) -> Path:
            self[part] = runs.finish(part, tmp_path_factory.mktemp("whole") / part)
            return self[part]

    return Made()


def again(folder: Path) -> str:
    """How a run that was ended goes on: from its checkpoint, from the beginning where it has none."""
    return "--restart" if checkpoint.list_checkpoints(folder) else "--overwrite"


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=MANY)])
@pytest.mark.parametrize("part", PARTS)
def test_killed_at_random_moments_a_run_ends_as_if_it_had_not_been(
    whole: dict[str, Path], tmp_path: Path, part: str, kills: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each run is killed, restarted and killed again, at a random part of a random step, until it gets through."""
    pick = random.Random(f"{part} {kills}")
    steps, _ = runs.last_state(whole[part])
    done, finished, bitwise = 0, 0, 0
    while done < kills:
        folder = tmp_path / str(finished)
        words: tuple[str, ...] = ()
        for _ in range(pick.choice((1, 2, 3, 5))):
            process = runs.start(part, folder, 0, *words)
            if pick.random() < 0.1:  # while libraries are loaded, or the folder is made
                time.sleep(pick.uniform(0, 3))
                alive = process.poll() is None
            else:
                begin = max([0, *map(checkpoint.step_of, checkpoint.list_checkpoints(folder)[:1])])
                alive = runs.wait_for_step(process, folder, pick.randint(min(begin, steps - 1), steps - 1))
                time.sleep(pick.uniform(0, 0.03))
            process.kill()
            process.wait()
            runs.assert_whole(folder)
            done += alive
            words = (again(folder),)
        runs.finish(part, folder, 0, *words)
        runs.assert_same_run(folder, whole[part])
        bitwise += runs.difference(folder, whole[part]) == 0
        finished += 1
    with capsys.disabled():
        ended = f"{finished} runs ended as the whole one, {bitwise} of them bit by bit"
        print(f"\n{part}: SIGKILL at {done} moments, {ended}")


@pytest.mark.parametrize("part", ["elastic", "hawkes", pytest.param("snow", marks=MANY)])
def test_sigterm_saves_the_step_and_ends_with_status_3(whole: dict[str, Path], tmp_path: Path, part: str) -> None:
    folder = tmp_path / part
    process = runs.start(part, folder)
    assert runs.wait_for_step(process, folder, 12)
    process.terminate()
    assert process.wait(timeout=60) == 3
    saved, _ = runs.last_state(folder)
    assert saved == runs.last_row(folder) >= 12
    runs.finish(part, folder, 0, "--restart")
    runs.assert_same_run(folder, whole[part])


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "a bit": lambda data: data[: len(data) // 3] + bytes([data[len(data) // 3] ^ 4]) + data[len(data) // 3 + 1 :],
    "zeros": lambda data: data[:1000] + bytes(len(data) - 1000),
}


@pytest.mark.parametrize("damage", ["a bit", *(pytest.param(name, marks=MANY) for name in DAMAGES if name != "a bit")])
@pytest.mark.parametrize("part", PARTS)
def test_of_a_damaged_checkpoint_the_one_before_is_used(
    whole: dict[str, Path], tmp_path: Path, part: str, damage: str
) -> None:
    folder = runs.finish(part, tmp_path / part)
    newest, before = checkpoint.list_checkpoints(folder)
    newest.write_bytes(DAMAGES[damage](newest.read_bytes()))
    done = subprocess.run(runs.command(part, folder, 0, "--restart"), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith(f"{newest} ") or any(line.startswith(f"{newest} ") for line in lines), done.stdout
    assert any(line.startswith(f"restarted from {before}") for line in lines), done.stdout
    runs.assert_same_run(folder, whole[part])


# ------------------------------------------------------------------ a rank is lost


def children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("part", ["snow", pytest.param("elastic", marks=MANY), pytest.param("hawkes", marks=MANY)])
def test_one_rank_killed_ends_the_job_without_orphans_and_the_checkpoint_is_good(
    whole: dict[str, Path], tmp_path: Path, part: str
) -> None:
    folder = tmp_path / part
    process = runs.start(part, folder, 2)
    assert runs.wait_for_step(process, folder, 12)
    ranks = children(process.pid)
    assert len(ranks) == 2
    os.kill(ranks[-1], signal.SIGKILL)
    assert process.wait(timeout=60) != 0
    end = time.monotonic() + 10
    while any(map(is_running, ranks)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(is_running, ranks))
    runs.assert_whole(folder)
    saved, _ = runs.last_state(folder)
    assert runs.last_row(folder) - saved <= 8
    runs.finish(part, folder, 2, "--restart")
    runs.assert_same_run(folder, whole[part], RANKS[part])


# ------------------------------------------------------------------ the disk is full


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("only root may make a small disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.mark.parametrize("free", [120_000, *(pytest.param(n, marks=MANY) for n in range(10_000, 400_000, 35_000))])
@pytest.mark.parametrize("part", PARTS)
def test_on_a_full_disk_a_run_ends_in_one_line_and_goes_on_when_there_is_room(
    whole: dict[str, Path], disk: Path, part: str, free: int
) -> None:
    """Where it fills up is now a frame, now a table, now a checkpoint."""
    filler = disk / "filler"
    filler.write_bytes(bytes(1_048_576 - free // 4096 * 4096))
    folder = disk / part
    scene = disk.parent / f"{part}.toml"
    scene.write_text(runs.SCENES[part])
    words = runs.command(part, folder)
    words[words.index(str(disk / f"{part}.toml"))] = str(scene)
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert "Traceback" not in done.stdout + done.stderr
    if done.returncode == 0:  # it fitted
        runs.assert_same_run(folder, whole[part])
        return
    assert done.returncode in (2, 3)
    assert (done.stdout + done.stderr).count("No space left on device") >= 1
    runs.assert_whole(folder)
    assert not list(folder.rglob("*.partial"))
    filler.unlink()
    subprocess.run(["mount", "-o", "remount,size=100m", str(disk)], check=True)
    more = subprocess.run([*words, again(folder)], capture_output=True, text=True, timeout=120)
    assert more.returncode == 0, more.stderr
    runs.assert_same_run(folder, whole[part])


# ------------------------------------------------------------------ numbers of ranks

# what a final state on several ranks may differ by from that on one, relative to the largest value of each array
RANKS = dict.fromkeys(PARTS, 1e-11)  # a hundred times what was measured


@pytest.mark.parametrize("ranks", [2, *(pytest.param(n, marks=MANY) for n in (1, 3, 4))])
@pytest.mark.parametrize("part", PARTS)
def test_a_run_is_the_same_on_any_number_of_ranks(
    whole: dict[str, Path], tmp_path: Path, part: str, ranks: int, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = runs.finish(part, tmp_path / part, ranks)
    with capsys.disabled():
        print(f"\n{part} on {ranks} ranks: differs by {runs.difference(folder, whole[part]):.1e}")
    runs.assert_same_run(folder, whole[part], RANKS[part])


@pytest.mark.parametrize("part", PARTS)
def test_a_run_ends_as_on_other_machines(whole: dict[str, Path], part: str) -> None:
    """hard_runs.json was written on Debian 12 (PETSc 3.18, AMD EPYC); on Debian 13 runs differ by 1e-13."""
    known = json.loads(Path(__file__).with_name("hard_runs.json").read_text())[part]
    found = runs.fingerprint(whole[part])
    assert found.keys() == known.keys()
    for name, (size, total) in known.items():
        assert found[name] == pytest.approx([size, total], rel=0, abs=1e-11 * size), name
