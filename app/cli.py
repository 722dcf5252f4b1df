"""The command line: `extremal COMMAND ...`, also as `python -m extremal.app` and under mpirun."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any, NoReturn

from .errors import EXIT_FINISHED, InputError, suggestion
from .options import split
from .parallel import run_on_all

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Command:
    """A command: the module that runs it (loaded only then) and what it says about itself.

    The module offers `add_arguments(parser, words)` and `run(args, petsc_arguments, comm) -> int`.
    """

    module: str
    purpose: str
    uses_petsc: bool


COMMANDS = {
    "elastic": Command("elastic_command", "run a scene of invertible elasticity", True),
    "snow": Command("snow_command", "run a scene of snow", True),
    "hawkes": Command("hawkes_command", "find unknown participants of events on a network", True),
    "check": Command("check_command", "validate scenes without running them; lists all errors", False),
    "mesh": Command("mesh_command", "build, convert and check a mesh", False),
    "render": Command("render_command", "draw pictures of the frames of a run, make volumes and a film", False),
    "study": Command("study_command", "run a study: accuracy against time, pictures", True),
}

EPILOGUE = """\
Options with a single dash go to PETSc: -elastic_snes_monitor, -log_view, -options_file FILE, -help.
Exit codes: 0 finished; 2 wrong input, nothing was computed; 3 solver failed or expectation missed."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program and return its exit code (collective).

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; by default those of the process.
    """
    from mpi4py import MPI

    # ufl looks through the installed packages and finds this one by two ways; nothing is wrong with that.
    warnings.filterwarnings("ignore", message="Module extremal was already imported")
    comm = MPI.COMM_WORLD
    words = list(sys.argv[1:] if argv is None else argv)
    return run_on_all(comm, lambda: dispatch(words, comm))


def dispatch(words: list[str], comm: MPI.Comm) -> int:
    """Run the command that `words` begins with.

    Raises
    ------
    InputError
        For an unknown command or option, naming the nearest.
    """
    if not words:
        raise InputError(
            f"a command is missing; one of {', '.join(COMMANDS)} (extremal --help explains them)"
        )
    name, *rest = words
    if name in ("-h", "--help"):
        _say(comm, _overview())
        return EXIT_FINISHED
    if name == "--version":
        _say(comm, f"extremal {metadata.version('extremal')}")
        return EXIT_FINISHED
    if name.startswith("-"):
        raise InputError(f"{name}: options come after the command, one of {', '.join(COMMANDS)}")
    if name not in COMMANDS:
        commands = " or ".join(f"extremal {part} {name}" for part in ("elastic", "snow", "hawkes"))
        hint = f"; write {commands}" if name.endswith(".toml") else "; " + suggestion(name, COMMANDS)
        raise InputError(f"{name}: unknown command{hint}")
    return _run(name, rest, comm)


def _run(name: str, words: list[str], comm: MPI.Comm) -> int:
    command = COMMANDS[name]
    module: Any = importlib.import_module(f".{command.module}", __package__)
    parser = Parser(
        prog=f"extremal {name}",
        description=command.purpose,
        epilog=EPILOGUE if command.uses_petsc else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        add_help=False,
    )
    parser.add_argument("-h", "--help", action="store_true", help="show this and exit")
    module.add_arguments(parser, words)
    with_value, flags = parser.single_dash()
    # Flags of ours take no value: set apart before PETSc's rule for values is applied.
    help_wanted = bool(flags & {*words}) or "--help" in words
    ours, petsc = split([word for word in words if word not in flags], with_value)
    if help_wanted:
        _say(comm, parser.format_help().rstrip())
        return EXIT_FINISHED
    if petsc and not command.uses_petsc:
        raise InputError(f"{petsc[0]}: unknown option; {parser.hint(petsc[0])} ({name} runs no PETSc solver)")
    parser.refuse_unknown(ours)
    try:
        args = parser.parse_args(_attach_negative(ours))
    except InputError as error:
        swallowed = [word for word in petsc if not word.startswith("-")]
        if "is missing" in str(error) and swallowed:
            raise InputError(f"{error} ({swallowed[-1]} was taken for the value of a PETSc option)") from None
        raise
    code: int = module.run(args, petsc, comm)
    return code


def _attach_negative(words: Sequence[str]) -> list[str]:
    """Join values such as -1,0,0 to their option: argparse would take them for options."""
    joined: list[str] = []
    for word in words:
        if joined and re.match(r"-[\d.]", word) and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class Parser(argparse.ArgumentParser):
    """argparse whose errors are InputErrors: rank 0 alone prints them."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError with argparse's message, in our words where it matters."""
        missing = "the following arguments are required: "
        if message.startswith(missing):
            message = f"{message.removeprefix(missing)} is missing"
        elif message.startswith("unrecognized arguments: "):
            message = f"{message.removeprefix('unrecognized arguments: ')}: one argument too many"
        elif message.startswith("argument "):
            message = message.removeprefix("argument ").replace("expected one argument", "needs a value")
        raise InputError(f"{self.prog.removeprefix('extremal ')}: {message}")

    def single_dash(self) -> tuple[set[str], set[str]]:
        """Return our single-dash options: those which take a value, and flags."""
        found: tuple[set[str], set[str]] = (set(), set())
        for action in self._actions:
            short = {option for option in action.option_strings if not option.startswith("--")}
            found[action.nargs == 0].update(short)
        return found

    def hint(self, word: str) -> str:
        """Return which option a word may have been meant to be."""
        known = [
            option for action in self._actions for option in action.option_strings if option.startswith("--")
        ]
        return suggestion("--" + word.lstrip("-"), known)

    def refuse_unknown(self, words: Sequence[str]) -> None:
        """Raise InputError for a double-dash option which is not ours, naming the nearest."""
        known = {option for action in self._actions for option in action.option_strings}
        for word in words:
            if word == "--":
                return
            option = word.partition("=")[0]
            if option.startswith("--") and option not in known:
                raise InputError(f"{option}: unknown option; {self.hint(option)}")


def _overview() -> str:
    width = max(len(name) for name in COMMANDS)
    lines = [f"  {name:<{width}}  {command.purpose}" for name, command in COMMANDS.items()]
    listing = "\n".join(lines)
    return (
        "usage: extremal COMMAND ...    [mpirun -n N extremal COMMAND ...]\n\n"
        f"{listing}\n\nextremal COMMAND --help explains a command; extremal --version.\n\n{EPILOGUE}"
    )


def _say(comm: MPI.Comm, text: str) -> None:
    if comm.rank == 0:
        print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
