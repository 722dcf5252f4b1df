"""Method (3.5) as a second-order cone program solved by Clarabel, the neighbour of `extremal study hawkes-cost`.

    PYTHON _clarabel_network.py PROBLEM.npz     with an interpreter that has clarabel; it needs nothing of this package

In y = x² the problem is (3.21): maximise Σ b s + Σ a t with s² <= y, t² <= y_j y_l (rotated cones), Σ_i y_ij = 1.
Prints seconds of the processor that the solver took, and the energy at its y made feasible, as JSON.
"""

import json
import sys
import time

import clarabel
import numpy as np
from scipy import sparse

NEGLIGIBLE = 1e-12  # of the largest coefficient: such pairs of events are left out


def main(path):
    """Read time, timeline, event, b and θω, ω of each slot; solve; report."""
    with np.load(path) as file:
        when, pair, event, b, coupling, decay = (file[k] for k in ("time", "pair", "event", "b", "coupling", "decay"))
    first, second = (np.concatenate(part) for part in zip(*_couples(pair)))
    a = coupling[first] * np.exp(-decay[first] * np.abs(when[first] - when[second]))
    kept = a > NEGLIGIBLE * max(a.max(), b.max())
    first, second, a = first[kept], second[kept], a[kept]
    slots, couples, events = len(b), len(a), event.max() + 1
    # unknowns: y of the slots, s of the slots, t of the couples
    cost = np.concatenate([np.zeros(slots), -b, -a])
    y, s, t = np.arange(slots), slots + np.arange(slots), 2 * slots + np.arange(couples)
    rows, columns, values, constant = [event], [y], [np.ones(slots)], [np.ones(events)]
    # (y + 1, y - 1, 2 s) and (y_j + y_l, y_j - y_l, 2 t) lie in the cone |(second, third)| <= first
    at = events + 3 * np.arange(slots)
    _entries(rows, columns, values, [(at, y, -1.0), (at + 1, y, -1.0), (at + 2, s, -2.0)])
    constant.append(np.tile([1.0, -1.0, 0.0], slots))
    at = events + 3 * slots + 3 * np.arange(couples)
    cone = [(at, first, -1.0), (at, second, -1.0), (at + 1, first, -1.0), (at + 1, second, 1.0), (at + 2, t, -2.0)]
    _entries(rows, columns, values, cone)
    constant.append(np.zeros(3 * couples))
    size = (events + 3 * (slots + couples), len(cost))
    matrix = sparse.csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=size)
    cones = [clarabel.ZeroConeT(int(events)), *[clarabel.SecondOrderConeT(3)] * (slots + couples)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    nothing = sparse.csc_matrix((len(cost), len(cost)))
    began = time.process_time()
    solver = clarabel.DefaultSolver(nothing, cost, matrix, np.concatenate(constant), cones, settings)
    solution = solver.solve()
    seconds = time.process_time() - began
    y = np.maximum(np.array(solution.x)[:slots], 0.0)
    x = np.sqrt(y / np.bincount(event, weights=y)[event])
    energy = float(b @ x + a @ (x[first] * x[second]))
    report = {"version": clarabel.__version__, "seconds": seconds, "energy": energy, "cones": slots + couples}
    print(json.dumps(report))


def _couples(pair):
    """All two slots of each timeline."""
    for timeline in np.unique(pair):
        mine = np.flatnonzero(pair == timeline)
        j, l = np.triu_indices(len(mine), 1)
        yield mine[j], mine[l]


def _entries(rows, columns, values, cone):
    for row, column, value in cone:
        rows.append(row)
        columns.append(column)
        values.append(np.full(len(row), value))


if __name__ == "__main__":
    main(sys.argv[1])
