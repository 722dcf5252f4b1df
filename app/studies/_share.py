"""Runs shared out among the ranks, each solved by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from mpi4py import MPI

    from ._table import Row

Case = TypeVar("Case")


def share_out(
    todo: Sequence[Case], solve: Callable[[Case], Row], take: Callable[[Row], None], comm: MPI.Comm
) -> None:
    """Every rank solves its part of `todo`; after each of its own rank 0 takes what has arrived (collective)."""
    from mpi4py import MPI

    mine = todo[comm.rank :: comm.size]
    left = len(todo) - len(mine)
    sent: list[Any] = []
    for case in mine:
        row = solve(case)
        if comm.rank > 0:
            sent.append(comm.isend(row, dest=0))
            continue
        take(row)
        while left and comm.iprobe(source=MPI.ANY_SOURCE):
            take(comm.recv(source=MPI.ANY_SOURCE))
            left -= 1
    if comm.rank == 0:
        for _ in range(left):
            take(comm.recv(source=MPI.ANY_SOURCE))
    MPI.Request.waitall(sent)
