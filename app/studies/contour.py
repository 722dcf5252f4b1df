"""`extremal study contour`: where a law draws a stretched body (primary contours, figures 6.1, 6.4 and 6.9).

Without --law or --energy it compares three laws in two dimensions, and shows the kinks of two energies; with one of
them it looks at that law alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import EXIT_FINISHED, InputError, suggestion
from ..parallel import on_root
from ..results import atomic
from ._table import make_folder, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.forms.contour import Plane
    from extremal.forms.kernel import Kernel

COLUMNS = ("law", "extension", "dimension", "sigma1", "sigma2", "sigma3", "piece", "primary", "valid")
LAWS = ("neo_hookean", "corotated", "fixed_corotated", "st_venant_kirchhoff", "mooney_rivlin")
EXTENSIONS = ("none", "c1", "c2", "ife")
COMPARED = (("corotated", "none"), ("fixed_corotated", "none"), ("neo_hookean", "c2"))
SLICES = (1.0, 2.0, 5.0)


@dataclass(frozen=True)
class Subject:
    """A law with its parameters, E = 1 Pa."""

    name: str
    extension: str
    kernel: Kernel
    parameters: list[float]
    poisson_ratio: float

    @property
    def title(self) -> str:
        """Name and extension for people."""
        law = self.name.replace("_", " ").replace("neo hookean", "Neo-Hookean")
        return law if self.extension == "none" else f"{law}, {self.extension.upper()} extension"

    def sentence(self) -> str:
        """Where its primary contour goes."""
        from extremal.forms.contour import crosses_into_inversion

        if not self.poisson_ratio > 0:
            return f"{self.title}: at ν = {self.poisson_ratio:g} no direction stands out, there is no primary contour"
        found = crosses_into_inversion(self.kernel, self.parameters).sentence()
        return f"{self.title}, ν = {self.poisson_ratio:g}, {self.kernel.dimension}D: {found}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the study's arguments."""
    parser.add_argument("--law", metavar="LAW", help=f"one of {', '.join(LAWS)}")
    parser.add_argument(
        "--energy", metavar="EXPRESSION", help="a custom law: Ψ of i1, i2, J, I1, I2 or s1, s2, s3, and of mu, lam, d"
    )
    parser.add_argument("--extension", metavar="KIND", help=f"one of {', '.join(EXTENSIONS)}; default none")
    parser.add_argument("--dimension", metavar="D", type=int, help="2 (default) or 3")
    parser.add_argument("--poisson-ratio", metavar="ν", type=float, default=0.45, help="default 0.45")
    parser.add_argument("--threshold", metavar="ε", type=float, help="of the extension; default as in scenes")
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, help="folder for the results; default results/contour"
    )


def run(args: argparse.Namespace, comm: MPI.Comm) -> int:
    """Compute, draw and write on rank 0 (collective)."""
    for sentence in on_root(comm, lambda: _study(args)):
        if comm.rank == 0:
            print(sentence)
    return EXIT_FINISHED


def _study(args: argparse.Namespace) -> list[str]:
    from . import _contour_picture as picture

    _check(args)
    folder = args.output or Path("results") / "contour"
    ν, ε = args.poisson_ratio, args.threshold
    if args.law is None and args.energy is None:
        subjects = [subject(law, extension, 2, ν, ε) for law, extension in COMPARED]
        planes = [(one, plane_of(one)) for one in subjects]
        kinked = [subject("corotated", "none", 3, ν), subject("neo_hookean", "c1", 2, ν)]
        figures = {
            "contour.png": picture.contours(planes),
            "surface.png": picture.kinks(kinked[0], kinked[1]),
        }
        told = [*subjects, kinked[0]]
    else:
        law = args.law if args.energy is None else args.energy
        one = subject(law, args.extension or "none", args.dimension or 2, ν, ε, custom=args.energy is not None)
        cuts = [None] if one.kernel.dimension == 2 else list(SLICES)
        planes = [(one, plane_of(one, c)) for c in cuts]
        figures = {"contour.png": picture.contours(planes), "surface.png": picture.surfaces(planes)}
        told = [one]
    sentences = [one.sentence() for one in told]
    make_folder(folder)
    write_rows(folder / "contour.csv", COLUMNS, _rows(planes))
    with atomic(folder / "surface.npz") as partial, open(partial, "wb") as file:
        np.savez_compressed(file, **_arrays(planes))
    for name, figure in figures.items():
        with atomic(folder / name) as partial:
            figure.savefig(partial, format="png")
    return [*sentences, f"{', '.join(('contour.csv', 'surface.npz', *figures))} are in {folder}"]


