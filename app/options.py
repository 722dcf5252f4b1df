"""PETSc's options database: what the user gave, what the scene gives, what are defaults of ours."""

from __future__ import annotations

import ctypes
import re
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from .errors import InputError, nearest

# Options PETSc consults only at its very end: never unused.
AT_THE_END = frozenset({"options_left", "options_view", "log_view", "memory_view", "malloc_dump", "help"})

# Names often wanted, to find what a mistyped one was meant to be.
COMMON = (
    "snes_type", "snes_monitor", "snes_converged_reason", "snes_view", "snes_rtol", "snes_atol",
    "snes_stol", "snes_max_it", "snes_max_funcs", "snes_linesearch_type", "snes_linesearch_max_it",
    "snes_linesearch_monitor", "snes_linesearch_order", "snes_linesearch_damping",
    "snes_max_linear_solve_fail", "snes_lag_preconditioner", "snes_lag_jacobian", "snes_ksp_ew",
    "snes_test_jacobian", "ksp_type", "ksp_monitor", "ksp_converged_reason", "ksp_view", "ksp_rtol",
    "ksp_atol", "ksp_max_it", "ksp_gmres_restart", "ksp_norm_type", "ksp_initial_guess_nonzero",
    "ksp_monitor_true_residual", "pc_type", "pc_view", "pc_gamg_type", "pc_gamg_threshold",
    "pc_gamg_agg_nsmooths", "pc_gamg_square_graph", "pc_hypre_type",
    "pc_hypre_boomeramg_strong_threshold", "pc_factor_mat_solver_type", "pc_factor_levels",
    "pc_factor_shift_type", "pc_asm_overlap", "sub_pc_type", "sub_ksp_type", "mg_levels_ksp_type",
    "mg_levels_pc_type", "mg_levels_ksp_max_it", "mg_coarse_pc_type", "mat_type", "vec_type",
    "tao_type", "tao_monitor", "tao_max_it", "tao_max_funcs", "tao_view", "tao_converged_reason", "tao_ls_type",
)  # fmt: skip
GLOBAL = (
    "log_view",
    "options_file",
    "options_left",
    "options_view",
    "memory_view",
    "malloc_debug",
    "info",
    "help",
)


def split(words: Sequence[str], ours: Collection[str]) -> tuple[list[str], list[str]]:
    """Tell our arguments from PETSc's, which begin with a single dash.

    Parameters
    ----------
    words : sequence of str
        The command line after the command.
    ours : collection of str
        Single-dash options of ours, as "-o".

    Returns
    -------
    tuple of list of str
        Ours, and PETSc's with their values. As in PETSc, a word after an option is its value unless it looks
        like an option itself; only a scene file (.toml) never is.
    """
    mine: list[str] = []
    petsc: list[str] = []
    i = 0
    while i < len(words):
        word = words[i]
        if word == "--":
            mine += words[i:]
            break
        if word in ours:
            mine += words[i : i + 2]
            i += 2
        elif _is_option(word) and not word.startswith("--"):
            petsc.append(word)
            i += 1
            if i < len(words) and not _is_option(words[i]) and not words[i].endswith(".toml"):
                petsc.append(words[i])
                i += 1
        else:
            mine.append(word)
            i += 1
    return mine, petsc


def _is_option(word: str) -> bool:
    """Tell an option from a value, by PETSc's rule: -1e-3 is a value."""
    stem = word.removeprefix("-").removeprefix("-")
    return word.startswith("-") and stem[:1].isalpha()


def check_files(arguments: Sequence[str]) -> None:
    """Raise InputError for an -options_file which cannot be read: PETSc's own message fills a screen."""
    for option, value in zip(arguments, [*arguments[1:], ""], strict=False):
        if option.lower() not in ("-options_file", "-options_file_yaml"):
            continue
        if not value or _is_option(value):
            raise InputError(f"{option}: needs a file")
        if not Path(value).is_file():
            raise InputError(f"{option} {value}: no such file")
        if option.lower() == "-options_file" and Path(value).suffix not in (".yml", ".yaml"):
            _check_lines(Path(value))


