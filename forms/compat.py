"""The differences between dolfinx 0.5 and 0.9 that forms meets, all in one place."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

_OPTIONS = {"cffi_extra_compile_args": ["-O3", "-march=native"], "timeout": 60}  # seconds to wait for another process
_NEW = hasattr(fem, "functionspace")
_CELLS = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def lagrange(mesh: Any, degree: int, size: int = 1) -> Any:
    """Continuous Lagrange space of scalars (size 1) or vectors."""
    if _NEW:
        return fem.functionspace(mesh, ("Lagrange", degree) if size == 1 else ("Lagrange", degree, (size,)))
    if size == 1:
        return fem.FunctionSpace(mesh, ("Lagrange", degree))
    return fem.VectorFunctionSpace(mesh, ("Lagrange", degree), dim=size)


def cellwise(mesh: Any) -> Any:
    """Scalars, one a cell."""
    return fem.functionspace(mesh, ("DG", 0)) if _NEW else fem.FunctionSpace(mesh, ("DG", 0))


def quadrature(mesh: Any, degree: int, shape: tuple[int, ...] = ()) -> Any:
    """Tensors of the given shape at the points of the default rule of that degree."""
    if _NEW:
        import basix.ufl

        element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, scheme="default", degree=degree)
        return fem.functionspace(mesh, element)
    rule = {"degree": degree, "quad_scheme": "default"}
    if len(shape) == 1:
        element = ufl.VectorElement("Quadrature", mesh.ufl_cell(), dim=shape[0], **rule)
    elif shape:
        element = ufl.TensorElement("Quadrature", mesh.ufl_cell(), shape=shape, **rule)
    else:
        element = ufl.FiniteElement("Quadrature", mesh.ufl_cell(), **rule)
    return fem.FunctionSpace(mesh, element)


def rule(dimension: int, degree: int) -> tuple[NDArray, NDArray]:
    """Points and weights of the default rule on the reference simplex."""
    points, weights = basix.make_quadrature(_CELLS[dimension], degree)
    return np.asarray(points), np.asarray(weights)


def edges(dimension: int) -> list[list[int]]:
    """Corners of each edge of the reference simplex, in the order of the P2 degrees of freedom."""
    return basix.topology(_CELLS[dimension])[1]


def form(expression: Any) -> Any:
    """Compiled form."""
    return _compiled(fem.form, expression)


def expression(what: Any, points: NDArray) -> Any:
    """Compiled expression at reference points."""
    return _compiled(fem.Expression, what, points)


def _compiled(make: Callable[..., Any], *arguments: Any) -> Any:
    options: dict[str, Any] = {("jit_options" if _NEW else "jit_params"): _OPTIONS}
    try:
        return make(*arguments, **options)
    except (TimeoutError, RuntimeError) as error:  # in parallel all ranks have the latter, the first one the reason
        # a compilation that was killed leaves its source, which FFCx takes for one that goes on
        left = re.search(r"remove (.+\.c)\)", str(error))
        if left:
            Path(left[1]).unlink(missing_ok=True)
        return make(*arguments, **options)


def evaluate(compiled: Any, mesh: Any, cells: NDArray) -> NDArray:
    """Values of a compiled expression, shape (cells, ...)."""
    return compiled.eval(mesh, cells) if _NEW else compiled.eval(cells)


def vector_of(function: Any) -> PETSc.Vec:
    """The PETSc vector of a function (with ghosts)."""
    return function.x.petsc_vec if _NEW else function.vector


def matrix(compiled: Any) -> PETSc.Mat:
    """Matrix with the pattern of a bilinear form."""
    return fem_petsc.create_matrix(compiled)


def vector(compiled: Any) -> PETSc.Vec:
    """Vector (with ghosts) for a linear form."""
    return fem_petsc.create_vector(compiled)


def add_vector(b: PETSc.Vec, compiled: Any) -> None:
    """b += assembled form, without the exchange of ghosts."""
    fem_petsc.assemble_vector(b, compiled)


def add_matrix(a: PETSc.Mat, compiled: Any, conditions: list[Any]) -> None:
    """A += assembled form, rows and columns of the conditions left out, ones on their diagonal."""
    a.assemble(PETSc.Mat.AssemblyType.FLUSH)  # PETSc refuses, unheard, to add after the ones of an earlier form
    fem_petsc.assemble_matrix(a, compiled, conditions)


def unfilled(a: PETSc.Mat) -> PETSc.Mat:
    """A matrix with the layout of `a` and no pattern yet."""
    out = PETSc.Mat().create(a.getComm())
    out.setSizes(a.getSizes(), a.getBlockSize())
    out.setType("aij")
    return out


def fill(out: PETSc.Mat, a: PETSc.Mat, more: sparse.csr_array | None) -> None:
    """out = a + more (this rank's rows), with just the pattern of that sum."""
    starts, columns, values = a.getValuesCSR()
    if more is not None:
        total = sparse.csr_array((values, columns, starts), shape=more.shape) + more
        starts, columns, values = total.indptr, total.indices, total.data
    out.setPreallocationCSR((starts.astype(PETSc.IntType), columns.astype(PETSc.IntType), values))
    out.assemble()


def held(space: Any, component: int, dofs: NDArray) -> Any:
    """Dirichlet condition (of value zero, only its place counts) on one component."""
    return fem.dirichletbc(PETSc.ScalarType(0), np.asarray(dofs, dtype=np.int32), space.sub(component))


def cell_dofs(space: Any, cells: int) -> NDArray:
    """Blocks of each cell, shape (cells, blocks per cell)."""
    listed = space.dofmap.list
    # not -1: this rank may have no cell
    return np.asarray(getattr(listed, "array", listed)).reshape(cells, space.dofmap.dof_layout.num_dofs)


def cell_nodes(mesh: Any, cells: int) -> NDArray:
    """Geometry nodes of each cell, shape (cells, nodes per cell)."""
    listed = mesh.geometry.dofmap
    per_cell = mesh.geometry.cmap.create_dof_layout().num_dofs
    return np.asarray(getattr(listed, "array", listed)).reshape(cells, per_cell)
