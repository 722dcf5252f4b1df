"""Expressions a user writes in a scene: read safely, turned into sympy, evaluated on arrays.

Only arithmetic, comparisons, `and`, `or`, `not` and a fixed list of functions are understood; nothing is ever
executed as Python. Numbers are kept exact (0.1 is 1/10), so that constants cancel exactly when an energy is
expanded. sympy is imported by the first expression of a run; a scene of plain numbers never loads it.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from .expression_reader import CONSTANTS, FUNCTIONS, ExpressionError, read

if TYPE_CHECKING:
    import sympy
    from numpy.typing import ArrayLike, NDArray

__all__ = ["CONSTANTS", "FUNCTIONS", "ExpressionError", "function_of", "numeric", "parse", "parse_condition"]


def parse(text: str, names: Sequence[str]) -> sympy.Expr:
    """Read an expression.

    Parameters
    ----------
    text : str
        Such as "0.5*t*sin(pi*x) if ..."; see `FUNCTIONS` and `CONSTANTS` for what may occur besides `names`.
    names : sequence of str
        Variables; they become real sympy symbols of the same name.

    Raises
    ------
    ExpressionError
        Naming the column and what would be accepted.
    """
    part = read(text, names)
    if part.logical:
        raise ExpressionError("is a comparison where a number is wanted; use where(condition, a, b)")
    return part.expr


def parse_condition(text: str, names: Sequence[str]) -> Any:
    """Read a comparison such as "z < 0.01 and x > 0"; see `parse`."""
    part = read(text, names)
    if not part.logical:
        raise ExpressionError('is not a comparison; write one as "z < 0.01"')
    return part.expr


def numeric(expr: Any, names: Sequence[str]) -> Callable[..., NDArray]:
    """Return a function of arrays that evaluates `expr`.

    Parameters
    ----------
    expr : sympy expression or comparison
    names : sequence of str
        The function's arguments, in this order.

    Returns
    -------
    callable
        Takes one array or number for each name; returns an array of their common shape, float64 or (for a
        comparison) bool. Where the expression has no real value the result is nan or infinite.
    """
    import sympy

    # sympy would print Max(0, x) as a reduction over the ragged sequence (0, x), which NumPy refuses.
    largest, smallest = sympy.Function("largest_of"), sympy.Function("smallest_of")
    expr = expr.replace(sympy.Max, lambda *a: largest(*a)).replace(sympy.Min, lambda *a: smallest(*a))
    functions = {
        "largest_of": lambda *a: reduce(np.maximum, a),
        "smallest_of": lambda *a: reduce(np.minimum, a),
    }
    symbols = [sympy.Symbol(unicodedata.normalize("NFKC", name), real=True) for name in names]
    raw = sympy.lambdify(symbols, expr, modules=[functions, "numpy"], cse=True)
    kind = bool if isinstance(expr, sympy.logic.boolalg.Boolean) else float

    def evaluate(*values: ArrayLike) -> NDArray:
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in values)) if values else []
        shape = arrays[0].shape if arrays else ()
        with np.errstate(all="ignore"):
            result = np.asarray(raw(*arrays))
        return np.array(np.broadcast_to(result, shape), dtype=kind)

    return evaluate


def function_of(value: float | str, names: Sequence[str]) -> Callable[..., NDArray]:
    """Return a function of arrays from what a scene gives, a number or an expression of `names`.

    Raises
    ------
    ExpressionError
        From the function, where the expression has no finite real value; says where.
    """
    if not isinstance(value, str):
        constant = float(value)
        return lambda *values: np.full(np.broadcast_shapes(*(np.shape(v) for v in values)), constant)
    evaluate = numeric(parse(value, names), names)

    def checked(*values: ArrayLike) -> NDArray:
        result = evaluate(*values)
        wrong = ~np.isfinite(result)
        if wrong.any():
            points = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in values))
            where = ", ".join(f"{name} = {p[wrong][0]:g}" for name, p in zip(names, points, strict=True))
            raise ExpressionError(f'expression "{value}" has no finite real value at {where}')
        return result

    return checked
