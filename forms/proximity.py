"""What on a surface is close to what, and what crosses what on a straight way: ipctk, shared by the ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from .laws import LawError
from .surface import Surface

SLACK = 0.5  # of d̂: how far from a way that has been looked at what may be close is known too


class Proximity:
    """Pairs of parts of a surface: those closer than `reach`, and those that meet on a way.

    Parts are vertices and segments in the plane, vertices and triangles or two edges in space, that have no node in
    common. Pairs of which all nodes are prescribed wholly are left out. Every rank has the whole surface and looks at
    its share of the pairs. Places are those of all nodes, (n, d) [m], the same on every rank; so is what follows from
    them. All methods are collective.

    Parameters
    ----------
    comm : MPI.Intracomm
    surface : Surface
    reach : float or None
        d̂ [m].
    most : float
        d̂ where `reach` is None, or half the smallest distance of two parts of one body at rest where that is less.

    Raises
    ------
    LawError
        Without ipctk.
    """

    def __init__(self, comm: Any, surface: Surface, reach: float | None, most: float) -> None:
        self.library = ipctk = _library()
        ipctk.set_num_threads(1)  # the ranks are what works at the same time; and sums are the same each time
        self._comm, self._nodes = comm, surface.nodes
        in_space = surface.rest.shape[1] == 3
        faces = surface.facets if in_space else np.zeros((0, 3), dtype=np.int32, order="F")
        edges = np.asfortranarray(ipctk.edges(faces)) if in_space else surface.facets
        self.mesh = ipctk.CollisionMesh(surface.rest, edges, faces)
        self._edges, self._faces = edges, faces
        self.reach = self._at_rest(surface.rest, most) if reach is None else reach
        self.mesh.can_collide = ipctk.make_static_obstacle_filter(surface.movable)
        self._ccd = ipctk.AdditiveCCD()
        self._way: _Way | None = None
        self.origin: NDArray | None = None
        self._clearance = 0.0
        self._seen: tuple[NDArray, Any] | None = None

    def close(self, x: NDArray) -> Any:
        """This rank's share of the pairs closer than d̂ at x, an ipctk.NormalCollisions."""
        if self._seen is None or not np.array_equal(self._seen[0], x):
            if self._way is None or not self._way.covers(x):
                self._way = self._look(x, np.zeros_like(x))
            self._seen = x, self._pairs(self._way.candidates, x, self.reach)
        return self._seen[1]

    def nearest(self, x: NDArray) -> float:
        """Smallest distance of two parts [m], at most d̂."""
        pairs = self.close(x)
        own = self.reach if pairs.empty() else float(np.sqrt(pairs.compute_minimum_distance(self.mesh, x)))
        return self._comm.allreduce(min(own, self.reach), op=MPI.MIN)

    def search_from(self, x: NDArray) -> None:
        """Ways begin at x."""
        self.origin, self._clearance = x, self.nearest(x)

    def crossed(self, x: NDArray) -> bool:
        """Whether parts meet on the straight way to x from where the search began."""
        if not np.isfinite(x).all():
            return True
        if self.origin is None:
            self.search_from(x)
        start = self.origin
        assert start is not None
        step = np.asfortranarray(x - start)
        if 2 * np.linalg.norm(step, axis=1).max(initial=0) < self._clearance:
            return False
        way = self._way
        if way is not None and way.start is start and way.free is not None and way.has(step):
            return way.part(x) > way.free
        way = self._way = self._look(start, step)
        own = way.candidates.compute_collision_free_stepsize(self.mesh, start, start + step, 0.0, self._ccd)
        way.free = self._comm.allreduce(float(own), op=MPI.MIN)
        return way.free < 1

    def intersects(self, x: NDArray) -> bool:
        """Whether any edge cuts a triangle, in the plane an edge."""
        return bool(self.library.has_intersections(self.mesh, x))

    def first_meeting(self, x: NDArray) -> str:
        """Which parts meet, and where, in words."""
        broad = self.library.LBVH()
        broad.can_vertices_collide = self.mesh.can_collide
        broad.build(x, self._edges, self._faces, 0.0)
        if x.shape[1] == 3:
            for pair in broad.detect_edge_face_candidates():
                edge, face = self._edges[pair.edge_id], self._faces[pair.face_id]
                if not {*edge} & {*face} and self.library.is_edge_intersecting_triangle(*x[edge], *x[face]):
                    return self._words("edge", edge, x) + " cuts " + self._words("triangle", face, x)
        else:
            for pair in broad.detect_edge_edge_candidates():
                one, other = self._edges[pair.edge0_id], self._edges[pair.edge1_id]
                if not {*one} & {*other} and self.library.segment_segment_intersect(*x[one], *x[other]):
                    return self._words("edge", one, x) + " cuts " + self._words("edge", other, x)
        return "two parts of the surface touch"

    def _words(self, what: str, rows: NDArray, x: NDArray) -> str:
        place = ", ".join(f"{c:.4g}" for c in x[rows].mean(axis=0))
        return f"{what} {'-'.join(str(k) for k in sorted(self._nodes[rows]))} at ({place}) m"

    # ------------------------------------------------------------------ candidates

    def _look(self, start: NDArray, step: NDArray) -> _Way:
        candidates, slack = self.library.Candidates(), SLACK * self.reach
        candidates.build(self.mesh, start, start + step, self.reach / 2 + slack)
        return _Way(start, step, slack, self._share(candidates))

    def _share(self, candidates: Any) -> Any:
        """The same without what other ranks look at."""
        rank, size = self._comm.rank, self._comm.size
        if size > 1:
            for name in ("ev_candidates", "ee_candidates", "fv_candidates"):
                setattr(candidates, name, getattr(candidates, name)[rank::size])
        return candidates

    def _pairs(self, candidates: Any, x: NDArray, reach: float) -> Any:
        found = self.library.NormalCollisions()
        found.use_area_weighting = True
        found.build(candidates, self.mesh, x, reach)
        return found

    def _at_rest(self, x: NDArray, most: float) -> float:
        graph = sparse.coo_array((np.ones(len(self._edges)), tuple(self._edges.T)), shape=(len(x), len(x)))
        body = sparse.csgraph.connected_components(graph)[1]
        candidates, nearest = self.library.Candidates(), 2 * most
        candidates.build(self.mesh, x, most)
        pairs = self._pairs(self._share(candidates), x, 2 * most)
        for kind in ("vv", "ev", "ee", "fv"):
            for pair in getattr(pairs, f"{kind}_collisions"):
                nodes = [k for k in pair.vertex_ids(self._edges, self._faces) if k >= 0]
                if len({*body[nodes]}) == 1:
                    nearest = min(nearest, float(np.sqrt(pair.compute_distance(x, self._edges, self._faces))))
        return self._comm.allreduce(nearest, op=MPI.MIN) / 2


