"""Compiled forms outlive what interrupts their compilation."""

import pytest
import ufl
from elastic_bodies import on

from extremal.forms import compat


@pytest.mark.mpi
def test_a_compilation_that_was_killed_is_made_again(comm, shared_path, monkeypatch):
    monkeypatch.setattr(compat, "_OPTIONS", {"cache_dir": str(shared_path), "timeout": 1})
    domain = on(comm, "box", cell_size=0.5)
    volume = 7.0 * ufl.dx(domain.mesh)
    compat.form(volume)
    comm.barrier()
    sources = sorted(shared_path.glob("libffcx_forms_*.c"))
    assert len(sources) == 1
    comm.barrier()
    if comm.rank == 0:  # what a kill leaves behind
        for path in [*shared_path.glob("*.cached"), *shared_path.glob("*.so"), *shared_path.glob("*.o")]:
            path.unlink()
        sources[0].write_text("")
    comm.barrier()
    compat.form(volume)
    comm.barrier()
    assert sources[0].stat().st_size > 0
