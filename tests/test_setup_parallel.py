"""The tests themselves under mpirun: nothing hangs, a failure is told once."""

import os
import shutil
from pathlib import Path

import pytest

TESTS = """
import time
import pytest

def test_serial():
    raise AssertionError("a serial test runs on several ranks")

@pytest.mark.mpi
def test_shared_folder(comm, shared_path):
    assert len(set(comm.allgather(shared_path))) == 1
    assert comm.size == 2

@pytest.mark.mpi
def test_last(comm):
    {body}
"""


@pytest.fixture
def run(launch, tmp_path):
    def run_tests(body: str, limit: float = 100):
        shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
        (tmp_path / "test_inner.py").write_text(TESTS.format(body=body))
        (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n    mpi\n    long\n")
        options = ("-p", "no:cacheprovider", "--color=no")
        env = {**os.environ, "EXTREMAL_TEST_TIMEOUT": str(limit)}
        return launch(2, "-m", "pytest", *options, cwd=tmp_path, timeout=60, env=env)

    return run_tests


def test_only_tests_marked_mpi_run_and_one_rank_reports(run):
    done = run("pass")
    assert done.returncode == 0
    assert done.stdout.count("2 passed") == 1
    assert done.stdout.count("test session starts") == 1


def test_failure_on_one_rank_ends_all_ranks_with_one_traceback(run):
    done = run("assert comm.rank == 0, 'rank 1 is lost'; comm.barrier()")
    assert done.returncode != 0
    output = done.stdout + done.stderr
    assert output.count("test_last failed on rank 1 of 2 (call)") == 1
    assert output.count("AssertionError: rank 1 is lost") == 1


def test_failure_on_all_ranks_is_told_once(run):
    done = run("raise ValueError('everyone is lost')")
    assert done.returncode != 0
    assert (done.stdout + done.stderr).count("ValueError: everyone is lost") == 1


def test_a_test_that_hangs_is_ended_and_located_on_each_rank(run):
    done = run("comm.rank or comm.barrier(); time.sleep(100)", limit=1)
    assert done.returncode != 0
    output = done.stdout + done.stderr
    assert output.count("Timeout (0:00:01") == 2
    assert output.count("in test_last") == 2
