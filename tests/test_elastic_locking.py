"""The study of locking: first-degree elements refuse to bend when they may not change volume, second-degree bend."""

import argparse
import csv

import pytest
from mpi4py import MPI

from extremal.app.studies import locking


@pytest.mark.parametrize(
    "ratio, p1_at_most, p1_at_least", [(0.3, 0.6, 0.5), (0.49, 0.2, 0.1), (0.4999, 0.1, 0.05)]
)
def test_second_degree_bends_where_first_degree_locks(ratio, p1_at_most, p1_at_least):
    """Two cells across the bar; docs/verification.md has the whole table."""
    stiff, good = (locking.bend(MPI.COMM_SELF, ratio, degree, 2)["deflection"] for degree in (1, 2))
    assert p1_at_least < stiff / good < p1_at_most
    assert good == pytest.approx(0.5, rel=0.1)  # P L³/(3 E I) = 0.51 m


def test_the_study_writes_its_table_and_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(locking, "RATIOS", (0.3,))
    locking.run(argparse.Namespace(output=tmp_path, quick=True), MPI.COMM_SELF)
    with open(tmp_path / "locking.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["degree"], row["across"]) for row in rows] == [
        ("1", "2"),
        ("1", "4"),
        ("2", "1"),
        ("2", "2"),
    ]
    assert (tmp_path / "locking.png").stat().st_size > 1000
    assert "| P2 " in capsys.readouterr().out
