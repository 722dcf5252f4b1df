"""Scenes with mistakes and the lines that refuse them; what scenes of all parts have in common."""

from collections.abc import Iterator
from pathlib import Path

import pydantic
import pytest

from extremal.app.errors import InputError
from extremal.app.scene import read_scene
from extremal.app.scene_errors import _models_in


def cases(name: str) -> list[list[str]]:
    """The scenes of a file beside this one, each followed by one line for each of its errors."""
    blocks = (Path(__file__).parent / name).read_text(encoding="utf-8").strip().split("\n\n")
    return [block.split("\n=> ") for block in blocks]


def refusal(path: Path, text: str) -> list[str]:
    """The lines with which a scene is refused, without the file's name; nothing is written."""
    path.write_text(text, encoding="utf-8")
    before = sorted(path.parent.iterdir())
    with pytest.raises(InputError) as caught:
        read_scene(path)
    assert sorted(path.parent.iterdir()) == before
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in caught.value.messages)
    return [line.removeprefix(f"{path}: ") for line in caught.value.messages]


def keys(model: type[pydantic.BaseModel]) -> Iterator[tuple[str, str | None]]:
    """Every key of a scene's tables with what it means."""
    for name, field in model.model_fields.items():
        yield f"{model.__name__}.{name}", field.description
        for below in _models_in(field.annotation):
            yield from keys(below)
