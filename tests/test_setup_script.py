"""`setup.sh`: what it installs, and what it says when it cannot.

apt, dpkg and sudo are stand-ins: nothing is installed.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (ROOT / "setup.sh").read_text().split('packages="')[1].split('"')[0].split()


class Machine:
    """A copy of the set-up script on a machine whose package commands are written by the test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "extremal"
        self.bin = folder / "bin"
        self.installed = folder / "installed"
        self.folder.mkdir()
        self.bin.mkdir()
        for file in ("setup.sh", "pyproject.toml"):
            shutil.copy(ROOT / file, self.folder)
        self.installed.write_text("\n".join(f"installed:{package}" for package in PACKAGES))
        self.command("dpkg-query", f"cat {self.installed}")
        self.command("id", "echo 1000")
        self.command("sudo", "exit 1")
        self.command(
            "apt-get", f'echo "$@" >> {folder}/apt; [ "$1" = update ] || cp {folder}/after {self.installed}'
        )
        (folder / "after").write_text(self.installed.read_text())
        self.apt = folder / "apt"

    def command(self, name: str, script: str) -> None:
        (self.bin / name).write_text(f"#!/bin/sh\n{script}\n")
        (self.bin / name).chmod(0o755)

    def remove(self, *packages: str) -> None:
        lines = self.installed.read_text().splitlines()
        self.installed.write_text("\n".join(x for x in lines if x.split(":")[1] not in packages))

    def make_environment(self, python: str, ready: bool) -> None:
        """A .venv with a Python of the test's making."""
        version = Path("/usr/bin/python3").resolve().name
        venv = self.folder / ".venv"
        (venv / "bin").mkdir(parents=True)
        (venv / "lib" / version / "site-packages").mkdir(parents=True)
        (venv / "pyvenv.cfg").write_text("include-system-site-packages = true\n")
        for name, script in (("python", python), ("pip", "exit 1")):
            (venv / "bin" / name).write_text(f"#!/bin/sh\n{script}\n")
            (venv / "bin" / name).chmod(0o755)
        if ready:
            sums = subprocess.check_output("cksum < pyproject.toml", shell=True, text=True, cwd=self.folder)
            (venv / "ready").write_text(f"{self.folder} {version} {sums}")

    def set_up(self, *arguments: str, path: str = "/usr/bin:/bin") -> tuple[int, list[str]]:
        done = subprocess.run(
            ["/bin/sh", self.folder / "setup.sh", *arguments],
            env={**os.environ, "PATH": f"{self.bin}:{path}"},
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
        )
        assert done.stdout == ""
        return done.returncode, done.stderr.splitlines()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_complete_machine_needs_no_word_no_network_and_no_second(machine):
    machine.make_environment("exit 1", ready=True)
    before = os.times()
    assert machine.set_up() == (0, [])
    after = os.times()  # of the processor, so that other programs do not count
    assert sum(after[2:4]) - sum(before[2:4]) < 1.0
    assert not machine.apt.exists()


def test_without_root_the_missing_packages_and_the_command_are_named(machine):
    machine.remove("python3-gmsh", "gcc")
    assert machine.set_up() == (
        1,
        [
            "setup: these Debian packages are missing, and only root can install them: python3-gmsh gcc",
            "setup: as root (su - or sudo), run:",
            "setup:     apt-get update && apt-get install -y --no-install-recommends python3-gmsh gcc",
            "setup: then repeat your command.",
        ],
    )
    assert not machine.apt.exists()


@pytest.mark.parametrize("who", ["root", "user with sudo"])
def test_missing_packages_and_only_they_are_installed(machine, who):
    machine.remove("python3-gmsh", "gcc")
    machine.make_environment("exit 1", ready=True)
    if who == "root":
        machine.command("id", "echo 0")
    else:
        machine.command("sudo", 'shift; exec "$@"')
    code, said = machine.set_up()
    assert (code, len(said)) == (0, 1)
    assert said[0].endswith(": python3-gmsh gcc")
    update, install = machine.apt.read_text().splitlines()
    assert update == "update"
    assert install.startswith("install -y --no-install-recommends python3-gmsh gcc -o ")
    assert machine.set_up() == (0, [])


def test_failing_apt_is_quoted(machine):
    machine.remove("gcc")
    machine.command("id", "echo 0")
    machine.command("apt-get", "[ $1 = update ] || { echo 'E: Unable to locate package gcc'; exit 100; }")
    code, said = machine.set_up()
    assert code == 1
    assert said[1:] == [
        "E: Unable to locate package gcc",
        "setup: apt could not install the packages (whole log in build/setup.log). The command was:",
        "setup:     apt-get install -y --no-install-recommends gcc",
    ]


def test_without_pypi_the_message_says_what_is_needed(machine):
    machine.make_environment("echo 'ERROR: No matching distribution found for pydantic'; exit 1", ready=False)
    assert machine.set_up() == (
        1,
        [
            "setup: installing extremal and what it needs from PyPI into .venv",
            "ERROR: No matching distribution found for pydantic",
            "setup: pip could not install the Python packages which pyproject.toml asks for (whole log in "
            "build/setup.log).",
            "setup: This step needs PyPI once; behind a proxy set https_proxy, or PIP_INDEX_URL for a "
            "mirror, and try again.",
        ],
    )


@pytest.mark.parametrize("change", ["pyproject.toml", "the folder", "an extra"])
def test_a_change_asks_for_a_new_installation(machine, change):
    machine.make_environment("exit 0", ready=True)
    extra = []
    if change == "pyproject.toml":
        with (machine.folder / "pyproject.toml").open("a") as file:
            file.write("\n")
    elif change == "the folder":
        machine.folder = machine.folder.rename(machine.folder.with_name("elsewhere"))
    else:
        extra = ["dev"]
    said = ["setup: installing extremal and what it needs from PyPI into .venv"]
    assert machine.set_up(*extra) == (0, said)
    assert machine.set_up(*extra) == (0, [])


def test_another_system_is_told_what_it_would_take(machine):
    (machine.bin / "dpkg-query").unlink()
    for name in ("dirname", "mkdir"):
        (machine.bin / name).symlink_to(shutil.which(name))
    code, said = machine.set_up(path="/nonexistent")
    assert code == 1
    assert said == [
        "setup: this is no Debian system; extremal runs on Debian 12 and 13 with these packages:",
        f"setup:     {' '.join(PACKAGES)}",
    ]


@pytest.mark.parametrize("target", ["run", "test", "test-long", "bench", "lint", "docs", "clean"])
def test_every_target_of_the_makefile_is_there(target):
    done = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout


def test_run_sets_up_first_and_uses_two_ranks():
    ours = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}  # not of `make test`
    commands = subprocess.check_output(["make", "-n", "run"], cwd=ROOT, text=True, env=ours).splitlines()
    assert "setup.sh" in commands[0]
    assert commands[-1] == (
        "mpirun --oversubscribe -n 2 .venv/bin/extremal elastic app/scenes/scattered_cube.toml "
        "-o results/scattered_cube"
    )
