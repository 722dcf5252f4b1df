"""Who owns which part of space: a coarse DMDA of blocks, cut by where the particles are."""

from __future__ import annotations

from itertools import product

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from .grid import nowhere
from .particles import Particles

MOST_BLOCKS = 1 << 18  # what a DMDA costs is bounded, however large the box around the particles


class Decomposition:
    """Blocks of cells and their ranks; the blocks at the edge own all that lies beyond them.

    Attributes
    ----------
    imbalance : float
        Largest number of particles of a rank over the mean, when the cuts were made.
    """

    def __init__(self, comm: MPI.Comm, h: float, particles: Particles) -> None:
        self.comm, self.h, self._dimension = comm, h, particles.dimension
        _check_places(comm, particles, h)
        self._cut(particles)

    def _cut(self, particles: Particles) -> None:
        d, comm = self._dimension, self.comm
        if comm.size == 1:
            return
        cells = np.floor(particles.position / self.h).astype(np.int64)
        low, high = np.full(d, np.iinfo(np.int64).max), np.full(d, np.iinfo(np.int64).min)
        if len(cells):
            low, high = cells.min(axis=0), cells.max(axis=0)
        comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
        comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
        self._side = 1  # cells of a block in each direction
        while np.prod((high // self._side - low // self._side + 1).astype(float)) > MOST_BLOCKS:
            self._side *= 2
        block, low, high = (self._blocks(x) for x in (cells, low, high))
        self._low = low
        self._count = high - low + 1
        share = [self._histogram(block[:, k] - low[k], int(self._count[k])) for k in range(d)]
        ranks = self._process_grid(share)
        # more ranks than blocks in a direction: empty blocks beyond the particles
        share = [np.pad(s, (0, max(0, p - len(s)))) for s, p in zip(share, ranks, strict=True)]
        ranges = [_even_cuts(s, p) for s, p in zip(share, ranks, strict=True)]
        self.dmda = PETSc.DMDA().create(
            dim=d,
            dof=1,
            sizes=[len(s) for s in share],
            proc_sizes=ranks,
            ownership_ranges=ranges,
            stencil_width=0,
            comm=comm,
        )
        self._ranks = np.array(ranks)
        self._bounds = [np.cumsum(r)[:-1] for r in self.dmda.getOwnershipRanges()]
        self._count = np.array([len(s) for s in share])
        begins, lengths = (np.array(corner) for corner in self.dmda.getCorners())
        self._box = (low + begins) * self._side, (low + begins + lengths) * self._side
        self._box[0][begins == 0] = np.iinfo(np.int32).min  # blocks at the edge own all that lies beyond them
        self._box[1][begins + lengths == self._count] = np.iinfo(np.int32).max
        self.dmda.destroy()

    def _histogram(self, index: NDArray, length: int) -> NDArray:
        counts = np.bincount(index, minlength=length).astype(np.int64)
        self.comm.Allreduce(MPI.IN_PLACE, counts)
        return counts

    def _process_grid(self, share: list[NDArray]) -> list[int]:
        """The factorisation of the number of ranks which leaves the least surface between them."""
        size, d = self.comm.size, self._dimension
        best: tuple[float, list[int]] = (np.inf, [])
        for ranks in product(*(range(1, size + 1) for _ in range(d))):
            if np.prod(ranks) != size:
                continue
            lengths = [len(s) / p for s, p in zip(share, ranks, strict=True)]
            surface = sum(np.prod([m for j, m in enumerate(lengths) if j != k]) * (ranks[k] > 1) for k in range(d))
            empty = sum(max(0, p - len(s)) for s, p in zip(share, ranks, strict=True))
            best = min(best, (surface + 1e6 * empty, list(ranks)))
        return best[1]

    def _blocks(self, cells: NDArray) -> NDArray:
        return cells // self._side

    def elsewhere(self, places: NDArray) -> NDArray:
        """Rows of `places` (q, d), in units of h, that other ranks own; ascending."""
        if self.comm.size == 1:
            return np.empty(0, dtype=np.int64)
        away = np.zeros(len(places), dtype=bool)
        for k, (low, high) in enumerate(zip(*self._box, strict=True)):
            away |= (places[:, k] < low) | (places[:, k] >= high)
        return np.flatnonzero(away)

    def owner(self, cells: NDArray) -> NDArray:
        """Rank of each cell (or node) given by its place (q, d) in units of h."""
        block = np.clip(self._blocks(cells.astype(np.int64)) - self._low, 0, self._count - 1)
        rank = np.zeros(len(cells), dtype=np.int32)
        stride = 1
        for k in range(self._dimension):  # PETSc numbers ranks with the first direction fastest
            rank += stride * np.searchsorted(self._bounds[k], block[:, k], side="right").astype(np.int32)
            stride *= int(self._ranks[k])
        return rank

    def imbalance(self, count: int) -> float:
        """Largest number of particles on a rank over the mean, given this rank's number."""
        total, most = self.comm.allreduce(count), self.comm.allreduce(count, op=MPI.MAX)
        return most * self.comm.size / max(1, total)

    def migrate(self, particles: Particles, tolerated: float = 0.0) -> Particles:
        """Send particles to the owners of their cells (collective); a DMSwarm of type BASIC carries them.

        Nothing is done while no rank has more than the share `tolerated` of its particles elsewhere: a rank may work on
        any particle, since nodes are summed wherever they are.
        """
        if self.comm.size == 1:
            return particles
        leaving = self.elsewhere(particles.position / self.h)
        share = np.array(len(leaving) / max(1, len(particles)))
        self.comm.Allreduce(MPI.IN_PLACE, share, op=MPI.MAX)
        if share <= tolerated:
            return particles
        with np.errstate(invalid="ignore"):  # what is nowhere may stay: the grid refuses it
            rank = self.owner(np.floor(particles.position[leaving] / self.h).astype(np.int64))
        leaving, rank = leaving[rank != self.comm.rank], rank[rank != self.comm.rank]
        staying = np.ones(len(particles), dtype=bool)
        staying[leaving] = False
        arrived = self._carry(particles.take(leaving), rank)
        return Particles.join([particles.take(np.flatnonzero(staying)), arrived])

    def _carry(self, particles: Particles, rank: NDArray) -> Particles:
        packed = _pack(particles)
        width = packed.shape[1]
        swarm = PETSc.DMSwarm().create(self.comm)
        swarm.setDimension(self._dimension)
        swarm.setType(PETSc.DMSwarm.Type.BASIC)
        swarm.initializeFieldRegister()
        swarm.registerField("particle", width, dtype=PETSc.RealType)
        swarm.finalizeFieldRegister()
        swarm.setLocalSizes(len(packed), len(packed) + 64)  # room: an empty rank may receive
        field = swarm.getField("particle")
        field[:] = packed.reshape(field.shape)
        swarm.restoreField("particle")
        target = swarm.getField("DMSwarm_rank")
        target[:] = rank.reshape(target.shape)
        swarm.restoreField("DMSwarm_rank")
        # what arrives stands after what was there; PETSc's removal of that takes time that grows with its square
        swarm.migrate(remove_sent_points=False)
        count = swarm.getLocalSize()
        arrived = np.array(swarm.getField("particle")).reshape(-1, width)[len(packed) : count].copy()
        swarm.restoreField("particle")
        swarm.destroy()
        return _unpack(arrived, particles)


def _check_places(comm: MPI.Comm, particles: Particles, h: float) -> None:
    """Raise FloatingPointError on all ranks, naming a particle that is nowhere (collective)."""
    bad = np.flatnonzero(~(np.abs(particles.position) < 1e9 * h).all(axis=1))
    words = ""
    if len(bad):
        words = str(nowhere(int(particles.ident[bad[0]]), particles.position[bad[0]]))
    worst = comm.allreduce(words, op=MPI.MAX)
    if worst:
        raise FloatingPointError(worst)


def _pack(particles: Particles) -> NDArray:
    """All arrays side by side; whole numbers are exact in double up to 2**53."""
    return np.hstack([(a if a.ndim == 2 else a[:, None]).astype(float) for a in particles.arrays().values()])


def _unpack(packed: NDArray, like: Particles) -> Particles:
    out, column = {}, 0
    for name, a in like.arrays().items():
        width = a.shape[1] if a.ndim == 2 else 1
        part = packed[:, column : column + width]
        out[name] = np.ascontiguousarray(part if a.ndim == 2 else part[:, 0]).astype(a.dtype)
        column += width
    return Particles(**out)


def _even_cuts(counts: NDArray, parts: int) -> list[int]:
    """Cut a row of counts into `parts` runs of nearly equal sums, none of them without an entry."""
    total = np.cumsum(counts)
    cuts = [0]
    for k in range(1, parts):
        wanted = total[-1] * k / parts
        cut = int(np.abs(total - wanted).argmin()) + 1
        cuts.append(int(np.clip(cut, cuts[-1] + 1, len(counts) - (parts - k))))
    cuts.append(len(counts))
    return [b - a for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
