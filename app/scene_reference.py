"""Reference of all keys of a scene, from the models themselves: `python -m extremal.app.scene_reference`."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from .collider_scene import Keys, Shape
from .elastic_scene import ElasticScene
from .expression import CONSTANTS, FUNCTIONS
from .hawkes_scene import HawkesScene
from .snow_scene import SnowScene

INTRODUCTION = """# Scene files

Written by `python -m extremal.app.scene_reference > docs/scenes.md` from the models that validate scenes.

A scene is a TOML file. `part` says which command runs it: [`extremal elastic SCENE`](#extremal-elastic) (also where
`part` is absent), [`extremal snow SCENE`](#extremal-snow) or [`extremal hawkes SCENE`](#extremal-hawkes).
`extremal check SCENE...` lists everything wrong in scenes of any part. An absent table means: no such effect, at no
cost. Unknown keys are errors. Units are SI throughout, except for the time of networks. Where a table below says
nothing of a default, the effect or key is absent.

## Expressions

Where a number may be an expression, write it in quotes: arithmetic `+ - * / **`, comparisons
`< <= > >= == !=`, `and`, `or`, `not`, the constants {constants} and the functions
{functions}.
`where(condition, a, b)` chooses, `log` is the natural logarithm. Nothing is executed as Python, and powers
are at most 64. Positions x, y, z are those of the reference body [m]; in the plane z is 0.
"""

ELASTIC = """# extremal elastic

Only `[mesh]` and `[material]` are needed.

```toml
title = "a cube, stretched"
[mesh]
shape = "box"
cell_size = 0.2                    # m
[material]
young_modulus = 1e5                # Pa
poisson_ratio = 0.45
[[fixed]]
boundary = "left"
[[motion]]
boundary = "right"
displacement = ["0.5*t", 0, 0]     # m
[expect]
status = "finished"
inverted = 0
```
"""

SNOW = """# extremal snow

Only `part`, `[grid]`, one `[[body]]` and `[analysis]` are needed.

```toml
title = "a snowball, dropped"
part = "snow"
[grid]
cell_size = 0.02                   # m
[[body]]
shape = "sphere"
center = [0, 0, 0.5]               # m
radius = 0.2                       # m
[[collider]]
shape = "half_space"
point = [0, 0, 0]                  # m
normal = [0, 0, 1]
friction = 0.5
[gravity]
acceleration = [0, 0, -9.81]       # m/s2
[analysis]
end_time = 1.0                     # s
[expect]
status = "finished"
```
"""

HAWKES = """# extremal hawkes

Only `part`, `[network]` and one of `[events]` and `[simulation]` are needed. [networks.md](networks.md) explains.

```toml
title = "incidents"
part = "hawkes"
[network]
file = "network.csv"               # first,second
[events]
file = "events.csv"                # time,first,second
unit = "days"
[estimation]
rounds = 100
[expect]
status = "finished"
gap = { below = 1e-8 }
```
"""

NOTES = {
    "elastic.mesh": "A shape's own parameters (`size`, `radius`, `dimension` ...) stand beside these; "
    "`extremal mesh SHAPE --help` lists them.",
    "elastic.regions": "Any subset of the keys of `[material]`, which it overrides in that region of the mesh. A "
    "region with another law, extension or pair of moduli does not inherit what belonged to the old one.",
    "elastic.material": "Give `young_modulus` and `poisson_ratio`, or `shear_modulus` and `lame_lambda`. `density` "
    "has no default: dynamics and gravity ask for it. A custom energy may use `mu` and `lam` if moduli are "
    "given.",
    "snow.solid": "Tables such as `[solid.mesh]` and `[[solid.fixed]]` have the keys they have in a scene for "
    "[`extremal elastic`](#extremal-elastic). Gravity, times and steps are those of the snow. "
    "[snow.md](snow.md#an-elastic-body-in-the-snow) explains.",
    "petsc": "Any PETSc option as `name = value`, for example `{part}_ksp_rtol = 1e-4`. The command line "
    "and an `-options_file` win over the scene. Options nobody used are reported at the end.",
    "hawkes.petsc": "Any PETSc option as `name = value`, for example `hawkes_tao_type = \"tron\"`. The command line "
    "and an `-options_file` win over the scene. Options nobody used are reported at the end.",
    "expect": "`name = number`, or a table with these keys, over the final diagnostics, `status` and "
    "`steps`.",
    "elastic.continuation": "Stages are an addition of this program to the method it implements.",
}


def markdown() -> str:
    """Return the whole reference."""
    introduction = INTRODUCTION.format(
        constants=", ".join(f"`{name}`" for name in CONSTANTS),
        functions=textwrap.fill(", ".join(f"`{name}`" for name in FUNCTIONS), 105),
    )
    parts = [introduction, ELASTIC, *_tables(ElasticScene, "elastic"), SNOW, *_tables(SnowScene, "snow")]
    parts += [HAWKES, *_tables(HawkesScene, "hawkes")]
    return "\n".join(parts).rstrip() + "\n"


def _tables(scene: type[BaseModel], part: str) -> Iterator[str]:
    yield "## Top level\n"
    yield _table(scene, plain_only=True)
    for name, field in scene.model_fields.items():
        model = _model(field.annotation)
        if model is None and name != "petsc":
            continue
        yield f"## {_heading(name, field)}\n"
        yield _sentence(str(field.description))
        note = NOTES.get(f"{part}.{name}", NOTES.get(name))
        if note is not None:
            yield note.format(part=part) + "\n"
        if model is not None and issubclass(model, Shape):
            yield _shapes(model.KEYS)
        if model is not None and name != "regions":
            yield _table(model)
            yield from _inner(_heading(name, field), model)


def _shapes(shapes: Keys) -> str:
    rows = ["| shape | needs | may have |", "|---|---|---|"]
    for shape, keys in shapes.items():
        needed, optional = (", ".join(f"`{key}`" for key in some) for some in keys)
        rows.append(f"| `\"{shape}\"` | {needed} | {optional} |")
    return "\n".join(rows) + "\n"


def _inner(heading: str, model: type[BaseModel]) -> Iterator[str]:
    described = [_model(field.annotation) for field in ElasticScene.model_fields.values()]
    for key, field in model.model_fields.items():
        below = _model(field.annotation)
        if below is not None and below not in described:
            yield f"### {key} of {heading}\n"
            yield _sentence(str(field.description))
            yield _table(below)


def _heading(name: str, field: FieldInfo) -> str:
    if name == "regions":
        return "[regions.NAME]"
    return f"[[{name}]]" if get_origin(field.annotation) is tuple else f"[{name}]"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:].rstrip(".") + ".\n"


def _table(model: type[BaseModel], plain_only: bool = False) -> str:
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for key, field in model.model_fields.items():
        if plain_only and (_model(field.annotation) is not None or key == "petsc"):
            continue
        choices = ", ".join(
            f'`"{c}"`' if isinstance(c, str) else f"`{c}`" for c in _choices(field.annotation)
        )
        meaning = f"{field.description}{': ' * bool(choices)}{choices}"
        rows.append(f"| `{key}` | {_default(field)} | {meaning.replace('|', chr(92) + '|')} |")
    return "\n".join(rows) + "\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    if field.default_factory is not None or field.default in (None, (), "", PydanticUndefined):
        return ""
    value: Any = field.default
    if isinstance(value, tuple):
        return "`[" + ", ".join(f'"{entry}"' for entry in value) + "]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def _choices(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    for argument in get_args(annotation):
        found = _choices(argument)
        if found:
            return found
    return ()


def _model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_model(argument) for argument in get_args(annotation))
    return next((model for model in found if model is not None), None)


if __name__ == "__main__":
    print(markdown(), end="")
