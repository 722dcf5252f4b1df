"""Nodes that particles of several ranks touch: sums go to the owner, values come back, by a PetscSF."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from .decomposition import Decomposition
from .grid import Grid


class Sharing:
    """Local nodes of this rank: those its particles touch, then those it owns which only others touch.

    Attributes
    ----------
    node : (count, d) int32
        All local nodes.
    owned : (n,) int64 or slice
        Those this rank owns.
    """

    def __init__(self, grid: Grid, decomposition: Decomposition) -> None:
        self.comm = comm = decomposition.comm
        self.node = grid.node
        self.owned: NDArray | slice = slice(None)
        self.sf: PETSc.SF | None = None
        if comm.size == 1:
            return
        ghosts = decomposition.elsewhere(grid.node)
        mine = np.ones(grid.count, dtype=bool)
        mine[ghosts] = False
        owner = decomposition.owner(grid.node[ghosts])
        order = np.argsort(owner, kind="stable")
        ghosts, owner = ghosts[order], owner[order]
        asked = self._exchange(grid.node[ghosts], owner)
        number = grid.find(asked)
        missing = np.flatnonzero(number < 0)
        if len(missing):
            adopted, which = np.unique(asked[missing], axis=0, return_inverse=True)
            number[missing] = grid.count + which.reshape(-1)
            self.node = np.vstack([grid.node, adopted])
        remote = self._answer(number, owner)
        self.owned = np.concatenate([np.flatnonzero(mine), np.arange(grid.count, len(self.node))])
        pairs = np.column_stack([owner, remote]).astype(PETSc.IntType)
        self.sf = PETSc.SF().create(comm)
        self.sf.setGraph(len(self.node), ghosts.astype(PETSc.IntType), pairs)
        self._types: dict[int, MPI.Datatype] = {}

    def _exchange(self, nodes: NDArray, owner: NDArray) -> NDArray:
        """Send places of nodes (sorted by owner) to their owners; what others ask of this rank comes back."""
        comm, d = self.comm, self.node.shape[1]
        self._sent = np.bincount(owner, minlength=comm.size).astype(np.int32)
        self._received = np.empty(comm.size, dtype=np.int32)
        comm.Alltoall(self._sent, self._received)
        asked = np.empty((int(self._received.sum()), d), dtype=np.int32)
        comm.Alltoallv([np.ascontiguousarray(nodes), self._sent * d], [asked, self._received * d])
        return asked

    def _answer(self, number: NDArray, owner: NDArray) -> NDArray:
        remote = np.empty(len(owner), dtype=np.int32)
        self.comm.Alltoallv([np.ascontiguousarray(number), self._received], [remote, self._sent])
        return remote

    @property
    def count(self) -> int:
        """Local nodes."""
        return len(self.node)

    def _unit(self, values: NDArray) -> MPI.Datatype:
        width = values.shape[1] if values.ndim == 2 else 1
        base = MPI.DOUBLE if values.dtype == np.float64 else MPI.FLOAT
        if width == 1:
            return base
        key = width * (1 if base == MPI.DOUBLE else -1)
        if key not in self._types:
            self._types[key] = base.Create_contiguous(width).Commit()
        return self._types[key]

    def sum_to_owners(self, values: NDArray) -> None:
        """Add what other ranks have at a node to its owner's value, in place."""
        if self.sf is None:
            return
        if values.dtype != np.float64:  # a PetscSF adds in PETSc's own precision only
            wide = values.astype(np.float64)
            self.sum_to_owners(wide)
            values[:] = wide
            return
        unit, leaves = self._unit(values), values.copy()
        self.sf.reduceBegin(unit, leaves, values, MPI.SUM)
        self.sf.reduceEnd(unit, leaves, values, MPI.SUM)

    def from_owners(self, values: NDArray) -> None:
        """Give every rank the owners' values, in place."""
        if self.sf is None:
            return
        unit, roots = self._unit(values), values.copy()
        self.sf.bcastBegin(unit, roots, values, MPI.REPLACE)
        self.sf.bcastEnd(unit, roots, values, MPI.REPLACE)

    def destroy(self) -> None:
        """Free the PetscSF and its data types."""
        if self.sf is not None:
            self.sf.destroy()
            for unit in self._types.values():
                unit.Free()
