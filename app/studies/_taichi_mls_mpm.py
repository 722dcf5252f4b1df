"""MLS-MPM (Hu et al. 2018) in taichi, the neighbour of `extremal study snow-cost`; prints what it measured as JSON.

    PYTHON _taichi_mls_mpm.py PARTICLES.npz      with an interpreter that has taichi; it needs nothing of this package

Quadratic B-splines, affine transfers, single precision, one thread of the processor. The snow is that of (7.1) and
(7.2): singular values of F_E clamped, moduli that harden.
"""

import json
import sys
import time

import numpy as np
import taichi as ti

CAP = 3.0  # of the hardening exponent
MARGIN = 3  # nodes around the snow


def main(path):
    """Read particles and material, make `repetitions` batches of `batch` steps, report the fastest."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f32, offline_cache=False, log_level=ti.ERROR)
    with np.load(path) as file:
        given = {name: file[name] for name in file.files}
    start = given["position"] - (given["position"].min(axis=0) - MARGIN * given["h"])
    n = len(start)
    h, dt = float(given["h"]), float(given["dt"])
    nodes = [int(k) + MARGIN + 1 for k in start.max(axis=0) / h]
    mu0, lambda0, hardening = (float(given[name]) for name in ("mu", "lambda", "hardening"))
    least, largest = float(given["least"]), float(given["largest"])
    mass, volume, gravity = float(given["mass"]), float(given["volume"]), float(given["gravity"])

    x, v = (ti.Vector.field(3, float, shape=n) for _ in range(2))
    C, F = (ti.Matrix.field(3, 3, float, shape=n) for _ in range(2))
    J_P = ti.field(float, shape=n)
    grid_v = ti.Vector.field(3, float, shape=nodes)
    grid_m = ti.field(float, shape=nodes)

    @ti.func
    def weights(f):
        return 0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2

    @ti.kernel
    def clear():
        for i in ti.grouped(grid_m):
            grid_v[i] = ti.Vector.zero(float, 3)
            grid_m[i] = 0.0

    @ti.kernel
    def to_grid():
        for p in x:
            base = ti.cast(x[p] / h - 0.5, int)
            f = x[p] / h - base
            w = ti.Matrix.rows(weights(f))
            U, S, V = ti.svd(F[p] + dt * C[p] @ F[p])
            J = 1.0
            for k in ti.static(range(3)):
                kept = ti.min(ti.max(S[k, k], least), largest)
                J_P[p] *= S[k, k] / kept
                S[k, k] = kept
                J *= kept
            F[p] = U @ S @ V.transpose()
            harder = ti.exp(ti.min(ti.max(hardening * (1.0 - J_P[p]), -CAP), CAP))
            mu, lam = mu0 * harder, lambda0 * harder
            stress = 2.0 * mu * (F[p] - U @ V.transpose()) @ F[p].transpose()
            stress += ti.Matrix.identity(float, 3) * lam * J * (J - 1.0)
            affine = mass * C[p] - dt * volume * 4.0 / h**2 * stress
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                weight = w[i, 0] * w[j, 1] * w[k, 2]
                grid_v[base + offset] += weight * (mass * v[p] + affine @ ((offset - f) * h))
                grid_m[base + offset] += weight * mass

    @ti.kernel
    def move_grid():
        for i in ti.grouped(grid_m):
            if grid_m[i] > 0:
                grid_v[i] /= grid_m[i]
                grid_v[i][2] += dt * gravity

    @ti.kernel
    def to_particles():
        for p in x:
            base = ti.cast(x[p] / h - 0.5, int)
            f = x[p] / h - base
            w = ti.Matrix.rows(weights(f))
            new_v, new_C = ti.Vector.zero(float, 3), ti.Matrix.zero(float, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                part = w[i, 0] * w[j, 1] * w[k, 2] * grid_v[base + offset]
                new_v += part
                new_C += 4.0 / h * part.outer_product(offset - f)
            v[p], C[p] = new_v, new_C
            x[p] += dt * new_v

    def step():
        clear()
        to_grid()
        move_grid()
        to_particles()

    def set_up():
        x.from_numpy(start.astype(np.float32))
        v.from_numpy(given["velocity"].astype(np.float32))
        C.fill(0.0)
        F.from_numpy(np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)))
        J_P.fill(1.0)

    set_up()
    step()  # compiles
    set_up()
    seconds = []
    for _ in range(int(given["repetitions"])):
        ti.sync()
        began = time.process_time()
        for _ in range(int(given["batch"])):
            step()
        ti.sync()
        seconds.append(time.process_time() - began)
    speed = v.to_numpy().astype(float)
    report = {
        "version": ".".join(str(number) for number in ti.__version__),
        "seconds": min(seconds) / int(given["batch"]),
        "kinetic_energy": 0.5 * mass * float((speed**2).sum()),
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main(sys.argv[1])
