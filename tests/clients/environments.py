"""Environments of other programs: made once from pinned versions, and kept."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yamsim_cli.core.files.writing import exclusive_lock

REPOSITORY = Path(__file__).resolve().parents[2]
REQUIREMENTS = Path(__file__).with_name("requirements")
SCRIPTS = Path(__file__).with_name("scripts")

# Prints the version of a distribution in a client's environment.
_VERSION = "import importlib.metadata, sys; print(importlib.metadata.version(sys.argv[1]))"


class UnavailableError(Exception):
    """The environment cannot be made here; the message gives the reason."""


@dataclass(frozen=True)
class Environment:
    """A client's Python and packages.

    Attributes:
        requirements: stem of a file in `requirements/`; empty for the tests' own environment.
        python: required version, such as 3.12; empty for the tests' own Python.
        beside: whether the packages come before those of the tests' environment: yamsim with another version of a
            library. Otherwise the client is alone.
    """

    requirements: str = ""
    python: str = ""
    beside: bool = False

    def make(self) -> Interpreter:
        """Return its interpreter; make the environment if it is missing.

        Raises:
            NotToBeHadError: no such Python, or the packages cannot be fetched.
        """
        if not self.requirements:
            return Interpreter(Path(sys.executable), {"PYTHONPATH": str(REPOSITORY)})
        wanted = REQUIREMENTS / f"{self.requirements}.txt"
        base = find_python(self.python)
        key = hashlib.sha256(wanted.read_bytes() + str(base).encode() + bytes([self.beside])).hexdigest()[:12]
        folder = REPOSITORY / ".venv-clients" / f"{self.requirements}-{key}"
        folder.parent.mkdir(exist_ok=True)
        with exclusive_lock(folder.parent / f"{folder.name}.lock"):
            if not (folder / ".ready").exists():
                shutil.rmtree(folder, ignore_errors=True)
                _install(base, wanted, folder, self.beside)
                (folder / ".ready").touch()
        if self.beside:
            return Interpreter(base, {"PYTHONPATH": os.pathsep.join([str(folder), str(REPOSITORY)])})
        return Interpreter(folder / "bin" / "python", {})


@dataclass(frozen=True)
class Interpreter:
    """A Python with a client, and its environment variables."""

    python: Path
    environ: Mapping[str, str]

    def run(self, script: Path | str, *arguments: object, timeout_s: float = 300) -> dict[str, Any]:
        """Return the JSON object in the last line of a script; a plain name is one of `scripts/`.

        Raises:
            AssertionError: the script failed; with all its output.
        """
        path = SCRIPTS / script if isinstance(script, str) else script
        done = self.call([str(path), *map(str, arguments)], timeout_s=timeout_s)
        printed = f"{done.stdout}\n{done.stderr}"
        assert done.returncode == 0, f"{path.name} ended with exit code {done.returncode}:\n{printed}"
        answer = json.loads(done.stdout.splitlines()[-1])
        assert isinstance(answer, dict), printed
        return answer

    def call(
        self, arguments: Sequence[str], *, timeout_s: float = 300, cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Call its Python with arguments, and return the output."""
        # Packages are installed without bytecode: a module is compiled at its first import.
        unset = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTHONDONTWRITEBYTECODE")
        environ = {key: value for key, value in os.environ.items() if key not in unset}
        # Nothing is fetched while a client runs: its test would depend on the day's downloads.
        offline = {"HF_HUB_OFFLINE": "1"}
        return subprocess.run(
            [str(self.python), *arguments],
            env=environ | offline | dict(self.environ),
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def version(self, distribution: str) -> str:
        """Return the installed version of a distribution."""
        done = self.call(["-c", _VERSION, distribution])
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


def yamsim_beside(alone: Interpreter, folder: Path, *more: str) -> tuple[Interpreter, Path]:
    """Install yamsim beside LeRobot, whose packages come from another environment. Return the interpreter and the
    packages' folder.

    Args:
        more: names or folders of further distributions.
    """
    assert alone.call(["-m", "venv", str(folder)]).returncode == 0
    both = Interpreter(folder / "bin" / "python", {})
    packages = "import sysconfig; print(sysconfig.get_path('purelib'))"
    place = Path(both.call(["-c", packages]).stdout.strip())
    (place / "lerobot.pth").write_text(alone.call(["-c", packages]).stdout)
    wanted = [f"lerobot[training]=={alone.version('lerobot')}", f"{REPOSITORY}[lerobot,video]", *more]
    done = both.call(["-m", "pip", "install", "-q", *wanted], timeout_s=1800)
    assert done.returncode == 0, done.stderr
    return both, place


def checkout(variable: str) -> Path:
    """Return the repository whose path a variable holds.

    Raises:
        NotToBeHadError: the variable is not set, or names no repository.
    """
    path = os.environ.get(variable, "")
    if not path:
        raise UnavailableError(f"{variable} does not name a checkout, with its submodules")
    if not Path(path).is_dir():
        raise UnavailableError(f"{variable} names {path}, which is no directory")
    return Path(path).resolve()


def commit(repository: Path) -> str:
    """Return a repository's short commit."""
    command = ["git", "-C", str(repository), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{repository} is no git repository: {done.stderr}"
    return done.stdout.strip()


def find_python(version: str) -> Path:
    """Return the Python of a version, such as 3.12, from the path or pyenv; the tests' own for an empty text.

    Raises:
        NotToBeHadError: there is none.
    """
    if not version or version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return Path(sys.executable)
    # A shim of pyenv may be on the path and refuse to run: only a Python that answers counts.
    candidates = [
        shutil.which(f"python{version}"),
        *sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python")),
    ]
    for candidate in filter(None, candidates):
        if subprocess.run([candidate, "-c", "import venv"], capture_output=True, check=False).returncode == 0:
            return Path(candidate)
    raise UnavailableError(f"Python {version} is not here")


def _install(base: Path, requirements: Path, folder: Path, beside: bool) -> None:
    # A pip and bytecode in each environment would take longer than everything else.
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    install = ["install", "-q", "--only-binary", ":all:", "--no-deps", "--no-compile", "-r", str(requirements)]
    if beside:
        command = [*pip, *install, "--target", str(folder)]
    else:
        subprocess.run([str(base), "-m", "venv", "--without-pip", str(folder)], check=True)
        command = [*pip, "--python", str(folder / "bin" / "python"), *install]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["pip failed"]
        raise UnavailableError(f"{requirements.name} cannot be installed: {said[-1]}")