def _check(args: argparse.Namespace) -> None:
    if args.law is not None and args.energy is not None:
        raise InputError("--energy: given together with --law; give one of them")
    for option, value, known in (("--law", args.law, LAWS), ("--extension", args.extension, EXTENSIONS)):
        if value is not None and value not in known:
            raise InputError(f"{option} {value}: unknown; {suggestion(value, known)}")
    if args.dimension not in (None, 2, 3):
        raise InputError(f"--dimension {args.dimension}: must be 2 or 3")
    if not -1 < args.poisson_ratio < 0.5:
        raise InputError(f"--poisson-ratio {args.poisson_ratio:g}: must be above -1 and below 0.5")
    if args.threshold is not None and not 0 < args.threshold < 1:
        raise InputError(f"--threshold {args.threshold:g}: must be above 0 and below 1")
    alone = args.law is None and args.energy is None
    for option, value in (("--extension", args.extension), ("--dimension", args.dimension)):
        if alone and value is not None:
            raise InputError(f"{option} {value}: belongs to --law or --energy; give one of them as well")


def subject(
    law: str, extension: str, dimension: int, poisson_ratio: float, threshold: float | None = None, custom: bool = False
) -> Subject:
    """Compile a law for E = 1 Pa.

    Parameters
    ----------
    law : str
        A name, or the expression of a custom energy.
    threshold : float or None
        ε; None for the extension's default.

    Raises
    ------
    InputError, LawError
        If the energy cannot be used.
    """
    from extremal.forms import laws
    from extremal.forms.kernel import Kernel
    from extremal.forms.material import Material

    if custom:
        from ..expression import ExpressionError, parse

        try:
            energy = parse(law, ["i1", "i2", "J", "I1", "I2", "s1", "s2", "s3", "d", "mu", "lam"])
            made, name = laws.custom(energy, dimension), "custom"
        except (ExpressionError, laws.LawError) as error:
            raise InputError(f"--energy: {error}") from None
    else:
        made, name = laws.law(law, dimension), law
    moduli = {"young_modulus": 1.0, "poisson_ratio": poisson_ratio}
    material = Material(made, moduli, extension=extension, threshold=threshold if extension != "none" else None)
    return Subject(
        name, extension, Kernel(made, extension), material.values(np.zeros((1, 3)))[0].tolist(), poisson_ratio
    )


def plane_of(one: Subject, fixed: float | None = None, points: int = 201) -> Plane:
    """Energy and contour of the part of stretch space that the pictures show."""
    from extremal.forms.contour import plane

    # no grid line on σ = 0, σ1 = ±σ2 or through rest: there the law may have no value, or v no direction
    first = np.linspace(-1.5, 4.0, points) + 1.37e-3
    second = np.linspace(-1.5, 4.0, points) + 0.71e-3
    if fixed is not None:
        first = np.linspace(-3.0, 3.0, points) + 1.37e-3
        second = np.linspace(-3.0, 3.0, points) + 0.71e-3
    return plane(one.kernel, one.parameters, first, second, fixed)


def _rows(planes: Sequence[tuple[Subject, Plane]]) -> list[dict[str, Any]]:
    from extremal.forms.contour import is_valid

    rows = []
    for one, part in planes:
        points = part.segments.reshape(-1, 2)
        if part.fixed is not None:
            points = np.column_stack([np.full(len(points), part.fixed), points])
        for k, (σ, valid) in enumerate(zip(points, is_valid(points), strict=True)):
            row = {"law": one.name, "extension": one.extension, "dimension": one.kernel.dimension, "piece": k // 2}
            row |= {f"sigma{i + 1}": repr(float(x)) for i, x in enumerate(σ)}
            rows.append(row | {"primary": int(part.primary[k // 2]), "valid": int(valid)})
    return rows


def _arrays(planes: Sequence[tuple[Subject, Plane]]) -> dict[str, Any]:
    arrays = {}
    for one, part in planes:
        key = f"{one.name}_{one.extension}" + ("" if part.fixed is None else f"_sigma1_{part.fixed:g}")
        for name in ("first", "second", "energy", "gradient", "attraction", "valid"):
            arrays[f"{key}_{name}"] = getattr(part, name)
    return arrays
