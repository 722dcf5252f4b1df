"""From a law's expression to C: the energy and its derivatives, of the law itself and of its C1 extension.

The energy is differentiated in coordinates y that vanish at rest:

    y = e  elementary symmetric polynomials of di = σi - 1 (for laws in the invariants): then
           i1 = 3 + e1, i2 = 3 + 2e1 + e2, J = 1 + e1 + e2 + e3   (2D: i1 = 2 + e1, J = 1 + e1 + e2)
    y = d  the di themselves (for laws written in single stretches)

so that small strains keep all their digits. A law without extension may be asked about nearly flat states,
where these lose theirs: there y = (i1, i2, J). The C2 extension (6.3.2) needs no more of a law than its
derivatives up to the fourth; `kernel.c` does the rest.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import sympy as sp
from sympy.codegen.rewriting import create_expand_pow_optimization, log1p_opt, optimize
from sympy.printing.c import C99CodePrinter

from .laws import I1, I2, STRETCHES, J, Law, i1, i2, in_stretches

EPSILON, STIFFNESS = sp.symbols("epsilon k", real=True)
_Y = sp.symbols("y0:3", real=True)
_C = sp.Symbol("c", real=True)  # J - 1, kept as a symbol of its own: expressions stay ten times shorter


def _in_coordinates(law: Law, y: tuple[sp.Expr, ...]) -> sp.Expr:
    """Ψ in the coordinates `y` (e or d, see above) and, for e, also in c = J - 1."""
    if law.uses_stretches:
        expr = in_stretches(law.energy, law.dimension)
        return expr.subs({s: 1 + d for s, d in zip(STRETCHES, y, strict=False)})
    e1, e2 = y[:2]
    table = {i1: law.dimension + e1, J: 1 + _C, I1: law.dimension + 2 * e1 + e1**2 - 2 * e2}
    if law.dimension == 3:
        table[i2] = 3 + 2 * e1 + e2
        table[I2] = table[i2] ** 2 - 2 * (3 + e1) * (1 + _C)
    return _cancel_constants(law.energy.xreplace(table))


def _cancel_constants(expr: sp.Expr) -> sp.Expr:
    """Multiply out sums of polynomials so that constants cancel exactly and small strains keep digits."""
    return sp.expand(expr, log=False, power_base=False, power_exp=False)


def _derivatives(expr: sp.Expr, y: tuple[sp.Expr, ...], order: int) -> list[sp.Expr]:
    """[Ψ, Ψ_k ..., Ψ_kl for k <= l ..., Ψ_klm for k <= l <= m ...] up to `order`; ∂c/∂y_k = 1."""
    table: dict[tuple[int, ...], sp.Expr] = {(): expr}
    for n in range(1, order + 1):
        for index in combinations_with_replacement(range(len(y)), n):
            lower = table[index[:-1]]
            table[index] = sp.diff(lower, y[index[-1]]) + sp.diff(lower, _C)
    return list(table.values())


def base(law: Law, order: int) -> list[sp.Expr]:
    """Ψ and its derivatives in y."""
    y = _Y[: law.dimension]
    return _derivatives(_in_coordinates(law, y), y, order)


def far(law: Law) -> list[sp.Expr]:
    """Ψ and its derivatives to second order in (i1, i2, J), 2D (i1, J)."""
    y = _Y[: law.dimension]
    table = {i1: y[0], J: y[-1], I1: y[0] ** 2 - 2 * y[1]}
    if law.dimension == 3:
        table |= {i2: y[1], I2: y[1] ** 2 - 2 * y[0] * y[2]}
    return _derivatives(law.energy.xreplace(table), y, 2)


def c1(law: Law, below: int) -> list[sp.Expr]:
    """Ψext of 6.3.1 and its derivatives in d when the `below` smallest stretches are under ε (appendix B.2).

    Ψext = Π_below (1 + Δi ∂i) Ψ at σ_below = ε, plus k/2 Σ Δi², Δi = σi - ε. The factor 1/2 is that of 6.3.1.
    """
    d = _Y[: law.dimension]
    s = STRETCHES[: law.dimension]
    expr = in_stretches(law.energy, law.dimension)
    penalty = sp.Integer(0)
    for a in range(law.dimension - below, law.dimension):
        gap = 1 + d[a] - EPSILON
        expr = (expr + gap * sp.diff(expr, s[a])).subs(s[a], EPSILON)
        penalty += STIFFNESS / 2 * gap**2
    return _derivatives(expr.subs({s[a]: 1 + d[a] for a in range(law.dimension)}) + penalty, d, 2)


def direct(law: Law, *, from_rest: bool = True) -> list[sp.Expr]:
    """[Ψ, ∂Ψ/∂I1, ∂Ψ/∂I2, ∂Ψ/∂J] in (I1 - d, I2 - 3, J - 1): what P needs where no stretch is asked for.

    Without `from_rest` in (I1, I2, J).
    """
    a, b, c = _Y
    if from_rest:
        psi = _cancel_constants(law.energy.xreplace({I1: law.dimension + a, I2: 3 + b, J: 1 + c}))
    else:
        psi = law.energy.xreplace({I1: a, I2: b, J: c})
    return [psi, sp.diff(psi, a), sp.diff(psi, b), sp.diff(psi, c)]


class _Printer(C99CodePrinter):
    def _print_Pow(self, expr):  # noqa: N802 - the name is sympy's
        base_, thirds = expr.base, 3 * expr.exp
        if thirds.is_Integer and not expr.exp.is_Integer:
            root = f"cbrt({self._print(base_)})"
            product = "*".join([root] * abs(int(thirds)))
            return f"({product})" if thirds > 0 else f"(1.0/({product}))"
        return super()._print_Pow(expr)


_EXPAND = create_expand_pow_optimization(6, base_req=lambda _: True)


def _function(name: str, expressions: list[sp.Expr], law: Law) -> str:
    """A C function that writes `expressions` of y and the parameters p to w."""
    names = {p: f"p[{k}]" for k, p in enumerate((*law.parameters, EPSILON, STIFFNESS))}
    names |= {c: f"y[{k}]" for k, c in enumerate(_Y)}
    symbols = {s: sp.Symbol(text) for s, text in names.items()}
    printer = _Printer()
    rewritten = [optimize(sp.sympify(e), (log1p_opt,)) for e in expressions]
    steps, results = sp.cse(rewritten, symbols=sp.numbered_symbols("x"))

    def text(expr: sp.Expr) -> str:
        return printer.doprint(_EXPAND(expr).xreplace(symbols))

    trace = " + ".join(f"y[{k}]" for k in range(law.dimension))
    lines = [f"  const double c = {trace};", "  (void)c; (void)p;"]
    lines += [f"  const double {left} = {text(right)};" for left, right in steps]
    lines += [f"  w[{k}] = {text(right)};" for k, right in enumerate(results)]
    head = f"static void {name}(const double *y, const double *p, double *w) {{"
    return "\n".join([head, *lines, "}\n"])


def c_source(law: Law, extension: str) -> str:
    """The law-specific half of the kernel (the other half is kernel.c)."""
    is_far = extension == "none" and not law.uses_stretches
    parts = [
        f"#define D {law.dimension}",
        f"#define LAW_PARAMETERS {len(law.parameters)}",
        f"#define IN_STRETCHES {int(law.uses_stretches)}",
        f"#define EXTENSION_{extension.upper()} 1",
        f"#define SKIPS_SVD {int(law.skips_svd)}",
        f"#define FAR {int(is_far)}",
        "#include <math.h>",
        _function("base", base(law, 2), law),
    ]
    if law.skips_svd:
        parts.append(_function("direct", direct(law), law))
    if is_far:
        parts.append(_function("base_far", far(law), law))
        if law.skips_svd:
            parts.append(_function("direct_far", direct(law, from_rest=False), law))
    if extension == "c2":
        parts.append(_function("base4", base(law, 4), law))
    if extension == "c1":
        parts += [_function(f"below_{n}", c1(law, n), law) for n in range(1, law.dimension + 1)]
    return "\n".join([*parts, '#include "kernel.c"\n'])
