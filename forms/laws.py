"""Isotropic energy densities, written once as sympy expressions.

An energy is a function of the invariants of the stretch tensor S (F = R S, chapter 6.1; the smallest stretch
carries the sign of det F)

    3D  i1 = σ1 + σ2 + σ3,  i2 = σ1σ2 + σ2σ3 + σ1σ3,  J = σ1σ2σ3        2D  i1 = σ1 + σ2,  J = σ1σ2

or of those of C = FᵀF: I1 = Σ σi², I2 = Σ σi²σj² (3D only), J; or of the stretches s1, s2, s3 themselves.
A two-dimensional body is in plane strain. `symbolic.py` derives everything else from the expression.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import sympy as sp

MU, LAMBDA = sp.symbols("mu lambda_", real=True)
SHARE = sp.Symbol("share", real=True)
I1, I2, J = sp.symbols("I1 I2 J", real=True)
i1, i2 = sp.symbols("i1 i2", real=True)
STRETCHES = sp.symbols("s1 s2 s3", real=True)


class LawError(ValueError):
    """A constitutive law or its parameters cannot be used; the message is one line for the user."""


@dataclass(frozen=True)
class Law:
    """An isotropic energy density in `dimension` 2 or 3.

    Attributes
    ----------
    name : str
    dimension : int
    energy : sympy.Expr
        Ψ [Pa] in the symbols of this module and `parameters`.
    parameters : tuple of sympy.Symbol
        In the order in which values are given to the kernel; μ and λ [Pa] come first.
    """

    name: str
    dimension: int
    energy: sp.Expr
    parameters: tuple[sp.Symbol, ...] = (MU, LAMBDA)
    uses_stretches: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "uses_stretches", bool(self.energy.free_symbols & set(STRETCHES)))

    @property
    def skips_svd(self) -> bool:
        """Whether Ψ is a function of (I1, I2, J) alone, so that P needs no stretches (6.3.1)."""
        return not self.energy.free_symbols & {i1, i2, *STRETCHES}


def neo_hookean(dimension: int) -> sp.Expr:
    """Ψ = μ/2 (I1 - d) - μ ln J + λ/2 (ln J)², section 6.4."""
    return MU / 2 * (I1 - dimension) - MU * sp.log(J) + LAMBDA / 2 * sp.log(J) ** 2


def corotated(dimension: int) -> sp.Expr:
    """Ψ = μ Σ(σi - 1)² + λ/2 (Σ(σi - 1))², section 6.2.3."""
    return MU * (I1 - 2 * i1 + dimension) + LAMBDA / 2 * (i1 - dimension) ** 2


def fixed_corotated(dimension: int) -> sp.Expr:
    """Ψ = μ Σ(σi - 1)² + λ/2 (J - 1)², eq. (6.1)."""
    return MU * (I1 - 2 * i1 + dimension) + LAMBDA / 2 * (J - 1) ** 2


def st_venant_kirchhoff(dimension: int) -> sp.Expr:
    """Ψ = μ E:E + λ/2 (tr E)² with E = (C - I)/2; tr C² = I1² - 2 I2 (3D), I1² - 2 J² (2D)."""
    trace_c2 = I1**2 - 2 * (I2 if dimension == 3 else J**2)
    return MU / 4 * (trace_c2 - 2 * I1 + dimension) + LAMBDA / 8 * (I1 - dimension) ** 2


def mooney_rivlin(dimension: int) -> sp.Expr:
    """Ψ = c1 (I1 J^-2/3 - 3) + c2 (I2 J^-4/3 - 3) + κ/2 (J - 1)², three terms; plane strain in 2D.

    c1 = (1 - share) μ/2, c2 = share μ/2 and κ = λ + 2μ/3, so that μ and λ are those of linear elasticity.
    """
    full_i1, full_i2 = (I1, I2) if dimension == 3 else (I1 + 1, I1 + J**2)
    third = sp.Rational(1, 3)
    first, second = full_i1 * J ** (-2 * third) - 3, full_i2 * J ** (-4 * third) - 3
    return MU / 2 * ((1 - SHARE) * first + SHARE * second) + (LAMBDA + 2 * third * MU) / 2 * (J - 1) ** 2


ENERGIES: Mapping[str, Callable[[int], sp.Expr]] = {
    "neo_hookean": neo_hookean,
    "corotated": corotated,
    "fixed_corotated": fixed_corotated,
    "st_venant_kirchhoff": st_venant_kirchhoff,
    "mooney_rivlin": mooney_rivlin,
}


def law(name: str, dimension: int) -> Law:
    """The built-in law of that name; raises `LawError` naming those there are."""
    if name not in ENERGIES:
        raise LawError(f"law {name!r} is unknown: one of {', '.join(ENERGIES)}, custom")
    energy = ENERGIES[name](dimension)
    return Law(name, dimension, energy, (MU, LAMBDA, SHARE) if SHARE in energy.free_symbols else (MU, LAMBDA))


def custom(energy: sp.Expr, dimension: int, parameters: tuple[str, ...] = ()) -> Law:
    """A user's energy.

    Parameters
    ----------
    energy : sympy.Expr
        Ψ [Pa] in symbols named i1, i2, J, I1, I2, s1, s2, s3, d, mu, lambda (or lambda_) and `parameters`.
    dimension : int
    parameters : tuple of str
        Names of further parameters.

    Raises
    ------
    LawError
        Unknown symbols, an invariant that the dimension does not have, an energy that is not smooth, not
        symmetric in the stretches, or not finite at rest.
    """
    known: dict[str, sp.Expr] = {str(s): s for s in (i1, i2, J, I1, I2, *STRETCHES, MU)}
    known |= {"lambda": LAMBDA, "lambda_": LAMBDA, "lam": LAMBDA, "d": sp.Integer(dimension)}
    extra = {name: sp.Symbol(name, real=True) for name in parameters}
    clash = sorted(set(extra) & set(known))
    if clash:
        raise LawError(f"parameter {clash[0]!r} has the name of an invariant: choose another name")
    known |= extra
    unknown = sorted(str(s) for s in energy.free_symbols if str(s) not in known)
    if unknown:
        raise LawError(f"energy uses {unknown[0]!r}: it may use {', '.join(sorted(known))}")
    expr = energy.xreplace({s: known[str(s)] for s in energy.free_symbols})
    missing = {3: set(), 2: {i2, I2, STRETCHES[2]}}[dimension]
    if expr.free_symbols & missing:
        name = sorted(str(s) for s in expr.free_symbols & missing)[0]
        raise LawError(
            f"energy uses {name!r}, which a two-dimensional body does not have: use i1, J, I1, s1, s2"
        )
    rough = expr.atoms(sp.Max, sp.Min, sp.Piecewise, sp.Abs, sp.sign, sp.floor, sp.ceiling)
    if rough:
        raise LawError(
            f"energy has {type(next(iter(rough))).__name__}: it must be smooth, four derivatives are taken"
        )
    made = Law("custom", dimension, expr, (MU, LAMBDA, *extra.values()))
    _check_rest(made)
    _check_isotropic(made)
    return made


def _check_rest(law_: Law) -> None:
    s = STRETCHES[: law_.dimension]
    expr = in_stretches(law_.energy, law_.dimension)
    rest: dict[sp.Expr, sp.Expr] = {x: sp.Integer(1) for x in s}
    rest |= {p: sp.Rational(17 + k, 10) for k, p in enumerate(law_.parameters)}
    for part in (expr, sp.diff(expr, s[0]), sp.diff(expr, s[0], s[0])):
        if not part.subs(rest).is_finite:
            raise LawError(
                "energy or its derivatives are not finite at rest, where every stretch and J are 1"
            )


def _check_isotropic(law_: Law) -> None:
    if not law_.uses_stretches:
        return
    s = STRETCHES[: law_.dimension]
    numbers = dict(zip(s, (sp.Rational(13, 10), sp.Rational(9, 10), sp.Rational(11, 10)), strict=False))
    numbers |= {p: sp.Rational(17 + k, 10) for k, p in enumerate(law_.parameters)}
    values = []
    for order in ((0, 1, 2), (1, 0, 2), (0, 2, 1))[: 3 if law_.dimension == 3 else 2]:
        swapped = law_.energy.xreplace({s[a]: s[b] for a, b in enumerate(order[: len(s)])})
        values.append(float(in_stretches(swapped, law_.dimension).subs(numbers)))
    if max(values) - min(values) > 1e-10 * (1 + abs(values[0])):
        raise LawError(
            "energy changes when stretches are exchanged: it must be symmetric in s1, s2, s3 (isotropic)"
        )


def in_stretches(expr: sp.Expr, dimension: int) -> sp.Expr:
    """`expr` with every invariant written in s1, s2(, s3)."""
    s = STRETCHES[:dimension]
    table = {i1: sum(s), J: sp.prod(s), I1: sum(x**2 for x in s)}
    if dimension == 3:
        a, b, c = s
        table |= {i2: a * b + b * c + a * c, I2: (a * b) ** 2 + (b * c) ** 2 + (a * c) ** 2}
    return expr.subs(table)
