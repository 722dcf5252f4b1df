"""A small sweep as text: a square under its weight, two degrees on three meshes; and one of a case."""

from pathlib import Path

SCENE = """
part = "elastic"
mesh = { shape = "box", dimension = 2, cell_size = 0.5 }
material = { young_modulus = 1e5, poisson_ratio = 0.3, density = 1000.0 }
fixed = [{ boundary = "left" }]
gravity = { acceleration = [0.0, -9.81] }
expect = { max_displacement = 17.0 }
"""
SWEEP = """
title = "A square"
scene = "square.toml"
timeout = 120
[set]
solver.tolerance = 1e-6
[error]
diagnostic = "max_displacement"
[reference]
set = { "mesh.cell_size" = 0.1 }
[[method]]
name = "P1"
[[method]]
name = "P2"
set = { element = { degree = 2 } }
petsc = { elastic_ksp_type = "gmres" }
[knob]
key = "mesh.cell_size"
values = [0.5, 0.25, 0.2]
"""
CASE = """
case = "manufactured"
set = { dimension = 2 }
[[method]]
name = "P1"
[knob]
key = "divisions"
values = [2, 4, 8]
"""


def write(folder: Path) -> Path:
    """Write the sweep and its scene; returns the sweep's path."""
    (folder / "square.toml").write_text(SCENE)
    path = folder / "sweep.toml"
    path.write_text(SWEEP)
    return path
