"""Tuned PETSc defaults that give way to whatever the user has said."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc


@contextmanager
def defaults(prefix: str, table: Mapping[str, object]) -> Iterator[None]:
    """Options stand in PETSc's database where it has none of that name, while an object is being configured."""
    options = PETSc.Options(prefix)
    ours = [name for name in table if not options.hasName(name)]
    for name in ours:
        options.setValue(name, table[name])
    try:
        yield
    finally:
        for name in ours:
            options.delValue(name)