class _Way:
    """A straight way of the surface: what may come close on it, and how far it is free.

    Attributes
    ----------
    start, step : (n, d) [m]
    slack : float
        [m]
    candidates : ipctk.Candidates
        This rank's share of the pairs closer than d̂ somewhere within `slack` of the way.
    free : float or None
        No pair meets on this part of the way, if that has been looked at.
    """

    def __init__(self, start: NDArray, step: NDArray, slack: float, candidates: Any) -> None:
        self.start, self.step, self.slack, self.candidates = start, step, slack, candidates
        self.free: float | None = None

    def part(self, x: NDArray) -> float:
        """How far along the way the place is that x is nearest to; 1: at its end."""
        size = float(np.vdot(self.step, self.step))
        return float(np.vdot(x - self.start, self.step)) / size if size > 0 else 0.0

    def has(self, step: NDArray) -> bool:
        """Whether a step from the start stays on the way, as those of a line search do."""
        s = self.part(self.start + step)
        return 0 <= s <= 1 and bool(np.linalg.norm(step - s * self.step) <= 1e-9 * np.linalg.norm(self.step))

    def covers(self, x: NDArray) -> bool:
        """Whether `candidates` are all that may be close at x."""
        away = x - self.start - np.clip(self.part(x), 0, 1) * self.step
        return bool(np.linalg.norm(away, axis=1).max(initial=0) <= self.slack)


def _library() -> Any:
    try:
        import ipctk
    except ImportError:
        raise LawError(
            "[contact] self = true needs ipctk; install it by ./setup.sh contact, or pip install 'extremal[contact]'"
        ) from None
    return ipctk