def _check_lines(path: Path) -> None:
    """Raise InputError for the first line which is neither an option nor a comment."""
    continued = False
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        word = line.split()[0] if line.split() else "#"
        if not continued and word[0] not in "#!" and not _is_option(word) and word != "alias":
            raise InputError(f"{path}: line {number}: {word}: an option begins with -, a comment with #")
        continued = line.endswith("\\")


class PetscOptions:
    """The options database of this process (every rank has the same one).

    Parameters
    ----------
    arguments : sequence of str
        PETSc's part of the command line. PETSc is initialised with it: nothing may import it before.
    prefix : str
        Of our solvers, to tell what a mistyped option was meant to be.

    Attributes
    ----------
    given : set of str
        Names which the user gave, on the command line, in an options file or in the scene; lower case.
    """

    def __init__(self, arguments: Sequence[str] = (), prefix: str = "elastic_") -> None:
        self.prefix = prefix
        started = "petsc4py.PETSc" in sys.modules
        import petsc4py

        try:
            petsc4py.init(["extremal", *arguments])
        except Exception as error:
            reason = str(error).strip().splitlines()[-1]
            raise InputError(f"PETSc refuses its options {' '.join(arguments)}: {reason}") from None
        from petsc4py import PETSc

        self._database = PETSc.Options()
        if started and arguments:
            # Too late for PETSc to read its command line: another program runs us.
            self._database.insertString(" ".join(arguments))
        self.given = {name.lower() for name in self._database.getAll()}

    def add_scene(self, table: Mapping[str, Any]) -> None:
        """Take over a scene's [petsc] table; what is on the command line stays."""
        for name, value in table.items():
            if name.lower() not in self.given:
                self._database.setValue(name, _text(value))
                self.given.add(name.lower())

    def unused(self) -> dict[str, str | None]:
        """Return the options the user gave and nobody asked for, with their values."""
        return {
            name: value
            for name, value in self._database.getAll().items()
            if name.lower() in self.given and name.lower() not in AT_THE_END and not _used(name)
        }

    def unused_line(self) -> str | None:
        """Return one line about the unused options, None without any or where PETSc will report them."""
        if "options_left" in self.given:
            return None
        everything = self._database.getAll()
        known = {name for name in everything if _used(name)} | {self.prefix + name for name in COMMON} | {*GLOBAL}
        parts = []
        for name, value in self.unused().items():
            near = nearest(name, known - {name})
            parts.append(
                f"-{name}" + (f" {value}" if value else "") + (f" (did you mean -{near}?)" if near else "")
            )
        return "unused PETSc options: " + ", ".join(parts) if parts else None

    def refusal(self, error: Exception) -> InputError | None:
        """Return an error that names the option at which PETSc raised `error`, None if it was none."""
        reason = str(error).strip().splitlines()[-1].partition("] ")[2]
        for name, value in self._database.getAll().items():
            if (
                name.lower() in self.given
                and value
                and re.search(rf"(?<!\w){re.escape(value)}(?!\w)", reason)
            ):
                return InputError(f"-{name} {value}: PETSc: {reason}")
        return None

    def close(self) -> None:
        """Keep PETSc's own report at exit from repeating ours and from naming our defaults."""
        if "options_left" not in self.given:
            self._database.setValue("options_left", "no")
        for name in self._database.getAll():
            if name.lower() not in self.given and name != "options_left" and not _used(name):
                self._database.delValue(name)


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _used(name: str) -> bool:
    """Ask PETSc whether an option has been consulted; petsc4py has no call for it."""
    from petsc4py import PETSc

    flag = ctypes.c_int(0)
    function = ctypes.CDLL(PETSc.__file__).PetscOptionsUsed
    function.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    function(None, name.encode(), ctypes.byref(flag))
    return bool(flag.value)
