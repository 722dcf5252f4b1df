"""A bad scene is refused with exactly one plain line for each thing wrong, and nothing is written."""

from pathlib import Path

import pytest
from bad_scenes import cases, refusal

from extremal.app.errors import InputError
from extremal.app.scene import read_scene

# what a case does not give itself
MESH = '[mesh]\nshape = "box"\ncell_size = 0.5\n'
MATERIAL = "[material]\nyoung_modulus = 1e5\npoisson_ratio = 0.3\n"


CASES = cases("bad_scenes.txt")

# to these no mesh and material are added
BARE: list[list[str]] = [
    [
        '[mesh]\nshape = "box',
        "line 2, column 13: not TOML: Illegal character '\\n'",
    ],
    [
        'title = "a"\ntitle = "b"',
        "line 2, column 12: not TOML: Cannot overwrite a value",
    ],
    [
        "x = [1,",
        "line 2, at the end: not TOML: Invalid value",
    ],
    [
        "a = 1 b = 2",
        "line 1, column 7: not TOML: Expected newline or end of document after a statement",
    ],
    [
        '[mesh]\nshape = "box"',
        "[material]: is missing; the material, everywhere unless a region overrides it",
    ],
    [
        "[material]\nyoung_modulus = 1\npoisson_ratio = 0.3",
        "[mesh]: is missing; the body",
    ],
]


def completed(text: str) -> str:
    """A scene with a mesh and a material if it has none; after its own tables, so that line numbers stay."""
    if "[mesh]" not in text and not text.startswith("mesh"):
        text += "\n" + MESH
    return text if "[material]" in text else text + "\n" + MATERIAL


@pytest.mark.parametrize("case", CASES, ids=[case[0] for case in CASES])
def test_bad_scene_is_refused_in_plain_words(case: list[str], tmp_path: Path) -> None:
    text, *messages = case
    assert refusal(tmp_path / "scene.toml", completed(text)) == messages


@pytest.mark.parametrize("case", BARE, ids=[case[0] for case in BARE])
def test_bad_file_is_refused_in_plain_words(case: list[str], tmp_path: Path) -> None:
    text, *messages = case
    assert refusal(tmp_path / "scene.toml", text + "\n") == messages


def test_there_are_at_least_sixty_distinct_messages() -> None:
    assert len({message for case in CASES + BARE for message in case[1:]}) >= 60


def test_a_number_beyond_all_is_refused_and_cut_short(tmp_path: Path) -> None:
    lines = refusal(tmp_path / "scene.toml", completed("[solver]\ntolerance = 1" + "0" * 400))
    assert lines == ["[solver] tolerance = 1" + "0" * 55 + " ...: must be a finite number"]


def test_all_errors_of_a_scene_are_reported_at_once(tmp_path: Path) -> None:
    text = """
        [mesh]
        shape = "box"
        [material]
        young_modulus = -1
        poisson_ratio = 0.7
        [gravity]
        acceleration = [1, 2]
        [solver]
        tolerance = -1
        iteration = 3
        [damping]
        mass = 1
    """
    assert refusal(tmp_path / "scene.toml", text) == [
        "[material] poisson_ratio = 0.7: must be above -1 and below 0.5 (nearly incompressible: 0.499)",
        "[material] young_modulus = -1: must be above 0",
        "[solver] tolerance = -1: must be above 0",
        "[solver] iteration = 3: unknown key; did you mean iterations?",
        '[damping]: needs [analysis] type = "dynamic"',
        "[gravity] acceleration = [1, 2]: must have 3 components: the body is 3-dimensional",
    ]


def test_a_plane_scene_with_components_of_space_is_refused(tmp_path: Path) -> None:
    text = """
        [mesh]
        shape = "box"
        dimension = 2
        [material]
        law = "custom"
        energy = "J*s3"
        density = 1
        [gravity]
        acceleration = [0, 0, -9.81]
        [[fixed]]
        boundary = "left"
        components = ["x", "z"]
        [[traction]]
        boundary = "left"
        value = [0, 0, 1]
        [[motion]]
        boundary = "right"
        keyframes = [{ time = 0, rotation = [0, 1, 0] }]
        [initial]
        state = "mirror"
        axis = "z"
    """
    assert refusal(tmp_path / "scene.toml", text) == [
        "[[motion]] #1 keyframes #1 rotation = [0, 1, 0]: must be one angle [rad], or [0, 0, angle]: "
        "the body is 2-dimensional",
        "[[traction]] #1 value = [0, 0, 1]: must have 2 components: the body is 2-dimensional",
        "[gravity] acceleration = [0, 0, -9.81]: must have 2 components: the body is 2-dimensional",
        '[[fixed]] #1 components = ["x", "z"]: has no "z": the body is 2-dimensional',
        '[initial] axis = "z": must be "x" or "y": the body is 2-dimensional',
        '[material] energy = "J*s3": s3 does not exist in 2 dimensions; use i1, J, I1 or s1, s2',
    ]


def test_a_mesh_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    lines = refusal(tmp_path / "scene.toml", '[mesh]\nfile = "body.msh"\n' + MATERIAL)
    assert lines == [f'[mesh] file = "body.msh": no such file: {tmp_path / "body.msh"}']


def test_a_scene_that_is_not_a_readable_file_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b'title = "a"\nb = "\xff"\n')
    deep = tmp_path / "deep.toml"
    deep.write_text("a = " + "[" * 5000)
    for path, message in (
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "is a folder; give a scene file"),
        (binary, "line 2: is not UTF-8 text"),
        (deep, "is nested too deeply for a scene"),
    ):
        with pytest.raises(InputError) as caught:
            read_scene(path)
        assert caught.value.messages == (f"{path}: {message}",)
