"""`extremal mesh`: build a shape or read a mesh file, check it, say what it is, and write it."""

from __future__ import annotations

import argparse
import inspect
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import EXIT_FINISHED, InputError, suggestion
from .parallel import on_root
from .shapes import shape_parameters, shapes

if TYPE_CHECKING:
    from mpi4py import MPI

    from extremal.meshes import MeshData

# Volume of the regular simplex with edges of length 1.
REGULAR = {2: np.sqrt(3) / 4, 3: np.sqrt(2) / 12}


def add_arguments(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Declare the source and, for a shape, the parameters of that shape."""
    source = words[0] if words and not words[0].startswith("-") else None
    known = shapes()
    is_file = source is not None and source not in known
    parser.add_argument("source", metavar="SOURCE", help=f"a mesh file, or a shape: {', '.join(known)}")
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help="file to write: .msh, .vtu or .xdmf"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace FILE if it exists")
    if source is None and not {"-h", "--help"} & {*words}:
        raise InputError(f"mesh: SOURCE is missing; give a mesh file first, or a shape: {', '.join(known)}")
    if is_file and not {"-h", "--help"} & {*words} and not Path(str(source)).exists():
        hint = (
            "no such file" if Path(str(source)).suffix else "unknown shape; " + suggestion(str(source), known)
        )
        raise InputError(f"mesh: {source}: {hint}")
    accepted: Mapping[str, inspect.Parameter] = shape_parameters(str(source)) if source in known else {}
    for name in accepted or ("cell_size", "order"):
        default = accepted[name].default if name in accepted else inspect.Parameter.empty
        shown = "" if default is inspect.Parameter.empty or default is None else f"default {default}"
        parser.add_argument(
            f"--{name.replace('_', '-')}", dest=f"parameter {name}", metavar="VALUE", help=shown
        )


def run(args: argparse.Namespace, petsc_arguments: Sequence[str], comm: MPI.Comm) -> int:
    """Build or read, check, report and write the mesh on rank 0."""
    lines = on_root(comm, lambda: _run(args))
    if comm.rank == 0:
        print("\n".join(lines), flush=True)
    return EXIT_FINISHED


def _run(args: argparse.Namespace) -> list[str]:
    from extremal import meshes

    parameters = {
        key.removeprefix("parameter "): value_of(text)
        for key, text in vars(args).items()
        if key.startswith("parameter ") and text is not None
    }
    target: Path | None = args.output
    if target is not None:
        check_target(target, args.overwrite)
    if args.source in shapes():
        data = meshes.generate(args.source, **parameters)
    else:
        data = meshes.read_mesh(Path(args.source), **parameters)
    lines = report(args.source, data)
    lines += [f"  note: {note}" for note in getattr(data, "notes", ())]
    if target is not None:
        meshes.write_mesh(data, target)
        lines.append(f"  written to {target}")
    return lines


def value_of(text: str) -> Any:
    """Read a parameter: whole number, number, true or false, several separated by commas, or else text."""
    if "," in text:
        return [value_of(part.strip()) for part in text.split(",")]
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def check_target(target: Path, overwrite: bool) -> None:
    """Refuse a file to write that exists or has no place, before a mesh is built."""
    if target.suffix not in (".msh", ".vtu", ".xdmf"):
        raise InputError(f"{target}: unknown kind of file; must end with .msh, .vtu or .xdmf")
    if target.is_dir():
        raise InputError(f"{target}: is a folder; give a file")
    if target.exists() and not overwrite:
        raise InputError(f"{target}: exists; give --overwrite to replace it")
    if not target.parent.is_dir():
        raise InputError(f"{target}: the folder {target.parent} does not exist")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{target}: the folder {target.parent} may not be written")


def report(name: str, data: MeshData) -> list[str]:
    """Return lines about a mesh: counts, names, measures and quality."""
    d = data.points.shape[1]
    corners = np.ascontiguousarray(data.cells[:, : d + 1])
    kind = {2: "triangles", 3: "tetrahedra"}[d]
    measure = {2: "area", 3: "volume"}[d]
    unit = {2: "m2", 3: "m3"}[d]
    volumes, edges = measures(data.points, corners)
    quality = volumes / (REGULAR[d] * (edges**2).mean(axis=1) ** (d / 2))
    worst = int(np.argmin(quality))
    size = data.points.max(axis=0) - data.points.min(axis=0)
    lines = [
        f"{name}: {len(data.cells)} {kind} of order {data.order}, {len(data.points)} nodes",
        f"  extent {' x '.join(f'{side:.6g}' for side in size)} m, {measure} {volumes.sum():.6g} {unit}, "
        f"edges {edges.min():.3g} to {edges.max():.3g} m, mean {edges.mean():.3g} m",
        f"  quality (1 regular, 0 flat): mean {quality.mean():.3f}, "
        f"least {quality[worst]:.3f} in element {worst}",
    ]
    regions = {n: int((data.regions == tag).sum()) for n, tag in data.region_names.items()}
    boundaries = {n: int((data.facet_tags == tag).sum()) for n, tag in data.boundary_names.items()}
    for title, counts, what in (("regions", regions, "cells"), ("boundaries", boundaries, "facets")):
        listing = ", ".join(f"{n} ({count} {what})" for n, count in counts.items())
        lines.append(f"  {title}: {listing or 'none is named'}")
    return lines


def measures(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each cell's volume (m,) [m^d] and edge lengths (m, edges) [m]."""
    d = points.shape[1]
    x = points[corners]
    volumes = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / {2: 2.0, 3: 6.0}[d]
    i, j = np.triu_indices(d + 1, k=1)
    return volumes, np.linalg.norm(x[:, i] - x[:, j], axis=2)
