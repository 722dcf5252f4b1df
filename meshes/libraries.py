"""What differs between versions of gmsh and meshio, or needs care, in one place."""

from __future__ import annotations

import contextlib
import inspect
import io
import re
import tempfile
import warnings
from pathlib import Path
from typing import Any


def gmsh_arguments(initialize: Any) -> dict[str, Any]:
    """Arguments of `gmsh.initialize`: no configuration files; no signal handler where there is a choice."""
    accepted = inspect.signature(initialize).parameters
    wanted = {"readConfigFiles": False, "interruptible": False}
    return {name: value for name, value in wanted.items() if name in accepted}


def meshio_formats() -> dict[str, list[str]]:
    """Formats that meshio knows for each file extension."""
    import meshio

    return dict(meshio.extension_to_filetypes)


def meshio_read(path: Path, file_format: str) -> Any:
    """`meshio.read` with exceptions only: it prints its errors and ends the process.

    Raises
    ------
    ValueError
        With what meshio had to say, on one line.
    """
    import meshio
    from meshio.gmsh import _gmsh41

    def entities(*arguments: Any) -> Any:
        # Entities outside all physical groups get the tag 0, as in format 2.2; otherwise meshio fails where
        # only some entities are in a group.
        physical, bounding = read_entities(*arguments)
        return tuple({tag: found or [0] for tag, found in of.items()} for of in physical), bounding

    said = io.StringIO()
    read_entities = _gmsh41._read_entities
    try:
        if file_format == "vtu":
            # What is new in 2.x of the format does not concern simplices, but meshio knows 1.0 at most.
            with path.open("rb") as file:
                newer = re.search(rb'<VTKFile[^>]*\sversion="2\.\d"', file.read(2000))
            if newer:
                return _read_as_version_1(path)
        _gmsh41._read_entities = entities
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return meshio.read(path, file_format=file_format)
    except (Exception, SystemExit) as error:
        # Before it ends the process meshio prints why; its last line only repeats the name of the file.
        reason = str(error)
        if isinstance(error, SystemExit):
            reason = said.getvalue().partition("Error:")[0].strip() or "not a file of this kind"
        raise ValueError(" ".join(reason.split()) or type(error).__name__) from None
    finally:
        _gmsh41._read_entities = read_entities


def _read_as_version_1(path: Path) -> Any:
    import meshio

    content = path.read_bytes()
    head = re.sub(rb'(<VTKFile[^>]*\sversion=")2\.\d(")', rb"\g<1>1.0\g<2>", content[:2000])
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mesh.vtu"
        copy.write_bytes(head + content[2000:])
        return meshio.read(copy, file_format="vtu")
